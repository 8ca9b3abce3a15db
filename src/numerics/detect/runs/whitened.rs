//! Least squares of a level and a pattern over tests that remember each other.

use crate::analysis::Estimate;
use crate::numerics::statistics::descriptive::median;

/// What is known of how much a quantity scatters from test to test.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scatter {
    /// Standard deviation of a test about the level.
    pub(super) deviation: f64,
    /// Lag-1 autocorrelation.
    pub(super) correlation: f64,
    /// Tests that both stand on.
    pub(super) freedom: f64,
}

/// Values of which each is independent of those before, each with its weight.
pub(super) struct Whitened {
    correlation: f64,
    /// Values and roots of their weights.
    values: Vec<f64>,
    roots: Vec<f64>,
}

/// Level and size of a pattern.
pub(super) struct Fit {
    pub(super) level: f64,
    pub(super) size: f64,
    pub(super) size_error: f64,
    /// Weighted sum of squares that is left.
    pub(super) rest: f64,
}

impl Whitened {
    /// Of tests, oldest first.
    pub(super) fn new(tests: &[Estimate], scatter: &Scatter) -> Self {
        let correlation = scatter.correlation;
        // most of a standard error is alike in all tests: it says which ones are less certain than usual, no more
        let usual = median(&tests.iter().map(|of| of.std_error).collect::<Vec<f64>>()).unwrap_or(0.0);
        let root = |(place, of): (usize, &Estimate)| {
            let first = if place == 0 { 1.0 } else { (1.0 - correlation * correlation).sqrt() };
            let less_certain = if usual > 0.0 { (of.std_error / usual).max(1.0) } else { 1.0 };
            (first * scatter.deviation * less_certain).recip()
        };
        let mut whitened =
            Self { correlation, values: Vec::new(), roots: tests.iter().enumerate().map(root).collect() };
        whitened.values = whitened.of(|i| tests[i].value);
        whitened
    }

    /// A pattern, whitened as the values are.
    fn of(&self, pattern: impl Fn(usize) -> f64) -> Vec<f64> {
        let one = |i: usize| match i {
            0 => pattern(0),
            _ => pattern(i) - self.correlation * pattern(i - 1),
        };
        (0..self.roots.len()).map(|i| self.roots[i] * one(i)).collect()
    }

    /// Least squares of a level and a pattern.
    pub(super) fn fit(&self, pattern: impl Fn(usize) -> f64) -> Fit {
        let (level, pattern) = (self.of(|_| 1.0), self.of(pattern));
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (aa, ab, bb) = (dot(&level, &level), dot(&level, &pattern), dot(&pattern, &pattern));
        let (ay, by) = (dot(&level, &self.values), dot(&pattern, &self.values));
        let determinant = aa * bb - ab * ab;
        let (at_start, size) = ((bb * ay - ab * by) / determinant, (aa * by - ab * ay) / determinant);
        Fit {
            level: at_start,
            size,
            size_error: (aa / determinant).sqrt(),
            rest: dot(&self.values, &self.values) - at_start * ay - size * by,
        }
    }

    /// The same of a jump with the test at the place `begin`.
    pub(super) fn jump(&self, begin: usize) -> Fit {
        self.fit(|i| f64::from(u8::from(i >= begin)))
    }
}
