//! Evidence for a shift from ranks alone, without assumptions about the distribution.
//!
//! If all orders of the values of a series are equally likely, the rank of the newest one among all `n` until now is
//! uniform, and independent of the earlier ranks (Barndorff-Nielsen 1963). Normal scores `s_r = Phi^-1((r - 1/2) / n)`
//! of the ranks give evidence like that of normal values, `exp(m s_r) / mean_j exp(m s_j)`, whose expectation is one
//! exactly.

use crate::statistics::distributions::normal_quantile;

/// Ranks of the values of a series.
#[derive(Debug, Clone, Default)]
pub struct Ranks {
    /// Values in ascending order.
    sorted: Vec<f64>,
}

/// Rank of a value among all values of a series so far.
#[derive(Debug, Clone)]
pub struct Standing {
    scores: Vec<f64>,
    /// Places that it shares with equal values.
    places: std::ops::Range<usize>,
}

impl Ranks {
    /// Adds a value and returns its rank.
    pub fn add(&mut self, value: f64) -> Standing {
        let first = self.sorted.partition_point(|of| of.total_cmp(&value).is_lt());
        let equals = self.sorted[first..].iter().take_while(|of| of.total_cmp(&value).is_eq()).count();
        self.sorted.insert(first, value);
        let count = self.sorted.len();
        let scores = (0..count).map(|r| normal_quantile((r as f64 + 0.5) / count as f64)).collect();
        Standing { scores, places: first..first + equals + 1 }
    }
}

impl Standing {
    /// Evidence for a shift by `shift` standard deviations.
    #[must_use]
    pub fn evidence(&self, shift: f64) -> f64 {
        let mean = |scores: &[f64]| {
            scores.iter().map(|score| (shift * score).exp()).sum::<f64>() / scores.len() as f64
        };
        mean(&self.scores[self.places.clone()]) / mean(&self.scores)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_expectation_over_all_ranks_is_one() {
        for shift in [0.5, -1.0, 3.5] {
            // the newest of seven values, at each rank
            let at = |rank: u32| {
                let mut ranks = Ranks::default();
                (0..6).for_each(|other| _ = ranks.add(f64::from(other)));
                ranks.add(f64::from(rank) - 0.5).evidence(shift)
            };
            let mean = (0..7).map(at).sum::<f64>() / 7.0;
            assert!((mean - 1.0).abs() < 1e-12, "{shift}: {mean}");
            assert!((at(6) > at(0)) == (shift > 0.0));
        }
    }

    #[test]
    fn equals_share_their_places_and_the_first_value_says_nothing() {
        let mut ranks = Ranks::default();
        for _ in 0..5 {
            assert!((ranks.add(2.0).evidence(3.5) - 1.0).abs() < 1e-12);
        }
        assert!(ranks.add(3.0).evidence(2.0) > 2.0);
    }
}
