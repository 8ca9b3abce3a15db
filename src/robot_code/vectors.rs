//! Test vectors: states of an arm with the torque that the library computes for them.

use std::fmt::Write;

use super::torque::CodeParameter;
use armwatch_method::model::base_parameters::{JointState, probe_state};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_method::model::regressor::{Regressor, joint_torque_regressor, write_load_columns};
use armwatch_model::robot::{JointKind, ParameterId, Robot};

/// States in a table.
pub const VECTOR_STATES: usize = 320;

/// Largest difference of torques that is rounding, as a fraction of the joint's scale: some hundred operations in two
/// orders.
pub const ROUNDING: f64 = 1e-12;

/// Least scale of a joint's torque, as a fraction of the arm's largest torque. If the forces of the other joints nearly
/// miss a joint, by the cosine of a right angle, its torque is only rounding.
const LEAST_SCALE: f64 = 0.01;

/// States and their torques.
#[derive(Debug, Clone, PartialEq)]
pub struct TestVectors {
    /// `[VECTOR_STATES]`.
    pub states: Vec<JointState>,
    /// Torque of each state by joint, Nm (N): regressor times parameters.
    pub tau: Vec<Vec<f64>>,
    kinds: Vec<JointKind>,
}

impl TestVectors {
    /// A fixed sequence of states within the limits of the arm, and the regressor's torques for them. One of four
    /// states is random, one at rest, one slow in all joints, and in one a joint rests while the others move; one of
    /// eight has neither speed nor acceleration.
    pub fn of(robot: &Robot, parameters: &[CodeParameter]) -> Self {
        let value = |id: &ParameterId| parameters.iter().find(|of| of.id == *id).map_or(0.0, |of| of.value);
        let phi: Vec<f64> = ParameterId::natural_order(robot).iter().map(value).collect();
        let states: Vec<JointState> = (0..VECTOR_STATES).map(|index| state(robot, index)).collect();
        let mut y = Regressor::new(robot);
        let model = DynamicModel::from_parameters(robot, parameters.iter().map(|of| (of.id, of.value)));
        let torque = |state: &JointState| {
            let (mut tau, mut load) = (vec![0.0; robot.joint_count()], vec![0.0; robot.joint_count()]);
            joint_torque_regressor(robot, &state.q, &state.qd, &state.qdd, &mut y);
            model.gear_load(robot, &state.q, &state.qd, &state.qdd, &mut load);
            write_load_columns(robot, &state.qd, &load, &mut y);
            y.torque(&phi, &mut tau);
            tau
        };
        let tau = states.iter().map(torque).collect();
        Self { states, tau, kinds: robot.joints.iter().map(|joint| joint.kind).collect() }
    }

    /// Largest torque of each joint, Nm (N).
    pub fn largest_torques(&self) -> Vec<f64> {
        let largest = |j: usize| self.tau.iter().map(|tau| tau[j].abs()).fold(0.0, f64::max);
        (0..self.kinds.len()).map(largest).collect()
    }

    /// Scale of each joint's torque, Nm (N): its largest torque, at least a hundredth of the arm's largest torque; 1 if
    /// no joint has a torque.
    pub fn torque_scales(&self) -> Vec<f64> {
        let largest = self.largest_torques();
        let of_arm = largest.iter().copied().fold(0.0, f64::max);
        let least = if of_arm > 0.0 { LEAST_SCALE * of_arm } else { 1.0 };
        largest.into_iter().map(|largest| largest.max(least)).collect()
    }

    /// Largest difference from the torques of another method, as a fraction of the joint's scale. NaN if a torque is
    /// NaN.
    pub fn largest_difference(&self, torque: impl Fn(&JointState) -> Vec<f64>) -> f64 {
        let scale = self.torque_scales();
        let of_state = |(state, tau): (&JointState, &Vec<f64>)| {
            let other = torque(state);
            let of_joint = |j: usize| (other[j] - tau[j]).abs() / scale[j];
            (0..scale.len()).map(of_joint).fold(0.0, nan_or_larger)
        };
        self.states.iter().zip(&self.tau).map(of_state).fold(0.0, nan_or_larger)
    }

    /// The table: `q_1_rad..`, `qd_1_rad_s..`, `qdd_1_rad_s2..`, `tau_1_nm..`, every digit written.
    pub fn csv(&self) -> String {
        let mut text = self.header();
        text.push('\n');
        for (state, tau) in self.states.iter().zip(&self.tau) {
            let cells = [&state.q, &state.qd, &state.qdd, tau].into_iter().flatten();
            let cells: Vec<String> = cells.map(|value| format!("{value:?}")).collect();
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{}", cells.join(","));
        }
        text
    }

    fn header(&self) -> String {
        let names = ["q", "qd", "qdd", "tau"].into_iter().enumerate().flat_map(|(power, name)| {
            self.kinds.iter().enumerate().map(move |(j, kind)| {
                let unit = match (kind, power) {
                    (JointKind::Revolute, 0) => "rad",
                    (JointKind::Revolute, 1) => "rad_s",
                    (JointKind::Revolute, 2) => "rad_s2",
                    (JointKind::Revolute, _) => "nm",
                    (JointKind::Prismatic, 0) => "m",
                    (JointKind::Prismatic, 1) => "m_s",
                    (JointKind::Prismatic, 2) => "m_s2",
                    (JointKind::Prismatic, _) => "n",
                };
                format!("{name}_{}_{unit}", j + 1)
            })
        });
        names.collect::<Vec<String>>().join(",")
    }
}

fn state(robot: &Robot, index: usize) -> JointState {
    let mut state = probe_state(robot, index);
    match index % 4 {
        1 => {
            state.qd.fill(0.0);
            if index % 8 == 1 {
                state.qdd.fill(0.0);
            }
        }
        2 => {
            for (qd, joint) in state.qd.iter_mut().zip(&robot.joints) {
                *qd *= joint.low_speed / joint.limits.velocity;
            }
        }
        3 => state.qd[index / 4 % robot.joint_count()] = 0.0,
        _ => {}
    }
    state
}

fn nan_or_larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}
