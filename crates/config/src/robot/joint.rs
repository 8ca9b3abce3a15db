//! A joint of a description: kind, limits, drive.

use super::geometry::read_dh_row;
use super::{friction_model, nominal};
use crate::toml::quantity::{ACCELERATION, Given, JERK, POSITION, SPEED, VELOCITY, quantity};
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::robot::{FrictionModel, Joint, JointGeometry, JointKind, JointLimits};

/// Default of `low_speed_*`, rad/s or m/s: below it the friction model is unreliable.
pub(crate) const DEFAULT_LOW_SPEED: f64 = 0.02;

/// Joint torque per motor current.
pub(crate) const DRIVE_GAIN: &str = "drive_gain_nm_a";
/// The same for a prismatic joint.
pub(crate) const DRIVE_GAIN_OF_SLIDE: &str = "drive_gain_n_a";
/// Torque per current at the motor's shaft.
pub(crate) const MOTOR_TORQUE_CONSTANT: &str = "motor_torque_constant_nm_a";
/// Rated torque at the motor's shaft.
pub(crate) const RATED_MOTOR_TORQUE: &str = "rated_motor_torque_nm";
/// Rated torque of a joint.
pub(crate) const RATED_JOINT_TORQUE: &str = "rated_joint_torque_nm";
/// Rated force of a prismatic joint.
pub(crate) const RATED_JOINT_FORCE: &str = "rated_joint_force_n";
/// Largest short-term torque of a joint.
const PEAK_JOINT_TORQUE: &str = "peak_joint_torque_nm";
/// Largest short-term force of a prismatic joint.
const PEAK_JOINT_FORCE: &str = "peak_joint_force_n";

/// Reads a joint of a Denavit-Hartenberg table, of either convention: the geometry stores its row as one of a modified
/// table. `ratio` is its gear ratio from a transmission matrix, `default_ratio` the ratio of a joint that gives none,
/// `friction` the arm's model.
pub(crate) fn read(
    table: &Table<'_>,
    ratio: Option<f64>,
    (default_ratio, friction): (Option<f64>, FrictionModel),
) -> Option<Joint> {
    let name = read_name(table);
    let kind = read_kind(table);
    // Without a type the units are unknown, but values that do not depend on them are still checked.
    let assumed = kind.unwrap_or(JointKind::Revolute);
    let row = read_dh_row(table);
    let limits = read_limits(table, assumed);
    let gear_ratio = read_gear_ratio(table, ratio, default_ratio);
    let drive = read_drive(table, assumed, friction);
    let velocity = limits.map(|limits| limits.velocity);
    let nominal = table.table("nominal").map(|nominal| nominal::read(&nominal, assumed, velocity));
    check_low_speed(table, drive.as_ref(), velocity);
    let drive = drive?;
    Some(Joint {
        name: name?,
        kind: kind?,
        geometry: JointGeometry::modified_dh(row?),
        limits: limits?,
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
        nominal: optional(nominal)?,
    })
}

/// Properties of a joint that do not depend on the source of its geometry.
pub(crate) struct Drive {
    pub position_offset: f64,
    pub drive_gain: Option<f64>,
    pub motor_torque_constant: Option<f64>,
    pub rated_motor_torque: Option<f64>,
    pub rated_torque: Option<f64>,
    pub peak_torque: Option<f64>,
    pub low_speed: f64,
    pub friction: Option<FrictionModel>,
}

/// Reads the keys of the drive, which are all optional; `arm` is the arm's friction model.
pub(crate) fn read_drive(table: &Table<'_>, kind: JointKind, arm: FrictionModel) -> Option<Drive> {
    let torque = Limits::above(0.0, 1e4, "Nm");
    let rated_motor_torque = table.optional(RATED_MOTOR_TORQUE).map(|value| value.number(&torque));
    let (gain_key, gain_limits) = match kind {
        JointKind::Revolute => (DRIVE_GAIN, Limits::within(1e4, "Nm/A")),
        JointKind::Prismatic => (DRIVE_GAIN_OF_SLIDE, Limits::within(1e5, "N/A")),
    };
    let ([rated_key, peak_key], torque_limits) = match kind {
        JointKind::Revolute => ([RATED_JOINT_TORQUE, PEAK_JOINT_TORQUE], Limits::above(0.0, 1e6, "Nm")),
        JointKind::Prismatic => ([RATED_JOINT_FORCE, PEAK_JOINT_FORCE], Limits::above(0.0, 1e7, "N")),
    };
    let gain = |key: &str, limits: &Limits| table.optional(key).map(|value| not_zero(&value, limits));
    let drive_gain = gain(gain_key, &gain_limits);
    let motor_torque_constant = gain(MOTOR_TORQUE_CONSTANT, &Limits::within(1e3, "Nm/A"));
    let torque_of_joint = |key: &str| table.optional(key).map(|value| value.number(&torque_limits));
    let (rated_torque, peak_torque) = (torque_of_joint(rated_key), torque_of_joint(peak_key));
    let friction = friction_model::read_of_joint(table, kind, arm);
    let position_offset = quantity(table, "position_offset", kind, &POSITION).optional();
    let position_offset = position_offset.map_or(Some(0.0), |given| Some(given?.si));
    let low_speed = quantity(table, "low_speed", kind, &SPEED).optional();
    let low_speed = low_speed.map_or(Some(DEFAULT_LOW_SPEED), |given| Some(given?.si));
    Some(Drive {
        position_offset: position_offset?,
        drive_gain: optional(drive_gain)?,
        motor_torque_constant: optional(motor_torque_constant)?,
        rated_motor_torque: optional(rated_motor_torque)?,
        rated_torque: optional(rated_torque)?,
        peak_torque: optional(peak_torque)?,
        low_speed: low_speed?,
        friction: friction?,
    })
}

