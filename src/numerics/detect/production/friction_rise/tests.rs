//! Friction that rises in ordinary work, on histories made by hand.

use crate::anomaly::{AnomalyKind, Severity};
use crate::numerics::detect::production::detect_production;
use crate::numerics::detect::production::fixtures::{USUAL, history, wobble};

#[test]
fn a_joint_that_wears_between_tests_is_named_and_the_next_test_takes_it_in() {
    let wear = |i: usize, j: usize| if j == 2 && (15..20).contains(&i) { 0.25 } else { 0.0 };
    let found = detect_production(&history(40, |i, j| (wear(i, j) + wobble(i, j), USUAL)));
    let [anomaly] = &found[..] else { panic!("one anomaly: {found:?}") };
    assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Drift, "production_friction"));
    assert_eq!((anomaly.joint.expect("one").number(), anomaly.severity), (3, Severity::Warning));
    // four tenths of a quarter are within the limit after the first log, two thirds are not after the second
    assert_eq!((anomaly.first_run_id, anomaly.last_run_id, anomaly.ended), (17, 20, true));
    assert!(anomaly.message.starts_with("joint 3: in ordinary work friction is"), "{}", anomaly.message);
}

#[test]
fn with_too_few_joints_to_tell_warmth_friction_counts_as_it_is() {
    let mut logs = history(10, |i, j| (if i >= 6 { 0.5 } else { wobble(i, j) }, USUAL));
    assert_eq!(detect_production(&logs), vec![], "all joints alike: the arm is cold");
    logs.iter_mut().for_each(|log| log.joints.truncate(1));
    assert_eq!(detect_production(&logs).len(), 1);
}
