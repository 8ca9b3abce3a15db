//! An arm that is written and read again is the same arm.

use proptest::prelude::*;

use super::{straight_friction, urdf_text};
use armwatch_config::robot::robot_file::parse_robot_with;
use armwatch_method::model::base_parameters::{base_parameters, probe_state};
use armwatch_method::model::dynamics::{DynamicModel, inverse_dynamics};
use armwatch_method::model::kinematics::forward_kinematics;
use armwatch_method::physical::uniform_bodies::uniform_bodies;
use armwatch_model::robot::{
    FrictionLaw, FrictionModel, JointIndex, JointLimits, Robot, StandardParameters, Transform,
};
use armwatch_testing::arms::{any_arm, numbers};
use armwatch_testing::{described, er3a, tx40};

/// Poses and torques over nine joints by frames that were turned there and back.
const EQUAL: f64 = 1e-9;

/// Cylinders that are moved and turned, so that no entry is zero.
fn some_model(robot: &Robot, numbers: &[f64]) -> DynamicModel {
    let moved = |(j, body): (usize, StandardParameters)| {
        let v = &numbers[10 * j..];
        body.seen_from(&Transform::from_xyz_rpy([0.1 * v[0], 0.1 * v[1], 0.1 * v[2]], [v[3], v[4], v[5]]))
    };
    let mut model = DynamicModel::from_parameters(robot, std::iter::empty());
    model.inertial = uniform_bodies(robot, 1500.0).into_iter().enumerate().map(moved).collect();
    model.motor_inertia.iter_mut().for_each(|inertia| *inertia = 0.3);
    model
}

/// Reads what was written; what URDF cannot say is taken over.
fn read_again(robot: &Robot, text: &str) -> Robot {
    let g = robot.gravity;
    let description = format!(
        "model = \"again\"\nconvention = \"urdf\"\nurdf = \"arm.urdf\"\ngravity_m_s2 = [{}, {}, {}]\nspeed_levels = [1]\n",
        g.x, g.y, g.z
    );
    let mut again = parse_robot_with("arm.toml", &description, &|_| Ok(text.to_owned()))
        .unwrap_or_else(|errors| panic!("{errors}\n{text}"));
    again.friction = robot.friction;
    again.couplings.clone_from(&robot.couplings);
    again.springs.clone_from(&robot.springs);
    again.parallelograms.clone_from(&robot.parallelograms);
    again.transmission.clone_from(&robot.transmission);
    for (again, joint) in again.joints.iter_mut().zip(&robot.joints) {
        let (read, given) = (again.limits, joint.limits);
        assert_eq!(JointLimits { acceleration: given.acceleration, jerk: given.jerk, ..read }, given);
        again.limits = given;
    }
    again
}

fn bodies(robot: &Robot) -> Vec<StandardParameters> {
    robot.joints.iter().map(|joint| joint.nominal.expect("an inertial tag").inertial).collect()
}

