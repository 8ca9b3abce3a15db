//! Descriptions of arms: `config/robots/*.toml` to [`Robot`].

use std::path::Path;

use super::geometry::Convention;
use super::transmission::GivenTransmission;
use super::{balance, friction_model, geometry, joint, shape, transmission, urdf_arm};
use crate::robot::chain::Chain;
use crate::toml::files;
use crate::toml::files::ReadText;
use crate::toml::problem::ConfigErrors;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value, read_document};
use armwatch_model::robot::{
    FourierExcitation, FrictionModel, Joint, JointGeometry, MAX_JOINTS, Robot, StandardParameters,
    TorqueSensors, Transform,
};

/// Longest name of a model, in characters; it appears in table columns and plot titles.
const MODEL_CHARACTERS: usize = 64;

/// Most speed levels of a friction test; the exports' signal for them is a small number.
const MAX_SPEED_LEVELS: usize = 20;

/// Most harmonics of an excitation; the one published for the ER3A has 5.
const MAX_HARMONICS: usize = 50;

/// Reads the description of an arm from `text`; `file_name` is used in problems, and a URDF file that the description
/// names is searched next to it.
///
/// # Errors
///
/// Every problem of the description at once.
pub fn parse_robot(file_name: &str, text: &str) -> Result<Robot, ConfigErrors> {
    parse_robot_with(file_name, text, &files::read_text)
}

/// Reads the description of an arm from the file at `path`.
///
/// # Errors
///
/// Every problem of the description at once, or a failed read.
pub fn read_robot(path: &Path) -> Result<Robot, ConfigErrors> {
    parse_robot(&path.display().to_string(), &files::read_text(path)?)
}

/// Like [`parse_robot`], with a reader for other files that the description names.
pub fn parse_robot_with(
    file_name: &str,
    text: &str,
    read_text: &ReadText<'_>,
) -> Result<Robot, ConfigErrors> {
    let folder = Path::new(file_name).parent().unwrap_or(Path::new("")).to_owned();
    read_document(file_name, text, |root| read_root(root, &folder, read_text))
}

