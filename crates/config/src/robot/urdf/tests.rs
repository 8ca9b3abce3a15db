//! One arm in three conventions, and oddities of URDF files.

use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;

use super::read_chain;
use crate::robot::robot_file::{parse_robot, parse_robot_with};
use armwatch_method::model::base_parameters::base_parameters;
use armwatch_method::model::dynamics::inverse_dynamics;
use armwatch_method::model::kinematics::forward_kinematics;
use armwatch_model::robot::{
    DhParameters, GeometrySource, Joint, JointGeometry, JointKind, Robot, StandardParameters, Transform,
};
use armwatch_testing::er3a;

/// Poses and torques over six joints by other frames: a few hundred roundings.
const ROUNDING: f64 = 1e-12;

/// The same arm in standard DH: a and alpha move to the previous row, and each link's parameters move along its axis by
/// `d`. The first row must have neither a nor alpha.
fn in_standard_dh(robot: &Robot) -> Robot {
    let rows: Vec<DhParameters> = robot.joints.iter().map(|j| j.geometry.dh_row().expect("a row")).collect();
    assert_eq!((rows[0].a, rows[0].alpha), (0.0, 0.0));
    let moved_up: Vec<DhParameters> = (0..rows.len())
        .map(|i| {
            let next = rows.get(i + 1);
            DhParameters { a: next.map_or(0.0, |r| r.a), alpha: next.map_or(0.0, |r| r.alpha), ..rows[i] }
        })
        .collect();
    let (geometry, end) = JointGeometry::standard_dh(&moved_up);
    let mut other = robot.clone();
    other.tool = end.then(&robot.tool);
    for ((joint, geometry), row) in other.joints.iter_mut().zip(geometry).zip(&rows) {
        joint.geometry = geometry;
        if let Some(nominal) = &mut joint.nominal {
            nominal.inertial = nominal.inertial.seen_from(&Transform::moved(0.0, 0.0, row.d));
        }
    }
    other
}

/// Pose of a link's URDF frame in the frame of its joint: arbitrary rotations, so that axes are oblique.
fn urdf_frame(i: usize) -> Transform {
    let i = i as f64;
    Transform::from_xyz_rpy([0.05 * i, -0.1, 0.03 * i], [0.4 * i, 0.7 - 0.3 * i, 1.1])
}

fn rpy(r: &Matrix3<f64>) -> [f64; 3] {
    [r.m32.atan2(r.m33), (-r.m31).asin(), r.m21.atan2(r.m11)]
}

fn origin_tag(pose: &Transform) -> String {
    let (t, [roll, pitch, yaw]) = (pose.translation, rpy(&pose.rotation));
    format!("<origin xyz=\"{} {} {}\" rpy=\"{roll} {pitch} {yaw}\"/>", t.x, t.y, t.z)
}

fn inertial_tag(body: &StandardParameters) -> String {
    let mass = body.mass();
    let centre = body.first_moment() / mass;
    let shift = Matrix3::identity() * centre.norm_squared() - centre * centre.transpose();
    let i = body.inertia() - shift * mass;
    format!(
        "<inertial>{}<mass value=\"{mass}\"/><inertia ixx=\"{}\" ixy=\"{}\" ixz=\"{}\" iyy=\"{}\" iyz=\"{}\" izz=\"{}\"/></inertial>",
        origin_tag(&Transform { translation: centre, ..Transform::IDENTITY }),
        i.m11,
        i.m12,
        i.m13,
        i.m22,
        i.m23,
        i.m33
    )
}

