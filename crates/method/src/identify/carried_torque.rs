//! Torque of the body that an arm is known to carry.

use std::borrow::Cow;

use crate::model::carried::carried_torque;
use crate::signal::filter::FilteredSignals;
use armwatch_model::robot::{MAX_JOINTS, Robot};
use armwatch_model::run::Samples;

/// Subtracts the torque of [`Robot::carried`] from the torques of a recording, so that its parameters are those of the arm
/// alone. Recorded torques lose the same as filtered ones: the difference of both is their noise.
pub fn subtract_carried(robot: &Robot, samples: &mut Cow<'_, Samples>, filtered: &mut FilteredSignals) {
    if !robot.has_carried() {
        return;
    }
    let n = robot.joint_count();
    let [mut q, mut qd, mut qdd, mut tau] = [[0.0; MAX_JOINTS]; 4];
    let samples = samples.to_mut();
    let rows: Vec<usize> = filtered.filtered_rows().collect();
    for row in rows {
        filtered.row(row, &mut q[..n], &mut qd[..n], &mut qdd[..n], &mut tau[..n]);
        carried_torque(robot, &q[..n], &qd[..n], &qdd[..n], &mut tau[..n]);
        for ((filtered, recorded), tau) in filtered.tau.iter_mut().zip(&mut samples.torque).zip(tau) {
            filtered[row] -= tau;
            recorded[row] -= tau;
        }
    }
}
