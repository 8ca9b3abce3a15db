//! Applies any estimator to stored factors: one set of parameters for all chosen cycles, or one for each cycle.

use super::chosen_cycles::{
    NotedCycle, PooledCycles, RunCycles, StoredError, add, chosen_cycles, merged, same_model, source,
};
use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::FactorColumns;
use armwatch_method::least_squares::conditioning::{Identifiability, identifiability};
use armwatch_method::least_squares::essential::EssentialSettings;
use armwatch_method::pooled::estimate::{PooledEstimate, StackedEstimator, estimate, estimate_essential};
use armwatch_method::pooled::per_joint::{PerJointEstimate, per_joint_estimates};
use armwatch_method::pooled::pool::{PooledFactors, RowWeights};
use armwatch_method::statistics::descriptive::parameter_statistics;
use armwatch_model::analysis::IdentifiedParameter;
use armwatch_model::analysis::estimator_kind::EstimatorKind;
use armwatch_model::robot::{JointIndex, ParameterId};
use armwatch_store::{
    CycleView, FactorsWanted, Reestimate, ReestimatedCycle, ReestimatedStatistics, Store, StoredCycle,
    StoredModel,
};

/// An estimator with its options.
#[derive(Debug, Clone, PartialEq)]
pub enum EstimatorChoice {
    /// One set of parameters from all joints, stacked.
    Stacked(StackedEstimator),
    /// Each joint alone ([`per_joint_estimates`]).
    PerJoint,
}

impl EstimatorChoice {
    /// The kind of the estimator.
    pub fn kind(&self) -> EstimatorKind {
        match self {
            Self::Stacked(estimator) => estimator.kind(),
            Self::PerJoint => EstimatorKind::PerJoint,
        }
    }
}

/// The result of combined cycles.
#[derive(Debug, Clone)]
pub struct PooledResult {
    /// Identifiability of the parameters by the motion.
    pub shown: Identifiability,
    /// The parameters.
    pub outcome: PooledOutcome,
}

/// Parameters, or the reason for their absence.
#[derive(Debug, Clone)]
pub enum PooledOutcome {
    /// One set.
    Set(Box<PooledEstimate>),
    /// Each joint's own view.
    Views(Vec<(JointIndex, Result<PerJointEstimate, NumericsError>)>),
    /// The motion does not identify every parameter: [`PooledResult::shown`] names the others.
    TooPoor,
}

/// Identifies one parameter set on combined cycles, on a blocking thread; with `fewest`, the fewest parameters that
/// explain the torque as well.
///
/// # Errors
/// [`StoredError::Numerics`] for too few rows or cycles, and for numbers that are not finite.
pub async fn estimate_together(
    taken: &PooledCycles,
    choice: &EstimatorChoice,
    fewest: Option<EssentialSettings>,
) -> Result<PooledResult, StoredError> {
    let (union, choice) = (taken.union.clone(), choice.clone());
    Ok(tokio::task::spawn_blocking(move || together(&union, &choice, fewest.as_ref())).await??)
}

fn together(
    union: &PooledFactors,
    choice: &EstimatorChoice,
    fewest: Option<&EssentialSettings>,
) -> Result<PooledResult, NumericsError> {
    let equal = RowWeights::equal(union.columns().joint_count());
    let shown = identifiability(&union.stacked(&equal))?;
    let EstimatorChoice::Stacked(estimator) = choice else {
        return Ok(PooledResult { shown, outcome: PooledOutcome::Views(per_joint_estimates(union)) });
    };
    let found = match fewest {
        Some(settings) => estimate_essential(union, estimator, settings),
        None => estimate(union, estimator),
    };
    match found {
        Ok(found) => Ok(PooledResult { shown, outcome: PooledOutcome::Set(Box::new(found)) }),
        Err(NumericsError::RankDeficient { .. }) => {
            Ok(PooledResult { shown, outcome: PooledOutcome::TooPoor })
        }
        Err(error) => Err(error),
    }
}

/// Cycles that need a note.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ChosenNotes {
    /// Excluded cycles of the chosen runs.
    pub passed_over: Vec<NotedCycle>,
    /// Cycles that are included despite a finding.
    pub in_spite: Vec<NotedCycle>,
}

