//! Text output of the check of a robot description.

use std::fmt;

use super::base_parameters::BaseParameters;
use super::robot_check::{IdentityCheck, RobotCheck};
use armwatch_model::robot::{
    GeometrySource, JointKind, ParameterId, Robot, SpringForm, StandardParameters, TorqueSensors, Transform,
};

impl fmt::Display for RobotCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write_geometry(f, &self.robot)?;
        write_conventions(f, &self.robot)?;
        write_limits(f, &self.robot)?;
        write_drives(f, &self.robot)?;
        write_pose(f, &self.pose_at_zero)?;
        write_identities(f, &self.identities)?;
        write_base(f, &self.robot, &self.base)
    }
}

fn write_geometry(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    let g = robot.gravity;
    writeln!(f, "Robot {}, {} joints", robot.model, robot.joint_count())?;
    writeln!(f, "Gravity in the base frame: ({}, {}, {}) m/s^2\n", short(g.x), short(g.y), short(g.z))?;
    let Some(first) = robot.joints.first() else { return Ok(()) };
    match first.geometry.source() {
        GeometrySource::ModifiedDh(_) => {
            writeln!(f, "Geometry, modified Denavit-Hartenberg: T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)")?;
            write_dh(f, robot)
        }
        GeometrySource::StandardDh(_) => {
            writeln!(f, "Geometry, standard Denavit-Hartenberg: T(i-1,i) = Rz(theta) Dz(d) Dx(a) Rx(alpha)")?;
            write_dh(f, robot)
        }
        GeometrySource::Urdf(_) => {
            writeln!(
                f,
                "Geometry, URDF: origin in the parent link's frame; fixed joints between are merged"
            )?;
            write_urdf(f, robot)
        }
    }
}

fn write_dh(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    writeln!(
        f,
        "{:>5}  {:<9} {:>10} {:>11} {:>10} {:>18}",
        "joint", "kind", "a [m]", "alpha [deg]", "d [m]", "theta offset [deg]"
    )?;
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let Some(row) = joint.geometry.dh_row() else { continue };
        writeln!(
            f,
            "{:>5}  {:<9} {:>10} {:>11} {:>10} {:>18}",
            index.number(),
            kind_name(joint.kind),
            short(row.a),
            short(row.alpha.to_degrees()),
            short(row.d),
            short(row.theta_offset.to_degrees()),
        )?;
    }
    Ok(())
}

fn write_urdf(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    writeln!(
        f,
        "{:>5}  {:<9} {:<28} {:<28} {:<20} name",
        "joint", "kind", "origin xyz [m]", "rpy [deg]", "axis"
    )?;
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let GeometrySource::Urdf(origin) = joint.geometry.source() else { continue };
        let list = |v: [f64; 3]| v.map(short).join(" ");
        writeln!(
            f,
            "{:>5}  {:<9} {:<28} {:<28} {:<20} {}",
            index.number(),
            kind_name(joint.kind),
            list(origin.xyz),
            list(origin.rpy.map(f64::to_degrees)),
            list(origin.axis),
            joint.name.as_deref().unwrap_or_default(),
        )?;
    }
    Ok(())
}

/// Writes the conventions, because other packages give three different answers for one arm.
fn write_conventions(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    writeln!(f, "\nConventions")?;
    let near = match robot.joints.first().map(|joint| joint.geometry.source()) {
        Some(GeometrySource::StandardDh(_)) => {
            "the description's frame i is at the far end of link i; parameters are about the joint's own frame\n  \
             at the near end: origin that of frame i-1, z along z(i-1), x along that of frame i"
        }
        Some(GeometrySource::Urdf(_)) => {
            "the joint's URDF frame, at the near end of its link, turned by the smallest rotation that takes z to\n  \
             the axis"
        }
        _ => "frame i lies on axis i, at the near end of link i, z along the axis",
    };
    writeln!(f, "  {near}; it moves with the link")?;
    writeln!(
        f,
        "  ten parameters of a link in the order {}: mass, first moment m c, inertia",
        StandardParameters::NAMES.join(" ")
    )?;
    writeln!(
        f,
        "  about the frame's ORIGIN, not the centre of mass; Ixy, Ixz, Iyz are matrix entries (negative products)"
    )?;
    write_friction(f, robot)
}

