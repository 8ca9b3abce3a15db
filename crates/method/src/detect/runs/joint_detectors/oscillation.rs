//! Oscillation: the relative RMSD of a joint swings from cycle to cycle.
//!
//! The quantity is the swing of the moving relative RMSD of the excitation stage
//! ([`RmsdSwing`](armwatch_model::analysis::RmsdSwing)): a standard deviation, as a fraction of the torque. The
//! baseline is the median of the joint's first runs. A run is out from `oscillation_ratio` (3 unless configured) times
//! the baseline on, and from 0.004 at least ([`MIN_SWING`], above the healthy joints of the thesis). If the RMSD itself
//! is larger than usual, the limit rises in proportion: more noise swings more. A short test gives an uncertain
//! standard deviation: the limit is at least one and a half times the effect of chance on it. It is critical from twice
//! this limit on.
//!
//! If there are other arms of the model, the same limit holds against the median of their first tests, from this arm's
//! first test on: an arm that always swung is found. One test then has the severity `info`, and is a warning if the
//! test before shows it too or if it exceeds the limit by half.

use crate::detect::control_chart::baseline;
use crate::detect::detector::Detector;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::median;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Swings of the relative RMSD below this are noise of a good fit, whatever their ratio: healthy
/// joints show 0.0012 to 0.003 (thesis 5.1.4).
const MIN_SWING: f64 = 0.004;

/// Standard deviations of the limit of chance, and the factor on it: the error of the baseline.
const CHANCE: f64 = 3.7;
const CHANCE_FACTOR: f64 = 1.5;

pub(super) struct Oscillation;

/// Upper limit of a standard deviation by chance over this number of cycles, as a multiple of the true one: the root of
/// the quantile of chi-square over its degrees of freedom (Wilson and Hilferty 1931).
fn highest_by_chance(cycles: usize) -> f64 {
    let freedom = cycles.saturating_sub(1).max(1) as f64;
    let share = 2.0 / (9.0 * freedom);
    (1.0 - share + CHANCE * share.sqrt()).powf(1.5)
}

impl Detector<JointSeries<'_>> for Oscillation {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Oscillation
    }

    fn quantity(&self, _: &JointSeries<'_>) -> Quantity {
        Quantity::MovingRelativeRmsd
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let settings = series.settings;
        let swings = series.figures(|summary| summary.rmsd_swing.map(|swing| swing.value));
        let levels = series.figures(|summary| summary.relative_rmsd);
        let first = |of: &[Option<f64>]| baseline(of.iter().flatten().copied(), settings.baseline_runs);
        let peers = series.of_peers(|summary| summary.rmsd_swing.map(|swing| swing.value));
        let own = first(&swings).map(|swing| UsualSwing { swing, level: first(&levels), peers: 0 });
        let of_peers = median(&peers).map(|swing| UsualSwing {
            swing,
            level: median(&series.of_peers(|summary| summary.relative_rmsd)),
            peers: peers.len(),
        });
        let compared: Vec<UsualSwing> = own.into_iter().chain(of_peers).collect();
        let mut before = false;
        let one = |(run, swing): (usize, &Option<f64>)| {
            // the residual of a wrong signal is not the joint's
            let Some(swing) = swing.filter(|_| !series.is_rest_of_wrong_signal(run)) else {
                return Verdict::Unknown;
            };
            let cycles = series.runs[run].and_then(|of| of.rmsd_swing).map_or(0, |of| of.cycles);
            let ratio = settings.oscillation_ratio.max(CHANCE_FACTOR * highest_by_chance(cycles));
            let limits = compared.iter().map(|usual| (usual, usual.limit(ratio, levels[run])));
            let Some((usual, limit)) = limits.min_by(|a, b| a.1.total_cmp(&b.1)) else {
                return Verdict::Unknown;
            };
            let is_out = swing >= limit;
            // two arms of a model differ more than two tests of one arm
            let is_confirmed =
                std::mem::replace(&mut before, is_out) || usual.peers == 0 || swing >= 1.5 * limit;
            if !is_out {
                return Verdict::Quiet;
            }
            Verdict::Out {
                severity: match is_confirmed {
                    true if swing >= 2.0 * limit => Severity::Critical,
                    true => Severity::Warning,
                    false => Severity::Info,
                },
                score: swing,
                threshold: limit,
                value: swing,
                baseline: usual.swing,
                message: format!(
                    "relative RMSD swings by {:.2} % of torque from cycle to cycle, {} {:.2} %; look \
                     for a loose bearing, belt or encoder coupling",
                    100.0 * swing,
                    usual.of_whom(),
                    100.0 * usual.swing
                ),
                why: Why::default(),
            }
        };
        swings.iter().enumerate().map(one).collect()
    }
}

