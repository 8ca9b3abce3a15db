//! All detectors of production together, on synthetic histories.

use super::fixtures::{USUAL, detected, history, wobble};
use super::*;
use armwatch_model::anomaly::{AnomalyKind, Severity};

#[test]
fn healthy_work_raises_nothing_however_warm_the_arm_is() {
    // the first log of each day is cold: a third more friction in all joints, with small differences
    let warmth = |i: usize, j: usize| if i.is_multiple_of(3) { 0.33 + 0.01 * j as f64 } else { 0.0 };
    let found = detected(&history(60, |i, j| (warmth(i, j) + wobble(i, j), USUAL)));
    assert_eq!(found, vec![]);
}

#[test]
fn a_short_history_and_one_odd_log_say_nothing() {
    assert_eq!(detected(&history(3, |i, _| (0.5 * i as f64, USUAL))), vec![]);
    let odd = |i: usize, j: usize| if i == 6 && j == 1 { 0.3 } else { wobble(i, j) };
    assert_eq!(detected(&history(10, |i, j| (odd(i, j), USUAL))), vec![]);
}

#[test]
fn cold_work_and_a_lasting_load_are_no_warning() {
    // half as much friction again in all joints, because of cold, is a sixth of the torque
    let cold = detected(&history(10, |i, j| (0.5 + wobble(i, j), USUAL)));
    assert_eq!(cold, vec![]);
    // a tool that the test did not carry is reported once, and friction is still checked
    let worn = |i: usize, j: usize| if j == 2 && i >= 6 { 0.4 } else { wobble(i, j) };
    let found = detected(&history(10, |i, j| (worn(i, j), if j == 2 { 0.4 } else { USUAL })));
    let kinds: Vec<_> =
        found.iter().map(|of| (of.joint.map(JointIndex::number), of.kind, of.severity)).collect();
    assert!(kinds.contains(&(Some(3), AnomalyKind::Accuracy, Severity::Info)), "{kinds:?}");
    assert!(kinds.iter().any(|of| (of.0, of.1) == (Some(3), AnomalyKind::Drift)), "{kinds:?}");
}

#[test]
fn no_two_detectors_give_the_same_anomaly() {
    // the store identifies an anomaly by kind and quantity, and by joint and first log
    let history = history(6, |_, _| (0.0, USUAL));
    let causes = vec![None; history.len()];
    let series = JointLogs { history: &history, causes: &causes, joint: JointIndex::new(0) };
    let mut named: Vec<_> = DETECTORS.iter().map(|of| (of.kind(), of.quantity(&series))).collect();
    named.sort_unstable();
    named.dedup();
    assert_eq!(named.len(), DETECTORS.len());
}
