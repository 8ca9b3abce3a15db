//! Drift of friction, on histories made by hand.

use jiff::civil::date;

use crate::detect::runs::detect;
use crate::detect::runs::fixtures::{history, wobble};
use armwatch_model::analysis::{Estimate, WarmFriction};
use armwatch_model::anomaly::forecast::{Forecast, Trend};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{AnomalyKind, Knowledge, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

#[test]
fn wear_is_found_once_names_the_joint_and_grows_worse() {
    let wear = |i: usize| 12.0 * wobble(i) * (1.0 + 0.03 * i.saturating_sub(7) as f64);
    let found = detect(&history(20, wear), &DetectSettings::default());
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.kind, anomaly.joint.expect("one").number()), (AnomalyKind::Drift, 3));
    assert_eq!(anomaly.severity, Severity::Critical);
    assert!(!anomaly.ended);
    // 3 % a run from the ninth run: the tenth is the earliest that passes 5 %
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert_eq!(anomaly.last_run_id, 20);
    assert!(anomaly.message.contains("joint 3"));
}

#[test]
fn wear_of_four_percent_a_run_is_found_with_its_third_run_whatever_the_history() {
    for healthy in [6, 12, 30, 90] {
        let wear = |i: usize| wobble(i) * (1.0 + 0.04 * (i + 1).saturating_sub(healthy) as f64);
        let runs = healthy + 3;
        let indexed = with_index(history(runs, |_| 12.0), |i| Some((wear(i), 0.005)));
        for tests in [history(runs, |i| 12.0 * wear(i)), indexed] {
            let found = detect(&tests, &DetectSettings::default());
            let [anomaly] = &found.anomalies[..] else { panic!("{healthy}: {:?}", found.anomalies) };
            assert!(anomaly.first_run_id <= runs as i64, "{healthy}: {anomaly:?}");
        }
    }
}

#[test]
fn one_odd_run_is_not_a_drift() {
    let found =
        detect(&history(30, |i| if i == 15 { 13.0 } else { 12.0 * wobble(i) }), &DetectSettings::default());
    assert_eq!(found.anomalies, vec![]);
}

/// Gives runs an index of `value` with `std_error`.
fn with_index(mut runs: Vec<RunSummary>, index: impl Fn(usize) -> Option<(f64, f64)>) -> Vec<RunSummary> {
    for (i, run) in runs.iter_mut().enumerate() {
        run.joints[2].friction_index = index(i).map(|(value, std_error)| Estimate { value, std_error });
    }
    runs
}

/// The message gives the beginning and the level the same sign.
#[test]
fn friction_that_jumps_up_and_falls_below_its_baseline_is_told_with_the_sign_of_each() {
    let up_and_down = |i: usize| match i {
        0..=11 => 1.0,
        12..=14 => 1.14,
        _ => 0.8,
    };
    for runs in 13..=22 {
        let tests = with_index(history(runs, |_| 12.0), |i| Some((up_and_down(i) * wobble(i), 0.004)));
        let found = detect(&tests, &DetectSettings::default()).anomalies;
        assert!(!found.is_empty(), "{runs}");
        for of in found {
            let (above, below) =
                (of.message.contains("above the joint's"), of.message.contains("below the joint's"));
            let jumps = [of.message.contains("jumped by +"), of.message.contains("jumped by -")];
            assert!(above != below && jumps == [above, below], "{runs}: {}", of.message);
        }
    }
}

/// The average is late, so the alarm is still open in the first test after a repair that nobody has entered.
#[test]
fn wear_does_not_become_a_jump_with_its_repair() {
    let wear = |i: usize| match i {
        8..=12 => 1.0 + 0.05 * (i - 7) as f64,
        _ => 1.0,
    };
    for runs in 12..=16 {
        let tests = with_index(history(runs, |_| 12.0), |i| Some((wear(i) * wobble(i), 0.004)));
        let found = detect(&tests, &DetectSettings::default()).anomalies;
        let [anomaly] = &found[..] else { panic!("{runs}: {found:?}") };
        assert_eq!(anomaly.kind, AnomalyKind::Drift, "{runs}: {anomaly:?}");
    }
}

#[test]
fn a_hall_that_the_index_knows_of_is_no_drift() {
    // warm friction rises by a tenth at a low ambient temperature, the index does not
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
    assert_eq!((anomaly.quantity, anomaly.baseline), (Quantity::FrictionIndex, 1.0));
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert!(anomaly.message.contains("equal speed and temperature"), "{}", anomaly.message);
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
    assert_eq!(anomaly.quantity, Quantity::FrictionIndex);
}

