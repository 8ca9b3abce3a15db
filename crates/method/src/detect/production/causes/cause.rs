//! Causes of a log: a load, and one other cause in addition to it.

use armwatch_model::robot::JointIndex;

/// Least mass that is reported as a load, kg, and the least mass in its standard errors.
const LEAST_MASS: f64 = 0.2;
const MASS_ERRORS: f64 = 5.0;
/// Least standard error of a mass, kg, that means the log does not show the mass: no joint carries the last link's
/// weight.
const UNSEEN_MASS: f64 = 2.0;
/// Least gain, and least friction beyond the other joints', that are reported.
pub(in crate::detect::production) const LEAST_GAIN: f64 = 0.03;
pub(in crate::detect::production) const LEAST_WEAR: f64 = 0.3;

/// Cause of a log in addition to a load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::production) enum WorkCause {
    /// Nothing.
    None,
    /// More friction of one joint, as a fraction of the test's and beyond that of the other joints.
    Friction(JointIndex, f64),
    /// Torque signal of one joint with a wrong gain, as a fraction.
    Gain(JointIndex, f64),
    /// Torque signal of one joint with an offset, Nm (N).
    Offset(JointIndex, f64),
    /// Something else.
    Unknown,
}

/// Body at the last link in addition to that of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::production) struct WorkLoad {
    /// Mass, kg.
    pub(in crate::detect::production) mass: f64,
    /// Its standard error, kg.
    pub(in crate::detect::production) std_error: f64,
    /// Centre in the frame of the last link, m; meaningless if the motion does not show the mass.
    pub(in crate::detect::production) centre: [f64; 3],
}

impl WorkLoad {
    /// Returns true if the motion shows the mass.
    pub(in crate::detect::production) fn has_seen_mass(&self) -> bool {
        self.std_error < UNSEEN_MASS
    }

    pub(super) fn is_plain(&self) -> bool {
        !self.has_seen_mass() || self.mass.abs() >= LEAST_MASS.max(MASS_ERRORS * self.std_error)
    }
}

impl WorkCause {
    /// Returns true if both have the same kind and joint, whatever their sizes.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Friction(a, _), Self::Friction(b, _))
            | (Self::Gain(a, _), Self::Gain(b, _))
            | (Self::Offset(a, _), Self::Offset(b, _)) => a == b,
            _ => self == other,
        }
    }

    /// Returns true if a cause of this size is reported.
    pub(super) fn is_large(&self) -> bool {
        match self {
            Self::Friction(_, excess) => *excess >= LEAST_WEAR,
            Self::Gain(_, part) => part.abs() >= LEAST_GAIN,
            _ => true,
        }
    }

    /// Description of the cause, in words that follow "rather than".
    pub(in crate::detect::production) fn words(&self) -> String {
        match self {
            Self::None => "no change except temperature".into(),
            Self::Friction(joint, _) => format!("friction of joint {joint}"),
            Self::Gain(joint, part) => {
                format!("a gain of {:+.1} % of the torque signal of joint {joint}", 100.0 * part)
            }
            Self::Offset(joint, torque) => {
                format!("an offset of {torque:+.2} Nm of the torque signal of joint {joint}")
            }
            Self::Unknown => "a change that is not known".into(),
        }
    }
}
