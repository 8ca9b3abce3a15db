//! An arm whose geometry is a URDF file, with additions of the description by the names of joints.

use std::path::Path;

use super::chain::Chain;
use super::joint::{Drive, check_low_speed, check_range, read_drive, read_gear_ratio};
use super::transmission::GivenTransmission;
use super::urdf::UrdfJoint;
use super::{joint, nominal, urdf};
use crate::toml::files::ReadText;
use crate::toml::problem::ConfigErrors;
use crate::toml::quantity::{ACCELERATION, JERK, POSITION, VELOCITY, quantity};
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{FrictionModel, Joint, JointLimits, MAX_JOINTS, NominalJoint, WarmUpShape};

/// Time from rest to a joint's largest speed if no acceleration is given, s: URDF files before version 1.2 have none,
/// and arms of this size take about that.
const SECONDS_TO_FULL_SPEED: f64 = 0.5;

/// Reads the chain of the URDF file in the key `urdf`, relative to the description's folder, and the additions of
/// `[[joint]]` to its joints.
pub(crate) fn read_chain(
    root: &Table<'_>,
    folder: &Path,
    read_text: &ReadText<'_>,
    given: &GivenTransmission<'_>,
    friction: FrictionModel,
) -> Option<Chain> {
    let tip = root.optional("tip_link").map(|value| value.text());
    let file = root.required("urdf");
    let sections = root.optional("joint").map(|value| value.sections());
    let (tip, sections) = (joint::optional(tip)?, joint::optional(sections)?.unwrap_or_default());
    let file = file?;
    let path = folder.join(file.text()?);
    let text = match read_text(&path) {
        Ok(text) => text,
        Err(errors) => {
            let reasons = errors.0.iter().map(|p| p.problem.as_str()).collect::<Vec<_>>().join(", ");
            file.refuse(
                format!("{} {reasons}", path.display()),
                Some("paths are relative to this file".into()),
            );
            return None;
        }
    };
    let chain = match urdf::read_chain(&text, tip) {
        Ok(chain) => chain,
        Err(problem) => {
            root.adopt(ConfigErrors::of_file(&path.display().to_string(), problem, None));
            return None;
        }
    };
    if chain.joints.len() > MAX_JOINTS {
        file.refuse(format!("has {} moving joints, must be 1 to {MAX_JOINTS}", chain.joints.len()), None);
        return None;
    }
    let tables = tables_by_joint(&sections, &chain.joints)?;
    let joints: Vec<Option<Joint>> = chain
        .joints
        .iter()
        .zip(tables)
        .enumerate()
        .map(|(i, (joint, table))| match table {
            Some(table) => read_joint(&table, joint, given.ratio(i), friction),
            None => read_joint(&Table::empty(root), joint, given.ratio(i), friction),
        })
        .collect();
    let joints = joints.into_iter().collect::<Option<_>>()?;
    Some(Chain { joints, end: chain.end, remarks: chain.remarks })
}

/// The `[[joint]]` table of each joint of the chain.
fn tables_by_joint<'d>(sections: &[Value<'d>], joints: &[UrdfJoint]) -> Option<Vec<Option<Table<'d>>>> {
    let mut tables: Vec<Option<Table<'d>>> = joints.iter().map(|_| None).collect();
    let mut sound = true;
    for section in sections {
        let table = section.table()?;
        let hint = || Some("the name of a joint of the URDF file".into());
        let value = table.required_or_else("name", hint)?;
        let name = value.text()?;
        match joints.iter().position(|joint| joint.name == name) {
            Some(i) if tables[i].is_none() => tables[i] = Some(table),
            Some(_) => {
                value.refuse("is listed twice".into(), None);
                sound = false;
            }
            None => {
                let known: Vec<&str> = joints.iter().map(|joint| joint.name.as_str()).collect();
                value.refuse(
                    "moves nothing in the chain".into(),
                    Some(format!("its joints are {}", known.join(", "))),
                );
                sound = false;
            }
        }
    }
    sound.then_some(tables)
}

fn read_joint(
    table: &Table<'_>,
    urdf: &UrdfJoint,
    ratio: Option<f64>,
    friction: FrictionModel,
) -> Option<Joint> {
    let limits = read_limits(table, urdf);
    let gear_ratio = read_gear_ratio(table, ratio, Some(1.0));
    let drive = read_drive(table, urdf.kind, friction);
    let velocity = limits.map(|limits| limits.velocity);
    check_low_speed(table, drive.as_ref(), velocity);
    let (limits, drive): (JointLimits, Drive) = (limits?, drive?);
    let beside = table.optional("nominal");
    let nominal = urdf.inertial.map(|inertial| NominalJoint {
        inertial,
        motor_inertia: 0.0,
        friction: [urdf.friction, urdf.damping, 0.0, 0.0],
        warm_up: WarmUpShape::default(),
        torque_noise: 0.0,
    });
    let nominal = match (nominal, beside) {
        (Some(nominal), Some(value)) => {
            Some(nominal::read_beside(&value.table()?, urdf.kind, nominal, limits.velocity)?)
        }
        (None, Some(value)) => {
            value.refuse(
                format!("cannot be used: the link of {} has no inertial tag in the URDF file", urdf.name),
                None,
            );
            return None;
        }
        (nominal, None) => nominal,
    };
    Some(Joint {
        name: Some(urdf.name.clone()),
        kind: urdf.kind,
        geometry: urdf.geometry,
        limits,
        gear_ratio: gear_ratio?,
        position_offset: drive.position_offset,
        drive_gain: drive.drive_gain,
        motor_torque_constant: drive.motor_torque_constant,
        rated_motor_torque: drive.rated_motor_torque,
        rated_torque: drive.rated_torque,
        peak_torque: drive.peak_torque,
        low_speed: drive.low_speed,
        has_torque: true,
        friction: drive.friction,
        nominal,
    })
}

/// Limits of the URDF file; the description may override each.
fn read_limits(table: &Table<'_>, urdf: &UrdfJoint) -> Option<JointLimits> {
    let min = quantity(table, "position_min", urdf.kind, &POSITION).optional();
    let max = quantity(table, "position_max", urdf.kind, &POSITION).optional();
    let velocity = quantity(table, "velocity_max", urdf.kind, &VELOCITY).optional();
    let acceleration = quantity(table, "acceleration_max", urdf.kind, &ACCELERATION).optional();
    let jerk = quantity(table, "jerk_max", urdf.kind, &JERK).optional();
    let (min, max) = (joint::optional(min)?, joint::optional(max)?);
    if let (Some(min), Some(max)) = (&min, &max) {
        check_range(min, max)?;
    }
    let velocity = velocity.map_or(Some(urdf.velocity), |given| Some(given?.si))?;
    let limits = JointLimits {
        position_min: min.map_or(urdf.position_min, |given| given.si),
        position_max: max.map_or(urdf.position_max, |given| given.si),
        velocity,
        acceleration: acceleration.map_or(Some(velocity / SECONDS_TO_FULL_SPEED), |given| Some(given?.si))?,
        jerk: joint::optional(jerk)?.map(|given| given.si),
    };
    let sound = limits.position_min < limits.position_max
        && limits.velocity > 0.0
        && [limits.position_min, limits.position_max, limits.velocity].iter().all(|x| x.is_finite());
    if !sound {
        table.refuse(
            format!(
                "joint {} has the range {} to {} and the speed {} in the URDF file",
                urdf.name, limits.position_min, limits.position_max, limits.velocity
            ),
            Some("give position_min, position_max and velocity_max in a [[joint]] of this name".into()),
        );
        return None;
    }
    Some(limits)
}
