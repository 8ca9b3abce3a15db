//! Results of a run: identification, verification, friction and warm-up. A missing result keeps its reason here; it is
//! never an empty value.

pub mod cycle_friction;
pub mod estimator_kind;
pub mod finding;
pub mod friction;
pub mod interval;
pub mod log_summary;
pub mod map_run;
pub mod measurements;
pub mod median;
pub mod refusal;
pub mod response;
pub mod settings;
mod torque_noise;
mod torque_rmsd;
pub mod work_evidence;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use finding::{Finding, FindingSeverity};

use self::refusal::RefusalCause;
use self::response::ChannelResponse;

pub use self::torque_noise::TorqueNoise;
pub use self::torque_rmsd::{Rmsd, RmsdPair, RmsdScope, TorqueRmsd, WarmingContrast};
use self::work_evidence::JointEvidence;
use crate::robot::{JointIndex, ParameterId};
use crate::run::{RunKind, Stage};

/// Everything computed from one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleAnalysis {
    /// Number of the cycle in the run, from 1.
    pub cycle: u32,
    /// Time of the first row since the start of the recording, s.
    pub start: f64,
    /// Time from the first to the last row, s.
    pub duration: f64,
    /// Rows of the cycle.
    pub rows: usize,
    /// Sample rate, Hz.
    pub sample_rate: f64,
    /// Cut-off of the analysis low-pass, Hz.
    pub cutoff: f64,
    /// Estimator of the parameters, also if estimation failed.
    pub estimator: Estimator,
    /// Parameters, or the reason why there are none.
    pub identification: Result<Identification, String>,
    /// Findings that caused the refusal of the cycle, the likeliest first; empty if it has parameters, or lacked motion
    /// for identifying them.
    pub refusal_causes: Vec<RefusalCause>,
    /// Self-verification by joint and stage; empty without parameters.
    pub verification: Vec<TorqueRmsd>,
    /// Self-verification at the start and at the end of the warming stage; empty without parameters
    /// or warming.
    pub warming_contrast: Vec<WarmingContrast>,
    /// Noise of the torque channels in the excitation stage; empty without parameters.
    pub torque_noise: Vec<TorqueNoise>,
    /// Mean magnitude of each joint's velocity over the cycle, rad/s (m/s), `[n]`: motion heats the joint. Empty if the
    /// channels were refused.
    pub mean_speeds: Vec<f64>,
    /// Motor temperatures and ambient temperature, if recorded.
    pub temperatures: CycleTemperatures,
    /// Mean friction on constant-speed plateaus.
    pub friction_points: Vec<FrictionPoint>,
    /// All data of the rows that later identification and verification need.
    pub factors: CycleFactors,
    /// Response of the parameters to channels that read wrong; for the first cycles of a test with parameters.
    pub response: Option<ChannelResponse>,
    /// Remarks on the data for a user, as sentences.
    pub remarks: Vec<String>,
    /// Findings about channels and model; those of severity refuse are the reasons for missing parameters.
    pub findings: Vec<Finding>,
    /// Kind of the recording. A production window has no parameters, no self-verification and no friction points; its
    /// factors are those of rows between stages.
    pub kind: RunKind,
    /// A production window compared with parameters of a test; `None` if there were none.
    pub production: Option<ProductionCheck>,
}

impl CycleAnalysis {
    /// Reason for a refusal: a test without parameters, or a window that cannot be filtered.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        match self.kind {
            RunKind::Production if self.sample_rate > 0.0 => None,
            _ => self.identification.as_ref().err().map(String::as_str),
        }
    }

    /// True if its values are shown, but nothing may be concluded from them.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.refusal().is_none() && self.findings.iter().any(|found| found.severity == FindingSeverity::Doubt)
    }
}

/// Mean temperatures of a cycle, K.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CycleTemperatures {
    /// Temperature of each joint's motor `[n]`; `None` if not recorded or not plausible. Empty if no motor is recorded.
    pub motor: Vec<Option<f64>>,
    /// Ambient temperature.
    pub ambient: Option<f64>,
}

/// Torques of a production window compared with those computed from the parameters of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct ProductionCheck {
    /// The run of the parameters.
    pub reference_run_id: i64,
    /// The estimator that made these parameters.
    pub estimator: Estimator,
    /// Checks by joint.
    pub joints: Vec<JointCheck>,
    /// Evidence for causes, for each joint that moves; empty if unknown.
    pub evidence: Vec<JointEvidence>,
}

