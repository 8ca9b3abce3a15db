//! Comment at the head of generated code: model, origin of its numbers, symbols, units, signs, equations.

use super::expression::{Function, Node};
use super::listing::wrapped;
use super::origin::{CodeOrigin, GENERATED_BY};
use super::torque::TorquePrograms;
use armwatch_model::robot::{JointIndex, JointKind, Robot, SpringForm, TorqueSensors};

/// Longest line.
const WIDTH: usize = 100;

/// Operations of a call.
pub(super) struct Cost {
    /// Sums, differences, products and quotients.
    pub(super) operations: usize,
    /// Sines and cosines.
    pub(super) sines_and_cosines: usize,
}

/// Counts the operations for the torque of a state, including friction.
pub(super) fn cost(programs: &TorquePrograms) -> Cost {
    let mut cost = Cost { operations: 0, sines_and_cosines: 0 };
    for program in [&programs.torque, &programs.friction] {
        let needed = program.graph.needed(&program.outputs);
        for (node, _) in program.graph.nodes().iter().zip(&needed).filter(|(_, needed)| **needed) {
            match node {
                Node::Add(..) | Node::Subtract(..) | Node::Multiply(..) | Node::Divide(..) => {
                    cost.operations += 1;
                }
                Node::Call(Function::Sine | Function::Cosine, _) => cost.sines_and_cosines += 1,
                _ => {}
            }
        }
    }
    cost
}

/// Lines of the comment at the head of a source; the first names the generator.
pub(super) fn lines(robot: &Robot, programs: &TorquePrograms, origin: &CodeOrigin) -> Vec<String> {
    let mut lines = vec![
        format!("{GENERATED_BY} of {}; edits are lost when it is generated again.", origin.program),
        String::new(),
    ];
    let mut add = |text: &str| lines.extend(indented(text));
    add(&format!(
        "Torque that a motion of the arm \"{}\" takes, for feed-forward and simulation:",
        robot.model
    ));
    add("");
    add("    tau = torque(q, qd, qdd) = M(q) qdd + c(q, qd) qd + g(q) + friction(qd)");
    add("");
    origin.parameters.iter().for_each(|line| add(line));
    add("");
    add("Friction");
    origin.friction.iter().for_each(|line| add(&format!("  {line}")));
    for (formula, joints) in friction_laws(robot) {
        add(&format!("  {joints}: {formula}, v = qd"));
    }
    for coupling in &robot.couplings {
        add(&format!(
            "  motor {m} turns with joint {j} too: friction of speed s = {:?} qd{j} + qd{m}",
            coupling.ratio,
            j = coupling.joint,
            m = coupling.motor_joint
        ));
    }
    for spring in &robot.springs {
        add(&match spring.form {
            SpringForm::Direct => format!("  joint {} has a spring: k_s q + t_s", spring.joint),
            SpringForm::Cylinder { pins: [a, b], aligned } => format!(
                "  joint {} has a counterbalance of length l between pins at {a:?} m and {b:?} m, shortest (l0) at q = \
                 {aligned:?} rad: pull t_c + k_c (l - l0)",
                spring.joint
            ),
        });
    }
    for of in &robot.parallelograms {
        add(&format!(
            "  a crank turns about the axis of joint {} and moves joint {}: a body of its own",
            of.upper_arm, of.forearm
        ));
    }
    add(
        "  sign(0) = 0: a joint at rest has no friction here; give the speed of the planned motion, not the measured one",
    );
    add("");
    symbols(robot).iter().for_each(|line| add(line));
    add("");
    EQUATIONS.lines().for_each(&mut add);
    add("");
    let cost = cost(programs);
    add(&format!(
        "Products with zeros are left out and equal parts are computed once: {} sums and products, {} sines and \
         cosines. In the code w2x is w of link 2 along x, and so on; u = [dw] + [w][w]; f and n are force and moment of a \
         link with all that it carries; s and c are sine and cosine of q; a name that ends in _neg holds the negative.",
        cost.operations, cost.sines_and_cosines
    ));
    lines
}

