//! Priors from known values of an arm: its description's nominal parameters, or external values with their standard
//! errors.

use crate::least_squares::prior::ParameterPrior;
use crate::model::base_parameters::BaseParameters;
use armwatch_model::robot::{CouplingTerm, ParameterId, ParameterKind, Robot};

/// Default standard deviation of a prior, as a fraction of the value: a drawing without cables and grease, or a
/// catalogue's friction, is rarely more accurate.
pub const PRIOR_STD_FRACTION: f64 = 0.3;

/// Base parameters `[b]` from the nominal parameters of a description, including all grouped ones. `None` if a
/// parameter or one of its group has no nominal value: a joint without nominal parameters, a coupled motor, friction of
/// another law than the nominal one.
#[must_use]
pub fn nominal_base(robot: &Robot, base: &BaseParameters) -> Vec<Option<f64>> {
    let value = |id: ParameterId| nominal_value(robot, id);
    base.kept
        .iter()
        .zip(&base.grouping)
        .map(|(&id, group)| {
            group.iter().try_fold(value(id)?, |sum, term| Some(sum + term.coefficient * value(term.id)?))
        })
        .collect()
}

/// Base parameters `[b]` for the torque of the described arm. Inertia and friction of coupled motors count as zero,
/// because a description has no values for them; otherwise the values are those of [`nominal_base`].
///
/// # Errors
/// All other parameters without a nominal value, including grouped ones.
pub fn nominal_torque_base(robot: &Robot, base: &BaseParameters) -> Result<Vec<f64>, Vec<ParameterId>> {
    let value = |id: ParameterId| match id.kind {
        ParameterKind::Coupling(_) => Some(0.0),
        _ => nominal_value(robot, id),
    };
    let mut missing = Vec::new();
    let mut known = |id: ParameterId| {
        let value = value(id);
        if value.is_none() {
            missing.push(id);
        }
        value.unwrap_or(0.0)
    };
    let mut values = Vec::with_capacity(base.kept.len());
    for (&id, group) in base.kept.iter().zip(&base.grouping) {
        let own = known(id);
        values.push(group.iter().fold(own, |sum, term| sum + term.coefficient * known(term.id)));
    }
    if missing.is_empty() { Ok(values) } else { Err(missing) }
}

/// Described value of a parameter, in the unit of [`ParameterId::unit`].
#[must_use]
pub fn nominal_value(robot: &Robot, id: ParameterId) -> Option<f64> {
    let nominal = robot.joints.get(id.joint.index())?.nominal.as_ref()?;
    match id.kind {
        ParameterKind::Inertial(k) => nominal.inertial.0.get(usize::from(k)).copied(),
        ParameterKind::MotorInertia => Some(nominal.motor_inertia),
        ParameterKind::Friction(term) => term.nominal(&nominal.friction),
        ParameterKind::Coupling(_) => None,
        ParameterKind::Spring(term) => robot.springs_of(id.joint).find_map(|spring| {
            let k = spring.terms().iter().position(|of| *of == term)?;
            spring.nominal?.get(k).copied()
        }),
        ParameterKind::Crank(k) => {
            let of = robot.parallelograms.iter().find(|of| of.forearm == id.joint)?;
            of.nominal?.0.get(usize::from(k)).copied()
        }
    }
}

