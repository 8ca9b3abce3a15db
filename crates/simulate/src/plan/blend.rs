//! Moves from one state of the arm to another, inside all limits.

use super::motion::{MotionPiece, MotionState, quintic, state_at};
use crate::error::SimulateError;
use armwatch_model::robot::{JointIndex, Robot};

/// Part of the largest speed and acceleration that moves between stages use.
const MOVE_USE: f64 = 0.9;
/// Durations tried for a move, each a fifth longer: the last is 30 times the first, and beyond that
/// a start speed only carries further out.
const BLEND_TRIES: usize = 20;
/// Shortest move, s.
pub(super) const MOVE_MIN_S: f64 = 0.3;

/// The shortest polynomial between two states that keeps inside all limits.
pub(super) fn blend(
    robot: &Robot,
    from: &MotionState,
    to: &MotionState,
) -> Result<(f64, MotionPiece), SimulateError> {
    // Peaks of the rest-to-rest polynomial: 15/8 D/T, 10/sqrt(3) D/T² and 60 D/T³.
    let mut duration = robot.joints.iter().enumerate().fold(MOVE_MIN_S, |longest, (j, joint)| {
        let distance = (to.position[j] - from.position[j]).abs();
        let by_speed = 1.875 * distance / (MOVE_USE * joint.limits.velocity);
        let by_acceleration =
            (10.0 / 3.0_f64.sqrt() * distance / (MOVE_USE * joint.limits.acceleration)).sqrt();
        let by_jerk = joint.limits.jerk.map_or(0.0, |jerk| (60.0 * distance / (MOVE_USE * jerk)).cbrt());
        longest.max(by_speed).max(by_acceleration).max(by_jerk)
    });
    let mut blocked = JointIndex::new(0);
    for _ in 0..BLEND_TRIES {
        let motion = quintic(from, to, robot.joint_count(), duration);
        match first_outside(robot, &motion, duration) {
            None => return Ok((duration, motion)),
            Some(joint) => blocked = joint,
        }
        duration *= 1.2;
    }
    Err(SimulateError::NoBlend { joint: blocked })
}

fn first_outside(robot: &Robot, motion: &MotionPiece, duration: f64) -> Option<JointIndex> {
    const STEPS: u32 = 100;
    let step = duration / f64::from(STEPS);
    let states: Vec<MotionState> = (0..=STEPS).map(|k| state_at(motion, step * f64::from(k))).collect();
    (0..states.len()).find_map(|k| {
        let (before, state) = (&states[k.saturating_sub(1)], &states[k]);
        robot.joint_indices().find(|index| {
            let (j, limits) = (index.index(), &robot.joints[index.index()].limits);
            let jerk = (state.acceleration[j] - before.acceleration[j]) / step;
            state.position[j] < limits.position_min
                || state.position[j] > limits.position_max
                || state.velocity[j].abs() > limits.velocity
                || state.acceleration[j].abs() > limits.acceleration
                || limits.jerk.is_some_and(|limit| jerk.abs() > limit)
        })
    })
}
