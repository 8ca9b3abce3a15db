//! What every detector is told, and what it says of a run.

use crate::anomaly::{Alternative, Severity};

/// When a change counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectSettings {
    /// Runs that form a joint's baseline; below this many the joint is learning.
    pub baseline_runs: usize,
    /// Relative change of friction that is a warning.
    pub drift_warning: f64,
    /// Relative change of friction that is critical.
    pub drift_critical: f64,
    /// False alarms of a robot and year that may be, by chance, in all joints, kinds and quantities together.
    pub false_alarms_per_robot_year: f64,
    /// Change of friction, in standard deviations of its smoothed value, that could be chance; `None`: what follows from
    /// the rate of false alarms.
    pub drift_sigma: Option<f64>,
    /// Ratio of the RMSD's swing to its baseline that is an oscillation.
    pub oscillation_ratio: f64,
    /// Relative RMSD that is a warning.
    pub accuracy_warning: f64,
    /// Relative RMSD that is critical.
    pub accuracy_critical: f64,
    /// Usual intervals between tests after which the next one is overdue.
    pub overdue_factor: f64,
}

impl Default for DetectSettings {
    fn default() -> Self {
        Self {
            baseline_runs: 5,
            drift_warning: 0.05,
            drift_critical: 0.15,
            false_alarms_per_robot_year: 1.0,
            drift_sigma: None,
            oscillation_ratio: 3.0,
            accuracy_warning: 0.10,
            accuracy_critical: 0.15,
            overdue_factor: 4.0,
        }
    }
}

/// Odds beyond which no model is believed.
pub(super) const MOST_ODDS: f64 = 1e9;

/// What one run says of one quantity.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// Not measured, or not comparable.
    Unknown,
    /// As expected.
    Quiet,
    /// Out of bounds; the fields are those of [`crate::anomaly::Anomaly`].
    Out {
        severity: Severity,
        score: f64,
        threshold: f64,
        value: f64,
        baseline: f64,
        message: String,
        why: Why,
    },
}

/// What a comparison of causes adds to a verdict.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Why {
    /// Place in the history of the run in which the change began, and the cycle, where that is better known than by
    /// the first verdict.
    pub(super) onset: Option<(usize, Option<u32>)>,
    /// Odds of the cause against all others together.
    pub(super) odds: Option<f64>,
    /// The rejected causes, the likeliest first.
    pub(super) alternatives: Vec<Alternative>,
}

/// A figure and its limit with as few decimals, up to three, as tell them apart.
pub(super) fn apart(figure: f64, limit: f64) -> [String; 2] {
    (0..3)
        .map(|decimals| [figure, limit].map(|of| format!("{of:.decimals$}")))
        .find(|[figure, limit]| figure != limit)
        .unwrap_or_else(|| [figure, limit].map(|of| format!("{of:.3}")))
}
