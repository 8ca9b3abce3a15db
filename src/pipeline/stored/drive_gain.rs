//! Drive gains from stored factors of recordings without and with a known load: no export is read.

use super::chosen_cycles::{
    ChosenCycles, RunCycles, StoredError, chosen_cycles, independent_shares, merged, told,
};
use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::pooled::drive_gain::{JointGain, RecordedCycle, drive_gains, load_change};
use armwatch_model::robot::{Robot, StandardParameters};
use armwatch_store::{FactorsWanted, Store, StoredCycle};

/// Drive gains of `robot` from runs `without` and `with` a load that is `load` about the frame of the last
/// link.
///
/// # Errors
/// [`StoredError::Refused`] if a run has no factors, lacks a cycle that is asked for, or was analysed with
/// another description than `robot`; [`StoredError::Numerics`] if the factors are over other columns.
pub async fn stored_drive_gains(
    store: &Store,
    robot: &Robot,
    without: &[RunCycles],
    with: &[RunCycles],
    load: StandardParameters,
) -> Result<Vec<JointGain>, StoredError> {
    let mut cycles = Vec::new();
    for (runs, loaded) in [(without, false), (with, true)] {
        for chosen in merged(runs) {
            cycles.extend(read(store, robot, &chosen).await?.into_iter().map(|cycle| (cycle, loaded)));
        }
    }
    let robot = robot.clone();
    tokio::task::spawn_blocking(move || gains(&robot, &cycles, &load)).await?.map_err(StoredError::from)
}

fn gains(
    robot: &Robot,
    cycles: &[(StoredCycle, bool)],
    load: &StandardParameters,
) -> Result<Vec<JointGain>, NumericsError> {
    let base = base_parameters(robot)?;
    let own = FactorColumns::new(robot, &base);
    let Some((first, _)) = cycles.first() else {
        return Err(NumericsError::TooShort { what: "the choice of cycles", rows: 0, needed: 2 });
    };
    let columns = FactorColumns::of_stored(&first.factors.columns);
    // stored columns stand in another order than the description's own
    let change = load_change(robot, &base, load);
    let change = columns.theta(base.kept.iter().copied().zip(change))?;
    let mut recorded = Vec::new();
    for (cycle, loaded) in cycles {
        if cycle.factors.columns != *own.by_joint() {
            return Err(NumericsError::ColumnsDiffer(format!(
                "run {} was factored over other parameters than the description has now; ingest its export again \
                 into a new database",
                cycle.run_id
            )));
        }
        recorded.push(RecordedCycle {
            loaded: *loaded,
            factors: unpack(&cycle.factors)?,
            independent_shares: independent_shares(cycle),
        });
    }
    drive_gains(&columns, &recorded, &change)
}

async fn read(store: &Store, robot: &Robot, chosen: &RunCycles) -> Result<Vec<StoredCycle>, StoredError> {
    let run_id = chosen.run_id;
    let ChosenCycles { cycles, passed_over, in_spite, .. } =
        chosen_cycles(store, chosen, FactorsWanted::Identification).await?;
    if cycles.is_empty() {
        return Err(StoredError::PassedOver(passed_over));
    }
    if !passed_over.is_empty() {
        tracing::warn!("passed over: {}", told(&passed_over));
    }
    if !in_spite.is_empty() {
        tracing::warn!("taken in spite of findings: {}", told(&in_spite));
    }
    match cycles.iter().find(|cycle| !cycle.model.describes(robot)) {
        Some(_) => Err(StoredError::Refused(format!(
            "run {run_id} was analysed with another description than {} has now: the load's place on the arm would \
             be a guess; give the configuration with which it was ingested (--config)",
            robot.model
        ))),
        None => Ok(cycles),
    }
}
