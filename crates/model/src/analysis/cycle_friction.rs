//! Friction of a joint in a cycle as one number: the geometric mean over the speed levels.
//!
//! A factor that is equal at all speeds, as of wear, adds its logarithm to that of the mean, whatever the levels.

use crate::analysis::FrictionPoint;
use crate::analysis::friction::CycleFriction;
use crate::robot::JointIndex;

/// Nominal speeds closer than this are one level, as fractions of the largest.
const SAME_LEVEL: f64 = 1e-6;

/// Friction of each joint with points in a cycle, ascending. Omits levels without both directions, or with torques that
/// do not oppose the motion.
#[must_use]
pub fn cycle_friction(points: &[FrictionPoint]) -> Vec<CycleFriction> {
    let mut joints: Vec<JointIndex> = points.iter().map(|point| point.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    let of_joint = |joint| {
        let mut own: Vec<&FrictionPoint> = points.iter().filter(|point| point.joint == joint).collect();
        own.sort_by(|a, b| a.speed_fraction.total_cmp(&b.speed_fraction));
        let levels = own.chunk_by(|a, b| (a.speed_fraction - b.speed_fraction).abs() < SAME_LEVEL);
        composite(joint, levels.filter_map(level))
    };
    joints.into_iter().filter_map(of_joint).collect()
}

/// One level: mean time, s, speed, half the difference of the directions and half their sum.
struct LevelFriction {
    time: f64,
    speed_fraction: f64,
    torque: f64,
    offset: f64,
}

fn level(points: &[&FrictionPoint]) -> Option<LevelFriction> {
    let mean = |direction: i8| {
        let own = points.iter().filter(|point| point.direction == direction);
        let (sum, count) = own.fold((0.0, 0.0), |(sum, count), point| (sum + point.torque, count + 1.0));
        (count > 0.0).then(|| sum / count)
    };
    let (forward, backward) = (mean(1)?, mean(-1)?);
    let torque = 0.5 * (forward - backward);
    (torque > 0.0).then(|| LevelFriction {
        time: points.iter().map(|point| point.time).sum::<f64>() / points.len() as f64,
        speed_fraction: points[0].speed_fraction,
        torque,
        offset: 0.5 * (forward + backward),
    })
}

fn composite(joint: JointIndex, levels: impl Iterator<Item = LevelFriction>) -> Option<CycleFriction> {
    let levels: Vec<LevelFriction> = levels.collect();
    let count = levels.len() as f64;
    let mean = |of: fn(&LevelFriction) -> f64| levels.iter().map(of).sum::<f64>() / count;
    let found = CycleFriction {
        joint,
        minute: mean(|level| level.time) / 60.0,
        ln_torque: mean(|level| level.torque.ln()),
        offset: mean(|level| level.offset),
        levels: u32::try_from(levels.len()).ok()?,
        speed_fraction: mean(|level| level.speed_fraction),
    };
    (!levels.is_empty() && found.ln_torque.is_finite() && found.offset.is_finite()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::GravityRemoval;

    fn point(joint: usize, speed_fraction: f64, direction: i8, torque: f64) -> FrictionPoint {
        FrictionPoint {
            joint: JointIndex::new(joint),
            time: 60.0,
            speed_fraction,
            speed: speed_fraction,
            direction,
            torque,
            std: 0.1,
            samples: 10,
            gravity: GravityRemoval::Fitted,
            load: None,
        }
    }

    #[test]
    fn wear_adds_its_logarithm_and_an_offset_stays_apart() {
        let cycle = |wear: f64, offset: f64| {
            let levels = [(0.1, 5.0), (0.5, 9.0), (1.0, 7.0)];
            let points: Vec<_> = levels
                .iter()
                .flat_map(|(speed, torque)| {
                    [1_i8, -1].map(|d| point(2, *speed, d, f64::from(d) * torque * wear + offset))
                })
                .collect();
            cycle_friction(&points)[0]
        };
        let (healthy, worn) = (cycle(1.0, 0.0), cycle(1.2, 0.7));
        assert!((worn.ln_torque - healthy.ln_torque - 1.2_f64.ln()).abs() < 1e-12);
        assert!((worn.offset - 0.7).abs() < 1e-12 && healthy.offset.abs() < 1e-12);
        assert!(worn.compares_with(&healthy) && (worn.minute - 1.0).abs() < 1e-12);
    }

    #[test]
    fn levels_that_say_nothing_are_left_out() {
        let points = [point(0, 0.1, 1, 4.0), point(0, 0.5, 1, -3.0), point(0, 0.5, -1, 3.0)];
        assert!(cycle_friction(&points).is_empty());
        let more = [&points[..], &[point(0, 0.1, -1, -4.0)]].concat();
        assert_eq!(cycle_friction(&more)[0].levels, 1);
    }
}
