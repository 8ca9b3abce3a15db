//! Tests without result, on synthetic histories.

use crate::detect::runs::detect;
use crate::detect::runs::fixtures::{CYCLES, JOINTS, healthy, indexed, refusal, refused};
use armwatch_model::analysis::refusal::Channel;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{AnomalyKind, Findings, Knowledge, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

fn found(history: &[RunSummary]) -> Findings {
    detect(history, &DetectSettings::default())
}

#[test]
fn a_stuck_channel_is_a_sensor_anomaly_and_nothing_is_known_of_any_joint() {
    let mut history = healthy(10);
    history.push(refused(10, vec![refusal("stuck_channel", Channel::Torque, Some(1), CYCLES)]));
    let found = found(&history);
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.kind, anomaly.quantity), (AnomalyKind::Sensor, Quantity::TorqueSignal));
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
    history.extend([refused(8, stuck()), refused(9, stuck()), indexed(10, Some(1.0))]);
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
        (AnomalyKind::Sensor, Quantity::PositionSignal, None)
    );
    assert!(anomaly.message.contains("(3 joints alike)"), "{}", anomaly.message);

    history[8] = refused(8, vec![refusal("negative_inertia", Channel::Model, Some(2), CYCLES)]);
    let model = &found(&history).anomalies[0];
    assert_eq!((model.kind, model.quantity), (AnomalyKind::Accuracy, Quantity::Model));
}
