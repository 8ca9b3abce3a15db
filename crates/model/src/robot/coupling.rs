//! Motors that turn with two joints, as in many wrists, and their parameters.

use super::joint_index::JointIndex;

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
    /// All terms, in natural order.
    pub const ALL: [Self; 3] = [Self::Inertia, Self::Viscous, Self::Coulomb];

    pub(super) fn name(self) -> &'static str {
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
    /// Motor turn caused by the other joint, relative to that of its own joint: `R[m, j] / R[m, m]`.
    pub ratio: f64,
}
