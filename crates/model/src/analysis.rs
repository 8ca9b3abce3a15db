//! What is computed from a run: identification, verification, friction and warm-up. An answer that
//! could not be had keeps its reason here; it is never an empty value.

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
    /// How parameters were, or would have been, estimated.
    pub estimator: Estimator,
    /// Parameters, or why there are none.
    pub identification: Result<Identification, String>,
    /// Findings for which the cycle was refused, the likeliest first; empty where it has parameters, and where
    /// there was nothing to identify them on.
    pub refusal_causes: Vec<RefusalCause>,
    /// Self-verification by joint and stage; empty without parameters.
    pub verification: Vec<TorqueRmsd>,
    /// Self-verification at the start and at the end of the warming stage; empty without parameters
    /// or warming.
    pub warming_contrast: Vec<WarmingContrast>,
    /// Noise of the torque channels in the excitation stage; empty without parameters.
    pub torque_noise: Vec<TorqueNoise>,
    /// Mean magnitude of each joint's velocity over the cycle, rad/s (m/s), `[n]`: what warms it. Empty where the
    /// channels were refused.
    pub mean_speeds: Vec<f64>,
    /// Temperatures of motors and hall, where recorded.
    pub temperatures: CycleTemperatures,
    /// Mean friction on constant-speed plateaus.
    pub friction_points: Vec<FrictionPoint>,
    /// All that later identification and verification need of the rows.
    pub factors: CycleFactors,
    /// How the parameters answer to channels that read wrong; of the first cycles of a test with parameters.
    pub response: Option<ChannelResponse>,
    /// What a user should know of the data, in sentences.
    pub remarks: Vec<String>,
    /// What was found of channels and model; those of severity refuse are why there are no parameters.
    pub findings: Vec<Finding>,
    /// What it is a recording of. A window of production has no parameters, no verification of its own and
    /// no friction points; its factors are those of rows between stages.
    pub kind: RunKind,
    /// A window of production against parameters of a test; `None` where there were none.
    pub production: Option<ProductionCheck>,
}

impl CycleAnalysis {
    /// Why nothing could be had of it: a test without parameters, a window that cannot be filtered.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        match self.kind {
            RunKind::Production if self.sample_rate > 0.0 => None,
            _ => self.identification.as_ref().err().map(String::as_str),
        }
    }

    /// Whether its numbers are given but nothing may be concluded from them.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.refusal().is_none() && self.findings.iter().any(|found| found.severity == FindingSeverity::Doubt)
    }
}

/// Mean temperatures of a cycle, K.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CycleTemperatures {
    /// Of each joint's motor `[n]`; `None` where not recorded or not believed. Empty without any record.
    pub motor: Vec<Option<f64>>,
    /// Of the hall.
    pub ambient: Option<f64>,
}

/// Torques of a window of production against those that the parameters of a test give.
#[derive(Debug, Clone, PartialEq)]
pub struct ProductionCheck {
    /// The run whose parameters they are.
    pub reference_run_id: i64,
    /// The estimator that made these parameters.
    pub estimator: Estimator,
    /// By joint.
    pub joints: Vec<JointCheck>,
    /// What causes could explain, of each joint that moves; empty where that is not known.
    pub evidence: Vec<JointEvidence>,
}

/// One joint's part of a [`ProductionCheck`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointCheck {
    /// The joint.
    pub joint: JointIndex,
    /// Deviation over all rows and over those in which the joint moves.
    pub rmsd: RmsdPair,
    /// How much of the deviation looks like friction; `None` where the joint does not move.
    pub friction: Option<FrictionExcess>,
}

/// Friction of a window beyond the test's, by least squares over the moving rows: the measured torque less the
/// estimated one as a multiple of the friction torque that the test's parameters give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionExcess {
    /// The multiple: 0.1 is a tenth more friction than in the test, negative less.
    pub excess: f64,
    /// Part of the squared deviation that it explains, 0 to 1.
    pub share: f64,
}

/// Windows of one recording of production against one test, medians over those in which the joint moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProductionJoint {
    /// The joint.
    pub joint: JointIndex,
    /// Windows behind the medians.
    pub windows: usize,
    /// Moving RMSD as a fraction of the measured torque's RMS.
    pub relative_rmsd: f64,
    /// Friction beyond the test's.
    pub friction: FrictionExcess,
    /// Moving relative RMSD of the test itself, its excitation by its own parameters; `None` where it is not known.
    pub test_relative_rmsd: Option<f64>,
}

