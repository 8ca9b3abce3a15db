//! Records a run: the torques of the true arm along its plan, through sensors and clock.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::arm_thermal_state::ArmThermalState;
use super::heat::{Heat, SensorReading, friction_power};
use super::recording::{RecordedRow, Recording};
use super::truth::{CycleTruth, FrictionLevelTruth, JointThermalTruth};
use crate::arm::dynamics::joint_torque;
use crate::arm::elastic::motor_state;
use crate::arm::friction::{
    JointFriction, coefficients_with, friction_torque_at, ripple_torque, turned_along,
    with_direction_and_load,
};
use crate::plan::motion::{MotionPiece, MotionState, PerJoint};
use crate::plan::trajectory::{CyclePlan, Segment};
use armwatch_model::robot::{FRICTION_COUNT, JointIndex, MAX_JOINTS};

/// Noise of the clock has separate random streams, so that it changes no other noise.
const CLOCK_STREAM: u64 = 1 << 40;
/// Phase shift of the hum from joint to joint: the golden angle, so that no two are alike.
const HUM_PHASE: f64 = 2.399_963;

/// Passes each row of the run to `sink` and returns its true values, cycle by cycle.
///
/// `seed` and `stream` select the noise.
///
/// # Errors
/// The first error of `sink`.
pub fn record<E>(
    recording: &Recording,
    seed: u64,
    stream: u64,
    mut sink: impl FnMut(&RecordedRow) -> Result<(), E>,
) -> Result<Vec<CycleTruth>, E> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    let rows_per_cycle = recording.rows_per_cycle();
    let mut truths = Vec::new();
    let sensors = recording.temperatures;
    let recorded = sensors.columns.motor || sensors.columns.ambient;
    let mut heat = recorded.then(|| Heat::new(recording, sensors, seed, stream));
    let dt = recording.sample_rate_hz.recip();
    let mut clock_rng = ChaCha8Rng::seed_from_u64(seed);
    clock_rng.set_stream(CLOCK_STREAM + stream);
    let mut gears = Gears::default();
    let mut torque_noise = [0.0; MAX_JOINTS];
    let mut faults = recording.faults.clone();
    let mut thermal_state = ArmThermalState::new(recording);
    for cycle in 1..=recording.cycles {
        faults.begin_cycle(cycle);
        let first = u64::from(cycle - 1) * u64::from(rows_per_cycle);
        let start_s = first as f64 / recording.sample_rate_hz;
        let mut tally = PlateauTally::new(&recording.plan);
        let at_start = thermal_state.multipliers(recording, start_s);
        for k in 0..rows_per_cycle {
            // a cycle begins with its first row
            let earliest = if k == 0 { 0.0 } else { -dt };
            let late = recording.clock.delay(first + u64::from(k), dt, &mut clock_rng).max(earliest);
            let t = f64::from(k) / recording.sample_rate_hz + late;
            let segment = tally.segment_at(&recording.plan, t);
            let path = |t: f64| recording.servo.state_at(&recording.plan, segment, t);
            let links = path(t);
            let bends = recording.compliance.iter().any(|compliance| *compliance > 0.0);
            let state = match bends {
                true => motor_state(&recording.chain, &recording.compliance, &path, t),
                false => links,
            };
            let time = (first + u64::from(k)) as f64 / recording.sample_rate_hz + late;
            let turned = gears.turn(recording, &state);
            let (mut torque, lost) = true_torque(
                recording,
                (faults.friction(), &thermal_state.multipliers(recording, time)),
                (&links, &state, &turned),
                time,
                segment,
                t,
                &mut tally,
            );
            let power = friction_power(&lost, &state.velocity);
            thermal_state.step(recording, dt, &power);
            faults.loosen(&recording.chain, &state, time, &mut torque);
            faults.push(t / recording.plan.duration, &mut torque);
            let mut row =
                measured(recording, &mut rng, &mut torque_noise, (time, cycle, segment), &state, torque);
            faults.distort(time, &mut row.position, &mut row.torque);
            row.torque = row.torque.map(|torque| stepped(torque, recording.sensors.torque_step));
            let reading = heat.as_mut().map(|heat| heat.step(time, dt, &torque, &power));
            let SensorReading { motor, ambient } = reading.unwrap_or_default();
            sink(&RecordedRow { motor_temperature: motor, ambient_temperature: ambient, ..row })?;
        }
        truths.push(tally.into_truth(recording, cycle, start_s, &at_start));
    }
    Ok(truths)
}

