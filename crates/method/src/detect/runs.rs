//! Anomalies and health of a robot's joints, from the history of its tests.
//!
//! Pure functions over the summaries of all complete runs, oldest first. The whole history is evaluated again each
//! time. So a run that arrives late takes its place in time, and the same history always gives the same anomalies.
//! Every joint is compared with its own baseline: two healthy arms of one model differ by half in friction.

mod history;
mod curve;
mod arm;
mod series;
mod joint_detectors;
mod arm_detectors;
pub mod judgement;
mod parts;
mod joined;
mod without_result;
mod health;
mod next_test;
mod other_unit;
mod after_work;
pub mod calibration;
pub mod open_run;
pub mod window;

use self::after_work::extend_persisting;
use self::arm_detectors::arm_change::arm_changes;
use self::arm_detectors::common_change::common_changes;
use self::arm_detectors::contact::contacts;
use self::health::health;
use self::joined::{coupled_swing, warm_up_of_arm};
use self::joint_detectors::JOINT_DETECTORS;
use self::joint_detectors::warm_up::of_common_warm_up;
use self::judgement::{Judged, Kept};
use self::next_test::expected_by;
use self::other_unit::{Separated, separated};
use self::parts::{Parts, grouped};
use self::series::JointSeries;
use self::without_result::without_result;
use super::episodes::anomalies;
use armwatch_model::anomaly::peer::Peer;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Findings, Knowledge, RunSummary};
use armwatch_model::robot::JointIndex;

/// [`detect_among`] for the only robot of its model.
#[must_use]
pub fn detect(history: &[RunSummary], settings: &DetectSettings) -> Findings {
    detect_among(history, &[], settings)
}

/// Detects anomalies in the complete runs of one robot, oldest first, whose cycles were all read. `peers` are the other
/// robots of its model. Runs of two epochs of a joint are not compared ([`armwatch_model::anomaly::epoch`]): each epoch
/// has its own baseline, and anomalies of an earlier one have ended.
#[must_use]
pub fn detect_among(history: &[RunSummary], peers: &[Peer], settings: &DetectSettings) -> Findings {
    concluded(history, peers, settings, None).0
}

/// [`detect_among`] with the findings of earlier conclusions in the cycles of tests. The findings are the same. A test
/// is evaluated again only if `kept` has no valid judgement of it.
#[must_use]
pub fn detect_with(
    history: &[RunSummary],
    peers: &[Peer],
    settings: &DetectSettings,
    kept: &Kept,
) -> (Findings, Judged) {
    concluded(history, peers, settings, Some(kept))
}

fn concluded(
    history: &[RunSummary],
    peers: &[Peer],
    settings: &DetectSettings,
    kept: Option<&Kept>,
) -> (Findings, Judged) {
    let separated = separated(history, settings);
    let history = separated.as_ref().map_or(history, |of| &of.history);
    let mut parts = Parts::new(history, settings, kept);
    let mut found = findings(&mut parts, peers);
    let judged = parts.judged;
    if let Some(Separated { anomalies, tests_of_latest, .. }) = separated {
        found.anomalies.extend(anomalies);
        let needed = settings.baseline_runs.max(1);
        if let Some(tests) = tests_of_latest.filter(|tests| *tests < needed) {
            for of in found.health.iter_mut().filter(|of| of.knowledge == Knowledge::Compared) {
                of.knowledge = Knowledge::Learning;
                of.reason = Some(format!("{tests} of {needed} tests of the baseline"));
            }
        }
    }
    (found, judged)
}

