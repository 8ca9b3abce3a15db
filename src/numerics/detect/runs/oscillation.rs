//! Oscillation: the relative RMSD of a joint swings from cycle to cycle.
//!
//! The quantity is the swing of the moving relative RMSD of the excitation stage
//! ([`RmsdSwing`](crate::analysis::RmsdSwing)): a standard deviation, as a fraction of the torque. The
//! baseline is the median of the joint's first runs. A run is out from `oscillation_ratio` (3 unless
//! configured) times the baseline on, and from 0.004 at least ([`MIN_SWING`], above the healthy joints of the
//! thesis). It is critical from twice this limit on.

use super::series::JointSeries;
use crate::anomaly::{AnomalyKind, Severity};
use crate::numerics::detect::control_chart::baseline;
use crate::numerics::detect::detector::Detector;
use crate::numerics::detect::verdict::{Verdict, Why};

/// Swings of the relative RMSD below this are noise of a good fit, whatever their ratio: healthy
/// joints show 0.0012 to 0.003 (thesis 5.1.4).
const MIN_SWING: f64 = 0.004;

pub(super) struct Oscillation;

impl Detector<JointSeries<'_>> for Oscillation {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Oscillation
    }

    fn quantity(&self, _: &JointSeries<'_>) -> &'static str {
        "moving_relative_rmsd"
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let settings = series.settings;
        let swings = series.figures(|summary| summary.rmsd_swing.map(|swing| swing.value));
        let Some(baseline) = baseline(swings.iter().flatten().copied(), settings.baseline_runs) else {
            return vec![Verdict::Unknown; swings.len()];
        };
        let threshold = (settings.oscillation_ratio * baseline).max(MIN_SWING);
        let verdict = |swing: Option<f64>| match swing {
            None => Verdict::Unknown,
            Some(swing) if swing < threshold => Verdict::Quiet,
            Some(swing) => Verdict::Out {
                severity: if swing >= 2.0 * threshold { Severity::Critical } else { Severity::Warning },
                score: swing,
                threshold,
                value: swing,
                baseline,
                message: format!(
                    "relative RMSD swings by {:.2} % of torque from cycle to cycle, usually {:.2} %; look \
                     for a loose bearing, belt or encoder coupling",
                    100.0 * swing,
                    100.0 * baseline
                ),
                why: Why::default(),
            },
        };
        let one = |(run, of)| match series.is_signal_at_fault(run) {
            // what it says of a joint is the signal's
            Some(_) => Verdict::Unknown,
            None => verdict(of),
        };
        swings.into_iter().enumerate().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::detect::runs::fixtures::{JOINT, judged, run};
    use crate::numerics::detect::verdict::DetectSettings;

    fn severities(swings: &[f64]) -> Vec<Option<Severity>> {
        let history: Vec<_> =
            swings.iter().enumerate().map(|(i, swing)| run(i, 12.0, 0.03, *swing)).collect();
        let settings = DetectSettings::default();
        let verdicts = judged(&Oscillation, &history, JOINT, &settings);
        let severity = |verdict| match verdict {
            Verdict::Out { severity, .. } => Some(severity),
            Verdict::Unknown | Verdict::Quiet => None,
        };
        verdicts.into_iter().map(severity).collect()
    }

    #[test]
    fn three_times_the_baseline_is_a_warning_and_six_times_is_critical() {
        let found = severities(&[0.002, 0.002, 0.002, 0.002, 0.002, 0.0059, 0.0061, 0.0121]);
        assert_eq!(found[..6], [None; 6]);
        assert_eq!(found[6..], [Some(Severity::Warning), Some(Severity::Critical)]);
    }

    #[test]
    fn swings_of_a_good_fit_and_a_short_history_are_quiet() {
        assert_eq!(severities(&[0.001, 0.001, 0.001, 0.001, 0.001, 0.0039]), [None; 6]);
        assert_eq!(severities(&[0.002, 0.002, 0.002, 0.05]), [None; 4]);
    }
}