/// Identifies every chosen cycle alone, run after run. A cycle without parameters has the reason instead. Cycles of
/// whole runs that cannot be used are returned separately. `progress` is called with the number of completed cycles.
///
/// # Errors
/// [`StoredError::Refused`] as for [`take`](super::chosen_cycles::take), and for [`StackedEstimator::Huber`], which
/// needs several cycles to weight.
pub async fn reestimate(
    store: &Store,
    chosen: &[RunCycles],
    choice: &EstimatorChoice,
    progress: &mut dyn FnMut(usize),
) -> Result<(Reestimate, ChosenNotes), StoredError> {
    if *choice == EstimatorChoice::Stacked(StackedEstimator::Huber) {
        return Err(StoredError::Refused(
            "huber compares cycles and cannot weight a single one; use another estimator".into(),
        ));
    }
    let mut model: Option<(StoredModel, i64)> = None;
    let mut cycles = Vec::new();
    let mut notes = ChosenNotes::default();
    for of_run in merged(chosen) {
        let of_run = chosen_cycles(store, &of_run, FactorsWanted::Identification).await?;
        notes.passed_over.extend(of_run.passed_over);
        notes.in_spite.extend(of_run.in_spite);
        for cycle in of_run.cycles {
            let (model, first_run) = model.get_or_insert_with(|| (cycle.model.clone(), cycle.run_id));
            same_model(model, *first_run, &cycle)?;
            let choice = choice.clone();
            cycles.push(tokio::task::spawn_blocking(move || one_cycle(cycle, &choice)).await?);
            progress(cycles.len());
        }
    }
    let Some((model, _)) = model else {
        return Err(match notes.passed_over.is_empty() {
            true => StoredError::Refused("no cycles are chosen".into()),
            false => StoredError::PassedOver(notes.passed_over),
        });
    };
    let statistics = statistics(&cycles);
    Ok((Reestimate { model, estimator: choice.kind(), cycles, statistics }, notes))
}

fn one_cycle(cycle: StoredCycle, choice: &EstimatorChoice) -> ReestimatedCycle {
    let columns = FactorColumns::of_stored(&cycle.factors.columns);
    let mut union = PooledFactors::new(columns.clone());
    let found = add(&mut union, &columns, &cycle).and_then(|()| match choice {
        EstimatorChoice::Stacked(estimator) => {
            estimate(&union, estimator).map(|found| (vec![stacked_view(found)], None))
        }
        EstimatorChoice::PerJoint => Ok(views_and_reason(per_joint_estimates(&union))),
    });
    let (views, reason) = found.unwrap_or_else(|error| (Vec::new(), Some(error.to_string())));
    ReestimatedCycle { source: source(cycle), views, reason }
}

fn stacked_view(found: PooledEstimate) -> CycleView {
    CycleView {
        seen_by: None,
        identification: found.identification,
        half_width: found.half_width,
        data_share: found.prior.map(|prior| prior.data_share),
    }
}

fn views_and_reason(
    found: Vec<(JointIndex, Result<PerJointEstimate, NumericsError>)>,
) -> (Vec<CycleView>, Option<String>) {
    let (mut views, mut reasons) = (Vec::new(), Vec::new());
    for (joint, view) in found {
        match view {
            Ok(PerJointEstimate { identification, half_width, .. }) => {
                views.push(CycleView { seen_by: Some(joint), identification, half_width, data_share: None });
            }
            Err(error) => reasons.push(format!("joint {joint}: {error}")),
        }
    }
    (views, (!reasons.is_empty()).then(|| reasons.join("; ")))
}

/// Statistics of each parameter over the cycles of each run, like those of `parameter_statistics`.
fn statistics(cycles: &[ReestimatedCycle]) -> Vec<ReestimatedStatistics> {
    let mut found = Vec::new();
    for of_run in cycles.chunk_by(|a, b| a.source.run_id == b.source.run_id) {
        let first = &of_run[0].source;
        for (seen_by, id) in series_of(of_run) {
            let value = |cycle: &ReestimatedCycle| {
                let view = cycle.views.iter().find(|view| view.seen_by == seen_by)?;
                let parameter = view.identification.parameters.iter().find(|p| p.id == id && p.is_shown())?;
                Some((cycle.source.cycle, parameter.value))
            };
            let by_cycle: Vec<(u32, f64)> = of_run.iter().filter_map(value).collect();
            found.extend(parameter_statistics(id, &by_cycle).into_iter().map(|statistics| {
                ReestimatedStatistics {
                    robot: first.robot.clone(),
                    run_id: first.run_id,
                    seen_by,
                    statistics,
                }
            }));
        }
    }
    found
}

/// Every parameter of a cycle of the run, with the joint whose view contains it.
fn series_of(cycles: &[ReestimatedCycle]) -> Vec<(Option<JointIndex>, ParameterId)> {
    let ids = |view: &CycleView| {
        let seen_by = view.seen_by;
        let of = |p: &IdentifiedParameter| (seen_by, p.id);
        view.identification.parameters.iter().map(of).collect::<Vec<_>>()
    };
    let mut series: Vec<_> = cycles.iter().flat_map(|cycle| cycle.views.iter().flat_map(ids)).collect();
    series.sort_unstable();
    series.dedup();
    series
}
