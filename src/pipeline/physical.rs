//! Bodies of all links from stored factors: no export is read.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::stored::{Chosen, StoredError};
use crate::numerics::base::base_parameters;
use crate::numerics::cross::independent_fraction;
use crate::numerics::factors::{JointColumns, unpack};
use crate::numerics::physical_fit::{JointRows, PhysicalFit, physical_fit};
use crate::robot::Robot;
use crate::store::{FactorsWanted, SourceCycle, Store, StoredCycle, StoredModel};

/// Moving excitation rows of chosen cycles, joined joint by joint.
#[derive(Debug, Clone)]
pub struct JoinedCycles {
    /// Description that the rows belong to.
    pub model: StoredModel,
    /// The cycles.
    pub sources: Vec<SourceCycle>,
    rows: JointRows,
}

/// Joins the factors of the chosen cycles. A cycle that is chosen twice counts once.
///
/// # Errors
/// [`StoredError::Refused`] if a run has no factors, a cycle that is asked for is not among them, or
/// the cycles belong to different descriptions.
pub async fn join_cycles(store: &Store, chosen: &[Chosen]) -> Result<JoinedCycles, StoredError> {
    let mut by_run: BTreeMap<i64, Option<Vec<u32>>> = BTreeMap::new();
    for Chosen { run_id, cycles } in chosen {
        let known = by_run.entry(*run_id).or_insert_with(|| Some(Vec::new()));
        *known = known.take().zip(cycles.clone()).map(|(known, more)| [known, more].concat());
    }
    let mut joined: Option<JoinedCycles> = None;
    for (run_id, numbers) in by_run {
        let cycles = store.factors_of_run(run_id, FactorsWanted::Identification).await?;
        check_chosen(run_id, &cycles, numbers.as_deref())?;
        for cycle in cycles.into_iter().filter(|of| numbers.as_ref().is_none_or(|n| n.contains(&of.cycle))) {
            let columns = JointColumns::of_stored(&cycle.factors.columns);
            let joined = joined.get_or_insert_with(|| JoinedCycles {
                model: cycle.model.clone(),
                sources: Vec::new(),
                rows: JointRows::new(columns.clone()),
            });
            if joined.model != cycle.model {
                return Err(StoredError::Refused(format!(
                    "run {run_id} was analysed with another description than the runs before it: base \
                     parameters of different descriptions mean different things; choose runs of one description"
                )));
            }
            let fraction = independent_fraction(cycle.cutoff, cycle.sample_rate);
            joined.rows.add(&columns, &unpack(&cycle.factors)?, fraction)?;
            joined.sources.push(SourceCycle { run_id, cycle: cycle.cycle, robot: cycle.robot });
        }
    }
    joined.ok_or_else(|| StoredError::Refused("no cycles are chosen".into()))
}

/// Fits physically consistent parameters of all links to joined cycles.
///
/// # Errors
/// [`StoredError::Refused`] if `robot` is not the description of the cycles; [`StoredError::Numerics`]
/// if the motion is too poor.
pub async fn fit_bodies(joined: &JoinedCycles, robot: Arc<Robot>) -> Result<PhysicalFit, StoredError> {
    if !joined.model.describes(&robot) {
        return Err(StoredError::Refused(format!(
            "the description {} is not the one that the cycles were analysed with ({}): geometry, gravity, \
             friction columns or couplings differ; give that one with --description",
            robot.model, joined.model.name
        )));
    }
    let rows = joined.rows.clone();
    let fit = tokio::task::spawn_blocking(move || {
        let base = base_parameters(&robot)?;
        physical_fit(&robot, &base, &rows.over(&base)?, rows.independent_fraction())
    });
    Ok(fit.await??)
}

fn check_chosen(run_id: i64, cycles: &[StoredCycle], numbers: Option<&[u32]>) -> Result<(), StoredError> {
    if cycles.is_empty() {
        return Err(StoredError::Refused(format!(
            "run {run_id} has no factors: it is unknown or quarantined, or was stored by an older program; \
             `SELECT run_id, robot, started_at, status FROM runs` lists the runs"
        )));
    }
    let missing = numbers.unwrap_or_default().iter().find(|n| cycles.iter().all(|of| of.cycle != **n));
    match missing {
        Some(missing) => {
            Err(StoredError::Refused(format!("run {run_id} has no cycle {missing} with factors")))
        }
        None => Ok(()),
    }
}
