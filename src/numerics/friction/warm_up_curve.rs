//! Exponentials over the minutes of a run: means that they are fitted to, candidates, their terms and starting points.

use nalgebra::DVector;

use crate::analysis::{Decay, Estimate, FastShown};

/// A point, or the mean of neighbours in time with their share of all points.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mean {
    pub(super) minute: f64,
    pub(super) torque: f64,
    /// Points that it stands for, of mean one over all.
    pub(super) weight: f64,
}

/// An exponential fit with its parts, slowest first.
#[derive(Debug, Clone)]
pub(super) struct CandidateFit {
    pub(super) a: Estimate,
    pub(super) parts: Vec<Decay>,
    /// What the points show of the faster of two parts.
    pub(super) fast_shown: Option<FastShown>,
    pub(super) rmsd: f64,
}

pub(super) fn extent(minutes: impl Iterator<Item = f64>) -> (f64, f64) {
    minutes.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), m| (low.min(m), high.max(m)))
}

pub(super) fn single_starts(points: &[Mean]) -> Vec<Vec<f64>> {
    let (first, last) = extent(points.iter().map(|p| p.minute));
    let record = (last - first).max(f64::MIN_POSITIVE);
    [0.05, 0.2, 0.6].iter().map(|part| vec![(part * record).ln()]).collect()
}

pub(super) fn decay(minute: &DVector<f64>, log_time: f64) -> DVector<f64> {
    minute.map(|t| (-t / log_time.exp()).exp())
}

pub(super) fn decay_slope(minute: &DVector<f64>, log_time: f64) -> DVector<f64> {
    minute.map(|t| {
        let x = t / log_time.exp();
        x * (-x).exp()
    })
}
