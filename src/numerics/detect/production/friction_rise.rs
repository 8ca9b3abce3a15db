//! Drift of friction in ordinary work: a joint needs more friction than in the first logs after the last
//! test, and the other joints do not.
//!
//! The quantity is the friction of a log as a multiple of the test's friction, divided by the median of this
//! multiple over the joints that move: the warmth of the whole arm cancels. Logs with another load
//! ([`load_change`]) are left out. The baseline is the median of the first [`LEARNING_LOGS`] logs. A log is
//! out if the EWMA of the difference from the baseline reaches 0.15 of the test's friction, or 4 standard
//! deviations of the EWMA if that is more. It is critical from 0.30 on ([`LIMITS`]). Less friction is never
//! out. Section "Watched between tests" of docs/production-logs.md counts false alarms and logs until wear is
//! found with these limits.

use super::load_change;
use super::series::{JointLogs, LEARNING_LOGS};
use crate::analysis::ProductionJoint;
use crate::anomaly::{AnomalyKind, ProductionSummary};
use crate::numerics::detect::control_chart::{EWMA_WEIGHT, Ewma, Limits, median_variance, steady_variance};
use crate::numerics::detect::detector::Detector;
use crate::numerics::detect::verdict::{Verdict, Why};
use crate::numerics::statistics::descriptive::{median, robust_deviation};

/// Joints that must move for what is common to them to be called warmth: of three, one that wears does not
/// move the median by more than the others differ.
const FEWEST_JOINTS: usize = 3;

/// Friction beyond the other joints'. Tests warn at a third of it: they move all joints alike and know how
/// warm each is.
const LIMITS: Limits = Limits { warning: 0.15, critical: 0.30, sigma: 4.0 };

/// Smallest standard deviation from log to log that a few logs are believed to have: joints of one arm warm
/// up at different rates, and a morning's log of a cold arm shows it.
const MIN_SPREAD: f64 = 0.03;

pub(super) struct FrictionRise;

impl Detector<JointLogs<'_>> for FrictionRise {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Drift
    }

    fn quantity(&self, _: &JointLogs<'_>) -> &'static str {
        "production_friction"
    }

    fn judge(&self, series: &JointLogs<'_>) -> Vec<Verdict> {
        let mut verdicts = vec![Verdict::Unknown; series.history.len()];
        let other_load = load_change::with_other_load(series);
        let ratio = |log: usize| match other_load[log] {
            true => None,
            false => friction_ratio(series, log),
        };
        // changes from log to log that were no anomaly
        let mut usual: Vec<f64> = Vec::new();
        for since_test in series.by_test(ratio) {
            let level = since_test.level;
            let mut chart = Ewma::new(0.0);
            for (place, (log, ratio)) in since_test.values.into_iter().enumerate() {
                let change = ratio - level;
                if place < LEARNING_LOGS {
                    verdicts[log] = Verdict::Quiet;
                    usual.push(change);
                    continue;
                }
                let smoothed = chart.add(change, EWMA_WEIGHT);
                let spread = robust_deviation(&usual).unwrap_or(0.0).max(MIN_SPREAD);
                let threshold = LIMITS.threshold(spread * smoothed_deviation());
                let Some(severity) = LIMITS.severity(smoothed, threshold) else {
                    verdicts[log] = Verdict::Quiet;
                    usual.push(change);
                    continue;
                };
                verdicts[log] = Verdict::Out {
                    severity,
                    score: smoothed,
                    threshold,
                    value: ratio,
                    baseline: level,
                    message: message(change, level, &series.history[log]),
                    why: Why::default(),
                };
            }
        }
        verdicts
    }
}

fn message(change: f64, level: f64, log: &ProductionSummary) -> String {
    format!(
        "in ordinary work friction is {:.0} % above that of the first logs since the last test{}; check \
         lubrication, gearbox and brake, and run a test",
        100.0 * change / level,
        if log.joints.len() < FEWEST_JOINTS { "" } else { ", and not in the other joints" }
    )
}

/// Friction of a log as a multiple of the test's, over that of the other joints: what all joints have in
/// common is how warm the arm was. `None` where the joint does not move.
fn friction_ratio(series: &JointLogs<'_>, log: usize) -> Option<f64> {
    let multiple = |of: &ProductionJoint| 1.0 + of.friction.excess;
    let own = series.of(log).map(multiple)?;
    let joints = &series.history[log].joints;
    if joints.len() < FEWEST_JOINTS {
        return Some(own);
    }
    let common = median(&joints.iter().map(multiple).collect::<Vec<_>>())?;
    (common > 0.0).then_some(own / common)
}

/// Standard deviation of the smoothed change over that of one log: the average's, and that of the baseline.
fn smoothed_deviation() -> f64 {
    (steady_variance(1.0) + median_variance(1.0, LEARNING_LOGS)).sqrt()
}

#[cfg(test)]
mod tests;
