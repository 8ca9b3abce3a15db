//! Columns of positions, velocities and accelerations in CSV files of any origin.

use armwatch_model::robot::{JointKind, Robot};

/// Prefixes of column names of positions, velocities and accelerations, before the joint's number.
pub(in crate::cli) const POSITIONS: [&str; 3] = ["pos_", "q_", "position_"];
pub(in crate::cli) const VELOCITIES: [&str; 3] = ["vel_", "qd_", "velocity_"];
pub(in crate::cli) const ACCELERATIONS: [&str; 3] = ["acc_", "qdd_", "acceleration_"];

/// A column and the factor of its cells to SI.
pub(in crate::cli) struct SiColumn {
    /// Its index, from 0.
    pub index: usize,
    /// The factor.
    pub factor: f64,
}

/// Columns of one quantity for every joint; `None` if one is missing. `order` is the order of the derivative.
pub(in crate::cli) fn columns(
    header: &[String],
    prefixes: &[&str],
    robot: &Robot,
    order: usize,
) -> Option<Vec<SiColumn>> {
    let of_joint = |(number, kind): (usize, JointKind)| {
        header.iter().enumerate().find_map(|(index, name)| {
            let rest = prefixes.iter().find_map(|prefix| name.strip_prefix(prefix))?;
            let unit = rest.strip_prefix(&number.to_string())?;
            let of_time = ["", "_s", "_s2"][order];
            let factor = match (unit.strip_suffix(of_time).unwrap_or(unit), kind) {
                ("", _) | ("_rad", JointKind::Revolute) | ("_m", JointKind::Prismatic) => 1.0,
                ("_deg", JointKind::Revolute) => std::f64::consts::PI / 180.0,
                ("_mm", JointKind::Prismatic) => 1e-3,
                _ => return None,
            };
            Some(SiColumn { index, factor })
        })
    };
    (1..).zip(robot.joints.iter().map(|joint| joint.kind)).map(of_joint).collect()
}

/// Names of a header, without the byte order mark that some programs write first.
pub(in crate::cli) fn names(header: &csv::StringRecord) -> Vec<String> {
    header.iter().map(|name| name.trim_start_matches('\u{feff}').to_owned()).collect()
}

/// Message for a missing position.
pub(in crate::cli) fn no_positions(robot: &Robot) -> String {
    let n = robot.joint_count();
    format!(
        "line 1: no position of each of the {n} joints; columns pos_1 to pos_{n} are needed, in rad (m) or named pos_1_deg"
    )
}
