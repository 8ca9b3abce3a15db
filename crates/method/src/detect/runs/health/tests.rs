//! Health of joints, on synthetic histories.

use crate::detect::runs::cause_tests::{State, fleet};
use crate::detect::runs::detect;
use crate::detect::runs::fixtures::{healthy, history, indexed, refusal, wobble};
use armwatch_model::analysis::refusal::Channel;
use armwatch_model::analysis::{Estimate, JointSummary, WarmFriction};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Findings, Knowledge, RunSummary};
use armwatch_model::robot::JointIndex;

fn found(history: &[RunSummary]) -> Findings {
    detect(history, &DetectSettings::default())
}

#[test]
fn a_short_history_is_learning() {
    let found = detect(&history(4, |i| 12.0 * (1.0 + 0.2 * i as f64)), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
    assert_eq!(found.health[2].knowledge, Knowledge::Learning);
    assert_eq!(found.health[2].reason.as_deref(), Some("4 of 5 tests of the baseline"));
    assert_eq!(found.health[2].friction_index, None);
}

#[test]
fn a_run_cut_short_is_not_compared() {
    let mut runs = history(12, |i| 12.0 * wobble(i));
    for cut in &mut runs[8..] {
        cut.joints[2].warm_friction =
            Some(WarmFriction { torque: 18.0, std_error: 0.1, minute: 8.0, speed_fraction: 0.6 });
    }
    let found = detect(&runs, &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
    let health = &found.health[2];
    assert_eq!((health.knowledge, health.friction_index), (Knowledge::Unsettled, None));
    let reason = health.reason.as_deref().expect("a reason");
    assert!(reason.contains("does not compare") && reason.contains("known last: friction index"), "{reason}");
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
    history[8].joints[1] = JointSummary { joint: JointIndex::new(1), ..indexed(8, None).joints[1] };
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
    // the next one is as usual
    history.push(indexed(9, Some(1.0)));
    assert_eq!(found(&history).health[1].knowledge, Knowledge::Compared);
}

#[test]
fn a_change_of_friction_that_hardly_is_there_is_not_told_in_per_cent() {
    // scatters by a quarter of its value
    let noisy = |run: usize| [1.0, 1.3, 0.8, 1.2, 0.7, 1.1, 1.25, 0.75, 0.95, 1.15, 0.85, 0.6][run];
    let mut history = healthy(12);
    for (run, summary) in history.iter_mut().enumerate() {
        summary.joints[1].friction_index = Some(Estimate { value: noisy(run), std_error: 0.2 });
    }
    let found = found(&history);
    let health = &found.health[1];
    assert_eq!((health.knowledge, health.friction_index), (Knowledge::Compared, None), "{:?}", health.reason);
    let reason = health.reason.as_deref().expect("a reason");
    assert!(reason.starts_with("friction is too small for a change in per cent: it scatters"), "{reason}");
    assert!(found.health[0].friction_index.is_some() && found.health[2].friction_index.is_some());
}

/// Measured friction has risen by a third, and the index has not: an effect of temperature, except if only one joint
/// has it.
#[test]
fn friction_that_one_joint_alone_has_from_temperature_is_not_settled() {
    let history = |warmer: &dyn Fn(usize) -> f64| {
        let mut history = fleet(9, 5, |_| State::default());
        for (run, of) in history.iter_mut().enumerate() {
            for (j, joint) in of.joints.iter_mut().enumerate() {
                let torque = 12.0 * wobble(run) * if run == 8 { warmer(j) } else { 1.0 };
                joint.warm_friction =
                    Some(WarmFriction { torque, std_error: 0.1, minute: 20.0, speed_fraction: 0.6 });
            }
        }
        history
    };
    let knowledge = |history: &[RunSummary]| {
        found(history).health.iter().map(|of| of.knowledge).collect::<Vec<Knowledge>>()
    };
    let all = history(&|j| 1.35 + 0.03 * j as f64);
    assert_eq!(knowledge(&all), vec![Knowledge::Compared; 6], "a cold hall");
    for warmer in [1.33, 0.7] {
        let one = history(&|j| if j == 3 { warmer } else { 1.0 });
        let mut expected = vec![Knowledge::Compared; 6];
        expected[3] = Knowledge::Unsettled;
        assert_eq!(knowledge(&one), expected, "{warmer}");
        let reason = found(&one).health[3].reason.clone().expect("a reason");
        assert!(reason.contains("no other joint"), "{reason}");
    }
}
