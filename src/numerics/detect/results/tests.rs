//! Tests without result, on histories made by hand.

use jiff::{SignedDuration, Timestamp};

use crate::analysis::refusal::{Channel, RefusalCause};
use crate::analysis::{Estimate, JointSummary};
use crate::anomaly::{AnomalyKind, Findings, Knowledge, RunRefusal, RunSummary, Severity};
use crate::numerics::detect::runs::detect;
use crate::numerics::detect::verdict::DetectSettings;
use crate::robot::JointIndex;

const JOINTS: usize = 3;
const CYCLES: u32 = 8;

fn hours(hours: i64) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(hours)
}

/// A daily test; `index` of all joints, `None` for one that says nothing.
fn test(day: i64, index: Option<f64>) -> RunSummary {
    let joint = |j: usize| JointSummary {
        joint: JointIndex::new(j),
        warm_friction: None,
        excitation_friction: None,
        friction_index: index.map(|value| Estimate { value, std_error: 0.004 }),
        relative_rmsd: index.map(|_| 0.03),
        rmsd_swing: None,
    };
    RunSummary {
        run_id: day + 1,
        started_at: hours(24 * day),
        cycles: CYCLES,
        refused_cycles: 0,
        refusals: vec![],
        joints: (0..JOINTS).map(joint).collect(),
    }
}

fn healthy(tests: i64) -> Vec<RunSummary> {
    (0..tests).map(|day| test(day, Some(1.0 + 0.002 * (day % 3) as f64))).collect()
}

fn refusal(finding: &str, channel: Channel, joint: Option<usize>, cycles: u32) -> RunRefusal {
    let joint = joint.map(JointIndex::new);
    let sentence = format!("the {channel} is wrong");
    RunRefusal {
        cause: RefusalCause { finding: finding.into(), channel, joint, sentence },
        first_cycle: 1,
        cycles,
    }
}

/// A test of which every cycle is refused.
fn refused(day: i64, refusals: Vec<RunRefusal>) -> RunSummary {
    RunSummary { refused_cycles: CYCLES, refusals, ..test(day, None) }
}

fn found(history: &[RunSummary]) -> Findings {
    detect(history, &DetectSettings::default())
}

#[test]
fn a_stuck_channel_is_a_sensor_anomaly_and_nothing_is_known_of_any_joint() {
    let mut history = healthy(10);
    history.push(refused(10, vec![refusal("stuck_channel", Channel::Torque, Some(1), CYCLES)]));
    let found = found(&history);
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Sensor, "torque_signal"));
    assert_eq!((anomaly.joint, anomaly.severity), (Some(JointIndex::new(1)), Severity::Warning));
    assert_eq!((anomaly.first_run_id, anomaly.first_cycle, anomaly.ended), (11, Some(1), false));
    assert_eq!(anomaly.message, "the test gave no result: the torque is wrong");
    for health in &found.health {
        assert_eq!(health.knowledge, Knowledge::NoResult);
        assert_eq!((health.friction_index, health.last_result_run_id), (None, Some(10)));
        assert_eq!(
            health.reason.as_deref(),
            Some(
                "the latest test gave no result: all 8 cycles were refused: the torque is wrong; known last: \
                 friction index 1.000 of 1970-01-10 00:00 UTC"
            )
        );
    }
}

#[test]
fn the_next_test_with_a_result_ends_it_and_the_same_fault_again_is_another() {
    let stuck = || vec![refusal("stuck_channel", Channel::Torque, Some(1), CYCLES)];
    let mut history = healthy(8);
    history.extend([refused(8, stuck()), refused(9, stuck()), test(10, Some(1.0))]);
    let first = found(&history);
    let [anomaly] = &first.anomalies[..] else { panic!("one anomaly: {:?}", first.anomalies) };
    assert_eq!((anomaly.first_run_id, anomaly.last_run_id, anomaly.ended), (9, 10, true));
    assert_eq!(first.health[0].knowledge, Knowledge::Compared);
    history.push(refused(11, stuck()));
    let firsts: Vec<i64> = found(&history).anomalies.iter().map(|of| of.first_run_id).collect();
    assert_eq!(firsts, [9, 12]);
}

#[test]
fn what_is_wrong_with_most_joints_alike_is_the_whole_arms() {
    let unit = |joint| refusal("position_unit", Channel::Position, Some(joint), CYCLES);
    let mut history = healthy(8);
    history.push(refused(8, (0..JOINTS).map(unit).collect()));
    let degrees = found(&history).anomalies;
    let [anomaly] = &degrees[..] else { panic!("one anomaly: {degrees:?}") };
    assert_eq!(
        (anomaly.kind, anomaly.quantity, anomaly.joint),
        (AnomalyKind::Sensor, "position_signal", None)
    );
    assert!(anomaly.message.contains("(3 joints alike)"), "{}", anomaly.message);

    history[8] = refused(8, vec![refusal("negative_inertia", Channel::Model, Some(2), CYCLES)]);
    let model = &found(&history).anomalies[0];
    assert_eq!((model.kind, model.quantity), (AnomalyKind::Accuracy, "model"));
}

#[test]
fn a_fault_of_a_few_cycles_is_told_and_judged_by_the_others() {
    let mut history = healthy(9);
    history[8].refused_cycles = 3;
    history[8].refusals = vec![refusal("spike", Channel::Torque, Some(1), 3)];
    let found = found(&history);
    assert_eq!(found.anomalies, vec![]);
    assert_eq!(found.health[0].knowledge, Knowledge::Compared);
    let reason = found.health[0].reason.as_deref().expect("a reason");
    assert_eq!(reason, "3 of 8 cycles of the latest test were refused: the torque is wrong");
}

#[test]
fn a_test_that_says_nothing_of_a_joint_leaves_it_unsettled_with_what_was_known() {
    let mut history = healthy(9);
    history[8].joints[1] = JointSummary { joint: JointIndex::new(1), ..test(8, None).joints[1] };
    let found = found(&history);
    assert_eq!(found.health[0].knowledge, Knowledge::Compared);
    let health = &found.health[1];
    assert_eq!(
        (health.knowledge, health.friction_index, health.last_result_run_id),
        (Knowledge::Unsettled, None, Some(8))
    );
    assert!(
        health
            .reason
            .as_deref()
            .expect("a reason")
            .contains("known last: friction index 1.002 of 1970-01-08")
    );
}

#[test]
fn one_test_far_off_is_neither_an_alarm_nor_well() {
    let mut history = healthy(9);
    history[8].joints[1].friction_index = Some(Estimate { value: 0.8, std_error: 0.008 });
    let odd = found(&history);
    assert_eq!(odd.anomalies, vec![]);
    assert_eq!((odd.health[1].knowledge, odd.health[1].friction_index), (Knowledge::Unsettled, Some(0.8)));
    let reason = odd.health[1].reason.as_deref().expect("a reason");
    assert!(reason.starts_with("one test 20 % below the joint's baseline"), "{reason}");
    // the next one is as ever
    history.push(test(9, Some(1.0)));
    assert_eq!(found(&history).health[1].knowledge, Knowledge::Compared);
}

#[test]
fn the_next_test_is_expected_by_the_usual_interval() {
    assert_eq!(found(&healthy(3)).expected_by, None, "too few to know");
    let mut history = healthy(10);
    assert_eq!(found(&history).expected_by, Some(hours(24 * (9 + 4))));
    // a fortnight's pause does not change what is usual
    history.push(RunSummary { started_at: hours(24 * 23), ..test(10, Some(1.0)) });
    assert_eq!(found(&history).expected_by, Some(hours(24 * (23 + 4))));
}
