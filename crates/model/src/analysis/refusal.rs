//! Causes of a cycle's refusal, as data: check, channel and joint.

use std::fmt;

use crate::robot::JointIndex;

crate::named_enum! {
    /// Subject of a refusal.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Channel {
        /// The position signal.
        Position = "position",
        /// The velocity signal.
        Velocity = "velocity",
        /// The torque signal.
        Torque = "torque",
        /// The time stamps.
        Time = "time",
        /// Whole rows, or channels of every kind.
        Rows = "rows",
        /// The motion of the arm: too little motion, or a missing stage.
        Motion = "motion",
        /// The identified model: physically impossible parameters, or torque that they do not explain.
        Model = "model",
    }
}

impl Channel {
    /// True if recorded data are at fault, so that a sensor, a cable or the export has to be checked.
    #[must_use]
    pub fn is_recorded(self) -> bool {
        match self {
            Self::Position | Self::Velocity | Self::Torque | Self::Time | Self::Rows => true,
            Self::Motion | Self::Model => false,
        }
    }
}

impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Name of the reason for logs without positions: their layout has none, so none of their tests has a result.
pub const NO_POSITIONS: &str = "no_positions";

/// One reason why a cycle has no result.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RefusalCause {
    /// Name of the check, such as `stuck_channel`.
    pub finding: String,
    /// Subject.
    pub channel: Channel,
    /// The joint, if it concerns one.
    pub joint: Option<JointIndex>,
    /// Fault and remedy, as a sentence.
    pub sentence: String,
}