/// One joint's part of a [`ProductionCheck`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointCheck {
    /// The joint.
    pub joint: JointIndex,
    /// Deviation over all rows, and over the moving ones.
    pub rmsd: RmsdPair,
    /// Part of the deviation that is proportional to friction; `None` if the joint does not move.
    pub friction: Option<FrictionExcess>,
}

/// Excess of a window's friction over the test's, by least squares over the moving rows: the measured torque minus the
/// estimated one, as a multiple of the friction torque from the test's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionExcess {
    /// The multiple: 0.1 means a tenth more friction than in the test; a negative value means less.
    pub excess: f64,
    /// Part of the squared deviation that it explains, 0 to 1.
    pub share: f64,
}

/// Windows of one production recording compared with one test: medians over the windows with motion of the joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProductionJoint {
    /// The joint.
    pub joint: JointIndex,
    /// Windows used for the medians.
    pub windows: usize,
    /// Moving RMSD as a fraction of the measured torque's RMS.
    pub relative_rmsd: f64,
    /// Excess of friction over the test's.
    pub friction: FrictionExcess,
    /// Moving relative RMSD of the test itself, its excitation with its own parameters; `None` if unknown.
    pub test_relative_rmsd: Option<f64>,
}

crate::named_enum! {
    /// Method that turns rows into parameters.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
    pub enum Estimator {
        /// Least squares with equal weight for every row of every joint.
        Ordinary = "ordinary",
        /// Least squares, each joint's rows weighted by one over its residual variance [3.22].
        #[default]
        Weighted = "weighted",
        /// Huber's M-estimate: as weighted, but rows with large residuals lose weight. Needs the rows themselves.
        Huber = "huber",
    }
}

impl Estimator {
    /// The estimator to use when only stored factors are available. Huber's estimate weights single rows, which are not
    /// stored; without these weights it is the weighted one.
    #[must_use]
    pub fn of_factors(self) -> Self {
        match self {
            Self::Ordinary => Self::Ordinary,
            Self::Weighted | Self::Huber => Self::Weighted,
        }
    }
}

/// Base parameters of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// Kept parameters in natural order.
    pub parameters: Vec<IdentifiedParameter>,
    /// Torque residual of each joint, `[n]`.
    pub residuals: Vec<JointResidual>,
    /// Samples used; each gives one row per joint.
    pub samples: usize,
    /// Condition number of the observation matrix.
    pub condition_number: f64,
    /// Condition number after scaling each column to unit norm.
    pub scaled_condition_number: f64,
    /// Standard deviation of the torque residual over all joints, Nm.
    pub residual_std: f64,
}

/// A base parameter with its uncertainty. It represents a grouping: see
/// `armwatch_method::model::base_parameters::BaseParameters`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifiedParameter {
    /// The parameter.
    pub id: ParameterId,
    /// Value in the unit of [`ParameterId::unit`].
    pub value: f64,
    /// Standard error, same unit.
    pub std_error: f64,
    /// Degrees of freedom of the standard error; NaN if unknown. The interval is
    /// [`half_width`](crate::analysis::interval::half_width) to either side.
    pub degrees_of_freedom: f64,
}

impl IdentifiedParameter {
    /// A parameter that an estimate omits: it counts as zero and has no error.
    #[must_use]
    pub fn left_out(id: ParameterId) -> Self {
        Self { id, value: 0.0, std_error: f64::NAN, degrees_of_freedom: f64::NAN }
    }

    /// True if the data determine the value. A value without an error is only part of a set that gives torques: it was
    /// omitted and is zero, or includes the torque of omitted ones.
    #[must_use]
    pub fn is_shown(&self) -> bool {
        self.std_error.is_finite()
    }
}

/// Residual of identification in one joint's torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointResidual {
    /// The joint.
    pub joint: JointIndex,
    /// Standard deviation of the residual over the rows used, Nm.
    pub std: f64,
    /// Ratio of independent rows to these rows. With this number of rows, errors that ignore the correlation of
    /// neighbours equal the clustered ones. Above 1 if the noise is smaller at the frequencies of the motion than above
    /// them, as that of a differentiated velocity.
    pub independent_share: f64,
}

crate::named_enum! {
    /// Motion of a joint in a row.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum Motion {
        /// At its low-speed threshold or faster.
        Moving = "moving",
        /// Slower, or at rest.
        Slow = "slow",
    }
}

impl Motion {
    /// Both values in order.
    pub const BOTH: [Self; 2] = [Self::Moving, Self::Slow];

