//! Unfolding of rotary joints' angles that are folded into one turn: adds whole turns at each jump, so that the angle
//! is continuous.

use std::borrow::Cow;
use std::f64::consts::{PI, TAU};

use super::arrival::usual_step;
use crate::lanes::{extent, largest_step};
use armwatch_model::robot::{Joint, JointIndex, JointKind, Robot};
use armwatch_model::run::Samples;

/// Multiple of a joint's largest speed that no joint reaches: a larger step between rows is no motion.
pub(crate) const LEAP: f64 = 4.0;

/// Largest part of a turn, for noise, between folded angles and one turn.
const BEYOND_TURN: f64 = 0.01;

/// Unfolds the positions of rotary joints, and returns a remark about each joint whose angle was folded.
///
/// A step of half a turn or more is a fold if the joint's speed allows the remainder after whole turns. A channel is
/// unfolded only if all such steps are folds and it stays within one turn, which excludes positions in another unit.
/// The whole turns of the first row are those that bring the motion inside the joint's limits.
pub fn unfold(robot: &Robot, samples: &mut Cow<'_, Samples>) -> Vec<String> {
    let mut remarks = Vec::new();
    for joint in robot.joint_indices() {
        let of = &robot.joints[joint.index()];
        let Some(channel) = samples.position.get(joint.index()) else { continue };
        if of.kind != JointKind::Revolute || largest_step(channel) < PI {
            continue;
        }
        let Some((unfolded, folds)) = unfolded(of, channel, &samples.time) else { continue };
        samples.to_mut().position[joint.index()] = unfolded;
        remarks.push(remark(joint, folds));
    }
    remarks
}

fn remark(joint: JointIndex, folds: usize) -> String {
    let places = if folds == 1 { "place" } else { "places" };
    format!("joint {joint}: its angle is folded into one turn; it is unfolded in {folds} {places}")
}

/// Unfolded angle and its number of folds; `None` if some jump is no fold.
fn unfolded(joint: &Joint, channel: &[f64], time: &[f64]) -> Option<(Vec<f64>, usize)> {
    let [low, high] = extent(channel);
    if high - low > TAU * (1.0 + BEYOND_TURN) {
        return None;
    }
    let usual = usual_step(time)?;
    let (mut turns, mut folds) = (0.0, 0);
    let mut unfolded = Vec::with_capacity(channel.len());
    unfolded.extend(channel.first());
    for row in 1..channel.len() {
        let step = channel[row] - channel[row - 1];
        if step.abs() >= PI {
            let reached = LEAP * joint.limits.velocity * (time[row] - time[row - 1]).max(usual);
            let whole = (step / TAU).round();
            if (step - whole * TAU).abs() > reached {
                return None;
            }
            turns -= whole;
            folds += 1;
        }
        unfolded.push(channel[row] + turns * TAU);
    }
    let [low, high] = extent(&unfolded);
    let centre = 0.5 * (joint.limits.position_min + joint.limits.position_max);
    let shift = ((centre - 0.5 * (low + high)) / TAU).round() * TAU;
    let outside = |shift: f64| {
        (joint.limits.position_min - low - shift).max(high + shift - joint.limits.position_max).max(0.0)
    };
    if outside(shift) < outside(0.0) {
        unfolded.iter_mut().for_each(|angle| *angle += shift);
    }
    Some((unfolded, folds))
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::Stage;
    use armwatch_testing::er3a;

    fn samples(position: Vec<f64>, step: f64) -> Samples {
        let rows = position.len();
        let still = vec![0.0; rows];
        Samples {
            time: (0..rows).map(|row| step * row as f64).collect(),
            position: vec![
                still.clone(),
                still.clone(),
                still.clone(),
                still.clone(),
                still.clone(),
                position,
            ],
            velocity: None,
            torque: vec![still; 6],
            stage: vec![Stage::Excitation; rows],
            cycle: None,
            friction_signal: None,
            temperatures: None,
        }
    }

    fn unfolded_of(position: Vec<f64>, step: f64) -> (Vec<f64>, Vec<String>) {
        let mut samples = Cow::Owned(samples(position, step));
        let remarks = unfold(&er3a(), &mut samples);
        (samples.position[5].clone(), remarks)
    }

    fn folded(angle: f64, from: f64) -> f64 {
        (angle - from).rem_euclid(TAU) + from
    }

    #[test]
    fn angles_go_on_at_any_count_rate_and_convention() {
        let limit = er3a().joints[5].limits;
        for rate in [30.0, 50.0, 250.0, 1000.0] {
            // crosses a fold at its largest speed, hundreds of times
            let amplitude = 0.9 * limit.position_max.min(1.7 * PI);
            let angle = |row: usize| {
                let t = row as f64 / rate;
                amplitude * (limit.velocity / amplitude * t).sin() + 1e-4 * (977.0 * t).sin()
            };
            let truth: Vec<f64> = (0..(120.0 * rate) as usize).map(angle).collect();
            for from in [-PI, 0.0] {
                let recorded: Vec<f64> = truth.iter().map(|angle| folded(*angle, from)).collect();
                let (found, remarks) = unfolded_of(recorded, 1.0 / rate);
                assert_eq!(remarks.len(), 1, "{rate} Hz from {from}");
                assert!(remarks[0].starts_with("joint 6: its angle is folded"), "{remarks:?}");
                for (found, truth) in found.iter().zip(&truth) {
                    assert!((found - truth).abs() < 1e-9, "{rate} Hz from {from}: {found} {truth}");
                }
            }
        }
    }

    #[test]
    fn other_jumps_and_other_units_stay() {
        let sine = |row: usize| 2.5 * (0.01 * row as f64).sin();
        let plain: Vec<f64> = (0..4000).map(sine).collect();
        let mut lost = plain.clone();
        lost[2000] -= 4.0;
        let in_degrees: Vec<f64> =
            (0..4000).map(|row| (90.0 * sine(row) + 180.0).rem_euclid(360.0) - 180.0).collect();
        let fast: Vec<f64> = (0..4000).map(|row| 170.0 * (0.05 * f64::from(row)).sin()).collect();
        for recorded in [plain, lost, in_degrees, fast] {
            assert_eq!(unfolded_of(recorded.clone(), 0.02), (recorded, vec![]));
        }
    }
}
