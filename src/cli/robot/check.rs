//! `armwatch robot check`.

use std::path::{Path, PathBuf};

use clap::Args;
use nalgebra::{Matrix3, Vector3};
use serde_json::json;

use crate::cli::context::{CliError, EXIT_DONE, EXIT_FOUND, Global};
use crate::cli::shared::output;
use crate::cli::shared::programme::read;
use armwatch_config::read_robot;
use armwatch_method::identify::load_visibility::{LEAST_OWN_PART, LoadVisibility, load_visibility};
use armwatch_method::model::base_parameters::JointState;
use armwatch_method::model::robot_check;
use armwatch_method::model::robot_check::{ReferenceAgreement, ReferenceRow, RobotCheck};
use armwatch_model::robot::{FourierExcitation, LoadFriction, Robot};
use armwatch_trajectory::series::state_at;

/// Largest accepted relative difference from reference data: reference tables have twelve digits, and summing them over
/// a chain loses two or three.
const REFERENCE_TOLERANCE: f64 = 1e-9;

/// Largest relative difference between two exact formulas for one number.
const EXACT_TOLERANCE: f64 = 1e-9;

/// Largest relative difference between a formula and a finite difference.
const DIFFERENCE_TOLERANCE: f64 = 1e-4;

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  armwatch robot check config/robots/er3a.toml
  armwatch robot check config/robots/er3a.toml \\
      --reference tests/reference/er3a_inverse_dynamics.csv

The reference is a CSV table with the columns q_1.., qd_1.., qdd_1.., tau_nm_1.. and the pose of the last frame in
the base, px,py,pz,r11,r12,r13,r21,r22,r23,r31,r32,r33. Its torques are those of rigid links with the nominal
inertia of the description, without friction and motor inertia. Exit status 1 if the reference differs, or if the
formulas of the program disagree with each other on this arm.")]
pub(in crate::cli) struct RobotCheckArgs {
    /// Robot description
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Reference table: states with torque and pose
    #[arg(long, value_name = "CSV")]
    reference: Option<PathBuf>,
}

pub(in crate::cli) fn check(global: &Global, args: &RobotCheckArgs) -> Result<u8, CliError> {
    let robot = read_robot(&args.file)?;
    let checked = robot_check::check(&robot)
        .map_err(|error| CliError::Usage(format!("{}: {error}", args.file.display())))?;
    let shown = match &robot.excitation {
        Some(excitation) => load_visibility(&robot, &excitation_states(excitation))
            .map_err(|error| CliError::Usage(format!("{}: {error}", args.file.display())))?,
        None => None,
    };
    let agreement = match &args.reference {
        Some(path) => Some(compare(&robot, path)?),
        None => None,
    };
    if global.json {
        output::json(&as_value(&robot, &checked, agreement.as_ref(), shown.as_deref()));
    } else {
        output::block(&checked.to_string());
        robot.remarks.iter().for_each(|remark| output::line(&format!("remark: {remark}")));
        if let Some(agreement) = &agreement {
            output::line(&agreement_text(agreement));
        }
    }
    if !global.json {
        load_friction_lines(&robot, shown.as_deref()).iter().for_each(|line| output::line(line));
    }
    if let Some(problem) = inconsistency(&checked) {
        output::print_hint(&problem);
    }
    let agrees = agreement.is_none_or(|found| within(&found)) && inconsistency(&checked).is_none();
    Ok(if agrees { EXIT_DONE } else { EXIT_FOUND })
}

/// Number of instants in one period of an excitation that are checked.
const EXCITATION_STATES: usize = 1000;

fn excitation_states(excitation: &FourierExcitation) -> Vec<JointState> {
    let period = 1.0 / excitation.base_frequency;
    let state = |k: usize| {
        let joints = state_at(excitation, period * k as f64 / EXCITATION_STATES as f64);
        let of = |power: usize| joints.iter().map(|joint| joint[power]).collect();
        JointState { q: of(0), qd: of(1), qdd: of(2) }
    };
    (0..EXCITATION_STATES).map(state).collect()
}

/// Reports if the described excitation identifies friction under load: one line per joint whose friction depends on it,
/// or one line about a suitable motion.
fn load_friction_lines(robot: &Robot, shown: Option<&[LoadVisibility]>) -> Vec<String> {
    let Some(shown) = shown else {
        return match robot.has_load_friction() {
            true => vec![
                "Load-dependent friction: not checked, because the description has no excitation or no \
                nominal parameters"
                    .to_owned(),
            ],
            false => Vec::new(),
        };
    };
    let is_asked = |of: &&LoadVisibility| robot.friction_of(of.joint).load != LoadFriction::None;
    if !shown.iter().any(|of| is_asked(&of)) {
        let visible = shown.iter().filter(|of| of.own_part >= LEAST_OWN_PART);
        let joints: Vec<String> = visible.map(|of| of.joint.to_string()).collect();
        let joints = if joints.is_empty() { "none".to_owned() } else { joints.join(", ") };
        return vec![format!("Load-dependent friction: the excitation shows it in these joints: {joints}")];
    }
    let line = |of: &LoadVisibility| {
        let verdict = match of.own_part >= LEAST_OWN_PART {
            true => "shown",
            false => "NOT SHOWN, move the joint at equal speed under different loads",
        };
        format!(
            "Load-dependent friction of joint {}: {:.0} % of its column is independent, largest load {:.1} \
            Nm (N): {verdict}",
            of.joint,
            100.0 * of.own_part,
            of.largest_load
        )
    };
    shown.iter().filter(is_asked).map(line).collect()
}

