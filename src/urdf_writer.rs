//! Writes an arm with its bodies as a URDF file.
//!
//! The position of each joint in the file is the `q` of this program. Offsets of Denavit-Hartenberg tables are in the
//! origins of the joints, and limits are limits of `q`. Link frames are the joints' own frames with the axis along z.
//! An arm from a URDF file keeps the frames of that file.

use std::fmt::Write;

use nalgebra::{Matrix3, Vector3};

use armwatch_method::model::base_parameters::probe_state;
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_model::robot::{
    FrictionModel, GeometrySource, Joint, JointIndex, JointKind, Robot, StandardParameters, Transform,
};
use armwatch_model::text;

/// Number of states inside the limits that are searched for the largest torque of a joint.
const EFFORT_STATES: usize = 256;
/// Number of speeds per direction to which the line of damping and friction is fitted.
const FRICTION_SPEEDS: usize = 50;

/// Damping and friction of a joint in a simulator: a straight line that approximates its friction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StraightFriction {
    /// Viscous friction, Nm s/rad (N s/m).
    pub damping: f64,
    /// Coulomb friction, Nm (N).
    pub friction: f64,
}

/// The URDF file of an arm: joints, bodies, friction as far as URDF can express it, transmissions, and `comments` at
/// its head. Numbers have all their digits, so that reading the file gives the same arm.
///
/// Links are `base_link`, `link_1`.. and `tool`. Joints have their own names, or `joint_1`... Comments contain the
/// properties that URDF cannot express: gravity, rotor inertia, coupled motors, and friction that is not a straight
/// line.
pub fn urdf_text(robot: &Robot, model: &DynamicModel, comments: &[String]) -> String {
    let names = joint_names(robot);
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    for comment in comments.iter().chain(&notes(robot)) {
        line(&mut text, &format!("<!-- {} -->", for_comment(comment)));
    }
    line(&mut text, &format!("<robot name=\"{}\">", escaped(&robot.model)));
    line(&mut text, "  <link name=\"base_link\"/>");
    let efforts = largest_torques(robot, model);
    let mut before = Transform::IDENTITY;
    for (j, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let turn = turn_to_own_frame(j);
        let place = before.then(j.geometry.placement()).then(&turn.inverse());
        let friction = straight_friction(robot, model, index);
        write_joint(&mut text, j, index, &names[index.index()], &place, friction, efforts[index.index()]);
        write_link(&mut text, index, &model.inertial[index.index()].seen_from(&turn));
        before = turn;
    }
    write_tool(&mut text, robot.joint_count(), &before.then(&robot.tool));
    for index in robot.joint_indices() {
        write_transmission(&mut text, robot, model, index, &names[index.index()]);
    }
    line(&mut text, "</robot>");
    text
}

/// The straight line `friction sign(v) + damping v` that is closest to a joint's friction at evenly spaced speeds up to
/// its largest, for both directions together. Neither part is negative.
///
/// The line is exact for Coulomb and viscous friction that is equal in both directions. URDF cannot express an offset,
/// a difference between the directions, or the curvature of the friction.
pub fn straight_friction(robot: &Robot, model: &DynamicModel, joint: JointIndex) -> StraightFriction {
    let f = &model.friction[joint.index()];
    let point = |v: f64| {
        let [ahead, back] = [v, -v].map(|v| robot.friction_of(joint).torque(f, v));
        (v, 0.5 * (ahead - back))
    };
    let sums = friction_speeds(robot, joint)
        .map(point)
        .fold([0.0; 4], |[v1, v2, f, vf], (v, torque)| [v1 + v, v2 + v * v, f + torque, vf + v * torque]);
    let ([v1, v2, f, vf], n) = (sums, FRICTION_SPEEDS as f64);
    let damping = (n * vf - v1 * f) / (n * v2 - v1 * v1);
    let friction = (f - damping * v1) / n;
    match (damping >= 0.0, friction >= 0.0) {
        (true, true) => StraightFriction { damping, friction },
        (false, _) => StraightFriction { damping: 0.0, friction: (f / n).max(0.0) },
        (true, false) => StraightFriction { damping: (vf / v2).max(0.0), friction: 0.0 },
    }
}

/// Speeds of one direction at which the line is fitted to a joint's friction, rad/s (m/s).
fn friction_speeds(robot: &Robot, joint: JointIndex) -> impl Iterator<Item = f64> {
    let limit = robot.joints[joint.index()].limits.velocity;
    (1..=FRICTION_SPEEDS).map(move |k| limit * k as f64 / FRICTION_SPEEDS as f64)
}

