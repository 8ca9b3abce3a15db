//! Weighted least squares over joints, from each joint's triangular factor of `[w_j | tau_j]`.

use super::factor::{FactorBuilder, TriangularFactor};
use super::orthonormal::OrthonormalBasis;
use super::rows::SampleRows;
use super::solution::LeastSquares;
use crate::NumericsError;

/// Largest relative change of a joint's residual standard deviation for converged weights.
const SETTLED: f64 = 1e-8;
/// Largest number of rounds. Weights converge in about five, or never.
const MAX_ROUNDS: usize = 50;
/// Smallest assumed noise of a joint, relative to the largest among the joints. No drive resolves its torque ten
/// thousand times finer than another. A smaller residual, as of computed torques or zeros, is no noise, and would make
/// the weight of the other joints' rows negligible.
const LEAST_SIGMA: f64 = 1e-4;
/// Smallest new share of a unit-norm column for it to be kept; corresponds to [`super::solution::MAX_SCALED_CONDITION`]
/// for a whole matrix.
const NEW_SHARE: f64 = 1e-3;

/// Weights of rows: from the joint's noise and, for robust estimates, from the row's own residual.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightRule {
    /// Standard deviation of each joint's residual, `[n]`, Nm.
    pub sigma: Vec<f64>,
    /// Tuning constant of Huber's weights; `None` for least squares.
    pub huber: Option<f64>,
}

impl WeightRule {
    /// Equal weight for all rows.
    #[must_use]
    pub fn equal(joint_count: usize) -> Self {
        Self { sigma: vec![1.0; joint_count], huber: None }
    }

    /// Weight of a squared residual, 1/(Nm)²: `1 / sigma²`, times `c sigma / |e|` beyond `c sigma`
    /// (Huber 1981, 7.8).
    #[must_use]
    pub fn weight(&self, joint: usize, residual: f64) -> f64 {
        let sigma = self.sigma[joint];
        let normed = (residual / sigma).abs();
        let share = match self.huber {
            Some(c) if normed > c => c / normed,
            _ => 1.0,
        };
        share / (sigma * sigma)
    }

    /// Slope of the weighted residual over the residual, 1/(Nm)²: the weight of least squares, and zero beyond
    /// `c sigma`, where Huber's influence is constant.
    #[must_use]
    pub fn slope(&self, joint: usize, residual: f64) -> f64 {
        let sigma = self.sigma[joint];
        match self.huber {
            Some(c) if (residual / sigma).abs() > c => 0.0,
            _ => 1.0 / (sigma * sigma),
        }
    }

    /// Weight of a joint's row in a sample, for the given parameters.
    #[must_use]
    pub fn weight_of(&self, sample: &SampleRows<'_>, joint: usize, theta: &[f64]) -> f64 {
        self.weight(joint, sample.residual(joint, theta))
    }
}

/// Parameters from all joints, with weights from their noise.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedEstimate {
    /// Parameters, `[b]`.
    pub theta: Vec<f64>,
    /// Weights of the rows.
    pub rule: WeightRule,
    /// Number of rounds until the weights converged.
    pub rounds: usize,
    /// True if the weights converged.
    pub settled: bool,
}

