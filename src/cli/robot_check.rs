//! `armwatch robot check`.

use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::{CliError, EXIT_DONE, EXIT_FOUND, Global, output};
use crate::config::read_robot;
use crate::numerics::robot_check::{self, ReferenceAgreement, ReferenceRow, RobotCheck};
use crate::robot::Robot;

/// Largest relative difference from reference data that agrees: reference tables carry twelve
/// digits, and summing them over a chain loses two or three.
const REFERENCE_TOLERANCE: f64 = 1e-9;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot check config/robots/er3a.toml
  armwatch robot check config/robots/er3a.toml --reference tests/reference/er3a_inverse_dynamics.csv

The reference is a CSV table with the columns q_1.., qd_1.., qdd_1.., tau_nm_1.. and, if the pose is to be
compared as well, px,py,pz,r11,r12,r13,r21,r22,r23,r31,r32,r33; torques are those of the rigid links with
the description's nominal inertia, without friction and motor inertia. Exit status 1 if it disagrees.")]
pub(super) struct RobotCheckArgs {
    /// Robot description
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Table of states with torque and pose to compare with
    #[arg(long, value_name = "CSV")]
    reference: Option<PathBuf>,
}

pub(super) fn check(global: &Global, args: &RobotCheckArgs) -> Result<u8, CliError> {
    let robot = read_robot(&args.file)?;
    let checked = robot_check::check(&robot)
        .map_err(|error| CliError::Usage(format!("{}: {error}", args.file.display())))?;
    let agreement = match &args.reference {
        Some(path) => Some(compare(&robot, path)?),
        None => None,
    };
    if global.json {
        output::json(&as_value(&robot, &checked, agreement.as_ref()));
    } else {
        output::line(&checked.to_string());
        if let Some(agreement) = &agreement {
            output::line(&agreement.to_string());
        }
    }
    let agrees = agreement.is_none_or(|found| found.within(REFERENCE_TOLERANCE)) && checked.is_consistent();
    Ok(if agrees { EXIT_DONE } else { EXIT_FOUND })
}

fn compare(robot: &Robot, path: &Path) -> Result<ReferenceAgreement, CliError> {
    let text = std::fs::read_to_string(path).map_err(|error| CliError::Usage(format!("{}: {error}", path.display())))?;
    let rows = reference_rows(robot.joint_count(), &text)
        .map_err(|problem| CliError::Usage(format!("{}: {problem}", path.display())))?;
    robot_check::compare_with_reference(robot, &rows)
        .map_err(|error| CliError::Usage(format!("{}: {error}", path.display())))
}

/// Reads the reference table by the names of its columns.
fn reference_rows(joints: usize, text: &str) -> Result<Vec<ReferenceRow>, String> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().ok_or("empty")?.split(',').map(str::trim).collect();
    let place = |name: &str| header.iter().position(|h| *h == name).ok_or_else(|| format!("no column {name}"));
    let per_joint = |prefix: &str| -> Result<Vec<usize>, String> {
        (1..=joints).map(|joint| place(&format!("{prefix}_{joint}"))).collect()
    };
    let (q, qd, qdd, tau) = (per_joint("q")?, per_joint("qd")?, per_joint("qdd")?, per_joint("tau_nm")?);
    let pose: Option<Vec<usize>> = ["px", "py", "pz", "r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"]
        .iter()
        .map(|name| place(name).ok())
        .collect();
    let mut rows = Vec::new();
    for (number, line) in (2..).zip(lines).filter(|(_, line)| !line.trim().is_empty()) {
        let cells: Vec<f64> = line
            .split(',')
            .map(|cell| cell.trim().parse().map_err(|_| format!("line {number}: \"{cell}\" is not a number")))
            .collect::<Result<_, _>>()?;
        if cells.len() != header.len() {
            return Err(format!("line {number}: {} cells for {} columns", cells.len(), header.len()));
        }
        let take = |places: &[usize]| places.iter().map(|&at| cells[at]).collect::<Vec<f64>>();
        rows.push(ReferenceRow { q: take(&q), qd: take(&qd), qdd: take(&qdd), tau: take(&tau), pose: pose.as_deref().map(take) });
    }
    if rows.is_empty() { Err("no rows".into()) } else { Ok(rows) }
}

fn as_value(robot: &Robot, checked: &RobotCheck, agreement: Option<&ReferenceAgreement>) -> serde_json::Value {
    let base = &checked.base;
    json!({
        "model": robot.model,
        "joints": robot.joint_count(),
        "parameters": base.kept.iter().enumerate().map(|(k, id)| json!({
            "joint": id.joint.number(),
            "parameter": id.name(),
            "unit": id.unit(robot.joints[id.joint.index()].kind),
            "grouping": base.grouping_formula(k),
        })).collect::<Vec<_>>(),
        "parameter_count": base.kept.len(),
        "inertial_rank": base.inertial_rank,
        "inertial_and_motor_rank": base.inertial_and_motor_rank,
        "rank": base.rank,
        "condition_number": base.condition_number,
        "scaled_condition_number": base.scaled_condition_number,
        "reference": agreement.map(|found| json!({
            "rows": found.rows, "torque": found.torque, "pose": found.pose,
        })),
    })
}