/// The arm as a URDF file with oblique axes. With `split`, each link is cut in two parts that a fixed joint connects,
/// with an empty frame in between.
fn as_urdf(robot: &Robot, split: bool) -> String {
    let mut text = String::from("<robot name=\"arm\"><link name=\"l0\"/>");
    // Frame of the previous link in the frame of its joint.
    let mut before = Transform::IDENTITY;
    let mut parent = "l0".to_owned();
    for (i, joint) in robot.joints.iter().enumerate() {
        let own = urdf_frame(i);
        // The URDF joint frame must be on the axis: the link's frame there is turned, not moved.
        let turned = Transform { translation: Vector3::zeros(), ..own };
        let place = before.inverse().then(joint.geometry.placement()).then(&turned);
        let axis = turned.to_inner(&Vector3::z()) * 2.5;
        let body = joint.nominal.expect("nominal").inertial.seen_from(&turned.inverse());
        let name = format!("l{}", i + 1);
        let kind = match joint.kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        };
        let limits = joint.limits;
        write!(
            text,
            "<joint name=\"j{}\" type=\"{kind}\">{}<parent link=\"{parent}\"/><child link=\"{name}\"/>\
             <axis xyz=\"{} {} {}\"/><limit lower=\"{}\" upper=\"{}\" effort=\"1\" velocity=\"{}\"/></joint>",
            i + 1,
            origin_tag(&place),
            axis.x,
            axis.y,
            axis.z,
            limits.position_min,
            limits.position_max,
            limits.velocity
        )
        .expect("text");
        before = turned;
        parent = name.clone();
        if split {
            let half = StandardParameters(body.0.map(|x| 0.5 * x));
            let away = own;
            write!(
                text,
                "<link name=\"{name}\">{}</link><link name=\"{name}_frame\"/><link name=\"{name}_half\">{}</link>\
                 <joint name=\"f{name}\" type=\"fixed\">{}<parent link=\"{name}\"/><child link=\"{name}_frame\"/></joint>\
                 <joint name=\"g{name}\" type=\"fixed\"><parent link=\"{name}_frame\"/><child link=\"{name}_half\"/></joint>",
                inertial_tag(&half), inertial_tag(&half.seen_from(&away.inverse())), origin_tag(&away)
            )
            .expect("text");
            before = before.then(&away);
            parent = format!("{name}_frame");
        } else {
            write!(text, "<link name=\"{name}\">{}</link>", inertial_tag(&body)).expect("text");
        }
    }
    // The tool, which is the frame of the last joint.
    write!(
        text,
        "<link name=\"tip\"/><joint name=\"tip\" type=\"fixed\">{}<parent link=\"{parent}\"/><child link=\"tip\"/></joint></robot>",
        origin_tag(&before.inverse())
    )
    .expect("text");
    text
}

fn read_urdf(urdf: &str, gravity: [f64; 3]) -> Robot {
    let description = format!(
        "model = \"arm\"\nconvention = \"urdf\"\nurdf = \"arm.urdf\"\ntip_link = \"tip\"\n\
         gravity_m_s2 = {gravity:?}\nspeed_levels = [0.5]\n"
    );
    parse_robot_with("folder/arm.toml", &description, &|path| {
        assert_eq!(path, std::path::Path::new("folder/arm.urdf"));
        Ok(urdf.to_owned())
    })
    .unwrap_or_else(|errors| panic!("{errors}"))
}

fn torque(robot: &Robot, k: usize) -> Vec<f64> {
    let n = robot.joint_count();
    let parameters: Vec<_> = robot.joints.iter().map(|j| j.nominal.expect("nominal").inertial).collect();
    let some = |seed: usize, scale: f64| -> Vec<f64> {
        (0..n).map(|j| scale * ((1.7 * (seed + j) as f64 + k as f64).sin())).collect()
    };
    let mut tau = vec![0.0; n];
    inverse_dynamics(robot, &parameters, &some(0, 1.5), &some(3, 3.0), &some(5, 9.0), &mut tau);
    tau
}

