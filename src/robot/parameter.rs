//! What a dynamic model is made of: inertial parameters of links, friction columns of joints, motor
//! inertias and couplings, with their names, units and natural order.

use std::fmt;

use nalgebra::{Matrix3, Vector3};

use super::{JointIndex, JointKind, Robot, Transform};

/// Ten inertial parameters of a link about the origin of its own frame, in the order
/// [`StandardParameters::NAMES`]. `mP` is the first moment, mass times centre of mass; inertia is
/// about the frame's origin, not about the centre of mass.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StandardParameters(pub [f64; 10]);

impl StandardParameters {
    /// Number of inertial parameters of a link.
    pub const COUNT: usize = 10;
    /// Names in order; `m` in kg, `mP*` in kg m, `I**` in kg m².
    pub const NAMES: [&'static str; 10] =
        ["m", "mPx", "mPy", "mPz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz"];

    /// From mass, first moment and inertia about the frame's origin.
    #[must_use]
    pub fn new(mass: f64, first_moment: &Vector3<f64>, inertia: &Matrix3<f64>) -> Self {
        let (h, i) = (first_moment, inertia);
        Self([mass, h.x, h.y, h.z, i.m11, i.m12, i.m13, i.m22, i.m23, i.m33])
    }

    /// From mass, centre of mass and inertia about that centre, axes of the frame: by the
    /// parallel-axis theorem `I = I_c + m (c'c 1 - c c')`.
    #[must_use]
    pub fn from_centre_of_mass(mass: f64, centre: &Vector3<f64>, inertia: &Matrix3<f64>) -> Self {
        let shift = Matrix3::identity() * centre.norm_squared() - centre * centre.transpose();
        Self::new(mass, &(centre * mass), &(inertia + shift * mass))
    }

    /// Mass, kg.
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.0[0]
    }

    /// First moment `m c`, kg m, in the link frame.
    #[must_use]
    pub fn first_moment(&self) -> Vector3<f64> {
        Vector3::new(self.0[1], self.0[2], self.0[3])
    }

    /// Inertia about the origin of the link frame, kg m².
    #[must_use]
    pub fn inertia(&self) -> Matrix3<f64> {
        let [_, _, _, _, xx, xy, xz, yy, yz, zz] = self.0;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// Centre of mass in the link frame, m; the frame's origin for a link without mass.
    #[must_use]
    pub fn centre_of_mass(&self) -> Vector3<f64> {
        if self.mass() == 0.0 { Vector3::zeros() } else { self.first_moment() / self.mass() }
    }

    /// Inertia about the centre of mass, axes of the link frame, kg m²: the parallel-axis theorem
    /// backwards.
    #[must_use]
    pub fn inertia_about_centre(&self) -> Matrix3<f64> {
        let c = self.centre_of_mass();
        let shift = Matrix3::identity() * c.norm_squared() - c * c.transpose();
        self.inertia() - shift * self.mass()
    }

    /// The same body about another frame, in which this one has the pose `frame`.
    ///
    /// With the second moment `S = tr(I)/2 1 - I` and the first moment `h`:
    /// `S' = R S R' + R h t' + t (R h)' + m t t'`; nothing divides by the mass.
    #[must_use]
    pub fn seen_from(&self, frame: &Transform) -> Self {
        let (mass, t) = (self.mass(), frame.translation);
        let second = |i: Matrix3<f64>| Matrix3::identity() * (0.5 * i.trace()) - i;
        let h = frame.rotation * self.first_moment();
        let moved = frame.rotation * second(self.inertia()) * frame.rotation.transpose()
            + h * t.transpose()
            + t * h.transpose()
            + t * t.transpose() * mass;
        let inertia = Matrix3::identity() * moved.trace() - moved;
        Self::new(mass, &(h + t * mass), &inertia)
    }

    /// Two bodies as one, about the same frame.
    #[must_use]
    pub fn joined(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|k| self.0[k] + other.0[k]))
    }
}