/// Removes the friction stage from runs and gives them friction of the excitation.
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
        (Knowledge::Compared, Some(Quantity::ExcitationFriction))
    );
    let worn = bare(&|i| 9.0 * wobble(i) * (1.0 + 0.03 * i.saturating_sub(7) as f64), 20);
    let [anomaly] = &worn.anomalies[..] else { panic!("one anomaly: {:?}", worn.anomalies) };
    assert_eq!((anomaly.quantity, anomaly.joint), (Quantity::ExcitationFriction, Some(JointIndex::new(2))));
    assert!((10..=13).contains(&anomaly.first_run_id), "{}", anomaly.first_run_id);
    assert!((anomaly.baseline - 9.0).abs() < 0.1 && anomaly.value > 11.0, "{anomaly:?}");
    assert!(anomaly.message.contains("the recordings have no friction stage"), "{}", anomaly.message);
}

#[test]
fn a_drift_says_when_it_becomes_critical_and_the_joint_does_too() {
    // 0.4 % a day from the eleventh test: critical with the 48th, 1970-02-17
    let wear = |i: usize| 1.0 + 0.2 * (wobble(i) - 1.0) + 0.004 * i.saturating_sub(10) as f64;
    let until = |tests: usize| {
        let runs = with_index(history(tests, |_| 12.0), |i| Some((wear(i), 0.005)));
        detect(&runs, &DetectSettings::default())
    };
    let found = until(38);
    let [anomaly] = &found.anomalies[..] else { panic!("one anomaly: {:?}", found.anomalies) };
    assert_eq!((anomaly.kind, anomaly.severity), (AnomalyKind::Drift, Severity::Warning));
    let forecast = found.health[2].forecast.expect("a forecast");
    assert_eq!((forecast.trend, forecast.warning_at), (Trend::Rising, None));
    let critical = forecast.critical_at.expect("ahead");
    let clause = format!("; at this rate critical by {}", critical.words());
    assert!(anomaly.message.ends_with(&clause), "{} {clause}", anomaly.message);
    let day = date(1970, 2, 17);
    assert!((date(1970, 2, 13)..=date(1970, 2, 21)).contains(&critical.by), "{critical:?}");
    assert!(critical.lower <= day && critical.upper.is_none_or(|upper| upper >= day), "{critical:?}");
    // a critical joint has no forecast
    let found = until(60);
    assert_eq!(found.anomalies[0].severity, Severity::Critical);
    assert!(!found.anomalies[0].message.contains("at this rate"), "{}", found.anomalies[0].message);
    assert_eq!(found.health[2].forecast.and_then(|of| of.critical_at), None);
}

#[test]
fn a_jump_is_no_trend() {
    let jump = |i: usize| wobble(i) * if i >= 20 { 1.1 } else { 1.0 };
    let found =
        detect(&with_index(history(40, |_| 12.0), |i| Some((jump(i), 0.005))), &DetectSettings::default());
    assert_eq!(found.health[2].forecast, Some(Forecast::default()), "{:?}", found.anomalies);
}

/// Healthy indices of six joints with day scatter, five first tests and two years of daily ones.
#[test]
#[ignore = "years of histories"]
fn scatter_of_healthy_indices_raises_less_than_the_rate_that_is_asked_for() {
    use rand::{RngExt, SeedableRng};
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    // scatter equal for all joints, and scatter that differs between joints by up to a factor of two either way
    for (scatter, unlike) in
        [(0.003, 0.0), (0.01, 0.0), (0.015, 0.0), (0.02, 0.0), (0.008, 0.7), (0.012, 0.7)]
    {
        let (mut alarms, robots, tests) = (0, 25, 730);
        for _ in 0..robots {
            let mut runs = history(tests, |_| 12.0);
            let scatters: Vec<f64> =
                (0..6).map(|_| scatter * (unlike * rng.random_range(-1.0..1.0_f64)).exp()).collect();
            for run in &mut runs {
                run.joints = (0..6)
                    .map(|j| {
                        let mut joint = run.joints[2];
                        let normal: f64 = rng.sample(rand_distr::StandardNormal);
                        joint.joint = JointIndex::new(j);
                        joint.friction_index =
                            Some(Estimate { value: 1.0 + scatters[j] * normal, std_error: 0.005 });
                        joint
                    })
                    .collect();
            }
            let found = detect(&runs, &DetectSettings::default()).anomalies;
            alarms += found.iter().filter(|of| of.severity >= Severity::Warning).count();
        }
        let years = f64::from(robots) * tests as f64 / 365.25;
        println!("scatter {scatter}, {unlike}: {alarms} false alarms in {years:.0} robot-years");
        assert!(alarms as f64 <= years, "{scatter}: {alarms} in {years:.0} years");
    }
}
