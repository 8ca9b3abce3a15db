//! An arm with its bodies as a MuJoCo file (MJCF).
//!
//! Frames, names and positions of joints are those of the URDF file. MuJoCo has a place for rotor inertia (`armature`) and for
//! gravity, and the same straight line for friction (`damping` and `frictionloss`).

use nalgebra::{Rotation3, UnitQuaternion};

use super::{
    StraightFriction, escaped, for_comment, friction_speeds, joint_names, line, listed, notes,
    straight_friction, turn_to_own_frame, written_axis,
};
use armwatch_method::model::dynamics::DynamicModel;
use armwatch_model::robot::{JointIndex, JointKind, Robot, StandardParameters, Transform};

/// MuJoCo makes dry friction a soft constraint. Its usual softness lets a joint slide at less than its friction; this is the
/// stiffest that it takes, over two of its usual steps of time.
const STIFF_FRICTION: &str = "solreffriction=\"0.004 1\" solimpfriction=\"0.9999 0.9999 0.001 0.5 2\"";

/// Friction of a joint as MuJoCo has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MjcfFriction {
    /// `damping` and `frictionloss`.
    pub line: StraightFriction,
    /// Largest difference between the friction of the model and the line, over both directions and all speeds up to the
    /// largest, Nm (N).
    pub largest_difference: f64,
}

/// Friction of a joint, `factor` times that of the model. An offset of the torque is no friction: it is not multiplied, and
/// a part of the difference.
pub fn mjcf_friction(robot: &Robot, model: &DynamicModel, joint: JointIndex, factor: f64) -> MjcfFriction {
    let StraightFriction { damping, friction } = straight_friction(robot, model, joint);
    let line = StraightFriction { damping: factor * damping, friction: factor * friction };
    let (law, f) = (robot.friction_of(joint), &model.friction[joint.index()]);
    let offset = law.torque(f, 0.0);
    let difference = |v: f64| {
        let of_model = offset + factor * (law.torque(f, v) - offset);
        (of_model - line.friction * v.signum() - line.damping * v).abs()
    };
    let speeds = friction_speeds(robot, joint).flat_map(|v| [v, -v]);
    MjcfFriction { line, largest_difference: speeds.map(difference).fold(0.0, f64::max) }
}

/// The MuJoCo file of an arm with the friction `[n]` of its joints, and `comments` at its head. Numbers have all their
/// digits.
pub fn mjcf_text(
    robot: &Robot,
    model: &DynamicModel,
    friction: &[MjcfFriction],
    comments: &[String],
) -> String {
    let names = joint_names(robot);
    let mut text = String::from("<?xml version=\"1.0\"?>\n");
    let comments =
        comments.iter().chain(&notes(robot)).map(|comment| for_comment(comment)).collect::<Vec<_>>();
    line(&mut text, &format!("<mujoco model=\"{}\">", escaped(&robot.model)));
    comments.iter().for_each(|comment| line(&mut text, &format!("  <!-- {comment} -->")));
    line(&mut text, "  <compiler angle=\"radian\" autolimits=\"true\"/>");
    line(&mut text, &format!("  <option gravity=\"{}\"/>", listed(&robot.gravity)));
    line(&mut text, &format!("  <default><joint {STIFF_FRICTION}/></default>"));
    line(&mut text, "  <worldbody>");
    let mut before = Transform::IDENTITY;
    for (index, friction) in robot.joint_indices().zip(friction) {
        let joint = &robot.joints[index.index()];
        let turn = turn_to_own_frame(joint);
        let place = before.then(joint.geometry.placement()).then(&turn.inverse());
        let indent = "  ".repeat(index.index() + 2);
        line(&mut text, &format!("{indent}<body name=\"link_{index}\" {}>", pose(&place)));
        line(&mut text, &format!("{indent}  {}", inertial(&model.inertial[index.index()].seen_from(&turn))));
        if joint.position_offset != 0.0 {
            let offset = joint.position_offset;
            line(&mut text, &format!("{indent}  <!-- q is the recorded position plus {offset:?} -->"));
        }
        let kind = match joint.kind {
            JointKind::Revolute => "hinge",
            JointKind::Prismatic => "slide",
        };
        let (armature, StraightFriction { damping, friction }) =
            (model.motor_inertia[index.index()], friction.line);
        line(
            &mut text,
            &format!(
                "{indent}  <joint name=\"{}\" type=\"{kind}\" axis=\"{}\" range=\"{:?} {:?}\" armature=\"{armature:?}\" \
                 damping=\"{damping:?}\" frictionloss=\"{friction:?}\"/>",
                escaped(&names[index.index()]),
                listed(&written_axis(joint)),
                joint.limits.position_min,
                joint.limits.position_max,
            ),
        );
        before = turn;
    }
    let indent = "  ".repeat(robot.joint_count() + 2);
    line(&mut text, &format!("{indent}<site name=\"tool\" {}/>", pose(&before.then(&robot.tool))));
    (0..robot.joint_count())
        .rev()
        .for_each(|depth| line(&mut text, &format!("{}</body>", "  ".repeat(depth + 2))));
    line(&mut text, "  </worldbody>");
    line(&mut text, "</mujoco>");
    text
}

fn pose(place: &Transform) -> String {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(place.rotation));
    let q = turn.quaternion();
    format!("pos=\"{}\" quat=\"{:?} {:?} {:?} {:?}\"", listed(&place.translation), q.w, q.i, q.j, q.k)
}

fn inertial(body: &StandardParameters) -> String {
    let i = body.inertia_about_centre();
    format!(
        "<inertial pos=\"{}\" mass=\"{:?}\" fullinertia=\"{:?} {:?} {:?} {:?} {:?} {:?}\"/>",
        listed(&body.centre_of_mass()),
        body.mass(),
        i.m11,
        i.m22,
        i.m33,
        i.m12,
        i.m13,
        i.m23
    )
}