    /// The motion of a joint with velocity `qd` and threshold `low_speed`, rad/s (m/s).
    #[must_use]
    pub fn of(qd: f64, low_speed: f64) -> Self {
        if qd.abs() >= low_speed { Self::Moving } else { Self::Slow }
    }
}

/// Triangular factor of `[regressor | torque]` over the rows of one joint in one stage, moving or
/// slow; see `armwatch_method::identify::joint_factors`.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueFactor {
    /// The joint.
    pub joint: JointIndex,
    /// The stage.
    pub stage: Stage,
    /// True if the joint moved.
    pub motion: Motion,
    /// Rows that the factor represents.
    pub rows: usize,
    /// The upper triangle, column after column; the last column belongs to the torque.
    pub upper: Vec<f64>,
}

/// Factors of a cycle: every usable row is in exactly one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CycleFactors {
    /// Parameters of each joint's columns; one list for all cycles of a method.
    pub columns: Arc<[Vec<ParameterId>]>,
    /// Factors with rows, by joint, stage and motion.
    pub factors: Vec<TorqueFactor>,
}

/// Mean friction torque on one constant-speed plateau: joint, speed level and direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrictionPoint {
    /// The joint that moves.
    pub joint: JointIndex,
    /// Mean time of the plateau's rows since the start of the recording, s.
    pub time: f64,
    /// Nominal speed as a fraction of the joint's largest speed.
    pub speed_fraction: f64,
    /// Mean measured speed, positive, rad/s.
    pub speed: f64,
    /// Sign of the motion, -1 or 1.
    pub direction: i8,
    /// Mean friction torque, gravity removed, signed as the motion, Nm.
    pub torque: f64,
    /// Standard deviation of the rows around the mean, Nm. The error of a fitted load is included, so that division by
    /// the root of the independent rows gives the standard error of `torque`.
    pub std: f64,
    /// Rows of the plateau.
    pub samples: usize,
    /// Method of removing gravity.
    pub gravity: GravityRemoval,
    /// Load of the gear, if the joint's friction law depends on it.
    pub load: Option<CarriedLoad>,
}

/// Load of a gear on a plateau.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CarriedLoad {
    /// Mean magnitude of the torque that the gear carries, Nm (N).
    pub torque: f64,
    /// Friction under load per carried torque, from the cycle's own parameters.
    pub friction: f64,
}

crate::named_enum! {
    /// Method of removing the load of gravity from a friction point.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    pub enum GravityRemoval {
        /// The axis is vertical in this posture: gravity does no work on the joint.
        AxisVertical = "axis_vertical",
        /// Fitted on the friction stage of the joint [5.3] and subtracted [5.2].
        Fitted = "fitted",
        /// Computed from the cycle's identified parameters.
        Model = "model",
    }
}

crate::named_enum! {
    /// Shape of a warm-up curve that the data support.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub enum WarmUpModel {
        /// `a + b exp(-t/t1) + c exp(-t/t2)` [5.4].
        Double = "double",
        /// `a + b exp(-t/t1)`.
        Single = "single",
        /// `a`.
        Constant = "constant",
    }
}

/// A value with its standard error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard error, same unit.
    pub std_error: f64,
}

/// Friction of a joint at one speed over the time of a run, or of all runs of a robot [5.4]. Times are in minutes, as
/// in the equation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WarmUpFit {
    /// The joint.
    pub joint: JointIndex,
    /// Nominal speed as a fraction of the joint's largest speed.
    pub speed_fraction: f64,
    /// Shape chosen.
    pub model: WarmUpModel,
    /// Warm friction, Nm.
    pub a: Estimate,
    /// Slow part, Nm, and its time constant, min; `None` for a constant.
    pub slow: Option<Decay>,
    /// Fast part, Nm, and its time constant, min; only for a double exponential. Errors are NaN if the points only show
    /// that there is a fast part, see [`FastShown`].
    pub fast: Option<Decay>,
    /// Properties of the fast part that the points determine; set with `fast`.
    pub fast_shown: Option<FastShown>,
    /// Root-mean-square deviation of the points from the curve, Nm.
    pub rmsd: f64,
    /// Points used.
    pub samples: usize,
    /// First and last time of the points, min. Values of the curve beyond them are extrapolated.
    pub record: [f64; 2],
}