/// How rows become parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Estimator {
    /// Least squares, every row of every joint alike.
    Ordinary,
    /// Least squares, each joint's rows weighted by one over its residual variance [3.22].
    #[default]
    Weighted,
    /// Huber's M-estimate: as weighted, and rows far off lose weight. Needs the rows themselves.
    Huber,
}

impl Estimator {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Ordinary, Self::Weighted, Self::Huber];

    /// Name as in configuration and in the view `cycles`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ordinary => "ordinary",
            Self::Weighted => "weighted",
            Self::Huber => "huber",
        }
    }

    /// What stands for it where only stored factors are at hand: single rows, which Huber's estimate weighs, are not
    /// stored, and without that it is the weighted one.
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
    /// What is left in the torque of each joint, `[n]`.
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

/// A base parameter with its uncertainty. Stands for a grouping: see
/// `armwatch_method::model::base_parameters::BaseParameters`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdentifiedParameter {
    /// Which parameter.
    pub id: ParameterId,
    /// Value in the unit of [`ParameterId::unit`].
    pub value: f64,
    /// Standard error, same unit.
    pub std_error: f64,
    /// Degrees of freedom of the standard error; not a number where they are not known. The interval
    /// is [`half_width`](crate::analysis::interval::half_width) to either side.
    pub degrees_of_freedom: f64,
}

impl IdentifiedParameter {
    /// A parameter that is left out of an estimate: it counts as zero and has no error.
    #[must_use]
    pub fn left_out(id: ParameterId) -> Self {
        Self { id, value: 0.0, std_error: f64::NAN, degrees_of_freedom: f64::NAN }
    }

    /// Whether the value says something of the parameter. One without an error is only part of a set that gives torques:
    /// it was left out and is zero, or carries the torque of one that was.
    #[must_use]
    pub fn is_shown(&self) -> bool {
        self.std_error.is_finite()
    }
}

/// What identification leaves of one joint's torque.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointResidual {
    /// The joint.
    pub joint: JointIndex,
    /// Standard deviation of the residual over the rows used, Nm.
    pub std: f64,
    /// Independent rows over these rows: so many that errors which ignore the correlation of neighbours
    /// come out as the clustered ones. Above 1 where the noise is less at the frequencies of the motion
    /// than above them, as that of a differentiated velocity.
    pub independent_share: f64,
}

/// Whether a joint moves in a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Motion {
    /// At its low-speed threshold or faster.
    Moving,
    /// Slower, or at rest.
    Slow,
}

impl Motion {
    /// Both, in their order.
    pub const BOTH: [Self; 2] = [Self::Moving, Self::Slow];

    /// That of a joint with velocity `qd` and threshold `low_speed`, rad/s (m/s).
    #[must_use]
    pub fn of(qd: f64, low_speed: f64) -> Self {
        if qd.abs() >= low_speed { Self::Moving } else { Self::Slow }
    }

    /// Name as stored.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Moving => "moving",
            Self::Slow => "slow",
        }
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
    /// Whether the joint moved.
    pub motion: Motion,
    /// Rows that the factor stands for.
    pub rows: usize,
    /// The upper triangle, column after column; the last column is that of the torque.
    pub upper: Vec<f64>,
}

/// Factors of a cycle: every usable row is in exactly one.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CycleFactors {
    /// Parameters of each joint's columns; one list for all cycles of a method.
    pub columns: Arc<[Vec<ParameterId>]>,
    /// By joint, stage and motion, those with rows.
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
    /// Standard deviation of the rows about the mean, enlarged by the error of a fitted load so that over the root of the
    /// independent rows it is the standard error of `torque`, Nm.
    pub std: f64,
    /// Rows of the plateau.
    pub samples: usize,
    /// How gravity was removed.
    pub gravity: GravityRemoval,
    /// What the gear carried, where the joint's friction law depends on it.
    pub load: Option<CarriedLoad>,
}

/// What a gear carried on a plateau.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CarriedLoad {
    /// Mean magnitude of the torque that the gear carries, Nm (N).
    pub torque: f64,
    /// Friction under load per carried torque, of the cycle's own parameters.
    pub friction: f64,
}

/// How the load of gravity was taken from a friction point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum GravityRemoval {
    /// The axis is vertical in this posture: gravity does no work on the joint.
    AxisVertical,
    /// Fitted on the friction stage of the joint [5.3] and subtracted [5.2].
    Fitted,
    /// Taken from the cycle's identified parameters.
    Model,
}

impl GravityRemoval {
    /// Name as stored.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::AxisVertical => "axis_vertical",
            Self::Fitted => "fitted",
            Self::Model => "model",
        }
    }
}

