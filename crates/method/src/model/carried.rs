//! Torque of a body that an arm is known to carry.

use super::dynamics::inverse_dynamics;
use armwatch_model::robot::{MAX_JOINTS, Robot, StandardParameters};

/// Torque of the body that the arm is known to carry ([`Robot::carried`]).
///
/// `q`, `qd`, `qdd` `[n]` in rad, rad/s, rad/s² (m); writes `tau` `[n]` in Nm (N).
///
/// # Panics
/// As [`inverse_dynamics`].
pub fn carried_torque(robot: &Robot, q: &[f64], qd: &[f64], qdd: &[f64], tau: &mut [f64]) {
    let n = robot.joint_count();
    let mut links = [StandardParameters::default(); MAX_JOINTS];
    links[n - 1] = robot.carried;
    inverse_dynamics(robot, &links[..n], q, qd, qdd, tau);
}

/// Adds it to `tau` `[n]`, if there is such a body.
pub(super) fn add_carried(robot: &Robot, [q, qd, qdd]: [&[f64]; 3], tau: &mut [f64]) {
    if robot.has_carried() {
        let mut carried = [0.0; MAX_JOINTS];
        carried_torque(robot, q, qd, qdd, &mut carried);
        tau.iter_mut().zip(carried).for_each(|(tau, carried)| *tau += carried);
    }
}