/// Torque at each joint, and the part of it that the gears lose; also adds up plateau friction. `links` moves as
/// planned, `state` is the motion of the motors: the same unless gears bend.
fn true_torque(
    recording: &Recording,
    (friction_factor, thermal_state): (&PerJoint, &PerJoint),
    (links, state, turned): (&MotionState, &MotionState, &PerJoint),
    time: f64,
    segment: &Segment,
    t: f64,
    tally: &mut PlateauTally,
) -> (PerJoint, PerJoint) {
    let settled = recording.servo.settled_after();
    let plateau = match &segment.motion {
        MotionPiece::Plateaus(p) => {
            let direction = p.plateau_direction(segment.own_time(t));
            // an arm that is behind its plan comes to constant speed later
            let is_steady = settled <= 0.0 || p.plateau_direction(segment.own_time(t - settled)) == direction;
            direction.filter(|_| is_steady).map(|direction| (p.joint, direction))
        }
        _ => None,
    };
    // torque for the links, and for the inertia of the motors along their own motion
    let mut torque = joint_torque(&recording.chain, links);
    for (j, torque) in torque.iter_mut().enumerate() {
        let inertia = recording.chain.motor_inertia(JointIndex::new(j));
        *torque += inertia * (state.acceleration[j] - links.acceleration[j]);
    }
    let rigid = torque;
    let mut all_lost = [0.0; MAX_JOINTS];
    for (j, friction) in recording.friction.iter().enumerate() {
        let (q, qd) = (state.position[j], state.velocity[j]);
        let plain =
            friction_torque_at(friction, &coefficients_with(friction, thermal_state[j]), qd, turned[j]);
        let carried = rigid[j] - recording.chain.motor_inertia(JointIndex::new(j)) * state.acceleration[j];
        let lost = friction_factor[j] * with_direction_and_load(friction, plain, (carried, qd), turned[j]);
        torque[j] += lost + ripple_torque(friction, q, qd);
        all_lost[j] = lost;
        if let Some((joint, direction)) = plateau
            && joint == j
        {
            tally.add(time, direction, qd.abs(), lost);
        }
    }
    (torque, all_lost)
}

/// Memory of the gears from row to row: the state of their Coulomb friction.
#[derive(Debug, Default)]
pub(super) struct Gears {
    /// Positions of the row before.
    pub(crate) position: Option<PerJoint>,
    pub(crate) turned: PerJoint,
}

impl Gears {
    /// Takes the motion of the next row and returns the share of each joint's Coulomb friction, -1 to 1.
    pub(crate) fn turn(&mut self, recording: &Recording, state: &MotionState) -> PerJoint {
        let before = self.position.replace(state.position).unwrap_or(state.position);
        for (j, friction) in recording.friction.iter().enumerate() {
            let dq = state.position[j] - before[j];
            self.turned[j] = turned_along(friction, self.turned[j], dq, state.velocity[j]);
        }
        self.turned
    }
}

