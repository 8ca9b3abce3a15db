//! Causes that a curve may differ for, and how well each explains it.
//!
//! The differences `d` of a run from the usual curve are held against few-parameter patterns: nothing, a factor, an
//! excess at the start, another time constant of the warm-up, a step at a cycle, scatter from cycle to cycle. Each
//! may come with a part that all joints have in common (hall, lubricant), whose coefficient is near one. A cause is
//! judged by its maximal likelihood with the price of its parameters (Schwarz 1978): `ln p = -chi²/2 - k/2 ln n` with
//! a prior of the cause.

use nalgebra::{DMatrix, DVector};

use super::template::Template;
use crate::numerics::detect::runs::friction_history::COMMON_SPREAD;

/// Part of the largest difference that the patterns may miss: they are models.
const PATTERN_ERROR: f64 = 0.05;
/// Standard deviation of a cycle's difference under a cause that is not known.
const ANYTHING: f64 = 0.3;
/// Price of such a cause, in parameters: any named one that fits is likelier.
const UNKNOWN_PARAMETERS: f64 = 3.0;
/// Factors of the slow time constant that are tried.
const FACTORS: [f64; 12] = [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.25, 1.4, 1.6, 2.0, 2.5, 3.0];
/// Least scatter that is a cause of its own, as a multiple of the usual.
const LEAST_SCATTER_FACTOR: f64 = 2.0;

/// Why a curve differs from the usual one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::numerics::detect::runs) enum Cause {
    /// It does not.
    None,
    /// Friction is larger by the same factor in all cycles; its natural logarithm.
    Scale(f64),
    /// The joint began colder or warmer; as a part of the usual excess.
    Start(f64),
    /// The slow time constant of the warm-up is so many times as long.
    TimeConstant(f64),
    /// Friction jumps with this cycle by this logarithm.
    Step { cycle: u32, size: f64 },
    /// Friction varies from cycle to cycle with this standard deviation, in logarithms.
    Scatter(f64),
    /// None of these explains it.
    Unknown,
}

impl Cause {
    /// What it would be, in words that follow "rather than".
    pub(in crate::numerics::detect::runs) fn words(&self) -> String {
        match self {
            Self::None => "no change".into(),
            Self::Scale(size) => format!("{:+.0} % friction in all cycles", 100.0 * size.exp_m1()),
            Self::Start(_) => "another warmth at the start".into(),
            Self::TimeConstant(factor) => format!("a warm-up {factor:.1} times as slow"),
            Self::Step { cycle, size } => {
                format!("a step of {:+.0} % with cycle {cycle}", 100.0 * size.exp_m1())
            }
            Self::Scatter(size) => format!("scatter of {:.0} % from cycle to cycle", 100.0 * size),
            Self::Unknown => "a cause that is not known".into(),
        }
    }
}

/// A cause with its logarithmic posterior, up to a constant that all causes share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::numerics::detect::runs) struct Judged {
    pub(in crate::numerics::detect::runs) cause: Cause,
    pub(in crate::numerics::detect::runs) log_posterior: f64,
}

/// One run of a joint.
pub(super) struct Evidence<'a> {
    /// Numbers of the cycles.
    pub(super) cycles: &'a [u32],
    /// Their times, min.
    pub(super) minutes: &'a [f64],
    /// Differences from the usual curve.
    pub(super) differences: &'a [f64],
    /// What the other joints have in common.
    pub(super) common: &'a [f64],
    /// Standard deviation of one cycle.
    pub(super) scatter: f64,
}

