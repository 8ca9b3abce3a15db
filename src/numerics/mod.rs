//! The method: samples in, numbers out. No async, files, clock, randomness or logging in here.
//!
//! | symbol | is | shape, unit |
//! |---|---|---|
//! | `q`, `qd`, `qdd` | joint position, velocity, acceleration | `[n]` rad, rad/s, rad/s² |
//! | `tau` | joint torque | `[n]` Nm |
//! | `y` | regressor of one sample, `tau = y phi` | `[n x p]` |
//! | `phi` | all parameters in natural order | `[p]` |
//! | `w` | observation matrix, stacked rows of the kept columns | `[nN x b]` |
//! | `theta` | base parameters | `[b]` |
//! | `sigma` | their standard errors | `[b]` |
//! | `r` | triangular factor of `[w \| tau]` | `[(b+1) x (b+1)]` |

pub mod analyse;
pub mod signal;
pub mod time_grid;
pub mod temperature;
pub mod stages;
pub mod motion_stages;
pub mod segment;
pub mod transmission;
pub mod kinematics;
pub mod actuator;
pub mod dynamics;
pub mod regressor;
pub mod base;
pub mod robot_check;
mod robot_text;
pub mod triangular;
pub mod jumps;
pub mod factors;
pub mod rows;
pub mod cycle_rows;
pub mod estimate;
pub mod robust;
pub mod student;
pub mod channel_delay;
pub mod covariance;
pub mod identify;
pub mod prior;
pub mod pseudo_inertia;
pub mod physical_share;
pub mod physical;
pub mod uniform_bodies;
pub mod physical_fit;
pub mod essential;
pub mod diagnose;
pub mod plausible;
pub mod refusal;
#[cfg(test)]
mod diagnose_tests;
#[cfg(test)]
mod drive_gain_tests;
#[cfg(test)]
mod estimate_tests;
#[cfg(test)]
mod physical_tests;
pub mod friction;
pub mod friction_speed;
#[cfg(test)]
mod friction_speed_tests;
pub mod friction_means;
pub mod excitation_friction;
pub mod thermal;
pub mod friction_record;
mod thermal_source;
pub mod friction_map;
mod friction_effects;
pub mod friction_index;
#[cfg(test)]
mod friction_alarm_tests;
#[cfg(test)]
mod friction_index_coverage;
#[cfg(test)]
mod friction_index_tests;
#[cfg(test)]
mod friction_temperature_tests;
pub mod whiteness;
pub mod warm_up;
mod warm_up_curve;
mod warm_up_early;
#[cfg(test)]
mod warm_up_tests;
pub mod verify;
pub mod production;
pub mod torque_series;
pub mod cross;
pub mod drive_gain;
pub mod cycle_errors;
pub mod history;
pub mod identifiability;
pub mod joint_views;
pub mod nominal_prior;
#[cfg(test)]
mod history_tests;
pub mod statistics;
pub mod detect;
pub mod detect_verdict;
mod detect_friction;
mod detect_results;
#[cfg(test)]
mod detect_results_tests;
pub mod detect_production;
#[cfg(test)]
mod detect_production_tests;
#[cfg(test)]
mod detect_tests;

/// Why numbers could not be had. Carries the figures that decided it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NumericsError {
    /// Too few rows for what was asked.
    #[error("{what} has {rows} rows, at least {needed} are needed")]
    TooShort {
        /// What was looked at.
        what: &'static str,
        /// Rows there are.
        rows: usize,
        /// Rows needed.
        needed: usize,
    },
    /// The motion does not excite every parameter.
    #[error(
        "the motion does not show {count} of {columns} parameters ({names}): the recorded motion is too poor, \
         or a joint stands still; record the excitation stage with all joints moving"
    )]
    RankDeficient {
        /// Parameters not seen.
        count: usize,
        /// Parameters asked for.
        columns: usize,
        /// The first of them.
        names: String,
    },
    /// A robot's geometry leaves open how many parameters its torques can show.
    #[error(
        "{kept} parameters are independent one after another, but {rank} singular values stand out (at the border \
         {smallest_kept:.1e} and {largest_dropped:.1e} against 1e-4): the geometry is almost degenerate; check \
         twists and offsets for rounding, and the joint limits"
    )]
    RankUnclear {
        /// Columns kept one after another.
        kept: usize,
        /// Singular values above the threshold.
        rank: usize,
        /// Singular value at the place of the last kept column.
        smallest_kept: f64,
        /// The next one.
        largest_dropped: f64,
    },
    /// The sample rate is too low for the low-pass.
    #[error("a sample rate of {sample_rate_hz} Hz cannot carry a low-pass at {cutoff_hz} Hz; set a cut-off below {} Hz", .sample_rate_hz / 2.0)]
    CutoffTooHigh {
        /// Sample rate, Hz.
        sample_rate_hz: f64,
        /// Cut-off asked for, Hz.
        cutoff_hz: f64,
    },
    /// Numbers that should be a stored triangular factor are none.
    #[error("{numbers} numbers are not a triangular factor of {columns} columns and the torque")]
    NotATriangle {
        /// Numbers there are.
        numbers: usize,
        /// Columns wanted.
        columns: usize,
    },
    /// Factors or parameters whose columns mean different things were put together.
    #[error("{0}")]
    ColumnsDiffer(String),
    /// Something that this program does not do for such a robot.
    #[error("not provided: {0}")]
    Unsupported(&'static str),
    /// A joint's friction was not measured at enough speeds.
    #[error(
        "joint {joint} has plateaus at {speeds} speed(s), friction over speed needs {needed}; record the friction \
         stage at more levels"
    )]
    TooFewSpeeds {
        /// The joint.
        joint: crate::robot::JointIndex,
        /// Different speeds there are.
        speeds: usize,
        /// Speeds needed.
        needed: usize,
    },
    /// A matrix routine did not converge, or a number is not finite.
    #[error("{0} did not give finite numbers")]
    NotFinite(&'static str),
}
