//! Identification and verification from stored factors: no export is read.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde::Serialize;
use tokio::task::JoinError;

use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::{FactorColumns, JointFactor, unpack};
use armwatch_method::identify::verify::{StageSums, torque_rmsd};
use armwatch_method::pooled::estimate::{StackedEstimator, estimate};
use armwatch_method::pooled::pool::PooledFactors;
use armwatch_method::signal::filter::independent_fraction;
use armwatch_model::analysis::finding::ACCEPTED;
use armwatch_model::analysis::{self, CycleFactors, IdentifiedParameter, TorqueRmsd};
use armwatch_model::robot::JointIndex;
use armwatch_store::{
    CycleState, FactorsGone, FactorsWanted, JoinedFactors, ParameterSet, SourceCycle, Store, StoreError,
    StoredCycle, StoredModel,
};

/// Cycles of one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunCycles {
    /// The run.
    pub run_id: i64,
    /// Numbers of the cycles; all of them if `None`.
    pub cycles: Option<Vec<u32>>,
    /// True if a person named the run: it is then used even if none of its cycles counts.
    pub named: bool,
}

impl RunCycles {
    /// All cycles of a run that no person named.
    pub fn all(run_id: i64) -> Self {
        Self { run_id, cycles: None, named: false }
    }
}

/// Parameters that are applied to recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterCandidate {
    /// Description that they belong to.
    pub model: StoredModel,
    /// The parameters.
    pub parameters: Vec<IdentifiedParameter>,
}

/// RMSD of one candidate on one run.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossVerification {
    /// Index of the candidate among those given.
    pub candidate: usize,
    /// The run.
    pub run_id: i64,
    /// By joint and stage, over all cycles of the run together.
    pub rmsd: Vec<TorqueRmsd>,
    /// The same for each cycle that has its own factors.
    pub by_cycle: Vec<(u32, Vec<TorqueRmsd>)>,
    /// Windows of a production log whose factors were joined: they are in `rmsd` and not in `by_cycle`.
    pub joined_windows: usize,
    /// Excluded cycles of the run.
    pub passed_over: Vec<NotedCycle>,
    /// Cycles of the run that are included despite a finding.
    pub in_spite: Vec<NotedCycle>,
}