/// Weighted least squares [3.22] with weights from each joint's residual variance, iterated until convergence.
/// `factors` `[n]` are the joints' own triangular factors; joints without rows are omitted.
///
/// A joint's variance is relative to its number of rows minus its share of the parameters. Finely measured torques then
/// have more weight than coarse ones. For independent noise this is the estimate of smallest variance (Aitken 1936).
/// The weight of a joint corresponds to at least a ten-thousandth of the largest noise; if no joint has any, all
/// weights are equal.
///
/// `max_condition` limits the scaled condition number of the weighted rows. It bounds rounding, and does not judge the
/// motion, which the unweighted rows show: fine torques of one joint make one direction far longer than the others,
/// without a loss for these.
///
/// # Errors
/// Those of [`TriangularFactor::solve`]; [`NumericsError::NotFinite`] for a joint whose residual is not finite.
pub fn weighted(
    factors: &[TriangularFactor],
    max_condition: f64,
    names: impl Fn(usize) -> String,
) -> Result<WeightedEstimate, NumericsError> {
    let n = factors.len();
    let columns = factors.first().map_or(0, TriangularFactor::columns);
    let rows: usize = factors.iter().map(TriangularFactor::rows).sum();
    let mut rule = WeightRule::equal(n);
    let solve = |rule: &WeightRule| joined(factors, rule, columns).solve_bounded(max_condition, &names);
    let mut theta = solve(&rule)?.theta;
    for round in 1..=MAX_ROUNDS {
        let share = columns as f64 / rows as f64;
        let sigma_of = |factor: &TriangularFactor| {
            let freedom = factor.rows() as f64 * (1.0 - share).max(f64::EPSILON);
            (factor.residual_sum_of_squares(&theta) / freedom).sqrt()
        };
        let found: Vec<f64> =
            factors.iter().map(|of| if of.rows() > 0 { sigma_of(of) } else { 0.0 }).collect();
        let largest = found.iter().copied().fold(0.0, f64::max);
        if !found.iter().all(|sigma| sigma.is_finite()) {
            return Err(NumericsError::NotFinite("a joint's residual standard deviation"));
        }
        if largest <= 0.0 {
            return Ok(WeightedEstimate { theta, rule, rounds: round, settled: true });
        }
        let mut change = 0.0_f64;
        for (j, _) in factors.iter().enumerate().filter(|(_, factor)| factor.rows() > 0) {
            let sigma = found[j].max(LEAST_SIGMA * largest);
            change = change.max((sigma / rule.sigma[j] - 1.0).abs());
            rule.sigma[j] = sigma;
        }
        theta = solve(&rule)?.theta;
        if change < SETTLED {
            return Ok(WeightedEstimate { theta, rule, rounds: round, settled: true });
        }
    }
    Ok(WeightedEstimate { theta, rule, rounds: MAX_ROUNDS, settled: false })
}

/// Factor of all joints' rows, each divided by its joint's standard deviation.
#[must_use]
pub fn joined(factors: &[TriangularFactor], rule: &WeightRule, columns: usize) -> TriangularFactor {
    let mut builder = FactorBuilder::new(columns);
    for (factor, sigma) in factors.iter().zip(&rule.sigma) {
        builder.push_rows((factor.upper() * faer::Scale(1.0 / sigma)).as_ref());
    }
    builder.take().of_rows(factors.iter().map(|factor| factor.upper().nrows()).sum())
}

/// Parameters from one joint's rows alone [3.21].
#[derive(Debug, Clone, PartialEq)]
pub struct JointEstimate {
    /// Columns that this joint's torque distinguishes, ascending.
    pub kept: Vec<usize>,
    /// Columns that it shows only as part of others; their share is in earlier kept columns.
    pub grouped: Vec<usize>,
    /// Solution for the kept columns.
    pub solution: LeastSquares,
    /// Standard deviation of the residual, Nm.
    pub sigma: f64,
}

/// Parameters from one joint's rows alone [3.21]. Columns are examined in natural order. A column that is zero for this
/// joint, such as those of all links before it, is omitted. A column that the kept ones explain to a thousandth is
/// grouped into them. So a value is comparable with that from all joints only if nothing is grouped into it.
///
/// # Errors
/// Those of [`TriangularFactor::solve`].
pub fn per_joint(
    factor: &TriangularFactor,
    max_condition: f64,
    names: impl Fn(usize) -> String,
) -> Result<JointEstimate, NumericsError> {
    let (kept, grouped) = independent_columns(factor);
    let own = factor.restricted(&kept);
    let rows = factor.rows();
    if rows <= kept.len() {
        return Err(NumericsError::TooShort { what: "the joint's motion", rows, needed: kept.len() + 1 });
    }
    let solution = LeastSquares { rows, ..own.solve(max_condition, |column| names(kept[column]))? };
    let sigma = (solution.residual_sum_of_squares / (rows - kept.len()) as f64).sqrt();
    Ok(JointEstimate { kept, grouped, solution, sigma })
}

fn independent_columns(factor: &TriangularFactor) -> (Vec<usize>, Vec<usize>) {
    let (r, b) = (factor.upper(), factor.columns());
    let longest = (0..b).map(|k| r.col(k).norm_l2()).fold(0.0, f64::max);
    let mut basis = OrthonormalBasis::default();
    let (mut kept, mut grouped) = (Vec::new(), Vec::new());
    for k in 0..b {
        let norm = r.col(k).norm_l2();
        if norm <= super::factor::ZERO_COLUMN_THRESHOLD * longest {
            continue;
        }
        let column: Vec<f64> = r.col(k).iter().map(|x| x / norm).collect();
        let rest = basis.rest(&column);
        if rest.length > NEW_SHARE {
            basis.take(rest);
            kept.push(k);
        } else {
            grouped.push(k);
        }
    }
    (kept, grouped)
}

#[cfg(test)]
mod tests;