fn read_root(root: &Table<'_>, folder: &Path, read_text: &ReadText<'_>) -> Option<Robot> {
    let model = read_model(root);
    let convention = geometry::read_convention(root);
    let gravity = root.numbers("gravity_m_s2", Some(3), &Limits::within(30.0, "m/s^2"));
    let speed_levels = read_speed_levels(root);
    let friction = friction_model::read_of_arm(root);
    let torque_sensors = read_torque_sensors(root);
    // problems of the arm's model are reported once
    let of_arm = friction.unwrap_or_default().model;
    let tool = geometry::read_tool(root);
    let given = transmission::read_matrix(root);
    let chain = match convention {
        Some(Convention::Urdf) => urdf_arm::read_chain(root, folder, read_text, &given, of_arm),
        // Values that do not depend on the convention are still checked.
        _ => read_dh_chain(root, convention, (&given, torque_sensors), of_arm),
    };
    let joints = chain.as_ref().map(|chain| &chain.joints[..]);
    let transmission = transmission::read(root, given, joints);
    let balance = balance::read(root, joints);
    let excitation = match root.table("excitation") {
        Some(table) => Some(read_excitation(&table, joints)?),
        None => None,
    };
    let shape = shape::read(root, joints.map(<[Joint]>::len));
    let friction = friction.zip(joints).and_then(|(friction, joints)| friction.of_other_joints(root, joints));
    let (friction, tool, chain, transmission) = (friction?, tool?, chain?, transmission?);
    let torque_sensors = torque_sensors?;
    let balance = balance?;
    convention?;
    let gravity: [f64; 3] = gravity?.try_into().ok()?;
    Some(Robot {
        model: model?,
        joints: chain.joints,
        gravity: gravity.into(),
        tool: chain.end.then(&tool),
        carried: StandardParameters::default(),
        friction,
        torque_sensors,
        transmission: transmission.matrix,
        // a sensor after the gears does not measure the motors
        couplings: match torque_sensors {
            TorqueSensors::Motor => transmission.couplings,
            TorqueSensors::Link => Vec::new(),
        },
        springs: balance.springs,
        parallelograms: balance.parallelograms,
        speed_levels: speed_levels?,
        excitation,
        shape: shape?,
        remarks: chain.remarks,
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

fn read_speed_levels(root: &Table<'_>) -> Option<Vec<f64>> {
    let value = root.required("speed_levels")?;
    let levels = value.numbers(None, &Limits::above(0.0, 1.0, "of the largest speed"))?;
    if levels.is_empty() || levels.len() > MAX_SPEED_LEVELS {
        value.refuse(format!("has {} entries, must have 1 to {MAX_SPEED_LEVELS}", levels.len()), None);
        return None;
    }
    if levels.windows(2).any(|pair| pair[1] <= pair[0]) {
        value.refuse("must increase from level to level".into(), None);
        return None;
    }
    Some(levels)
}

/// Reads which torque is measured.
fn read_torque_sensors(root: &Table<'_>) -> Option<TorqueSensors> {
    let Some(value) = root.optional("torque_sensors") else { return Some(TorqueSensors::default()) };
    match value.text()? {
        "motor" => Some(TorqueSensors::Motor),
        "link" => Some(TorqueSensors::Link),
        _ => {
            let hint = "torque or current of the drives; sensors behind the gears, which do not measure motor inertia";
            value.refuse("must be \"motor\" or \"link\"".into(), Some(hint.into()));
            None
        }
    }
}

fn read_dh_chain(
    root: &Table<'_>,
    convention: Option<Convention>,
    (given, torque_sensors): (&GivenTransmission<'_>, Option<TorqueSensors>),
    friction: FrictionModel,
) -> Option<Chain> {
    // a sensor after the gears does not measure them
    let default_ratio = torque_sensors.filter(|of| *of == TorqueSensors::Link).map(|_| 1.0);
    let value = root
        .required_or_else("joint", || Some("write one [[joint]] per joint, from the base outwards".into()))?;
    let items = value.sections()?;
    let joints: Vec<Option<Joint>> = items
        .iter()
        .enumerate()
        .map(|(i, item)| {
            item.table().and_then(|table| joint::read(&table, given.ratio(i), (default_ratio, friction)))
        })
        .collect();
    if joints.is_empty() || joints.len() > MAX_JOINTS {
        value.refuse(format!("{} joints, must be 1 to {MAX_JOINTS}", joints.len()), None);
        return None;
    }
    let mut joints: Vec<Joint> = joints.into_iter().collect::<Option<_>>()?;
    let mut end = Transform::IDENTITY;
    if convention == Some(Convention::StandardDh) {
        let rows: Vec<_> = joints.iter().filter_map(|joint| joint.geometry.dh_row()).collect();
        let (geometry, last) = JointGeometry::standard_dh(&rows);
        for (joint, geometry) in joints.iter_mut().zip(geometry) {
            joint.geometry = geometry;
        }
        end = last;
    }
    Some(Chain { joints, end, remarks: Vec::new() })
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

/// One array of amplitudes per joint, all of the same length.
fn read_amplitudes(table: &Table<'_>, key: &str, joint_count: Option<usize>) -> Option<Vec<Vec<f64>>> {
    let value = table.required(key)?;
    let items = value.items()?;
    if let Some(count) = joint_count
        && items.len() != count
    {
        let hint = Some("write one array of amplitudes per joint".into());
        value.refuse(format!("has {} entries, must have {count}, one per joint", items.len()), hint);
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
    use armwatch_method::model::base_parameters::base_parameters;
    use armwatch_method::model::kinematics::forward_kinematics;
    use armwatch_model::robot::{DhParameters, JointKind, JointLimits};
    use armwatch_testing::er3a;

    const SCARA: &str = include_str!("../../../../config/robots/scara.toml");

    fn table(text: &str) -> Vec<Vec<f64>> {
        text.lines()
            .skip(1)
            .map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect())
            .collect()
    }

    #[test]
    fn the_er3a_has_the_geometry_of_the_reference_data() {
        let reference = table(include_str!("../../../../tests/reference/geometry.csv"));
        let robot = er3a();
        assert_eq!(robot.joint_count(), reference.len());
        for (joint, row) in robot.joints.iter().zip(reference) {
            assert_eq!(joint.kind, JointKind::Revolute);
            let geometry = DhParameters {
                a: row[1],
                alpha: row[2].to_radians(),
                d: row[3],
                theta_offset: row[4].to_radians(),
            };
            assert_eq!(joint.geometry, JointGeometry::modified_dh(geometry));
            let limits = JointLimits {
                position_min: row[5].to_radians(),
                position_max: row[6].to_radians(),
                velocity: row[7].to_radians(),
                acceleration: row[8].to_radians(),
                jerk: None,
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
        let reference = table(include_str!("../../../../tests/reference/er3a_inertial_parameters.csv"));
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
        // Known largest speeds of the source's table, as fractions of the limits.
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
        assert_eq!((robot.excitation, robot.joints[0].low_speed), (None, joint::DEFAULT_LOW_SPEED));
    }

    #[test]
    fn degrees_and_radians_of_the_same_angle_are_the_same_arm() {
        let radians = SCARA
            .replace("alpha_deg = 180", "alpha_rad = 3.141592653589793")
            .replace("position_max_deg = 130", &format!("position_max_rad = {}", 130.0_f64.to_radians()));
        assert_ne!(radians, SCARA);
        assert_eq!(parse_robot("scara.toml", &radians), parse_robot("scara.toml", SCARA));
    }

    #[test]
    fn sensors_behind_the_gears_need_no_gear_ratio() {
        let text = include_str!("../../../../config/robots/er3a.toml");
        let without: String = text
            .lines()
            .filter(|line| !line.starts_with("gear_ratio"))
            .map(|line| format!("{line}\n"))
            .collect();
        assert!(parse_robot("er3a.toml", &without).is_err());
        let robot = parse_robot("er3a.toml", &format!("torque_sensors = \"link\"\n{without}"));
        let robot = robot.unwrap_or_else(|errors| panic!("{errors}"));
        assert!(robot.joints.iter().all(|joint| (joint.gear_ratio - 1.0).abs() < f64::EPSILON));
    }

    #[test]
    fn the_tx40_has_the_structural_ranks_of_its_published_model() {
        let text = include_str!("../../../../config/robots/tx40.toml");
        let robot = parse_robot("tx40.toml", text).unwrap_or_else(|errors| panic!("{errors}"));
        let base = base_parameters(&robot).expect("base parameters");
        assert_eq!((base.inertial_rank, base.inertial_and_motor_rank, base.rank), (36, 40, 61));
        let names: Vec<String> = base.kept.iter().map(ToString::to_string).collect();
        assert_eq!(names[names.len() - 3..], ["J6_Iam", "J6_fvm", "J6_fsm"]);
        let friction = ["fs", "fv", "off"];
        assert!((1..=6).all(|j| friction.iter().all(|f| names.contains(&format!("J{j}_{f}")))), "{names:?}");
        // At the controller's zero the arm is upright.
        assert_eq!(robot.joints[1].position_offset, -std::f64::consts::FRAC_PI_2);
        assert_eq!((robot.joints[3].gear_ratio, robot.transmission[(5, 4)]), (-48.0, 32.0));
        assert_eq!(robot.couplings[0].ratio, 1.0);
    }

    #[test]
    fn a_tx40_without_its_coupling_lacks_three_parameters() {
        let text = include_str!("../../../../config/robots/tx40.toml");
        let (before, after) = text.split_once("[[coupling]]").expect("a coupling");
        let (_, after) = after.split_once("# Joint 1").expect("a joint");
        let robot = parse_robot("tx40.toml", &format!("{before}{after}")).expect("no problems");
        assert_eq!(base_parameters(&robot).expect("base parameters").rank, 58);
    }

    #[test]
    fn the_ur10e_stretches_as_far_as_its_data_sheet_says() {
        let text = include_str!("../../../../config/robots/ur10e.toml");
        let robot = parse_robot("ur10e.toml", text).unwrap_or_else(|errors| panic!("{errors}"));
        let base = base_parameters(&robot).expect("base parameters");
        assert_eq!((base.inertial_rank, base.inertial_and_motor_rank, base.rank), (36, 40, 58));
        // All joints at zero: the arm is stretched out along -x, and its flange points along -y.
        let pose = forward_kinematics(&robot, &[0.0; 6]);
        let expected = [-0.6127 - 0.57155, -0.17415 - 0.11655, 0.1807 - 0.11985];
        assert!(
            (pose.translation - nalgebra::Vector3::from(expected)).norm() < 1e-12,
            "{}",
            pose.translation
        );
    }
}
