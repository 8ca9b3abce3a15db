//! Parameters of a dynamic model: inertial parameters of links, friction columns of joints, motor inertias, couplings,
//! springs and cranks, with their names, units and natural order.

use std::fmt;

use super::coupling::CouplingTerm;
use super::friction_law::{FrictionTerm, TermFactor};
use super::joint_index::JointIndex;
use super::parallelogram::Parallelogram;
use super::spring::SpringTerm;
use super::standard_parameters::StandardParameters;
use super::{JointKind, Robot};

/// Quantity of a parameter of a joint or its link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ParameterKind {
    /// Inertial parameter of the link, index into [`StandardParameters::NAMES`].
    Inertial(u8),
    /// Friction coefficient.
    Friction(FrictionTerm),
    /// Motor inertia seen at the joint.
    MotorInertia,
    /// Parameter of a motor that turns with two joints.
    Coupling(CouplingTerm),
    /// Parameter of a spring.
    Spring(SpringTerm),
    /// Inertial parameter of the crank of a parallelogram, index into [`StandardParameters::NAMES`].
    Crank(u8),
}

impl ParameterKind {
    /// Every kind, in natural order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..10)
            .map(Self::Inertial)
            .chain(FrictionTerm::ALL.map(Self::Friction))
            .chain([Self::MotorInertia])
            .chain(CouplingTerm::ALL.map(Self::Coupling))
            .chain(SpringTerm::ALL.map(Self::Spring))
            .chain((0..10).map(Self::Crank))
    }
}

/// A parameter of the dynamic model: a kind at a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ParameterId {
    /// The joint, and the link that it moves.
    pub joint: JointIndex,
    /// The quantity.
    pub kind: ParameterKind,
}

impl ParameterId {
    /// All parameters of a robot in the model's natural column order: ten inertial ones link by link,
    /// friction coefficients joint by joint, motor inertias, three of each coupling, two of each spring, ten of each
    /// crank.
    #[must_use]
    pub fn natural_order(robot: &Robot) -> Vec<Self> {
        let joints = || robot.joint_indices();
        let inertial = joints().flat_map(|j| (0..10).map(move |k| (j, ParameterKind::Inertial(k))));
        let friction = joints()
            .flat_map(|j| robot.friction_of(j).all_terms().map(move |k| (j, ParameterKind::Friction(k))));
        let motor = joints().filter(|_| robot.has_motor_inertia()).map(|j| (j, ParameterKind::MotorInertia));
        let coupling = robot.couplings.iter().flat_map(|coupling| {
            CouplingTerm::ALL.map(|term| (coupling.motor_joint, ParameterKind::Coupling(term)))
        });
        let spring = robot
            .springs
            .iter()
            .flat_map(|spring| spring.terms().map(|term| (spring.joint, ParameterKind::Spring(term))));
        let crank = robot
            .parallelograms
            .iter()
            .flat_map(|of| (0..10).map(move |k| (of.forearm, ParameterKind::Crank(k))));
        inertial
            .chain(friction)
            .chain(motor)
            .chain(coupling)
            .chain(spring)
            .chain(crank)
            .map(|(joint, kind)| Self { joint, kind })
            .collect()
    }

