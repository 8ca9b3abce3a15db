//! Detectors on histories made by hand.

use super::*;
use crate::analysis::{Estimate, JointSummary};
use crate::analysis::{RmsdSwing, WarmFriction};
use crate::anomaly::{AnomalyKind, Knowledge, RunSummary, Severity};
use crate::numerics::detect::verdict::DetectSettings;
use crate::robot::JointIndex;
use jiff::{SignedDuration, Timestamp};

fn run(index: usize, friction: f64, rmsd: f64, swing: f64) -> RunSummary {
    let joint = JointSummary {
        joint: JointIndex::new(2),
        warm_friction: Some(WarmFriction {
            torque: friction,
            std_error: 0.05,
            minute: 100.0,
            speed_fraction: 0.6,
        }),
        excitation_friction: None,
        friction_index: None,
        relative_rmsd: Some(rmsd),
        rmsd_swing: Some(RmsdSwing { value: swing, cycles: 24 }),
    };
    let quiet = |j: usize| JointSummary {
        joint: JointIndex::new(j),
        warm_friction: None,
        excitation_friction: None,
        friction_index: None,
        relative_rmsd: None,
        rmsd_swing: None,
    };
    RunSummary {
        run_id: i64::try_from(index).expect("small") + 1,
        started_at: Timestamp::UNIX_EPOCH
            + SignedDuration::from_hours(24 * i64::try_from(index).expect("small")),
        cycles: 24,
        refused_cycles: 0,
        refusals: vec![],
        joints: vec![quiet(0), quiet(1), joint],
    }
}

fn wobble(i: usize) -> f64 {
    1.0 + 0.008 * ((i * 37 % 11) as f64 / 5.0 - 1.0)
}

fn history(runs: usize, friction: impl Fn(usize) -> f64) -> Vec<RunSummary> {
    (0..runs).map(|i| run(i, friction(i), 0.03, 0.002)).collect()
}

#[test]
fn a_steady_arm_raises_nothing_and_has_an_index_near_one() {
    let found = detect(&history(60, |i| 12.0 * wobble(i)), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
    let health = &found.health[2];
    assert_eq!((health.knowledge, &health.reason), (Knowledge::Compared, &None));
    assert!((health.friction_index.expect("learned") - 1.0).abs() < 0.02);
}

#[test]
fn wear_is_found_once_names_the_joint_and_grows_worse() {
    let wear = |i: usize| 12.0 * wobble(i) * (1.0 + 0.03 * i.saturating_sub(7) as f64);
    let found = detect(&history(20, wear), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.kind, anomaly.joint.expect("one").number()), (AnomalyKind::Drift, 3));
    assert_eq!(anomaly.severity, Severity::Critical);
    assert!(!anomaly.ended);
    // 3 % a run from the ninth run on: 5 % is passed at the earliest with the tenth
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert_eq!(anomaly.last_run_id, 20);
    assert!(anomaly.message.contains("joint 3"));
}

