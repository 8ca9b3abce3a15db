//! Columns of positions, velocities and accelerations in CSV files of any origin. Their positions are those of the
//! controller at the joints, without `position_offset_*` of the description.

use armwatch_model::robot::{Joint, JointKind, Robot};

/// Prefixes of column names of positions, velocities and accelerations, before the joint's number.
pub(in crate::cli) const POSITIONS: [&str; 3] = ["pos_", "q_", "position_"];
pub(in crate::cli) const VELOCITIES: [&str; 3] = ["vel_", "qd_", "velocity_"];
pub(in crate::cli) const ACCELERATIONS: [&str; 3] = ["acc_", "qdd_", "acceleration_"];

/// A column and the conversion of its cells to the model's values in SI.
pub(in crate::cli) struct SiColumn {
    /// Its index, from 0.
    pub index: usize,
    /// Factor to SI.
    pub factor: f64,
    /// Added after the factor, rad (m): the position offset of the joint, 0 for derivatives.
    pub offset: f64,
}

impl SiColumn {
    /// The model's value of a cell.
    pub fn value(&self, cell: f64) -> f64 {
        cell * self.factor + self.offset
    }
}

/// Columns of one quantity for every joint; `None` if one is missing. `order` is the order of the derivative.
pub(in crate::cli) fn columns(
    header: &[String],
    prefixes: &[&str],
    robot: &Robot,
    order: usize,
) -> Option<Vec<SiColumn>> {
    let of_joint = |(number, joint): (usize, &Joint)| {
        header.iter().enumerate().find_map(|(index, name)| {
            let rest = prefixes.iter().find_map(|prefix| name.strip_prefix(prefix))?;
            let unit = rest.strip_prefix(&number.to_string())?;
            let of_time = ["", "_s", "_s2"][order];
            let factor = match (unit.strip_suffix(of_time).unwrap_or(unit), joint.kind) {
                ("", _) | ("_rad", JointKind::Revolute) | ("_m", JointKind::Prismatic) => 1.0,
                ("_deg", JointKind::Revolute) => std::f64::consts::PI / 180.0,
                ("_mm", JointKind::Prismatic) => 1e-3,
                _ => return None,
            };
            let offset = if order == 0 { joint.position_offset } else { 0.0 };
            Some(SiColumn { index, factor, offset })
        })
    };
    (1..).zip(&robot.joints).map(of_joint).collect()
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

/// Explains positions in a file of an arm with position offsets; `None` if the arm has none.
pub(in crate::cli) fn offsets_text(robot: &Robot) -> Option<String> {
    let of_joint = |(number, joint): (usize, &Joint)| {
        let unit = if joint.kind == JointKind::Revolute { "rad" } else { "m" };
        (joint.position_offset != 0.0).then(|| format!("joint {number} {:+.6} {unit}", joint.position_offset))
    };
    let offsets: Vec<String> = (1..).zip(&robot.joints).filter_map(of_joint).collect();
    (!offsets.is_empty()).then(|| {
        format!(
            "positions in the file are those of the controller; the positions q of the model, which have the limits, are \
             these plus the position offsets of the description: {}",
            offsets.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_testing::er3a_of;

    #[test]
    fn positions_alone_have_an_offset() {
        let mut robot = er3a_of(2);
        assert_eq!(offsets_text(&robot), None);
        robot.joints[1].position_offset = -0.25;
        let header = ["pos_1", "pos_2_deg", "vel_1", "vel_2_deg_s"].map(str::to_owned);
        let found = columns(&header, &POSITIONS, &robot, 0).expect("positions");
        assert!((found[1].value(180.0) - (std::f64::consts::PI - 0.25)).abs() < 1e-15);
        let found = columns(&header, &VELOCITIES, &robot, 1).expect("velocities");
        assert!((found[1].value(180.0) - std::f64::consts::PI).abs() < 1e-15);
        assert!(offsets_text(&robot).expect("an offset").ends_with("description: joint 2 -0.250000 rad"));
    }
}
