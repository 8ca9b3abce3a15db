//! Response of identified parameters to a channel that reads wrong.

use crate::robot::{JointIndex, ParameterId};

/// Fault of a joint's channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChannelFault {
    /// The torque reads too high in proportion; size 1 doubles it.
    TorqueGain,
    /// The torque reads too high by a constant, Nm (N).
    TorqueOffset,
    /// The position reads too high by a constant, rad (m).
    PositionOffset,
}

impl ChannelFault {
    /// All faults.
    pub const ALL: [Self; 3] = [Self::TorqueGain, Self::TorqueOffset, Self::PositionOffset];
}

/// Effect of one fault on the parameters of a cycle, by its size.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultResponse {
    /// The joint of the channel.
    pub joint: JointIndex,
    /// The fault.
    pub fault: ChannelFault,
    /// Index in [`STRENGTHS`].
    pub strength: usize,
    /// Change of the parameters for a fault of size 1, `[b]`, in their SI units.
    pub change: Vec<f64>,
    /// Change of the parameters, `[b]`, that a fault of this strength causes whatever its sign, in their SI units. The
    /// estimate gives less weight to joints whose torque it does not explain, and other joints determine slightly
    /// different values of the same parameters. Empty if unknown, and for the weakest fault.
    pub shift: Vec<f64>,
    /// Unexplained torque of each joint, `[n]`, root mean square as a fraction of that of the joint's torque.
    pub unexplained: Vec<f64>,
}

/// Strengths of faults with known responses: the largest unexplained torque of a joint caused by a fault, as a multiple
/// of the usual one. A weighted estimate gives a joint less weight the more of its torque is unexplained, so the
/// parameters respond differently to a large fault than to a small one.
pub const STRENGTHS: [f64; 3] = [0.0, 3.0, 10.0];

/// Response of the parameters that a motion determines to each fault of each channel. It depends on the motion and
/// hardly on the arm's present state, so one cycle of a test is enough.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelResponse {
    /// The parameters, `[b]`.
    pub parameters: Vec<ParameterId>,
    /// One entry per fault, strength and joint.
    pub faults: Vec<FaultResponse>,
}
