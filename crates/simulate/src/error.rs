//! Why a run could not be simulated.

use std::io;
use std::path::PathBuf;

use armwatch_model::robot::{JointIndex, MAX_JOINTS};

/// Why a run could not be simulated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// The description contains no dynamics of a joint.
    #[error(
        "joint {joint} has no nominal parameters, and there is nothing to simulate without them; add a nominal \
         section to joint {joint} in the robot description: ten inertial parameters, motor inertia, warm friction \
         f1..f4, warm-up and torque noise"
    )]
    NoNominal {
        /// The joint.
        joint: JointIndex,
    },
    /// The description gives only the position of a spring or crank.
    #[error(
        "a spring, counterbalance or crank of joint {joint} has no numbers, and there is nothing to simulate without them; \
         add stiffness and rest, stiffness and pull, or the crank's mass, centre and inertia in the robot description"
    )]
    NoSpring {
        /// The joint.
        joint: JointIndex,
    },
    /// A link's first moment needs a mass to have a centre.
    #[error("link {joint} has a first moment mP but no mass m; give its mass in the robot description")]
    FirstMomentWithoutMass {
        /// The joint that moves the link.
        joint: JointIndex,
    },
    /// Too few or too many joints.
    #[error("the robot has {joints} joints; 1 to {MAX_JOINTS} can be simulated")]
    JointCount {
        /// Joints of the description.
        joints: usize,
    },
    /// Limits that no motion can keep.
    #[error(
        "the limits of joint {joint} leave no motion; position_min must lie below position_max, and velocity and \
         acceleration must be positive"
    )]
    BadLimits {
        /// The joint.
        joint: JointIndex,
    },
    /// The excitation lacks coefficients.
    #[error(
        "the excitation of the robot description does not fit its {joints} joints: a, b and centre need one row a \
         joint, a and b equally many coefficients, and the base frequency must be positive"
    )]
    ExcitationShape {
        /// Joints of the description.
        joints: usize,
    },
    /// The excitation leaves the limits.
    #[error(
        "the excitation takes joint {joint} to a {what} of {value:.4}, its limit is {limit:.4}; \
         scale its coefficients or move its centre"
    )]
    ExcitationOutsideLimits {
        /// The joint.
        joint: JointIndex,
        /// The quantity that leaves its limit.
        what: &'static str,
        /// Its extreme, SI.
        value: f64,
        /// The limit, SI.
        limit: f64,
    },
    /// The start of the excitation cannot be reached from rest.
    #[error(
        "joint {joint} cannot reach the start of the excitation from rest inside its limits; \
         choose coefficients with zero speed at the start (sum of a = 0)"
    )]
    NoBlend {
        /// The joint.
        joint: JointIndex,
    },
    /// A point that the arm cannot go to.
    #[error("point {point}: {problem}")]
    Point {
        /// Its number, from 1.
        point: usize,
        /// The reason.
        problem: String,
    },
    /// A level that the description does not have.
    #[error(
        "there is no speed level {level}; the robot description has the levels 1 to {levels} (speed_levels)"
    )]
    NoSuchLevel {
        /// The requested level.
        level: u8,
        /// Levels of the description.
        levels: usize,
    },
    /// A setting out of its range.
    #[error("{key} = {value} is not possible; {hint}")]
    Setting {
        /// Name of the setting.
        key: &'static str,
        /// Its value.
        value: String,
        /// The valid values.
        hint: &'static str,
    },
    /// A file could not be written.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}
