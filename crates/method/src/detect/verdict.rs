//! The verdict of a detector about one run.

use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Alternative, Severity};

/// Upper limit of reported odds.
pub(super) const MOST_ODDS: f64 = 1e9;

/// Result of one run for one quantity.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    /// Not measured, or not comparable.
    Unknown,
    /// As expected.
    Quiet,
    /// Out of bounds; the fields are those of [`armwatch_model::anomaly::Anomaly`].
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

/// Additions of a comparison of causes to a verdict.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Why {
    /// Place in the history of the first run with the change, and the cycle, if the comparison dates the onset better
    /// than the first verdict.
    pub(super) onset: Option<(usize, Option<u32>)>,
    /// The quantity that shows the cause, if it is not the detector's.
    pub(super) quantity: Option<Quantity>,
    /// Odds of the cause against all others together.
    pub(super) odds: Option<f64>,
    /// The rejected causes, the likeliest first.
    pub(super) alternatives: Vec<Alternative>,
}

/// A value and its limit with as few decimals, up to three, as make them differ.
pub(super) fn apart(figure: f64, limit: f64) -> [String; 2] {
    (0..3)
        .map(|decimals| [figure, limit].map(|of| format!("{of:.decimals$}")))
        .find(|[figure, limit]| figure != limit)
        .unwrap_or_else(|| [figure, limit].map(|of| format!("{of:.3}")))
}
