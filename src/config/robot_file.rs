//! Descriptions of arms: `config/robots/*.toml` to [`Robot`].

use std::path::Path;

use super::files;
use super::limits::Limits;
use super::nominal;
use super::problem::ConfigErrors;
use super::quantity::{ACCELERATION, Given, POSITION, SPEED, TURN, VELOCITY, quantity};
use super::reader::{Table, Value, read_document};
use crate::robot::{FourierExcitation, Joint, JointKind, JointLimits, MAX_JOINTS, ModifiedDh, Robot};

/// The only convention understood, as the key `convention` must say it.
const CONVENTION: &str = "modified_dh";

/// Longest name of a model, in characters; it stands in table columns and plot titles.
const MODEL_CHARACTERS: usize = 64;

/// Most speed levels of a friction test; the exports' signal for them is a small number.
const MAX_SPEED_LEVELS: usize = 20;

/// Most harmonics of an excitation; the one published for the ER3A has 5.
const MAX_HARMONICS: usize = 50;

/// Longest link length or offset. No industrial arm has a link of that length, so that a value in
/// mm does not pass for one in m.
const LENGTH: Limits = Limits::within(10.0, "m");

/// Default of `low_speed_*`, rad/s or m/s: below it the friction model is not to be trusted.
const DEFAULT_LOW_SPEED: f64 = 0.02;

/// Angles in degrees from here up to `2 pi` are taken for radians. Smaller ones are the twist that
/// a calibration finds.
const SUSPICIOUS_DEG: f64 = 0.5;

/// Reads the description of an arm from `text`; `file_name` only says where problems are.
///
/// # Errors
///
/// Every problem of the description at once.
pub fn parse_robot(file_name: &str, text: &str) -> Result<Robot, ConfigErrors> {
    read_document(file_name, text, read_root)
}

/// Reads the description of an arm from the file at `path`.
///
/// # Errors
///
/// Every problem of the description at once, or that the file cannot be read.
pub fn read_robot(path: &Path) -> Result<Robot, ConfigErrors> {
    parse_robot(&path.display().to_string(), &files::read_text(path)?)
}

fn read_root(root: &Table<'_>) -> Option<Robot> {
    let model = read_model(root);
    let convention = read_convention(root);
    let gravity = root.numbers("gravity_m_s2", Some(3), &Limits::within(30.0, "m/s^2"));
    let speed_levels = read_speed_levels(root);
    let joints = read_joints(root);
    let excitation = match root.table("excitation") {
        Some(table) => Some(read_excitation(&table, joints.as_deref())?),
        None => None,
    };
    convention?;
    let gravity: [f64; 3] = gravity?.try_into().ok()?;
    Some(Robot {
        model: model?,
        joints: joints?,
        gravity: gravity.into(),
        speed_levels: speed_levels?,
        excitation,
    })
}

fn read_model(root: &Table<'_>) -> Option<String> {
    let value = root.required("model")?;
    let model = value.text()?;
    if model.chars().count() > MODEL_CHARACTERS || model.chars().any(char::is_control) {
        value.refuse(format!("must be at most {MODEL_CHARACTERS} characters on one line"), None);
        return None;
    }
    Some(model.to_owned())
}

fn read_convention(root: &Table<'_>) -> Option<()> {
    let hint = || {
        Some(format!(
            "only \"{CONVENTION}\" (Craig) is understood: a row of its table holds a and alpha of the previous axis, \
             T = Rx(alpha) Dx(a) Rz(theta) Dz(d), and the first row usually has a = 0 and alpha = 0; in a standard DH \
             table (Rz Dz Dx Rx) it is the last row that does"
        ))
    };
    let value = root.required_or_else("convention", hint)?;
    if value.text()? != CONVENTION {
        value.refuse("is not understood".into(), hint());
        return None;
    }
    Some(())
}

fn read_speed_levels(root: &Table<'_>) -> Option<Vec<f64>> {
    let value = root.required("speed_levels")?;
    let levels = value.numbers(None, &Limits::above(0.0, 1.0, "of the largest speed"))?;
    if levels.is_empty() || levels.len() > MAX_SPEED_LEVELS {
        value.refuse(format!("has {} entries, must have 1 to {MAX_SPEED_LEVELS}", levels.len()), None);
        return None;
    }
    if levels.windows(2).any(|pair| pair[1] <= pair[0]) {
        value.refuse("must rise from level to level".into(), None);
        return None;
    }
    Some(levels)
}

