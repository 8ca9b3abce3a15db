//! Mean friction of both directions, for comparisons over time: offsets cancel.

use crate::statistics::descriptive::mean;
use armwatch_model::analysis::FrictionPoint;
use armwatch_model::robot::JointIndex;

/// Longest time between plateaus of the two directions that belong together, s: a joint moves back and forth at one
/// level within seconds, and cycles are minutes apart.
pub(crate) const SAME_PASS_S: f64 = 60.0;

/// Friction at one level in one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrictionMean {
    /// The joint.
    pub joint: JointIndex,
    /// Mean time since the start of the run, s.
    pub time: f64,
    /// Nominal speed as a fraction of the joint's largest speed.
    pub speed_fraction: f64,
    /// Mean of the magnitudes of both directions, Nm.
    pub torque: f64,
}

/// Means over both directions of neighbouring plateaus of one joint and level, in the order of `points`. If a joint was
/// never measured in both directions, its single values.
///
/// `points` may contain several consecutive runs, if the points of each cycle are consecutive.
#[must_use]
pub fn friction_means(points: &[FrictionPoint], joint: JointIndex, speed_fraction: f64) -> Vec<FrictionMean> {
    let found = |time, torque| FrictionMean { joint, time, speed_fraction, torque };
    let of_level: Vec<&FrictionPoint> = at_level(points, joint, speed_fraction).collect();
    let pairs = passes(&of_level);
    if pairs.is_empty() {
        return of_level.iter().map(|p| found(p.time, p.torque.abs())).collect();
    }
    let middle = |[p, q]: [&FrictionPoint; 2]| {
        found(f64::midpoint(p.time, q.time), f64::midpoint(p.torque.abs(), q.torque.abs()))
    };
    pairs.into_iter().map(middle).collect()
}

/// Mean difference of the directions, forward minus backward magnitude, over neighbouring plateaus of one joint and
/// level, Nm; zero without any.
#[must_use]
pub(crate) fn direction_difference(points: &[FrictionPoint], joint: JointIndex, speed_fraction: f64) -> f64 {
    let along = |p: &FrictionPoint| p.torque.abs() * f64::from(p.direction);
    let of_level: Vec<&FrictionPoint> = at_level(points, joint, speed_fraction).collect();
    let differences: Vec<f64> = passes(&of_level).into_iter().map(|[p, q]| along(p) + along(q)).collect();
    mean(&differences).unwrap_or(0.0)
}

/// Points of a joint at a level, a fraction of its largest speed.
#[expect(clippy::float_cmp, reason = "levels are copied from one list, never computed")]
pub(crate) fn at_level(
    points: &[FrictionPoint],
    joint: JointIndex,
    level: f64,
) -> impl Iterator<Item = &FrictionPoint> {
    points.iter().filter(move |p| p.joint == joint && p.speed_fraction == level)
}

/// Level nearest to `wanted`, both as fractions of the largest speed.
#[must_use]
pub fn nearest_level(levels: impl Iterator<Item = f64>, wanted: f64) -> Option<f64> {
    let distance = |level: f64| (level - wanted).abs();
    levels.min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
}

/// Neighbours of opposite direction that belong to one pass of a level.
fn passes<'a>(of_level: &[&'a FrictionPoint]) -> Vec<[&'a FrictionPoint; 2]> {
    let (mut pairs, mut at) = (Vec::new(), 0);
    while let [p, q, ..] = of_level[at..] {
        let together = p.direction != q.direction && (p.time - q.time).abs() <= SAME_PASS_S;
        if together {
            pairs.push([p, q]);
        }
        at += if together { 2 } else { 1 };
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::GravityRemoval;

    fn point(time: f64, direction: i8, torque: f64) -> FrictionPoint {
        FrictionPoint {
            joint: JointIndex::new(0),
            time,
            speed_fraction: 0.6,
            speed: 2.0,
            direction,
            torque,
            std: 0.1,
            samples: 50,
            gravity: GravityRemoval::AxisVertical,
            load: None,
        }
    }

    #[test]
    fn an_offset_of_torque_cancels_and_a_lone_direction_is_left_out() {
        let points =
            [point(10.0, -1, -9.0), point(12.0, 1, 11.0), point(300.0, 1, 10.9), point(600.0, -1, -8.8)];
        let found = friction_means(&points, JointIndex::new(0), 0.6);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].time, found[0].torque), (11.0, 10.0));
        assert_eq!(direction_difference(&points, JointIndex::new(0), 0.6), 2.0);
    }

    #[test]
    fn one_direction_alone_is_taken_as_it_is() {
        let points = [point(10.0, -1, -9.0), point(310.0, -1, -8.0)];
        let torques: Vec<f64> =
            friction_means(&points, JointIndex::new(0), 0.6).iter().map(|m| m.torque).collect();
        assert_eq!(torques, [9.0, 8.0]);
        assert!(friction_means(&points, JointIndex::new(1), 0.6).is_empty());
    }
}
