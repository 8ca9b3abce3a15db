//! Friction against speed and thermal state: what is computed of it. Speeds in rad/s (m/s for a sliding
//! joint), torques in Nm (N).

use serde::{Deserialize, Serialize};

use super::Estimate;
use crate::robot::JointIndex;

/// Form of friction over speed, for one direction of motion; `v` is the speed, positive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SpeedModel {
    /// `fc`.
    Coulomb,
    /// `fc + fv v`.
    CoulombViscous,
    /// `fc + fp (v / v_ref)^exponent`, `v_ref` the largest measured speed.
    PowerLaw,
    /// `fc + fv v + fs exp(-(v / vs)²)` (Armstrong-Hélouvry, Dupont & Canudas de Wit 1994).
    Stribeck,
    /// `f1 + f2 v + f3 v² + f4 v³` [3.10].
    Polynomial,
}

impl SpeedModel {
    /// All of them, fewest parameters first.
    pub const ALL: [Self; 5] =
        [Self::Coulomb, Self::CoulombViscous, Self::PowerLaw, Self::Stribeck, Self::Polynomial];

    /// Name as in the view `friction_speed_fits`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Coulomb => "coulomb",
            Self::CoulombViscous => "coulomb_viscous",
            Self::PowerLaw => "power_law",
            Self::Stribeck => "stribeck",
            Self::Polynomial => "polynomial",
        }
    }

    /// Names of its coefficients, in their order.
    #[must_use]
    pub fn coefficient_names(self) -> &'static [&'static str] {
        match self {
            Self::Coulomb => &["fc"],
            Self::CoulombViscous => &["fc", "fv"],
            Self::PowerLaw => &["fc", "fp", "exponent"],
            Self::Stribeck => &["fc", "fv", "fs", "vs"],
            Self::Polynomial => &["f1", "f2", "f3", "f4"],
        }
    }
}

/// A fitted coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedCoefficient {
    /// Name, one of [`SpeedModel::coefficient_names`].
    pub name: &'static str,
    /// Value and standard error: Nm for `fc`, `fp`, `fs`, `f1`; Nm s/rad, Nm s²/rad², Nm s³/rad³ for `fv`
    /// and `f2`, `f3`, `f4`; rad/s for `vs`; the exponent has no unit.
    pub estimate: Estimate,
    /// Whether physics holds it at zero: the data alone would have friction drive the joint. Its
    /// standard error is zero then and says nothing.
    pub at_bound: bool,
}

/// Friction of a joint over speed in one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedFit {
    /// Sign of the motion, -1 or 1.
    pub direction: i8,
    /// Form; both directions of a joint have the same.
    pub model: SpeedModel,
    /// Coefficients in the order of [`SpeedModel::coefficient_names`].
    pub coefficients: Vec<SpeedCoefficient>,
    /// Their covariance, row after row, in the product of their units; zero where at a bound.
    pub covariance: Vec<f64>,
    /// Smallest and largest measured speed, rad/s. Values beyond are extrapolated.
    pub speeds: [f64; 2],
    /// Root-mean-square deviation of the points, Nm.
    pub rmsd: f64,
    /// Weighted sum of squared residuals over the degrees of freedom; about one where the form is
    /// right and the points' scatter tells their error. `None` without freedom.
    pub reduced_chi_square: Option<f64>,
    /// Points used.
    pub points: usize,
}

/// Difference between the directions, forward less backward magnitude over the speeds that both have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asymmetry {
    /// Weighted mean difference, Nm.
    pub difference: Estimate,
    /// The same as a fraction of the mean of both directions.
    pub relative: Estimate,
    /// Speeds compared.
    pub levels: usize,
}

/// Friction of a joint over speed, both directions.
#[derive(Debug, Clone, PartialEq)]
pub struct JointSpeedFits {
    /// The joint.
    pub joint: JointIndex,
    /// One fit for each direction with enough speeds.
    pub directions: Vec<SpeedFit>,
    /// `None` with one direction only.
    pub asymmetry: Option<Asymmetry>,
    /// Information criterion of each form that could be tried; the smallest was chosen among those
    /// whose parts the data support.
    pub criteria: Vec<(SpeedModel, f64)>,
    /// What was missing, in sentences.
    pub remarks: Vec<String>,
}

/// How a gearbox warms in motion and cools at rest: two coldnesses, each of first order, of which the
/// slow one has the share `slow_share` in friction. A coldness is one where the gearbox is as cold as its
/// surroundings and zero after endless motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThermalLaw {
    /// Time constant of the slow part in motion, s.
    pub slow_s: Estimate,
    /// Time constant of the fast part in motion, s.
    pub fast_s: Estimate,
    /// Share of the slow part in the coldness that friction sees, 0 to 1.
    pub slow_share: Estimate,
    /// Time constants at rest as a multiple of those in motion.
    pub cooling_ratio: Estimate,
}