fn norm(v: &[f64]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn assert_same_motion(robot: &Robot, model: &DynamicModel, again: &Robot) {
    let read = bodies(again);
    let n = robot.joint_count();
    for index in 0..8 {
        let state = probe_state(robot, index);
        let (here, there) = (forward_kinematics(robot, &state.q), forward_kinematics(again, &state.q));
        assert!((here.translation - there.translation).norm() < EQUAL, "{here:?} {there:?}");
        assert!((here.rotation - there.rotation).norm() < EQUAL, "{here:?} {there:?}");
        let (mut tau, mut tau_again) = (vec![0.0; n], vec![0.0; n]);
        inverse_dynamics(robot, &model.inertial, &state.q, &state.qd, &state.qdd, &mut tau);
        inverse_dynamics(again, &read, &state.q, &state.qd, &state.qdd, &mut tau_again);
        let difference: Vec<f64> = tau.iter().zip(&tau_again).map(|(a, b)| a - b).collect();
        assert!(norm(&difference) <= EQUAL * norm(&tau).max(1.0), "{tau:?} {tau_again:?}");
    }
}

fn phi(robot: &Robot, inertial: &[StandardParameters]) -> Vec<f64> {
    let links = inertial.iter().flat_map(|link| link.0);
    let mut phi: Vec<f64> = links.collect();
    phi.resize(robot.parameter_count(), 0.2);
    phi
}

fn assert_same_base_parameters(robot: &Robot, model: &DynamicModel, again: &Robot) {
    let (Ok(here), Ok(there)) = (base_parameters(robot), base_parameters(again)) else { return };
    assert_eq!(here.kept, there.kept);
    let ours = here.group(&phi(robot, &model.inertial));
    let theirs = there.group(&phi(again, &bodies(again)));
    for ((a, b), id) in ours.iter().zip(&theirs).zip(&here.kept) {
        assert!((a - b).abs() <= EQUAL * norm(&ours), "{id}: {a} {b}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn any_arm_is_the_same_after_writing_and_reading(robot in any_arm(), numbers in numbers()) {
        let model = some_model(&robot, &numbers);
        let again = read_again(&robot, &urdf_text(&robot, &model, &[]));
        assert_same_motion(&robot, &model, &again);
        assert_same_base_parameters(&robot, &model, &again);
    }
}

#[test]
fn the_er3a_with_a_tool_is_the_same_after_writing_and_reading() {
    let mut robot = er3a();
    robot.tool = Transform::from_xyz_rpy([0.1, 0.2, 0.3], [0.1, std::f64::consts::FRAC_PI_2, 0.3]);
    let mut model = DynamicModel::from_parameters(&robot, std::iter::empty());
    model.inertial = bodies(&robot);
    let again = read_again(&robot, &urdf_text(&robot, &model, &["from -- nothing".to_owned()]));
    assert_same_motion(&robot, &model, &again);
    assert_same_base_parameters(&robot, &model, &again);
    for (joint, again) in robot.joints.iter().zip(&again.joints) {
        assert!((joint.geometry.placement().rotation - again.geometry.placement().rotation).norm() < EQUAL);
    }
}

#[test]
fn frames_and_names_of_a_urdf_arm_are_its_own() {
    let urdf = "<robot name=\"two\"><link name=\"a\"/><link name=\"b\"/><link name=\"c\"/>\
        <joint name=\"shoulder\" type=\"revolute\"><origin xyz=\"0 0.1 0.3\" rpy=\"0.1 0.2 0.3\"/><parent link=\"a\"/>\
        <child link=\"b\"/><axis xyz=\"0 2 0\"/><limit lower=\"-1\" upper=\"2\" effort=\"5\" velocity=\"3\"/></joint>\
        <joint name=\"slide &amp; stop\" type=\"prismatic\"><origin xyz=\"0.4 0 0\"/><parent link=\"b\"/><child link=\"c\"/>\
        <axis xyz=\"0 0 -1\"/><limit lower=\"0\" upper=\"0.5\" effort=\"5\" velocity=\"1\"/></joint></robot>";
    let description = "model = \"two\"\nconvention = \"urdf\"\nurdf = \"two.urdf\"\n\
        gravity_m_s2 = [0, 0, -9.81]\nspeed_levels = [1]\n";
    let robot = parse_robot_with("two.toml", description, &|_| Ok(urdf.to_owned())).expect("an arm");
    let model = some_model(&robot, &[0.5; 20]);
    let text = urdf_text(&robot, &model, &[]);
    let written = urdf_rs::read_from_string(&text).expect("a URDF");
    for (joint, (name, axis, xyz)) in written.joints.iter().zip([
        ("shoulder", [0.0, 1.0, 0.0], [0.0, 0.1, 0.3]),
        ("slide & stop", [0.0, 0.0, -1.0], [0.4, 0.0, 0.0]),
    ]) {
        assert_eq!((joint.name.as_str(), joint.axis.xyz.0), (name, axis));
        let away = (0..3).map(|k| (joint.origin.xyz.0[k] - xyz[k]).abs()).fold(0.0, f64::max);
        assert!(away < EQUAL, "{:?}", joint.origin);
    }
    assert_same_motion(&robot, &model, &read_again(&robot, &text));
}

#[test]
fn the_line_of_friction_is_exact_where_urdf_can_say_it_and_never_drives() {
    let joint = JointIndex::new(0);
    let line = |law: FrictionLaw, asymmetric: bool, f: [f64; 4]| {
        let robot =
            Robot { friction: FrictionModel { law, asymmetric, ..FrictionModel::POLYNOMIAL }, ..er3a() };
        let mut model = DynamicModel::from_parameters(&robot, std::iter::empty());
        model.friction[0] = f;
        straight_friction(&robot, &model, joint)
    };
    let near = |a: f64, b: f64| (a - b).abs() < EQUAL;
    let exact = line(FrictionLaw::ViscousCoulomb, false, [3.0, 7.0, 0.9, 0.0]);
    assert!(near(exact.friction, 3.0) && near(exact.damping, 7.0), "{exact:?}");
    let mean = line(FrictionLaw::ViscousCoulomb, true, [3.0, 5.0, 7.0, 9.0]);
    assert!(near(mean.friction, 4.0) && near(mean.damping, 8.0), "{mean:?}");
    // A falling curve has no damping, one that starts below zero no Coulomb friction.
    let falling = line(FrictionLaw::Polynomial, false, [9.0, -1.0, 0.0, 0.0]);
    assert!(falling.damping == 0.0 && (0.0..9.0).contains(&falling.friction), "{falling:?}");
    let rising = line(FrictionLaw::Polynomial, false, [-1.0, 5.0, 0.0, 0.0]);
    assert!(rising.friction == 0.0 && (0.0..5.0).contains(&rising.damping), "{rising:?}");
}

#[test]
fn what_urdf_cannot_say_stands_in_comments() {
    let robot = tx40();
    let model = some_model(&robot, &[0.3; 70]);
    let text = urdf_text(&robot, &model, &["identified -- from run 1-".to_owned()]);
    for said in [
        "<!-- identified - - from run 1 -->",
        "gravity in the frame of base_link, m/s^2: 0.0 0.0 -9.81",
        "an offset of torque",
        "the motor of joint 6 also turns with joint 5",
        "q is the recorded position plus -1.57",
        "<mechanicalReduction>-48.0</mechanicalReduction>",
        "(armature): 0.3 kg m^2",
    ] {
        assert!(text.contains(said), "{said}\n{text}");
    }
}

#[test]
fn effort_is_the_peak_torque_before_ratings_and_the_model() {
    let mut robot = er3a();
    for joint in &mut robot.joints {
        (joint.peak_torque, joint.rated_torque, joint.rated_motor_torque) = (None, None, None);
    }
    robot.joints[0].peak_torque = Some(230.0);
    robot.joints[0].rated_torque = Some(77.0);
    robot.joints[1].rated_torque = Some(55.0);
    robot.joints[1].rated_motor_torque = Some(0.5);
    robot.joints[2].rated_motor_torque = Some(0.5);
    robot.joints[2].gear_ratio = -81.0;
    let model = some_model(&robot, &[0.3; 70]);
    let text = urdf_text(&robot, &model, &[]);
    let written = urdf_rs::read_from_string(&text).expect("a URDF");
    let efforts: Vec<f64> = written.joints[..3].iter().map(|joint| joint.limit.effort).collect();
    assert_eq!(efforts, [230.0, 55.0, 40.5]);
    let origins: Vec<&str> =
        text.lines().filter_map(|line| line.trim().strip_prefix("<!-- effort: ")).collect();
    let expected =
        ["peak torque of the joint", "rated torque of the joint", "rated torque of the motor", "largest"];
    assert_eq!(origins.len(), 6);
    for (origin, expected) in origins.iter().zip(expected) {
        assert!(origin.starts_with(expected), "{origin}");
    }
}

/// The reference has fifteen digits; sums over a chain lose a few.
const REFERENCE_DIGITS: f64 = 1e-9;

/// Bodies as read from the file, frames from the description that the file was written with, against
/// what Pinocchio computed from the file: any slip of an origin, an axis or a centre shows.
fn assert_pinocchio(description: &str, urdf: &str, table: &str) {
    let robot = described(description);
    let again = read_again(&robot, urdf);
    let read = bodies(&again);
    let n = robot.joint_count();
    let mut rows = 0;
    for row in table.lines().skip(1) {
        let row: Vec<f64> = row.split(',').map(|cell| cell.parse().expect("a number")).collect();
        let (q, qd, qdd, expected) = (&row[..n], &row[n..2 * n], &row[2 * n..3 * n], &row[3 * n..4 * n]);
        let mut tau = vec![0.0; n];
        for arm in [&robot, &again] {
            inverse_dynamics(arm, &read, q, qd, qdd, &mut tau);
            let difference: Vec<f64> = tau.iter().zip(expected).map(|(a, b)| a - b).collect();
            assert!(norm(&difference) < REFERENCE_DIGITS * norm(expected), "{tau:?} {expected:?}");
            let pose = forward_kinematics(arm, q);
            let by_rows = pose.rotation.transpose();
            let numbers = pose.translation.iter().chain(by_rows.iter());
            for (found, expected) in numbers.zip(&row[4 * n..]) {
                assert!((found - expected).abs() < REFERENCE_DIGITS, "{pose:?} {row:?}");
            }
        }
        rows += 1;
    }
    assert_eq!(rows, 40);
}

#[test]
fn pinocchio_computes_the_same_from_the_er3a_as_written() {
    assert_pinocchio(
        include_str!("../../config/robots/er3a.toml"),
        include_str!("../../tests/reference/urdf/er3a.urdf"),
        include_str!("../../tests/reference/urdf/er3a_inverse_dynamics.csv"),
    );
}

#[test]
fn pinocchio_computes_the_same_from_the_tx40_as_written() {
    assert_pinocchio(
        include_str!("../../config/robots/tx40.toml"),
        include_str!("../../tests/reference/urdf/tx40.urdf"),
        include_str!("../../tests/reference/urdf/tx40_inverse_dynamics.csv"),
    );
}

#[test]
fn pinocchio_computes_the_same_from_an_arm_in_standard_dh_as_written() {
    assert_pinocchio(
        include_str!("../../tests/reference/urdf/standard_dh.toml"),
        include_str!("../../tests/reference/urdf/standard_dh.urdf"),
        include_str!("../../tests/reference/urdf/standard_dh_inverse_dynamics.csv"),
    );
}
