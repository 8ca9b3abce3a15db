//! Least squares of a level and a pattern over autocorrelated tests.

use crate::statistics::descriptive::median;
use armwatch_model::analysis::Estimate;

/// Values that are independent of each other, each with its weight.
pub(in crate::detect::runs) struct Whitened {
    correlation: f64,
    /// Values and roots of their weights.
    values: Vec<f64>,
    roots: Vec<f64>,
}

/// Level and size of a pattern.
pub(in crate::detect::runs) struct Fit {
    pub(in crate::detect::runs) level: f64,
    pub(in crate::detect::runs) size: f64,
    pub(in crate::detect::runs) size_error: f64,
    /// Weighted residual sum of squares.
    pub(in crate::detect::runs) rest: f64,
}

impl Whitened {
    /// Whitens tests, oldest first, with the standard deviation of one about the level and the lag-1 autocorrelation.
    pub(in crate::detect::runs) fn new(tests: &[Estimate], deviation: f64, correlation: f64) -> Self {
        // most of a standard error is the same in all tests: it only shows which ones are less certain than usual
        let usual = median(&tests.iter().map(|of| of.std_error).collect::<Vec<f64>>()).unwrap_or(0.0);
        let root = |(place, of): (usize, &Estimate)| {
            let first = if place == 0 { 1.0 } else { (1.0 - correlation * correlation).sqrt() };
            let less_certain = if usual > 0.0 { (of.std_error / usual).max(1.0) } else { 1.0 };
            (first * deviation * less_certain).recip()
        };
        let mut whitened =
            Self { correlation, values: Vec::new(), roots: tests.iter().enumerate().map(root).collect() };
        whitened.values = whitened.of(|i| tests[i].value);
        whitened
    }

    /// A pattern, whitened like the values.
    fn of(&self, pattern: impl Fn(usize) -> f64) -> Vec<f64> {
        let one = |i: usize| match i {
            0 => pattern(0),
            _ => pattern(i) - self.correlation * pattern(i - 1),
        };
        (0..self.roots.len()).map(|i| self.roots[i] * one(i)).collect()
    }

    /// Least squares of a level and a pattern.
    pub(in crate::detect::runs) fn fit(&self, pattern: impl Fn(usize) -> f64) -> Fit {
        let (level, pattern) = (self.of(|_| 1.0), self.of(pattern));
        let sums = Sums {
            level: dot(&level, &level),
            level_pattern: dot(&level, &pattern),
            pattern: dot(&pattern, &pattern),
            level_value: dot(&level, &self.values),
            pattern_value: dot(&pattern, &self.values),
            value: dot(&self.values, &self.values),
        };
        sums.fit()
    }

    /// Fits of a jump with the test at each place from 1 on, the first place first.
    pub(in crate::detect::runs) fn jumps(&self) -> Vec<Fit> {
        let level = self.of(|_| 1.0);
        let whole = (dot(&level, &level), dot(&level, &self.values), dot(&self.values, &self.values));
        // a whitened jump is zero before its first test, that test's root there, and the level's pattern from the next
        // on
        let (mut behind, mut behind_value) = (0.0, 0.0);
        let mut fits: Vec<Fit> = (1..self.roots.len())
            .rev()
            .map(|begin| {
                let (root, value) = (self.roots[begin], self.values[begin]);
                let sums = Sums {
                    level: whole.0,
                    level_pattern: level[begin] * root + behind,
                    pattern: root * root + behind,
                    level_value: whole.1,
                    pattern_value: root * value + behind_value,
                    value: whole.2,
                };
                behind += level[begin] * level[begin];
                behind_value += level[begin] * value;
                sums.fit()
            })
            .collect();
        fits.reverse();
        fits
    }
}

/// Sums of products of a level, a pattern and the values.
struct Sums {
    level: f64,
    level_pattern: f64,
    pattern: f64,
    level_value: f64,
    pattern_value: f64,
    value: f64,
}

impl Sums {
    fn fit(&self) -> Fit {
        let determinant = self.level * self.pattern - self.level_pattern * self.level_pattern;
        let level = (self.pattern * self.level_value - self.level_pattern * self.pattern_value) / determinant;
        let size = (self.level * self.pattern_value - self.level_pattern * self.level_value) / determinant;
        Fit {
            level,
            size,
            size_error: (self.level / determinant).sqrt(),
            rest: self.value - level * self.level_value - size * self.pattern_value,
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jumps_by_running_sums_are_those_of_the_pattern() {
        let tests: Vec<Estimate> = (0..30)
            .map(|place| {
                let wave = (f64::from(place) * 2.3).sin();
                Estimate { value: wave + f64::from(u8::from(place > 11)), std_error: 0.2 + 0.1 * wave }
            })
            .collect();
        for correlation in [0.0, 0.4, -0.2] {
            let whitened = Whitened::new(&tests, 0.3, correlation);
            let jumps = whitened.jumps();
            assert_eq!(jumps.len(), 29);
            for (fit, begin) in jumps.iter().zip(1..) {
                let other = whitened.fit(|i| f64::from(u8::from(i >= begin)));
                let pairs = [
                    (fit.level, other.level),
                    (fit.size, other.size),
                    (fit.size_error, other.size_error),
                    (fit.rest, other.rest),
                ];
                for (fit, other) in pairs {
                    assert!((fit - other).abs() < 1e-9 * other.abs().max(1.0), "{begin}: {fit} {other}");
                }
            }
        }
    }
}
