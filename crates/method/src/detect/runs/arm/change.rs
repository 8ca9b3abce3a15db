//! How the inertial parameters of a run, or of some runs together, differ from those of the first runs.

use nalgebra::DVector;

use super::baseline::{Direction, MOST_CHI_SQUARE, SIGNAL_DEVIATIONS};
use super::price::{ARM_MARGIN, CHANNEL_PRICE, PARAMETER_PRICE};

/// Mean square of the deviations of all parameters from which on they have changed: a baseline of a few runs knows the
/// deviations badly, and nothing of a season.
pub(super) const LEAST_MEAN_SQUARE: f64 = 25.0;
/// Latest runs in whose mean a change is looked for that one run does not show.
pub(super) const MOST_TOGETHER: usize = 8;
/// Part of a mean change that the latest run has itself.
const LEAST_OWN: f64 = 0.5;
/// Ratio of a change along one direction below which no rate of false alarms asks for it: twice the margin, and the prices.
const LEAST_RATIO: f64 = 2.0 * ARM_MARGIN + CHANNEL_PRICE + PARAMETER_PRICE;

/// How the inertial parameters differ from those of the first runs.
pub(super) struct Change {
    /// In their standard deviations.
    pub(super) deviations: DVector<f64>,
    /// These are as many times as large as those of one run, since they are of the mean of several.
    pub(super) scale: f64,
    /// What of the square counts: zero where it is no change.
    pub(super) square: f64,
}

impl Change {
    /// Of the latest run, whose change is the last of `changes`; `None` where it has no parameters. What one run does not
    /// show is looked for in the mean of the latest runs: where that points along a fault, it comes with the ratio by
    /// which it does. `own_variance` is that of the baseline in the variances of a run.
    pub(super) fn of(
        changes: &[Option<&DVector<f64>>],
        directions: &[Direction],
        own_variance: f64,
    ) -> (Option<Self>, Vec<(f64, Self)>) {
        let Some(latest) = changes.last().copied().flatten().cloned() else { return (None, Vec::new()) };
        let chi_square: f64 = latest.iter().map(|x| (x * x).min(MOST_CHI_SQUARE)).sum();
        // what chance makes of so many parameters is no change
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

/// Returns true if the run alone agrees with the mean of it and earlier runs. A load that was put down would otherwise count
/// by half.
fn shows(latest: &DVector<f64>, mean: &DVector<f64>) -> bool {
    let size = mean.norm();
    let own = latest.dot(mean) / size.max(f64::MIN_POSITIVE);
    own >= LEAST_OWN * size || size - own < SIGNAL_DEVIATIONS
}

/// For a change that is small but points where one fault of a channel moves the parameters: by how much more of it than by
/// chance, and its square in the variance of what that fault leaves. A season moves the parameters more than their errors
/// say, but in no such direction, so the first is an F ratio, for which the scale of the errors does not matter.
fn along_one_direction(change: &DVector<f64>, directions: &[Direction]) -> (f64, f64) {
    let rest = |of: &Direction| {
        let along = of.change.dot(change);
        change.norm_squared() - along * along / of.change.norm_squared().max(f64::MIN_POSITIVE)
    };
    let Some(least) = directions.iter().map(rest).min_by(f64::total_cmp) else { return (0.0, 0.0) };
    let variance = (least / (change.len() as f64 - 1.0).max(1.0)).max(1.0);
    ((change.norm_squared() - least) / variance, change.norm_squared() / variance)
}
