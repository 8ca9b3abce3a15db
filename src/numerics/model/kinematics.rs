//! Where the links are: joint transforms and their product.

use nalgebra::{Matrix3, Vector3};

use crate::robot::{Joint, JointIndex, JointKind, Robot, Transform};

/// Frame of `joint` in the frame of the link before it, at the position `q` (rad, or m for a sliding
/// joint): its place at rest, then `Rz(q)` or `Dz(q)`. For modified Denavit-Hartenberg parameters the
/// same as `T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)` [2.1, 2.2], since the last two steps commute.
#[inline]
#[must_use]
pub fn joint_transform(joint: &Joint, q: f64) -> Transform {
    let Transform { rotation: r, translation } = joint.geometry.placement();
    match joint.kind {
        JointKind::Revolute => {
            let (s, c) = q.sin_cos();
            let rotation = Matrix3::new(
                r.m11 * c + r.m12 * s,
                r.m12 * c - r.m11 * s,
                r.m13,
                r.m21 * c + r.m22 * s,
                r.m22 * c - r.m21 * s,
                r.m23,
                r.m31 * c + r.m32 * s,
                r.m32 * c - r.m31 * s,
                r.m33,
            );
            Transform { rotation, translation: *translation }
        }
        JointKind::Prismatic => {
            let slide = Vector3::new(r.m13 * q, r.m23 * q, r.m33 * q);
            Transform { rotation: *r, translation: translation + slide }
        }
    }
}

/// Frame of every link in the frame before it, at the posture `q` `[n]` (rad; m for sliding joints)
/// [2.1, 2.2]. `[n]`, base outwards.
#[must_use]
#[cfg(test)]
fn link_transforms(robot: &Robot, q: &[f64]) -> Vec<Transform> {
    robot.joints.iter().zip(q).map(|(joint, &q)| joint_transform(joint, q)).collect()
}

/// Tool frame in the base at the posture `q` `[n]` (rad; m for sliding joints): the product of the link
/// transforms [2.2], not the closed form that the source prints in [2.3], and of the robot's tool. Without
/// a tool it is the frame of the last link.
#[must_use]
pub fn forward_kinematics(robot: &Robot, q: &[f64]) -> Transform {
    chain(robot, q, robot.joint_count()).then(&robot.tool)
}

/// Direction of a joint's axis in the base frame at the posture `q` `[n]` (rad; m for sliding joints):
/// a unit vector. Gravity does no work on a turning joint whose axis is parallel to gravity.
#[must_use]
pub fn joint_axis_in_base(robot: &Robot, q: &[f64], joint: JointIndex) -> Vector3<f64> {
    chain(robot, q, joint.index() + 1).rotation.column(2).into_owned()
}

fn chain(robot: &Robot, q: &[f64], links: usize) -> Transform {
    robot
        .joints
        .iter()
        .zip(q)
        .take(links)
        .fold(Transform::IDENTITY, |pose, (joint, &q)| pose.then(&joint_transform(joint, q)))
}

