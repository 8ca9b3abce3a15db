//! Motions of single joints back and forth: over the range near full speed, through a friction level, to warm up.

use std::f64::consts::TAU;

use super::blend::MOVE_MIN_S;
use super::motion::{PerJoint, Plateaus, RAMP_EDGE, Shuttle, Stroke};
use armwatch_model::robot::{Joint, JointIndex, JointLimits};

/// Share of the position range for strokes over the whole range.
pub(super) const RANGE_USE: f64 = 0.985;
/// Share of the largest acceleration and speed for full-speed motions.
const FULL_USE: f64 = 0.985;
/// Shortest ramp of a friction level, s: a third of the shortest move.
const RAMP_MIN_S: f64 = MOVE_MIN_S / 3.0;
/// Longest stroke of the full-speed trajectory, s: a joint of many turns needs no more.
const FULL_SPEED_STROKE_S: f64 = 2.5;
/// Intended and longest duration of a friction level, s.
const LEVEL_S: [f64; 2] = [3.6, 5.0];
/// Share of the largest acceleration for ramps with enough space.
const GENTLE_RAMP: f64 = 0.7;
/// A plateau shorter than this is lengthened by steeper ramps, s.
const PLATEAU_SHORT_S: f64 = 0.35;
/// Shortest plateau, s: five rows at 50 Hz. A joint whose range is too short for it runs slower.
pub(super) const PLATEAU_MIN_S: f64 = 0.1;
/// Share of range and of speed for the warming stage.
const WARMING_RANGE: f64 = 0.8;
const WARMING_SPEED: f64 = 0.8;

/// Middle and width of a joint's range, rad (m).
pub(super) fn middle_and_range(limits: &JointLimits) -> (f64, f64) {
    (0.5 * (limits.position_min + limits.position_max), limits.position_max - limits.position_min)
}

/// Back and forth over the range in the shortest time that limits allow [4.22-4.24]. Neighbouring joints move in
/// opposite directions, which distinguishes their parameters.
pub(super) fn full_speed(joint: &Joint, from_the_top: bool) -> Shuttle {
    let (middle, range) = middle_and_range(&joint.limits);
    let (speed, acceleration) = (FULL_USE * joint.limits.velocity, FULL_USE * joint.limits.acceleration);
    let jerk = usable_jerk(&joint.limits);
    let travel = (RANGE_USE * range).min(0.5 * speed * FULL_SPEED_STROKE_S);
    let direction = if from_the_top { -1.0 } else { 1.0 };
    Shuttle {
        start: middle - 0.5 * direction * travel,
        travel: direction * travel,
        stroke_s: cycloid_s(travel, speed, acceleration, jerk),
        strokes: 2,
    }
}

/// Shortest cycloid over `travel`: its peaks are `2 D/T`, `2 pi D/T²` [4.23, 4.24] and `4 pi² D/T³`.
fn cycloid_s(travel: f64, speed: f64, acceleration: f64, jerk: f64) -> f64 {
    let by_acceleration = (TAU * travel / acceleration).sqrt();
    (2.0 * travel / speed).max(by_acceleration).max((TAU * TAU * travel / jerk).cbrt())
}

/// Jerk limit of motions; infinite for a joint without such a limit.
fn usable_jerk(limits: &JointLimits) -> f64 {
    limits.jerk.map_or(f64::INFINITY, |jerk| FULL_USE * jerk)
}

/// Back and forth for exactly `warming_s` seconds; over less of the range if even one round trip over it takes longer.
pub(super) fn warming_shuttle(joint: &Joint, warming_s: f64) -> Shuttle {
    let (middle, range) = middle_and_range(&joint.limits);
    let (speed, acceleration) = (WARMING_SPEED * joint.limits.velocity, FULL_USE * joint.limits.acceleration);
    let (travel, jerk) = (WARMING_RANGE * range, usable_jerk(&joint.limits));
    let rounds = (warming_s / (2.0 * cycloid_s(travel, speed, acceleration, jerk))).floor().max(1.0);
    let stroke_s = 0.5 * warming_s / rounds;
    let reachable = (0.5 * speed * stroke_s)
        .min(acceleration * stroke_s * stroke_s / TAU)
        .min(jerk * stroke_s.powi(3) / (TAU * TAU));
    let travel = travel.min(reachable);
    Shuttle { start: middle - 0.5 * travel, travel, stroke_s, strokes: 2 * rounds as u32 }
}

