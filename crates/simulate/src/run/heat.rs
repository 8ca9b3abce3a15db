//! Temperatures as reported by drives: two masses per joint, heated by losses of motor and gear.
//!
//! Winding and rotor take the copper losses. The housing takes the gear's friction and the heat from the motor, and
//! transfers it to the ambient air. This model does not contain the effect of temperature on friction: that is separate
//! ([`crate::arm::friction`]), because a motor's sensor is not in the oil.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::recording::Recording;
use super::temperatures::{TemperatureSettings, USUAL_AMBIENT};
use crate::arm::dynamics::joint_torque;
use crate::arm::friction::{friction_torque_at, turned_at, with_direction_and_load};
use crate::plan::motion::PerJoint;
use armwatch_model::robot::{JointIndex, MAX_JOINTS};
use armwatch_model::run::temperature::ZERO_CELSIUS;

/// Temperature rise of the motor above its housing, and of the housing above ambient, in continuous usual motion, K.
const MOTOR_RISE: f64 = 12.0;
const HOUSING_RISE: f64 = 18.0;
/// Time constant of a housing whose gear is described without a warm-up, s.
const USUAL_HOUSING_S: f64 = 3000.0;
/// Time between two updates of a temperature by a drive, s; it repeats the value in between.
const READING_S: f64 = 1.0;
/// Time step of the calculation of the plan's usual losses, s.
const PLAN_STEP_S: f64 = 0.2;
/// Time step before the first row, s: far below every time constant.
const BEFORE_STEP_S: f64 = 5.0;
/// Stream of the sensors' noise: far from those of other channels, so that these stay the same with and without
/// sensors.
const SENSOR_STREAM: u64 = 1 << 40;

/// A joint as two masses. Losses and conductances are relative: the usual copper loss is 1, and so is the usual
/// friction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Masses {
    /// Usual losses: N²m² of the motor's torque, W of friction.
    usual: [f64; 2],
    /// Heat capacities of motor and housing over their conductances, s.
    time: [f64; 2],
    /// Temperatures of motor and housing above ambient, K.
    above: [f64; 2],
}

impl Masses {
    /// Steps by `dt`, s, with copper and friction losses relative to the usual.
    fn step(&mut self, [copper, friction]: [f64; 2], dt: f64) {
        let [motor, housing] = self.above;
        // conductances that give the usual rises at the usual losses
        let (inner, outer) = (1.0 / MOTOR_RISE, 2.0 / HOUSING_RISE);
        let between = inner * (motor - housing);
        self.above[0] += dt / (inner * self.time[0]) * (copper - between);
        self.above[1] += dt / (outer * self.time[1]) * (friction + between - outer * housing);
    }
}

/// Temperatures during a run, and their sensors.
#[derive(Debug, Clone)]
pub(super) struct Heat {
    settings: TemperatureSettings,
    masses: Vec<Masses>,
    ambient: f64,
    rng: ChaCha8Rng,
    next_reading: f64,
    reading: SensorReading,
}

/// Readings of the sensors, K.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct SensorReading {
    pub motor: PerJoint,
    pub ambient: f64,
}

impl Heat {
    /// Creates the state at the first row of a run: warmed in usual motion for the same time as the run's gears.
    pub fn new(recording: &Recording, settings: TemperatureSettings, seed: u64, stream: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(SENSOR_STREAM + stream);
        let usual = usual_losses(recording);
        let masses = recording.friction.iter().zip(usual).map(|(friction, usual)| {
            let slow = friction.warm_up.t1;
            let time = [settings.lag_s, if slow > 0.0 { slow } else { USUAL_HOUSING_S }];
            let mut masses = Masses { usual, time, above: [0.0; 2] };
            for _ in 0..(recording.initial.seconds / BEFORE_STEP_S) as usize {
                masses.step([1.0, 1.0], BEFORE_STEP_S);
            }
            masses
        });
        Self {
            settings,
            masses: masses.collect(),
            ambient: USUAL_AMBIENT + recording.initial.ambient_offset_k,
            rng,
            next_reading: 0.0,
            reading: SensorReading::default(),
        }
    }

    /// Readings of the sensors at `time`, s, before the losses of `dt`, s: torque of each joint, Nm, and friction, W.
    pub fn step(&mut self, time: f64, dt: f64, torque: &PerJoint, friction: &PerJoint) -> SensorReading {
        // half a row of tolerance
        if time >= self.next_reading - 0.5 * dt {
            self.next_reading += READING_S;
            self.read();
        }
        for (j, masses) in self.masses.iter_mut().enumerate() {
            let [copper, power] = masses.usual;
            masses.step([torque[j] * torque[j] / copper, friction[j] / power], dt);
        }
        self.reading
    }

