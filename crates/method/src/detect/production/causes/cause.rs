//! What explains a log: a load, and one other cause beside it.

use armwatch_model::robot::JointIndex;

/// Least mass that is called a load, kg, and how many of its standard errors.
const LEAST_MASS: f64 = 0.2;
const MASS_ERRORS: f64 = 5.0;
/// Standard error of a mass, kg, from which on the log says nothing of it: no joint carries the last link's weight.
const UNSEEN_MASS: f64 = 2.0;
/// Least gain, and least friction beyond the other joints', that are named.
pub(in crate::detect::production) const LEAST_GAIN: f64 = 0.03;
pub(in crate::detect::production) const LEAST_WEAR: f64 = 0.3;

/// What beside a load explains a log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::production) enum WorkCause {
    /// Nothing.
    None,
    /// Friction of one joint, as a fraction of the test's beyond the other joints'.
    Friction(JointIndex, f64),
    /// A torque signal that reads in proportion too much.
    Gain(JointIndex, f64),
    /// A torque signal that reads too much by a constant, Nm (N).
    Offset(JointIndex, f64),
    /// Something else.
    Unknown,
}

/// A body at the last link beyond that of the test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::production) struct WorkLoad {
    /// Mass, kg.
    pub(in crate::detect::production) mass: f64,
    /// Its standard error, kg.
    pub(in crate::detect::production) std_error: f64,
    /// Centre in the frame of the last link, m; means something where the motion shows the mass.
    pub(in crate::detect::production) centre: [f64; 3],
}

impl WorkLoad {
    /// Whether the motion shows the mass.
    pub(in crate::detect::production) fn has_seen_mass(&self) -> bool {
        self.std_error < UNSEEN_MASS
    }

    pub(super) fn is_plain(&self) -> bool {
        !self.has_seen_mass() || self.mass.abs() >= LEAST_MASS.max(MASS_ERRORS * self.std_error)
    }
}

impl WorkCause {
    /// Whether both are of one kind and one joint, whatever their sizes.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Friction(a, _), Self::Friction(b, _))
            | (Self::Gain(a, _), Self::Gain(b, _))
            | (Self::Offset(a, _), Self::Offset(b, _)) => a == b,
            _ => self == other,
        }
    }

    /// Whether a cause of this size is named.
    pub(super) fn is_large(&self) -> bool {
        match self {
            Self::Friction(_, excess) => *excess >= LEAST_WEAR,
            Self::Gain(_, part) => part.abs() >= LEAST_GAIN,
            _ => true,
        }
    }

    /// What it would be, in words that follow "rather than".
    pub(in crate::detect::production) fn words(&self) -> String {
        match self {
            Self::None => "no change beside warmth".into(),
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