impl Evidence<'_> {
    /// Every cause with its posterior, the likeliest first. `prior` is the logarithm of the odds of any named cause
    /// against none.
    pub(super) fn judge(&self, template: &Template, prior: f64) -> Vec<Judged> {
        let n = self.cycles.len();
        let price = 0.5 * (n as f64).ln();
        let one = DVector::from_element(n, 1.0);
        let excess = DVector::from_fn(n, |i, _| template.excess(self.minutes[i]));
        let mut found = vec![Judged { cause: Cause::None, log_posterior: self.log_likelihood(&[], None).1 }];
        let mut add = |cause: Cause, likelihood: f64, parameters: f64| {
            found.push(Judged { cause, log_posterior: likelihood + prior - parameters * price });
        };
        let (sizes, likelihood) = self.log_likelihood(std::slice::from_ref(&one), None);
        add(Cause::Scale(sizes[0]), likelihood, 1.0);
        if excess.amax() > 0.0 {
            let (sizes, likelihood) = self.log_likelihood(std::slice::from_ref(&excess), None);
            add(Cause::Start(sizes[0]), likelihood, 1.0);
            let slower = |factor: f64| DVector::from_fn(n, |i, _| template.slower(factor, self.minutes[i]));
            let best = FACTORS.iter().map(|&of| (of, self.log_likelihood(&[], Some(&slower(of))).1));
            if let Some((factor, likelihood)) = best.max_by(|a, b| a.1.total_cmp(&b.1)) {
                add(Cause::TimeConstant(factor), likelihood, 1.0);
            }
        }
        // one cycle alone is no level; the cycles before are the usual curve's
        for first in 1..n.saturating_sub(1) {
            let after = DVector::from_fn(n, |i, _| f64::from(u8::from(i >= first)));
            let (sizes, likelihood) = self.log_likelihood(&[after], None);
            add(Cause::Step { cycle: self.cycles[first], size: sizes[0] }, likelihood, 2.0);
        }
        let (size, likelihood) = self.scattered();
        if size > LEAST_SCATTER_FACTOR * self.scatter {
            add(Cause::Scatter(size), likelihood, 1.0);
        }
        add(Cause::Unknown, self.anything(), UNKNOWN_PARAMETERS);
        found.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        found
    }

    /// Standard deviation of one cycle, with what patterns may miss.
    fn sigma(&self) -> f64 {
        let largest = self.differences.iter().fold(0.0_f64, |largest, d| largest.max(d.abs()));
        self.scatter.hypot(PATTERN_ERROR * largest)
    }

    /// Sizes of the patterns and the logarithm of the likelihood, up to a constant. `known` is a pattern of known size.
    fn log_likelihood(&self, patterns: &[DVector<f64>], known: Option<&DVector<f64>>) -> (Vec<f64>, f64) {
        let n = self.cycles.len();
        let sigma = self.sigma();
        let common = DVector::from_row_slice(self.common);
        let mut target = DVector::from_row_slice(self.differences) - &common;
        if let Some(known) = known {
            target -= known;
        }
        // the last column is the share in common, with its prior as a further row
        let columns = patterns.len() + 1;
        let x = DMatrix::from_fn(n + 1, columns, |i, k| match (i < n, k + 1 == columns) {
            (true, false) => patterns[k][i] / sigma,
            (true, true) => common[i] / sigma,
            (false, true) => 1.0 / COMMON_SPREAD,
            (false, false) => 0.0,
        });
        let y = DVector::from_fn(n + 1, |i, _| if i < n { target[i] / sigma } else { 0.0 });
        let Ok(solved) = x.clone().svd(true, true).solve(&y, 1e-12) else {
            return (vec![0.0; patterns.len()], f64::NEG_INFINITY);
        };
        let chi_square = (&y - &x * &solved).norm_squared();
        let likelihood = -0.5 * chi_square - n as f64 * sigma.ln();
        (solved.iter().take(patterns.len()).copied().collect(), likelihood)
    }

    /// Logarithm of the likelihood if each cycle may have any friction: normal with a wide standard deviation.
    fn anything(&self) -> f64 {
        let sum: f64 = self.differences.iter().map(|d| d * d).sum();
        -0.5 * sum / (ANYTHING * ANYTHING) - self.cycles.len() as f64 * ANYTHING.ln()
    }

    /// Standard deviation about a constant, and the logarithm of the likelihood of normal scatter with it.
    fn scattered(&self) -> (f64, f64) {
        let n = self.cycles.len();
        let one = DVector::from_element(n, 1.0);
        let sigma = self.sigma();
        let (_, likelihood) = self.log_likelihood(&[one], None);
        let chi_square = -2.0 * (likelihood + n as f64 * sigma.ln());
        let freedom = (n as f64 - 1.0).max(1.0);
        let size = (chi_square / freedom).sqrt() * sigma;
        let price = 0.5 * (n as f64).ln();
        (size, -0.5 * freedom - n as f64 * size.max(self.scatter).ln() - price)
    }
}