    fn read(&mut self) {
        let mut sensor = |kelvin: f64| {
            let noisy = kelvin + self.settings.noise_k * self.rng.sample::<f64, _>(StandardNormal);
            // drives round degrees, not kelvins
            ((noisy - ZERO_CELSIUS) / self.settings.step_k).round() * self.settings.step_k + ZERO_CELSIUS
        };
        for (j, masses) in self.masses.iter().enumerate() {
            self.reading.motor[j] = sensor(self.ambient + masses.above[0]);
        }
        self.reading.ambient = sensor(self.ambient);
    }
}

/// Mean squared torque, N²m², and mean friction power, W, of each joint over a cycle with warm gears, without the
/// requested rest at its end; never zero.
pub(super) fn usual_losses(recording: &Recording) -> Vec<[f64; 2]> {
    let mut sums = vec![[0.0; 2]; recording.friction.len()];
    let mut segments = recording.plan.segments.iter().peekable();
    let mut current = None;
    let steps = (recording.plan.working_s / PLAN_STEP_S) as u32;
    for step in 0..steps {
        let t = f64::from(step) * PLAN_STEP_S;
        while let Some(segment) = segments.next_if(|segment| segment.start <= t) {
            current = Some(segment);
        }
        let Some(segment) = current else { continue };
        let state = segment.state_at(t);
        let rigid = joint_torque(&recording.chain, &state);
        for (j, friction) in recording.friction.iter().enumerate() {
            let qd = state.velocity[j];
            let carried =
                rigid[j] - recording.chain.motor_inertia(JointIndex::new(j)) * state.acceleration[j];
            let turned = turned_at(friction, qd);
            let plain = friction_torque_at(friction, &friction.warm, qd, turned);
            let lost = with_direction_and_load(friction, plain, (carried, qd), turned);
            sums[j][0] += (rigid[j] + lost).powi(2);
            sums[j][1] += lost * qd;
        }
    }
    let steps = f64::from(steps.max(1));
    sums.into_iter().map(|sum| sum.map(|sum| (sum / steps).max(f64::MIN_POSITIVE))).collect()
}

/// Losses of a row: friction power of each joint, W.
pub(super) fn friction_power(lost: &PerJoint, velocity: &PerJoint) -> PerJoint {
    std::array::from_fn::<f64, MAX_JOINTS, _>(|j| lost[j] * velocity[j])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tolerance of temperatures after some ten thousand steps of first order.
    const STEPPING: f64 = 0.05;

    fn masses() -> Masses {
        Masses { usual: [1.0, 1.0], time: [600.0, 2400.0], above: [0.0; 2] }
    }

    #[test]
    fn endless_usual_motion_makes_the_usual_rises_and_rest_takes_them_away() {
        let mut joint = masses();
        (0..40_000).for_each(|_| joint.step([1.0, 1.0], 1.0));
        assert!((joint.above[1] - HOUSING_RISE).abs() < STEPPING, "{joint:?}");
        assert!((joint.above[0] - HOUSING_RISE - MOTOR_RISE).abs() < STEPPING, "{joint:?}");
        (0..40_000).for_each(|_| joint.step([0.0, 0.0], 1.0));
        assert!(joint.above.iter().all(|above| above.abs() < STEPPING), "{joint:?}");
    }

    #[test]
    fn heat_that_goes_in_is_stored_or_comes_out() {
        let mut joint = masses();
        let (inner, outer) = (1.0 / MOTOR_RISE, 2.0 / HOUSING_RISE);
        let (mut put_in, mut come_out) = (0.0, 0.0);
        for second in 0..3000 {
            let losses = [f64::from(second % 7), f64::from(second % 3)];
            put_in += losses[0] + losses[1];
            come_out += outer * joint.above[1];
            joint.step(losses, 1.0);
        }
        let stored = inner * joint.time[0] * joint.above[0] + outer * joint.time[1] * joint.above[1];
        assert!((put_in - come_out - stored).abs() < 1e-9 * put_in, "{put_in} {come_out} {stored}");
    }

    #[test]
    fn a_motor_is_ahead_of_its_housing_in_motion() {
        let mut joint = masses();
        (0..300).for_each(|_| joint.step([1.0, 1.0], 1.0));
        assert!(joint.above[0] > 2.0 * joint.above[1], "{joint:?}");
    }
}
