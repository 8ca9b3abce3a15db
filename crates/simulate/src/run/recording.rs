//! A run row by row: what the arm does, and what its controller would record of it.

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

/// What the signals add to the truth: rad, rad/s (m, m/s) and Nm (N).
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
    /// Correlation of the torque signals' noise from row to row, an autoregression of order one; 0 for white noise. Its
    /// standard deviation stays the same.
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

/// What warms a gear.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Heating {
    /// Time alone, as if the arm never rested.
    #[default]
    Time,
    /// The power that friction takes; rest cools.
    Work,
}

/// How the instants of rows follow each other, with the same mean step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Clock {
    /// Every step alike.
    #[default]
    Even,
    /// Steps longer and shorter in turn by this part of the mean step, as of a logger whose timer has a coarser
    /// resolution.
    Alternating(f64),
    /// Each instant off by this standard deviation, in mean steps; never more than four tenths.
    Jittering(f64),
}

impl Clock {
    /// How much row `row` is late, s, where the mean step is `step`.
    pub(crate) fn delay(self, row: u64, step: f64, rng: &mut ChaCha8Rng) -> f64 {
        let steps = match self {
            Self::Even => return 0.0,
            // the step before an odd row is longer by `part`, the one behind it shorter
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
    /// Compliance of each joint's gear, rad/Nm (m/N); 0 of a stiff one.
    pub compliance: PerJoint,
    /// Friction of each joint in this run.
    pub friction: Vec<JointFriction>,
    /// What warms the gears.
    pub heating: Heating,
    /// Standard deviation of each torque signal, Nm.
    pub torque_noise: Vec<f64>,
    /// Errors of the position and velocity signals.
    pub sensors: SensorSettings,
    /// Rows a second, Hz.
    pub sample_rate_hz: f64,
    /// How their instants follow each other.
    pub clock: Clock,
    /// Cycles.
    pub cycles: u32,
    /// Warmth at the first row.
    pub initial: ThermalState,
    /// Temperatures that the controller records.
    pub temperatures: TemperatureSettings,
    /// What is wrong in this run.
    pub faults: RunFaults,
}

/// One row as recorded; arrays are zero beyond the arm's joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedRow {
    /// Time since the start of the run, s.
    pub time: f64,
    /// Position signals, rad.
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
    /// Temperatures of the motors as their sensors give them, K; zero where none are recorded.
    pub motor_temperature: PerJoint,
    /// That of the hall, K.
    pub ambient_temperature: f64,
}

impl Recording {
    /// Rows of each cycle: every cycle starts on a row, the last rest fills it up.
    #[must_use]
    pub fn rows_per_cycle(&self) -> u32 {
        // A duration that is whole but for rounding must not gain a row.
        (self.plan.duration * self.sample_rate_hz - 1e-6).ceil().max(1.0) as u32
    }

    /// All rows.
    #[must_use]
    pub fn rows(&self) -> u64 {
        u64::from(self.rows_per_cycle()) * u64::from(self.cycles)
    }
}
