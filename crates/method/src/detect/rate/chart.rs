//! A sequential chart of one series: detects a shift of its level of any size, to either side.
//!
//! For each shift `m` of a grid and each side, `L = exp(m z - m² / 2)` is the likelihood ratio of a value `z` that is
//! standard normal without a shift. The Shiryaev-Roberts statistic sums the likelihood ratios of all possible moments
//! of the shift, `R_k = L_k (1 + R_(k-1))`, and the chart follows the mean of `R` over the grid with `WEIGHTS`.
//! `R_k - k` is a martingale without a shift. So the mean number of values until the mean of `R` reaches `A` is at
//! least `A`. This holds for every sequence of numbers in place of `L` whose expectation is at most one, given the past
//! (e-detectors: Shin, Ramdas, Rinaldo 2022). It is larger for normal values, because the statistic jumps over `A`.

/// Shifts, in standard deviations of a value.
const SHIFTS: [f64; 4] = [0.5, 1.0, 2.0, 3.2];

/// Their weights. A weight `w` adds `-2 ln(w) / m²` values to the delay of a shift of `m` standard deviations. One
/// more value is much compared with the two that a large shift takes, and little compared with the twenty of a small
/// one. So nearly all weight is with the largest.
const WEIGHTS: [f64; 4] = [0.01, 0.05, 0.12, 0.82];

/// Values further out count as this far out, in standard deviations, to prevent overflow.
const FURTHEST: f64 = 30.0;

/// Statistics of a series, for shifts to both sides.
#[derive(Debug, Clone, Default)]
pub(crate) struct SequentialChart {
    above: [f64; SHIFTS.len()],
    below: [f64; SHIFTS.len()],
}

impl SequentialChart {
    /// Takes a value in standard deviations from its expectation. Returns the logarithm of the statistic.
    pub fn add(&mut self, z: f64) -> f64 {
        let z = z.clamp(-FURTHEST, FURTHEST);
        let evidence = |shift: f64| (shift * z - 0.5 * shift * shift).exp();
        let mut sum = 0.0;
        for (place, (shift, weight)) in SHIFTS.iter().zip(WEIGHTS).enumerate() {
            let (above, below) = (&mut self.above[place], &mut self.below[place]);
            *above = evidence(*shift) * (1.0 + *above);
            *below = evidence(-shift) * (1.0 + *below);
            sum += 0.5 * weight * (*above + *below);
        }
        sum.ln()
    }

    /// Forgets all values, as after an alarm.
    pub fn restart(&mut self) {
        *self = Self::default();
    }
}

/// Logarithm of the statistic that raises an alarm, for a mean of `run_length` values (1 or more) between false alarms.
/// The mean is at least this, whatever the evidence.
#[must_use]
pub(crate) fn limit(run_length: f64) -> f64 {
    run_length.max(1.0).ln()
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    /// Mean number of values until an alarm, of normal ones with the mean `shift`, and its standard error.
    fn mean_run(limit: f64, shift: f64, series: u32, seed: u64) -> (f64, f64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let lengths: Vec<f64> = (0..series)
            .map(|_| {
                let mut chart = SequentialChart::default();
                let mut length = 1.0;
                while chart.add(shift + rng.sample::<f64, _>(StandardNormal)) < limit {
                    length += 1.0;
                }
                length
            })
            .collect();
        let mean = lengths.iter().sum::<f64>() / lengths.len() as f64;
        let squares: f64 = lengths.iter().map(|of| (of - mean).powi(2)).sum();
        (mean, squares.sqrt() / lengths.len() as f64)
    }

    /// Normal values jump over the limit: by `1 / sum w exp(-0.583 m)` (Siegmund 1985), the mean is about 5 times as long.
    #[test]
    fn the_mean_run_is_at_least_the_one_asked_for() {
        for asked in [150.0, 600.0] {
            let (mean, error) = mean_run(limit(asked), 0.0, 1000, 2);
            assert!(mean > asked + 3.0 * error && mean < 6.0 * asked, "{asked}: {mean} {error}");
        }
    }

    /// No chart has a shorter delay than `2 ln(run length) / shift²` in the limit (Lorden 1971).
    #[test]
    fn shifts_are_found_about_as_soon_as_can_be() {
        let asked: f64 = 22_000.0;
        for shift in [1.0, 2.0, 3.0] {
            let most = 1.5 * 2.0 * asked.ln() / (shift * shift);
            let (mean, error) = mean_run(limit(asked), shift, 20_000, 3);
            assert!(mean + 2.0 * error < most, "{shift}: {mean} {error} {most}");
            let (down, _) = mean_run(limit(asked), -shift, 20_000, 4);
            assert!((down - mean).abs() < 6.0 * error, "{shift}: {down} {mean}");
        }
    }

    #[test]
    fn values_far_out_stay_finite_and_a_restart_forgets() {
        let mut chart = SequentialChart::default();
        assert!(chart.add(1e9).is_finite() && chart.add(-1e9).is_finite());
        chart.restart();
        assert!(chart.add(0.0) < 0.0);
    }
}