fn findings(parts: &mut Parts<'_>, peers: &[Peer]) -> Findings {
    let Parts { history, settings, joints, .. } = *parts;
    let mut findings = Findings::default();
    let Some(latest) = history.last() else { return findings };
    let by_joint =
        |joint: JointIndex| grouped(history, |run| run.epochs.get(joint.index()).copied().unwrap_or(0));
    let of_joints: Vec<Vec<Vec<usize>>> = (0..joints).map(JointIndex::new).map(by_joint).collect();
    let of_arm = grouped(history, |run| run.epochs.clone());
    of_joints.iter().flatten().chain(&of_arm).for_each(|places| parts.add(places));
    let contacts_of = |places: &Vec<usize>| {
        let part = parts.of(places);
        part.map_or_else(Vec::new, |of| contacts(&of.runs, &of.causes, &of.moments, settings))
    };
    let of_contacts: Vec<Vec<Anomaly>> = of_arm.iter().map(contacts_of).collect();
    let is_of_contact = |of: &Anomaly| of_contacts.iter().flatten().any(|contact| explains(contact, of));
    for (joint, of_joint) in (0..joints).map(JointIndex::new).zip(&of_joints) {
        for (ordinal, places) in of_joint.iter().enumerate() {
            let is_latest = places.last().is_some_and(|place| place + 1 == history.len());
            let Some(part) = parts.of(places) else { continue };
            let (friction, causes) = (&part.friction[joint.index()], &part.causes[joint.index()]);
            let series = JointSeries::new(&part.runs, joint, friction, causes, &part.faults, settings)
                .beside(&part.common_causes, &part.common_warm_up)
                .among(peers);
            let mut found = anomalies(JOINT_DETECTORS, &series, joint, &part.moments);
            found.retain(|of| !is_of_contact(of));
            if is_latest {
                findings.health.push(health(&part.runs, &series, &found));
            } else {
                let before: Vec<&RunSummary> = places.iter().map(|place| &history[*place]).collect();
                let after = learning_after(parts, of_joint, ordinal, joint);
                extend_persisting(&mut found, joint, &before, &after, settings);
                found.iter_mut().for_each(|anomaly| anomaly.ended = anomaly.last_run_id != latest.run_id);
            }
            findings.anomalies.extend(found);
        }
    }
    for (places, of_contacts) in of_arm.iter().zip(&of_contacts) {
        let Some(part) = parts.of(places) else { continue };
        let mut found = arm_changes(&part.arm, &part.faults, joints, &part.moments);
        found.retain(|of| !is_of_contact(of));
        found.extend(common_changes(&part.friction, &part.faults, &part.moments));
        found.extend(of_common_warm_up(&part.common_warm_up, &part.moments));
        found.extend(of_contacts.iter().cloned());
        if part.runs.last().is_some_and(|run| run.run_id != latest.run_id) {
            found.iter_mut().for_each(|anomaly| anomaly.ended = true);
        }
        findings.anomalies.extend(found);
        findings.anomalies = warm_up_of_arm::joined(findings.anomalies, part);
    }
    findings.anomalies = coupled_swing::joined(findings.anomalies, history, joints);
    findings.anomalies.extend(without_result(history));
    findings.expected_by = expected_by(history, settings.overdue_factor);
    findings
}

/// Tests of the epoch after the one at `ordinal`, if it is the joint's latest and its baseline is not complete.
fn learning_after<'h>(
    parts: &Parts<'h>,
    of_joint: &[Vec<usize>],
    ordinal: usize,
    joint: JointIndex,
) -> Vec<&'h RunSummary> {
    let is_learning = |places: &&Vec<usize>| {
        let is_latest = places.last().is_some_and(|place| place + 1 == parts.history.len());
        is_latest && parts.of(places).is_some_and(|part| part.friction[joint.index()].is_learning())
    };
    let after = of_joint.get(ordinal + 1).filter(is_learning);
    after.into_iter().flatten().map(|place| &parts.history[*place]).collect()
}

/// Returns true if a contact explains an anomaly of one test alone: the torque of one cycle makes the RMSD swing, and
/// shifts the identified properties of a torque signal.
fn explains(contact: &Anomaly, anomaly: &Anomaly) -> bool {
    let is_of_test = anomaly.first_run_id == anomaly.last_run_id
        && [contact.first_run_id, contact.last_run_id].contains(&anomaly.first_run_id);
    let is_of_joint = contact.joint.is_none() || contact.joint == anomaly.joint;
    matches!(anomaly.kind, AnomalyKind::Oscillation | AnomalyKind::Sensor) && is_of_test && is_of_joint
}

#[cfg(test)]
mod arm_cause_tests;
#[cfg(test)]
mod cause_tests;
#[cfg(test)]
mod fixtures;
#[cfg(test)]
mod kept_tests;
#[cfg(test)]
mod tests;
