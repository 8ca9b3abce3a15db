//! A run row by row: the motion of the arm, and the values that its controller records.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::servo::Servo;
use super::temperatures::TemperatureSettings;
use crate::arm::dynamics::RigidChain;
use crate::arm::fault::in_run::RunFaults;
use crate::arm::friction::{JointFriction, ThermalState};
use crate::plan::motion::PerJoint;
use crate::plan::trajectory::CyclePlan;
use armwatch_model::run::{FrictionSignal, Stage};

/// Errors of the signals relative to the true values: rad, rad/s (m, m/s) and Nm (N).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorSettings {
    /// Standard deviation of the position signal.
    pub position_noise: f64,
    /// Step of the position signal; 0 for none.
    pub position_step: f64,
    /// Standard deviation of the velocity signal.
    pub velocity_noise: f64,
    /// Step of the velocity signal; 0 for none.
    pub velocity_step: f64,
    /// Correlation of the torque signals' noise from row to row, an autoregression of order one; 0 for white noise. The
    /// standard deviation is unaffected.
    pub torque_correlation: f64,
    /// Step of the torque signals; 0 for none.
    pub torque_step: f64,
    /// A hum in the torque signals: frequency, Hz, and amplitude; each joint has its own phase.
    pub torque_hum: Option<[f64; 2]>,
}

impl Default for SensorSettings {
    /// Noise as in the controller's exports: 20 µrad and 2 mrad/s.
    fn default() -> Self {
        Self {
            position_noise: 2e-5,
            position_step: 5e-6,
            velocity_noise: 2e-3,
            velocity_step: 5e-4,
            torque_correlation: 0.0,
            torque_step: 0.0,
            torque_hum: None,
        }
    }
}

/// Heat source of a gear.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Heating {
    /// Time alone, as if the arm never rested.
    #[default]
    Time,
    /// The power that friction takes; rest cools.
    Work,
}

/// Sequence of the instants of rows, with the same mean step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Clock {
    /// Equal steps.
    #[default]
    Even,
    /// Alternately longer and shorter steps by this fraction of the mean step, like a logger whose timer has a coarser
    /// resolution.
    Alternating(f64),
    /// Each instant is off by this standard deviation, in mean steps; never more than four tenths.
    Jittering(f64),
}

impl Clock {
    /// Delay of row `row`, s, at a mean step of `step`.
    pub(crate) fn delay(self, row: u64, step: f64, rng: &mut ChaCha8Rng) -> f64 {
        let steps = match self {
            Self::Even => return 0.0,
            // the step before an odd row is longer by `part`, the one after it shorter
            Self::Alternating(part) => {
                if row % 2 == 1 {
                    part
                } else {
                    0.0
                }
            }
            Self::Jittering(std) => (std * rng.sample::<f64, _>(StandardNormal)).clamp(-0.4, 0.4),
        };
        steps * step
    }
}

/// One arm in one run.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Motions of each cycle.
    pub plan: CyclePlan,
    /// How the arm follows them.
    pub servo: Servo,
    /// Rigid dynamics.
    pub chain: RigidChain,
    /// Compliance of each joint's gear, rad/Nm (m/N); 0 for a stiff one.
    pub compliance: PerJoint,
    /// Friction of each joint in this run.
    pub friction: Vec<JointFriction>,
    /// Heat source of the gears.
    pub heating: Heating,
    /// Standard deviation of each torque signal, Nm.
    pub torque_noise: Vec<f64>,
    /// Errors of the position and velocity signals.
    pub sensors: SensorSettings,
    /// Rows per second, Hz.
    pub sample_rate_hz: f64,
    /// How their instants follow each other.
    pub clock: Clock,
    /// Cycles.
    pub cycles: u32,
    /// Temperature state at the first row.
    pub initial: ThermalState,
    /// Temperatures that the controller records.
    pub temperatures: TemperatureSettings,
    /// Faults of this run.
    pub faults: RunFaults,
}

/// One row as recorded; arrays are zero beyond the arm's joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedRow {
    /// Time since the start of the run, s.
    pub time: f64,
    /// Position signals as the model's `q`, with the position offsets: rad.
    pub position: PerJoint,
    /// Velocity signals, rad/s.
    pub velocity: PerJoint,
    /// Torque signals, Nm.
    pub torque: PerJoint,
    /// Stage signal.
    pub stage: Stage,
    /// Cycle counter, from 1.
    pub cycle: u32,
    /// Joint and level during the friction stage.
    pub signal: Option<FrictionSignal>,
    /// Temperatures of the motors by their sensors, K; zero if none are recorded.
    pub motor_temperature: PerJoint,
    /// The ambient temperature, K.
    pub ambient_temperature: f64,
}

impl Recording {
    /// Rows of each cycle: every cycle starts on a row, and the last rest is extended accordingly.
    pub fn rows_per_cycle(&self) -> u32 {
        // A duration that is a whole number of rows except for rounding must not gain a row.
        (self.plan.duration * self.sample_rate_hz - 1e-6).ceil().max(1.0) as u32
    }

    /// All rows.
    pub fn rows(&self) -> u64 {
        u64::from(self.rows_per_cycle()) * u64::from(self.cycles)
    }
}