fn read_joints(root: &Table<'_>) -> Option<Vec<Joint>> {
    let value = root
        .required_or_else("joint", || Some("write one [[joint]] a joint, from the base outwards".into()))?;
    let items = value.sections()?;
    let joints: Vec<Option<Joint>> =
        items.iter().map(|item| item.table().and_then(|table| read_joint(&table))).collect();
    if joints.is_empty() || joints.len() > MAX_JOINTS {
        value.refuse(format!("{} joints, must be 1 to {MAX_JOINTS}", joints.len()), None);
        return None;
    }
    joints.into_iter().collect()
}

fn read_joint(table: &Table<'_>) -> Option<Joint> {
    let kind = read_kind(table);
    // Without a type the units are not known, but what does not depend on them is still checked.
    let assumed = kind.unwrap_or(JointKind::Revolute);
    let geometry = read_geometry(table);
    let limits = read_limits(table, assumed);
    let gear_ratio = table.number("gear_ratio", &Limits::above(0.0, 1e5, ""));
    let torque = Limits::above(0.0, 1e4, "Nm");
    let rated_motor_torque = table.optional("rated_motor_torque_nm").map(|value| value.number(&torque));
    let low_speed = quantity(table, "low_speed", assumed, &SPEED).optional();
    let low_speed = low_speed.map_or(Some(DEFAULT_LOW_SPEED), |given| Some(given?.si));
    let velocity = limits.map(|limits| limits.velocity);
    let nominal = table.table("nominal").map(|nominal| nominal::read(&nominal, assumed, velocity));
    if let (Some(low_speed), Some(velocity)) = (low_speed, velocity)
        && low_speed >= velocity
    {
        table.refuse("low_speed must be smaller than velocity_max, or no row counts as moving".into(), None);
    }
    Some(Joint {
        kind: kind?,
        geometry: geometry?,
        limits: limits?,
        gear_ratio: gear_ratio?,
        rated_motor_torque: optional(rated_motor_torque)?,
        low_speed: low_speed?,
        nominal: optional(nominal)?,
    })
}