impl WarmUpFit {
    /// True if the warm friction `a` is extrapolated beyond the record: at its end the slow part is still more than two
    /// standard errors of `a` and 1 % of it.
    #[must_use]
    pub fn asymptote_extrapolated(&self) -> bool {
        self.slow.is_some_and(|slow| {
            let left = slow.amplitude.value * (-self.record[1] / slow.time_constant.value).exp();
            left > (2.0 * self.a.std_error).max(0.01 * self.a.value.abs())
        })
    }
}

/// Properties of the fast part of a warm-up curve that the points determine. Its height at t = 0 is an extrapolation,
/// and its time constant has only an upper limit if the first cycle alone shows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FastShown {
    /// Its value at the first point, Nm.
    pub at_first: Estimate,
    /// Upper end of the 95 % interval of its time constant, min.
    pub longest: f64,
}

/// One exponential part of a warm-up curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decay {
    /// Height at t = 0, Nm.
    pub amplitude: Estimate,
    /// Time constant, min.
    pub time_constant: Estimate,
}

crate::named_enum! {
    /// Cycles used for the statistics of a parameter.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub enum StatisticsWindow {
        /// All cycles.
        All = "all",
        /// All except the first five: the arm warms up in these.
        AfterFive = "after_5",
    }
}

/// Statistics of one parameter over the cycles of a run, as the thesis defines them (Appendix H).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterStatistics {
    /// The parameter.
    pub id: ParameterId,
    /// Cycles considered.
    pub window: StatisticsWindow,
    /// Arithmetic mean.
    pub mean: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
    /// `(max - min) / |max|`; `None` if `max` is zero.
    pub d_mm: Option<f64>,
    /// `|last - first| / |first|`; `None` if `first` is zero.
    pub d_se: Option<f64>,
    /// Sample standard deviation; `None` for a single cycle.
    pub sdv: Option<f64>,
    /// Number of cycles.
    pub cycles: usize,
}

/// Results of one joint in one run, condensed for the detectors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JointSummary {
    /// The joint.
    pub joint: JointIndex,
    /// Warm friction; `None` if unknown.
    pub warm_friction: Option<WarmFriction>,
    /// Warm friction from the identified friction coefficients of the excitation: the only friction result of
    /// recordings without a friction stage.
    pub excitation_friction: Option<WarmFriction>,
    /// The same coefficients at half the speed of [`Self::excitation_friction`], Nm (N). Tests that reach different speeds are
    /// compared at a speed that both have.
    pub half_speed_friction: Option<Estimate>,
    /// Friction against the joint's own baseline at equal thermal state, where the robot's history gives one:
    /// known only once the run is held against that history.
    pub friction_index: Option<Estimate>,
    /// Median over the cycles of the moving relative RMSD of the excitation stage.
    pub relative_rmsd: Option<f64>,
    /// Swing of that RMSD between cycles.
    pub rmsd_swing: Option<RmsdSwing>,
    /// Median over the cycles of the noise of the torque channel, as a fraction of the torque
    /// ([`TorqueNoise::relative`]).
    pub relative_noise: Option<f64>,
    /// Median over the cycles of the RMS of the torque while the joint moves in the excitation, Nm (N).
    pub torque_rms: Option<f64>,
}

impl JointSummary {
    /// True if the run gives any result for the joint.
    #[must_use]
    pub fn has_result(&self) -> bool {
        self.warm_friction.is_some()
            || self.excitation_friction.is_some()
            || self.friction_index.is_some()
            || self.relative_rmsd.is_some()
    }
}

/// Friction at the reference speed over the last third of a run's cycles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct WarmFriction {
    /// Mean of the torque magnitudes of both directions, Nm.
    pub torque: f64,
    /// Standard error of that mean, Nm.
    pub std_error: f64,
    /// Mean time of the points since the run's start, min. Runs are only comparable at equal temperature.
    pub minute: f64,
    /// Speed of the points as a fraction of the largest.
    pub speed_fraction: f64,
}

/// Standard deviation of a series from cycle to cycle, without slow trends: root of half the mean squared successive
/// difference (von Neumann 1941).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RmsdSwing {
    /// The standard deviation, same unit as the series.
    pub value: f64,
    /// Number of cycles.
    pub cycles: usize,
}

/// Everything computed from a whole run, once its last cycle is stored.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunAnalysis {
    /// Friction against time, by joint and speed.
    pub warm_up_fits: Vec<WarmUpFit>,
    /// Statistics of each parameter.
    pub statistics: Vec<ParameterStatistics>,
    /// One summary per joint.
    pub summaries: Vec<JointSummary>,
}
