//! Exponentials over the minutes of a run: the means for the fit, candidates, their terms and starting points.

use nalgebra::{DMatrix, DVector};
use varpro::fit::FitResult;
use varpro::model::SeparableModel;
use varpro::problem::SingleRhs;

use crate::friction::separable::{Terms, on_gradient};
use armwatch_model::analysis::{Decay, Estimate, FastShown};

/// A point, or the mean of neighbours in time with their share of all points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mean {
    pub(in crate::friction) minute: f64,
    pub(in crate::friction) torque: f64,
    /// Relative number of points in the mean; one on average.
    pub(in crate::friction) weight: f64,
}

/// An exponential fit with its parts, slowest first.
#[derive(Debug, Clone)]
pub(super) struct CandidateFit {
    pub(in crate::friction) a: Estimate,
    pub(in crate::friction) parts: Vec<Decay>,
    /// Information about the faster of two parts.
    pub(super) fast_shown: Option<FastShown>,
    pub(in crate::friction) rmsd: f64,
}

pub(super) fn extent(minutes: impl Iterator<Item = f64>) -> (f64, f64) {
    minutes.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| (low.min(m), high.max(m)))
}

pub(super) fn single_starts(points: &[Mean]) -> Vec<Vec<f64>> {
    let (first, last) = extent(points.iter().map(|p| p.minute));
    let record = (last - first).max(f64::MIN_POSITIVE);
    [0.05, 0.2, 0.6].iter().map(|part| vec![(part * record).ln()]).collect()
}

pub(in crate::friction) fn decay(minute: &DVector<f64>, log_time: f64) -> DVector<f64> {
    minute.map(|t| (-t / log_time.exp()).exp())
}

pub(super) fn decay_slope(minute: &DVector<f64>, log_time: f64) -> DVector<f64> {
    minute.map(|t| {
        let x = t / log_time.exp();
        x * (-x).exp()
    })
}

/// Result of a search.
pub(super) type ExponentialFit = FitResult<SeparableModel<f64>, SingleRhs>;

/// Result of `make` for the search with the smallest sum of squares, or for the next one if it gives none. Searches
/// that end in the same minimum differ only by the root of the rounding, so one of them is enough.
pub(super) fn from_the_best<T>(
    points: &[Mean],
    searches: Vec<ExponentialFit>,
    mut make: impl FnMut(ExponentialFit) -> Option<T>,
) -> Option<T> {
    let squares = |fit: &ExponentialFit| -> Option<f64> {
        let fitted = fit.best_fit()?;
        Some(points.iter().zip(fitted.iter()).map(|(p, of)| p.weight * (of - p.torque).powi(2)).sum())
    };
    let judged = |fit: ExponentialFit| Some((squares(&fit)?, fit));
    let mut judged: Vec<(f64, ExponentialFit)> = searches.into_iter().filter_map(judged).collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    judged.into_iter().find_map(|(_, fit)| make(fit))
}

/// Logarithms of time constants near `log_times` with zero slope of the sum of squares. The curve is `a`, the terms
/// `held` and one decay for each time constant.
pub(super) fn finished_log_times(
    points: &[Mean],
    held: &[&dyn Fn(f64) -> f64],
    log_times: &[f64],
) -> Vec<f64> {
    let roots = DVector::from_iterator(points.len(), points.iter().map(|p| p.weight.sqrt()));
    let minutes = DVector::from_iterator(points.len(), points.iter().map(|p| p.minute));
    let right = DVector::from_iterator(points.len(), points.iter().map(|p| p.torque)).component_mul(&roots);
    let first = 1 + held.len();
    on_gradient(log_times, &right, |log_times| {
        let mut terms = DMatrix::from_element(points.len(), first + log_times.len(), 1.0);
        for (k, of) in held.iter().enumerate() {
            terms.set_column(1 + k, &minutes.map(of));
        }
        for (k, log_time) in log_times.iter().enumerate() {
            terms.set_column(first + k, &decay(&minutes, *log_time));
        }
        terms.column_iter_mut().for_each(|mut column| column.component_mul_assign(&roots));
        let slope = |log_time: &f64| decay_slope(&minutes, *log_time).component_mul(&roots);
        let slopes = log_times.iter().enumerate().map(|(k, log_time)| (first + k, slope(log_time))).collect();
        Some(Terms { terms, slopes })
    })
}
