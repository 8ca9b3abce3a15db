//! Accuracy: the identified model does not explain the torque of a joint.
//!
//! The quantity is the moving relative RMSD of the excitation stage, a fraction of the torque. The limits are
//! absolute. A run is out above `accuracy_warning` (0.10 unless configured, the limit of the thesis) and
//! critical above `accuracy_critical` (0.15). If the joint's baseline, the median of its first runs, is above
//! `accuracy_warning` itself, a run of up to 1.3 times the baseline ([`ACCURACY_AS_EVER`]) is only worth
//! knowing (`info`).

use crate::detect::control_chart::baseline;
use crate::detect::detector::Detector;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why, apart};
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// A relative RMSD beyond its limit that is within this factor of the joint's own baseline is how
/// the joint has always been: worth knowing, not worth a call.
const ACCURACY_AS_EVER: f64 = 1.3;

pub(super) struct Accuracy;

impl Detector<JointSeries<'_>> for Accuracy {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Accuracy
    }

    fn quantity(&self, _: &JointSeries<'_>) -> &'static str {
        "moving_relative_rmsd"
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let settings = series.settings;
        let values = series.figures(|summary| summary.relative_rmsd);
        let baseline = baseline(values.iter().flatten().copied(), settings.baseline_runs);
        let verdict = |value: Option<f64>| match value {
            None => Verdict::Unknown,
            Some(value) if value <= settings.accuracy_warning => Verdict::Quiet,
            Some(value) => {
                let critical = value > settings.accuracy_critical;
                let as_ever =
                    baseline.is_some_and(|b| b > settings.accuracy_warning && value <= ACCURACY_AS_EVER * b);
                let threshold = if critical { settings.accuracy_critical } else { settings.accuracy_warning };
                let [percent, limit] = apart(100.0 * value, 100.0 * threshold);
                Verdict::Out {
                    severity: match (as_ever, critical) {
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
                        if as_ever { ", as in its baseline" } else { "" }
                    ),
                    why: Why::default(),
                }
            }
        };
        let one = |(run, of)| match series.is_rest_explained(run) {
            true => Verdict::Unknown,
            false => verdict(of),
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