pub(super) fn measured(
    recording: &Recording,
    rng: &mut ChaCha8Rng,
    torque_noise: &mut PerJoint,
    (time, cycle, segment): (f64, u32, &Segment),
    state: &MotionState,
    mut torque: PerJoint,
) -> RecordedRow {
    let sensors = &recording.sensors;
    let (mut position, mut velocity) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for (j, noise) in recording.torque_noise.iter().enumerate() {
        let [p, v, t]: [f64; 3] =
            [rng.sample(StandardNormal), rng.sample(StandardNormal), rng.sample(StandardNormal)];
        position[j] = stepped(state.position[j] + sensors.position_noise * p, sensors.position_step);
        velocity[j] = stepped(state.velocity[j] + sensors.velocity_noise * v, sensors.velocity_step);
        let rho = sensors.torque_correlation;
        torque_noise[j] = rho * torque_noise[j] + (1.0 - rho * rho).sqrt() * t;
        torque[j] += noise * recording.faults.noise(j) * torque_noise[j];
        if let Some([hertz, amplitude]) = sensors.torque_hum {
            torque[j] += amplitude * (TAU * hertz * time + HUM_PHASE * j as f64).sin();
        }
    }
    RecordedRow {
        time,
        position,
        velocity,
        torque,
        stage: segment.stage,
        cycle,
        signal: segment.signal,
        motor_temperature: [0.0; MAX_JOINTS],
        ambient_temperature: 0.0,
    }
}

fn stepped(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

/// Sums over the plateaus of one cycle, and the position of the rows in the plan.
pub(super) struct PlateauTally {
    pub(super) current: usize,
    /// One entry per friction segment of the plan, by its index in the plan.
    pub(crate) levels: Vec<(usize, PlateauSums)>,
}

#[derive(Default)]
pub(super) struct PlateauSums {
    pub(crate) rows: u32,
    pub(crate) time: f64,
    pub(crate) speed: f64,
    /// Rows and sum of friction, downwards and upwards.
    pub(crate) direction: [(u32, f64); 2],
}

impl PlateauTally {
    pub(crate) fn new(plan: &CyclePlan) -> Self {
        let friction = plan.segments.iter().enumerate().filter(|(_, s)| s.signal.is_some());
        Self { current: 0, levels: friction.map(|(i, _)| (i, PlateauSums::default())).collect() }
    }

    /// The segment at `t`; times must not decrease. The last one is valid after its end.
    fn segment_at<'p>(&mut self, plan: &'p CyclePlan, t: f64) -> &'p Segment {
        while self.current + 1 < plan.segments.len() && t >= plan.segments[self.current + 1].start {
            self.current += 1;
        }
        &plan.segments[self.current]
    }

    pub(crate) fn add(&mut self, time: f64, direction: i8, speed: f64, friction: f64) {
        if let Ok(at) = self.levels.binary_search_by_key(&self.current, |(segment, _)| *segment) {
            let sums = &mut self.levels[at].1;
            sums.rows += 1;
            sums.time += time;
            sums.speed += speed;
            let (rows, sum) = &mut sums.direction[usize::from(direction > 0)];
            *rows += 1;
            *sum += friction;
        }
    }

    fn into_truth(self, recording: &Recording, cycle: u32, start_s: f64, at_start: &PerJoint) -> CycleTruth {
        let pairs = recording.friction.iter().zip(at_start);
        let joints = pairs.map(|(friction, &multiplier)| thermal_truth(friction, multiplier)).collect();
        let friction_levels = self
            .levels
            .iter()
            .filter_map(|(segment, sums)| level_truth(&recording.plan.segments[*segment], sums))
            .collect();
        CycleTruth { cycle, start_s, joints, friction_levels }
    }
}

fn thermal_truth(friction: &JointFriction, multiplier: f64) -> JointThermalTruth {
    let coefficients: [f64; FRICTION_COUNT] = coefficients_with(friction, multiplier);
    JointThermalTruth { multiplier, friction_f1_f4: coefficients }
}

fn level_truth(segment: &Segment, sums: &PlateauSums) -> Option<FrictionLevelTruth> {
    let signal = segment.signal?;
    let mean = |sum: f64, rows: u32| (rows > 0).then(|| sum / f64::from(rows));
    let [(rows_down, down), (rows_up, up)] = sums.direction;
    Some(FrictionLevelTruth {
        joint: signal.joint.number(),
        level: signal.level,
        minute: mean(sums.time, sums.rows).map(|s| s / 60.0),
        speed_rad_s: mean(sums.speed, sums.rows),
        rows: sums.rows,
        torque_positive_nm: mean(up, rows_up),
        torque_negative_nm: mean(down, rows_down),
    })
}