/// Absent is fine, wrong is not.
fn optional<T>(value: Option<Option<T>>) -> Option<Option<T>> {
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

fn read_geometry(table: &Table<'_>) -> Option<ModifiedDh> {
    let a = read_length(table, "a_m");
    let alpha = read_fixed_angle(table, "alpha");
    let d = read_length(table, "d_m");
    let theta_offset = read_fixed_angle(table, "theta_offset");
    Some(ModifiedDh { a: a?, alpha: alpha?, d: d?, theta_offset: theta_offset? })
}

fn read_length(table: &Table<'_>, key: &str) -> Option<f64> {
    let in_metres = |raw: f64| Some(format!("did you mean {} m?", raw / 1000.0)).filter(|_| raw.is_finite());
    table.required(key)?.number_or_hint(&LENGTH, in_metres)
}

/// An angle of the geometry, with an eye on degrees and radians taken for each other.
fn read_fixed_angle(table: &Table<'_>, stem: &str) -> Option<f64> {
    let given = quantity(table, stem, JointKind::Revolute, &TURN).required()?;
    let degrees = given.raw.abs();
    if given.unit == "deg" && (SUSPICIOUS_DEG..=std::f64::consts::TAU).contains(&degrees) {
        given.value.refuse(
            "looks like radians given as degrees".into(),
            Some(format!(
                "write {stem}_rad = {0} if it is in rad, {stem}_rad = {1:.6} if it is {0} deg",
                given.raw, given.si
            )),
        );
        return None;
    }
    Some(given.si)
}

fn read_limits(table: &Table<'_>, kind: JointKind) -> Option<JointLimits> {
    let min = quantity(table, "position_min", kind, &POSITION).required();
    let max = quantity(table, "position_max", kind, &POSITION).required();
    let velocity = quantity(table, "velocity_max", kind, &VELOCITY).required();
    let acceleration = quantity(table, "acceleration_max", kind, &ACCELERATION).required();
    let (min, max) = (min?, max?);
    check_range(&min, &max)?;
    Some(JointLimits {
        position_min: min.si,
        position_max: max.si,
        velocity: velocity?.si,
        acceleration: acceleration?.si,
    })
}

fn check_range(min: &Given<'_>, max: &Given<'_>) -> Option<()> {
    if min.si >= max.si {
        max.value
            .refuse(format!("must be larger than position_min, which is {} {}", min.raw, min.unit), None);
        return None;
    }
    let range = max.raw - min.raw;
    if min.unit == "deg" && max.unit == "deg" && range <= std::f64::consts::TAU {
        max.value.refuse(
            format!("leaves a range of only {range} deg and looks like radians"),
            Some("write position_min_rad and position_max_rad".into()),
        );
        return None;
    }
    Some(())
}

fn read_excitation(table: &Table<'_>, joints: Option<&[Joint]>) -> Option<FourierExcitation> {
    let count = joints.map(<[Joint]>::len);
    let base_frequency = table.number("base_frequency_hz", &Limits::above(0.0, 100.0, "Hz"));
    let centre = table.required("centre_rad").and_then(|value| read_centre(&value, joints));
    let a = read_amplitudes(table, "a_rad_s", count);
    let b = read_amplitudes(table, "b_rad_s", count);
    let (a, b) = (a?, b?);
    if a.first().map(Vec::len) != b.first().map(Vec::len) {
        table.refuse("a_rad_s and b_rad_s must have the same number of harmonics".into(), None);
        return None;
    }
    Some(FourierExcitation { base_frequency: base_frequency?, a, b, centre: centre? })
}

fn read_centre(value: &Value<'_>, joints: Option<&[Joint]>) -> Option<Vec<f64>> {
    let centre = value.numbers(joints.map(<[Joint]>::len), &Limits::within(100.0, "rad"))?;
    for (i, (joint, position)) in joints.unwrap_or_default().iter().zip(&centre).enumerate() {
        let limits = joint.limits;
        if !(limits.position_min..=limits.position_max).contains(position) {
            value.refuse(format!("joint {}: {position} rad is outside the joint's range", i + 1), None);
            return None;
        }
    }
    Some(centre)
}

/// One array of amplitudes a joint, all of the same length.
fn read_amplitudes(table: &Table<'_>, key: &str, joint_count: Option<usize>) -> Option<Vec<Vec<f64>>> {
    let value = table.required(key)?;
    let items = value.items()?;
    if let Some(count) = joint_count
        && items.len() != count
    {
        let hint = Some("write one array of amplitudes a joint".into());
        value.refuse(format!("has {} entries, must have {count}, one a joint", items.len()), hint);
        return None;
    }
    let harmonics = items.first()?.items()?.len();
    if harmonics == 0 || harmonics > MAX_HARMONICS {
        value.refuse(format!("has {harmonics} harmonics, must have 1 to {MAX_HARMONICS}"), None);
        return None;
    }
    let amplitude = Limits::within(100.0, "rad/s");
    let rows: Vec<_> = items.iter().map(|item| item.numbers(Some(harmonics), &amplitude)).collect();
    rows.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::er3a;

    const SCARA: &str = include_str!("../../config/robots/scara.toml");

    fn table(text: &str) -> Vec<Vec<f64>> {
        text.lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
            .collect()
    }

    #[test]
    fn the_er3a_has_the_geometry_of_the_reference_data() {
        let reference = table(include_str!("../../tests/reference/geometry.csv"));
        let robot = er3a();
        assert_eq!(robot.joint_count(), reference.len());
        for (joint, row) in robot.joints.iter().zip(reference) {
            assert_eq!(joint.kind, JointKind::Revolute);
            let geometry = ModifiedDh {
                a: row[1],
                alpha: row[2].to_radians(),
                d: row[3],
                theta_offset: row[4].to_radians(),
            };
            assert_eq!(joint.geometry, geometry);
            let limits = JointLimits {
                position_min: row[5].to_radians(),
                position_max: row[6].to_radians(),
                velocity: row[7].to_radians(),
                acceleration: row[8].to_radians(),
            };
            assert_eq!(joint.limits, limits);
            assert_eq!(
                (joint.rated_motor_torque, joint.gear_ratio, joint.low_speed),
                (Some(row[9]), row[10], 0.02)
            );
        }
    }

    #[test]
    fn the_er3a_has_the_inertia_of_the_reference_data() {
        let reference = table(include_str!("../../tests/reference/er3a_inertial_parameters.csv"));
        for (joint, row) in er3a().joints.iter().zip(reference) {
            let nominal = joint.nominal.expect("nominal parameters");
            assert_eq!(nominal.inertial.0[..], row[1..11]);
            assert_eq!(nominal.motor_inertia, row[11]);
        }
    }

    #[test]
    fn the_cold_er3a_has_about_one_and_a_half_times_the_friction_of_the_warm_one() {
        for joint in er3a().joints {
            let shape = joint.nominal.expect("nominal parameters").warm_up;
            let at = |t: f64| 1.0 + shape.b * (-t / shape.t1).exp() + shape.c * (-t / shape.t2).exp();
            assert!((1.3..1.6).contains(&at(60.0)), "{shape:?}: {}", at(60.0));
            assert!((1.0..1.1).contains(&at(7200.0)), "{shape:?}: {}", at(7200.0));
        }
    }

    #[test]
    fn the_er3a_excitation_starts_at_rest_and_stays_within_speed_limits() {
        let robot = er3a();
        let excitation = robot.excitation.expect("an excitation");
        let harmonics = |row: &[f64], f: &dyn Fn(f64) -> f64| -> f64 {
            row.iter().enumerate().map(|(l, x)| x * f(l as f64 + 1.0)).sum()
        };
        // Largest speed as a fraction of the limit, which the source's table is known to reach.
        let expected = [0.66, 0.61, 0.59, 0.52, 0.46, 0.39];
        for (i, joint) in robot.joints.iter().enumerate() {
            let (a, b) = (&excitation.a[i], &excitation.b[i]);
            // Four decimals in the table, five harmonics.
            assert!(
                harmonics(a, &|_| 1.0).abs() < 5e-4 && harmonics(b, &|l| l).abs() < 15e-4,
                "joint {}",
                i + 1
            );
            let speed = |t: f64| {
                let wt = std::f64::consts::TAU * excitation.base_frequency * t;
                harmonics(a, &|l| (l * wt).cos()) + harmonics(b, &|l| (l * wt).sin())
            };
            let fastest = (0..1000).map(|k| speed(0.01 * f64::from(k)).abs()).fold(0.0, f64::max);
            assert!(
                (fastest / joint.limits.velocity - expected[i]).abs() < 0.005,
                "joint {}: {fastest}",
                i + 1
            );
        }
    }

    #[test]
    fn a_sliding_joint_is_read_in_metres() {
        let robot = parse_robot("scara.toml", SCARA).expect("no problems");
        assert_eq!(robot.joint_count(), 4);
        let quill = &robot.joints[2];
        assert_eq!(quill.kind, JointKind::Prismatic);
        assert_eq!((quill.limits.position_max, quill.limits.velocity, quill.low_speed), (0.2, 1.2, 0.005));
        let nominal = quill.nominal.expect("nominal parameters");
        assert_eq!((nominal.motor_inertia, nominal.friction), (2.5, [10.0, 20.0, 0.0, 0.0]));
        assert_eq!(nominal.warm_up.t1, 1200.0);
        assert_eq!((robot.excitation, robot.joints[0].low_speed), (None, DEFAULT_LOW_SPEED));
    }

    #[test]
    fn degrees_and_radians_of_the_same_angle_are_the_same_arm() {
        let radians = SCARA
            .replace("alpha_deg = 180", "alpha_rad = 3.141592653589793")
            .replace("position_max_deg = 130", &format!("position_max_rad = {}", 130.0_f64.to_radians()));
        assert_ne!(radians, SCARA);
        assert_eq!(parse_robot("scara.toml", &radians), parse_robot("scara.toml", SCARA));
    }
}
