//! Fleet: a joint of an arm differs from the same joint of other arms of its model.
//!
//! The detector compares medians of first tests, of this arm and of each other one, so that later changes do not
//! matter: friction of the warm joint at the same speed and about the same temperature, and the relative RMSD of the
//! excitation stage. Healthy arms of one model differ much: the friction of two in the thesis differs by half (Appendix
//! H). The limit is the quantile of Student's distribution that one healthy joint in ten thousand exceeds, for the
//! logarithm of this arm's value less the median of the others. The variance between arms is that of the others, shrunk
//! towards 0.25² for friction and 0.2² for the RMSD, which count as eight arms. The severity of a difference is
//! `info` if there are fewer than four other arms.

use crate::detect::control_chart::median_variance;
use crate::detect::detector::Detector;
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::{median, robust_deviation};
use crate::statistics::distributions::student_quantile;
use armwatch_model::analysis::JointSummary;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Fewest first tests of an arm.
const FEWEST_TESTS: usize = 3;
/// Fewest other arms for a warning.
const PEERS_OF_WARNING: usize = 4;
/// Probability that a healthy joint is beyond the limit, once in its life.
const CHANCE: f64 = 1e-4;
/// Usual standard deviations of logarithms between healthy arms, and the number of arms that these are worth.
const FRICTION_SPREAD: f64 = 0.25;
const RMSD_SPREAD: f64 = 0.2;
const PRIOR_ARMS: f64 = 8.0;
/// Relative RMSD below which a fit is good, whatever the others.
const GOOD_RMSD: f64 = 0.05;
/// Tests are comparable if their points are within this fraction of the time of this arm's.
const WARMTH_TOLERANCE: f64 = 0.25;

/// The compared quantity.
pub(super) enum UnlikePeers {
    Friction,
    Accuracy,
}

impl UnlikePeers {
    /// The value of a joint in one test. `like` is a test of the checked arm.
    fn figure(&self, of: &JointSummary, like: &JointSummary) -> Option<f64> {
        match self {
            Self::Friction => {
                let (of, like) = (of.warm_friction?, like.warm_friction?);
                let is_alike = (of.speed_fraction - like.speed_fraction).abs() < 1e-6
                    && (of.minute - like.minute).abs() <= WARMTH_TOLERANCE * like.minute;
                Some(of.torque).filter(|torque| is_alike && *torque > 0.0)
            }
            Self::Accuracy => of.relative_rmsd.filter(|rmsd| *rmsd > 0.0),
        }
    }

    fn has_figure(&self, of: &JointSummary) -> bool {
        self.figure(of, of).is_some()
    }

    fn usual_spread(&self) -> f64 {
        match self {
            Self::Friction => FRICTION_SPREAD,
            Self::Accuracy => RMSD_SPREAD,
        }
    }

    /// Returns true if a difference matters.
    fn counts(&self, own: f64) -> bool {
        match self {
            Self::Friction => true,
            Self::Accuracy => own >= GOOD_RMSD,
        }
    }

    fn message(&self, own: f64, usual: f64, peers: usize) -> String {
        let others = if peers == 1 { "one other arm".to_owned() } else { format!("{peers} other arms") };
        let times = own / usual;
        match self {
            Self::Friction => format!(
                "friction was {times:.1} times that of {others} of this model from its first tests on ({own:.3} against \
                 {usual:.3} Nm); check lubricant and preload, and whether the description fits this arm"
            ),
            Self::Accuracy => format!(
                "the model leaves {:.1} % of the torque unexplained from the first tests on, in {others} of this model \
                 {:.1} %; check mounting, cables and the torque signal of this joint",
                100.0 * own,
                100.0 * usual
            ),
        }
    }
}

impl Detector<JointSeries<'_>> for UnlikePeers {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Fleet
    }

    fn quantity(&self, _: &JointSeries<'_>) -> Quantity {
        match self {
            Self::Friction => Quantity::FrictionOfModel,
            Self::Accuracy => Quantity::RmsdOfModel,
        }
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let unknown = || vec![Verdict::Unknown; series.runs.len()];
        let Some(like) = series.runs.iter().flatten().find(|of| self.has_figure(of)) else {
            return unknown();
        };
        let peers: Vec<f64> = series.of_peers(|of| self.figure(of, like)).into_iter().map(f64::ln).collect();
        let Some(usual) = median(&peers) else { return unknown() };
        let limit = limit(&peers, self.usual_spread());
        let count = series.settings.baseline_runs.max(FEWEST_TESTS);
        let mut first: Vec<f64> = Vec::new();
        let verdict = |of: &Option<&JointSummary>| {
            let figure = of.and_then(|of| self.figure(of, like));
            first.extend(figure.filter(|_| first.len() < count));
            let Some(own) = median(&first).filter(|_| figure.is_some() && first.len() >= FEWEST_TESTS) else {
                return Verdict::Unknown;
            };
            let score = own.ln() - usual;
            // less friction than others and a better fit need no check
            if score < limit || !self.counts(own) {
                return Verdict::Quiet;
            }
            Verdict::Out {
                severity: match peers.len() {
                    PEERS_OF_WARNING.. => Severity::Warning,
                    _ => Severity::Info,
                },
                score,
                threshold: limit,
                value: own,
                baseline: usual.exp(),
                message: self.message(own, usual.exp(), peers.len()),
                why: Why::default(),
            }
        };
        series.runs.iter().map(verdict).collect()
    }
}

