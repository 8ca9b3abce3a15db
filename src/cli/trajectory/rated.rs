//! What the motors of an arm stand for hours.

use crate::robot::{Joint, Robot};

/// Rated torque of each joint, Nm (N), where the description has one: its own, or the motor's through the gear.
pub(super) fn rated_torques(robot: &Robot) -> Vec<Option<f64>> {
    let of = |joint: &Joint| {
        joint.rated_torque.or_else(|| joint.rated_motor_torque.map(|motor| motor * joint.gear_ratio.abs()))
    };
    robot.joints.iter().map(of).collect()
}
