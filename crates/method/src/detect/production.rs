//! Anomalies of a robot's joints between its tests, from production logs.
//!
//! Pure functions over the summaries of all complete logs of a robot, oldest first. A joint is compared with its own
//! first logs after the reference test: motion unlike the test, or a load that the test did not carry, is present from
//! the first log and is no change. The first logs may be wrong themselves. So each log is also compared with the test's
//! own error, and the friction of the first logs with that of the logs after earlier tests.

mod causes;
mod series;
mod friction_rise;
mod load_change;
mod test_deviation;
mod torque_signal;
mod work_load;
pub mod window;

use jiff::Timestamp;

use self::causes::causes;
use self::friction_rise::FrictionRise;
use self::load_change::LoadChange;
use self::series::{JointLogs, ProductionDetector};
use self::test_deviation::TestDeviation;
use self::torque_signal::TorqueSignal;
use self::work_load::work_loads;
use super::episodes::anomalies;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, ProductionSummary};
use armwatch_model::robot::JointIndex;

/// All detectors of a joint. Anomalies of a joint are found in this order.
const DETECTORS: &[&ProductionDetector] = &[&FrictionRise, &LoadChange, &TestDeviation, &TorqueSignal];

/// Detects anomalies in the complete logs of one robot, oldest first.
#[must_use]
pub fn detect_production(history: &[ProductionSummary], settings: &DetectSettings) -> Vec<Anomaly> {
    let moments: Vec<(i64, Timestamp)> = history.iter().map(|log| (log.run_id, log.started_at)).collect();
    let joints = history.iter().flat_map(|log| &log.joints).map(|of| of.joint.index() + 1).max().unwrap_or(0);
    let causes = causes(history, settings);
    let of_joint =
        |joint| anomalies(DETECTORS, &JointLogs { history, causes: &causes, joint }, joint, &moments);
    let mut found: Vec<Anomaly> = (0..joints).map(JointIndex::new).flat_map(of_joint).collect();
    found.extend(work_loads(&causes, &moments));
    found
}

#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod tests;
