//! Motors that turn with two joints, as in many wrists, and their parameters.

use super::joint_index::JointIndex;

crate::named_enum! {
    /// A parameter of a motor that turns with two joints.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum CouplingTerm {
        /// `Iam`: its inertia.
        Inertia = "Iam",
        /// `fvm`: its viscous friction.
        Viscous = "fvm",
        /// `fsm`: its Coulomb friction.
        Coulomb = "fsm",
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
