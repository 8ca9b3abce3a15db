//! Weighted least squares over joints, from each joint's triangular factor of `[w_j | tau_j]`.

use super::factor::{FactorBuilder, TriangularFactor};
use super::orthonormal::OrthonormalBasis;
use super::rows::SampleRows;
use super::solution::LeastSquares;
use crate::NumericsError;

/// Largest relative change of a joint's residual standard deviation at which weights have settled.
const SETTLED: f64 = 1e-8;
/// Weights settle in some five rounds; more show that they never will.
const MAX_ROUNDS: usize = 50;
/// Least noise that a joint is believed to have, as a part of the largest among the joints. No drive resolves its torque
/// ten thousand times finer than another's: a smaller residual, as of torques that were computed or are all zero, is no
/// noise, and would make the other joints' rows count for nothing.
const LEAST_SIGMA: f64 = 1e-4;
/// Smallest share of a unit-norm column that must be new for it to be kept: what
/// [`super::solution::MAX_SCALED_CONDITION`] is to a whole matrix.
const NEW_SHARE: f64 = 1e-3;

/// How much a row counts: its joint's noise and, for robust estimates, its own residual.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightRule {
    /// Standard deviation of each joint's residual, `[n]`, Nm.
    pub sigma: Vec<f64>,
    /// Tuning constant of Huber's weights; `None` for least squares.
    pub huber: Option<f64>,
}

impl WeightRule {
    /// Every row counts alike.
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

    /// Slope of the weighted residual over the residual, 1/(Nm)²: the weight of least squares, and
    /// none beyond `c sigma`, where Huber's influence stays the same.
    #[must_use]
    pub fn slope(&self, joint: usize, residual: f64) -> f64 {
        let sigma = self.sigma[joint];
        match self.huber {
            Some(c) if (residual / sigma).abs() > c => 0.0,
            _ => 1.0 / (sigma * sigma),
        }
    }

    /// Weight of a joint's row in a sample, given the parameters.
    #[must_use]
    pub fn weight_of(&self, sample: &SampleRows<'_>, joint: usize, theta: &[f64]) -> f64 {
        self.weight(joint, sample.residual(joint, theta))
    }
}

/// Parameters from all joints, each weighted by its own noise.
#[derive(Debug, Clone, PartialEq)]
pub struct WeightedEstimate {
    /// The parameters, `[b]`.
    pub theta: Vec<f64>,
    /// Weights of the rows.
    pub rule: WeightRule,
    /// Rounds until the weights settled.
    pub rounds: usize,
    /// Whether they did.
    pub settled: bool,
}

/// Weighted least squares [3.22] with weights from each joint's residual variance, iterated until
/// they settle. `factors` `[n]` are the joints' own triangular factors; joints without rows are left
/// out.
///
/// A joint's variance counts its rows less its share of the parameters. Joints whose torques are
/// measured finely then count more than those that are measured coarsely, as they should: for
/// independent noise this is the estimate of smallest variance (Aitken 1936). A joint counts at most as
/// one with a ten-thousandth of the largest noise; where no joint has any, all count alike.
///
/// `max_condition` bounds the scaled condition number of the weighted rows. It judges rounding, not the motion, which
/// the unweighted rows show: fine torques of one joint make one direction far longer than the others and take nothing
/// from these.
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

/// One factor of all joints' rows, each divided by its joint's standard deviation.
#[must_use]
pub fn joined(factors: &[TriangularFactor], rule: &WeightRule, columns: usize) -> TriangularFactor {
    let mut builder = FactorBuilder::new(columns);
    for (factor, sigma) in factors.iter().zip(&rule.sigma) {
        builder.push_rows((factor.upper() * faer::Scale(1.0 / sigma)).as_ref());
    }
    builder.take().of_rows(factors.iter().map(|factor| factor.upper().nrows()).sum())
}

/// What one joint's rows alone say [3.21].
#[derive(Debug, Clone, PartialEq)]
pub struct JointEstimate {
    /// Columns that this joint's torque tells apart, rising.
    pub kept: Vec<usize>,
    /// Columns that it sees only within others; their share is in those kept before them.
    pub grouped: Vec<usize>,
    /// Solution for the kept columns.
    pub solution: LeastSquares,
    /// Standard deviation of the residual, Nm.
    pub sigma: f64,
}

/// Parameters from one joint's rows alone [3.21]. Columns are gone through in natural order: one that
/// is zero for this joint, as all links before it are, is left out; one that the kept ones explain to
/// a thousandth is grouped into them. So values compare with those of all joints only where nothing
/// is grouped into them.
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
