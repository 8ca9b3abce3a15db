//! Postures with a vertical axis of a joint, so that its gravity torque is constant while it turns.

use nalgebra::{Matrix3, Vector3};

use super::motion::PerJoint;
use armwatch_model::robot::{JointIndex, JointKind, MAX_JOINTS, Robot};

/// Share of each joint's range, about its middle, that a posture may use.
const RANGE_PART: f64 = 0.9;
/// Starting postures of a search, in addition to home.
const STARTS: u32 = 64;
/// Steps of a search; near a solution each of them doubles the number of correct digits.
const STEPS: usize = 200;
/// Last steps of a search, which turn the axis alone: each doubles the number of correct digits, so that a few would be
/// enough.
const LAST_STEPS: usize = 20;
/// Longest step of a joint, rad.
const STEP_MAX: f64 = 0.3;
/// Tilt of the axis below which it counts as vertical, rad.
const VERTICAL: f64 = 1e-9;
/// Damping that keeps the step finite if no joint can turn the axis further.
const DAMPING: f64 = 1e-6;
/// Bases of the sequence that spreads starts evenly, one prime per joint (Halton 1960).
const PRIMES: [u32; MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17, 19, 23];

/// The posture of the joints before `joint` nearest to `home` that makes the axis of `joint` vertical; the other joints
/// are as in `home`. `None` if no posture within nine tenths of the ranges achieves it. A prismatic joint carries the
/// same weight everywhere, so that the result is `home`, like for any joint without gravity.
pub fn still_posture(robot: &Robot, joint: JointIndex, home: &PerJoint) -> Option<PerJoint> {
    let Some(down) = robot.gravity.try_normalize(f64::MIN_POSITIVE) else { return Some(*home) };
    if robot.joints[joint.index()].kind == JointKind::Prismatic {
        return Some(*home);
    }
    let starts = std::iter::once(*home).chain((1..=STARTS).map(|k| spread(robot, joint, home, k)));
    let found = starts.flat_map(|start| {
        [down, -down].into_iter().filter_map(move |wanted| aligned(robot, joint, home, start, &wanted))
    });
    found.min_by(|a, b| distance(a, home).total_cmp(&distance(b, home)))
}

/// Angle of a joint's axis from the vertical, rad, 0 to a right angle; 0 without gravity and for a prismatic joint.
pub fn axis_tilt(robot: &Robot, joint: JointIndex, posture: &PerJoint) -> f64 {
    let Some(down) = robot.gravity.try_normalize(f64::MIN_POSITIVE) else { return 0.0 };
    if robot.joints[joint.index()].kind == JointKind::Prismatic {
        return 0.0;
    }
    let (_, axis) = axes(robot, joint.index(), posture);
    axis.cross(&down).norm().atan2(axis.dot(&down).abs())
}

fn distance(posture: &PerJoint, home: &PerJoint) -> f64 {
    posture.iter().zip(home).map(|(q, home)| (q - home).powi(2)).sum()
}

/// Start `k`, from 1: evenly spread over the ranges of the joints before `joint`.
fn spread(robot: &Robot, joint: JointIndex, home: &PerJoint, k: u32) -> PerJoint {
    let mut posture = *home;
    for (j, q) in posture.iter_mut().enumerate().take(joint.index()) {
        let [low, high] = room(robot, j);
        let (mut part, mut weight, mut rest) = (0.0, 1.0, k);
        while rest > 0 {
            weight /= f64::from(PRIMES[j]);
            part += weight * f64::from(rest % PRIMES[j]);
            rest /= PRIMES[j];
        }
        *q = low + part * (high - low);
    }
    posture
}

fn room(robot: &Robot, joint: usize) -> [f64; 2] {
    let limits = &robot.joints[joint].limits;
    let middle = 0.5 * (limits.position_min + limits.position_max);
    let half = 0.5 * RANGE_PART * (limits.position_max - limits.position_min);
    [middle - half, middle + half]
}

