//! Huber's M-estimate by iteratively reweighted least squares.

use super::factor::{FactorBuilder, TriangularFactor};
use super::rows::{RowSource, joint_factors};
use super::solution::LeastSquares;
use super::weighted::{WeightRule, weighted};
use crate::NumericsError;
use crate::statistics::descriptive::median;

/// Huber's constant: 95 % of the efficiency of least squares under normal noise (Huber 1981).
pub const HUBER_CONSTANT: f64 = 1.345;
/// Median absolute deviation to standard deviation, for normal noise.
const MAD_TO_SIGMA: f64 = 1.482_602_218_505_602;

/// Settings of the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobustSettings {
    /// Number of standard deviations beyond which residuals count linearly, not squared.
    pub constant: f64,
    /// Largest number of passes over the rows.
    pub max_rounds: usize,
    /// Largest change of the estimated torque, relative to the noise, of a converged estimate.
    pub settled: f64,
    /// Largest scaled condition number.
    pub max_condition: f64,
}

impl Default for RobustSettings {
    fn default() -> Self {
        Self {
            constant: HUBER_CONSTANT,
            max_rounds: 50,
            settled: 1e-4,
            max_condition: super::solution::MAX_SCALED_CONDITION,
        }
    }
}

/// Robust estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct RobustEstimate {
    /// Last weighted solution, in units of the joints' noise.
    pub solution: LeastSquares,
    /// Scale of each joint by its median absolute deviation, and Huber's constant.
    pub rule: WeightRule,
    /// Share of rows whose weight is below 1.
    pub outlier_share: f64,
    /// Number of passes over the rows.
    pub rounds: usize,
    /// True if the estimate has converged.
    pub settled: bool,
}

/// Huber's M-estimate over all joints: the weight of rows beyond `constant` standard deviations is `c sigma / |e|`. The
/// scale of each joint is its median absolute residual times 1.4826, updated in each round; the start is weighted least
/// squares. Each round reads `w` again and never stores it; it stores one residual per row.
///
/// # Errors
/// Those of [`weighted`]; [`NumericsError::NotFinite`] if more than half of a joint's residuals are zero.
pub fn huber(
    source: &dyn RowSource,
    settings: &RobustSettings,
    names: impl Fn(usize) -> String,
) -> Result<RobustEstimate, NumericsError> {
    let start = weighted(&joint_factors(source), settings.max_condition, &names)?;
    let mut theta = start.theta;
    let mut rule = WeightRule { huber: Some(settings.constant), ..start.rule };
    for round in 1..=settings.max_rounds {
        rescale(source, &theta, &mut rule)?;
        let (factor, outlier_share) = reweighted(source, &theta, &rule);
        let solution = factor.solve(settings.max_condition, &names)?;
        let step: Vec<f64> = solution.theta.iter().zip(&theta).map(|(a, b)| a - b).collect();
        let settled = torque_change(&factor, &step) < settings.settled;
        if settled || round == settings.max_rounds {
            return Ok(RobustEstimate { solution, rule, outlier_share, rounds: round, settled });
        }
        theta = solution.theta;
    }
    Err(NumericsError::NotFinite("a robust estimate without rounds"))
}

fn rescale(source: &dyn RowSource, theta: &[f64], rule: &mut WeightRule) -> Result<(), NumericsError> {
    let mut residuals = vec![Vec::new(); source.joint_count()];
    source.each(&mut |sample| {
        for (j, residuals) in residuals.iter_mut().enumerate().filter(|(j, _)| sample.used[*j]) {
            residuals.push(sample.residual(j, theta).abs());
        }
    });
    for (sigma, residuals) in rule.sigma.iter_mut().zip(residuals) {
        let Some(middle) = median(&residuals) else { continue };
        if !(middle > 0.0 && middle.is_finite()) {
            return Err(NumericsError::NotFinite("a joint's median absolute residual"));
        }
        *sigma = MAD_TO_SIGMA * middle;
    }
    Ok(())
}

fn reweighted(source: &dyn RowSource, theta: &[f64], rule: &WeightRule) -> (TriangularFactor, f64) {
    let mut folder = FactorBuilder::new(source.columns());
    let (mut rows, mut outliers) = (0_usize, 0_usize);
    source.each(&mut |sample| {
        for j in (0..sample.tau.len()).filter(|&j| sample.used[j]) {
            let weight = rule.weight_of(sample, j, theta);
            rows += 1;
            // a full weight is 1 except for rounding
            outliers += usize::from(weight * rule.sigma[j] * rule.sigma[j] < 1.0 - 1e-9);
            let factor = weight.sqrt();
            folder.push(sample.of_joint(j).iter().chain([&sample.tau[j]]).map(|x| factor * x));
        }
    });
    (folder.take(), outliers as f64 / rows.max(1) as f64)
}

/// Root mean square change of the estimated torque in units of the noise.
pub(crate) fn torque_change(factor: &TriangularFactor, step: &[f64]) -> f64 {
    let (r, b) = (factor.upper(), factor.columns());
    let squares: f64 = (0..b).map(|i| (i..b).map(|k| r[(i, k)] * step[k]).sum::<f64>().powi(2)).sum();
    (squares / factor.rows().max(1) as f64).sqrt()
}
