//! Identification of the dynamics and friction of robot arms from recorded motion.
//!
//! Samples go in, numbers come out: no async, files, clock, randomness or logging.
//!
//! # Equations
//!
//! The joint torques of rigid links with friction are linear in the parameters `phi`. A recording shows only some of
//! their sums, the base parameters `theta`. The rows of all joints and samples, stacked, are the problem to solve:
//!
//! ```text
//! tau = Y(q, qd, qdd) phi = W theta
//! ```
//!
//! A zero-phase Butterworth low-pass `F` of fourth order acts on every channel. `qdd` is the central difference of the
//! filtered `qd`. The columns of Coulomb friction jump, so they pass the same low-pass as the torque:
//! `F tau = F(W) theta`.
//!
//! Weighted least squares weights each joint `j` by its noise and finds these weights by iteration:
//!
//! ```text
//! theta = argmin  sum_j |tau_j - W_j theta|² / s_j²,     s_j² = mean of the squared residuals of joint j
//! ```
//!
//! Friction of a joint at the speed `v` follows one of four laws. The description of the robot names the law:
//!
//! ```text
//! polynomial         f1 sign(v) + f2 v + f3 v² sign(v) + f4 v³
//! viscous, Coulomb   fs sign(v) + fv v + off
//! smooth             fs tanh(v / v0) + fv v + off
//! none               0
//! ```
//!
//! Neighbouring residuals are correlated. Blocks of time `b`, which overlap by half, are independent enough to give
//! the standard errors `sigma`. `H_b` is the taper of a block, `e` the residual and `A_b` the information without the
//! block. For independent rows the sum is too large by the factor `c`. Weights are part of `W` and `e`:
//!
//! ```text
//! sigma_k² = [ sum_b A_b⁻¹ Wᵀ H_b e eᵀ H_b W A_b⁻¹ ]_kk / c_k,     A_b = Wᵀ W - Wᵀ H_b² W
//! ```
//!
//! # Symbols
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
//!
//! # Example
//!
//! A simulated excitation of the arm in `config/robots/er3a.toml` becomes 64 base parameters:
//!
//! ```
//! use armwatch_method::analyse::{Method, analyse_cycle};
//! use armwatch_model::analysis::interval::{LEVEL, half_width};
//! use armwatch_model::analysis::settings::AnalysisSettings;
//! use armwatch_model::run::Cycle;
//! use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let description = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/robots/er3a.toml");
//! let robot = armwatch_config::read_robot(description.as_ref())?;
//! let samples = record_excitation(&robot, &ExactSettings::default())?;
//!
//! let method = Method::new(robot, AnalysisSettings::default())?;
//! let found = analyse_cycle(&method, &Cycle { number: 1, samples }).identification?;
//! assert_eq!(found.parameters.len(), 64);
//! for parameter in &found.parameters {
//!     println!("{} {} ± {}", parameter.id, parameter.value, half_width(parameter, LEVEL));
//! }
//! # Ok(())
//! # }
//! ```
//!
//! `examples/identify.rs` does the same with the recording of a real arm.
//!
//! # Reading order
//!
//! [`analyse`] is the method on one screen and calls the other modules in this order:
//!
//! 1. [`segment`] finds stages and cycles in the rows of a recording.
//! 2. [`signal`] has the low-pass and the derivatives.
//! 3. [`diagnose`] refuses recordings, and later models, that cannot be true.
//! 4. [`model`] has kinematics, the regressor and the base parameters.
//! 5. [`least_squares`] solves from triangular factors and gives the standard errors.
//! 6. [`identify`] applies it to one cycle, and [`pooled`] to many.
//! 7. [`physical`] finds the nearest parameters that bodies can have.
//! 8. [`friction`] measures friction over speed, over a run and over the life of a robot.
//! 9. [`analyse_run`] sums up a run, and [`partial_run`] its first cycles.
//! 10. [`production`] verifies the parameters of a test on logs of production.
//! 11. [`detect`] finds changes over the runs of a robot.
//!
//! [`statistics`], [`lanes`], [`buffers`] and [`spare_threads`] serve all of them.

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

/// Reason why there is no numeric result, with the values that decided it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NumericsError {
    /// There are too few rows.
    #[error("{what} has {rows} rows, at least {needed} are needed")]
    TooShort {
        /// The data that are too short.
        what: &'static str,
        /// Number of rows.
        rows: usize,
        /// Number of rows that are necessary.
        needed: usize,
    },
    /// The motion does not excite every parameter.
    #[error(
        "the motion does not show {count} of {columns} parameters ({names}): the recorded motion is too poor, \
         or a joint stands still; record the excitation stage with all joints moving"
    )]
    RankDeficient {
        /// Number of parameters that are not visible.
        count: usize,
        /// Number of all parameters.
        columns: usize,
        /// Names of the first of them.
        names: String,
    },
    /// A robot's geometry does not determine how many parameters its torques can show.
    #[error(
        "{kept} parameters are independent one after another, but {rank} singular values stand out (at the border \
         {smallest_kept:.1e} and {largest_dropped:.1e} against 1e-4): the geometry is almost degenerate; check \
         twists and offsets for rounding, and the joint limits"
    )]
    RankUnclear {
        /// Number of columns kept one by one.
        kept: usize,
        /// Number of singular values above the threshold.
        rank: usize,
        /// Singular value at the index of the last kept column.
        smallest_kept: f64,
        /// Next singular value.
        largest_dropped: f64,
    },
    /// The sample rate is too low for the low-pass.
    #[error("a sample rate of {sample_rate_hz} Hz cannot carry a low-pass at {cutoff_hz} Hz; set a cut-off below {} Hz", .sample_rate_hz / 2.0)]
    CutoffTooHigh {
        /// Sample rate, Hz.
        sample_rate_hz: f64,
        /// Requested cut-off, Hz.
        cutoff_hz: f64,
    },
    /// The number of stored values does not match a triangular factor.
    #[error("{numbers} numbers are not a triangular factor of {columns} columns and the torque")]
    NotATriangle {
        /// Number of values.
        numbers: usize,
        /// Number of columns.
        columns: usize,
    },
    /// Factors or parameters with different columns were combined.
    #[error("{0}")]
    ColumnsDiffer(String),
    /// A function that the program does not provide for such a robot.
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
        /// Number of different speeds.
        speeds: usize,
        /// Number of speeds that are necessary.
        needed: usize,
    },
    /// A matrix routine did not converge, or a number is not finite.
    #[error("{0} did not give finite numbers")]
    NotFinite(&'static str),
}