/// Searches from `start` for a posture whose axis points along `wanted`. Motion that does not turn the axis approaches
/// `home` (Liégeois 1977, gradient projection).
fn aligned(
    robot: &Robot,
    joint: JointIndex,
    home: &PerJoint,
    start: PerJoint,
    wanted: &Vector3<f64>,
) -> Option<PerJoint> {
    let mut posture = start;
    for step in 0..STEPS {
        let (before, axis) = axes(robot, joint.index(), &posture);
        let missing = wanted - axis;
        let is_drawn = step + LAST_STEPS < STEPS;
        let turn = |j: usize| before[j].map_or_else(Vector3::zeros, |of| of.cross(&axis));
        let slopes: Vec<Vector3<f64>> = (0..joint.index()).map(turn).collect();
        let square = slopes.iter().fold(Matrix3::identity() * DAMPING, |sum, of| sum + of * of.transpose());
        let inverse = square.try_inverse()?;
        let part = if is_drawn { 1.0 } else { 0.0 };
        let towards: Vec<f64> = posture.iter().zip(home).map(|(q, home)| part * (home - q)).collect();
        let drawn = slopes.iter().zip(&towards).fold(Vector3::zeros(), |sum, (of, by)| sum + of * *by);
        let along = inverse * (missing - drawn);
        for (j, (slope, towards)) in slopes.iter().zip(towards).enumerate() {
            let [low, high] = room(robot, j);
            let change = (towards + slope.dot(&along)).clamp(-STEP_MAX, STEP_MAX);
            posture[j] = (posture[j] + change).clamp(low, high);
        }
    }
    (axis_tilt(robot, joint, &posture) < VERTICAL).then_some(posture)
}

/// Axes of the turning joints before `joint`, and that of `joint`, in the base frame.
fn axes(
    robot: &Robot,
    joint: usize,
    posture: &PerJoint,
) -> ([Option<Vector3<f64>>; MAX_JOINTS], Vector3<f64>) {
    let mut found = [None; MAX_JOINTS];
    let mut rotation = Matrix3::identity();
    let mut axis = Vector3::z();
    for (j, of) in robot.joints.iter().enumerate().take(joint + 1) {
        rotation *= of.geometry.placement().rotation;
        axis = rotation.column(2).into_owned();
        if of.kind == JointKind::Revolute {
            found[j] = Some(axis);
            let (sin, cos) = posture[j].sin_cos();
            rotation *= Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        }
    }
    (found, axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::dynamics::{joint_torque, rigid_chain};
    use crate::plan::motion::MotionState;
    use crate::test_arms::{er3a, nine_joints};

    /// Gravity torques of the dynamics over the range of a joint, the others held: lowest and highest, Nm.
    fn gravity(robot: &Robot, joint: usize, posture: &PerJoint) -> [f64; 2] {
        let chain = rigid_chain(robot).unwrap();
        let limits = &robot.joints[joint].limits;
        let at = |k: u32| {
            let mut posture = *posture;
            posture[joint] =
                limits.position_min + f64::from(k) / 40.0 * (limits.position_max - limits.position_min);
            joint_torque(&chain, &MotionState::at_rest(posture))[joint]
        };
        (0..=40).map(at).fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| [low.min(t), high.max(t)])
    }

    #[test]
    fn gravity_stays_still_in_the_postures_that_are_found_and_only_shoulder_and_elbow_have_none() {
        let robot = er3a();
        let home = [0.0; MAX_JOINTS];
        for joint in robot.joint_indices() {
            let found = still_posture(&robot, joint, &home);
            assert_eq!(found.is_some(), ![2, 3].contains(&joint.number()), "joint {joint}");
            let Some(posture) = found else {
                assert!(axis_tilt(&robot, joint, &home) > 1.5, "joint {joint}");
                continue;
            };
            let [low, high] = gravity(&robot, joint.index(), &posture);
            assert!(high - low < 1e-6, "joint {joint}: {low} to {high} Nm in {posture:?}");
            assert!(axis_tilt(&robot, joint, &posture) < VERTICAL);
            // joints after it stay at home, the others inside their ranges
            for (j, of) in robot.joints.iter().enumerate() {
                let inside = (of.limits.position_min..=of.limits.position_max).contains(&posture[j]);
                assert!(inside && (j < joint.index() || posture[j] == 0.0), "joint {joint}: {posture:?}");
            }
        }
        let wrist = [4, 5].map(JointIndex::new);
        let moving = wrist.map(|joint| gravity(&robot, joint.index(), &home));
        assert!(moving.iter().any(|[low, high]| high - low > 0.1), "{moving:?}");
    }

    #[test]
    fn sliding_joints_and_arms_without_gravity_stay_at_home() {
        let robot = nine_joints();
        let home = [1.0; MAX_JOINTS];
        assert_eq!(still_posture(&robot, JointIndex::new(0), &home), Some(home));
        let mut floating = er3a();
        floating.gravity = Vector3::zeros();
        assert_eq!(still_posture(&floating, JointIndex::new(1), &home), Some(home));
    }
}