/// The strokes of one friction level, from the posture upwards and back.
pub(super) fn level_motion(joint: &Joint, index: JointIndex, posture: PerJoint, fraction: f64) -> Plateaus {
    let room = RANGE_USE * (joint.limits.position_max - joint.limits.position_min);
    let stroke = level_stroke(&joint.limits, room, fraction.clamp(1e-3, 1.0));
    let pairs = (LEVEL_S[1] / (2.0 * stroke.duration())).floor();
    let wanted = (LEVEL_S[0] / (2.0 * stroke.duration())).ceil();
    Plateaus { posture, joint: index.index(), stroke, strokes: 2 * pairs.min(wanted).max(1.0) as u32 }
}

fn level_stroke(limits: &JointLimits, room: f64, fraction: f64) -> Stroke {
    let speed = fraction * limits.velocity;
    // the jerk of a ramp's edge is speed / (edge (1 - edge) ramp²), with the edge as a fraction of the ramp
    let jerk = RAMP_EDGE * (1.0 - RAMP_EDGE) * usable_jerk(limits);
    let by_jerk = |speed: f64| (speed / jerk).sqrt();
    let ramp = |part: f64| {
        let by_acceleration = speed / ((1.0 - RAMP_EDGE) * part * limits.acceleration);
        by_acceleration.max(by_jerk(speed)).max(RAMP_MIN_S)
    };
    let plateau = |ramp_s: f64| (room / speed - ramp_s).min(0.5 * LEVEL_S[0] - 2.0 * ramp_s);
    let gentle = ramp(GENTLE_RAMP);
    if plateau(gentle) >= PLATEAU_SHORT_S {
        return Stroke { speed, ramp_s: gentle, plateau_s: plateau(gentle) };
    }
    let steep = ramp(FULL_USE);
    let plateau_s = room / speed - steep;
    if plateau_s >= PLATEAU_MIN_S {
        return Stroke { speed, ramp_s: steep, plateau_s: plateau_s.min(PLATEAU_SHORT_S) };
    }
    // speed (plateau + speed / a) = room: the highest speed that leaves space for the shortest plateau
    let a = (1.0 - RAMP_EDGE) * FULL_USE * limits.acceleration;
    let reachable = 0.5 * a * ((PLATEAU_MIN_S * PLATEAU_MIN_S + 4.0 * room / a).sqrt() - PLATEAU_MIN_S);
    // speed (plateau + sqrt(speed / jerk)) = room grows with the speed
    let mut speed = speed.min(reachable);
    while speed * (PLATEAU_MIN_S + by_jerk(speed)) > room {
        speed *= 0.99;
    }
    let ramp_s = (speed / a).max(by_jerk(speed));
    Stroke { speed, ramp_s, plateau_s: (room / speed - ramp_s).max(0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_range_too_short_for_a_level_slows_it_down() {
        let limits = JointLimits {
            position_min: -0.2,
            position_max: 0.2,
            velocity: 4.0,
            acceleration: 8.0,
            jerk: None,
        };
        let room = RANGE_USE * 0.4;
        let stroke = level_stroke(&limits, room, 1.0);
        assert!(stroke.speed < 4.0 && (stroke.plateau_s - PLATEAU_MIN_S).abs() < 1e-12);
        assert!((stroke.travel() - room).abs() < 1e-12);
        assert!(stroke.peak_acceleration() <= 8.0);
    }
}