/// Names of the joints. They are numbered if a name of the description is missing or occurs twice.
fn joint_names(robot: &Robot) -> Vec<String> {
    let numbered = || robot.joint_indices().map(|j| format!("joint_{j}")).collect::<Vec<String>>();
    let given: Option<Vec<String>> = robot.joints.iter().map(|joint| joint.name.clone()).collect();
    let different = |names: &Vec<String>| {
        let mut sorted: Vec<&String> = names.iter().collect();
        sorted.sort();
        sorted.windows(2).all(|pair| pair[0] != pair[1])
    };
    given.filter(different).unwrap_or_else(numbered)
}

/// Rotation from a joint's own frame, with z along the axis, to the frame in the file.
fn turn_to_own_frame(joint: &Joint) -> Transform {
    match joint.geometry.source() {
        GeometrySource::Urdf(_) => Transform::z_to(&written_axis(joint)),
        GeometrySource::ModifiedDh(_) | GeometrySource::StandardDh(_) => Transform::IDENTITY,
    }
}

fn written_axis(joint: &Joint) -> Vector3<f64> {
    match joint.geometry.source() {
        GeometrySource::Urdf(origin) => {
            let axis = Vector3::from(origin.axis);
            axis / axis.norm()
        }
        GeometrySource::ModifiedDh(_) | GeometrySource::StandardDh(_) => Vector3::z(),
    }
}

/// Facts about the whole file for which URDF has no tag.
fn notes(robot: &Robot) -> Vec<String> {
    let g = robot.gravity;
    let mut notes = vec![
        format!("gravity in the frame of base_link, m/s^2: {:?} {:?} {:?}", g.x, g.y, g.z),
        "the position of a joint is q: the recorded position plus its position offset; offsets of a \
         Denavit-Hartenberg table are in the origins"
            .to_owned(),
    ];
    let mut models: Vec<FrictionModel> =
        robot.joint_indices().map(|joint| robot.friction_of(joint)).collect();
    models.dedup();
    let mut laws: Vec<&str> = models.iter().map(FrictionModel::beside_a_line).collect();
    laws.dedup();
    notes.extend(laws.into_iter().map(|law| format!("friction was identified as {law}")));
    for coupling in &robot.couplings {
        notes.push(format!(
            "the motor of joint {} also turns with joint {}, {:?} per own turn: the file has no place for that",
            coupling.motor_joint, coupling.joint, coupling.ratio
        ));
    }
    notes.extend(robot.springs.iter().map(|spring| {
        format!("joint {} has a spring or counterbalance: URDF has no place for that", spring.joint)
    }));
    notes.extend(
        robot.parallelograms.iter().map(|of| {
            format!("a parallelogram moves joint {}: its crank is no link of this file", of.forearm)
        }),
    );
    notes
}

fn write_joint(
    text: &mut String,
    joint: &Joint,
    index: JointIndex,
    name: &str,
    place: &Transform,
    friction: StraightFriction,
    largest_torque: f64,
) {
    let kind = match joint.kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    };
    let parent = match index.index() {
        0 => "base_link".to_owned(),
        before => format!("link_{before}"),
    };
    let (axis, limits) = (written_axis(joint), joint.limits);
    let effort = Effort::of(joint, largest_torque);
    line(text, &format!("  <joint name=\"{}\" type=\"{kind}\">", escaped(name)));
    line(text, &format!("    {}", origin_tag(place)));
    line(text, &format!("    <parent link=\"{parent}\"/>"));
    line(text, &format!("    <child link=\"link_{index}\"/>"));
    line(text, &format!("    <axis xyz=\"{}\"/>", listed(&axis)));
    if joint.position_offset != 0.0 {
        line(text, &format!("    <!-- q is the recorded position plus {:?} -->", joint.position_offset));
    }
    line(text, &format!("    <!-- effort: {} -->", effort.origin));
    line(
        text,
        &format!(
            "    <limit lower=\"{:?}\" upper=\"{:?}\" effort=\"{:?}\" velocity=\"{:?}\"/>",
            limits.position_min, limits.position_max, effort.value, limits.velocity
        ),
    );
    line(
        text,
        &format!("    <dynamics damping=\"{:?}\" friction=\"{:?}\"/>", friction.damping, friction.friction),
    );
    line(text, "  </joint>");
}

/// Largest torque (force) of a joint in the file.
struct Effort {
    /// Nm (N).
    value: f64,
    /// Its origin, for a comment.
    origin: &'static str,
}

impl Effort {
    /// The described limit for a moment, else for continuous duty, else the largest torque of the model.
    fn of(joint: &Joint, largest_torque: f64) -> Self {
        let through_gear = |motor: f64| (motor * joint.gear_ratio).abs();
        let described = [
            (joint.peak_torque, "peak torque of the joint, allowed for a moment"),
            (
                joint.rated_torque,
                "rated torque of the joint, allowed continuously; no peak torque is described",
            ),
            (
                joint.rated_motor_torque.map(through_gear),
                "rated torque of the motor times the gear ratio, allowed continuously; no peak torque is described",
            ),
        ];
        let described =
            described.into_iter().find_map(|(value, origin)| Some(Self { value: value?, origin }));
        described.unwrap_or(Self {
            value: largest_torque,
            origin: "largest torque of the model inside the limits; no rating is described",
        })
    }
}