/// What the thermal state of a joint is taken from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThermalSource {
    /// Motion and rest alone.
    Motion,
    /// The slow part from the motor's temperature `T`: `(exp(k x) - 1) / (exp(k) - 1)` with
    /// `x = (warm - T) / (warm - cold)`; the fast part, what the sensor does not show, from motion.
    MotorTemperature {
        /// Temperature at which the slow part is zero, K.
        warm: f64,
        /// Temperature at which it is one, K.
        cold: f64,
        /// The curvature `k`; 0 is a line.
        curvature: Estimate,
    },
    /// Motion and rest, and as many times `coldness` more as the hall is colder than usual, in K.
    AmbientAndMotion {
        /// The usual temperature of the hall, K.
        usual: f64,
        /// Coldness for a kelvin, 1/K.
        coldness: Estimate,
    },
}

impl ThermalSource {
    /// Name as in the view `friction_map`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Motion => "motion",
            Self::MotorTemperature { .. } => "motor_temperature",
            Self::AmbientAndMotion { .. } => "ambient_and_motion",
        }
    }
}

/// Friction at one speed level as a line over coldness: `warm + cold x`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapLevel {
    /// Nominal speed as a fraction of the joint's largest speed.
    pub speed_fraction: f64,
    /// Friction of the warm joint, mean of both directions, Nm.
    pub warm: Estimate,
    /// What a joint as cold as its surroundings has more, Nm; zero or more.
    pub cold: Estimate,
}

/// Friction of a joint over speed and thermal state, from all runs of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct FrictionMap {
    /// The joint.
    pub joint: JointIndex,
    /// Warming and cooling. With a motor's temperature only `fast_s` and `slow_share` are fitted and used; the
    /// others keep what is assumed.
    pub law: ThermalLaw,
    /// What the thermal state is taken from.
    pub source: ThermalSource,
    /// By speed level, slowest first.
    pub levels: Vec<MapLevel>,
    /// Covariance, row after row, of `warm` of each level, `cold` of each level, then the logarithms of
    /// `slow_s` and `fast_s`, `slow_share` and the logarithm of `cooling_ratio`; then, where the hall's temperature
    /// is used, of the coldness for a kelvin, where the motor's is, of the curvature.
    pub covariance: Vec<f64>,
    /// Root-mean-square of the residuals as a fraction of friction, after each run's offset and index.
    pub relative_rmsd: f64,
    /// Part of friction's variance at each level that warm-up and ambient explain, 0 to 1.
    pub explained: f64,
    /// Runs used.
    pub runs: usize,
    /// Points used, means of both directions.
    pub points: usize,
    /// What the data do not tell, in sentences.
    pub remarks: Vec<String>,
}

/// Friction of a joint in one run against the robot's own baseline at equal speed and thermal state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionIndex {
    /// The joint.
    pub joint: JointIndex,
    /// 1 = unchanged, with its standard error; that of the baseline is in it.
    pub index: Estimate,
    /// Friction of the run as it was measured, against that of the baseline; not a number without a level in
    /// common. What it varies by more than the index, warm-up and hall explain.
    pub raw: f64,
    /// Coldness beyond the predicted one that lasted through the run, as a colder hall gives.
    pub ambient: Estimate,
    /// Predicted coldness at the start of the run, slow and fast part mixed, 0 to 1.
    pub coldness_at_start: f64,
    /// Points that the run has of the joint.
    pub points: usize,
    /// Whether the run was too short for the map, so that its thermal state stands on the map alone.
    pub short: bool,
}

/// Friction of one joint in one cycle as one number that compares between cycles of equal levels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CycleFriction {
    /// The joint.
    pub joint: JointIndex,
    /// Mean time of the friction points since the start of the recording, min.
    pub minute: f64,
    /// Mean over the speed levels of the natural logarithm of half the difference between both directions, of Nm (N).
    pub ln_torque: f64,
    /// Mean over the levels of half the sum of both directions, Nm (N): what does not turn over with the direction.
    pub offset: f64,
    /// Levels with both directions.
    pub levels: u32,
    /// Mean of their speeds as fractions of the largest. Two cycles compare if this and `levels` are the same.
    pub speed_fraction: f64,
}

impl CycleFriction {
    /// Whether two cycles have the same levels.
    #[must_use]
    pub fn compares_with(&self, other: &Self) -> bool {
        self.levels == other.levels && (self.speed_fraction - other.speed_fraction).abs() < 1e-3
    }
}
