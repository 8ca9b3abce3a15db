//! All detectors of tests together, on synthetic histories.

use super::fixtures::{JOINT, history, run, wobble};
use super::series::friction_history;
use super::*;
use armwatch_model::anomaly::{AnomalyKind, Knowledge, Severity};

#[test]
fn a_steady_arm_raises_nothing_and_has_an_index_near_one() {
    let found = detect(&history(60, |i| 12.0 * wobble(i)), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
    let health = &found.health[2];
    assert_eq!((health.knowledge, &health.reason), (Knowledge::Compared, &None));
    assert!((health.friction_index.expect("learned") - 1.0).abs() < 0.02);
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
fn severity_figures_and_message_are_of_one_run_and_the_peak_stays() {
    let repaired = |i: usize| 12.0 * wobble(i) * if (8..16).contains(&i) { 1.2 } else { 1.0 };
    let found = detect(&history(17, repaired), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    // one healthy test after a repair: the smoothed change is still out, but no longer critical
    assert_eq!((anomaly.severity, anomaly.last_run_id), (Severity::Warning, 17));
    assert!((anomaly.value - 12.0).abs() < 0.2 && (anomaly.peak_value - 14.4).abs() < 0.2, "{anomaly:?}");
    let percent = format!("is {:.0} % above", 100.0 * anomaly.score);
    assert!(anomaly.message.contains(&percent), "{}", anomaly.message);
    assert!(anomaly.message.contains("latest test, within the limit by itself"), "{}", anomaly.message);

    let limit: Vec<_> = (0..12).map(|i| run(i, 12.0, if i == 11 { 0.10004 } else { 0.03 }, 0.002)).collect();
    let found = detect(&limit, &DetectSettings::default()).anomalies;
    assert!(found[0].message.contains("misses 10.004 % of this joint's torque, limit 10.000 %"), "{found:?}");
    // worse, then as in its baseline again: all values of the row are of the same run
    let ever: Vec<_> = (0..12).map(|i| run(i, 12.0, if i == 10 { 0.3 } else { 0.128 }, 0.002)).collect();
    let found = detect(&ever, &DetectSettings::default()).anomalies;
    let last = found.last().expect("one");
    assert_eq!((last.severity, last.value, last.peak_value), (Severity::Info, 0.128, 0.3));
    assert!(last.message.contains("as in its baseline"), "{}", last.message);
}

#[test]
fn two_healthy_tests_after_a_repair_end_it() {
    let repaired = |i: usize| 12.0 * wobble(i) * if (8..16).contains(&i) { 1.3 } else { 1.0 };
    let found = detect(&history(19, repaired), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert!(anomaly.last_run_id <= 17 && anomaly.ended, "{anomaly:?}");
}

#[test]
fn no_two_detectors_give_the_same_anomaly() {
    // the store identifies an anomaly by kind and quantity, and by joint and first run
    let (history, settings) = (history(6, |_| 12.0), DetectSettings::default());
    let causes = vec![None; history.len()];
    let friction = friction_history(&history, JOINT, &causes, settings.baseline_runs);
    let series = JointSeries::new(&history, JOINT, &friction, &causes, &[], &settings);
    let mut named: Vec<_> = JOINT_DETECTORS.iter().map(|of| (of.kind(), of.quantity(&series))).collect();
    named.sort_unstable();
    named.dedup();
    assert_eq!(named.len(), JOINT_DETECTORS.len());
}
