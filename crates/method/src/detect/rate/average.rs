//! Run lengths of an exponentially weighted moving average, and the limit for a given run length.
//!
//! The average `z_k = w x_k + (1 - w) z_(k-1)` of independent normal values of variance one begins at 0 and alarms
//! outside `-h` to `h`. The mean number of values from an average of `u` until the alarm solves (Crowder 1987)
//!
//! ```text
//! L(u) = 1 + 1/w integral_-h^h L(y) phi((y - (1 - w) u) / w - d) dy
//! ```
//!
//! with the normal density `phi` and the mean `d` of the values. The integral is a sum over Gauss-Legendre nodes.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};

use crate::statistics::distributions::normal_quantile;

/// Fewest nodes: run lengths of 1e6 are then exact to 1e-6 with the weight 0.4.
const FEWEST_NODES: usize = 24;
/// Most nodes. In charts that need more, noise hardly changes the delay.
const MOST_NODES: usize = 160;
/// Nodes for each width `w` of the density.
const NODES_PER_WIDTH: f64 = 1.5;
/// Run lengths beyond this are infinite: one test per minute for two thousand years.
const LONGEST: f64 = 1e9;

/// Mean number of values until the average of `weight` (above 0, below 1) leaves `-half_width` to `half_width`, in
/// standard deviations of a value, for values with the mean `mean`. Infinite beyond 1e9.
#[must_use]
pub fn mean_run_length(weight: f64, half_width: f64, mean: f64) -> f64 {
    let wanted = (2.0 * NODES_PER_WIDTH * half_width / weight).ceil();
    if !(half_width > 0.0 && wanted <= MOST_NODES as f64) {
        return without_noise(weight, half_width, mean);
    }
    let rule = gauss_legendre((wanted as usize).max(FEWEST_NODES));
    let share = |from: f64, (node, of_node): (f64, f64)| {
        let z = (half_width * node - (1.0 - weight) * from) / weight - mean;
        half_width * of_node / weight * (-0.5 * z * z).exp() / (2.0 * PI).sqrt()
    };
    let n = rule.len();
    let system =
        DMatrix::from_fn(n, n, |i, j| f64::from(u8::from(i == j)) - share(half_width * rule[i].0, rule[j]));
    let Some(lengths) = system.lu().solve(&DVector::from_element(n, 1.0)) else { return f64::INFINITY };
    let length =
        1.0 + rule.iter().zip(lengths.iter()).map(|(of, length)| share(0.0, *of) * length).sum::<f64>();
    if (1.0..LONGEST).contains(&length) { length } else { f64::INFINITY }
}

/// Mean run length without noise, for wide charts.
fn without_noise(weight: f64, half_width: f64, mean: f64) -> f64 {
    if half_width <= 0.0 {
        return 1.0;
    }
    match mean.abs() > half_width {
        true => ((1.0 - half_width / mean.abs()).ln() / (1.0 - weight).ln()).ceil().max(1.0),
        false => f64::INFINITY,
    }
}

/// Limit of the average of `weight`, in its own steady standard deviations, with a mean of `run_length` values between
/// false alarms.
#[must_use]
pub fn limit(weight: f64, run_length: f64) -> f64 {
    let steady = (weight / (2.0 - weight)).sqrt();
    let asked = run_length.clamp(2.0, 0.1 * LONGEST).ln();
    let of = |limit: f64| mean_run_length(weight, limit * steady, 0.0).ln() - asked;
    // for the same run length, a chart of independent averages has a lower limit than a chart of single values: secant
    // from both
    let start = normal_quantile(1.0 - 0.5 / run_length.clamp(2.0, 0.1 * LONGEST));
    let (mut below, mut above) = (0.5 * start, start + 0.5);
    let (mut at_below, mut at_above) = (of(below), of(above));
    for _ in 0..STEPS {
        let next = above - at_above * (above - below) / (at_above - at_below);
        if !next.is_finite() || (next - above).abs() < ACCURATE {
            break;
        }
        (below, at_below) = (above, at_above);
        above = next.max(0.01);
        at_above = of(above);
    }
    above
}

/// Most steps to the limit.
const STEPS: usize = 12;
/// Accuracy of the limit, standard deviations.
const ACCURATE: f64 = 1e-4;

/// Nodes in -1 to 1 and their weights: the zeros of the Legendre polynomial of degree `count`, by Newton's method.
fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    let node = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..NEWTON_STEPS {
            let (mut previous, mut value) = (1.0, x);
            for k in 2..=count {
                let k = k as f64;
                (previous, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * previous) / k);
            }
            slope = n * (x * value - previous) / (x * x - 1.0);
            x -= value / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(node).collect()
}

/// The starting values are good to 1e-3; each step squares the error.
const NEWTON_STEPS: usize = 5;

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;

    #[test]
    fn run_lengths_are_those_of_tables() {
        // Lucas and Saccucci 1990, table 3: 500 values without a shift
        for (weight, limit, at_one) in [(0.4_f64, 3.054, 14.3), (0.25, 3.0, 11.1), (0.1, 2.814, 10.3)] {
            let half_width = limit * (weight / (2.0 - weight)).sqrt();
            let found = (mean_run_length(weight, half_width, 0.0), mean_run_length(weight, half_width, 1.0));
            assert!((found.0 / 500.0 - 1.0).abs() < 0.01, "{weight}: {found:?}");
            assert!((found.1 - at_one).abs() < 0.1, "{weight}: {found:?}");
        }
    }

    #[test]
    fn the_limit_gives_the_run_length_and_a_chart_of_drawn_values_keeps_it() {
        for asked in [20.0, 300.0, 16_000.0, 1e6] {
            let half_width = limit(0.4, asked) * 0.5;
            let found = mean_run_length(0.4, half_width, 0.0);
            assert!((found / asked - 1.0).abs() < 2e-3, "{asked}: {found}");
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (half_width, mut lengths) = (limit(0.4, 200.0) * 0.5, Vec::new());
        for _ in 0..4000 {
            let (mut average, mut length) = (0.0_f64, 0.0);
            while average.abs() < half_width {
                average = 0.4 * rng.sample::<f64, _>(StandardNormal) + 0.6 * average;
                length += 1.0;
            }
            lengths.push(length);
        }
        let mean = lengths.iter().sum::<f64>() / 4000.0;
        assert!((mean / 200.0 - 1.0).abs() < 4.0 / 4000.0_f64.sqrt(), "{mean}");
    }

    /// The delays in docs/evidence/detection.md, of one of the 45 channels of a robot of six joints that is tested daily.
    #[test]
    fn a_shift_of_the_level_is_found_after_the_published_delays() {
        let half_width = limit(0.4, 365.25 * 45.0) * 0.5;
        for (shift, tests) in [(1.0, 64.8), (2.0, 6.2), (3.0, 2.8), (5.0, 1.5)] {
            let found = mean_run_length(0.4, half_width, shift);
            assert!((found - tests).abs() < 0.06, "{shift}: {found}");
        }
    }

    #[test]
    fn wide_charts_wait_as_long_as_without_noise() {
        // 0.6^k < 1 - 20/30 with the third value
        let (narrow, wide) = (mean_run_length(0.4, 15.0, 22.5), mean_run_length(0.4, 200.0, 300.0));
        assert!((narrow - 3.0).abs() < 0.2 && (wide - 3.0).abs() < 1e-12, "{narrow} {wide}");
        assert_eq!(mean_run_length(0.4, 200.0, 150.0), f64::INFINITY);
        assert_eq!(mean_run_length(0.4, 0.0, 0.0), 1.0);
    }
}