fn assert_same_arm(a: &Robot, b: &Robot) {
    for k in 0..8 {
        let (ta, tb) = (torque(a, k), torque(b, k));
        let norm = ta.iter().map(|x| x * x).sum::<f64>().sqrt();
        for (x, y) in ta.iter().zip(&tb) {
            assert!((x - y).abs() < ROUNDING * norm, "{ta:?} {tb:?}");
        }
        let q: Vec<f64> = (0..a.joint_count()).map(|j| ((j + k) as f64).cos()).collect();
        let (pa, pb) = (forward_kinematics(a, &q), forward_kinematics(b, &q));
        assert!((pa.translation - pb.translation).norm() < ROUNDING, "{pa:?} {pb:?}");
        assert!((pa.rotation - pb.rotation).norm() < ROUNDING);
    }
    let (ba, bb) = (base_parameters(a).expect("a base"), base_parameters(b).expect("a base"));
    assert_eq!(
        (ba.inertial_rank, ba.inertial_and_motor_rank, ba.rank),
        (bb.inertial_rank, bb.inertial_and_motor_rank, bb.rank)
    );
}

fn mounted(gravity: [f64; 3]) -> Robot {
    let mut robot = er3a();
    robot.gravity = Vector3::from(gravity);
    robot.tool = Transform::from_xyz_rpy([0.1, 0.2, 0.3], [0.0, FRAC_PI_2 / 2.0, 0.0]);
    robot
}

#[test]
fn one_arm_in_three_conventions_has_one_torque_one_pose_and_one_rank() {
    for gravity in [[0.0, 0.0, -9.81], [0.0, 0.0, 9.81], [6.0, -7.0, 0.0]] {
        let modified = mounted(gravity);
        let standard = in_standard_dh(&modified);
        assert!(matches!(standard.joints[3].geometry.source(), GeometrySource::StandardDh(_)));
        assert_same_arm(&modified, &standard);
        let mut untooled = modified.clone();
        untooled.tool = Transform::IDENTITY;
        let urdf = read_urdf(&as_urdf(&modified, false), gravity);
        assert_same_arm(&untooled, &urdf);
    }
}

#[test]
fn a_sliding_joint_is_the_same_in_three_conventions() {
    let mut robot = er3a();
    robot.joints[2].kind = JointKind::Prismatic;
    assert_same_arm(&robot, &in_standard_dh(&robot));
    assert_same_arm(&robot, &read_urdf(&as_urdf(&robot, false), [0.0, 0.0, -9.81]));
}

#[test]
fn links_on_fixed_joints_are_one_with_the_link_that_carries_them() {
    let gravity = [0.0, 0.0, -9.81];
    let whole = read_urdf(&as_urdf(&er3a(), false), gravity);
    let split = read_urdf(&as_urdf(&er3a(), true), gravity);
    assert_same_arm(&whole, &split);
    for (a, b) in whole.joints.iter().zip(&split.joints) {
        let [a, b] = [a, b].map(|j: &Joint| j.nominal.expect("nominal").inertial.0);
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < ROUNDING), "{a:?} {b:?}");
    }
}

proptest! {
    // A case reads a file and factors a regressor of an arm with up to six joints twice.
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn any_arm_in_standard_dh_is_the_same_arm(
        rows in proptest::collection::vec((-0.5..0.5_f64, -3.0..3.0_f64, -0.5..0.5_f64, -3.0..3.0_f64), 1..5),
    ) {
        let mut robot = er3a();
        robot.excitation = None;
        robot.joints.truncate(rows.len());
        for (i, (joint, (a, alpha, d, theta_offset))) in robot.joints.iter_mut().zip(rows).enumerate() {
            let (a, alpha) = if i == 0 { (0.0, 0.0) } else { (a, alpha) };
            joint.geometry = JointGeometry::modified_dh(DhParameters { a, alpha, d, theta_offset });
        }
        let standard = in_standard_dh(&robot);
        for k in 0..4 {
            let (a, b) = (torque(&robot, k), torque(&standard, k));
            let norm = a.iter().map(|x| x * x).sum::<f64>().sqrt();
            prop_assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < ROUNDING * (1.0 + norm)));
        }
    }
}

