//! Random arms with bodies, and their recordings.

use std::f64::consts::{FRAC_PI_2, TAU};

use armwatch_model::robot::{
    JointGeometry, JointKind, NominalJoint, Robot, StandardParameters, UrdfOrigin, WarmUpShape,
};
use armwatch_model::run::{Samples, Stage};
use armwatch_simulate::arm::dynamics::{joint_torque, rigid_chain};
use armwatch_simulate::plan::motion::MotionState;
use armwatch_testing::arms::{arm, joint};
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

pub(crate) const G: f64 = 9.81;

/// Random arm with bodies, and the properties of its recording.
pub(crate) struct Case {
    pub(crate) robot: Robot,
    pub(crate) rng: ChaCha8Rng,
    /// Ripple of gear and posture, relative to the RMS torque.
    pub(crate) ripple: f64,
    /// Noise of the torque, relative to its RMS.
    pub(crate) noise: f64,
    /// Coulomb friction, relative to the RMS torque.
    pub(crate) friction: f64,
    pub(crate) rate_hz: f64,
    pub(crate) seconds: f64,
    /// Smallest and largest amplitude of the motion, rad.
    pub(crate) swing: [f64; 2],
    pub(crate) with_velocity: bool,
}

impl Case {
    pub(crate) fn drawn(seed: u64, joints: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let robot = drawn_arm(&mut rng, joints);
        Self {
            robot,
            ripple: rng.random_range(0.01..0.05),
            noise: rng.random_range(0.002..0.01),
            friction: rng.random_range(0.04..0.2),
            rate_hz: [50.0, 100.0, 250.0][rng.random_range(0..3)],
            seconds: rng.random_range(10.0..20.0),
            swing: if rng.random_bool(0.5) { [0.26, 0.63] } else { [0.4, 1.2] },
            with_velocity: rng.random_bool(0.7),
            rng,
        }
    }

    /// Heavy arm with little motion and much ripple.
    pub(crate) fn heavy(seed: u64) -> Self {
        let case = Self::drawn(seed, 6);
        Self { ripple: 0.05, seconds: 10.0, rate_hz: 100.0, swing: [0.26, 0.63], ..case }
    }

    /// Description, without bodies.
    pub(crate) fn described(&self) -> Robot {
        let mut robot = self.robot.clone();
        robot.joints.iter_mut().for_each(|joint| joint.nominal = None);
        robot
    }

    /// Position, velocity and acceleration of every joint over time, and the torque of the rigid bodies.
    fn motion(&mut self) -> (Vec<MotionState>, Vec<Vec<f64>>) {
        let n = self.robot.joint_count();
        let rows = (self.seconds * self.rate_hz) as usize;
        let base = TAU * 0.1;
        let mut series = Vec::new();
        for joint in &self.robot.joints {
            let terms: Vec<[f64; 2]> = (1..=5)
                .map(|k| {
                    let k = f64::from(k);
                    [
                        self.rng.sample::<f64, _>(StandardNormal) / k.sqrt(),
                        self.rng.sample::<f64, _>(StandardNormal) / k.sqrt(),
                    ]
                })
                .collect();
            let at = |t: f64| -> f64 {
                terms
                    .iter()
                    .zip(1..)
                    .map(|([a, b], k)| {
                        let w = base * f64::from(k) * t;
                        a * w.cos() + b * w.sin()
                    })
                    .sum()
            };
            let peak = (0..1000).map(|i| at(0.01 * f64::from(i)).abs()).fold(0.0, f64::max);
            let room = 0.45 * (joint.limits.position_max - joint.limits.position_min);
            let amplitude = self.rng.random_range(self.swing[0]..self.swing[1]).min(room) / peak;
            let centre = 0.5 * (joint.limits.position_max + joint.limits.position_min);
            series.push((centre, amplitude, terms));
        }
        let chain = rigid_chain(&self.robot).expect("bodies");
        let mut states = Vec::new();
        let mut torque = vec![Vec::new(); n];
        for row in 0..rows {
            let t = row as f64 / self.rate_hz;
            let mut state = MotionState::default();
            for (j, (centre, amplitude, terms)) in series.iter().enumerate() {
                state.position[j] = *centre;
                for ([a, b], k) in terms.iter().zip(1..) {
                    let w = base * f64::from(k);
                    let (sine, cosine) = (w * t).sin_cos();
                    state.position[j] += amplitude * (a * cosine + b * sine);
                    state.velocity[j] += amplitude * w * (b * cosine - a * sine);
                    state.acceleration[j] -= amplitude * w * w * (a * cosine + b * sine);
                }
            }
            let tau = joint_torque(&chain, &state);
            (0..n).for_each(|j| torque[j].push(tau[j]));
            states.push(state);
        }
        (states, torque)
    }

