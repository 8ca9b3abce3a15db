//! Full parameters of an arm from the factors of its joints, and the cost of physical consistency for each joint.

use super::bodies::{PhysicalEstimate, PhysicalSettings, physical};
use super::uniform_bodies::{BodyStart, start};
use crate::NumericsError;
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::solution::MAX_SCALED_CONDITION;
use crate::least_squares::weighted::{WeightRule, joined};
use crate::model::base_parameters::BaseParameters;
use armwatch_model::robot::{JointIndex, Robot};

/// Smallest assumed noise of a torque signal, relative to its RMS: without noise, the weight of rows would be infinite.
pub(super) const NOISE_FLOOR: f64 = 1e-4;
/// Largest relative change of a joint's noise for converged weights.
const SETTLED: f64 = 1e-6;
/// Largest number of rounds; weights converge in about five.
const MAX_ROUNDS: usize = 50;

/// Cost of physical consistency for a joint, over the fitted rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConstraintCost {
    /// The joint.
    pub joint: JointIndex,
    /// Number of its rows.
    pub samples: usize,
    /// RMS of its measured torque, Nm (N).
    pub torque_rms: f64,
    /// RMSD of unconstrained base parameters, Nm (N).
    pub unconstrained_rmsd: f64,
    /// RMSD of the physically consistent parameters, Nm (N).
    pub consistent_rmsd: f64,
}

/// Full parameters with their start and their cost.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicalFit {
    /// Result of the fit.
    pub estimate: PhysicalEstimate,
    /// Start and prior of the fit.
    pub start: BodyStart,
    /// Cost of physical consistency for each joint with rows.
    pub price: Vec<ConstraintCost>,
    /// Condition number of the unconstrained problem with scaled columns.
    pub scaled_condition_number: f64,
}

/// Fits full parameters to the joints' `factors` `[n]` of `[w | tau]` over all base parameters, each joint weighted by
/// its own residual, starting from the description's nominal bodies or uniform ones.
///
/// # Errors
/// Those of `physical` and [`TriangularFactor::solve`]: rows that do not show all base parameters are refused, although
/// the assumption alone would give bodies.
pub fn physical_fit(
    robot: &Robot,
    base: &BaseParameters,
    factors: &[TriangularFactor],
    independent_fraction: f64,
) -> Result<PhysicalFit, NumericsError> {
    let b = base.kept.len();
    let (rule, theta, scaled_condition_number) = weights(base, factors)?;
    let factor = joined(factors, &rule, b);
    let start = start(robot, base, &factor)?;
    let settings = PhysicalSettings { independent_fraction, ..PhysicalSettings::default() };
    let estimate = physical(robot, base, &factor, &start.nominal, &settings)?;
    let consistent = base.group(&estimate.phi);
    let price = factors.iter().enumerate().filter(|(_, factor)| factor.rows() > 0).map(|(j, factor)| {
        let rms = |sum: f64| (sum / factor.rows() as f64).sqrt();
        ConstraintCost {
            joint: JointIndex::new(j),
            samples: factor.rows(),
            torque_rms: rms(factor.torque_sum_of_squares()),
            unconstrained_rmsd: rms(factor.residual_sum_of_squares(&theta)),
            consistent_rmsd: rms(factor.residual_sum_of_squares(&consistent)),
        }
    });
    Ok(PhysicalFit { price: price.collect(), estimate, start, scaled_condition_number })
}

/// Noise of each joint, the unconstrained parameters with it, and their condition number. Same as
/// [`weighted`](crate::least_squares::weighted::weighted), except that no joint is without noise.
fn weights(
    base: &BaseParameters,
    factors: &[TriangularFactor],
) -> Result<(WeightRule, Vec<f64>, f64), NumericsError> {
    let b = base.kept.len();
    let rows: usize = factors.iter().map(TriangularFactor::rows).sum();
    if rows <= b {
        return Err(NumericsError::TooShort {
            what: "the excitation stage, joints stacked,",
            rows,
            needed: b + 1,
        });
    }
    let solve = |rule: &WeightRule| {
        joined(factors, rule, b).solve(MAX_SCALED_CONDITION, |k| base.kept[k].to_string())
    };
    let mut rule = WeightRule::equal(factors.len());
    let mut solution = solve(&rule)?;
    for _ in 0..MAX_ROUNDS {
        let mut change = 0.0_f64;
        for (sigma, factor) in rule.sigma.iter_mut().zip(factors).filter(|(_, factor)| factor.rows() > 0) {
            let share = (1.0 - b as f64 / rows as f64).max(f64::EPSILON);
            let rms = |sum: f64| (sum / factor.rows() as f64).sqrt();
            let residual = rms(factor.residual_sum_of_squares(&solution.theta) / share);
            let found = residual.max(NOISE_FLOOR * rms(factor.torque_sum_of_squares()));
            if !(found.is_finite() && found > 0.0) {
                return Err(NumericsError::NotFinite("a joint's residual standard deviation"));
            }
            change = change.max((found / *sigma - 1.0).abs());
            *sigma = found;
        }
        solution = solve(&rule)?;
        if change < SETTLED {
            break;
        }
    }
    Ok((rule, solution.theta, solution.scaled_condition_number))
}
