//! Positions of the links: joint transforms and their product.

use nalgebra::{Matrix3, Vector3};

use armwatch_model::robot::{Joint, JointIndex, JointKind, Robot, Transform};

/// Frame of `joint` in the frame of the previous link, at the position `q` (rad, or m for a sliding joint): its
/// placement, then `Rz(q)` or `Dz(q)`. For modified Denavit-Hartenberg parameters this equals
/// `T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)` [2.1, 2.2], since the last two steps commute.
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

/// Frame of every link in the previous frame, at the posture `q` `[n]` (rad; m for sliding joints) [2.1, 2.2]. `[n]`,
/// from the base outwards.
#[must_use]
#[cfg(test)]
fn link_transforms(robot: &Robot, q: &[f64]) -> Vec<Transform> {
    robot.joints.iter().zip(q).map(|(joint, &q)| joint_transform(joint, q)).collect()
}

/// Tool frame in the base at the posture `q` `[n]` (rad; m for sliding joints): the product of the link transforms
/// [2.2] and the robot's tool, not the closed form that the source prints in [2.3]. Without a tool it is the frame of
/// the last link.
#[must_use]
pub fn forward_kinematics(robot: &Robot, q: &[f64]) -> Transform {
    chain(robot, q, robot.joint_count()).then(&robot.tool)
}

/// Direction of a joint's axis in the base frame at the posture `q` `[n]` (rad; m for sliding joints): a unit vector.
/// Gravity does no work on a rotary joint whose axis is parallel to gravity.
#[must_use]
pub(crate) fn joint_axis_in_base(robot: &Robot, q: &[f64], joint: JointIndex) -> Vector3<f64> {
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
mod tests {
    use nalgebra::{Rotation3, Translation3};
    use proptest::prelude::*;

    use super::*;
    use armwatch_testing::arms::{any_arm, joint, numbers};
    use armwatch_testing::er3a;

    /// Rounding of products of at most nine rotations, a few units in the last place each.
    const ROUNDING: f64 = 1e-13;

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
            // Tolerance of central differences of fourth order: the step to the fourth power is far smaller.
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