const EQUATIONS: &str = "\
Equations: recursive Newton-Euler in link frames. Frame i lies on joint i with z along its axis
and moves with link i; R and p are its rotation and origin in the frame before.
  w_i  = R' w_(i-1) + z qd_i
  dw_i = R' dw_(i-1) + (R' w_(i-1)) x z qd_i + z qdd_i
  a_i  = R' (a_(i-1) + dw_(i-1) x p + w_(i-1) x (w_(i-1) x p)),  a_0 = -gravity
  f_i  = m a_i + dw_i x mP + w_i x (w_i x mP) + R f_(i+1)
  n_i  = I dw_i + w_i x I w_i + mP x a_i + R n_(i+1) + p x R f_(i+1),  R and p of joint i+1
  tau_i = z n_i + I_m qdd_i + friction_i
Of a joint that slides w_i and dw_i are only turned, a_i has 2 (R' w_(i-1)) x z qd_i + z qdd_i
beside, p grows along z by q_i, and tau_i = z f_i + I_m qdd_i + friction_i. A motor that turns c
times as far with another joint adds c Iam qdd of each joint to the torque of the other one.

Constants: Jn_M mass of link n, Jn_MPX.. first moment mP and Jn_IXX.. inertia I about the origin
of its frame, Jn_I_M motor inertia seen at joint n, Jn_F1.. and Jn_FS.. friction; Pn and Rn place
and rotation of joint n at position 0. Those that are missing are 0, or +-1.";

fn symbols(robot: &Robot) -> Vec<String> {
    let sliding: Vec<JointIndex> = robot
        .joint_indices()
        .filter(|joint| robot.joints[joint.index()].kind == JointKind::Prismatic)
        .collect();
    let slides = match sliding.is_empty() {
        true => String::new(),
        false => format!("; where a joint slides ({}): m, m/s, m/s^2, N", listed(&sliding)),
    };
    let offset = |joint: JointIndex| {
        let offset = robot.joints[joint.index()].position_offset;
        (offset != 0.0).then(|| format!("joint {joint} {offset:?}"))
    };
    let offsets: Vec<String> = robot.joint_indices().filter_map(offset).collect();
    let offsets = match offsets.is_empty() {
        true => "as recorded".to_owned(),
        false => format!("the recorded position plus an offset ({})", offsets.join(", ")),
    };
    let torque = match robot.torque_sensors {
        TorqueSensors::Motor => "of the motors at the joints, with what their inertia takes",
        TorqueSensors::Link => "behind the gears, without motor inertia",
    };
    let g = robot.gravity;
    vec![
        format!("Symbols, SI units, joints from the base outwards{slides}"),
        format!("  q    position, rad: {offsets}"),
        "  qd   speed, rad/s".to_owned(),
        "  qdd  acceleration, rad/s^2".to_owned(),
        format!("  tau  torque, Nm: {torque}; positive where it drives q upwards"),
        format!("  gravity in the base frame: {:?} {:?} {:?} m/s^2", g.x, g.y, g.z),
    ]
}

/// Formulas of friction, each with its joints.
fn friction_laws(robot: &Robot) -> Vec<(String, String)> {
    let mut laws: Vec<(String, Vec<JointIndex>)> = Vec::new();
    for joint in robot.joint_indices() {
        let formula = robot.friction_of(joint).formula();
        match laws.iter_mut().find(|(known, _)| *known == formula) {
            Some((_, joints)) => joints.push(joint),
            None => laws.push((formula, vec![joint])),
        }
    }
    let of = |joints: &[JointIndex]| match joints {
        [joint] => format!("joint {joint}"),
        _ if joints.len() == robot.joint_count() => "all joints".to_owned(),
        _ => format!("joints {}", listed(joints)),
    };
    laws.into_iter().map(|(formula, joints)| (formula, of(&joints))).collect()
}

fn listed(joints: &[JointIndex]) -> String {
    joints.iter().map(JointIndex::to_string).collect::<Vec<_>>().join(", ")
}

/// Text in lines of at most [`WIDTH`], with two blanks more before those after the first.
fn indented(text: &str) -> Vec<String> {
    let blanks = text.len() - text.trim_start().len();
    let width = WIDTH.saturating_sub(blanks + 2);
    let lines = wrapped(text.trim_start(), width);
    let indent = |(k, line): (usize, String)| match line.is_empty() {
        true => line,
        false => format!("{:1$}{line}", "", if k == 0 || blanks == 0 { blanks } else { blanks + 2 }),
    };
    lines.into_iter().enumerate().map(indent).collect()
}
