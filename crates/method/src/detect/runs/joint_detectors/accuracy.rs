//! Accuracy: the identified model does not explain the torque of a joint.
//!
//! The quantity is the moving relative RMSD of the excitation stage, a fraction of the torque. The limits are absolute.
//! A run is out above `accuracy_warning` (0.10 unless configured, the limit of the thesis) and critical above
//! `accuracy_critical` (0.15). If the joint's baseline, the median of its first runs, is itself above
//! `accuracy_warning`, the severity of a run of up to 1.3 times the baseline ([`ACCURACY_AS_EVER`]) is `info`.
//!
//! An error that is small in Nm does not show a wrong model, even if it is a large part of a small torque. So an error
//! below 1 % of the largest torque among the arm's joints, or below three standard deviations of the channel's noise,
//! does not count. Until the joint has a baseline, an error within 60 % of the joint's friction has the severity
//! `info`: friction may have another shape than the description's law. The refusal of a cycle (`unexplained_torque`)
//! uses the same values.

use crate::detect::control_chart::baseline;
use crate::detect::detector::Detector;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why, apart};
use crate::diagnose::model::weigh::WeighSettings;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Largest factor on the joint's own baseline that still makes a relative RMSD beyond its limit the joint's usual
/// state, with the severity `info`.
const ACCURACY_AS_EVER: f64 = 1.3;

pub(super) struct Accuracy;

/// Least errors that matter in a run, as parts of the joint's torque.
#[derive(Debug, Clone, Copy, Default)]
struct Floors {
    /// Below this value there is no error.
    none: f64,
    /// Up to this value it may be friction of another shape.
    friction: f64,
}

impl Floors {
    fn of(series: &JointSeries<'_>, run: usize) -> Self {
        let Some(own) = series.runs[run] else { return Self::default() };
        let limits = WeighSettings::default();
        let noise = limits.noise_deviations * own.relative_noise.unwrap_or(0.0);
        let Some(torque) = own.torque_rms.filter(|torque| *torque > 0.0) else { return Self::default() };
        let friction = own.warm_friction.or(own.excitation_friction).map_or(0.0, |of| of.torque);
        Self {
            none: noise.max(limits.arm_share * series.largest_torque(run) / torque),
            friction: limits.friction_share * friction / torque,
        }
    }
}

impl Detector<JointSeries<'_>> for Accuracy {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Accuracy
    }

    fn quantity(&self, _: &JointSeries<'_>) -> Quantity {
        Quantity::MovingRelativeRmsd
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let settings = series.settings;
        let values = series.figures(|summary| summary.relative_rmsd);
        let baseline = baseline(values.iter().flatten().copied(), settings.baseline_runs);
        let verdict = |run: usize, value: Option<f64>| match value {
            None => Verdict::Unknown,
            Some(value) if value <= settings.accuracy_warning => Verdict::Quiet,
            Some(value) if value <= Floors::of(series, run).none => Verdict::Quiet,
            Some(value) => {
                let of_friction = baseline.is_none() && value <= Floors::of(series, run).friction;
                let critical = value > settings.accuracy_critical;
                let as_ever =
                    baseline.is_some_and(|b| b > settings.accuracy_warning && value <= ACCURACY_AS_EVER * b);
                let threshold = if critical { settings.accuracy_critical } else { settings.accuracy_warning };
                let [percent, limit] = apart(100.0 * value, 100.0 * threshold);
                Verdict::Out {
                    severity: match (as_ever || of_friction, critical) {
                        (true, _) => Severity::Info,
                        (false, true) => Severity::Critical,
                        (false, false) => Severity::Warning,
                    },
                    score: value,
                    threshold,
                    value,
                    baseline: baseline.unwrap_or(settings.accuracy_warning),
                    message: format!(
                        "the identified model misses {percent} % of this joint's torque, limit {limit} %{}; \
                         check torque signal, payload and the robot's description",
                        match (as_ever, of_friction) {
                            (true, _) => ", as in its baseline",
                            (false, true) =>
                                ", which friction of another shape than the description's may explain",
                            (false, false) => "",
                        }
                    ),
                    why: Why::default(),
                }
            }
        };
        let one = |(run, of)| match series.is_rest_explained(run) {
            true => Verdict::Unknown,
            false => verdict(run, of),
        };
        values.into_iter().enumerate().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::detect;
    use crate::detect::runs::fixtures::{JOINT, judged, run};
    use armwatch_model::anomaly::settings::DetectSettings;

    #[test]
    fn a_joint_that_was_always_inaccurate_is_only_worth_knowing() {
        let runs: Vec<_> = (0..12).map(|i| run(i, 12.0, 0.12, 0.002)).collect();
        let found = detect(&runs, &DetectSettings::default()).anomalies;
        let after_learning = found.last().expect("one");
        assert_eq!(after_learning.severity, Severity::Info);
    }

    #[test]
    fn an_error_of_little_torque_or_within_friction_is_no_alarm_of_a_new_arm() {
        let settings = DetectSettings::default();
        let severity = |torque: f64, friction: f64, tests: usize| {
            let mut history: Vec<_> = (0..tests).map(|i| run(i, friction, 0.05, 0.002)).collect();
            let last = history.last_mut().expect("tests");
            let place = |joint| last.joints.iter().position(|of| of.joint == joint).expect("the joint");
            let (own, other) = (place(JOINT), (place(JOINT) + 1) % last.joints.len());
            last.joints[own].relative_rmsd = Some(0.37);
            last.joints[own].torque_rms = Some(torque);
            last.joints[other].torque_rms = Some(31.0);
            match judged(&Accuracy, &history, JOINT, &settings).last() {
                Some(Verdict::Out { severity, .. }) => Some(*severity),
                _ => None,
            }
        };
        assert_eq!(severity(0.18, 0.1, 1), None, "0.07 Nm in an arm of 31 Nm");
        assert_eq!(severity(1.8, 0.1, 1), Some(Severity::Critical), "0.67 Nm");
        assert_eq!(severity(1.8, 1.5, 1), Some(Severity::Info), "within its friction");
        assert_eq!(severity(1.8, 1.5, 8), Some(Severity::Critical), "it was better before");
    }

    #[test]
    fn the_limits_hold_from_the_first_run_on() {
        let history: Vec<_> =
            [0.10, 0.11, 0.16].into_iter().enumerate().map(|(i, rmsd)| run(i, 12.0, rmsd, 0.002)).collect();
        let settings = DetectSettings::default();
        let verdicts = judged(&Accuracy, &history, JOINT, &settings);
        let severity = |verdict: &Verdict| match verdict {
            Verdict::Out { severity, threshold, .. } => Some((*severity, *threshold)),
            Verdict::Unknown | Verdict::Quiet => None,
        };
        let found: Vec<_> = verdicts.iter().map(severity).collect();
        assert_eq!(found, [None, Some((Severity::Warning, 0.10)), Some((Severity::Critical, 0.15))]);
    }
}
