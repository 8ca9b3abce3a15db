//! Payload of an arm, from stored factors of a test without and one with it: no export is read.

use serde::Serialize;
use utoipa::ToSchema;

use super::chosen_cycles::{RunCycles, StoredError, in_ranges};
use super::drive_gain::{LoadedCycles, read_both};
use armwatch_config::Config;
use armwatch_method::NumericsError;
use armwatch_method::pooled::payload::{Interval, Payload, payload};
use armwatch_model::run::{RunKind, RunStatus};
use armwatch_store::{RunRow, Store};

/// Payload of an arm: the load that one run has and another lacks
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RunPayload {
    /// The robot
    pub robot: String,
    /// Run without the load
    pub empty_run_id: i64,
    /// Run with the load
    pub loaded_run_id: i64,
    /// Cycles of these runs
    pub cycles: [usize; 2],
    /// Largest relative error of a gain that the intervals contain
    pub gain_uncertainty: f64,
    /// Largest relative error of a gain in the configuration; smaller than `gain_uncertainty` if the joints contradict it
    pub stated_gain_uncertainty: f64,
    /// Mass, centre of mass in the tool frame, and inertia about the centre in its axes
    pub quantities: Vec<PayloadQuantity>,
}

/// A quantity of a payload with its 95 % interval
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PayloadQuantity {
    /// Name with its unit
    pub quantity: &'static str,
    /// Best value; null if the motion does not show it
    pub value: Option<f64>,
    /// Lower end of the interval
    pub interval_low: Option<f64>,
    /// Upper end of the interval
    pub interval_high: Option<f64>,
}

impl RunPayload {
    /// Returns true if the motion shows the mass.
    pub fn has_mass(&self) -> bool {
        self.quantities.first().is_some_and(|mass| mass.value.is_some())
    }

    /// Names of the quantities that the motion does not show.
    pub fn unseen(&self) -> Vec<&'static str> {
        self.quantities.iter().filter(|of| of.value.is_none()).map(|of| of.quantity).collect()
    }
}

/// Difference of the payloads in the runs `loaded` and `empty`. A run is named by its number or by its export.
///
/// # Errors
/// [`StoredError::Refused`] if a name is not that of a usable test, the runs belong to different robots or to another
/// description, or the joints do not move in the excitation of both.
pub async fn payload_of_runs(
    config: &Config,
    store: &Store,
    empty: &str,
    loaded: &str,
) -> Result<RunPayload, StoredError> {
    let runs = store.runs().await?;
    let (empty, loaded) = (named_test(&runs, empty)?, named_test(&runs, loaded)?);
    let refused = |sentence: String| Err(StoredError::Refused(sentence));
    if empty.run_id == loaded.run_id {
        return refused(format!("run {} cannot be both without and with the load", empty.run_id));
    }
    if empty.robot != loaded.robot {
        return refused(format!(
            "run {} is of robot {}, run {} of {}: compare two tests of one robot",
            empty.run_id, empty.robot, loaded.run_id, loaded.robot
        ));
    }
    let Some(entry) = config.robot_entry(&empty.robot) else {
        return refused(format!("the configuration has no [[robot]] for {}", empty.robot));
    };
    let chosen = |run: &RunRow| [RunCycles { run_id: run.run_id, cycles: None, named: true }];
    let cycles = read_both(store, &entry.description, &chosen(empty), &chosen(loaded)).await?;
    let (robot, bound) = (entry.description.clone(), entry.gain_uncertainty);
    let found = tokio::task::spawn_blocking(move || {
        let LoadedCycles { base, columns, cycles } = LoadedCycles::of(&robot, &cycles)?;
        payload(&robot, &base, &columns, &cycles, bound)
    });
    match found.await? {
        Ok(found) => Ok(told(empty, loaded, bound, &found)),
        Err(NumericsError::TooShort { .. }) => refused(format!(
            "runs {} and {} do not move a joint in the excitation stage of both: record the same test, with excitation, \
             without and with the load",
            empty.run_id, loaded.run_id
        )),
        Err(error) => Err(error.into()),
    }
}

/// The test that takes part in conclusions and that `word` names.
fn named_test<'a>(runs: &'a [RunRow], word: &str) -> Result<&'a RunRow, StoredError> {
    let refused = |sentence: String| Err(StoredError::Refused(sentence));
    let is_used = |run: &&RunRow| matches!(run.status, RunStatus::Complete | RunStatus::Streaming);
    let by_number = word.parse::<i64>().ok().and_then(|id| runs.iter().find(|run| run.run_id == id));
    let by_name: Vec<&RunRow> = runs.iter().filter(|run| run.source_name == word).collect();
    let used: Vec<&RunRow> = by_name.iter().copied().filter(is_used).collect();
    let found = match (by_number, used.as_slice()) {
        (Some(found), _) => found,
        (None, [found]) => found,
        (None, [_, ..]) => {
            let numbers = in_ranges(used.iter().map(|run| run.run_id));
            return refused(format!("several runs have an export {word}: {numbers}; give the number of one"));
        }
        (None, []) => match by_name.last() {
            Some(found) => found,
            None => {
                let numbers = in_ranges(runs.iter().map(|run| run.run_id));
                return refused(format!(
                    "\"{word}\" is neither the number of a run nor the name of an export; runs known: {numbers}; `armwatch \
                     runs` lists them"
                ));
            }
        },
    };
    let run_id = found.run_id;
    match found.status {
        _ if found.kind == RunKind::Production => {
            refused(format!("run {run_id} is a production log: choose a test, which has an excitation stage"))
        }
        RunStatus::SetAside => refused(format!(
            "run {run_id} is set aside: choose another test, or include it again with `armwatch set-aside \
            {run_id} --undo` (`armwatch run-date` if its start is in doubt)"
        )),
        RunStatus::Superseded => refused(format!(
            "run {run_id} is superseded by a later version of its recording: choose that; `armwatch runs` lists it"
        )),
        RunStatus::Quarantined => refused(format!(
            "run {run_id} is in quarantine: {}; `armwatch quarantine explain` has the remedy",
            found.reason.as_deref().unwrap_or("its export could not be read")
        )),
        RunStatus::Complete | RunStatus::Streaming => Ok(found),
    }
}

fn told(empty: &RunRow, loaded: &RunRow, stated: f64, found: &Payload) -> RunPayload {
    const NAMES: [&str; 10] = [
        "mass_kg",
        "centre_x_m",
        "centre_y_m",
        "centre_z_m",
        "inertia_xx_kg_m2",
        "inertia_xy_kg_m2",
        "inertia_xz_kg_m2",
        "inertia_yy_kg_m2",
        "inertia_yz_kg_m2",
        "inertia_zz_kg_m2",
    ];
    let all = [found.mass].into_iter().chain(found.centre).chain(found.inertia);
    let quantity = |(name, of): (&&'static str, Interval)| {
        let shown = |value: f64| of.is_shown.then_some(value);
        PayloadQuantity {
            quantity: name,
            value: shown(of.value),
            interval_low: shown(of.low),
            interval_high: shown(of.high),
        }
    };
    RunPayload {
        robot: empty.robot.clone(),
        empty_run_id: empty.run_id,
        loaded_run_id: loaded.run_id,
        cycles: found.cycles,
        gain_uncertainty: found.gain_bound.max(stated),
        stated_gain_uncertainty: stated,
        quantities: NAMES.iter().zip(all).map(quantity).collect(),
    }
}