    /// Sound recording.
    pub(crate) fn recorded(&mut self) -> Samples {
        self.recorded_with_motion().0
    }

    /// Sound recording with its motion and the torque of its bodies.
    pub(crate) fn recorded_with_motion(&mut self) -> (Samples, Vec<MotionState>, Vec<Vec<f64>>) {
        let (states, rigid) = self.motion();
        let n = self.robot.joint_count();
        let mut torque = rigid.clone();
        for j in 0..n {
            let rms = rms(&rigid[j]).max(1e-6);
            let top = states.iter().map(|s| s.velocity[j].abs()).fold(0.0, f64::max);
            let phases: [f64; 3] = std::array::from_fn(|_| self.rng.random_range(0.0..TAU));
            let teeth = self.rng.random_range(10.0..60.0_f64).round();
            let viscous = self.rng.random_range(0.5..1.5) * self.friction;
            for (tau, state) in torque[j].iter_mut().zip(&states) {
                let (q, qd) = (state.position[j], state.velocity[j]);
                let other = state.position[if j > 0 { j - 1 } else { n - 1 }];
                let ripple = 0.7 * (teeth * q + phases[0]).sin()
                    + (2.0 * q + other + phases[1]).sin()
                    + 0.7 * (3.0 * q + phases[2]).sin();
                *tau +=
                    rms * (self.ripple * ripple + self.friction * (qd / 0.01).tanh() + viscous * qd / top);
                *tau += rms * self.noise * self.rng.sample::<f64, _>(StandardNormal);
            }
        }
        (self.samples(&states, torque), states, rigid)
    }

    /// Samples of a motion with sensor noise in positions and velocities.
    fn samples(&mut self, states: &[MotionState], torque: Vec<Vec<f64>>) -> Samples {
        let n = self.robot.joint_count();
        let mut noisy = |of: fn(&MotionState) -> &[f64; 9], sigma: f64| -> Vec<Vec<f64>> {
            (0..n)
                .map(|j| {
                    states
                        .iter()
                        .map(|s| of(s)[j] + sigma * self.rng.sample::<f64, _>(StandardNormal))
                        .collect()
                })
                .collect()
        };
        let position = noisy(|s| &s.position, 2e-5);
        let velocity = self.with_velocity.then(|| noisy(|s| &s.velocity, 2e-3));
        Samples {
            time: (0..states.len()).map(|row| row as f64 / self.rate_hz).collect(),
            position,
            velocity,
            torque,
            stage: vec![Stage::Excitation; states.len()],
            ..Samples::default()
        }
    }
}

pub(crate) fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

