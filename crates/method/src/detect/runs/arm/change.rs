//! Difference of the inertial parameters of a run, or of several runs together, from those of the first runs.

use nalgebra::DVector;

use super::baseline::{Direction, MOST_CHI_SQUARE, SIGNAL_DEVIATIONS};
use super::price::{ARM_MARGIN, CHANNEL_PRICE, PARAMETER_PRICE};

/// Least mean square of the deviations of all parameters that counts as a change. A baseline of a few runs has
/// uncertain deviations, and does not contain the seasons.
pub(super) const LEAST_MEAN_SQUARE: f64 = 25.0;
/// Most of the latest runs that are averaged to find a change that one run does not show.
pub(super) const MOST_TOGETHER: usize = 8;
/// Least part of a mean change that the latest run has itself.
const LEAST_OWN: f64 = 0.5;
/// Least ratio of a change along one direction, for every rate of false alarms: twice the margin, and the prices.
const LEAST_RATIO: f64 = 2.0 * ARM_MARGIN + CHANNEL_PRICE + PARAMETER_PRICE;

/// Difference of the inertial parameters from those of the first runs.
pub(super) struct Change {
    /// Deviations in the standard deviations of the parameters.
    pub(super) deviations: DVector<f64>,
    /// Factor of these deviations over those of one run, since they are of the mean of several.
    pub(super) scale: f64,
    /// The part of the square that counts: zero if it is no change.
    pub(super) square: f64,
}

impl Change {
    /// The change of the latest run, which is the last of `changes`; `None` if it has no parameters. If one run does
    /// not show a change, the means of the latest runs are compared with the directions of faults: those along a
    /// direction are returned with their ratio. `own_variance` is that of the baseline relative to the variances of a
    /// run.
    pub(super) fn of(
        changes: &[Option<&DVector<f64>>],
        directions: &[Direction],
        own_variance: f64,
    ) -> (Option<Self>, Vec<(f64, Self)>) {
        let Some(latest) = changes.last().copied().flatten().cloned() else { return (None, Vec::new()) };
        let chi_square: f64 = latest.iter().map(|x| (x * x).min(MOST_CHI_SQUARE)).sum();
        // changes that chance explains for this number of parameters do not count
        if chi_square > LEAST_MEAN_SQUARE * latest.len() as f64 {
            return (Some(Self { deviations: latest, scale: 1.0, square: chi_square }), Vec::new());
        }
        let mut sum = DVector::zeros(latest.len());
        let mut together = Vec::new();
        for (runs, change) in (1..).zip(changes.iter().rev().flatten().take(MOST_TOGETHER)) {
            sum += *change;
            if !usize::is_power_of_two(runs) || !shows(&latest, &(&sum / runs as f64)) {
                continue;
            }
            // the baseline is the same for all runs
            let variance = ((runs as f64).recip() + own_variance) / (1.0 + own_variance);
            let scale = variance.sqrt().recip();
            let deviations = &sum * (scale / runs as f64);
            let (ratio, square) = along_one_direction(&deviations, directions);
            if ratio >= LEAST_RATIO {
                together.push((ratio, Self { deviations, scale, square }));
            }
        }
        (Some(Self { deviations: latest, scale: 1.0, square: 0.0 }), together)
    }
}

/// Returns true if the run alone agrees with the mean of it and earlier runs. A load that was put down would otherwise
/// count by half.
fn shows(latest: &DVector<f64>, mean: &DVector<f64>) -> bool {
    let size = mean.norm();
    let own = latest.dot(mean) / size.max(f64::MIN_POSITIVE);
    own >= LEAST_OWN * size || size - own < SIGNAL_DEVIATIONS
}

/// For a small change along the direction of one channel fault: the F ratio of its part along the direction, and its
/// square relative to the variance of the remaining part. A season moves the parameters more than their errors, but in
/// no such direction. The scale of the errors does not matter for an F ratio.
fn along_one_direction(change: &DVector<f64>, directions: &[Direction]) -> (f64, f64) {
    let rest = |of: &Direction| {
        let along = of.change.dot(change);
        change.norm_squared() - along * along / of.change.norm_squared().max(f64::MIN_POSITIVE)
    };
    let Some(least) = directions.iter().map(rest).min_by(f64::total_cmp) else { return (0.0, 0.0) };
    let variance = (least / (change.len() as f64 - 1.0).max(1.0)).max(1.0);
    ((change.norm_squared() - least) / variance, change.norm_squared() / variance)
}