#[cfg(test)]
pub(crate) mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use nalgebra::{Rotation3, Translation3};
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{
        ArmShape, Coupling, DhParameters, FrictionLaw, FrictionModel, JointGeometry, JointLimits, MAX_JOINTS,
        TorqueSensors, UrdfOrigin,
    };
    use crate::testing::er3a;

    /// Products of at most nine rotations lose a few units in the last place each.
    const ROUNDING: f64 = 1e-13;

    /// A joint without parameters; lengths in m, angles in rad, ordinary limits.
    pub(in crate::numerics) fn joint(
        kind: JointKind,
        a: f64,
        alpha: f64,
        d: f64,
        theta_offset: f64,
    ) -> Joint {
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
            friction: None,
            nominal: None,
        }
    }

    /// An arm of the given joints and gravity.
    pub(in crate::numerics) fn arm(joints: Vec<Joint>, gravity: [f64; 3]) -> Robot {
        Robot {
            model: "test arm".into(),
            transmission: Robot::uncoupled_transmission(&joints),
            joints,
            gravity: Vector3::from(gravity),
            tool: Transform::IDENTITY,
            friction: FrictionModel::POLYNOMIAL,
            torque_sensors: TorqueSensors::Motor,
            couplings: Vec::new(),
            speed_levels: Vec::new(),
            excitation: None,
            shape: ArmShape::default(),
        }
    }

    /// Arms of 1 to 9 joints, turning and sliding mixed, in the three conventions, with any friction
    /// model and now and then a coupled motor. Lengths and twists come from a grid with zeros and right
    /// angles, and gravity is absent along an axis or clearly there: degenerate arms occur often,
    /// almost degenerate ones do not.
    pub(crate) fn any_arm() -> impl Strategy<Value = Robot> {
        let kind = prop_oneof![3 => Just(JointKind::Revolute), 1 => Just(JointKind::Prismatic)];
        let length = || prop_oneof![Just(0.0), Just(0.07), Just(0.3), Just(-0.25)];
        let twist = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(-FRAC_PI_2), Just(0.7)];
        let offset = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(PI), Just(0.4)];
        let any_joint = (kind, length(), twist, length(), offset)
            .prop_map(|(kind, a, alpha, d, offset)| joint(kind, a, alpha, d, offset));
        let pull = prop_oneof![Just(0.0), 3.0..9.81, -9.81..-3.0];
        let friction = prop_oneof![
            Just(FrictionModel::POLYNOMIAL),
            (any::<bool>())
                .prop_map(|asymmetric| FrictionModel { law: FrictionLaw::ViscousCoulomb, asymmetric }),
            (any::<bool>())
                .prop_map(|asymmetric| FrictionModel { law: FrictionLaw::Smooth { speed: 0.1 }, asymmetric }),
        ];
        let joints = proptest::collection::vec(any_joint, 1..=MAX_JOINTS);
        (joints, proptest::array::uniform3(pull), friction, 0..3_u8, any::<bool>()).prop_map(
            |(joints, gravity, friction, convention, coupled)| {
                let mut robot = Robot { friction, ..arm(joints, gravity) };
                match convention {
                    0 => {}
                    1 => read_as_standard_dh(&mut robot),
                    _ => turn_axes(&mut robot),
                }
                if coupled {
                    couple_last_joints(&mut robot);
                }
                robot
            },
        )
    }

    /// Takes the rows of an arm for those of a standard DH table.
    fn read_as_standard_dh(robot: &mut Robot) {
        let rows: Vec<DhParameters> = robot.joints.iter().filter_map(|j| j.geometry.dh_row()).collect();
        let (geometry, end) = JointGeometry::standard_dh(&rows);
        robot.joints.iter_mut().zip(geometry).for_each(|(joint, geometry)| joint.geometry = geometry);
        robot.tool = end;
    }

    /// Turns each axis away from z as URDF files do.
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

    /// `[n]` numbers for every channel of a state or a parameter set.
    pub(crate) fn numbers() -> impl Strategy<Value = Vec<f64>> {
        proptest::collection::vec(-1.0..1.0, 16 * MAX_JOINTS)
    }

    fn difference(a: &Transform, b: &Transform) -> f64 {
        (a.rotation - b.rotation).norm() + (a.translation - b.translation).norm()
    }

    #[test]
    fn a_link_transform_is_the_product_of_its_four_steps() {
        for kind in [JointKind::Revolute, JointKind::Prismatic] {
            let joint = joint(kind, 0.2, 0.7, -0.3, 0.4);
            let q = 0.9;
            let (theta, d) = match kind {
                JointKind::Revolute => (q + 0.4, -0.3),
                JointKind::Prismatic => (0.4, q - 0.3),
            };
            let product = Rotation3::from_axis_angle(&Vector3::x_axis(), 0.7).to_homogeneous()
                * Translation3::new(0.2, 0.0, 0.0).to_homogeneous()
                * Rotation3::from_axis_angle(&Vector3::z_axis(), theta).to_homogeneous()
                * Translation3::new(0.0, 0.0, d).to_homogeneous();
            let expected = Transform {
                rotation: product.fixed_view::<3, 3>(0, 0).into_owned(),
                translation: product.fixed_view::<3, 1>(0, 3).into_owned(),
            };
            assert!(difference(&joint_transform(&joint, q), &expected) < ROUNDING);
        }
    }

    #[test]
    fn the_er3a_at_zero_points_where_its_geometry_says() {
        let pose = forward_kinematics(&er3a(), &[0.0; 6]);
        // Upright upper arm: 0.32 + 0.27 + 0.07 up, 0.05 + 0.3 + 0.0785 forward.
        let expected = Vector3::new(0.4285, 0.0, 0.66);
        assert!((pose.translation - expected).norm() < ROUNDING, "{}", pose.translation);
    }

    #[test]
    fn the_first_axis_of_the_er3a_is_vertical_in_every_posture_and_the_second_never() {
        let robot = er3a();
        for q1 in [-1.0, 0.0, 2.0] {
            let q = [q1, 0.3, -0.4, 0.5, 0.6, -0.7];
            let first = joint_axis_in_base(&robot, &q, JointIndex::new(0));
            let second = joint_axis_in_base(&robot, &q, JointIndex::new(1));
            assert!((first - Vector3::z()).norm() < ROUNDING);
            assert!(second.z.abs() < ROUNDING);
            assert!((second - Vector3::new(q1.sin(), -q1.cos(), 0.0)).norm() < ROUNDING);
        }
    }

    proptest! {
        #[test]
        fn the_last_frame_is_the_product_of_all_and_stays_a_rotation(robot in any_arm(), q in numbers()) {
            let product = link_transforms(&robot, &q)
                .iter()
                .fold(Transform::IDENTITY, |pose, link| pose.then(link));
            let hand = forward_kinematics(&robot, &q);
            prop_assert!(difference(&hand, &product.then(&robot.tool)) < ROUNDING);
            let pose = chain(&robot, &q, robot.joint_count());
            prop_assert!(difference(&pose, &product) < ROUNDING);
            prop_assert!((pose.rotation.transpose() * pose.rotation - Matrix3::identity()).norm() < ROUNDING);
            let last = JointIndex::new(robot.joint_count() - 1);
            prop_assert!((joint_axis_in_base(&robot, &q, last) - pose.rotation.column(2)).norm() < ROUNDING);
        }

        #[test]
        fn moving_a_joint_moves_the_hand_about_or_along_its_axis(robot in any_arm(), q in numbers()) {
            // Central differences of fourth order: the step to the fourth power is far below this.
            const TOLERANCE: f64 = 1e-8;
            const STEP: f64 = 1e-3;
            let n = robot.joint_count();
            let hand = forward_kinematics(&robot, &q[..n]).translation;
            for j in robot.joint_indices() {
                let at = |step: f64| {
                    let mut moved = q[..n].to_vec();
                    moved[j.index()] += step;
                    forward_kinematics(&robot, &moved).translation
                };
                let slope = (8.0 * (at(STEP) - at(-STEP)) - (at(2.0 * STEP) - at(-2.0 * STEP))) / (12.0 * STEP);
                let axis = joint_axis_in_base(&robot, &q, j);
                let expected = match robot.joints[j.index()].kind {
                    JointKind::Revolute => axis.cross(&(hand - chain(&robot, &q, j.index() + 1).translation)),
                    JointKind::Prismatic => axis,
                };
                prop_assert!((slope - expected).norm() < TOLERANCE);
            }
        }
    }
}
