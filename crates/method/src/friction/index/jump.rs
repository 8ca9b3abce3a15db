//! Jump of friction within a run.
//!
//! The friction map assumes that a run is from one gearbox that warms up. A seal that tears in the fifth cycle is no
//! warm-up: a fit as warm-up makes the joint colder at the start than it was, and its friction at equal temperature far
//! larger than it is. The points before such a jump are therefore scaled to the friction after it, and the index of the
//! run is that of its end.

use crate::friction::points::level_means::friction_means;
use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::map_run::MapRun;
use armwatch_model::robot::JointIndex;

/// Smallest number of cycles, with their points of a level, on each side of a jump: a single one may have met an
/// obstacle.
const LEAST_CYCLES: usize = 2;

/// Smallest jump, of the logarithm of friction. The detectors evaluate smaller ones, which have little effect on the
/// index.
const LEAST_JUMP: f64 = 0.08;

/// Smallest ratio of a jump to the largest other change between cycles. A joint whose friction varies from cycle to
/// cycle then has no jump.
const STANDS_OUT: f64 = 3.0;

/// Longest time between the cycles of a jump, as a multiple of the usual time. A longer rest cools the joint.
const LONGEST_REST: f64 = 1.5;

/// Weight of the first change among the others: a cold joint warms fastest there.
const FIRST_CHANGE: f64 = 0.5;

/// Number of nearest other changes, whose median estimates the effect of warming. A single jump among them hardly
/// changes it.
const NEIGHBOURS: usize = 4;

/// Jump of a joint's friction within a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrictionJump {
    /// Time of the first point after the jump, s since the start of the run.
    at: f64,
    /// Friction after the jump as a multiple of that before it.
    factor: f64,
}

impl FrictionJump {
    /// Factor that scales friction at `time`, s since the start of the run, to that after the jump.
    pub(in crate::friction) fn factor(&self, time: f64) -> f64 {
        if time < self.at { self.factor } else { 1.0 }
    }
}

/// Jump of friction of `joint` within a run; `None` if friction changes like in warm-up, in one cycle only, after a
/// rest, or equally from each cycle to the next.
///
/// The change between two cycles is the mean over the levels of the change of the logarithm of friction. Its difference
/// from the median of its neighbours decides.
pub(in crate::friction) fn jump(run: &MapRun, joint: JointIndex, levels: &[f64]) -> Option<FrictionJump> {
    let passes: Vec<Vec<(f64, f64)>> = levels.iter().map(|level| logarithms(run, joint, *level)).collect();
    let cycles = passes.iter().map(Vec::len).max()?;
    let whole: Vec<&Vec<(f64, f64)>> = passes.iter().filter(|of| of.len() == cycles).collect();
    let of_cycle = |cycle: usize| {
        let (times, values): (Vec<f64>, Vec<f64>) = whole.iter().map(|of| of[cycle]).unzip();
        Some((mean(&times)?, mean(&values)?, times.into_iter().fold(f64::INFINITY, f64::min)))
    };
    let means: Vec<(f64, f64, f64)> = (0..cycles).map(of_cycle).collect::<Option<_>>()?;
    let rests: Vec<f64> = means.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let changes: Vec<f64> = means.windows(2).map(|pair| pair[1].1 - pair[0].1).collect();
    let beyond = beyond_neighbours(&changes)?;
    let at = (LEAST_CYCLES - 1..beyond.len().checked_sub(LEAST_CYCLES - 1)?)
        .max_by(|a, b| beyond[*a].abs().total_cmp(&beyond[*b].abs()))?;
    let share = |other: usize| if other == 0 { FIRST_CHANGE } else { 1.0 };
    let others =
        (0..beyond.len()).filter(|other| *other != at).map(|other| share(other) * beyond[other].abs());
    let least = (STANDS_OUT * others.fold(0.0, f64::max)).max(LEAST_JUMP);
    let rested = rests[at] > LONGEST_REST * median(&rests)?;
    (beyond[at].abs() >= least && !rested)
        .then(|| FrictionJump { at: means[at + 1].2, factor: beyond[at].exp() })
}

/// Time, s since the start of the run, and logarithm of friction of each pass of a joint at one speed.
fn logarithms(run: &MapRun, joint: JointIndex, level: f64) -> Vec<(f64, f64)> {
    let means = friction_means(&run.points, joint, level);
    means.into_iter().filter(|mean| mean.torque > 0.0).map(|mean| (mean.time, mean.torque.ln())).collect()
}

