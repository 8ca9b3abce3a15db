//! Detectors of production on histories made by hand.

use jiff::{SignedDuration, Timestamp};

use super::*;
use crate::analysis::{FrictionExcess, ProductionJoint};
use crate::anomaly::{AnomalyKind, ProductionSummary, Severity};
use crate::robot::JointIndex;

const JOINTS: usize = 4;

/// Relative RMSD that friction does not explain in healthy logs.
const USUAL: f64 = 0.02;

/// A log every eight hours, a test before every tenth.
fn log(index: usize, friction: [f64; JOINTS], unexplained: [f64; JOINTS]) -> ProductionSummary {
    let joint = |j: usize| {
        // the excess raises the deviation by as much as a third of the torque being friction gives
        let by_friction = friction[j] / 3.0;
        let square = unexplained[j].powi(2) + by_friction.powi(2);
        ProductionJoint {
            joint: JointIndex::new(j),
            windows: 60,
            relative_rmsd: square.sqrt(),
            friction: FrictionExcess { excess: friction[j], share: by_friction.powi(2) / square },
            test_relative_rmsd: Some(0.015),
        }
    };
    ProductionSummary {
        run_id: i64::try_from(index).expect("small") + 1,
        started_at: Timestamp::UNIX_EPOCH
            + SignedDuration::from_hours(8 * i64::try_from(index).expect("small")),
        reference_run_id: 1000 + i64::try_from(index / 10).expect("small"),
        joints: (0..JOINTS).map(joint).collect(),
    }
}

fn wobble(index: usize, joint: usize) -> f64 {
    0.02 * (((index * 37 + joint * 11) % 13) as f64 / 6.0 - 1.0)
}

fn history(logs: usize, of: impl Fn(usize, usize) -> (f64, f64)) -> Vec<ProductionSummary> {
    let each = |i: usize, part: &dyn Fn((f64, f64)) -> f64| std::array::from_fn(|j| part(of(i, j)));
    (0..logs).map(|i| log(i, each(i, &|of| of.0), each(i, &|of| of.1))).collect()
}

#[test]
fn healthy_work_raises_nothing_however_warm_the_arm_is() {
    // the first log of each day is cold: a third more friction in all joints, a little unlike each other
    let warmth = |i: usize, j: usize| if i.is_multiple_of(3) { 0.33 + 0.01 * j as f64 } else { 0.0 };
    let found = detect_production(&history(60, |i, j| (warmth(i, j) + wobble(i, j), USUAL)));
    assert_eq!(found, vec![]);
}

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
fn another_load_is_no_wear() {
    let load = |i: usize, j: usize| if i >= 16 && j < 3 { 0.12 } else { USUAL };
    let found =
        detect_production(&history(20, |i, j| (wobble(i, j) + if i >= 16 { 0.2 } else { 0.0 }, load(i, j))));
    let kinds: Vec<_> = found
        .iter()
        .map(|of| (of.joint.expect("one").number(), of.kind, of.severity, of.first_run_id))
        .collect();
    let payload = |joint| (joint, AnomalyKind::Payload, Severity::Info, 17);
    assert_eq!(kinds, [payload(1), payload(2), payload(3)]);
}

#[test]
fn a_short_history_and_one_odd_log_say_nothing() {
    assert_eq!(detect_production(&history(3, |i, _| (0.5 * i as f64, USUAL))), vec![]);
    let odd = |i: usize, j: usize| if i == 6 && j == 1 { 0.3 } else { wobble(i, j) };
    assert_eq!(detect_production(&history(10, |i, j| (odd(i, j), USUAL))), vec![]);
}

#[test]
fn with_too_few_joints_to_tell_warmth_friction_counts_as_it_is() {
    let mut logs = history(10, |i, j| (if i >= 6 { 0.5 } else { wobble(i, j) }, USUAL));
    assert_eq!(detect_production(&logs), vec![], "all joints alike: the arm is cold");
    logs.iter_mut().for_each(|log| log.joints.truncate(1));
    assert_eq!(detect_production(&logs).len(), 1);
}

#[test]
fn the_first_logs_after_a_test_are_held_against_the_test() {
    // joint 2 is off from the first log on: learning its level must not make that normal
    for (off, severity) in [(0.3, Severity::Info), (1.15, Severity::Warning)] {
        let logs = history(12, |i, j| (wobble(i, j), if j == 1 && i < 12 { off } else { USUAL }));
        let found = detect_production(&logs);
        let [anomaly] = &found[..] else { panic!("one anomaly: {found:?}") };
        assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Accuracy, "production_relative_rmsd"));
        assert_eq!(
            (anomaly.joint.map(JointIndex::number), anomaly.severity, anomaly.first_run_id),
            (Some(2), severity, 1)
        );
        assert!(anomaly.message.contains("the test itself leaves 1.5 %"), "{}", anomaly.message);
    }
    // a test that explains its own torque badly says less
    let mut poor = history(12, |i, j| (wobble(i, j), if j == 1 { 0.3 } else { USUAL }));
    poor.iter_mut().flat_map(|log| &mut log.joints).for_each(|of| of.test_relative_rmsd = Some(0.12));
    assert_eq!(detect_production(&poor), vec![]);
}

#[test]
fn cold_work_and_a_lasting_load_are_no_warning() {
    // half as much friction again in all joints, cold, is a sixth of the torque
    let cold = detect_production(&history(10, |i, j| (0.5 + wobble(i, j), USUAL)));
    assert_eq!(cold, vec![]);
    // a tool that the test did not carry is said once, and friction is watched all the same
    let worn = |i: usize, j: usize| if j == 2 && i >= 6 { 0.4 } else { wobble(i, j) };
    let found = detect_production(&history(10, |i, j| (worn(i, j), if j == 2 { 0.4 } else { USUAL })));
    let kinds: Vec<_> =
        found.iter().map(|of| (of.joint.map(JointIndex::number), of.kind, of.severity)).collect();
    assert!(kinds.contains(&(Some(3), AnomalyKind::Accuracy, Severity::Info)), "{kinds:?}");
    assert!(kinds.iter().any(|of| (of.0, of.1) == (Some(3), AnomalyKind::Drift)), "{kinds:?}");
}