fn write_friction(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    let motor = match robot.torque_sensors {
        TorqueSensors::Motor => "motor inertia seen at the joint: I_m a",
        TorqueSensors::Link => "torque is measured behind the gears, without motor inertia",
    };
    writeln!(f, "  friction of a joint: {}; {motor}", robot.friction.formula())?;
    for joint in robot.joint_indices() {
        let model = robot.friction_of(joint);
        if model != robot.friction {
            writeln!(f, "  friction of joint {joint}: {}", model.formula())?;
        }
    }
    for coupling in &robot.couplings {
        writeln!(
            f,
            "  the motor of joint {} also turns with joint {} ({} per own turn): Iam, fvm, fsm of J{}",
            coupling.motor_joint,
            coupling.joint,
            short(coupling.ratio),
            coupling.motor_joint
        )?;
    }
    for spring in &robot.springs {
        let joint = spring.joint;
        match spring.form {
            SpringForm::Direct => writeln!(f, "  joint {joint} has a spring: k_s q + t_s")?,
            SpringForm::Cylinder { pins: [a, b], aligned } => writeln!(
                f,
                "  joint {joint} has a counterbalance between pins at {} m and {} m from its axis, shortest at {} deg:\n    \
                 pull t_c + k_c (l - {})",
                short(a),
                short(b),
                short(aligned.to_degrees()),
                short((a - b).abs())
            )?,
        }
    }
    for of in &robot.parallelograms {
        let sign = if of.sense < 0.0 { '-' } else { '+' };
        writeln!(
            f,
            "  a parallelogram moves joint {m}: its crank stands at q{j} {sign} q{m} about the axis of joint {j};\n    \
             parameters c_m to c_Izz of J{m} in the frame of joint {j}, turned with the crank",
            j = of.upper_arm,
            m = of.forearm,
        )?;
    }
    Ok(())
}

fn write_limits(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    writeln!(f, "\nLimits (degrees for turning joints, metres for sliding ones)")?;
    writeln!(
        f,
        "{:>5}  {:<5} {:>10} {:>10} {:>12} {:>16}",
        "joint", "unit", "min", "max", "speed [/s]", "accel. [/s^2]"
    )?;
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let (unit, factor) = match joint.kind {
            JointKind::Revolute => ("deg", 1_f64.to_degrees()),
            JointKind::Prismatic => ("m", 1.0),
        };
        let limits = &joint.limits;
        writeln!(
            f,
            "{:>5}  {unit:<5} {:>10} {:>10} {:>12} {:>16}",
            index.number(),
            short(limits.position_min * factor),
            short(limits.position_max * factor),
            short(limits.velocity * factor),
            short(limits.acceleration * factor),
        )?;
    }
    Ok(())
}

/// Writes the drive of each joint, in the units of the limits; the matrix of the motors only if they turn with several
/// joints.
fn write_drives(f: &mut fmt::Formatter<'_>, robot: &Robot) -> fmt::Result {
    let given = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), short);
    writeln!(f, "\nDrives (torques in Nm, forces of sliding joints in N)")?;
    writeln!(
        f,
        "{:>5}  {:>10} {:>16} {:>14} {:>12} {:>12} {:>12}",
        "joint",
        "gear ratio",
        "position offset",
        "low speed [/s]",
        "rated motor",
        "rated joint",
        "peak joint"
    )?;
    for (joint, index) in robot.joints.iter().zip(robot.joint_indices()) {
        let factor = if joint.kind == JointKind::Revolute { 1_f64.to_degrees() } else { 1.0 };
        writeln!(
            f,
            "{:>5}  {:>10} {:>16} {:>14} {:>12} {:>12} {:>12}",
            index.number(),
            short(joint.gear_ratio),
            short(joint.position_offset * factor),
            short(joint.low_speed * factor),
            given(joint.rated_motor_torque),
            given(joint.rated_torque),
            given(joint.peak_torque),
        )?;
    }
    if !robot.has_coupled_motors() {
        return Ok(());
    }
    writeln!(f, "Motor turns per joint turn, theta_motor = R q: a row per motor, a column per joint")?;
    for row in robot.transmission.row_iter() {
        let cells: Vec<String> = row.iter().map(|ratio| format!("{:>10}", short(*ratio))).collect();
        writeln!(f, "  {}", cells.join(" "))?;
    }
    Ok(())
}