const BRANCHED: &str = r#"<robot name="r">
  <link name="base"/><link name="arm"/>
  <link name="left"><inertial><mass value="0.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="right"/><link name="camera"/>
  <joint name="a" type="continuous"><parent link="base"/><child link="arm"/><limit velocity="2" effort="1"/></joint>
  <joint name="l" type="prismatic"><origin xyz="0 0.2 0"/><parent link="arm"/><child link="left"/><axis xyz="0 1 0"/><limit lower="0" upper="1" velocity="1"/></joint>
  <joint name="r" type="prismatic"><parent link="arm"/><child link="right"/><axis xyz="0 1 0"/><limit lower="0" upper="1" velocity="1"/><mimic joint="l"/></joint>
  <joint name="c" type="fixed"><parent link="arm"/><child link="camera"/></joint>
</robot>"#;

#[test]
fn a_tree_that_branches_needs_a_tip_and_the_rest_is_carried_at_rest() {
    let problem = read_chain(BRANCHED, None).expect_err("ambiguous");
    assert!(problem.contains("tip_link") && problem.contains("left, right, camera"), "{problem}");
    let chain = read_chain(BRANCHED, Some("camera")).expect("a chain");
    assert_eq!(chain.joints.len(), 1);
    assert_eq!(
        (chain.joints[0].position_min, chain.joints[0].position_max),
        (-std::f64::consts::TAU, std::f64::consts::TAU)
    );
    let carried = chain.joints[0].inertial.expect("the finger");
    // The axis is x by default, so that y of the URDF stays y turned about it; the finger is 0.2 m away.
    assert!(
        (carried.mass() - 0.5).abs() < ROUNDING && (carried.first_moment().norm() - 0.1).abs() < ROUNDING
    );
    assert_eq!(read_chain(BRANCHED, Some("left")).expect("a chain").joints.len(), 2);
    let problem = read_chain(BRANCHED, Some("right")).expect_err("a mimic");
    assert!(problem.contains("joint r mimics another"), "{problem}");
    let problem = read_chain(BRANCHED, Some("hand")).expect_err("no such link");
    assert!(problem.contains("has no link hand"), "{problem}");
}

#[test]
fn an_inertial_tag_that_cannot_be_right_is_ignored_with_a_remark() {
    for (from, to, said) in [
        ("ixx=\"1\"", "ixx=\"2.06\"", "no body has this inertia"),
        ("ixx=\"1\"", "ixx=\"9\"", "no body has this inertia"),
        ("mass value=\"0.5\"", "mass value=\"-0.5\"", "mass of -0.5 kg"),
    ] {
        let chain = read_chain(&BRANCHED.replace(from, to), Some("left")).expect("a chain");
        assert_eq!(chain.joints[1].inertial, None);
        let [remark] = &chain.remarks[..] else { panic!("{:?}", chain.remarks) };
        assert!(remark.contains("of link left is ignored") && remark.contains(said), "{remark}");
    }
    let without = BRANCHED.replace("mass value=\"0.5\"", "mass value=\"0\"");
    let chain = read_chain(&without, Some("left")).expect("a frame without mass");
    assert_eq!((chain.joints[1].inertial, chain.remarks), (None, Vec::new()));
}

#[test]
#[expect(clippy::approx_constant, reason = "as makers round it")]
fn rounded_right_angles_are_exact_and_reported() {
    let gravity = [0.0, 0.0, -9.81];
    let text = |turn: f64| {
        format!(
            r#"<robot name="r"><link name="base"/><link name="a"/><link name="b"/><link name="tip"/>
            <joint name="one" type="revolute"><origin rpy="0 0 3.14159"/><parent link="base"/><child link="a"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
            <joint name="two" type="revolute"><origin xyz="0.1 0 0.3" rpy="{turn} 0 0"/><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
            <joint name="three" type="revolute"><origin xyz="0.3 0 0" rpy="0 0 -1.5708"/><parent link="b"/><child link="tip"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint>
            </robot>"#
        )
    };
    let [exact, near, far] = [FRAC_PI_2, 1.5708, 1.5718].map(|turn| read_urdf(&text(turn), gravity));
    let [remark] = &near.remarks[..] else { panic!("{:?}", near.remarks) };
    assert!(remark.contains("joints one, two, three"), "{remark}");
    assert!(!far.remarks.concat().contains("two"), "a thousandth is meant: {:?}", far.remarks);
    let base = |robot: &Robot| base_parameters(robot).expect("a base");
    assert_eq!(base(&near).kept, base(&exact).kept);
    assert!(
        (base(&near).scaled_condition_number / base(&exact).scaled_condition_number - 1.0).abs() < ROUNDING
    );
}

