//! Where the links are: modified Denavit-Hartenberg transforms and their product.

use nalgebra::{Matrix3, Vector3};

use crate::robot::{Joint, JointIndex, JointKind, Robot};

/// Pose of one frame in another: frame `i` in frame `i-1`, or the last frame in the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkTransform {
    /// Axes of the frame as columns, expressed in the other frame.
    pub rotation: Matrix3<f64>,
    /// Origin of the frame in the other frame, m.
    pub translation: Vector3<f64>,
}

impl LinkTransform {
    /// A frame that lies in the other one.
    pub const IDENTITY: Self = Self {
        rotation: Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::new(0.0, 0.0, 0.0),
    };

    /// Frame of `joint` in the frame before it, at the position `q` (rad, or m for a sliding joint):
    /// `T(i-1,i) = Rx(alpha) Dx(a) Rz(theta) Dz(d)` [2.1, 2.2].
    #[must_use]
    pub fn of_joint(joint: &Joint, q: f64) -> Self {
        let geometry = &joint.geometry;
        let (theta, d) = match joint.kind {
            JointKind::Revolute => (q + geometry.theta_offset, geometry.d),
            JointKind::Prismatic => (geometry.theta_offset, geometry.d + q),
        };
        let (sin_alpha, cos_alpha) = geometry.alpha.sin_cos();
        let (sin_theta, cos_theta) = theta.sin_cos();
        Self {
            rotation: Matrix3::new(
                cos_theta,
                -sin_theta,
                0.0,
                cos_alpha * sin_theta,
                cos_alpha * cos_theta,
                -sin_alpha,
                sin_alpha * sin_theta,
                sin_alpha * cos_theta,
                cos_alpha,
            ),
            translation: Vector3::new(geometry.a, -sin_alpha * d, cos_alpha * d),
        }
    }

    /// The transform that applies `next` in this frame: `T(a,c) = T(a,b) T(b,c)`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: self.rotation * next.rotation,
            translation: self.translation + self.to_outer(&next.translation),
        }
    }

    /// A free vector of this frame, expressed in the other: `R v`.
    #[inline]
    #[must_use]
    pub fn to_outer(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let r = &self.rotation;
        Vector3::new(
            r.m11 * v.x + r.m12 * v.y + r.m13 * v.z,
            r.m21 * v.x + r.m22 * v.y + r.m23 * v.z,
            r.m31 * v.x + r.m32 * v.y + r.m33 * v.z,
        )
    }

    /// A free vector of the other frame, expressed in this one: `R' v`.
    #[inline]
    #[must_use]
    pub fn to_inner(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let r = &self.rotation;
        Vector3::new(
            r.m11 * v.x + r.m21 * v.y + r.m31 * v.z,
            r.m12 * v.x + r.m22 * v.y + r.m32 * v.z,
            r.m13 * v.x + r.m23 * v.y + r.m33 * v.z,
        )
    }
}

/// Frame of every link in the frame before it, at the posture `q` `[n]` (rad; m for sliding joints)
/// [2.1, 2.2]. `[n]`, base outwards.
#[must_use]
pub fn link_transforms(robot: &Robot, q: &[f64]) -> Vec<LinkTransform> {
    robot.joints.iter().zip(q).map(|(joint, &q)| LinkTransform::of_joint(joint, q)).collect()
}

/// Frame of the last link in the base at the posture `q` `[n]` (rad; m for sliding joints): the
/// product of the link transforms [2.2], not the closed form that the source prints in [2.3].
#[must_use]
pub fn forward_kinematics(robot: &Robot, q: &[f64]) -> LinkTransform {
    chain(robot, q, robot.joint_count())
}

/// Direction of a joint's axis in the base frame at the posture `q` `[n]` (rad; m for sliding joints):
/// a unit vector. Gravity does no work on a turning joint whose axis is parallel to gravity.
#[must_use]
pub fn joint_axis_in_base(robot: &Robot, q: &[f64], joint: JointIndex) -> Vector3<f64> {
    chain(robot, q, joint.index() + 1).rotation.column(2).into_owned()
}

fn chain(robot: &Robot, q: &[f64], links: usize) -> LinkTransform {
    robot
        .joints
        .iter()
        .zip(q)
        .take(links)
        .fold(LinkTransform::IDENTITY, |pose, (joint, &q)| pose.then(&LinkTransform::of_joint(joint, q)))
}

#[cfg(test)]
pub(super) mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use nalgebra::{Rotation3, Translation3};
    use proptest::prelude::*;

    use super::*;
    use crate::robot::{JointLimits, MAX_JOINTS, ModifiedDh};
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
            JointKind::Revolute => {
                JointLimits { position_min: -2.5, position_max: 2.0, velocity: 4.0, acceleration: 9.0 }
            }
            JointKind::Prismatic => {
                JointLimits { position_min: -0.2, position_max: 0.8, velocity: 1.5, acceleration: 6.0 }
            }
        };
        Joint {
            kind,
            geometry: ModifiedDh { a, alpha, d, theta_offset },
            limits,
            gear_ratio: 1.0,
            rated_motor_torque: None,
            low_speed: 0.02,
            nominal: None,
        }
    }

    /// An arm of the given joints and gravity.
    pub(in crate::numerics) fn arm(joints: Vec<Joint>, gravity: [f64; 3]) -> Robot {
        Robot {
            model: "test arm".into(),
            joints,
            gravity: Vector3::from(gravity),
            speed_levels: Vec::new(),
            excitation: None,
        }
    }

    /// Arms of 1 to 9 joints, turning and sliding mixed. Lengths and twists come from a grid with
    /// zeros and right angles, and gravity is absent along an axis or clearly there: degenerate arms
    /// occur often, almost degenerate ones do not.
    pub(in crate::numerics) fn any_arm() -> impl Strategy<Value = Robot> {
        let kind = prop_oneof![3 => Just(JointKind::Revolute), 1 => Just(JointKind::Prismatic)];
        let length = || prop_oneof![Just(0.0), Just(0.07), Just(0.3), Just(-0.25)];
        let twist = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(-FRAC_PI_2), Just(0.7)];
        let offset = prop_oneof![Just(0.0), Just(FRAC_PI_2), Just(PI), Just(0.4)];
        let any_joint = (kind, length(), twist, length(), offset)
            .prop_map(|(kind, a, alpha, d, offset)| joint(kind, a, alpha, d, offset));
        let pull = prop_oneof![Just(0.0), 3.0..9.81, -9.81..-3.0];
        (proptest::collection::vec(any_joint, 1..=MAX_JOINTS), proptest::array::uniform3(pull))
            .prop_map(|(joints, gravity)| arm(joints, gravity))
    }

    /// `[n]` numbers for every channel of a state or a parameter set.
    pub(in crate::numerics) fn numbers() -> impl Strategy<Value = Vec<f64>> {
        proptest::collection::vec(-1.0..1.0, 15 * MAX_JOINTS)
    }

    fn difference(a: &LinkTransform, b: &LinkTransform) -> f64 {
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
            let expected = LinkTransform {
                rotation: product.fixed_view::<3, 3>(0, 0).into_owned(),
                translation: product.fixed_view::<3, 1>(0, 3).into_owned(),
            };
            assert!(difference(&LinkTransform::of_joint(&joint, q), &expected) < ROUNDING);
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
                .fold(LinkTransform::IDENTITY, |pose, link| pose.then(link));
            let pose = forward_kinematics(&robot, &q);
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