/// A gain, whose sign gives the direction of the drive for a positive current.
fn not_zero(value: &Value<'_>, limits: &Limits) -> Option<f64> {
    let gain = value.number(limits)?;
    if gain == 0.0 {
        value.refuse("must not be 0".into(), None);
        return None;
    }
    Some(gain)
}

/// Refuses a threshold that no row could exceed.
pub(crate) fn check_low_speed(table: &Table<'_>, drive: Option<&Drive>, velocity: Option<f64>) {
    if let (Some(drive), Some(velocity)) = (drive, velocity)
        && drive.low_speed >= velocity
    {
        table.refuse("low_speed must be smaller than velocity_max, or no row counts as moving".into(), None);
    }
}

/// The gear ratio, unless a transmission matrix or a default gives it.
pub(crate) fn read_gear_ratio(
    table: &Table<'_>,
    of_matrix: Option<f64>,
    default: Option<f64>,
) -> Option<f64> {
    let instead = of_matrix.or(default);
    let value = match instead {
        None => Some(table.required("gear_ratio")?),
        Some(_) => table.optional("gear_ratio"),
    };
    let Some(value) = value else { return instead };
    let ratio = value.number(&Limits::within(1e5, ""))?;
    if ratio == 0.0 {
        value.refuse(
            "must not be 0".into(),
            Some("use a negative value if motor and joint turn in opposite directions".into()),
        );
        return None;
    }
    match of_matrix {
        #[expect(clippy::float_cmp, reason = "the same number written twice")]
        Some(other) if other != ratio => {
            value.refuse(
                format!("is {other} in transmission.motor_per_joint"),
                Some("remove one of them".into()),
            );
            None
        }
        _ => Some(ratio),
    }
}

/// The name, if given.
fn read_name(table: &Table<'_>) -> Option<Option<String>> {
    optional(table.optional("name").map(|value| value.text().map(str::to_owned)))
}

/// Accepts an absent value, but not a wrong one.
pub(crate) fn optional<T>(value: Option<Option<T>>) -> Option<Option<T>> {
    match value {
        None => Some(None),
        Some(Some(value)) => Some(Some(value)),
        Some(None) => None,
    }
}

fn read_kind(table: &Table<'_>) -> Option<JointKind> {
    let value = table.required_or_else("type", || Some("\"revolute\" turns, \"prismatic\" slides".into()))?;
    match value.text()? {
        "revolute" => Some(JointKind::Revolute),
        "prismatic" => Some(JointKind::Prismatic),
        _ => {
            value.refuse("must be \"revolute\" or \"prismatic\"".into(), None);
            None
        }
    }
}

fn read_limits(table: &Table<'_>, kind: JointKind) -> Option<JointLimits> {
    let min = quantity(table, "position_min", kind, &POSITION).required();
    let max = quantity(table, "position_max", kind, &POSITION).required();
    let velocity = quantity(table, "velocity_max", kind, &VELOCITY).required();
    let acceleration = quantity(table, "acceleration_max", kind, &ACCELERATION).required();
    let jerk = quantity(table, "jerk_max", kind, &JERK).optional();
    let (min, max) = (min?, max?);
    check_range(&min, &max)?;
    Some(JointLimits {
        position_min: min.si,
        position_max: max.si,
        velocity: velocity?.si,
        acceleration: acceleration?.si,
        jerk: optional(jerk)?.map(|given| given.si),
    })
}

pub(crate) fn check_range(min: &Given<'_>, max: &Given<'_>) -> Option<()> {
    if min.si >= max.si {
        max.value
            .refuse(format!("must be larger than position_min, which is {} {}", min.raw, min.unit), None);
        return None;
    }
    let range = max.raw - min.raw;
    if min.unit == "deg" && max.unit == "deg" && range <= std::f64::consts::TAU {
        max.value.refuse(
            format!("gives a range of only {range} deg and looks like radians"),
            Some("write position_min_rad and position_max_rad".into()),
        );
        return None;
    }
    Some(())
}