/// Shape of a warm-up curve that the data support.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum WarmUpModel {
    /// `a + b exp(-t/t1) + c exp(-t/t2)` [5.4].
    Double,
    /// `a + b exp(-t/t1)`.
    Single,
    /// `a`.
    Constant,
}

impl WarmUpModel {
    /// Name as in the view `warmup_fits`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Double => "double",
            Self::Single => "single",
            Self::Constant => "constant",
        }
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

/// Friction of a joint at one speed over the time of a run, or of all runs of a robot [5.4].
/// Times in minutes, as the equation has them.
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
    /// Fast part, Nm, and its time constant, min; only for a double exponential. Errors are not numbers where the
    /// points show only that there is one, see [`FastShown`].
    pub fast: Option<Decay>,
    /// What the points show of the fast part; with `fast`.
    pub fast_shown: Option<FastShown>,
    /// Root-mean-square deviation of the points from the curve, Nm.
    pub rmsd: f64,
    /// Points used.
    pub samples: usize,
    /// First and last time of the points, min. What the curve says beyond is extrapolated.
    pub record: [f64; 2],
}

impl WarmUpFit {
    /// Whether the warm friction `a` lies beyond the record: at its end the slow part still makes more
    /// than two standard errors of `a` and 1 % of it.
    #[must_use]
    pub fn asymptote_extrapolated(&self) -> bool {
        self.slow.is_some_and(|slow| {
            let left = slow.amplitude.value * (-self.record[1] / slow.time_constant.value).exp();
            left > (2.0 * self.a.std_error).max(0.01 * self.a.value.abs())
        })
    }
}

/// The fast part of a warm-up curve as far as the points show it: its height at t = 0 is an extrapolation, and its time
/// constant may be known from one side only, where the first cycle alone sees it.
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

/// Cycles over which statistics of a parameter are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StatisticsWindow {
    /// All cycles.
    All,
    /// Without the first five, in which the arm warms up.
    AfterFive,
}

impl StatisticsWindow {
    /// Name as in the view `parameter_statistics`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::AfterFive => "after_5",
        }
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
    /// `(max - min) / |max|`; `None` where `max` is zero.
    pub d_mm: Option<f64>,
    /// `|last - first| / |first|`; `None` where `first` is zero.
    pub d_se: Option<f64>,
    /// Sample standard deviation; `None` for a single cycle.
    pub sdv: Option<f64>,
    /// Number of cycles.
    pub cycles: usize,
}

/// What one run says of one joint, condensed for the detectors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JointSummary {
    /// The joint.
    pub joint: JointIndex,
    /// Friction once warm, or why it is unknown.
    pub warm_friction: Option<WarmFriction>,
    /// What the identified friction coefficients of the excitation say: all that recordings without a friction stage
    /// tell of friction.
    pub excitation_friction: Option<WarmFriction>,
    /// The same coefficients at half the speed of [`Self::excitation_friction`], Nm (N). Tests that reach different speeds are
    /// compared at a speed that both have.
    pub half_speed_friction: Option<Estimate>,
    /// Friction against the joint's own baseline at equal thermal state, where the robot's history gives one:
    /// known only once the run is held against that history.
    pub friction_index: Option<Estimate>,
    /// Median over the cycles of the moving relative RMSD of the excitation stage.
    pub relative_rmsd: Option<f64>,
    /// How much that RMSD swings from cycle to cycle.
    pub rmsd_swing: Option<RmsdSwing>,
    /// Median over the cycles of the noise of the torque channel, as a fraction of the torque ([`TorqueNoise::relative`]).
    pub relative_noise: Option<f64>,
    /// Median over the cycles of the RMS of the torque while the joint moves in the excitation, Nm (N).
    pub torque_rms: Option<f64>,
}

impl JointSummary {
    /// Whether the run says anything of the joint.
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
    /// Mean time of the points since the run's start, min. Runs compare at equal warmth only.
    pub minute: f64,
    /// Speed of the points as a fraction of the largest.
    pub speed_fraction: f64,
}

/// Standard deviation of a series from cycle to cycle, blind to slow trends: root of half the mean
/// squared successive difference (von Neumann 1941).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RmsdSwing {
    /// The standard deviation, same unit as the series.
    pub value: f64,
    /// Cycles that it stands on.
    pub cycles: usize,
}

/// Everything computed from a whole run, once its last cycle is stored.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RunAnalysis {
    /// Friction against time, by joint and speed.
    pub warm_up_fits: Vec<WarmUpFit>,
    /// Statistics of each parameter.
    pub statistics: Vec<ParameterStatistics>,
    /// One summary a joint.
    pub summaries: Vec<JointSummary>,
}
