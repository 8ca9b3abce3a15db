//! Motion from point to point, with a dead time at each: for controllers that support nothing else.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::motion::PerJoint;
use crate::error::SimulateError;
use armwatch_model::robot::{JointKind, MAX_JOINTS, Robot};

/// Share of each range, about its middle, for random points.
const RANGE_PART: f64 = 0.9;
/// Stream of the points: far from those of other random values.
const STREAM: u64 = 1 << 42;

/// Points that the arm moves to in sequence.
#[derive(Debug, Clone, PartialEq)]
pub struct PointToPoint {
    /// Their positions.
    pub points: Points,
    /// Rest at each, s.
    pub dead_s: f64,
}

/// Positions of the points.
#[derive(Debug, Clone, PartialEq)]
pub enum Points {
    /// A number of points, drawn evenly over nine tenths of the ranges.
    Drawn(u32),
    /// These, `[points][n]`, rad (m).
    Given(Vec<Vec<f64>>),
}

impl PointToPoint {
    /// The points as postures.
    ///
    /// # Errors
    /// [`SimulateError::Point`] for one outside the range of a joint or with another number of joints,
    /// [`SimulateError::Setting`] for fewer than two points or an invalid dead time.
    pub fn postures(&self, robot: &Robot, seed: u64) -> Result<Vec<PerJoint>, SimulateError> {
        if !(0.0..=3600.0).contains(&self.dead_s) {
            return Err(SimulateError::Setting {
                key: "dead_s",
                value: self.dead_s.to_string(),
                hint: "0 to 3600 s",
            });
        }
        let postures = match &self.points {
            Points::Drawn(count) => drawn(robot, seed, *count),
            Points::Given(given) => given
                .iter()
                .enumerate()
                .map(|(k, point)| posture(robot, k + 1, point))
                .collect::<Result<_, _>>()?,
        };
        if postures.len() < 2 {
            let value = postures.len().to_string();
            return Err(SimulateError::Setting {
                key: "points",
                value,
                hint: "2 or more points make a motion",
            });
        }
        Ok(postures)
    }
}

fn posture(robot: &Robot, number: usize, point: &[f64]) -> Result<PerJoint, SimulateError> {
    let mut found = [0.0; MAX_JOINTS];
    if point.len() != robot.joint_count() {
        let problem = format!("it has {} positions, the arm {} joints", point.len(), robot.joint_count());
        return Err(SimulateError::Point { point: number, problem });
    }
    for ((q, of), (value, joint)) in
        found.iter_mut().zip(robot.joint_indices()).zip(point.iter().zip(&robot.joints))
    {
        let limits = &joint.limits;
        let unit = if joint.kind == JointKind::Revolute { "rad" } else { "m" };
        if !(limits.position_min..=limits.position_max).contains(value) {
            let recorded = if joint.position_offset == 0.0 {
                String::new()
            } else {
                format!(" ({} {unit} of the controller)", joint.recorded_position(*value))
            };
            let problem = format!(
                "joint {of} at {value} {unit}{recorded} is outside its range of {} to {} {unit}",
                limits.position_min, limits.position_max
            );
            return Err(SimulateError::Point { point: number, problem });
        }
        *q = *value;
    }
    Ok(found)
}

fn drawn(robot: &Robot, seed: u64, count: u32) -> Vec<PerJoint> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(STREAM);
    let mut one = || {
        let mut posture = [0.0; MAX_JOINTS];
        for (q, joint) in posture.iter_mut().zip(&robot.joints) {
            let limits = &joint.limits;
            let middle = 0.5 * (limits.position_min + limits.position_max);
            let range = limits.position_max - limits.position_min;
            *q = middle + RANGE_PART * range * (rng.random::<f64>() - 0.5);
        }
        posture
    };
    (0..count).map(|_| one()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::motion::MotionPiece;
    use crate::plan::trajectory::{ExcitationParts, PlanSettings, plan_cycle};
    use crate::test_arms::er3a;
    use armwatch_model::run::Stage;

    #[test]
    fn an_arm_goes_from_point_to_point_and_waits_at_each() {
        let robot = er3a();
        let given: Vec<Vec<f64>> = vec![vec![0.5; 6], vec![-0.4; 6], vec![0.1; 6]];
        let points = PointToPoint { points: Points::Given(given.clone()), dead_s: 0.7 };
        let excitation = ExcitationParts { series: false, additional: false, points: Some(points) };
        let settings = PlanSettings { levels: Some(Vec::new()), excitation, ..PlanSettings::default() };
        let plan = plan_cycle(&robot, &settings).unwrap();
        let stage: Vec<_> = plan.segments.iter().filter(|of| of.stage == Stage::Excitation).collect();
        // three rests with two moves between them
        assert_eq!(stage.len(), 5);
        for (segment, point) in stage.iter().step_by(2).zip(&given) {
            assert!((segment.duration - 0.7).abs() < 1e-12);
            let MotionPiece::Hold(posture) = segment.motion else { panic!("{:?}", segment.motion) };
            assert_eq!(&posture[..6], &point[..]);
        }
    }

    #[test]
    fn points_are_drawn_from_the_seed_inside_the_ranges_and_wrong_ones_are_refused() {
        let robot = er3a();
        let drawn = PointToPoint { points: Points::Drawn(20), dead_s: 0.0 };
        let postures = drawn.postures(&robot, 3).unwrap();
        assert_eq!(postures, drawn.postures(&robot, 3).unwrap());
        assert_ne!(postures, drawn.postures(&robot, 4).unwrap());
        for posture in &postures {
            for (q, joint) in posture.iter().zip(&robot.joints) {
                assert!((joint.limits.position_min..=joint.limits.position_max).contains(q));
            }
        }
        for (points, dead_s, said) in [
            (Points::Given(vec![vec![0.0; 5]; 2]), 0.0, "point 1: it has 5 positions, the arm 6 joints"),
            (Points::Given(vec![vec![0.0; 6], vec![9.0; 6]]), 0.0, "point 2: joint 1 at 9"),
            (Points::Drawn(1), 0.0, "2 or more"),
            (Points::Drawn(2), -1.0, "0 to 3600 s"),
        ] {
            let error = PointToPoint { points, dead_s }.postures(&robot, 1).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
    }
}
