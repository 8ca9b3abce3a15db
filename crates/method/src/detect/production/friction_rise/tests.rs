//! Friction that rises in production, on synthetic histories.

use crate::detect::production::fixtures::{USUAL, detected, history, wobble};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, ProductionSummary, Severity};

#[test]
fn a_joint_that_wears_between_tests_is_named_and_the_next_test_takes_it_in() {
    let wear = |i: usize, j: usize| if j == 2 && (15..20).contains(&i) { 0.25 } else { 0.0 };
    let found = detected(&history(40, |i, j| (wear(i, j) + wobble(i, j), USUAL)));
    let [anomaly] = &found[..] else { panic!("one anomaly: {found:?}") };
    assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Drift, Quantity::ProductionFriction));
    assert_eq!((anomaly.joint.expect("one").number(), anomaly.severity), (3, Severity::Warning));
    // 0.4 × 0.25 is within the limit after the first log; 0.64 × 0.25 is not after the second
    assert_eq!((anomaly.first_run_id, anomaly.last_run_id, anomaly.ended), (17, 20, true));
    assert!(anomaly.message.starts_with("joint 3: in production friction is"), "{}", anomaly.message);
}

#[test]
fn with_too_few_joints_to_tell_warmth_friction_counts_as_it_is() {
    let mut logs = history(10, |i, j| (if i >= 6 { 0.5 } else { wobble(i, j) }, USUAL));
    assert_eq!(detected(&logs), vec![], "all joints alike: the arm is cold");
    logs.iter_mut().for_each(|log| log.joints.truncate(1));
    assert_eq!(detected(&logs).len(), 1);
}

/// Logs after `tests` tests, ten logs each. The level of a joint's logs differs from test to test with the standard
/// deviation `spread`; `wear` is by test and joint, counted from 0.
fn tested(tests: usize, spread: f64, wear: impl Fn(usize, usize) -> f64) -> Vec<ProductionSummary> {
    // the sum of twelve uniform draws is nearly normal
    let draw = |test: usize, joint: usize| {
        let mut state = (test * 7919 + joint * 104_729 + 17) as u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| next()).sum::<f64>() - 6.0
    };
    history(10 * tests, |i, j| (spread * draw(i / 10, j) + wear(i / 10, j) + wobble(i, j), USUAL))
}

#[test]
fn wear_that_is_there_in_the_first_logs_after_a_test_is_not_learnt() {
    let worn = |test: usize, joint: usize| if test == 6 && joint == 2 { 0.4 } else { 0.0 };
    let found = detected(&tested(8, 0.02, worn));
    let [anomaly] = &found[..] else { panic!("one anomaly: {found:#?}") };
    assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Drift, Quantity::ProductionFriction));
    assert_eq!(anomaly.joint.expect("one").number(), 3);
    assert!((61..=63).contains(&anomaly.first_run_id), "{anomaly:#?}");
    assert!(anomaly.ended && anomaly.last_run_id == 70, "the next test takes it in: {anomaly:#?}");
    assert!(anomaly.message.contains("after earlier tests"), "{}", anomaly.message);
}

#[test]
fn before_there_are_three_tests_their_logs_are_learnt_as_they_are() {
    let worn = |test: usize, joint: usize| if test == 2 && joint == 2 { 0.4 } else { 0.0 };
    assert_eq!(detected(&tested(3, 0.02, worn)), vec![]);
}

#[test]
fn tests_that_know_friction_to_five_percent_are_no_wear() {
    assert_eq!(detected(&tested(120, 0.05, |_, _| 0.0)), vec![]);
}
