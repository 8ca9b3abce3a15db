//! Rises of simulated indices: an autoregression with a line, drawn without the detector's formulas.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::detect::runs::detect;
use crate::detect::runs::fixtures::indexed;
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary, Severity};

/// Daily tests of three joints; `of` is added to the index of the last one.
fn tests(
    count: i64,
    deviation: f64,
    correlation: f64,
    seed: u64,
    of: impl Fn(i64) -> f64,
) -> Vec<RunSummary> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut states = [0.0; 3];
    let fresh = deviation * (1.0 - correlation * correlation).sqrt();
    (0..count)
        .map(|day| {
            let mut run = indexed(day, Some(1.0));
            for (j, state) in states.iter_mut().enumerate() {
                *state = correlation * *state + fresh * rng.sample::<f64, _>(StandardNormal);
                let value = 1.0 + *state + if j == 2 { of(day) } else { 0.0 };
                run.joints[j].friction_index = Some(Estimate { value, std_error: 0.004 });
            }
            run
        })
        .collect()
}

fn alarms(history: &[RunSummary]) -> Vec<Anomaly> {
    let mut found = detect(history, &DetectSettings::default()).anomalies;
    found.retain(|of| of.severity >= Severity::Warning);
    found
}

/// Wear of half a per cent per test, in a joint that was run in by 2 % before.
#[test]
fn slow_wear_is_found_within_fifteen_tests_even_where_the_joint_was_run_in() {
    let onset = 30;
    for (deviation, correlation) in [(0.003, 0.0), (0.006, 0.4)] {
        let mut late = 0;
        for seed in 0..40 {
            let history = tests(onset + 15, deviation, correlation, seed, |day| {
                -0.02 * (1.0 - (-day as f64 / 10.0).exp()) + 0.005 * (day + 1 - onset).max(0) as f64
            });
            let found = alarms(&history);
            late += usize::from(!found.iter().any(|of| of.joint.is_some_and(|joint| joint.index() == 2)));
            for of in &found {
                assert_eq!(of.kind, AnomalyKind::Drift, "{}", of.message);
                assert!(of.first_run_id > onset, "{}", of.message);
            }
        }
        assert!(late <= 2, "{deviation} {correlation}: {late} of 40 later");
    }
}

#[test]
fn a_rise_says_how_much_and_since_when_and_goes_on_as_the_same_drift() {
    let onset = 30;
    let wear = |day: i64| 0.004 * (day + 1 - onset).max(0) as f64;
    let at = |count: i64| alarms(&tests(count, 0.002, 0.0, 4, wear));
    let first = (onset..onset + 20).find(|count| !at(*count).is_empty()).expect("an alarm");
    let early = &at(first)[0];
    assert!(early.score < 0.05 && early.threshold < 0.03, "{early:?}");
    assert!(early.message.contains("has risen by") && early.message.contains("a test"), "{}", early.message);
    assert!((early.onset.run_id - (onset + 1)).abs() <= 3, "{early:?}");
    let later = at(onset + 30);
    let [only] = &later[..] else { panic!("one alarm: {later:?}") };
    assert_eq!((only.first_run_id, only.ended), (early.first_run_id, false));
    assert!(only.score > 0.08, "{only:?}");
}

#[test]
fn what_stays_small_or_jumps_or_falls_is_no_rise() {
    // few tests after a small jump seldom count as a rise
    let mut taken = 0;
    for seed in 0..30 {
        let small = tests(120, 0.004, 0.3, seed, |day| 0.015 * (day.min(60) as f64 / 60.0));
        assert_eq!(alarms(&small), vec![], "{seed}");
        let jump = tests(60, 0.004, 0.3, seed, |day| if day >= 30 { 0.03 } else { 0.0 });
        taken += alarms(&jump).len();
        let fall = tests(60, 0.004, 0.3, seed, |day| -0.004 * (day - 30).clamp(0, 10) as f64);
        assert_eq!(alarms(&fall), vec![], "{seed}");
    }
    assert!(taken <= 2, "{taken} of 30 jumps");
}

/// Daily tests of healthy joints with autocorrelation, for a year each: one alarm in two years is allowed.
#[test]
fn healthy_joints_seldom_rise() {
    let mut found = 0;
    let robots = 12;
    for seed in 0..robots {
        let correlation = [0.0, 0.5, 0.8][seed as usize % 3];
        found += alarms(&tests(365, 0.007, correlation, 1000 + seed, |_| 0.0)).len();
    }
    assert!(found * 2 <= robots as usize, "{found} in {robots} robot-years");
}