/// Returns true if the reference agrees; a description without nominal inertia makes no statement about torque.
fn within(found: &ReferenceAgreement) -> bool {
    [found.torque.unwrap_or(0.0), found.position, found.rotation]
        .iter()
        .all(|worst| *worst <= REFERENCE_TOLERANCE)
}

/// Formulas that disagree for this arm, and the remedy.
fn inconsistency(checked: &RobotCheck) -> Option<String> {
    let found = &checked.identities;
    if found.grouping > EXACT_TOLERANCE {
        return Some(format!(
            "the torque of the base parameters differs from that of all parameters by {:.1e} of it, above \
            {EXACT_TOLERANCE:.0e}: the geometry is almost one with fewer parameters, for example because of \
            rounded angles or lengths; write right angles with all digits, and 0 for lengths that should be \
            0",
            found.grouping
        ));
    }
    let formulas = [
        ("the regressor and inverse dynamics", found.regressor, EXACT_TOLERANCE),
        ("gravity torque and the gradient of potential energy", found.gravity, DIFFERENCE_TOLERANCE),
        ("the power of the torques and the rate of energy", found.power, DIFFERENCE_TOLERANCE),
    ];
    let (what, by, most) = formulas.into_iter().find(|(_, by, most)| by > most)?;
    Some(format!(
        "{what} differ by {by:.1e}, above {most:.0e}: the description has lengths or limits too large for its numbers; \
         correct them"
    ))
}

fn agreement_text(found: &ReferenceAgreement) -> String {
    let torque = found
        .torque
        .map_or_else(|| "not compared, no nominal inertia".into(), |worst| format!("{worst:.1e}"));
    format!(
        "Reference: {} rows, worst relative difference: torque {torque}, position {:.1e}, rotation {:.1e}: {}",
        found.rows,
        found.position,
        found.rotation,
        if within(found) { "agrees" } else { "DISAGREES" }
    )
}

fn compare(robot: &Robot, path: &Path) -> Result<ReferenceAgreement, CliError> {
    let text = read(path)?;
    let rows = reference_rows(robot.joint_count(), &text)
        .map_err(|problem| CliError::Usage(format!("{}: {problem}", path.display())))?;
    robot_check::compare_with_reference(robot, &rows)
        .map_err(|error| CliError::Usage(format!("{}: {error}", path.display())))
}

/// Reads the reference table by the names of its columns.
fn reference_rows(joints: usize, text: &str) -> Result<Vec<ReferenceRow>, String> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().ok_or("empty")?.split(',').map(str::trim).collect();
    let place =
        |name: &str| header.iter().position(|h| *h == name).ok_or_else(|| format!("no column {name}"));
    let per_joint = |prefix: &str| -> Result<Vec<usize>, String> {
        (1..=joints).map(|joint| place(&format!("{prefix}_{joint}"))).collect()
    };
    let (q, qd, qdd, tau) = (per_joint("q")?, per_joint("qd")?, per_joint("qdd")?, per_joint("tau_nm")?);
    let pose: Vec<usize> = ["px", "py", "pz", "r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"]
        .iter()
        .map(|name| place(name))
        .collect::<Result<_, _>>()?;
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
        let pose = take(&pose);
        rows.push(ReferenceRow {
            q: take(&q),
            qd: take(&qd),
            qdd: take(&qdd),
            tau: take(&tau),
            position: Vector3::from_column_slice(&pose[..3]),
            rotation: Matrix3::from_row_slice(&pose[3..]),
        });
    }
    if rows.is_empty() { Err("no rows".into()) } else { Ok(rows) }
}

fn as_value(
    robot: &Robot,
    checked: &RobotCheck,
    agreement: Option<&ReferenceAgreement>,
    shown: Option<&[LoadVisibility]>,
) -> serde_json::Value {
    let base = &checked.base;
    json!({
        "model": robot.model,
        "joints": robot.joint_count(),
        "drives": robot.joints.iter().zip(robot.joint_indices()).map(|(joint, index)| json!({
            "joint": index.number(),
            "gear_ratio": joint.gear_ratio,
            "position_offset": joint.position_offset,
            "low_speed": joint.low_speed,
            "rated_motor_torque_nm": joint.rated_motor_torque,
            "rated_torque_nm": joint.rated_torque,
            "peak_torque_nm": joint.peak_torque,
        })).collect::<Vec<_>>(),
        "motor_per_joint": robot.transmission.row_iter()
            .map(|row| row.iter().copied().collect::<Vec<_>>())
            .collect::<Vec<_>>(),
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
        "load_friction": shown.map(|shown| shown.iter().map(|of| json!({
            "joint": of.joint.number(),
            "law": robot.friction_of(of.joint).load.name(),
            "largest_load_nm": of.largest_load,
            "own_part": of.own_part,
            "is_shown": of.own_part >= LEAST_OWN_PART,
        })).collect::<Vec<_>>()),
        "remarks": robot.remarks,
        "problem": inconsistency(checked),
        "reference": agreement,
    })
}
