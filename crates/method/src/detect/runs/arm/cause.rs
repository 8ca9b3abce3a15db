//! Causes of the difference between the arm of a run and that of the first runs.

use serde::{Deserialize, Serialize};

use armwatch_model::robot::JointIndex;

/// Least mass that is reported as a load, kg.
const LEAST_MASS: f64 = 0.1;
/// Least standard error of a mass, kg, that means the test does not show the mass: no joint carries the last link's
/// weight.
const UNSEEN_MASS: f64 = 2.0;

/// Cause of the difference between the arm of a run and that of the first runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) enum ArmCause {
    /// No difference.
    None,
    /// A body at the last link.
    Load(Load),
    /// A wrong torque signal of a joint.
    TorqueSignal { joint: JointIndex, fault: SignalFault },
    /// The position signal of a joint has this offset, rad (m).
    PositionSignal { joint: JointIndex, offset: f64 },
    /// The motor of a joint has a torque that a rigid arm with friction does not have. It is `ratio` times the usual,
    /// and the noise of the channel does not explain it: play, a loose part, a damaged gear.
    UnexplainedTorque { joint: JointIndex, ratio: f64 },
    /// The torque signals of most joints have more noise: mean multiple of the usual.
    NoiseOfAll(f64),
    /// Parameters changed in another way.
    Unknown,
}

/// A body at the last link, or a removed one if the mass is negative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct Load {
    /// Mass, kg.
    pub(in crate::detect::runs) mass: f64,
    /// Its standard error, kg.
    pub(in crate::detect::runs) std_error: f64,
    /// Centre in the frame of the last link, m; meaningless if the motion does not show the mass.
    pub(in crate::detect::runs) centre: [f64; 3],
}

impl Load {
    /// Returns true if the motion shows the mass. If not, other parameters of the load still show that there is one.
    pub(in crate::detect::runs) fn has_seen_mass(&self) -> bool {
        self.std_error < UNSEEN_MASS
    }

    /// Returns true if the mass is at least `mass_errors` standard errors, or if the motion does not show it.
    pub(in crate::detect::runs) fn is_at_least(&self, mass_errors: f64) -> bool {
        !self.has_seen_mass() || self.mass.abs() >= LEAST_MASS.max(mass_errors * self.std_error)
    }
}

/// Fault of a torque signal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) enum SignalFault {
    /// Friction is not symmetric: half the sum of both directions, Nm (N), beyond the usual.
    Offset(f64),
    /// Noise, as a multiple of the usual. In tests with unknown noise: torque that the model does not explain.
    Noise(f64),
    /// The joint's own parameters have changed by this fraction.
    Gain(f64),
}

impl ArmCause {
    /// Returns true if both are one fault to users: of the same signal or joint, whatever its size.
    pub(in crate::detect::runs) fn is_same_fault(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Load(_), Self::Load(_))
            | (Self::NoiseOfAll(_), Self::NoiseOfAll(_))
            | (Self::Unknown, Self::Unknown) => true,
            (Self::TorqueSignal { joint, .. }, Self::TorqueSignal { joint: other, .. })
            | (Self::PositionSignal { joint, .. }, Self::PositionSignal { joint: other, .. })
            | (Self::UnexplainedTorque { joint, .. }, Self::UnexplainedTorque { joint: other, .. }) => {
                joint == other
            }
            _ => false,
        }
    }

    /// Returns true for an offset of the torque signal of the joint that had a mechanical fault before.
    pub(in crate::detect::runs) fn is_offset_of_rest(&self, before: &Self) -> bool {
        match (self, before) {
            (
                Self::TorqueSignal { joint, fault: SignalFault::Offset(_) },
                Self::UnexplainedTorque { joint: of, .. },
            ) => joint == of,
            _ => false,
        }
    }

    /// Description of the cause, in words that follow "rather than".
    pub(in crate::detect::runs) fn words(&self) -> String {
        match self {
            Self::None => "no change of the arm".into(),
            Self::Load(load) if load.has_seen_mass() => format!("a load of {:+.2} kg", load.mass),
            Self::Load(_) => "a load of unknown mass".into(),
            Self::TorqueSignal { joint, fault: SignalFault::Offset(_) } => {
                format!("an offset of the torque signal of joint {joint}")
            }
            Self::TorqueSignal { joint, fault: SignalFault::Gain(part) } => {
                format!("a gain of {:+.1} % of the torque signal of joint {joint}", 100.0 * part)
            }
            Self::TorqueSignal { joint, fault: SignalFault::Noise(_) } => {
                format!("noise of the torque signal of joint {joint}")
            }
            Self::PositionSignal { joint, offset } => {
                format!("an offset of {offset:+.4} rad (m) of the position of joint {joint}")
            }
            Self::UnexplainedTorque { joint, .. } => {
                format!("play or another fault of the mechanics of joint {joint}")
            }
            Self::NoiseOfAll(_) => "noise of all torque signals".into(),
            Self::Unknown => "a change of the arm that is not known".into(),
        }
    }
}