#[test]
fn one_odd_run_is_not_a_drift() {
    let found =
        detect(&history(30, |i| if i == 15 { 13.0 } else { 12.0 * wobble(i) }), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
}

#[test]
fn a_repaired_joint_ends_its_episode() {
    let repaired = |i: usize| 12.0 * wobble(i) * if (8..16).contains(&i) { 1.2 } else { 1.0 };
    let found = detect(&history(30, repaired), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert!(anomaly.ended);
    assert!(anomaly.last_run_id >= 16, "{}", anomaly.last_run_id);
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
fn swings_and_inaccuracy_are_told_apart() {
    let mut runs = history(12, |i| 12.0 * wobble(i));
    runs[10] = run(10, 12.0, 0.03, 0.009);
    runs[11] = run(11, 12.0, 0.17, 0.009);
    let found = detect(&runs, &DetectSettings::default()).anomalies;
    let kinds: Vec<_> = found.iter().map(|a| (a.kind, a.severity, a.first_run_id)).collect();
    assert_eq!(
        kinds,
        vec![
            (AnomalyKind::Oscillation, Severity::Warning, 11),
            (AnomalyKind::Accuracy, Severity::Critical, 12)
        ]
    );
}

#[test]
fn a_joint_that_was_always_inaccurate_is_only_worth_knowing() {
    let runs: Vec<_> = (0..12).map(|i| run(i, 12.0, 0.12, 0.002)).collect();
    let found = detect(&runs, &DetectSettings::default()).anomalies;
    let after_learning = found.last().expect("one");
    assert_eq!(after_learning.severity, Severity::Info);
}

/// Gives runs an index of `value` with `std_error`.
fn with_index(mut runs: Vec<RunSummary>, index: impl Fn(usize) -> Option<(f64, f64)>) -> Vec<RunSummary> {
    for (i, run) in runs.iter_mut().enumerate() {
        run.joints[2].friction_index = index(i).map(|(value, std_error)| Estimate { value, std_error });
    }
    runs
}

#[test]
fn a_hall_that_the_index_knows_of_is_no_drift() {
    // warm friction rises by a tenth with a cold hall, the index does not
    let cold = history(20, |i| 12.0 * wobble(i) * if i > 10 { 1.1 } else { 1.0 });
    assert_eq!(detect(&cold, &DetectSettings::default()).anomalies.len(), 1);
    let found = detect(&with_index(cold, |i| Some((wobble(i), 0.005))), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
    assert!((found.health[2].friction_index.expect("learned") - wobble(19)).abs() < 1e-12);
}

#[test]
fn wear_in_the_index_says_so_and_uncertain_runs_have_less_of_a_say() {
    let wear = |i: usize| wobble(i) * (1.0 + 0.03 * i.saturating_sub(7) as f64);
    let found =
        detect(&with_index(history(20, |_| 12.0), |i| Some((wear(i), 0.005))), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.quantity, anomaly.baseline), ("friction_index", 1.0));
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert!(anomaly.message.contains("equal speed and warmth"), "{}", anomaly.message);
    let unsure = |i: usize| Some(if i < 14 { (wobble(i), 0.005) } else { (1.1, 0.08) });
    assert_eq!(
        detect(&with_index(history(16, |_| 12.0), unsure), &DetectSettings::default()).anomalies,
        vec![]
    );
}

#[test]
fn a_run_without_an_index_is_held_against_warm_friction_and_says_why() {
    let worn = history(20, |i| 12.0 * wobble(i) * if i > 9 { 1.3 } else { 1.0 });
    let found =
        detect(&with_index(worn, |i| (i < 10).then(|| (wobble(i), 0.005))), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert!(anomaly.message.contains("has no friction index"), "{}", anomaly.message);
    assert_eq!(anomaly.quantity, "friction_index");
}

/// Takes the friction stage from runs and gives them friction of the excitation.
fn without_friction_stage(mut runs: Vec<RunSummary>, friction: impl Fn(usize) -> f64) -> Vec<RunSummary> {
    for (i, run) in runs.iter_mut().enumerate() {
        let joint = &mut run.joints[2];
        joint.warm_friction = None;
        joint.excitation_friction =
            Some(WarmFriction { torque: friction(i), std_error: 0.8, minute: 60.0, speed_fraction: 0.6 });
    }
    runs
}

#[test]
fn without_a_friction_stage_the_identified_friction_is_watched() {
    let bare = |friction: &dyn Fn(usize) -> f64, runs| {
        detect(&without_friction_stage(history(runs, |_| 12.0), friction), &DetectSettings::default())
    };
    let learning = bare(&|i| 9.0 * wobble(i), 4);
    assert_eq!(learning.health[2].reason.as_deref(), Some("4 of 5 tests of the baseline"));
    let healthy = bare(&|i| 9.0 * wobble(i), 40);
    assert_eq!(healthy.anomalies, vec![]);
    let health = &healthy.health[2];
    assert_eq!(
        (health.knowledge, health.friction_quantity),
        (Knowledge::Compared, Some("excitation_friction_nm"))
    );
    let worn = bare(&|i| 9.0 * wobble(i) * (1.0 + 0.03 * i.saturating_sub(7) as f64), 20);
    let [anomaly] = &worn.anomalies[..] else { panic!("one anomaly: {:?}", worn.anomalies) };
    assert_eq!((anomaly.quantity, anomaly.joint), ("excitation_friction_nm", Some(JointIndex::new(2))));
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert!((anomaly.baseline - 9.0).abs() < 0.1 && anomaly.value > 11.0, "{anomaly:?}");
    assert!(anomaly.message.contains("the recordings have no friction stage"), "{}", anomaly.message);
}

#[test]
fn severity_figures_and_message_are_of_one_run_and_the_peak_stays() {
    let repaired = |i: usize| 12.0 * wobble(i) * if (8..16).contains(&i) { 1.3 } else { 1.0 };
    let found = detect(&history(18, repaired), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    // two healthy tests after a repair: the smoothed change is still out, but no longer critical
    assert_eq!((anomaly.severity, anomaly.last_run_id), (Severity::Warning, 18));
    assert!((anomaly.value - 12.0).abs() < 0.2 && (anomaly.peak_value - 15.6).abs() < 0.2, "{anomaly:?}");
    let percent = format!("is {:.0} % above", 100.0 * anomaly.score);
    assert!(anomaly.message.contains(&percent), "{}", anomaly.message);
    assert!(anomaly.message.contains("latest test, within the limit by itself"), "{}", anomaly.message);

    let limit: Vec<_> = (0..12).map(|i| run(i, 12.0, if i == 11 { 0.10004 } else { 0.03 }, 0.002)).collect();
    let found = detect(&limit, &DetectSettings::default()).anomalies;
    assert!(found[0].message.contains("misses 10.004 % of this joint's torque, limit 10.000 %"), "{found:?}");
    // worse, then as in its baseline again: the row says one of both throughout
    let ever: Vec<_> = (0..12).map(|i| run(i, 12.0, if i == 10 { 0.3 } else { 0.128 }, 0.002)).collect();
    let found = detect(&ever, &DetectSettings::default()).anomalies;
    let last = found.last().expect("one");
    assert_eq!((last.severity, last.value, last.peak_value), (Severity::Info, 0.128, 0.3));
    assert!(last.message.contains("as in its baseline"), "{}", last.message);
}
