//! A steady rise: friction grows from test to test, by less than a change that is a warning alone.
//!
//! Wear continues. A rise that is more than chance is therefore reported at half of `drift_warning`, and relative to
//! the joint's own level before it: a run-in joint has less friction than in its first tests, and its wear would
//! otherwise show late. The latest [`WINDOW`] tests are fitted as a constant level and a line that begins at any of
//! them, by least squares on whitened values: an autoregression of order one with the joint's own scatter. A test that
//! is less certain than usual counts for less. A rise counts if
//!
//! * its slope is beyond chance by Student's distribution, with the channel's probability at the set rate of false
//!   alarms divided by the number of tried beginnings,
//! * it is three times as likely as a level that jumps at any test,
//! * it is three standard errors of the joint's share in a change of all joints' friction and thermal correction.
//!
//! Only the friction index is checked. Seasons change friction torques for months in the same way as wear.

use crate::detect::rate::budget::beyond_chance;
use crate::detect::runs::history::friction_history::{FrictionHistory, Observed, Source, share_deviation};
use crate::detect::runs::history::whitened::Whitened;
use armwatch_model::analysis::Estimate;

/// Most tests in a fit: a slower rise reaches the limit of a change before it is distinguished from chance.
const WINDOW: usize = 40;
/// Fewest tests before the beginning and from it on.
const FEWEST: usize = 5;
/// Least rise that counts, as a part of the warning limit of a change.
const PART_OF_WARNING: f64 = 0.5;
/// Logarithm of the least likelihood ratio of a rise to a jump: three.
const LEAD: f64 = 1.1;
/// Standard errors of the joint's share in a change of all joints.
const SHARE_ERRORS: f64 = 3.0;

/// Scatter of a quantity from test to test.
#[derive(Debug, Clone, Copy)]
pub(in crate::detect::runs) struct Scatter {
    /// Standard deviation of a test about the level.
    pub(in crate::detect::runs) deviation: f64,
    /// Lag-1 autocorrelation.
    pub(in crate::detect::runs) correlation: f64,
    /// Number of tests of both estimates.
    pub(in crate::detect::runs) freedom: f64,
}

/// A rise that is more than chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rise {
    /// Place in the history of the first test with the rise.
    pub(in crate::detect::runs) run: usize,
    /// Level before it, as a multiple of the baseline.
    pub(in crate::detect::runs) level: f64,
    /// Growth per test, and until the latest test, as fractions of the baseline.
    pub(in crate::detect::runs) rate: f64,
    pub(in crate::detect::runs) size: f64,
    /// Number of tests with the rise.
    pub(in crate::detect::runs) tests: usize,
    /// Least size that counts.
    pub(in crate::detect::runs) least: f64,
}

/// Least rise that counts, if a change of `warning` is a warning alone.
pub(super) fn least_rise(warning: f64) -> f64 {
    PART_OF_WARNING * warning
}

/// The rise that the latest of `tests` belongs to. `tests` are comparable with each other, oldest first; `alpha` is the
/// probability of a false alarm of the channel per test.
pub(super) fn steady_rise(
    friction: &FrictionHistory,
    tests: &[Observed],
    scatter: &Scatter,
    alpha: f64,
    warning: f64,
) -> Option<Rise> {
    if friction.source != Source::Index || tests.iter().any(|of| of.source != Source::Index) {
        return None;
    }
    let tests = &tests[tests.len().saturating_sub(WINDOW)..];
    if !is_higher(tests, least_rise(warning)) {
        return None;
    }
    let begins = FEWEST..(tests.len() + 1).checked_sub(FEWEST)?;
    let tried = begins.len().max(1) as f64;
    let of = |of: &Observed| Estimate { value: of.ratio, std_error: of.std_error };
    let estimates: Vec<Estimate> = tests.iter().map(of).collect();
    let whitened = Whitened::new(&estimates, scatter.deviation, scatter.correlation);
    let line = |begin: usize| move |i: usize| if i < begin { 0.0 } else { (i - begin + 1) as f64 };
    let fits = begins.map(|begin| (begin, whitened.fit(line(begin))));
    let (begin, fit) = fits.min_by(|a, b| a.1.rest.total_cmp(&b.1.rest))?;
    let count = tests.len() - begin;
    let size = fit.size * count as f64;
    let latest = tests.last()?;
    let since = |part: fn(&Observed) -> f64| {
        part(latest) - tests[..begin].iter().map(part).sum::<f64>() / begin as f64
    };
    let of_share = SHARE_ERRORS * share_deviation(since(Observed::common), since(Observed::thermal));
    let least = least_rise(warning).max(of_share);
    // cheap conditions first
    if size < least || fit.size < beyond_chance(alpha / tried, scatter.freedom) * fit.size_error {
        return None;
    }
    let best_jump = whitened.jumps().iter().map(|of| of.rest).fold(f64::INFINITY, f64::min);
    (fit.rest + 2.0 * LEAD <= best_jump).then_some(Rise {
        run: tests[begin].run,
        level: fit.level,
        rate: fit.size,
        size,
        tests: count,
        least,
    })
}

/// Returns true if the latest tests are so far above the lowest ones that a line between them may rise by `least`: a
/// cheap condition. The mean of the latest five of a line of five tests is three fifths of its rise.
fn is_higher(tests: &[Observed], least: f64) -> bool {
    let means = || tests.windows(FEWEST).map(|of| of.iter().map(|of| of.ratio).sum::<f64>() / FEWEST as f64);
    let lowest = means().fold(f64::INFINITY, f64::min);
    means().next_back().is_some_and(|latest| latest - lowest >= 0.5 * least)
}

#[cfg(test)]
mod tests;
