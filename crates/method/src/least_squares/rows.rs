//! Rows of `[w | tau]` that can be read repeatedly, one sample at a time, so that estimators with several passes never
//! store the observation matrix.

use super::factor::{FactorBuilder, TriangularFactor};
use crate::lanes::dot;

/// All joints' rows of one sample.
#[derive(Debug, Clone, Copy)]
pub struct SampleRows<'a> {
    /// Number of the observation; neighbours in time differ by one, or by more if rows are omitted.
    pub row: usize,
    /// Rows of `w`, joint by joint, `[n * b]`.
    pub w: &'a [f64],
    /// Torque, `[n]`.
    pub tau: &'a [f64],
    /// True for joints whose row is used, `[n]`.
    pub used: &'a [bool],
}

impl SampleRows<'_> {
    /// Row of `w` of `joint`, `[b]`.
    #[must_use]
    pub fn of_joint(&self, joint: usize) -> &[f64] {
        let b = self.w.len() / self.tau.len().max(1);
        &self.w[joint * b..(joint + 1) * b]
    }

    /// `tau - w theta` of `joint`, Nm.
    #[must_use]
    pub fn residual(&self, joint: usize, theta: &[f64]) -> f64 {
        let w = self.of_joint(joint);
        self.tau[joint] - dot(w, &theta[..w.len()])
    }
}

/// Least-squares problem whose rows can be read repeatedly in order of time.
pub trait RowSource {
    /// Number of columns `b` of `w`.
    fn columns(&self) -> usize;
    /// Number of rows per sample, `n`.
    fn joint_count(&self) -> usize;
    /// Passes every sample to `visit`, in order of time.
    fn each(&self, visit: &mut dyn FnMut(&SampleRows<'_>));
    /// Number of observations from the first to the last.
    fn record_length(&self) -> usize {
        let mut ends = None;
        self.each(&mut |sample| ends = Some((ends.map_or(sample.row, |(first, _)| first), sample.row)));
        ends.map_or(0, |(first, last)| last - first + 1)
    }
}

/// Triangular factor of each joint's rows, `[n]`.
#[must_use]
pub(crate) fn joint_factors(source: &dyn RowSource) -> Vec<TriangularFactor> {
    let n = source.joint_count();
    let mut folders: Vec<FactorBuilder> = (0..n).map(|_| FactorBuilder::new(source.columns())).collect();
    source.each(&mut |sample| {
        for (j, folder) in folders.iter_mut().enumerate().filter(|(j, _)| sample.used[*j]) {
            folder.push(sample.of_joint(j).iter().copied().chain([sample.tau[j]]));
        }
    });
    folders.iter_mut().map(FactorBuilder::take).collect()
}
