//! Results on friction over speed and thermal state. Speeds in rad/s (m/s for a sliding joint), torques in Nm (N).

use serde::{Deserialize, Serialize};

use super::Estimate;
use crate::robot::JointIndex;

crate::named_enum! {
    /// Form of friction over speed, for one direction of motion; `v` is the speed, positive.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum SpeedModel {
        /// `fc`.
        Coulomb = "coulomb",
        /// `fc + fv v`.
        CoulombViscous = "coulomb_viscous",
        /// `fc + fp (v / v_ref)^exponent`, `v_ref` the largest measured speed.
        PowerLaw = "power_law",
        /// `fc + fv v + fs exp(-(v / vs)²)` (Armstrong-Hélouvry, Dupont & Canudas de Wit 1994).
        Stribeck = "stribeck",
        /// `f1 + f2 v + f3 v² + f4 v³` [3.10].
        Polynomial = "polynomial",
    }
}

impl SpeedModel {
    /// Names of its coefficients, in order.
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
    /// Value and standard error: Nm for `fc`, `fp`, `fs`, `f1`; Nm s/rad, Nm s²/rad², Nm s³/rad³ for `fv` and `f2`,
    /// `f3`, `f4`; rad/s for `vs`; the exponent has no unit.
    pub estimate: Estimate,
    /// True if a physical constraint keeps it at zero: with the data alone, friction would drive the joint. Its
    /// standard error is zero then and has no meaning.
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
    /// Smallest and largest measured speed, rad/s. Values outside are extrapolated.
    pub speeds: [f64; 2],
    /// Root-mean-square deviation of the points, Nm.
    pub rmsd: f64,
    /// Weighted sum of squared residuals over the degrees of freedom; about one if the form is right and the points'
    /// scatter equals their error. `None` without freedom.
    pub reduced_chi_square: Option<f64>,
    /// Points used.
    pub points: usize,
}

/// Difference between the directions: forward minus backward magnitude over the speeds that both have.
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
    /// Information criterion of each form that could be fitted. The form with the smallest one was chosen, among those
    /// whose parts the data support.
    pub criteria: Vec<(SpeedModel, f64)>,
    /// Missing data, as sentences.
    pub remarks: Vec<String>,
}

/// Warming of a gearbox in motion and cooling at rest: two coldnesses, each of first order; the slow one has the share
/// `slow_share` in friction. A coldness is one if the gearbox is at ambient temperature, and zero after endless motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThermalLaw {
    /// Time constant of the slow part in motion, s.
    pub slow_s: Estimate,
    /// Time constant of the fast part in motion, s.
    pub fast_s: Estimate,
    /// Share of the slow part in the coldness that determines friction, 0 to 1.
    pub slow_share: Estimate,
    /// Time constants at rest as a multiple of those in motion.
    pub cooling_ratio: Estimate,
}

/// Source of a joint's thermal state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ThermalSource {
    /// Only motion and rest.
    Motion,
    /// The slow part is computed from the motor's temperature `T`: `(exp(k x) - 1) / (exp(k) - 1)` with `x = (warm - T)
    /// / (warm - cold)`. The fast part, which the sensor does not show, is computed from motion.
    MotorTemperature {
        /// Temperature of a slow part of zero, K.
        warm: f64,
        /// Temperature of a slow part of one, K.
        cold: f64,
        /// The curvature `k`; 0 is a line.
        curvature: Estimate,
    },
    /// Motion and rest, plus `coldness` for each kelvin of an ambient temperature below the usual one.
    AmbientAndMotion {
        /// The usual ambient temperature, K.
        usual: f64,
        /// Coldness per kelvin, 1/K.
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
    /// Additional friction of a joint at ambient temperature, Nm; zero or more.
    pub cold: Estimate,
}

/// Friction of a joint over speed and thermal state, from all runs of a robot.
#[derive(Debug, Clone, PartialEq)]
pub struct FrictionMap {
    /// The joint.
    pub joint: JointIndex,
    /// Warming and cooling. Only `fast_s` and `slow_share` are fitted and used if the source is a motor's temperature;
    /// the others keep their assumed values.
    pub law: ThermalLaw,
    /// Source of the thermal state.
    pub source: ThermalSource,
    /// By speed level, slowest first.
    pub levels: Vec<MapLevel>,
    /// Covariance, row after row, of `warm` of each level, `cold` of each level, then the logarithms of `slow_s` and
    /// `fast_s`, `slow_share` and the logarithm of `cooling_ratio`. Then follows the coldness per kelvin if the ambient
    /// temperature is used, or the curvature if the motor's temperature is used.
    pub covariance: Vec<f64>,
    /// Root-mean-square of the residuals as a fraction of friction, after each run's offset and index.
    pub relative_rmsd: f64,
    /// Part of friction's variance at each level that warm-up and ambient temperature explain, 0 to 1.
    pub explained: f64,
    /// Runs used.
    pub runs: usize,
    /// Points used, means of both directions.
    pub points: usize,
    /// Facts that the data do not determine, as sentences.
    pub remarks: Vec<String>,
}

/// Friction of a joint in one run relative to the robot's own baseline at equal speed and thermal state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionIndex {
    /// The joint.
    pub joint: JointIndex,
    /// 1 = unchanged, with its standard error, which includes that of the baseline.
    pub index: Estimate,
    /// Measured friction of the run relative to that of the baseline; NaN without a common level. Warm-up and ambient
    /// temperature explain its additional variation compared with the index.
    pub raw: f64,
    /// Coldness in addition to the predicted one that lasted through the run, as at a lower ambient temperature.
    pub ambient: Estimate,
    /// Predicted coldness at the start of the run, slow and fast part mixed, 0 to 1.
    pub coldness_at_start: f64,
    /// Number of the run's points for the joint.
    pub points: usize,
    /// True if the run was too short for the map, so that its thermal state depends on the map alone.
    pub short: bool,
}

/// Friction of one joint in one cycle as one number that is comparable between cycles with equal levels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CycleFriction {
    /// The joint.
    pub joint: JointIndex,
    /// Mean time of the friction points since the start of the recording, min.
    pub minute: f64,
    /// Mean over the speed levels of the natural logarithm of half the difference between both directions, of Nm (N).
    pub ln_torque: f64,
    /// Mean over the levels of half the sum of both directions, Nm (N): the part that does not change its sign with the
    /// direction.
    pub offset: f64,
    /// Levels with both directions.
    pub levels: u32,
    /// Mean of their speeds as fractions of the largest. Two cycles are comparable if this and `levels` are equal.
    pub speed_fraction: f64,
}

impl CycleFriction {
    /// True if two cycles have the same levels.
    #[must_use]
    pub fn compares_with(&self, other: &Self) -> bool {
        self.levels == other.levels && (self.speed_fraction - other.speed_fraction).abs() < 1e-3
    }
}
