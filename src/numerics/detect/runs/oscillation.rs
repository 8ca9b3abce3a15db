//! Oscillation: the relative RMSD of a joint swings from cycle to cycle.
//!
//! The quantity is the swing of the moving relative RMSD of the excitation stage
//! ([`RmsdSwing`](crate::analysis::RmsdSwing)): a standard deviation, as a fraction of the torque. The
//! baseline is the median of the joint's first runs. A run is out from `oscillation_ratio` (3 unless
//! configured) times the baseline on, and from 0.004 at least ([`MIN_SWING`], above the healthy joints of the
//! thesis). Where the RMSD itself is larger than usual, the limit is so in proportion: more noise swings more. A short
//! test tells a standard deviation badly: the limit is one and a half times what chance makes of it at least. It is
//! critical from twice this limit on.

use super::series::JointSeries;
use crate::anomaly::{AnomalyKind, Severity};
use crate::numerics::detect::control_chart::baseline;
use crate::numerics::detect::detector::Detector;
use crate::numerics::detect::verdict::{Verdict, Why};

/// Swings of the relative RMSD below this are noise of a good fit, whatever their ratio: healthy
/// joints show 0.0012 to 0.003 (thesis 5.1.4).
const MIN_SWING: f64 = 0.004;

/// Standard deviations of chance, and the factor on it: the baseline's own error.
const CHANCE: f64 = 3.7;
const CHANCE_FACTOR: f64 = 1.5;

pub(super) struct Oscillation;

/// The most that chance makes of a standard deviation over so many cycles, as a multiple of the true one: the root of the
/// quantile of chi-square over its degrees of freedom (Wilson and Hilferty 1931).
fn highest_by_chance(cycles: usize) -> f64 {
    let freedom = cycles.saturating_sub(1).max(1) as f64;
    let share = 2.0 / (9.0 * freedom);
    (1.0 - share + CHANCE * share.sqrt()).powf(1.5)
}

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
        let levels = series.figures(|summary| summary.relative_rmsd);
        let usual_level = baseline(levels.iter().flatten().copied(), settings.baseline_runs);
        let Some(baseline) = baseline(swings.iter().flatten().copied(), settings.baseline_runs) else {
            return vec![Verdict::Unknown; swings.len()];
        };
        let threshold = |run: usize| {
            let cycles = series.runs[run].and_then(|of| of.rmsd_swing).map_or(0, |of| of.cycles);
            let by_chance = CHANCE_FACTOR * highest_by_chance(cycles);
            let level = levels[run].zip(usual_level).map_or(1.0, |(now, usual)| (now / usual).max(1.0));
            (settings.oscillation_ratio.max(by_chance) * baseline * level).max(MIN_SWING)
        };
        let verdict = |swing: Option<f64>, threshold: f64| match swing {
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
            None => verdict(of, threshold(run)),
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