/// Priors whose standard deviations are `fraction` of the value, or of the root mean square of the joint's values of
/// the same kind and unit if that is more: a product of inertia with the described value zero may differ from zero. No
/// prior if all of these are zero, or for `None`.
#[must_use]
pub fn with_fraction(values: &[(ParameterId, Option<f64>)], fraction: f64) -> Vec<Option<ParameterPrior>> {
    let scale = |id: ParameterId| {
        let like = |other: &ParameterId| other.joint == id.joint && kin(other.kind) == kin(id.kind);
        let squares: Vec<f64> =
            values.iter().filter(|(other, _)| like(other)).filter_map(|(_, v)| Some((*v)?.powi(2))).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    let prior = |&(id, value): &(ParameterId, Option<f64>)| {
        let value = value?;
        let std = fraction * scale(id).max(value.abs());
        (std > 0.0 && std.is_finite()).then_some(ParameterPrior { value, std })
    };
    values.iter().map(prior).collect()
}

/// Group of a joint's parameters of similar size: those of one unit.
fn kin(kind: ParameterKind) -> u8 {
    match kind {
        ParameterKind::Inertial(0) => 0,
        ParameterKind::Inertial(1..=3) => 1,
        ParameterKind::Inertial(_) => 2,
        ParameterKind::MotorInertia | ParameterKind::Coupling(CouplingTerm::Inertia) => 3,
        ParameterKind::Friction(term) => 4 + term as u8,
        ParameterKind::Coupling(CouplingTerm::Viscous) => 100,
        ParameterKind::Coupling(CouplingTerm::Coulomb) => 101,
        ParameterKind::Spring(term) => 102 + term as u8,
        ParameterKind::Crank(0) => 110,
        ParameterKind::Crank(1..=3) => 111,
        ParameterKind::Crank(_) => 112,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::base_parameters::base_parameters;
    use crate::model::dynamics::DynamicModel;
    use armwatch_model::robot::{Coupling, FrictionTerm, JointIndex};
    use armwatch_testing::er3a;

    /// Rounding of a few hundred operations.
    const ROUNDING: f64 = 1e-9;

    #[test]
    fn grouped_nominal_parameters_give_the_torque_of_the_full_ones() {
        let robot = er3a();
        let base = base_parameters(&robot).expect("base parameters");
        let values: Vec<(ParameterId, f64)> = base
            .kept
            .iter()
            .zip(nominal_base(&robot, &base))
            .map(|(&id, value)| (id, value.expect("nominal")))
            .collect();
        assert_eq!(values.len(), 64);
        let full = ParameterId::natural_order(&robot).into_iter();
        let full = full.map(|id| (id, nominal_value(&robot, id).expect("nominal")));
        let (full, grouped) = (
            DynamicModel::from_parameters(&robot, full),
            DynamicModel::from_parameters(&robot, values.into_iter()),
        );
        let (q, qd, qdd) = (
            [0.3, -0.4, 0.5, 0.6, -0.7, 0.8],
            [1.0, -0.5, 0.7, 1.1, -0.9, 0.4],
            [2.0, 1.0, -1.5, 3.0, 0.5, -2.0],
        );
        let (mut expected, mut found) = ([0.0; 6], [0.0; 6]);
        full.torque(&robot, &q, &qd, &qdd, &mut expected);
        grouped.torque(&robot, &q, &qd, &qdd, &mut found);
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < ROUNDING * expected.abs().max(1.0), "{found} {expected}");
        }
    }

    #[test]
    fn a_joint_without_nominal_parameters_has_no_prior_and_spoils_its_groups_only() {
        let mut robot = er3a();
        let base = base_parameters(&robot).expect("base parameters");
        robot.joints[5].nominal = None;
        let known = nominal_base(&robot, &base);
        for (id, value) in base.kept.iter().zip(&known) {
            if id.joint.index() == 5 {
                assert!(value.is_none(), "{id}");
            }
        }
        assert!(known.iter().flatten().count() > 30);
    }

    #[test]
    fn coupled_motors_have_no_prior_and_count_as_zero_in_torques() {
        let mut robot = er3a();
        robot.transmission[(5, 4)] = 32.0;
        let plain = base_parameters(&robot).expect("base parameters");
        let (joint, motor_joint) = (JointIndex::new(4), JointIndex::new(5));
        robot.couplings = vec![Coupling { joint, motor_joint, ratio: 0.5 }];
        let base = base_parameters(&robot).expect("base parameters");
        assert!(nominal_base(&robot, &base).contains(&None));
        let values = nominal_torque_base(&robot, &base).expect("every other parameter is described");
        let of_coupling = |id: &&ParameterId| matches!(id.kind, ParameterKind::Coupling(_));
        assert_eq!(base.kept.iter().filter(of_coupling).count(), 3);
        for (id, value) in base.kept.iter().zip(&values).filter(|(id, _)| of_coupling(id)) {
            assert!(value.abs() < ROUNDING, "{id}: {value}");
        }
        let model = |base: &BaseParameters, values: Vec<f64>| {
            DynamicModel::from_parameters(&robot, base.kept.iter().copied().zip(values))
        };
        let [coupled, plain] = [
            model(&base, values),
            model(
                &plain,
                nominal_base(&robot, &plain).into_iter().map(|value| value.expect("nominal")).collect(),
            ),
        ]
        .map(|model| {
            let mut tau = [0.0; 6];
            model.torque(&robot, &[0.3; 6], &[-0.5; 6], &[1.5; 6], &mut tau);
            tau
        });
        for (coupled, plain) in coupled.iter().zip(plain) {
            assert!((coupled - plain).abs() < ROUNDING * plain.abs().max(1.0), "{coupled} {plain}");
        }
        robot.joints[2].nominal = None;
        let missing = nominal_torque_base(&robot, &base).expect_err("a joint");
        assert!(missing.iter().all(|id| id.joint.index() == 2), "{missing:?}");
    }

    #[test]
    fn a_zero_among_others_is_as_uncertain_as_they_are() {
        let id = |k| ParameterId { joint: JointIndex::new(0), kind: ParameterKind::Inertial(k) };
        let friction =
            ParameterId { joint: JointIndex::new(0), kind: ParameterKind::Friction(FrictionTerm::F3) };
        let values = [(id(4), Some(2.0)), (id(5), Some(0.0)), (id(6), None), (friction, Some(0.0))];
        let priors = with_fraction(&values, 0.5);
        let std = |k: usize| priors[k].map(|p| p.std);
        assert_eq!(std(0), Some(1.0));
        assert!((std(1).expect("a prior") - 0.5 * 2.0_f64.sqrt()).abs() < ROUNDING);
        assert_eq!((priors[2], priors[3]), (None, None));
    }
}
