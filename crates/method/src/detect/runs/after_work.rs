//! Friction faults that work did not remove.
//!
//! Work begins a new baseline. A fault that persists would be usual friction in it. Until that baseline is complete, warm
//! friction is compared with the baseline before the work, at the same speed. Its change is the logarithm of the
//! ratio of both, less the median of the other joints, which share the temperature. A fault persists while at least half
//! of the change before the work remains, and no less than a drift that is reported.

use super::health::SAME_SPEED;
use crate::statistics::descriptive::median;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary};
use armwatch_model::robot::JointIndex;

/// Least part of the change that remains.
const REMAINING: f64 = 0.5;
/// Tests before the work that show its change.
const LATEST_BEFORE: usize = 2;
/// Fewest other joints for a common change.
const FEWEST_OTHERS: usize = 3;

/// Extends the anomalies in `found` that the joint's last test before the work still showed, if the tests `after` it show
/// them too. `before` are the tests of the baseline before the work and all later ones, `after` those of the baseline
/// that is not complete.
pub(super) fn extend_persisting(
    found: &mut [Anomaly],
    joint: JointIndex,
    before: &[&RunSummary],
    after: &[&RunSummary],
    settings: &DetectSettings,
) {
    let Some(latest) = after.last() else { return };
    let baseline = &before[..before.len().min(settings.baseline_runs.max(1))];
    let latest_before = &before[before.len().saturating_sub(LATEST_BEFORE)..];
    let changes = [latest_before, after].map(|tests| change(joint, baseline, tests, latest));
    let [Some(was), Some(is)] = changes else { return };
    let remains = was * is > 0.0 && is.abs() >= (REMAINING * was.abs()).max(settings.drift_warning.ln_1p());
    let is_of_friction = |of: &&mut Anomaly| {
        matches!(of.kind, AnomalyKind::Drift | AnomalyKind::Step)
            && of.quantity.is_of_one_cause(Quantity::FrictionIndex)
            && !of.ended
    };
    for anomaly in found.iter_mut().filter(is_of_friction).filter(|_| remains) {
        anomaly.last_run_id = latest.run_id;
        anomaly.last_seen_at = latest.started_at;
        anomaly.score = is.exp_m1().abs();
        anomaly.value = anomaly.baseline * is.exp();
        anomaly.message = format!(
            "{}; it persists: in {} the new baseline began, friction is {:.0} % {} the earlier baseline",
            anomaly.message,
            match after.len() {
                1 => "the test since".to_owned(),
                tests => format!("the {tests} tests since"),
            },
            100.0 * is.exp_m1().abs(),
            if is > 0.0 { "above" } else { "below" },
        );
    }
}

/// Logarithm of the change of a joint's warm friction from `baseline` to `tests`, at the speed of `latest`, beyond that
/// of the other joints.
fn change(
    joint: JointIndex,
    baseline: &[&RunSummary],
    tests: &[&RunSummary],
    latest: &RunSummary,
) -> Option<f64> {
    let of_joint = |joint: JointIndex| {
        let warm = |run: &RunSummary| run.joints.iter().find(|of| of.joint == joint)?.warm_friction;
        let speed = warm(latest)?.speed_fraction;
        let level = |runs: &[&RunSummary]| {
            let same = runs.iter().filter_map(|run| warm(run));
            let same = same.filter(|of| (of.speed_fraction - speed).abs() < SAME_SPEED);
            median(&same.map(|of| of.torque).collect::<Vec<_>>())
        };
        let change = (level(tests)? / level(baseline)?).ln();
        change.is_finite().then_some(change)
    };
    let others = latest.joints.iter().map(|of| of.joint).filter(|other| *other != joint);
    let others: Vec<f64> = others.filter_map(of_joint).collect();
    let common = if others.len() >= FEWEST_OTHERS { median(&others)? } else { 0.0 };
    Some(of_joint(joint)? - common)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::detect;
    use crate::detect::runs::fixtures::{JOINT, run};

    /// Five usual tests, seven with 20 % more friction, and after the work those with `friction`.
    fn history(friction: &[f64]) -> Vec<RunSummary> {
        let before =
            (0..12).map(|at| run(at, if at < 5 { 10.0 } else { 12.0 } + 0.01 * (at % 3) as f64, 0.03, 0.002));
        let after = friction.iter().enumerate().map(|(at, friction)| {
            let mut test = run(12 + at, *friction, 0.03, 0.002);
            test.epochs = vec![0; JOINT.index() + 1];
            test.epochs[JOINT.index()] = 1;
            test
        });
        before.chain(after).collect()
    }

    fn friction_alarm(friction: &[f64]) -> Anomaly {
        let found = detect(&history(friction), &DetectSettings::default()).anomalies;
        let mut found =
            found.into_iter().filter(|of| matches!(of.kind, AnomalyKind::Drift | AnomalyKind::Step));
        found.next().expect("an alarm")
    }

    #[test]
    fn a_fault_that_work_did_not_remove_stays_open_until_the_new_baseline_is_complete() {
        let alarm = friction_alarm(&[12.1, 12.0]);
        assert!(!alarm.ended && alarm.last_run_id == 14, "{alarm:?}");
        assert!((alarm.score - 0.2).abs() < 0.02, "{}", alarm.score);
        let said = "it persists: in the 2 tests since the new baseline began, friction is 20 % above the earlier baseline";
        assert!(alarm.message.ends_with(said), "{}", alarm.message);
        assert!(friction_alarm(&[12.0; 6]).ended);
    }

    #[test]
    fn a_fault_that_work_removed_has_ended() {
        for friction in [10.0, 10.9, 9.0] {
            let alarm = friction_alarm(&[friction]);
            assert!(alarm.ended && !alarm.message.contains("persists"), "{friction}: {alarm:?}");
        }
    }
}