fn write_link(text: &mut String, index: JointIndex, body: &StandardParameters) {
    let i = body.inertia_about_centre();
    let centre = Transform { translation: body.centre_of_mass(), ..Transform::IDENTITY };
    line(text, &format!("  <link name=\"link_{index}\">"));
    line(text, "    <inertial>");
    line(text, &format!("      {}", origin_tag(&centre)));
    line(text, &format!("      <mass value=\"{:?}\"/>", body.mass()));
    line(
        text,
        &format!(
            "      <inertia ixx=\"{:?}\" ixy=\"{:?}\" ixz=\"{:?}\" iyy=\"{:?}\" iyz=\"{:?}\" izz=\"{:?}\"/>",
            i.m11, i.m12, i.m13, i.m22, i.m23, i.m33
        ),
    );
    line(text, "    </inertial>");
    line(text, "  </link>");
}

fn write_tool(text: &mut String, joints: usize, place: &Transform) {
    line(text, "  <joint name=\"tool_mount\" type=\"fixed\">");
    line(text, &format!("    {}", origin_tag(place)));
    line(text, &format!("    <parent link=\"link_{joints}\"/>"));
    line(text, "    <child link=\"tool\"/>");
    line(text, "  </joint>");
    line(text, "  <link name=\"tool\"/>");
}

fn write_transmission(text: &mut String, robot: &Robot, model: &DynamicModel, index: JointIndex, name: &str) {
    let joint = &robot.joints[index.index()];
    let unit = match joint.kind {
        JointKind::Revolute => "kg m^2",
        JointKind::Prismatic => "kg",
    };
    line(text, &format!("  <transmission name=\"transmission_{index}\">"));
    line(text, "    <type>transmission_interface/SimpleTransmission</type>");
    line(text, &format!("    <joint name=\"{}\">", escaped(name)));
    line(text, "      <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface>");
    line(text, "    </joint>");
    line(text, &format!("    <actuator name=\"motor_{index}\">"));
    line(text, &format!("      <mechanicalReduction>{:?}</mechanicalReduction>", joint.gear_ratio));
    let inertia = model.motor_inertia[index.index()];
    line(
        text,
        &format!(
            "      <!-- rotor inertia seen at the joint (armature): {inertia:?} {unit}; not in any inertial tag -->"
        ),
    );
    line(text, "    </actuator>");
    line(text, "  </transmission>");
}

/// Largest torque of each joint over states inside the limits, Nm (N).
fn largest_torques(robot: &Robot, model: &DynamicModel) -> Vec<f64> {
    let mut largest = vec![0.0_f64; robot.joint_count()];
    let mut tau = largest.clone();
    for index in 0..EFFORT_STATES {
        let state = probe_state(robot, index);
        model.torque(robot, &state.q, &state.qd, &state.qdd, &mut tau);
        largest.iter_mut().zip(&tau).for_each(|(largest, tau)| *largest = largest.max(tau.abs()));
    }
    largest
}

fn origin_tag(pose: &Transform) -> String {
    format!(
        "<origin xyz=\"{}\" rpy=\"{}\"/>",
        listed(&pose.translation),
        listed(&roll_pitch_yaw(&pose.rotation))
    )
}

fn listed(v: &Vector3<f64>) -> String {
    // Adding zero makes a negative zero positive.
    format!("{:?} {:?} {:?}", v.x + 0.0, v.y + 0.0, v.z + 0.0)
}

/// Roll, pitch and yaw of `Rz(yaw) Ry(pitch) Rx(roll)`, rad.
///
/// Pitch and roll are computed after the yaw is removed. At a pitch of a right angle, the roll thus compensates a yaw
/// that comes from rounding.
fn roll_pitch_yaw(r: &Matrix3<f64>) -> Vector3<f64> {
    let yaw = r.m21.atan2(r.m11);
    let (s, c) = yaw.sin_cos();
    let pitch = (-r.m31).atan2(c * r.m11 + s * r.m21);
    let roll = (s * r.m13 - c * r.m23).atan2(c * r.m22 - s * r.m12);
    Vector3::new(roll, pitch, yaw)
}

fn line(text: &mut String, content: &str) {
    // Writing to a string cannot fail.
    let _ = writeln!(text, "{content}");
}

/// A name as an attribute. XML does not allow most hidden characters.
fn escaped(name: &str) -> String {
    text::xml(&text::distinct(name))
}

/// Text for a comment on one line. Two hyphens would end the comment.
fn for_comment(text: &str) -> String {
    text::shown(text).replace("--", "- -").replace("--", "- -").trim_end_matches('-').to_owned()
}

pub mod mjcf;
#[cfg(test)]
mod tests;