/// Limit of the difference from the median of `peers`, logarithms.
fn limit(peers: &[f64], usual_spread: f64) -> f64 {
    let (arms, own) = (peers.len() as f64, robust_deviation(peers).unwrap_or(0.0));
    let variance = (PRIOR_ARMS * usual_spread.powi(2) + arms * own * own) / (PRIOR_ARMS + arms);
    let of_difference = variance + median_variance(variance.sqrt(), peers.len());
    student_quantile(1.0 - CHANCE, PRIOR_ARMS + arms - 1.0) * of_difference.sqrt()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::detect::runs::detect_among;
    use crate::detect::runs::fixtures::{JOINT, run, wobble};
    use armwatch_model::anomaly::Anomaly;
    use armwatch_model::anomaly::peer::Peer;
    use armwatch_model::anomaly::settings::DetectSettings;

    fn peers(frictions: &[f64]) -> Vec<Peer> {
        let test = |friction: f64| move |i: usize| run(i, friction * wobble(i), 0.03, 0.002).joints;
        let peer = |(number, friction): (usize, &f64)| Peer {
            robot: format!("R{number}"),
            tests: (0..5).map(test(*friction)).collect(),
        };
        frictions.iter().enumerate().map(peer).collect()
    }

    fn found(tests: usize, friction: f64, rmsd: f64, others: &[f64]) -> Vec<Anomaly> {
        let history: Vec<_> = (0..tests).map(|i| run(i, friction * wobble(i), rmsd, 0.002)).collect();
        let mut found = detect_among(&history, &peers(others), &DetectSettings::default()).anomalies;
        found.retain(|of| of.kind == AnomalyKind::Fleet);
        found
    }

    #[test]
    fn an_arm_of_much_more_friction_than_its_peers_is_told_from_its_third_test_on() {
        let others = [10.0, 12.0, 14.0, 11.0, 9.0];
        assert_eq!(found(2, 60.0, 0.03, &others), vec![]);
        let of = &found(12, 60.0, 0.03, &others)[0];
        assert_eq!((of.joint, of.severity, of.first_run_id), (Some(JOINT), Severity::Warning, 3));
        assert!((of.baseline - 11.0).abs() < 0.2 && (of.value - 60.0).abs() < 0.8, "{of:?}");
        assert!(!of.ended && of.last_run_id == 12, "it stays until somebody settles it");
    }

    /// Arms with a spread wider than usual: few of them are beyond the limit.
    #[test]
    fn healthy_arms_of_an_uneven_model_are_seldom_unlike_it() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for spread in [0.15, 0.3, 0.45] {
            let (mut beyond, count) = (0, 20_000);
            for arms in 0..count {
                let mut draw = || spread * rng.sample::<f64, _>(StandardNormal);
                let peers: Vec<f64> = (0..4 + arms % 8).map(|_| draw()).collect();
                beyond += usize::from(draw() - median(&peers).unwrap() > limit(&peers, FRICTION_SPREAD));
            }
            println!("spread {spread}: {beyond} of {count} healthy joints beyond the limit");
            assert!(beyond * 200 <= count, "spread {spread}: {beyond} of {count}");
        }
    }

    #[test]
    fn half_more_friction_is_usual_and_one_twin_gives_no_warning() {
        assert_eq!(found(12, 17.0, 0.03, &[11.0]), vec![]);
        assert_eq!(found(12, 17.0, 0.03, &[10.0, 12.0, 14.0, 11.0, 9.0]), vec![]);
        assert_eq!(found(12, 2.0, 0.03, &[10.0, 12.0, 14.0, 11.0, 9.0]), vec![], "less needs no look");
        let of_one = found(12, 160.0, 0.03, &[11.0]);
        assert_eq!(of_one[0].severity, Severity::Info);
        assert_eq!(found(12, 160.0, 0.03, &[]), vec![]);
    }

    #[test]
    fn a_bad_fit_among_good_ones_is_told() {
        let others = [10.0, 12.0, 14.0, 11.0, 9.0];
        let of = found(8, 11.0, 0.11, &others);
        assert_eq!(of.len(), 1, "{of:?}");
        assert_eq!((of[0].quantity, of[0].severity), (Quantity::RmsdOfModel, Severity::Warning));
        assert_eq!(found(8, 11.0, 0.045, &others), vec![]);
    }
}
