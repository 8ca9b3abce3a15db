//! Why a cycle was refused, as data: which check, which channel, which joint.

use std::fmt;

use crate::robot::JointIndex;

/// What a refusal is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Channel {
    /// The position signal.
    Position,
    /// The velocity signal.
    Velocity,
    /// The torque signal.
    Torque,
    /// The time stamps.
    Time,
    /// Whole rows, or channels of every kind.
    Rows,
    /// What the arm was made to do: too little motion, or a stage that is missing.
    Motion,
    /// The identified model: parameters that no arm can have, torque that they do not explain.
    Model,
}

impl Channel {
    /// All of them.
    pub const ALL: [Self; 7] =
        [Self::Position, Self::Velocity, Self::Torque, Self::Time, Self::Rows, Self::Motion, Self::Model];

    /// Name as stored.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Torque => "torque",
            Self::Time => "time",
            Self::Rows => "rows",
            Self::Motion => "motion",
            Self::Model => "model",
        }
    }

    /// Whether something that is recorded is at fault, so that a sensor, a cable or the export is to be looked at.
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

/// Name of the reason of logs without positions: their layout has none, so that no test of theirs has a result.
pub const NO_POSITIONS: &str = "no_positions";

/// One reason for which a cycle gave no result.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RefusalCause {
    /// Name of the check, such as `stuck_channel`.
    pub finding: String,
    /// What it is about.
    pub channel: Channel,
    /// The joint, if it is about one.
    pub joint: Option<JointIndex>,
    /// What is wrong and what to do, as a sentence.
    pub sentence: String,
}