/// Each change minus the median of its [`NEIGHBOURS`] nearest other changes.
fn beyond_neighbours(changes: &[f64]) -> Option<Vec<f64>> {
    let beyond = |at: usize| {
        let mut others: Vec<usize> = (0..changes.len()).filter(|other| *other != at).collect();
        others.sort_by_key(|other| other.abs_diff(at));
        let neighbours: Vec<f64> = others.iter().take(NEIGHBOURS).map(|other| changes[*other]).collect();
        Some(changes[at] - median(&neighbours)?)
    };
    (0..changes.len()).map(beyond).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::map_run::CycleMotion;
    use armwatch_model::analysis::{FrictionPoint, GravityRemoval};

    const LEVELS: [f64; 3] = [0.2, 0.6, 1.0];

    /// Run of one joint that warms up, with the given factor of friction by cycle and the rest before each, s.
    fn run(factors: &[f64], rests: &[f64]) -> MapRun {
        let (mut points, mut start) = (Vec::new(), 0.0);
        for (cycle, factor) in factors.iter().enumerate() {
            start += 200.0 + rests.get(cycle).copied().unwrap_or(0.0);
            let warm = 1.0 + 0.4 * (-start / 700.0).exp();
            for (place, level) in LEVELS.iter().enumerate() {
                for direction in [1, -1] {
                    let wobble = 1.0 + 0.004 * ((7 * cycle + 3 * place) as f64).sin();
                    points.push(FrictionPoint {
                        joint: JointIndex::new(0),
                        time: start + 10.0 * place as f64,
                        speed_fraction: *level,
                        speed: 4.0 * level,
                        direction,
                        torque: f64::from(direction) * (2.0 + 9.0 * level) * warm * factor * wobble,
                        std: 0.1,
                        samples: 50,
                        gravity: GravityRemoval::AxisVertical,
                        load: None,
                    });
                }
            }
        }
        MapRun { started_at: 0.0, spans: Vec::<CycleMotion>::new(), points }
    }

    fn found(factors: &[f64]) -> Option<FrictionJump> {
        jump(&run(factors, &[]), JointIndex::new(0), &LEVELS)
    }

    #[test]
    fn a_jump_is_found_with_its_cycle_and_size() {
        for (at, factor) in [(2, 1.25), (4, 1.25), (6, 1.25), (4, 0.75), (3, 1.15)] {
            let factors: Vec<f64> = (0..8).map(|cycle| if cycle < at { 1.0 } else { factor }).collect();
            let jump = found(&factors).unwrap_or_else(|| panic!("{factor} at {at}"));
            let first_after = 200.0 * f64::from(at + 1);
            assert_eq!(jump.at, first_after, "{factor} at {at}");
            assert!((jump.factor / factor - 1.0).abs() < 0.03, "{factor} at {at}: {jump:?}");
            assert_eq!((jump.factor(first_after - 1.0), jump.factor(first_after)), (jump.factor, 1.0));
        }
    }

    #[test]
    fn warming_one_odd_cycle_and_swings_are_no_jump() {
        assert_eq!(found(&[1.0; 8]), None);
        assert_eq!(found(&[1.0; 24]), None);
        for odd in 0..8 {
            let factors: Vec<f64> = (0..8).map(|cycle| if cycle == odd { 1.3 } else { 1.0 }).collect();
            assert_eq!(found(&factors), None, "cycle {odd}");
        }
        assert_eq!(found(&[1.1, 0.9, 1.12, 0.93, 1.08, 0.88, 1.1, 0.92]), None);
        assert_eq!(found(&[1.0, 1.0, 1.0, 1.25]), None, "one cycle after it says nothing");
        assert_eq!(found(&[]), None);
        assert_eq!(found(&[1.0]), None);
    }

    #[test]
    fn what_a_rest_does_is_left_to_the_thermal_state() {
        let factors = [1.0, 1.0, 1.0, 1.0, 1.2, 1.2, 1.2, 1.2];
        assert!(found(&factors).is_some());
        let rested = run(&factors, &[0.0, 0.0, 0.0, 0.0, 1800.0]);
        assert_eq!(jump(&rested, JointIndex::new(0), &LEVELS), None);
    }
}