#[test]
fn what_is_no_chain_is_refused_in_words() {
    let with = |from: &str, to: &str| {
        let text = BRANCHED.replace(from, to);
        assert_ne!(text, BRANCHED);
        read_chain(&text, Some("left")).expect_err("a refusal")
    };
    assert!(with("name=\"a\" type=\"continuous\"", "name=\"a\" type=\"floating\"").contains("is floating"));
    assert!(with("name=\"a\" type=\"continuous\"", "name=\"a\" type=\"planar\"").contains("is planar"));
    assert!(
        with(
            "<axis xyz=\"0 1 0\"/><limit lower=\"0\" upper=\"1\" velocity=\"1\"/></joint>",
            "<axis xyz=\"0 0 0\"/><limit velocity=\"1\"/></joint>"
        )
        .contains("no direction")
    );
    assert!(with("<child link=\"camera\"/>", "<child link=\"left\"/>").contains("two joints"));
    assert!(with("<child link=\"camera\"/>", "<child link=\"lens\"/>").contains("names the missing link"));
    assert!(
        with("<link name=\"camera\"/>", "<link name=\"camera\"/><link name=\"world\"/>")
            .contains("two bases")
    );
    assert!(
        with("<parent link=\"base\"/>", "<parent link=\"left\"/>").contains("is not connected to the base"),
        "a ring"
    );
    assert!(read_chain("<robot", None).expect_err("cut").contains("is not a URDF file"));
    assert!(
        read_chain("<robot name=\"r\"><link name=\"l\"/></robot>", None)
            .expect_err("still")
            .contains("no joint moves")
    );
}

#[test]
fn a_description_adds_to_the_joints_of_a_urdf_file_by_name() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/configs/robots/");
    let text = std::fs::read_to_string(format!("{folder}urdf.toml")).expect("the fixture");
    let robot = parse_robot(&format!("{folder}urdf.toml"), &text).unwrap_or_else(|errors| panic!("{errors}"));
    let [shoulder, elbow] = &robot.joints[..] else { panic!("two joints") };
    assert_eq!((shoulder.name.as_deref(), elbow.name.as_deref()), (Some("shoulder"), Some("elbow")));
    assert_eq!((shoulder.gear_ratio, elbow.gear_ratio, robot.transmission[(1, 1)]), (1.0, -80.0, -80.0));
    // From rest to 3 rad/s in half a second, because the file gives no acceleration.
    assert_eq!((shoulder.limits.acceleration, elbow.limits.acceleration), (6.0, 10.0));
    let nominal = shoulder.nominal.expect("nominal");
    assert_eq!((nominal.friction, nominal.motor_inertia), ([2.0, 4.0, 0.0, 0.0], 0.0));
    let nominal = elbow.nominal.expect("nominal");
    assert_eq!((nominal.motor_inertia, nominal.torque_noise, nominal.warm_up.b), (0.2, 0.4, 0.3));
    let flange = forward_kinematics(&robot, &[0.0, 0.0]);
    assert!((flange.translation - Vector3::new(0.7, 0.0, 0.3)).norm() < ROUNDING);
    assert!((flange.rotation - Matrix3::identity()).norm() < ROUNDING);
    // A positive turn about y lowers a point on the x axis.
    let lowered = forward_kinematics(&robot, &[FRAC_PI_2, 0.0]).translation;
    assert!((lowered - Vector3::new(0.0, 0.0, 0.3 - 0.7)).norm() < ROUNDING, "{lowered}");
}
