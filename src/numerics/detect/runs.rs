//! Anomalies and health of a robot's joints, from the history of its tests.
//!
//! Pure functions over the summaries of all complete runs, oldest first. The whole history is
//! judged anew each time, so a run that arrives late falls into its place, and the same history
//! always gives the same anomalies. Every joint is compared with its own baseline: two arms of one
//! model differ by half in friction when both are healthy.

mod friction_history;
mod curve;
mod like_length;
mod arm;
mod series;
mod common_change;
mod friction_change;
mod forecast;
mod level_limit;
mod steady_rise;
mod friction_drift;
mod friction_step;
mod friction_swing;
mod warm_up;
mod arm_change;
mod contact;
mod coupled_swing;
mod oscillation;
mod accuracy;
mod unlike_peers;
mod without_result;
mod health;
mod next_test;
pub mod calibration;
pub mod open_run;

use jiff::Timestamp;

use self::accuracy::Accuracy;
use self::arm::{ArmEvidence, arm_evidence, least_advantage as least_advantage_of_arm};
use self::arm_change::arm_changes;
use self::common_change::{common_changes, common_parts};
use self::contact::contacts;
use self::coupled_swing::joined;
use self::curve::causes::causes;
use self::curve::run_cause::{RunCause, least_advantage};
use self::friction_drift::FrictionDrift;
use self::friction_history::FrictionHistory;
use self::friction_step::FrictionStep;
use self::friction_swing::FrictionSwing;
use self::health::health;
use self::next_test::expected_by;
use self::oscillation::Oscillation;
use self::series::{JointSeries, RunDetector, friction_history};
use self::unlike_peers::UnlikePeers;
use self::warm_up::WarmUp;
use self::without_result::without_result;
use super::episodes::anomalies;
use super::verdict::DetectSettings;
use crate::anomaly::peer::Peer;
use crate::anomaly::{Findings, RunSummary};
use crate::robot::JointIndex;

/// All detectors of a joint. Anomalies of a joint are found in this order.
const DETECTORS: &[&RunDetector] = &[
    &FrictionStep,
    &FrictionDrift,
    &FrictionSwing,
    &WarmUp,
    &Oscillation,
    &Accuracy,
    &UnlikePeers::Friction,
    &UnlikePeers::Accuracy,
];

/// [`detect_among`] for a robot of whose model there is no other.
#[must_use]
pub fn detect(history: &[RunSummary], settings: &DetectSettings) -> Findings {
    detect_among(history, &[], settings)
}

/// Looks at the complete runs of one robot, oldest first. `peers` are the other robots of its model. Runs of two epochs of a joint are not compared
/// ([`crate::anomaly::epoch`]): each epoch has its own baseline, and anomalies of an earlier one have ended.
#[must_use]
pub fn detect_among(history: &[RunSummary], peers: &[Peer], settings: &DetectSettings) -> Findings {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let mut findings = Findings::default();
    let Some(latest) = history.last() else { return findings };
    let mut parts: Vec<Part> = Vec::new();
    for joint in (0..joints).map(JointIndex::new) {
        let epoch = |run: &RunSummary| run.epochs.get(joint.index()).copied().unwrap_or(0);
        for places in grouped(history, epoch) {
            let is_latest = places.last().is_some_and(|place| place + 1 == history.len());
            let part = part(&mut parts, history, places, joints, settings);
            let (friction, causes) = (&part.friction[joint.index()], &part.causes[joint.index()]);
            let series =
                JointSeries::new(&part.runs, joint, friction, causes, &part.arm, settings).among(peers);
            let mut found = anomalies(DETECTORS, &series, joint, &part.moments);
            if is_latest {
                findings.health.push(health(&part.runs, &series, &found));
            } else {
                found.iter_mut().for_each(|anomaly| anomaly.ended = true);
            }
            findings.anomalies.extend(found);
        }
    }
    for places in grouped(history, |run| run.epochs.clone()) {
        let part = part(&mut parts, history, places, joints, settings);
        let mut found = arm_changes(&part.arm, joints, &part.moments);
        found.extend(common_changes(&part.friction, &part.arm, &part.moments));
        found.extend(contacts(&part.runs, &part.causes, &part.moments, settings));
        if part.runs.last().is_some_and(|run| run.run_id != latest.run_id) {
            found.iter_mut().for_each(|anomaly| anomaly.ended = true);
        }
        findings.anomalies.extend(found);
    }
    findings.anomalies = joined(findings.anomalies, history, joints);
    findings.anomalies.extend(without_result(history));
    findings.expected_by = expected_by(history, settings.overdue_factor);
    findings
}

/// Runs that are compared with each other.
struct Part {
    /// Their places in the history.
    places: Vec<usize>,
    runs: Vec<RunSummary>,
    /// Key and start of each.
    moments: Vec<(i64, Timestamp)>,
    arm: Vec<Option<ArmEvidence>>,
    /// By joint and run.
    causes: Vec<Vec<Option<RunCause>>>,
    /// By joint.
    friction: Vec<FrictionHistory>,
}

/// The part of these places; most joints have the same parts.
fn part<'p>(
    parts: &'p mut Vec<Part>,
    history: &[RunSummary],
    places: Vec<usize>,
    joints: usize,
    settings: &DetectSettings,
) -> &'p Part {
    let known = parts.iter().position(|part| part.places == places).unwrap_or_else(|| {
        let runs: Vec<RunSummary> = places.iter().map(|&place| history[place].clone()).collect();
        let needed = least_advantage(history, settings);
        let causes = causes(&runs, joints, settings.baseline_runs, needed);
        let of_joint = |(joint, causes): (usize, &Vec<Option<RunCause>>)| {
            friction_history(&runs, JointIndex::new(joint), causes, settings.baseline_runs)
        };
        let mut friction: Vec<FrictionHistory> = causes.iter().enumerate().map(of_joint).collect();
        let common = common_parts(&friction, runs.len());
        friction.iter_mut().zip(&common).for_each(|(history, common)| history.without_common(common));
        parts.push(Part {
            moments: runs.iter().map(|run| (run.run_id, run.started_at)).collect(),
            arm: arm_evidence(
                &runs,
                joints,
                settings.baseline_runs,
                least_advantage_of_arm(history, settings),
            ),
            causes,
            friction,
            places,
            runs,
        });
        parts.len() - 1
    });
    &parts[known]
}

/// Places of the runs with the same key, in the order of the keys' first runs.
fn grouped<K: PartialEq>(history: &[RunSummary], key: impl Fn(&RunSummary) -> K) -> Vec<Vec<usize>> {
    let mut groups: Vec<(K, Vec<usize>)> = Vec::new();
    for (place, run) in history.iter().enumerate() {
        let key = key(run);
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, places)) => places.push(place),
            None => groups.push((key, vec![place])),
        }
    }
    groups.into_iter().map(|(_, places)| places).collect()
}

#[cfg(test)]
mod cause_tests;
#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod tests;
