//! Fit of all joints together to torques of any sign, among possible bodies and frictions.
//!
//! One factor of `[w | tau]`, with a right-hand side for the torque of each joint, is enough for every set of signs:
//! for torques `T s` least squares leave `|R22 s|²`. Least squares alone would fit a reversed torque with negative
//! friction and inertia. Every joint's mean power of friction and mean inertia are therefore kept at zero or more, by
//! the dual of the least distance problem (Lawson and Hanson 1974, chapter 23).

use crate::least_squares::factor::{FactorBuilder, TriangularFactor};
use crate::least_squares::orthonormal::dot;

/// New part of a column below which it depends on those before it.
const DEPENDENT: f64 = 1e-7;
/// Number of sweeps over the bounds: there are two for each joint, and each sweep divides the error.
const SWEEPS: usize = 60;

/// Fit of all joints, with each row divided by the standard deviation of its torque.
#[derive(Debug, Clone)]
pub(super) struct JointFit {
    /// Residual of each joint's torque, `[n]` columns.
    left: Vec<Vec<f64>>,
    /// Values of the bounded sums for each joint's torque, `[n][bounds]`.
    bounded: Vec<Vec<f64>>,
    /// Inner products of the bounds in the metric of the fit.
    gram: Vec<Vec<f64>>,
}

impl JointFit {
    /// Creates the fit from a factor of `b` columns followed by the torques of `n` joints, each only in the rows of its
    /// joint. `bounds` are sums of parameters, `[b]` each, that are never negative.
    pub(super) fn new(factor: &TriangularFactor, b: usize, n: usize, bounds: &[Vec<f64>]) -> Self {
        let kept = factor.independent_columns(b, DEPENDENT);
        let k = kept.len();
        let columns: Vec<usize> = kept.iter().copied().chain(b..b + n).collect();
        let mut builder = FactorBuilder::new(columns.len() - 1);
        let upper = factor.upper();
        (0..upper.nrows()).for_each(|i| builder.push(columns.iter().map(|&c| upper[(i, c)])));
        let factor = builder.take();
        let r = factor.upper();
        let side = |of: usize| -> Vec<f64> { (0..r.nrows()).map(|i| r[(i, k + of)]).collect() };
        let whole: Vec<Vec<f64>> = (0..n).map(side).collect();
        // a bound c theta is c r11⁻¹ (r11 theta)
        let directions: Vec<Vec<f64>> = bounds
            .iter()
            .map(|bound| {
                let mut direction = vec![0.0; k];
                for (at, &column) in kept.iter().enumerate() {
                    let known: f64 = (0..at).map(|i| r[(i, at)] * direction[i]).sum();
                    direction[at] = (bound[column] - known) / r[(at, at)];
                }
                let length = dot(&direction, &direction).sqrt();
                direction.iter().map(|x| if length > 0.0 { x / length } else { 0.0 }).collect()
            })
            .collect();
        let gram = directions.iter().map(|a| directions.iter().map(|b| dot(a, b)).collect()).collect();
        let bounded =
            whole.iter().map(|side| directions.iter().map(|d| dot(d, &side[..k])).collect()).collect();
        let left = whole.into_iter().map(|side| side[k..].to_vec()).collect();
        Self { left, bounded, gram }
    }

    /// Weighted squares that the best arm leaves of the torques, each times its `sign`.
    pub(super) fn misfit(&self, sign: impl Fn(usize) -> f64) -> f64 {
        let mut left = vec![0.0; self.left.first().map_or(0, Vec::len)];
        let mut bounded = vec![0.0; self.gram.len()];
        for joint in 0..self.left.len() {
            let sign = sign(joint);
            left.iter_mut().zip(&self.left[joint]).for_each(|(sum, x)| *sum += sign * x);
            bounded.iter_mut().zip(&self.bounded[joint]).for_each(|(sum, x)| *sum += sign * x);
        }
        dot(&left, &left) + self.cost_of_bounds(&bounded)
    }

    /// Squares of the smallest change that makes all bounded sums zero or more.
    fn cost_of_bounds(&self, bounded: &[f64]) -> f64 {
        if bounded.iter().all(|value| *value >= 0.0) {
            return 0.0;
        }
        let mut force = vec![0.0_f64; bounded.len()];
        for _sweep in 0..SWEEPS {
            for i in 0..force.len() {
                let own = self.gram[i][i];
                if own > 0.0 {
                    force[i] = (force[i] - (dot(&self.gram[i], &force) + bounded[i]) / own).max(0.0);
                }
            }
        }
        force.iter().zip(&self.gram).map(|(f, row)| f * dot(row, &force)).sum()
    }
}