    /// Name without the joint, as in the view `cycle_parameters`: `mPx`, `f1`, `I_m`, `Iam`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self.kind {
            ParameterKind::Inertial(k) => StandardParameters::NAMES[usize::from(k)],
            ParameterKind::Friction(term) => term.name(),
            ParameterKind::MotorInertia => "I_m",
            ParameterKind::Coupling(term) => term.name(),
            ParameterKind::Spring(term) => term.name(),
            ParameterKind::Crank(k) => Parallelogram::NAMES[usize::from(k)],
        }
    }

    /// Unit of the value for a joint of the given kind.
    #[must_use]
    pub fn unit(&self, joint: JointKind) -> &'static str {
        let friction = |degree: u8| match (joint, degree) {
            (JointKind::Revolute, 0) => "Nm",
            (JointKind::Revolute, 1) => "Nm s/rad",
            (JointKind::Revolute, 2) => "Nm s^2/rad^2",
            (JointKind::Revolute, _) => "Nm s^3/rad^3",
            (JointKind::Prismatic, 0) => "N",
            (JointKind::Prismatic, 1) => "N s/m",
            (JointKind::Prismatic, 2) => "N s^2/m^2",
            (JointKind::Prismatic, _) => "N s^3/m^3",
        };
        let motor = match joint {
            JointKind::Revolute => "kg m^2",
            JointKind::Prismatic => "kg",
        };
        match self.kind {
            ParameterKind::Inertial(0) | ParameterKind::Crank(0) => "kg",
            ParameterKind::Inertial(1..=3) | ParameterKind::Crank(1..=3) => "kg m",
            ParameterKind::Inertial(_) | ParameterKind::Crank(_) => "kg m^2",
            ParameterKind::Friction(term) => match (term.factor(), joint) {
                (TermFactor::Speed(degree), _) => friction(degree),
                (TermFactor::Load(0 | 1), _) => "1",
                (TermFactor::Load(_), JointKind::Revolute) => "1/Nm",
                (TermFactor::Load(_), JointKind::Prismatic) => "1/N",
            },
            ParameterKind::MotorInertia | ParameterKind::Coupling(CouplingTerm::Inertia) => motor,
            ParameterKind::Coupling(CouplingTerm::Viscous) => friction(1),
            ParameterKind::Coupling(CouplingTerm::Coulomb) => friction(0),
            ParameterKind::Spring(SpringTerm::Stiffness) if joint == JointKind::Revolute => "Nm/rad",
            ParameterKind::Spring(SpringTerm::Stiffness | SpringTerm::CylinderStiffness) => "N/m",
            ParameterKind::Spring(SpringTerm::Preload) => friction(0),
            ParameterKind::Spring(SpringTerm::CylinderPreload) => "N",
        }
    }
}

/// Coefficients of a link's ten standard parameters in a sum of standard parameters, in their order; `terms` are the
/// coefficients and parameters of the sum.
#[must_use]
pub fn shares_of_link(terms: &[(f64, ParameterId)], link: JointIndex) -> [f64; 10] {
    let mut found = [0.0; 10];
    for (coefficient, id) in terms.iter().filter(|(_, id)| id.joint == link) {
        if let ParameterKind::Inertial(place) = id.kind {
            found[usize::from(place)] += coefficient;
        }
    }
    found
}

impl fmt::Display for ParameterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "J{}_{}", self.joint, self.name())
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::robot::Transform;

    /// Rounding errors of a few dozen operations on numbers of about one.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn names_tell_all_kinds_apart_and_kinds_stand_in_natural_order() {
        let joint = JointIndex::new(0);
        let names: Vec<&str> = ParameterKind::all().map(|kind| ParameterId { joint, kind }.name()).collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), names.len(), "{names:?}");
        assert!(ParameterKind::all().zip(ParameterKind::all().skip(1)).all(|(a, b)| a < b));
    }

    #[test]
    fn a_body_seen_from_elsewhere_keeps_its_inertia_about_its_centre() {
        let centre = Vector3::new(0.1, -0.2, 0.3);
        let own = Matrix3::new(0.5, 0.02, -0.03, 0.02, 0.4, 0.01, -0.03, 0.01, 0.3);
        let body = StandardParameters::from_centre_of_mass(2.5, &centre, &own);
        let frame = Transform::from_xyz_rpy([0.7, 0.1, -0.4], [0.3, -0.8, 1.1]);
        let expected = StandardParameters::from_centre_of_mass(
            2.5,
            &(frame.to_outer(&centre) + frame.translation),
            &(frame.rotation * own * frame.rotation.transpose()),
        );
        let seen = body.seen_from(&frame);
        let back = seen.seen_from(&frame.inverse());
        for k in 0..10 {
            assert!((seen.0[k] - expected.0[k]).abs() < ROUNDING, "{k}: {seen:?} {expected:?}");
            assert!((back.0[k] - body.0[k]).abs() < ROUNDING);
        }
    }
}
