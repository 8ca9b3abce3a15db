//! The control chart that detectors share: a baseline, an exponentially weighted moving average (EWMA) of the
//! values after it, and limits for the average.
//!
//! The EWMA is `z_k = w x_k + (1 - w) z_(k-1)`, and `z_0` is the baseline. If all values have the variance
//! `s²`, the variance of `z_k` tends to `w / (2 - w) s²` (Roberts 1959).

use std::f64::consts::FRAC_PI_2;

use crate::statistics::descriptive::median;
use armwatch_model::anomaly::Severity;

/// Weight `w` of the newest value. Three values in a row have four fifths of the weight, so that one outlier has little
/// effect.
pub const EWMA_WEIGHT: f64 = 0.4;

/// Median of the first `count` values; `None` while there are fewer.
pub(super) fn baseline(values: impl Iterator<Item = f64>, count: usize) -> Option<f64> {
    let first: Vec<f64> = values.take(count).collect();
    median(&first).filter(|_| first.len() == count)
}

/// Variance of the median of `count` values with the standard deviation `spread`: pi/2 times that of their
/// mean.
pub(super) fn median_variance(spread: f64, count: usize) -> f64 {
    FRAC_PI_2 * spread * spread / count as f64
}

/// Variance of the EWMA of many values with the standard deviation `spread`.
pub(super) fn steady_variance(spread: f64) -> f64 {
    EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * spread * spread
}

/// EWMA of values. The caller gives each weight: [`EWMA_WEIGHT`] for all if all are equally certain.
#[derive(Debug)]
pub(super) struct Ewma {
    average: f64,
}

impl Ewma {
    /// Begins at the baseline.
    pub(super) fn new(baseline: f64) -> Self {
        Self { average: baseline }
    }

    /// The EWMA with one more value.
    pub(super) fn add(&mut self, value: f64, weight: f64) -> f64 {
        self.average = weight * value + (1.0 - weight) * self.average;
        self.average
    }
}

/// EWMA of values with unequal variances. The weight of a value is `w s² / var x`, with the usual variance `s²`. The
/// variance of the EWMA is `var z_k = w_k² var x_k + (1 - w_k)² var z_(k-1)`.
#[derive(Debug)]
pub(super) struct UnequalEwma {
    ewma: Ewma,
    /// Usual standard deviation of one value.
    spread: f64,
    variance: f64,
}

impl UnequalEwma {
    /// Begins at the baseline. `spread` is the usual standard deviation of one value, in the unit of the
    /// values.
    pub(super) fn new(baseline: f64, spread: f64) -> Self {
        Self { ewma: Ewma::new(baseline), spread, variance: steady_variance(spread) }
    }

    /// The EWMA with one more value. `own` is the variance of this value, at least the usual one.
    pub(super) fn add(&mut self, value: f64, own: f64) -> f64 {
        let weight = EWMA_WEIGHT * self.spread * self.spread / own;
        self.variance = weight * weight * own + (1.0 - weight) * (1.0 - weight) * self.variance;
        self.ewma.add(value, weight)
    }

    /// The EWMA.
    pub(super) fn average(&self) -> f64 {
        self.ewma.average
    }

    /// Restarts at a level that values of this variance have shown.
    pub(super) fn restart(&mut self, level: f64, variance: f64) {
        self.ewma = Ewma::new(level);
        self.variance = variance;
    }

    /// Variance of the EWMA, at least that of equally certain values.
    pub(super) fn variance(&self) -> f64 {
        self.variance.max(steady_variance(self.spread))
    }
}

/// Limits of the change from the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    /// Change that is a warning.
    pub(super) warning: f64,
    /// Change that is critical.
    pub(super) critical: f64,
    /// Largest change by chance, in its standard deviations.
    pub(super) sigma: f64,
}

impl Limits {
    /// Least change of an anomaly; `deviation` is the standard deviation of the change.
    pub(super) fn threshold(&self, deviation: f64) -> f64 {
        self.warning.max(self.sigma * deviation)
    }

    /// Severity of a change; `None` below the threshold.
    pub(super) fn severity(&self, change: f64, threshold: f64) -> Option<Severity> {
        if change < threshold {
            return None;
        }
        let critical = change >= self.critical.max(threshold);
        Some(if critical { Severity::Critical } else { Severity::Warning })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_baseline_needs_all_of_its_values() {
        assert_eq!(baseline([3.0, 1.0].into_iter(), 3), None);
        assert_eq!(baseline([3.0, 1.0, 2.0, 90.0].into_iter(), 3), Some(2.0));
        assert_eq!(baseline([3.0].into_iter(), 0), None);
    }

    #[test]
    fn the_variance_follows_from_the_weights_of_all_values() {
        // the definition: the average is a weighted sum of all values, its variance the sum of squared weights times
        // variances
        let spread = 0.02;
        let variances: Vec<f64> = (0..30).map(|i| spread * spread * f64::from(1 + i % 4)).collect();
        let mut chart = UnequalEwma::new(0.0, spread);
        variances.iter().for_each(|own| _ = chart.add(0.0, *own));
        let weight = |own: f64| EWMA_WEIGHT * spread * spread / own;
        let mut left = 1.0;
        let mut sum = 0.0;
        for own in variances.iter().rev() {
            sum += (left * weight(*own)).powi(2) * own;
            left *= 1.0 - weight(*own);
        }
        sum += left * left * steady_variance(spread);
        assert!((chart.variance / sum - 1.0).abs() < 1e-12, "{} {sum}", chart.variance);
    }

    #[test]
    fn equally_certain_values_keep_the_variance_and_the_weight() {
        let (mut unequal, mut equal) = (UnequalEwma::new(1.0, 0.02), Ewma::new(1.0));
        for value in [1.2, 0.9, 1.1, 1.1, 1.0] {
            let (a, b) = (unequal.add(value, 0.02 * 0.02), equal.add(value, EWMA_WEIGHT));
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
        assert!((unequal.variance() / steady_variance(0.02) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_change_within_chance_is_none_however_large_it_is() {
        let limits = Limits { warning: 0.05, critical: 0.15, sigma: 4.0 };
        assert_eq!(limits.severity(0.06, limits.threshold(0.01)), Some(Severity::Warning));
        assert_eq!(limits.severity(0.06, limits.threshold(0.02)), None);
        assert_eq!(limits.severity(0.15, limits.threshold(0.01)), Some(Severity::Critical));
        // the threshold is above the critical change
        assert_eq!(limits.severity(0.17, limits.threshold(0.05)), None);
        assert_eq!(limits.severity(0.20, limits.threshold(0.05)), Some(Severity::Critical));
    }
}