/// A cycle that is excluded although its run was chosen, or included despite a finding.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotedCycle {
    /// The run.
    #[serde(skip)]
    pub run_id: i64,
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Why.
    pub reason: String,
}

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum StoredError {
    /// Every chosen cycle was refused when it was read, or has no factors.
    #[error("no usable cycle is left: {}", told(.0))]
    PassedOver(Vec<NotedCycle>),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The numbers cannot be computed.
    #[error(transparent)]
    Numerics(#[from] NumericsError),
    /// The request is inconsistent, or its data does not exist.
    #[error("{0}")]
    Refused(String),
    /// A task of the program itself panicked.
    #[error("internal error: {0}")]
    Task(#[from] JoinError),
}

/// Most cycles that are combined. Their factors are in memory, 50 kB per cycle of a six-joint arm, which makes 250 MB;
/// that is half a year of tests with 24 cycles per day.
pub const MAX_CYCLES_TOGETHER: usize = 5000;

/// Combined cycles, with the data that identification needs.
#[derive(Debug, Clone)]
pub struct PooledCycles {
    /// Description of all of them.
    pub model: StoredModel,
    /// Their moving rows of excitation.
    pub union: PooledFactors,
    /// Their runs and numbers, in the order of the union's.
    pub sources: Vec<SourceCycle>,
    /// Excluded cycles of the chosen runs.
    pub passed_over: Vec<NotedCycle>,
    /// Cycles that are included despite a finding.
    pub in_spite: Vec<NotedCycle>,
}

/// Combines the chosen cycles. Within whole runs, cycles that were refused during reading are skipped.
///
/// # Errors
/// [`StoredError::PassedOver`] if none is left; [`StoredError::Refused`] if a run has no cycles, a requested cycle has
/// no factors, the cycles belong to different descriptions, or there are more than [`MAX_CYCLES_TOGETHER`].
pub async fn take(store: &Store, chosen: &[RunCycles]) -> Result<PooledCycles, StoredError> {
    let mut taken: Option<(PooledCycles, i64)> = None;
    let (mut passed_over, mut in_spite) = (Vec::new(), Vec::new());
    for of_run in merged(chosen) {
        let ChosenCycles { cycles, passed_over: without, in_spite: noted, .. } =
            chosen_cycles(store, &of_run, FactorsWanted::Identification).await?;
        passed_over.extend(without);
        in_spite.extend(noted);
        for cycle in cycles {
            let columns = FactorColumns::of_stored(&cycle.factors.columns);
            let (taken, first_run) = taken.get_or_insert_with(|| {
                let union = PooledFactors::new(columns.clone());
                let (model, sources) = (cycle.model.clone(), Vec::new());
                let (passed_over, in_spite) = (Vec::new(), Vec::new());
                (PooledCycles { model, union, sources, passed_over, in_spite }, cycle.run_id)
            });
            same_model(&taken.model, *first_run, &cycle)?;
            if taken.sources.len() == MAX_CYCLES_TOGETHER {
                return Err(StoredError::Refused(format!(
                    "more than {MAX_CYCLES_TOGETHER} cycles are chosen; choose fewer runs, or some cycles of each"
                )));
            }
            add(&mut taken.union, &columns, &cycle)?;
            taken.sources.push(source(cycle));
        }
    }
    match taken {
        Some((taken, _)) => Ok(PooledCycles { passed_over, in_spite, ..taken }),
        None if passed_over.is_empty() => Err(StoredError::Refused("no cycles are chosen".into())),
        None => Err(StoredError::PassedOver(passed_over)),
    }
}

/// Adds a stored cycle to a union. Only this function determines how many of its rows are independent.
pub(in crate::pipeline) fn add(
    union: &mut PooledFactors,
    columns: &FactorColumns,
    cycle: &StoredCycle,
) -> Result<(), NumericsError> {
    union.add(columns, &unpack(&cycle.factors)?, &independent_shares(cycle))
}

pub(in crate::pipeline) fn source(cycle: StoredCycle) -> SourceCycle {
    SourceCycle { run_id: cycle.run_id, cycle: cycle.cycle, robot: cycle.robot }
}

/// Identifies one parameter set on the chosen cycles, joints stacked, from moving rows of their excitation stages, with
/// the configured `estimator` or its counterpart on factors ([`analysis::Estimator::of_factors`]).
///
/// # Errors
/// Those of [`take`]; [`StoredError::Numerics`] if the motion is too poor.
pub async fn unit_identification(
    store: &Store,
    chosen: &[RunCycles],
    estimator: analysis::Estimator,
) -> Result<ParameterSet, StoredError> {
    identify_taken(take(store, chosen).await?, estimator).await
}

/// The same on cycles that are already combined.
///
/// # Errors
/// [`StoredError::Numerics`] if the motion is too poor.
pub async fn identify_taken(
    taken: PooledCycles,
    estimator: analysis::Estimator,
) -> Result<ParameterSet, StoredError> {
    let estimator = match estimator.of_factors() {
        analysis::Estimator::Ordinary => StackedEstimator::Ordinary,
        analysis::Estimator::Weighted | analysis::Estimator::Huber => StackedEstimator::Weighted,
    };
    let kind = estimator.kind();
    let PooledCycles { model, union, sources, .. } = taken;
    let found = tokio::task::spawn_blocking(move || estimate(&union, &estimator)).await??;
    Ok(ParameterSet {
        model,
        errors: found.errors.source(),
        estimator: kind,
        identification: found.identification,
        sources,
    })
}

/// RMSD of one parameter set over the combined chosen cycles, by joint and stage.
///
/// # Errors
/// Those of [`take`].
pub async fn rmsd_on(
    store: &Store,
    candidate: &ParameterCandidate,
    chosen: &[RunCycles],
) -> Result<Vec<TorqueRmsd>, StoredError> {
    let mut sums = StageSums::default();
    for of_run in merged(chosen) {
        let of_run = chosen_cycles(store, &of_run, FactorsWanted::All).await?;
        for (run_id, model, factors) in of_run.all_factors() {
            same_model_of_run(&candidate.model, run_id, run_id, model)?;
            let columns = FactorColumns::of_stored(&factors.columns);
            sums.add(&columns, &unpack(factors)?, &theta(&columns, candidate)?);
        }
    }
    Ok(sums.rmsd())
}

/// RMSD of each joint's torque with the parameters from its own rows [3.21], over the combined chosen cycles;
/// parameters that a view omits count as zero.
///
/// # Errors
/// Those of [`take`].
pub async fn rmsd_of_views(
    store: &Store,
    views: &[(JointIndex, Vec<IdentifiedParameter>)],
    chosen: &[RunCycles],
) -> Result<Vec<TorqueRmsd>, StoredError> {
    let mut sums = StageSums::default();
    for of_run in merged(chosen) {
        for (_, _, factors) in chosen_cycles(store, &of_run, FactorsWanted::All).await?.all_factors() {
            let columns = FactorColumns::of_stored(&factors.columns);
            let factors = unpack(factors)?;
            for (joint, parameters) in views {
                let value = |id| parameters.iter().find(|p| p.id == id).map_or(0.0, |p| p.value);
                let theta: Vec<f64> = columns.kept().iter().map(|&id| value(id)).collect();
                let own: Vec<JointFactor> = factors.iter().filter(|of| of.joint == *joint).cloned().collect();
                sums.add(&columns, &own, &theta);
            }
        }
    }
    Ok(sums.rmsd())
}

/// Applies each candidate to each run. Runs are read one after another, so that memory does not grow with their number.
///
/// # Errors
/// Those of [`take`].
pub async fn cross_verification(
    store: &Store,
    candidates: Vec<ParameterCandidate>,
    runs: &[RunCycles],
) -> Result<Vec<CrossVerification>, StoredError> {
    let candidates = Arc::new(candidates);
    let mut verified = Vec::new();
    for of_run in runs {
        let run_id = of_run.run_id;
        let chosen = chosen_cycles(store, of_run, FactorsWanted::All).await?;
        let candidates = Arc::clone(&candidates);
        let of_run = tokio::task::spawn_blocking(move || verify_run(&candidates, run_id, chosen)).await??;
        verified.extend(of_run);
    }
    Ok(verified)
}

fn verify_run(
    candidates: &[ParameterCandidate],
    run_id: i64,
    ChosenCycles { cycles, joined, joined_windows, passed_over, in_spite }: ChosenCycles,
) -> Result<Vec<CrossVerification>, StoredError> {
    let empty = |candidate| CrossVerification {
        candidate,
        run_id,
        rmsd: Vec::new(),
        by_cycle: Vec::new(),
        joined_windows,
        passed_over: passed_over.clone(),
        in_spite: in_spite.clone(),
    };
    let mut verified: Vec<CrossVerification> = (0..candidates.len()).map(empty).collect();
    let mut sums = vec![StageSums::default(); candidates.len()];
    for cycle in &cycles {
        let columns = FactorColumns::of_stored(&cycle.factors.columns);
        let factors = unpack(&cycle.factors)?;
        for ((candidate, verified), sums) in candidates.iter().zip(&mut verified).zip(&mut sums) {
            same_model(&candidate.model, run_id, cycle)?;
            let theta = theta(&columns, candidate)?;
            sums.add(&columns, &factors, &theta);
            verified.by_cycle.push((cycle.cycle, torque_rmsd(&columns, &factors, &theta)));
        }
    }
    for JoinedFactors { model, factors, .. } in &joined {
        let columns = FactorColumns::of_stored(&factors.columns);
        let factors = unpack(factors)?;
        for (candidate, sums) in candidates.iter().zip(&mut sums) {
            same_model_of_run(&candidate.model, run_id, run_id, model)?;
            sums.add(&columns, &factors, &theta(&columns, candidate)?);
        }
    }
    for (verified, sums) in verified.iter_mut().zip(sums) {
        verified.rmsd = sums.rmsd();
    }
    Ok(verified)
}

/// One entry per run; a cycle that is chosen twice counts once.
pub(in crate::pipeline) fn merged(chosen: &[RunCycles]) -> Vec<RunCycles> {
    let mut by_run: BTreeMap<i64, RunCycles> = BTreeMap::new();
    for RunCycles { run_id, cycles, named } in chosen {
        let known = by_run.entry(*run_id).or_insert_with(|| RunCycles {
            run_id: *run_id,
            cycles: Some(Vec::new()),
            named: false,
        });
        known.cycles = known.cycles.take().zip(cycles.clone()).map(|(known, more)| [known, more].concat());
        known.named |= named;
    }
    by_run.into_values().collect()
}

/// Cycles of a run, and its excluded cycles.
#[derive(Debug, Clone)]
pub(in crate::pipeline) struct ChosenCycles {
    pub(in crate::pipeline) cycles: Vec<StoredCycle>,
    /// Joined factors of a whole log's windows, if all rows are requested.
    pub(in crate::pipeline) joined: Vec<JoinedFactors>,
    /// Number of joined windows.
    pub(in crate::pipeline) joined_windows: usize,
    pub(in crate::pipeline) passed_over: Vec<NotedCycle>,
    pub(in crate::pipeline) in_spite: Vec<NotedCycle>,
}

impl ChosenCycles {
    /// The run, the description and the factors of each cycle, then of joined windows.
    pub(super) fn all_factors(&self) -> impl Iterator<Item = (i64, &StoredModel, &CycleFactors)> {
        let own = self.cycles.iter().map(|of| (of.run_id, &of.model, &of.factors));
        own.chain(self.joined.iter().map(|of| (of.run_id, &of.model, &of.factors)))
    }
}

/// Chosen cycles that have factors. Within a whole run, refused and doubtful cycles are skipped, unless a person named
/// the run and it has no others. A cycle that is requested by its number is used if its factors are stored.
pub(in crate::pipeline) async fn chosen_cycles(
    store: &Store,
    chosen: &RunCycles,
    wanted: FactorsWanted,
) -> Result<ChosenCycles, StoredError> {
    let run_id = chosen.run_id;
    let states = store.cycle_states(run_id).await?;
    let mut cycles = store.factors_of_run(run_id, wanted).await?;
    if states.is_empty() {
        return Err(StoredError::Refused(without_cycles(store, run_id).await?));
    }
    if cycles.is_empty()
        && let Err(error) = store.refuse_snapshot("nothing can be identified or verified on it")
    {
        return Err(StoredError::Refused(error.to_string()));
    }
    let has_factors = |cycles: &[StoredCycle], number: u32| cycles.iter().any(|cycle| cycle.cycle == number);
    let with_factors: Vec<u32> = cycles.iter().map(|cycle| cycle.cycle).collect();
    let why = |number: u32| match states.iter().find(|state| state.cycle == number) {
        Some(CycleState { reason: Some(reason), .. }) => format!("refused when it was read: {reason}"),
        Some(CycleState { factors_gone: Some(FactorsGone::Joined), .. }) => format!(
            "they expired and were joined with those of the other windows ([retention] in the \
            configuration); verification against the whole log is still possible, and `armwatch ingest \
            --again {run_id}` reads its export again"
        ),
        Some(CycleState { factors_gone: Some(FactorsGone::Removed), .. }) => format!(
            "they expired and were deleted ([retention] in the configuration); its results stay, and \
            `armwatch ingest --again {run_id}` reads its export again"
        ),
        Some(CycleState { remarks, .. }) if with_factors.contains(&number) => {
            marked(remarks.as_deref()).unwrap_or_else(|| "doubtful".to_owned())
        }
        _ => "no factors are stored: it was stored by an older program".to_owned(),
    };
    if let Some(numbers) = &chosen.cycles {
        if let Some(missing) = numbers.iter().find(|number| !has_factors(&cycles, **number)) {
            return Err(StoredError::Refused(match states.iter().any(|state| state.cycle == *missing) {
                true => format!("cycle {missing} of run {run_id} has no factors: {}", why(*missing)),
                false => {
                    let there = in_ranges(states.iter().map(|state| i64::from(state.cycle)));
                    format!(
                        "run {run_id} has no cycle {missing}; it has cycles {there}: choose among these with --cycles"
                    )
                }
            }));
        }
        cycles.retain(|cycle| numbers.contains(&cycle.cycle));
    } else {
        // many poor motions together may identify parameters that none of them does alone
        let joins = |cycle: &StoredCycle| cycle.joinable && !cycle.factors.factors.is_empty();
        let identifies = wanted == FactorsWanted::Identification;
        let takes = |cycle: &StoredCycle| cycle.counts || identifies && joins(cycle);
        if !chosen.named || cycles.iter().any(takes) {
            cycles.retain(takes);
        }
    }
    let in_spite = cycles.iter().filter_map(|cycle| {
        let state = states.iter().find(|state| state.cycle == cycle.cycle)?;
        let reason = match cycle.counts {
            true => marked(state.remarks.as_deref())?,
            false => why(cycle.cycle),
        };
        Some(NotedCycle { run_id, cycle: cycle.cycle, reason })
    });
    let in_spite: Vec<NotedCycle> = in_spite.collect();
    if chosen.cycles.is_some() {
        let (joined, passed_over) = (Vec::new(), Vec::new());
        return Ok(ChosenCycles { cycles, joined, joined_windows: 0, passed_over, in_spite });
    }
    let joined = match wanted {
        FactorsWanted::All => store.joined_factors(run_id).await?,
        FactorsWanted::Identification => Vec::new(),
    };
    let is_joined =
        |state: &CycleState| !joined.is_empty() && state.factors_gone == Some(FactorsGone::Joined);
    let joined_windows = states.iter().filter(|state| is_joined(state)).count();
    let without = states.iter().filter(|state| !is_joined(state)).map(|state| state.cycle);
    let without = without.filter(|number| !has_factors(&cycles, *number));
    let passed_over = without.map(|cycle| NotedCycle { run_id, cycle, reason: why(cycle) }).collect();
    Ok(ChosenCycles { cycles, joined, joined_windows, passed_over, in_spite })
}

/// The remarks that make a cycle doubtful or accepted.
fn marked(remarks: Option<&str>) -> Option<String> {
    let is_mark = |line: &&str| line.starts_with("doubtful: ") || line.starts_with(ACCEPTED);
    let lines: Vec<&str> = remarks?.lines().filter(is_mark).collect();
    (!lines.is_empty()).then(|| lines.join("; "))
}

/// Why a run has no cycles to use, with the runs that have some.
async fn without_cycles(store: &Store, run_id: i64) -> Result<String, StoreError> {
    let runs = store.runs().await?;
    let with_cycles = in_ranges(runs.iter().filter(|run| run.cycles > 0).map(|run| run.run_id));
    let what = match runs.iter().find(|run| run.run_id == run_id) {
        Some(run) => format!("run {run_id} of robot {} has no cycle: it is {}", run.robot, run.status.name()),
        None => format!("there is no run {run_id}"),
    };
    match runs.iter().any(|run| run.cycles > 0) {
        true => Ok(format!("{what}; runs with cycles: {with_cycles}; `armwatch runs` lists them")),
        false => Ok(format!("{what}, and no run has cycles; `armwatch ingest` reads exports")),
    }
}

/// Numbers as ranges, such as `1-8, 10`; only the first ranges and the last one if there are many, `none` if empty.
pub fn in_ranges(numbers: impl IntoIterator<Item = i64>) -> String {
    /// more would hide the point of the sentence
    const MOST: usize = 8;
    let numbers: Vec<i64> = numbers.into_iter().collect::<BTreeSet<_>>().into_iter().collect();
    let ranges: Vec<String> = numbers
        .chunk_by(|a, b| a + 1 == *b)
        .filter_map(|range| Some((range.first()?, range.last()?)))
        .map(|(first, last)| if first == last { first.to_string() } else { format!("{first}-{last}") })
        .collect();
    match ranges.split_last() {
        None => "none".into(),
        Some((last, others)) if ranges.len() > MOST => {
            let first: Vec<&str> = others.iter().take(MOST - 1).map(String::as_str).collect();
            format!("{}, ..., {last}", first.join(", "))
        }
        Some(_) => ranges.join(", "),
    }
}

/// Notes on cycles in one sentence; consecutive cycles of a run with the same reason are combined.
pub fn told(noted: &[NotedCycle]) -> String {
    let alike = noted.chunk_by(|a, b| (a.run_id, &a.reason, a.cycle + 1) == (b.run_id, &b.reason, b.cycle));
    let parts: Vec<String> = alike
        .map(|alike| {
            let (first, last) = (&alike[0], &alike[alike.len() - 1]);
            let cycles = match alike.len() {
                1 => format!("cycle {}", first.cycle),
                _ => format!("cycles {} to {}", first.cycle, last.cycle),
            };
            format!("run {}, {cycles}: {}", first.run_id, first.reason)
        })
        .collect();
    parts.join("; ")
}

pub(in crate::pipeline) fn same_model(
    model: &StoredModel,
    of: i64,
    cycle: &StoredCycle,
) -> Result<(), StoredError> {
    same_model_of_run(model, of, cycle.run_id, &cycle.model)
}

fn same_model_of_run(
    model: &StoredModel,
    of: i64,
    run_id: i64,
    of_run: &StoredModel,
) -> Result<(), StoredError> {
    if model == of_run {
        return Ok(());
    }
    let shown = |model: &StoredModel| {
        let hash: String = model.description_hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
        format!("{} ({hash})", model.name)
    };
    let (ours, theirs) = (shown(model), shown(of_run));
    Err(StoredError::Refused(format!(
        "run {run_id} was analysed with the description {theirs}, run {of} or the parameters with {ours}: \
        base parameters of different descriptions are not comparable; choose runs of one description"
    )))
}

fn theta(columns: &FactorColumns, candidate: &ParameterCandidate) -> Result<Vec<f64>, NumericsError> {
    columns.theta(candidate.parameters.iter().map(|parameter| (parameter.id, parameter.value)))
}

/// The stored shares; for cycles without, the share that the low-pass leaves.
pub(in crate::pipeline) fn independent_shares(cycle: &StoredCycle) -> Vec<f64> {
    match cycle.independent_shares.is_empty() {
        true => vec![independent_fraction(cycle.cutoff, cycle.sample_rate); cycle.factors.columns.len()],
        false => cycle.independent_shares.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_told_in_ranges() {
        assert_eq!(in_ranges([]), "none");
        assert_eq!(in_ranges([3, 1, 2, 3, 7]), "1-3, 7");
        assert_eq!(in_ranges((1..=20).map(|n| 2 * n)), "2, 4, 6, 8, 10, 12, 14, ..., 40");
    }
}
