//! Scatter of averages of a series about its level by chance.

use super::whitening::Likeness;
use crate::statistics::distributions::{normal_probability, student_quantile};

impl Likeness {
    /// Variance of a value about the level: `s² / (1 - f²)` with the lag-1 autocorrelation `f`.
    #[must_use]
    pub fn variance(&self) -> f64 {
        self.scale * self.scale / (1.0 - self.correlation * self.correlation)
    }

    /// Factor of the autocorrelation on the steady variance of a moving average of `weight`:
    /// `(1 + f (1 - w)) / (1 - f (1 - w))` (Schmid 1997).
    #[must_use]
    pub fn average_inflation(&self, weight: f64) -> f64 {
        let kept = self.correlation * (1.0 - weight);
        (1.0 + kept) / (1.0 - kept)
    }

    /// Factor of the autocorrelation on the variance of a mean of `count` values, at most `count`:
    /// `1 + 2 sum_k (1 - k / n) f^k`.
    #[must_use]
    pub fn mean_inflation(&self, count: usize) -> f64 {
        let n = count.max(1) as f64;
        let term = |(lag, power): (usize, f64)| 2.0 * (1.0 - lag as f64 / n) * power;
        let powers = std::iter::successors(Some(self.correlation), |power| Some(power * self.correlation));
        1.0 + (1..count).zip(powers).map(term).sum::<f64>()
    }

    /// Limit in standard deviations for an estimated scale, with the probability that `limit` has for a known one: the
    /// quantile of Student's distribution.
    #[must_use]
    pub fn estimated_limit(&self, limit: f64) -> f64 {
        -student_quantile(normal_probability(-limit), self.freedom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIKENESS: Likeness = Likeness { level: 1.0, scale: 0.01, correlation: 0.6, freedom: 10.0 };

    /// By definition: the variance of a weighted sum of values with the covariance `f^k`.
    fn variance_of_sum(weights: &[f64], correlation: f64) -> f64 {
        let mut sum = 0.0;
        for (i, of) in weights.iter().enumerate() {
            for (j, other) in weights.iter().enumerate() {
                sum += of * other * correlation.powi(i.abs_diff(j) as i32);
            }
        }
        sum
    }

    #[test]
    fn inflated_variances_are_those_of_the_weighted_sums() {
        let average: Vec<f64> = (0..60).map(|k| 0.4 * 0.6_f64.powi(k)).collect();
        let found = variance_of_sum(&average, 0.6) / (0.4 / 1.6);
        assert!((LIKENESS.average_inflation(0.4) / found - 1.0).abs() < 1e-9, "{found}");
        for count in [1, 5, 30] {
            let mean = vec![1.0 / count as f64; count];
            let found = variance_of_sum(&mean, 0.6) * count as f64;
            assert!((LIKENESS.mean_inflation(count) / found - 1.0).abs() < 1e-9, "{count} {found}");
        }
        assert!((LIKENESS.variance() - 0.0001 / 0.64).abs() < 1e-12);
    }

    #[test]
    fn few_values_need_wider_limits() {
        let limits =
            [5.0, 10.0, 100.0, 1e7].map(|freedom| Likeness { freedom, ..LIKENESS }.estimated_limit(4.0));
        assert!(limits.windows(2).all(|pair| pair[0] > pair[1]), "{limits:?}");
        assert!((limits[3] - 4.0).abs() < 1e-3);
    }
}
