//! Friction over speed from slow motion without constant speed.

use super::plateau::{Plateau, SPEED_TOLERANCE};
use crate::segment::cycles::ranges_where;
use crate::signal::filter::FilteredSignals;
use armwatch_model::robot::{JointIndex, Robot};

/// Shortest pass of a slow motion through a level's speed, s.
const MIN_PASS_S: f64 = 0.15;

/// Smallest ratio between the numbers of rows with acceleration and with deceleration, or its inverse; below it,
/// inertia would appear as friction.
const LEAST_BALANCE: f64 = 0.5;

/// Friction over speed from slow motion back and forth without constant speed, such as a sinusoid of one joint. It uses
/// the rows within the tolerance of a level's speed, over passes with acceleration and passes of equal length with
/// deceleration. Inertia has opposite signs in the two, so their mean is friction. Gravity is removed as elsewhere.
pub(super) fn slow_passes(
    robot: &Robot,
    filtered: &FilteredSignals,
    joint: JointIndex,
    tested: &[usize],
) -> Vec<Plateau> {
    let qd = &filtered.qd[joint.index()];
    let fastest = robot.joints[joint.index()].limits.velocity;
    let shortest = (MIN_PASS_S * filtered.sample_rate).ceil().max(4.0) as usize;
    let mut found = Vec::new();
    for &speed_fraction in &robot.speed_levels {
        let speed = speed_fraction * fastest;
        for direction in [-1_i8, 1] {
            let along = |row: usize| qd[row] * f64::from(direction);
            let near = |i: usize| (along(tested[i]) - speed).abs() <= SPEED_TOLERANCE * speed;
            let (mut rows, mut faster, mut slower) = (Vec::new(), 0, 0);
            for range in ranges_where(tested.len(), near) {
                let pass = &tested[range];
                let (Some(first), Some(last)) = (pass.first(), pass.last()) else { continue };
                let is_whole = last - first + 1 == pass.len();
                if pass.len() < shortest || !is_whole {
                    continue;
                }
                // around a maximum of the speed, one pass does both
                let peak =
                    pass.iter().copied().max_by(|a, b| along(*a).total_cmp(&along(*b))).unwrap_or(*last);
                faster += peak - first;
                slower += last - peak;
                rows.extend_from_slice(pass);
            }
            let balanced = faster.min(slower) as f64 >= LEAST_BALANCE * faster.max(slower) as f64;
            if faster.min(slower) > 0 && balanced {
                found.push(Plateau { speed_fraction, direction, rows });
            }
        }
    }
    found
}

/// Remark about a joint with points from slow passes.
pub(super) fn slow_remark(robot: &Robot, joint: JointIndex, passes: &[Plateau]) -> String {
    let mut seen: Vec<f64> = passes.iter().map(|pass| pass.speed_fraction).collect();
    seen.dedup();
    let percent = |levels: &[f64]| {
        levels
            .iter()
            .map(|level| format!("{:.3}", 100.0 * level))
            .map(|p| p.trim_end_matches('0').trim_end_matches('.').to_owned())
            .collect::<Vec<_>>()
            .join(", ")
    };
    let missing: Vec<f64> =
        robot.speed_levels.iter().copied().filter(|level| !seen.contains(level)).collect();
    let missing = match missing.is_empty() {
        true => String::new(),
        false => format!("; it does not pass slowly through {} %", percent(&missing)),
    };
    format!(
        "joint {joint} holds no constant speed; its friction at {} % of its largest speed is from slow passes through these \
         speeds{missing}",
        percent(&seen)
    )
}

#[cfg(test)]
mod tests {
    use crate::friction::points::plateaus::tests::{RATE, TOLERANCE, friction, one_joint, points};
    use armwatch_model::robot::Robot;
    use armwatch_model::run::{Samples, Stage};

    /// Joint in a slow sinusoidal motion with the largest speed `peak`.
    fn sinusoid(robot: &Robot, peak: f64, frequency: f64, load: impl Fn(f64) -> f64) -> Samples {
        let omega = std::f64::consts::TAU * frequency;
        let mut samples = Samples { position: vec![vec![]], torque: vec![vec![]], ..Samples::default() };
        let mut velocity = Vec::new();
        for row in 0..(60.0 * RATE) as usize {
            let t = row as f64 / RATE;
            let (q, v, a) = (
                peak / omega * (omega * t).sin(),
                peak * (omega * t).cos(),
                -peak * omega * (omega * t).sin(),
            );
            samples.time.push(t);
            samples.position[0].push(q);
            velocity.push(v);
            samples.torque[0].push(0.4 * a + friction(v) + load(q));
            samples.stage.push(Stage::Friction);
        }
        samples.velocity = Some(vec![velocity; robot.joint_count()]);
        samples
    }

    #[test]
    fn a_slow_sinusoid_gives_friction_at_the_speeds_that_it_passes_slowly() {
        for with_gravity in [false, true] {
            let mut robot = one_joint(with_gravity);
            robot.joints[0].limits.velocity = 0.5;
            let load = |q: f64| if with_gravity { 11.0 * q.cos() - 4.0 * q.sin() } else { 0.0 };
            for (peak, frequency, levels) in
                [(0.5, 0.05, &[0.4, 0.6, 0.8, 1.0][..]), (0.35, 0.1, &[0.4, 0.6])]
            {
                let found = points(&robot, &sinusoid(&robot, peak, frequency, load));
                let seen: Vec<(f64, i8)> =
                    found.points.iter().map(|p| (p.speed_fraction, p.direction)).collect();
                let expected: Vec<(f64, i8)> =
                    levels.iter().flat_map(|level| [(*level, -1), (*level, 1)]).collect();
                assert_eq!(seen, expected, "{:?}", found.remarks);
                for point in &found.points {
                    let truth = friction(point.speed);
                    let along = point.torque * f64::from(point.direction);
                    assert!((along - truth).abs() < 2.0 * TOLERANCE * truth, "{point:?} {truth}");
                }
                assert!(found.remarks[0].contains("is from slow passes"), "{:?}", found.remarks);
            }
        }
    }

    #[test]
    fn a_fast_sinusoid_gives_no_friction_points() {
        let robot = one_joint(false);
        let found = points(&robot, &sinusoid(&robot, 4.0, 1.0, |_| 0.0));
        assert_eq!(found.points, vec![], "{:?}", found.remarks);
    }
}