/// Serial arm of 4 to 7 joints: shoulder, elbow and wrists, in rows of modified Denavit-Hartenberg or as a URDF.
fn drawn_arm(rng: &mut ChaCha8Rng, joints: usize) -> Robot {
    let mut long = |low: f64, high: f64| rng.random_range(low..high);
    let q = FRAC_PI_2;
    let rows: Vec<[f64; 4]> = match joints {
        4 => vec![
            [0.0, 0.0, 0.3, 0.0],
            [long(0.0, 0.1), -q, 0.0, -q],
            [long(0.3, 0.6), 0.0, 0.0, 0.0],
            [long(0.3, 0.5), 0.0, 0.1, 0.0],
        ],
        5 => vec![
            [0.0, 0.0, 0.3, 0.0],
            [long(0.0, 0.1), -q, 0.0, -q],
            [long(0.3, 0.6), 0.0, 0.0, 0.0],
            [long(0.3, 0.5), 0.0, 0.0, 0.0],
            [0.0, -q, 0.1, 0.0],
        ],
        7 => {
            let (upper, lower) = (long(0.3, 0.5), long(0.3, 0.5));
            let bend = long(0.0, 0.09);
            vec![
                [0.0, 0.0, 0.34, 0.0],
                [0.0, -q, 0.0, 0.0],
                [0.0, q, upper, 0.0],
                [bend, q, 0.0, 0.0],
                [-bend, -q, lower, 0.0],
                [0.0, q, 0.0, 0.0],
                [long(0.0, 0.09), q, 0.1, 0.0],
            ]
        }
        _ if long(0.0, 1.0) < 0.5 => vec![
            [0.0, 0.0, 0.4, 0.0],
            [long(0.05, 0.3), -q, 0.0, -q],
            [long(0.4, 1.0), 0.0, 0.0, 0.0],
            [long(0.05, 0.2), -q, long(0.4, 1.0), 0.0],
            [0.0, q, 0.0, 0.0],
            [0.0, -q, 0.1, 0.0],
        ],
        _ => vec![
            [0.0, 0.0, 0.16, 0.0],
            [0.0, q, 0.0, 0.0],
            [long(0.4, 0.7), 0.0, 0.0, 0.0],
            [long(0.4, 0.6), 0.0, 0.15, 0.0],
            [0.0, q, 0.12, 0.0],
            [0.0, -q, 0.1, 0.0],
        ],
    };
    let mut robot = arm(
        rows.iter().map(|&[a, alpha, d, offset]| joint(JointKind::Revolute, a, alpha, d, offset)).collect(),
        [0.0, 0.0, -G],
    );
    let n = robot.joint_count();
    let payload = rng.random_range(0.3..3.0);
    let heavy = rng.random_range(8.0..60.0);
    for j in 0..n {
        let reach = robot
            .joints
            .get(j + 1)
            .map_or(Vector3::new(0.0, 0.02, 0.05), |next| next.geometry.placement().translation);
        let mass = heavy / (1.0 + j as f64).powf(1.3) + if j + 1 == n { payload } else { 0.0 };
        let mut off = || rng.random_range(-0.03..0.03);
        let centre = 0.5 * reach + Vector3::new(off(), off(), off());
        let thick = 0.06 + 0.1 * reach.norm();
        let own = Matrix3::identity() * (mass * thick * thick)
            + (Matrix3::identity() * reach.norm_squared() - reach * reach.transpose()) * (mass / 12.0);
        let about = own + (Matrix3::identity() * centre.norm_squared() - centre * centre.transpose()) * mass;
        let drag = about.trace() / 3.0;
        robot.joints[j].nominal = Some(NominalJoint {
            inertial: StandardParameters([
                mass,
                mass * centre.x,
                mass * centre.y,
                mass * centre.z,
                about[(0, 0)],
                about[(0, 1)],
                about[(0, 2)],
                about[(1, 1)],
                about[(1, 2)],
                about[(2, 2)],
            ]),
            motor_inertia: drag * rng.random_range(0.3..2.0),
            friction: [0.0; 4],
            warm_up: WarmUpShape { b: 0.0, t1: 1500.0, c: 0.0, t2: 200.0 },
            torque_noise: 0.0,
        });
        robot.joints[j].limits.position_min = -1.5;
        robot.joints[j].limits.position_max = 1.5 + 0.4 * j as f64 / n as f64;
    }
    if rng.random_bool(0.4) {
        for joint in &mut robot.joints {
            let placement = *joint.geometry.placement();
            let origin =
                UrdfOrigin { xyz: placement.translation.into(), rpy: [0.0; 3], axis: [0.0, 0.0, 1.0] };
            joint.geometry = JointGeometry::urdf(placement, origin);
        }
    }
    robot
}
