//! Identification and verification from stored factors: no export is read.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::task::JoinError;

use crate::analysis::{IdentifiedParameter, TorqueRmsd};
use crate::numerics::NumericsError;
use crate::numerics::cross::{Union, independent_fraction};
use crate::numerics::factors::{JointColumns, unpack};
use crate::numerics::verify::{StageSums, torque_rmsd};
use crate::store::{FactorsWanted, ParameterSet, SourceCycle, Store, StoreError, StoredCycle, StoredModel};

/// Cycles of one run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Chosen {
    /// The run.
    pub run_id: i64,
    /// Numbers of the cycles; all of them if `None`.
    pub cycles: Option<Vec<u32>>,
}

/// Parameters that are applied to recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct Candidate {
    /// Description that they belong to.
    pub model: StoredModel,
    /// The parameters.
    pub parameters: Vec<IdentifiedParameter>,
}

/// RMSD of one candidate on one run.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossVerification {
    /// Place of the candidate among those given.
    pub candidate: usize,
    /// The run.
    pub run_id: i64,
    /// By joint and stage, over all cycles of the run together.
    pub rmsd: Vec<TorqueRmsd>,
    /// The same for each cycle.
    pub by_cycle: Vec<(u32, Vec<TorqueRmsd>)>,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum StoredError {
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The numbers cannot be had.
    #[error(transparent)]
    Numerics(#[from] NumericsError),
    /// What was asked for does not go together, or is not there.
    #[error("{0}")]
    Refused(String),
    /// A task of the program itself panicked.
    #[error("internal error: {0}")]
    Task(#[from] JoinError),
}

/// Identifies one parameter set on the chosen cycles, joints stacked, moving rows of their
/// excitation stages.
///
/// # Errors
/// [`StoredError::Refused`] if a run has no factors, a cycle that is asked for is not among them, or
/// the cycles belong to different descriptions; [`StoredError::Numerics`] if the motion is too poor.
pub async fn unit_identification(store: &Store, chosen: &[Chosen]) -> Result<ParameterSet, StoredError> {
    let mut union: Option<(StoredCycle, Union)> = None;
    let mut sources = Vec::new();
    for of_run in merged(chosen) {
        for cycle in chosen_cycles(store, &of_run, FactorsWanted::Identification).await? {
            let columns = JointColumns::of_stored(&cycle.factors.columns);
            let (first, union) = union.get_or_insert_with(|| (cycle.clone(), Union::new(columns.clone())));
            same_model(&first.model, first.run_id, &cycle)?;
            union.add(&columns, &unpack(&cycle.factors)?, &independent_shares(&cycle))?;
            sources.push(SourceCycle { run_id: cycle.run_id, cycle: cycle.cycle, robot: cycle.robot });
        }
    }
    let Some((first, union)) = union else {
        return Err(StoredError::Refused("no cycles are chosen".into()));
    };
    let identification = tokio::task::spawn_blocking(move || union.identify()).await??;
    Ok(ParameterSet { model: first.model, identification, sources })
}

/// RMSD of one parameter set over the chosen cycles together, by joint and stage.
///
/// # Errors
/// As [`unit_identification`].
pub async fn rmsd_on(
    store: &Store,
    candidate: &Candidate,
    chosen: &[Chosen],
) -> Result<Vec<TorqueRmsd>, StoredError> {
    let mut sums = StageSums::default();
    for of_run in merged(chosen) {
        for cycle in chosen_cycles(store, &of_run, FactorsWanted::All).await? {
            same_model(&candidate.model, of_run.run_id, &cycle)?;
            let columns = JointColumns::of_stored(&cycle.factors.columns);
            sums.add(&columns, &unpack(&cycle.factors)?, &theta(&columns, candidate)?);
        }
    }
    Ok(sums.rmsd())
}

/// Applies each candidate to each run. Runs are read one after another: memory does not grow with
/// their number.
///
/// # Errors
/// As [`unit_identification`].
pub async fn cross_verification(
    store: &Store,
    candidates: Vec<Candidate>,
    runs: &[i64],
) -> Result<Vec<CrossVerification>, StoredError> {
    let candidates = Arc::new(candidates);
    let mut verified = Vec::new();
    for &run_id in runs {
        let of_run = Chosen { run_id, cycles: None };
        let cycles = chosen_cycles(store, &of_run, FactorsWanted::All).await?;
        let candidates = Arc::clone(&candidates);
        let of_run = tokio::task::spawn_blocking(move || verify_run(&candidates, run_id, &cycles)).await??;
        verified.extend(of_run);
    }
    Ok(verified)
}

fn verify_run(
    candidates: &[Candidate],
    run_id: i64,
    cycles: &[StoredCycle],
) -> Result<Vec<CrossVerification>, StoredError> {
    let empty = |candidate| CrossVerification { candidate, run_id, rmsd: Vec::new(), by_cycle: Vec::new() };
    let mut verified: Vec<CrossVerification> = (0..candidates.len()).map(empty).collect();
    let mut sums = vec![StageSums::default(); candidates.len()];
    for cycle in cycles {
        let columns = JointColumns::of_stored(&cycle.factors.columns);
        let factors = unpack(&cycle.factors)?;
        for ((candidate, verified), sums) in candidates.iter().zip(&mut verified).zip(&mut sums) {
            same_model(&candidate.model, run_id, cycle)?;
            let theta = theta(&columns, candidate)?;
            sums.add(&columns, &factors, &theta);
            verified.by_cycle.push((cycle.cycle, torque_rmsd(&columns, &factors, &theta)));
        }
    }
    for (verified, sums) in verified.iter_mut().zip(sums) {
        verified.rmsd = sums.rmsd();
    }
    Ok(verified)
}

/// One entry a run; a cycle that is chosen twice counts once.
fn merged(chosen: &[Chosen]) -> Vec<Chosen> {
    let mut by_run: BTreeMap<i64, Option<Vec<u32>>> = BTreeMap::new();
    for Chosen { run_id, cycles } in chosen {
        let known = by_run.entry(*run_id).or_insert_with(|| Some(Vec::new()));
        *known = known.take().zip(cycles.clone()).map(|(known, more)| [known, more].concat());
    }
    by_run.into_iter().map(|(run_id, cycles)| Chosen { run_id, cycles }).collect()
}

async fn chosen_cycles(
    store: &Store,
    chosen: &Chosen,
    wanted: FactorsWanted,
) -> Result<Vec<StoredCycle>, StoredError> {
    let run_id = chosen.run_id;
    let mut cycles = store.factors_of_run(run_id, wanted).await?;
    if cycles.is_empty() {
        return Err(StoredError::Refused(format!(
            "run {run_id} has no factors: it is unknown or quarantined, or was stored by an older program; \
             `SELECT run_id, robot, started_at, status FROM runs` lists the runs"
        )));
    }
    if let Some(numbers) = &chosen.cycles {
        if let Some(missing) = numbers.iter().find(|n| cycles.iter().all(|cycle| cycle.cycle != **n)) {
            return Err(StoredError::Refused(format!("run {run_id} has no cycle {missing} with factors")));
        }
        cycles.retain(|cycle| numbers.contains(&cycle.cycle));
    }
    Ok(cycles)
}

fn same_model(model: &StoredModel, of: i64, cycle: &StoredCycle) -> Result<(), StoredError> {
    if *model == cycle.model {
        return Ok(());
    }
    let shown = |model: &StoredModel| {
        let hash: String = model.description_hash.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
        format!("{} ({hash})", model.name)
    };
    let (ours, theirs) = (shown(model), shown(&cycle.model));
    Err(StoredError::Refused(format!(
        "run {} was analysed with the description {theirs}, run {of} or the parameters with {ours}: base \
         parameters of different descriptions mean different things; choose runs of one description",
        cycle.run_id
    )))
}

fn theta(columns: &JointColumns, candidate: &Candidate) -> Result<Vec<f64>, NumericsError> {
    columns.theta(candidate.parameters.iter().map(|parameter| (parameter.id, parameter.value)))
}

/// As stored; of cycles without, what the low-pass leaves.
fn independent_shares(cycle: &StoredCycle) -> Vec<f64> {
    match cycle.independent_shares.is_empty() {
        true => vec![independent_fraction(cycle.cutoff, cycle.sample_rate); cycle.factors.columns.len()],
        false => cycle.independent_shares.clone(),
    }
}
