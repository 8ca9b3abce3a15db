//! Each joint's torque against all that its own columns can explain: whether friction brakes, and what a joint
//! alone leaves unexplained.

use crate::identify::joint_factors::{FactorColumns, Factored, used_for_identification};
use crate::least_squares::factor::TriangularFactor;
use crate::least_squares::orthonormal::OrthonormalBasis;
use crate::signal::filter::FilteredSignals;
use armwatch_model::robot::{FrictionTerm, JointIndex, ParameterKind, Robot};

/// Instants that the power of friction is averaged over: a mean needs no more.
const INSTANTS: usize = 2000;
/// A column of which no more than this part is new is dependent on those before it.
const DEPENDENT: f64 = 1e-6;
/// Rows needed for each column of a fit of one joint.
const ROWS_PER_COLUMN: usize = 2;

/// A joint's torque fitted with the columns of the joint alone, over its moving rows of the excitation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OwnFit {
    /// The joint.
    pub joint: JointIndex,
    /// Part of the torque's squares that is left.
    pub unexplained: f64,
    /// Mean power of the joint's friction, W: negative where friction would drive it.
    pub friction_power: f64,
    /// Its standard error.
    pub friction_power_error: f64,
    /// RMS of torque times RMS of speed, W.
    pub power_scale: f64,
}

/// Fits each joint that has rows enough. Unlike the fit of all joints together, a joint's own sees nothing of faults
/// in the other joints' torques.
#[must_use]
pub fn own_fits(
    robot: &Robot,
    columns: &FactorColumns,
    filtered: &FilteredSignals,
    factored: &Factored,
    excitation: &[usize],
) -> Vec<OwnFit> {
    let fit = |joint: JointIndex| {
        let of = factored
            .factors
            .iter()
            .find(|of| of.joint == joint && used_for_identification(of.stage, of.motion))?;
        let moving = moving_speeds(robot, filtered, excitation, joint);
        own_fit(robot, columns, joint, &of.factor, &moving, filtered.independent_fraction())
    };
    robot.joint_indices().filter_map(fit).collect()
}

fn moving_speeds(
    robot: &Robot,
    filtered: &FilteredSignals,
    excitation: &[usize],
    joint: JointIndex,
) -> Vec<f64> {
    let low = robot.joints[joint.index()].low_speed;
    let qd = &filtered.qd[joint.index()];
    let stride = excitation.len().div_ceil(INSTANTS).max(1);
    excitation.iter().step_by(stride).map(|&row| qd[row]).filter(|speed| speed.abs() >= low).collect()
}

fn own_fit(
    robot: &Robot,
    columns: &FactorColumns,
    joint: JointIndex,
    factor: &TriangularFactor,
    speeds: &[f64],
    independent: f64,
) -> Option<OwnFit> {
    let ids = columns.by_joint().get(joint.index())?;
    let b = ids.len();
    let rows = factor.rows() as f64 * independent.min(1.0);
    if factor.rows() < ROWS_PER_COLUMN * b || speeds.is_empty() || !factor.is_finite() {
        return None;
    }
    // an offset of the torque signal is no friction, whatever its sign
    let place = |k: usize| match ids[k].kind {
        ParameterKind::Friction(term) if ids[k].joint == joint && term != FrictionTerm::Offset => {
            robot.friction.terms().iter().position(|of| *of == term)
        }
        _ => None,
    };
    let (friction, others): (Vec<usize>, Vec<usize>) = (0..b).partition(|&k| place(k).is_some());
    let upper = factor.upper();
    let column = |k: usize| -> Vec<f64> { upper.col(k).iter().copied().collect() };
    let mut basis = OrthonormalBasis::default();
    others.iter().for_each(|&k| basis.add(&column(k), DEPENDENT));
    // what of friction and torque nothing else explains
    let rest: Vec<Vec<f64>> = friction.iter().map(|&k| basis.rest(&column(k)).vector).collect();
    let torque = basis.rest(&column(b)).vector;
    let f = friction.len();
    let mut small = TriangularFactor::new(f);
    small.fold(faer::Mat::from_fn(b + 1, f + 1, |i, k| rest.get(k).unwrap_or(&torque)[i]).as_ref());
    let power_of = |k: usize| {
        let at = |qd: f64| place(friction[k]).map_or(0.0, |at| qd * robot.friction.columns(qd)[at]);
        speeds.iter().map(|&qd| at(qd)).sum::<f64>() / speeds.len() as f64
    };
    let weights: Vec<f64> = (0..friction.len()).map(power_of).collect();
    let r = small.upper();
    let mut theta = vec![0.0; f];
    let mut spread = vec![0.0; f];
    for k in (0..f).rev() {
        let known: f64 = (k + 1..f).map(|i| r[(k, i)] * theta[i]).sum();
        theta[k] = (r[(k, f)] - known) / r[(k, k)];
    }
    // the variance of weights * theta is |R^-T weights|^2 times the residual's
    for k in 0..f {
        let known: f64 = (0..k).map(|i| r[(i, k)] * spread[i]).sum();
        spread[k] = (weights[k] - known) / r[(k, k)];
    }
    let squares = factor.torque_sum_of_squares();
    let left = r[(f, f)].powi(2);
    let all = factor.rows() as f64;
    let variance = left / (all - b as f64).max(1.0) * all / rows * spread.iter().map(|x| x * x).sum::<f64>();
    let mean_square = |values: &[f64]| values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64;
    let found = OwnFit {
        joint,
        unexplained: if squares > 0.0 { left / squares } else { 0.0 },
        friction_power: weights.iter().zip(&theta).map(|(weight, theta)| weight * theta).sum(),
        friction_power_error: variance.sqrt(),
        power_scale: (squares / all * mean_square(speeds)).sqrt(),
    };
    (found.friction_power.is_finite() && found.friction_power_error.is_finite()).then_some(found)
}
