//! How identified parameters answer to a channel that reads wrong.

use crate::robot::{JointIndex, ParameterId};

/// What is wrong with a channel of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChannelFault {
    /// The torque reads in proportion too much; of size 1 it reads twice as much.
    TorqueGain,
    /// The torque reads too much by a constant, Nm (N).
    TorqueOffset,
    /// The position reads too much by a constant, rad (m).
    PositionOffset,
}

impl ChannelFault {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::TorqueGain, Self::TorqueOffset, Self::PositionOffset];
}

/// What one fault does to the parameters of a cycle, by its size.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultResponse {
    /// The joint whose channel it is.
    pub joint: JointIndex,
    /// The fault.
    pub fault: ChannelFault,
    /// Place in [`STRENGTHS`].
    pub strength: usize,
    /// Change of the parameters for a fault of size 1, `[b]`, in their SI units.
    pub change: Vec<f64>,
    /// Change of the parameters, `[b]`, that comes with a fault of this strength whatever its sign, in their SI units: the
    /// estimate trusts joints less whose torque it does not explain, and what other joints say of the same parameters is not
    /// quite the same. Empty where it is not known, and of the weakest fault.
    pub shift: Vec<f64>,
    /// Torque of each joint that no parameters explain, `[n]`, root mean square as a fraction of that of the joint's torque.
    pub unexplained: Vec<f64>,
}

/// Strengths of faults for which a response is known: the most that a fault leaves unexplained of a joint, as a multiple
/// of what is usual. A weighted estimate trusts a joint less the more of its torque is unexplained, so that its parameters
/// answer otherwise to a large fault than to a small one.
pub const STRENGTHS: [f64; 3] = [0.0, 3.0, 10.0];

/// How the parameters that a motion shows answer to each fault of each channel. It follows from the motion and hardly
/// from the arm's present state, so that one cycle of a test speaks for all.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelResponse {
    /// The parameters, `[b]`.
    pub parameters: Vec<ParameterId>,
    /// One entry a fault, strength and joint.
    pub faults: Vec<FaultResponse>,
}