/// Which columns describe the friction of a robot's joints.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrictionModel {
    /// The law.
    pub law: FrictionLaw,
    /// Whether each direction of motion has its own Coulomb and viscous friction. A torque offset is
    /// then no column of its own: it is half the difference of the two Coulomb parts. Not for
    /// [`FrictionLaw::Polynomial`].
    pub asymmetric: bool,
}

/// How friction depends on speed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum FrictionLaw {
    /// `f1 sign(v) + f2 v + f3 v² sign(v) + f4 v³` [3.10].
    #[default]
    Polynomial,
    /// `fs sign(v) + fv v + off`.
    ViscousCoulomb,
    /// No friction in the measured torque, as of sensors behind gears without seals.
    None,
    /// `fs tanh(v / speed) + fv v + off`.
    Smooth {
        /// Speed at which three quarters of the Coulomb friction act, rad/s (m/s).
        speed: f64,
    },
}

impl FrictionModel {
    /// The source's law [3.10].
    pub const POLYNOMIAL: Self = Self { law: FrictionLaw::Polynomial, asymmetric: false };
    /// Most terms that a model has.
    pub const MAX_TERMS: usize = 4;

    /// Terms of each joint, in natural order.
    #[must_use]
    pub fn terms(&self) -> &'static [FrictionTerm] {
        use FrictionTerm::{
            Coulomb, CoulombNegative, CoulombPositive, F1, F2, F3, F4, Offset, Viscous, ViscousNegative,
            ViscousPositive,
        };
        match (self.law, self.asymmetric) {
            (FrictionLaw::None, _) => &[],
            (FrictionLaw::Polynomial, _) => &[F1, F2, F3, F4],
            (_, false) => &[Coulomb, Viscous, Offset],
            (_, true) => &[CoulombPositive, CoulombNegative, ViscousPositive, ViscousNegative],
        }
    }
}

/// A friction coefficient of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FrictionTerm {
    /// `f1 sign(v)` [3.10].
    F1,
    /// `f2 v` [3.10].
    F2,
    /// `f3 v² sign(v)` [3.10].
    F3,
    /// `f4 v³` [3.10].
    F4,
    /// `fs`: Coulomb friction.
    Coulomb,
    /// `fs_p`: Coulomb friction while the position grows.
    CoulombPositive,
    /// `fs_n`: Coulomb friction while the position falls.
    CoulombNegative,
    /// `fv`: viscous friction.
    Viscous,
    /// `fv_p`: viscous friction while the position grows.
    ViscousPositive,
    /// `fv_n`: viscous friction while the position falls.
    ViscousNegative,
    /// `off`: offset of the torque signal.
    Offset,
}

impl FrictionTerm {
    /// Every term of every model.
    pub const ALL: [Self; 11] = [
        Self::F1,
        Self::F2,
        Self::F3,
        Self::F4,
        Self::Coulomb,
        Self::CoulombPositive,
        Self::CoulombNegative,
        Self::Viscous,
        Self::ViscousPositive,
        Self::ViscousNegative,
        Self::Offset,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::F1 => "f1",
            Self::F2 => "f2",
            Self::F3 => "f3",
            Self::F4 => "f4",
            Self::Coulomb => "fs",
            Self::CoulombPositive => "fs_p",
            Self::CoulombNegative => "fs_n",
            Self::Viscous => "fv",
            Self::ViscousPositive => "fv_p",
            Self::ViscousNegative => "fv_n",
            Self::Offset => "off",
        }
    }

    /// Power of the speed that the coefficient multiplies.
    fn degree(self) -> u8 {
        match self {
            Self::F1 | Self::Coulomb | Self::CoulombPositive | Self::CoulombNegative | Self::Offset => 0,
            Self::F2 | Self::Viscous | Self::ViscousPositive | Self::ViscousNegative => 1,
            Self::F3 => 2,
            Self::F4 => 3,
        }
    }
}

