//! Anomalies and health of a robot's joints, from the history of its tests.
//!
//! Pure functions over the summaries of all complete runs, oldest first. The whole history is
//! judged anew each time, so a run that arrives late falls into its place, and the same history
//! always gives the same anomalies. Every joint is compared with its own baseline: two arms of one
//! model differ by half in friction when both are healthy.

mod friction_history;
mod curve;
mod arm;
mod series;
mod friction_change;
mod friction_drift;
mod friction_step;
mod friction_swing;
mod warm_up;
mod arm_change;
mod oscillation;
mod accuracy;
mod without_result;
mod health;
mod next_test;

use jiff::Timestamp;

use self::accuracy::Accuracy;
use self::arm::arm_evidence;
use self::arm_change::arm_changes;
use self::curve::causes::causes;
use self::friction_drift::FrictionDrift;
use self::friction_step::FrictionStep;
use self::friction_swing::FrictionSwing;
use self::health::health;
use self::next_test::expected_by;
use self::oscillation::Oscillation;
use self::series::{JointSeries, RunDetector};
use self::warm_up::WarmUp;
use self::without_result::without_result;
use super::episodes::anomalies;
use super::verdict::DetectSettings;
use crate::anomaly::{Findings, RunSummary};
use crate::robot::JointIndex;

/// All detectors of a joint. Anomalies of a joint are found in this order.
const DETECTORS: &[&RunDetector] =
    &[&FrictionStep, &FrictionDrift, &FrictionSwing, &WarmUp, &Oscillation, &Accuracy];

/// Looks at the complete runs of one robot, oldest first.
#[must_use]
pub fn detect(history: &[RunSummary], settings: &DetectSettings) -> Findings {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let mut findings = Findings::default();
    let moments: Vec<(i64, Timestamp)> = history.iter().map(|run| (run.run_id, run.started_at)).collect();
    let arm = arm_evidence(history, joints, settings.baseline_runs);
    let causes = causes(history, joints, settings.baseline_runs);
    for (joint, causes) in (0..joints).map(JointIndex::new).zip(causes) {
        let series = JointSeries::new(history, joint, causes, &arm, settings);
        let found = anomalies(DETECTORS, &series, joint, &moments);
        findings.health.push(health(history, &series, &found));
        findings.anomalies.extend(found);
    }
    findings.anomalies.extend(arm_changes(&arm, joints, &moments));
    findings.anomalies.extend(without_result(history));
    findings.expected_by = expected_by(history, settings.overdue_factor);
    findings
}

#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod tests;
