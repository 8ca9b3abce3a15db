//! Identifies stored cycles of another estimator again from their factors, with the configured one.
//!
//! An estimator that does not need single rows is a choice of weights on stored factors. So a changed
//! `[analysis] estimator`, or a program whose default has changed, needs no export: parameters, errors, residuals,
//! self-verification, statistics and summaries are computed again, run by run, each in a transaction. Results that
//! cannot be computed again stay and are marked ([`Store::keep_estimates`]). Conclusions on a robot's history are drawn
//! after all of its cycles are done, so that two estimators are never compared.

use tokio_util::sync::CancellationToken;

use super::context::{Pipeline, PipelineError};
use super::stored::chosen_cycles::independent_shares;
use armwatch_method::NumericsError;
use armwatch_method::identify::cycle::identify_factors;
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::identify::verify::torque_rmsd;
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_method::statistics::descriptive::{median, parameter_statistics, swing};
use armwatch_model::analysis::measurements::{ByCycle, RunMeasurements};
use armwatch_model::analysis::{Estimator, Identification, ParameterStatistics, TorqueRmsd};
use armwatch_model::robot::JointIndex;
use armwatch_store::{JointDeviation, NewEstimate, OtherEstimate, Store, StoredCycle};

/// Cycles whose factors are in memory at once: 50 kB each for a six-joint arm, 3 MB in total.
const CYCLES_AT_ONCE: usize = 64;

/// Progress of the repeated identification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reweighting {
    /// Cycles that are done.
    pub done: u64,
    /// Cycles of another estimator at the beginning.
    pub total: u64,
}

/// The result of the repeated identification.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reweighted {
    /// Cycles that now have the configured estimator.
    pub cycles: u64,
    /// Cycles that keep another one; `estimator_reason` in the view `cycles` gives the reason.
    pub kept: u64,
    /// True if a stop was requested before all cycles were done: the rest follows at the next start, and no conclusions
    /// are drawn before.
    pub interrupted: bool,
}

impl Pipeline {
    /// Identifies all stored cycles with another estimator than the configured one again, if their factors allow it.
    /// `progress` is called after some cycles.
    pub async fn reweight(
        &self,
        stop: &CancellationToken,
        progress: &mut (dyn FnMut(Reweighting) + Send),
    ) -> Result<Reweighted, PipelineError> {
        self.reweight_of(None, stop, progress).await
    }

    /// The same for one robot, without progress or stop; returns true if anything has changed.
    pub(super) async fn reweight_robot(&self, robot_id: i64) -> Result<bool, PipelineError> {
        let never = CancellationToken::new();
        let done = self.reweight_of(Some(robot_id), &never, &mut |_| ()).await?;
        Ok(done.cycles > 0)
    }

    async fn reweight_of(
        &self,
        robot_id: Option<i64>,
        stop: &CancellationToken,
        progress: &mut (dyn FnMut(Reweighting) + Send),
    ) -> Result<Reweighted, PipelineError> {
        let wanted = self.config.analysis.estimator;
        let mut found =
            Reweighted { kept: self.store.keep_estimates(wanted).await?, ..Reweighted::default() };
        let runs = self.store.other_estimates(wanted, robot_id).await?;
        let total = runs.iter().map(|run| u64::from(run.cycles)).sum();
        let mut at = Reweighting { done: 0, total };
        for run in &runs {
            let mut counted = |cycles: u64| {
                at.done += cycles;
                progress(at);
            };
            let Some((cycles, kept)) = of_run(&self.store, run, wanted, stop, &mut counted).await? else {
                return Ok(Reweighted { interrupted: true, ..found });
            };
            found.cycles += cycles;
            found.kept += kept;
        }
        Ok(found)
    }
}

/// Identifies the cycles of a run again. Returns how many have the configured estimator now, and how many keep theirs.
/// Returns `None`, and stores nothing of the run, if a stop was requested.
async fn of_run(
    store: &Store,
    run: &OtherEstimate,
    wanted: Estimator,
    stop: &CancellationToken,
    counted: &mut (dyn FnMut(u64) + Send),
) -> Result<Option<(u64, u64)>, PipelineError> {
    let numbers = store.cycles_of_other_estimates(run.run_id, wanted).await?;
    let mut estimates = Vec::with_capacity(numbers.len());
    for some in numbers.chunks(CYCLES_AT_ONCE) {
        if stop.is_cancelled() {
            return Ok(None);
        }
        let cycles = store.factors_of_cycles(run.run_id, some).await?;
        let made = move || cycles.iter().map(|cycle| estimate(cycle, wanted)).collect::<Vec<_>>();
        estimates.extend(tokio::task::spawn_blocking(made).await?);
        counted(some.len() as u64);
    }
    for of in &estimates {
        if let Err(reason) = &of.found {
            tracing::warn!(
                robot = run.robot,
                run_id = run.run_id,
                cycle = of.cycle,
                "keeps its estimator: {reason}"
            );
        }
    }
    let kept = estimates.iter().filter(|of| of.found.is_err()).count() as u64;
    let mut transaction = store.replace_estimates(run.run_id, wanted).await?;
    for of in &estimates {
        transaction.replace(of).await?;
    }
    let (statistics, deviations) = run_figures(&transaction.measurements().await?);
    transaction.replace_run_figures(&statistics, &deviations).await?;
    transaction.commit().await?;
    Ok(Some((estimates.len() as u64 - kept, kept)))
}

fn estimate(cycle: &StoredCycle, wanted: Estimator) -> NewEstimate {
    NewEstimate {
        cycle: cycle.cycle,
        robot_model_id: cycle.model.robot_model_id,
        found: of_factors(cycle, wanted)
            .map_err(|error| format!("the {} estimate from its factors fails: {error}", wanted.name())),
    }
}

/// Parameters of a cycle's moving rows of excitation, with errors by the share of rows that the cycle's own
/// identification found independent, and their self-verification.
fn of_factors(
    cycle: &StoredCycle,
    wanted: Estimator,
) -> Result<(Identification, Vec<TorqueRmsd>), NumericsError> {
    let columns = FactorColumns::of_stored(&cycle.factors.columns);
    let factors = unpack(&cycle.factors)?;
    let mut union = PooledFactors::new(columns.clone());
    union.add(&columns, &factors, &independent_shares(cycle))?;
    let by_joint = union.embedded_by_joint();
    let found = identify_factors(columns.kept(), &by_joint, &union.independent_shares(), wanted)?;
    let theta: Vec<f64> = found.parameters.iter().map(|parameter| parameter.value).collect();
    let verification = torque_rmsd(&columns, &factors, &theta);
    Ok((found, verification))
}

/// Overall results of a run that follow from the parameters of its cycles.
fn run_figures(measurements: &RunMeasurements) -> (Vec<ParameterStatistics>, Vec<JointDeviation>) {
    let by_parameter = measurements.by_parameter();
    let statistics = by_parameter.iter().flat_map(|(id, values)| parameter_statistics(*id, values));
    let of_joint = |(joint, values): &(JointIndex, ByCycle)| {
        let values: Vec<f64> = values.iter().map(|(_, value)| *value).collect();
        JointDeviation { joint: *joint, relative_rmsd: median(&values), rmsd_swing: swing(&values) }
    };
    (statistics.collect(), measurements.rmsd_by_joint().iter().map(of_joint).collect())
}

#[cfg(test)]
mod tests;
