//! Noise of torque channels.

use crate::robot::JointIndex;

/// Noise of a joint's torque channel in one cycle after the analysis low-pass: the least residual of any model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TorqueNoise {
    /// The joint.
    pub joint: JointIndex,
    /// Standard deviation, Nm (N).
    pub value: f64,
    /// `value` divided by the RMS of the torque while the joint moves, as in [`Rmsd::relative`](super::Rmsd::relative).
    pub relative: f64,
}
