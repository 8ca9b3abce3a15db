//! Drive gains from stored factors of recordings without and with a known load: no export is read.

use super::chosen_cycles::{
    ChosenCycles, RunCycles, StoredError, chosen_cycles, independent_shares, merged, told,
};
use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::{FactorColumns, unpack};
use armwatch_method::model::base_parameters::{BaseParameters, base_parameters};
use armwatch_method::pooled::drive_gain::{JointGain, drive_gains};
use armwatch_method::pooled::loaded_rows::{RecordedCycle, load_change};
use armwatch_model::robot::{Robot, StandardParameters};
use armwatch_store::{FactorsWanted, Store, StoredCycle};

/// Drive gains of `robot` from runs `without` and `with` a load, whose parameters `load` refer to the frame of the last
/// link.
///
/// # Errors
/// [`StoredError::Refused`] if a run has no factors, lacks a requested cycle, or was analysed with another description
/// than `robot`; [`StoredError::Numerics`] if the factors have other columns.
pub async fn stored_drive_gains(
    store: &Store,
    robot: &Robot,
    without: &[RunCycles],
    with: &[RunCycles],
    load: StandardParameters,
) -> Result<Vec<JointGain>, StoredError> {
    let cycles = read_both(store, robot, without, with).await?;
    let robot = robot.clone();
    tokio::task::spawn_blocking(move || {
        let LoadedCycles { base, columns, cycles } = LoadedCycles::of(&robot, &cycles)?;
        // the stored columns have another order than the description's
        let change = load_change(&robot, &base, &load);
        let change = columns.theta(base.kept.iter().copied().zip(change))?;
        drive_gains(&columns, &cycles, &change)
    })
    .await?
    .map_err(StoredError::from)
}

/// Stored cycles without a load, and with one (true).
pub(super) async fn read_both(
    store: &Store,
    robot: &Robot,
    without: &[RunCycles],
    with: &[RunCycles],
) -> Result<Vec<(StoredCycle, bool)>, StoredError> {
    let mut cycles = Vec::new();
    for (runs, loaded) in [(without, false), (with, true)] {
        for chosen in merged(runs) {
            cycles.extend(read(store, robot, &chosen).await?.into_iter().map(|cycle| (cycle, loaded)));
        }
    }
    Ok(cycles)
}

/// Cycles without and with a load, in the columns of their description.
pub(super) struct LoadedCycles {
    pub(super) base: BaseParameters,
    pub(super) columns: FactorColumns,
    pub(super) cycles: Vec<RecordedCycle>,
}

impl LoadedCycles {
    pub(super) fn of(robot: &Robot, cycles: &[(StoredCycle, bool)]) -> Result<Self, NumericsError> {
        let base = base_parameters(robot)?;
        let own = FactorColumns::new(robot, &base);
        let Some((first, _)) = cycles.first() else {
            return Err(NumericsError::TooShort { what: "the choice of cycles", rows: 0, needed: 2 });
        };
        let columns = FactorColumns::of_stored(&first.factors.columns);
        let recorded = |(cycle, loaded): &(StoredCycle, bool)| {
            if cycle.factors.columns != *own.by_joint() {
                return Err(NumericsError::ColumnsDiffer(format!(
                    "run {} was stored with other parameters than the description has now; ingest its \
                    export again into a new database",
                    cycle.run_id
                )));
            }
            Ok(RecordedCycle {
                loaded: *loaded,
                factors: unpack(&cycle.factors)?,
                independent_shares: independent_shares(cycle),
            })
        };
        let cycles = cycles.iter().map(recorded).collect::<Result<_, _>>()?;
        Ok(Self { base, columns, cycles })
    }
}

async fn read(store: &Store, robot: &Robot, chosen: &RunCycles) -> Result<Vec<StoredCycle>, StoredError> {
    let run_id = chosen.run_id;
    let ChosenCycles { cycles, passed_over, in_spite, .. } =
        chosen_cycles(store, chosen, FactorsWanted::Identification).await?;
    if cycles.is_empty() {
        return Err(StoredError::PassedOver(passed_over));
    }
    if !passed_over.is_empty() {
        tracing::warn!("skipped: {}", told(&passed_over));
    }
    if !in_spite.is_empty() {
        tracing::warn!("used in spite of findings: {}", told(&in_spite));
    }
    match cycles.iter().find(|cycle| !cycle.model.describes(robot)) {
        Some(_) => Err(StoredError::Refused(format!(
            "run {run_id} was analysed with another description than {} has now: the place of the load on \
            the arm is unknown; give the configuration used for ingesting it (--config)",
            robot.model
        ))),
        None => Ok(cycles),
    }
}