/// A parameter of a motor that turns with two joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CouplingTerm {
    /// `Iam`: its inertia.
    Inertia,
    /// `fvm`: its viscous friction.
    Viscous,
    /// `fsm`: its Coulomb friction.
    Coulomb,
}

impl CouplingTerm {
    /// All of them, in natural order.
    pub const ALL: [Self; 3] = [Self::Inertia, Self::Viscous, Self::Coulomb];

    fn name(self) -> &'static str {
        match self {
            Self::Inertia => "Iam",
            Self::Viscous => "fvm",
            Self::Coulomb => "fsm",
        }
    }
}

/// A motor that turns with two joints, as in many wrists.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coupling {
    /// The other joint that turns the motor.
    pub joint: JointIndex,
    /// The motor's own joint; the parameters are named after it.
    pub motor_joint: JointIndex,
    /// How far the motor turns with the other joint, per its own: `R[m, j] / R[m, m]`.
    pub ratio: f64,
}

/// Which quantity a parameter of a joint or its link is.
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
}

impl ParameterKind {
    /// Every kind that there is, in natural order.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..10)
            .map(Self::Inertial)
            .chain(FrictionTerm::ALL.map(Self::Friction))
            .chain([Self::MotorInertia])
            .chain(CouplingTerm::ALL.map(Self::Coupling))
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
    /// friction coefficients joint by joint, motor inertias, three of each coupling.
    #[must_use]
    pub fn natural_order(robot: &Robot) -> Vec<Self> {
        let joints = || robot.joint_indices();
        let inertial = joints().flat_map(|j| (0..10).map(move |k| (j, ParameterKind::Inertial(k))));
        let friction = joints()
            .flat_map(|j| robot.friction_of(j).terms().iter().map(move |&k| (j, ParameterKind::Friction(k))));
        let motor = joints().filter(|_| robot.has_motor_inertia()).map(|j| (j, ParameterKind::MotorInertia));
        let coupling = robot.couplings.iter().flat_map(|coupling| {
            CouplingTerm::ALL.map(|term| (coupling.motor_joint, ParameterKind::Coupling(term)))
        });
        inertial
            .chain(friction)
            .chain(motor)
            .chain(coupling)
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
            ParameterKind::Inertial(0) => "kg",
            ParameterKind::Inertial(1..=3) => "kg m",
            ParameterKind::Inertial(_) => "kg m^2",
            ParameterKind::Friction(term) => friction(term.degree()),
            ParameterKind::MotorInertia | ParameterKind::Coupling(CouplingTerm::Inertia) => motor,
            ParameterKind::Coupling(CouplingTerm::Viscous) => friction(1),
            ParameterKind::Coupling(CouplingTerm::Coulomb) => friction(0),
        }
    }
}

impl fmt::Display for ParameterId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "J{}_{}", self.joint, self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A few dozen operations on numbers of about one.
    const ROUNDING: f64 = 1e-14;

    #[test]
    fn names_tell_all_kinds_apart_and_kinds_stand_in_natural_order() {
        let joint = JointIndex::new(0);
        let names: Vec<&str> = ParameterKind::all().map(|kind| ParameterId { joint, kind }.name()).collect();
        let mut unique = names.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!((unique.len(), names.len()), (25, 25), "{names:?}");
        assert!(ParameterKind::all().zip(ParameterKind::all().skip(1)).all(|(a, b)| a < b));
        for model in [
            FrictionModel::POLYNOMIAL,
            FrictionModel { law: FrictionLaw::None, asymmetric: false },
            FrictionModel { law: FrictionLaw::ViscousCoulomb, asymmetric: false },
            FrictionModel { law: FrictionLaw::Smooth { speed: 0.1 }, asymmetric: true },
        ] {
            let terms = model.terms();
            assert!(terms.len() <= FrictionModel::MAX_TERMS && terms.windows(2).all(|w| w[0] < w[1]));
        }
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