fn write_pose(f: &mut fmt::Formatter<'_>, pose: &Transform) -> fmt::Result {
    let p = pose.translation;
    writeln!(f, "\nLast frame (tool) in the base, all joints at 0")?;
    writeln!(f, "  origin  ({}, {}, {}) m", short(p.x), short(p.y), short(p.z))?;
    for (name, axis) in ["x", "y", "z"].iter().zip(pose.rotation.column_iter()) {
        writeln!(f, "  {name} axis  ({}, {}, {})", short(axis[0]), short(axis[1]), short(axis[2]))?;
    }
    Ok(())
}

fn write_identities(f: &mut fmt::Formatter<'_>, identities: &IdentityCheck) -> fmt::Result {
    writeln!(
        f,
        "\nSelf-check over {} states within the limits, worst relative difference",
        identities.states
    )?;
    writeln!(f, "  {:.1e}  regressor x parameters against inverse dynamics", identities.regressor)?;
    writeln!(f, "  {:.1e}  base parameters against all parameters", identities.grouping)?;
    writeln!(
        f,
        "  {:.1e}  gravity torque against the gradient of potential energy (numeric)",
        identities.gravity
    )?;
    writeln!(f, "  {:.1e}  power of the torques against the rate of energy (numeric)", identities.power)
}

fn write_base(f: &mut fmt::Formatter<'_>, robot: &Robot, base: &BaseParameters) -> fmt::Result {
    let total = ParameterId::natural_order(robot).len();
    writeln!(f, "\nBase parameters: {} of {total}", base.rank)?;
    writeln!(
        f,
        "  rank {} inertial, {} with motor inertia, {} with friction{}",
        base.inertial_rank,
        base.inertial_and_motor_rank,
        base.rank,
        if robot.couplings.is_empty() && robot.springs.is_empty() && robot.parallelograms.is_empty() {
            ""
        } else {
            " and all others"
        },
    )?;
    writeln!(
        f,
        "  singular values at the border: {:.1e} counts, {:.1e} does not",
        base.singular_value_gap.smallest_kept, base.singular_value_gap.largest_dropped
    )?;
    writeln!(
        f,
        "  condition number {:.1} in SI units, {:.1} with scaled columns (states spread over the limits)",
        base.condition_number, base.scaled_condition_number
    )?;
    writeln!(f, "\nEach stands for a grouping: its value is the sum on the right")?;
    writeln!(f, "{:>4}  {:<8} {:<13} grouping", "no.", "name", "unit")?;
    for (index, id) in base.kept.iter().enumerate() {
        let unit = robot.joints.get(id.joint.index()).map_or("", |joint| id.unit(joint.kind));
        let name = id.to_string();
        writeln!(f, "{:>4}  {name:<8} {unit:<13} {}", index + 1, base.grouping_formula(index))?;
    }
    let hidden: Vec<String> = base.unobservable.iter().map(ToString::to_string).collect();
    if hidden.is_empty() {
        return Ok(());
    }
    writeln!(f, "\nWithout any effect on the torques: {}", hidden.join(", "))
}

fn kind_name(kind: JointKind) -> &'static str {
    match kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    }
}

/// Formats with at most six decimals, without trailing zeros or a negative zero.
fn short(x: f64) -> String {
    let text = format!("{x:.6}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text == "-0" { "0".into() } else { text.into() }
}
