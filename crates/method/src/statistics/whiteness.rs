//! Test that a series of runs is white, as control charts assume.
//!
//! `r_k = sum (x_t - m)(x_{t+k} - m) / sum (x_t - m)^2`, `Q = n (n + 2) sum_k r_k^2 / (n - k)` (Ljung & Box 1978): for
//! white noise, `Q` of `h` lags is chi-square with `h` degrees of freedom.

use super::descriptive::{mean, standard_deviation};
use super::distributions::chi_square_tail;
use armwatch_model::analysis::Estimate;

/// Smallest number of values that distinguishes memory from chance.
pub const MIN_VALUES: usize = 8;

/// Largest lag-1 autocorrelation that is acceptable for control charts: beyond it, false alarms of an exponentially
/// weighted mean more than double.
pub const LARGEST_LAG: f64 = 0.2;

/// Probability below which memory is not due to chance.
const SIGNIFICANCE: f64 = 0.05;

/// Largest number of lags of the portmanteau test.
const MOST_LAGS: usize = 10;

/// Result of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whiteness {
    /// Number of values.
    pub count: usize,
    /// Mean of the series.
    pub mean: f64,
    /// Standard deviation about the mean.
    pub std: f64,
    /// Autocorrelation of neighbours, with the standard error for white noise. Its expectation for white noise is
    /// `-1/count`.
    pub lag_1: Estimate,
    /// Number of lags of the portmanteau test.
    pub lags: usize,
    /// Statistic `Q` of the test.
    pub ljung_box: f64,
    /// Probability that white noise has this `Q` or more.
    pub p_value: f64,
}

armwatch_model::named_enum! {
    /// Verdict of the test.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum WhitenessVerdict {
        /// White enough for control charts.
        White = "yes",
        /// The lag-1 autocorrelation is too large, but may be due to chance.
        Undecided = "undecided",
        /// The series has memory.
        Memory = "no",
    }
}

impl Whiteness {
    /// Verdict on the use of the series in control charts.
    #[must_use]
    pub fn verdict(&self) -> WhitenessVerdict {
        if self.p_value < SIGNIFICANCE {
            WhitenessVerdict::Memory
        } else if self.lag_1.value < LARGEST_LAG {
            WhitenessVerdict::White
        } else {
            WhitenessVerdict::Undecided
        }
    }
}

/// Tests a series in order of time; `None` below [`MIN_VALUES`] values, or if they are all equal.
#[must_use]
pub fn whiteness(values: &[f64]) -> Option<Whiteness> {
    let n = values.len() as f64;
    let (mean, std) = (mean(values)?, standard_deviation(values)?);
    if values.len() < MIN_VALUES || !std.is_finite() || std <= 0.0 {
        return None;
    }
    // an even number, because chi-square then has a closed form
    let lags = (values.len() / 10 * 2).clamp(2, MOST_LAGS);
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    let correlation = |lag: usize| products(values, mean, lag) / squares;
    let terms: f64 = (1..=lags).map(|lag| correlation(lag).powi(2) / (n - lag as f64)).sum();
    let ljung_box = n * (n + 2.0) * terms;
    Some(Whiteness {
        count: values.len(),
        mean,
        std,
        lag_1: Estimate { value: correlation(1), std_error: ((n - 1.0) / (n * (n + 2.0))).sqrt() },
        lags,
        ljung_box,
        p_value: chi_square_tail(ljung_box, lags as f64),
    })
}

/// Lag-1 autocorrelation of several series together, each about its own mean; `None` if none has [`MIN_VALUES`] values.
/// The standard error is valid for independent series.
#[must_use]
pub fn common_lag_1(series: &[Vec<f64>]) -> Option<Estimate> {
    let (mut shared, mut squares, mut count) = (0.0, 0.0, 0.0);
    for values in series.iter().filter(|values| values.len() >= MIN_VALUES) {
        let (mean, std) = (mean(values)?, standard_deviation(values)?);
        if std > 0.0 {
            // the weight of a series is its length, independent of its scatter
            shared += products(values, mean, 1) / (std * std);
            squares += values.len() as f64 - 1.0;
            count += values.len() as f64;
        }
    }
    (count > 0.0).then(|| Estimate { value: shared / squares, std_error: count.sqrt().recip() })
}

fn products(values: &[f64], mean: f64, lag: usize) -> f64 {
    values.iter().zip(&values[lag..]).map(|(x, later)| (x - mean) * (later - mean)).sum()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Series with first-order memory `phi`.
    fn remembering(phi: f64, n: usize, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut state = rng.sample::<f64, _>(StandardNormal) / (1.0 - phi * phi).sqrt();
        (0..n)
            .map(|_| {
                state = phi * state + rng.sample::<f64, _>(StandardNormal);
                state
            })
            .collect()
    }

    #[test]
    fn white_noise_is_called_white_as_often_as_promised() {
        let found: Vec<Whiteness> =
            (0..1000).map(|seed| whiteness(&remembering(0.0, 24, seed)).expect("enough")).collect();
        let part =
            |test: &dyn Fn(&Whiteness) -> bool| found.iter().filter(|w| test(w)).count() as f64 / 1000.0;
        // four standard errors of a share of 0.05 in a thousand; the test's size is not exact at 24 values
        assert!((part(&|w| w.verdict() == WhitenessVerdict::Memory) - SIGNIFICANCE).abs() < 0.028);
        assert!((part(&|w| (w.lag_1.value + 1.0 / 24.0).abs() < w.lag_1.std_error) - 0.68).abs() < 0.06);
    }

    #[test]
    fn memory_is_found_and_one_value_repeated_says_nothing() {
        let found = whiteness(&remembering(0.7, 60, 1)).expect("enough");
        assert_eq!(found.verdict(), WhitenessVerdict::Memory);
        let series: Vec<Vec<f64>> = (0..200).map(|seed| remembering(0.4, 40, seed)).collect();
        let together = common_lag_1(&series).expect("enough");
        // for series about their own mean, the estimate of a phi of 0.4 is too small by about (1 + 3 phi) / n
        assert!((together.value - (0.4 - 2.2 / 40.0)).abs() < 4.0 * together.std_error, "{together:?}");
        assert_eq!(whiteness(&[1.0; 20]), None);
        assert_eq!(whiteness(&remembering(0.0, MIN_VALUES - 1, 2)), None);
        assert_eq!(common_lag_1(&[vec![1.0, 2.0]]), None);
    }
}
