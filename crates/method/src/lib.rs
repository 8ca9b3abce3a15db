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

pub mod buffers;
pub mod spare_threads;
pub mod lanes;
pub mod statistics;
pub mod signal;
pub mod segment;
pub mod least_squares;
pub mod model;
pub mod identify;
pub mod pooled;
pub mod physical;
pub mod diagnose;
pub mod friction;
pub mod detect;
pub mod analyse;
pub mod analyse_run;
pub mod production;
pub mod partial_run;

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
    /// The stored numbers are too few or too many for a triangular factor.
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
        joint: armwatch_model::robot::JointIndex,
        /// Different speeds there are.
        speeds: usize,
        /// Speeds needed.
        needed: usize,
    },
    /// A matrix routine did not converge, or a number is not finite.
    #[error("{0} did not give finite numbers")]
    NotFinite(&'static str),
}