/// Usual swing with which that of a test is compared.
struct UsualSwing {
    swing: f64,
    /// Usual relative RMSD.
    level: Option<f64>,
    /// Number of other arms whose median it is; 0 for the joint's own first tests.
    peers: usize,
}

impl UsualSwing {
    /// Least swing that is out, for a test of this relative RMSD.
    fn limit(&self, ratio: f64, level: Option<f64>) -> f64 {
        let level = level.zip(self.level).map_or(1.0, |(now, usual)| (now / usual).max(1.0));
        (ratio * self.swing * level).max(MIN_SWING)
    }

    fn of_whom(&self) -> String {
        match self.peers {
            0 => "usually".into(),
            1 => "in another arm of this model".into(),
            peers => format!("in {peers} other arms of this model"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::runs::detect_among;
    use crate::detect::runs::fixtures::{JOINT, judged, run};
    use armwatch_model::anomaly::RunSummary;
    use armwatch_model::anomaly::peer::Peer;
    use armwatch_model::anomaly::settings::DetectSettings;

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

    /// Table 5.1 of the thesis: tests of joint 5 of robot 1 with 20 to 24 cycles, its joints 3 and 4, and joint 4 of
    /// robot 2 as the arm with healthy joints. The thesis has no separate values of joint 5 of robot 2.
    #[test]
    fn the_joint_of_the_thesis_that_always_swung_is_found_beside_its_twin() {
        const BAD: [(f64, f64); 4] =
            [(0.0921, 0.009751), (0.0837, 0.00512), (0.0931, 0.006487), (0.1063, 0.00992)];
        const TWIN: [f64; 4] = [0.002978, 0.002949, 0.00291, 0.002739];
        const HEALTHY: [[f64; 4]; 2] =
            [[0.002, 0.001308, 0.001188, 0.001736], [0.001609, 0.00128, 0.001599, 0.001997]];
        let peers = |swings: &[f64]| {
            let tests = swings.iter().enumerate().map(|(i, swing)| run(i, 12.0, 0.11, *swing).joints);
            vec![Peer { robot: "Robot 2".into(), tests: tests.collect() }]
        };
        let found = |tests: Vec<RunSummary>, twin: &[f64]| {
            let found = detect_among(&tests, &peers(twin), &DetectSettings::default()).anomalies;
            found.into_iter().filter(|of| of.kind == AnomalyKind::Oscillation).collect::<Vec<_>>()
        };
        let bad: Vec<RunSummary> =
            BAD.iter().enumerate().map(|(i, (level, swing))| run(i, 12.0, *level, *swing)).collect();
        // compared with the worst healthy joint of both arms, and with the usual ones
        for twin in [&TWIN[..], &HEALTHY[0], &HEALTHY[1]] {
            let of = found(bad.clone(), twin);
            assert!(!of.is_empty(), "{twin:?}");
            assert_eq!((of[0].first_run_id, of[0].joint), (1, Some(JOINT)));
            assert!(of[0].severity >= Severity::Info && of[0].message.contains("another arm"), "{of:?}");
        }
        let beside_usual = found(bad, &HEALTHY[1]);
        assert!(beside_usual.len() == 1 && beside_usual[0].severity >= Severity::Warning, "{beside_usual:?}");
        for own in HEALTHY.iter().chain([&TWIN]) {
            let tests: Vec<RunSummary> =
                own.iter().enumerate().map(|(i, swing)| run(i, 12.0, 0.11, *swing)).collect();
            for twin in HEALTHY.iter().chain([&TWIN]) {
                assert_eq!(found(tests.clone(), twin), vec![], "{own:?} beside {twin:?}");
            }
        }
    }

    #[test]
    fn swings_of_a_good_fit_and_a_short_history_are_quiet() {
        assert_eq!(severities(&[0.001, 0.001, 0.001, 0.001, 0.001, 0.0039]), [None; 6]);
        assert_eq!(severities(&[0.002, 0.002, 0.002, 0.05]), [None; 4]);
    }
}
