//! Estimates from each joint's rows alone [3.21], from the stored factors of cycles.

use super::cycle_errors::{ProblemColumns, between_cycles};
use super::estimate::{ErrorBasis, half, widen};
use super::pool::{PooledFactors, RowWeights};
use crate::NumericsError;
use crate::identify::cycle::identify_factors;
use crate::least_squares::solution::MAX_SCALED_CONDITION;
use crate::least_squares::weighted::per_joint;
use armwatch_model::analysis::{Estimator, Identification};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Parameters from one joint's rows alone [3.21].
#[derive(Debug, Clone, PartialEq)]
pub struct PerJointEstimate {
    /// The joint.
    pub joint: JointIndex,
    /// Parameters that the joint's torque distinguishes; samples are its rows.
    pub identification: Identification,
    /// Half the width of the 95 % interval of each parameter.
    pub half_width: Vec<f64>,
    /// Parameters that its torque shows only as part of earlier ones, which include their share.
    pub within_others: Vec<ParameterId>,
    /// Parameters that never changed its torque, due to the arm's structure or this motion.
    pub unseen: Vec<ParameterId>,
    /// Source of the standard errors.
    pub errors: ErrorBasis,
}

/// Parameters [3.21] from each joint's own rows alone, or an error if its motion is too poor.
#[must_use]
pub fn per_joint_estimates(
    union: &PooledFactors,
) -> Vec<(JointIndex, Result<PerJointEstimate, NumericsError>)> {
    let joints = (0..union.columns().joint_count()).map(JointIndex::new);
    joints.map(|joint| (joint, joint_view(union, joint))).collect()
}

fn joint_view(union: &PooledFactors, joint: JointIndex) -> Result<PerJointEstimate, NumericsError> {
    let j = joint.index();
    let (factor, ids) = (&union.by_joint()[j], &union.columns().by_joint()[j]);
    let fraction = union.independent_shares()[j];
    let found = per_joint(factor, MAX_SCALED_CONDITION, |k| ids[k].to_string())?;
    let own: Vec<ParameterId> = found.kept.iter().map(|&k| ids[k]).collect();
    let restricted = factor.restricted(&found.kept);
    let alone = std::slice::from_ref(&restricted);
    let mut identification = identify_factors(&own, alone, &[fraction], Estimator::Ordinary)?;
    identification.residuals.iter_mut().for_each(|residual| residual.joint = joint);
    let design = ProblemColumns::of_joint(union.columns(), joint, &found.kept);
    let count = design.cycles(union.cycles());
    let mut repeated = 0.0;
    if count > 1 {
        let theta: Vec<f64> = identification.parameters.iter().map(|p| p.value).collect();
        let equal = RowWeights::equal(union.columns().joint_count());
        let inverse = restricted.inverse_of_upper()?;
        let scatter = between_cycles(union.cycles(), &design, &equal, &theta, &inverse)?;
        repeated = widen(&mut identification.parameters, &scatter, count);
    }
    let errors = ErrorBasis::new(count, fraction, repeated);
    let within_others: Vec<ParameterId> = found.grouped.iter().map(|&k| ids[k]).collect();
    let seen = |id: &ParameterId| own.contains(id) || within_others.contains(id);
    let unseen = union.columns().kept().iter().copied().filter(|id| !seen(id)).collect();
    let half_width =
        identification.parameters.iter().map(|p| half(p.std_error, p.degrees_of_freedom)).collect();
    Ok(PerJointEstimate { joint, identification, half_width, within_others, unseen, errors })
}
