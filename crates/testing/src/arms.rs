//! Arms of any kind, for property tests.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use proptest::prelude::*;

use armwatch_model::robot::{
    ArmShape, Coupling, DhParameters, FrictionLaw, FrictionModel, Joint, JointGeometry, JointIndex,
    JointKind, JointLimits, MAX_JOINTS, Parallelogram, Robot, Spring, SpringForm, StandardParameters,
    TorqueSensors, Transform, UrdfOrigin,
};

/// A joint without parameters; lengths in m, angles in rad, usual limits.
pub fn joint(kind: JointKind, a: f64, alpha: f64, d: f64, theta_offset: f64) -> Joint {
    let limits = match kind {
        JointKind::Revolute => JointLimits {
            position_min: -2.5,
            position_max: 2.0,
            velocity: 4.0,
            acceleration: 9.0,
            jerk: None,
        },
        JointKind::Prismatic => JointLimits {
            position_min: -0.2,
            position_max: 0.8,
            velocity: 1.5,
            acceleration: 6.0,
            jerk: None,
        },
    };
    Joint {
        name: None,
        kind,
        geometry: JointGeometry::modified_dh(DhParameters { a, alpha, d, theta_offset }),
        limits,
        gear_ratio: 1.0,
        position_offset: 0.0,
        drive_gain: None,
        motor_torque_constant: None,
        rated_motor_torque: None,
        rated_torque: None,
        peak_torque: None,
        low_speed: 0.02,
        has_torque: true,
        friction: None,
        nominal: None,
    }
}

/// An arm of the given joints and gravity.
pub fn arm(joints: Vec<Joint>, gravity: [f64; 3]) -> Robot {
    Robot {
        model: "test arm".into(),
        transmission: Robot::uncoupled_transmission(&joints),
        joints,
        gravity: Vector3::from(gravity),
        tool: Transform::IDENTITY,
        carried: StandardParameters::default(),
        friction: FrictionModel::POLYNOMIAL,
        torque_sensors: TorqueSensors::Motor,
        couplings: Vec::new(),
        springs: Vec::new(),
        parallelograms: Vec::new(),
        speed_levels: Vec::new(),
        excitation: None,
        shape: ArmShape::default(),
        remarks: Vec::new(),
    }
}

/// Arms of 1 to 9 joints, turning and sliding mixed, in the three conventions, with any friction model and sometimes a
/// coupled motor, springs and parallelograms. Lengths and twists are from a grid with zeros and right angles, and
/// gravity along an axis is zero or clearly not: degenerate arms occur often, almost degenerate ones do not.
pub fn any_arm() -> impl Strategy<Value = Robot> {
    let kind = prop_oneof![3 => Just(JointKind::Revolute), 1 => Just(JointKind::Prismatic)];
    let length = || prop_oneof![Just(0.0), Just(0.07), Just(0.3), Just(-0.25)];
    let twist = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(-FRAC_PI_2), Just(0.7)];
    let offset = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(PI), Just(0.4)];
    let any_joint = (kind, length(), twist, length(), offset)
        .prop_map(|(kind, a, alpha, d, offset)| joint(kind, a, alpha, d, offset));
    let pull = prop_oneof![Just(0.0), 3.0..9.81, -9.81..-3.0];
    let friction = prop_oneof![
        Just(FrictionModel::POLYNOMIAL),
        (any::<bool>()).prop_map(|asymmetric| FrictionModel {
            law: FrictionLaw::ViscousCoulomb,
            asymmetric,
            ..FrictionModel::POLYNOMIAL
        }),
        (any::<bool>()).prop_map(|asymmetric| FrictionModel {
            law: FrictionLaw::Smooth { speed: 0.1 },
            asymmetric,
            ..FrictionModel::POLYNOMIAL
        }),
    ];
    let joints = proptest::collection::vec(any_joint, 1..=MAX_JOINTS);
    (joints, proptest::array::uniform3(pull), friction, 0..3_u8, any::<[bool; 2]>()).prop_map(
        |(joints, gravity, friction, convention, [coupled, balanced])| {
            let mut robot = Robot { friction, ..arm(joints, gravity) };
            match convention {
                0 => {}
                1 => read_as_standard_dh(&mut robot),
                _ => turn_axes(&mut robot),
            }
            if coupled {
                couple_last_joints(&mut robot);
            }
            if balanced {
                balance(&mut robot);
            }
            robot
        },
    )
}

/// Uses the rows of an arm as those of a standard DH table.
fn read_as_standard_dh(robot: &mut Robot) {
    let rows: Vec<DhParameters> = robot.joints.iter().filter_map(|j| j.geometry.dh_row()).collect();
    let (geometry, end) = JointGeometry::standard_dh(&rows);
    robot.joints.iter_mut().zip(geometry).for_each(|(joint, geometry)| joint.geometry = geometry);
    robot.tool = end;
}

/// Turns each axis away from z like in URDF files.
fn turn_axes(robot: &mut Robot) {
    const AXES: [[f64; 3]; 4] = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8]];
    let mut back = Transform::IDENTITY;
    for (joint, axis) in robot.joints.iter_mut().zip(AXES.into_iter().cycle()) {
        let turn = Transform::z_to(&Vector3::from(axis));
        let placement = back.then(joint.geometry.placement()).then(&turn);
        let origin = UrdfOrigin { xyz: [0.0; 3], rpy: [0.0; 3], axis };
        joint.geometry = JointGeometry::urdf(placement, origin);
        back = turn.inverse();
    }
}

fn couple_last_joints(robot: &mut Robot) {
    let n = robot.joint_count();
    let turns = |joint: &Joint| joint.kind == JointKind::Revolute;
    if n >= 2 && robot.joints[n - 2..].iter().all(turns) {
        let (joint, motor_joint) = (JointIndex::new(n - 2), JointIndex::new(n - 1));
        robot.couplings = vec![Coupling { joint, motor_joint, ratio: -0.6 }];
    }
}

/// Adds a spring at the first joint, a counterbalance at each third joint if it turns, and all possible parallelograms.
fn balance(robot: &mut Robot) {
    robot.springs = vec![Spring { joint: JointIndex::new(0), form: SpringForm::Direct, nominal: None }];
    for joint in robot.joint_indices().filter(|joint| joint.index() % 3 == 1).collect::<Vec<_>>() {
        if robot.joints[joint.index()].kind == JointKind::Revolute {
            let form = SpringForm::Cylinder { pins: [0.2, 0.7], aligned: 0.3 };
            robot.springs.push(Spring { joint, form, nominal: None });
        }
    }
    robot.parallelograms =
        robot.joint_indices().filter_map(|joint| Parallelogram::new(&robot.joints, joint, None)).collect();
}

/// `[n]` numbers for every channel of a state or a parameter set.
pub fn numbers() -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(-1.0..1.0, 28 * MAX_JOINTS)
}
