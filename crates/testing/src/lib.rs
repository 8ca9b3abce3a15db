//! Common parts of several unit tests.

#![expect(clippy::expect_used, clippy::panic, reason = "only tests depend on this package")]

pub mod arms;
pub mod cycle;
pub mod direct;
pub mod noise;

use armwatch_config::parse_robot;
use armwatch_model::robot::{DhParameters, GeometrySource, JointGeometry, Robot};

/// The ER3A of its shipped description.
pub fn er3a() -> Robot {
    described(include_str!("../../../config/robots/er3a.toml"))
}

/// The SCARA of its shipped description.
pub fn scara() -> Robot {
    described(include_str!("../../../config/robots/scara.toml"))
}

/// The TX40 of its shipped description.
pub fn tx40() -> Robot {
    described(include_str!("../../../config/robots/tx40.toml"))
}

/// The arm of the text of a description file.
pub fn described(text: &str) -> Robot {
    parse_robot("robot.toml", text).unwrap_or_else(|errors| panic!("{errors}"))
}

/// Changes the row of a joint of an arm in modified DH parameters.
pub fn change_dh(robot: &mut Robot, joint: usize, change: impl FnOnce(&mut DhParameters)) {
    let geometry = &mut robot.joints[joint].geometry;
    let GeometrySource::ModifiedDh(mut row) = *geometry.source() else { panic!("not modified DH") };
    change(&mut row);
    *geometry = JointGeometry::modified_dh(row);
}

/// The first joints of the ER3A as a separate arm, without an excitation.
pub fn er3a_of(joints: usize) -> Robot {
    let mut robot = er3a();
    robot.joints.truncate(joints);
    robot.transmission = Robot::uncoupled_transmission(&robot.joints);
    robot.excitation = None;
    robot
}
