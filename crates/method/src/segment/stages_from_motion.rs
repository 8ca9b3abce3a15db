//! Stages from the motion alone, for exports without any signal.
//!
//! A joint moves if it is at its low-speed threshold or faster. A block is a sequence of rows with several moving
//! joints, with one, or with none. An interruption shorter than [`SETTLE_S`] belongs to the block around it, so brief
//! stops and crossings of the threshold do not cut a block. A block of one joint is friction. The first blocks of
//! several joints are excitation, those after friction are warming, and the next after warming begin another cycle.
//! Shorter blocks are moves between stages. At most the rows of [`BLOCK_S`] and [`SETTLE_S`] are pending.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use armwatch_model::run::{RawSamples, Samples, Stage};

/// Shortest duration of a change of motion, s; shorter ones belong to the motion around them. A turning point takes
/// some tenths of a second, a rest between cycles takes longer than this.
pub const SETTLE_S: f64 = 1.0;

/// Shortest block that is a stage, s. Moves to the next posture take one to three seconds; a joint's friction test or
/// an excitation takes more than ten.
pub const BLOCK_S: f64 = 5.0;

/// Time between positions whose difference gives the velocity if none is recorded, s: long relative to noise of the
/// position, short relative to a ramp.
const DIFFERENCE_S: f64 = 0.05;

/// Largest number of rows between differenced positions: those of [`DIFFERENCE_S`] at 80 kHz. Without it, times that
/// hardly advance would collect rows without limit.
const MOST_RECENT: usize = 4096;

/// Duration of the moving state after a joint moved, s. Without it, each turning point would end the motion.
const HOLD_S: f64 = 0.3;

/// Number of joints that move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum MovingJoints {
    /// No joint.
    #[default]
    Rest,
    /// One joint.
    OneJoint,
    /// Several joints.
    Several,
}

/// Progress of a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum MotionPhase {
    /// At its start, or in the excitation.
    #[default]
    Begun,
    /// In the friction stage.
    Friction,
    /// In the warming stage.
    Warming,
}

/// Finds stages from the motion, row by row.
#[derive(Debug, Default)]
pub(crate) struct MotionFinder {
    /// Low-speed thresholds by joint, rad/s (m/s).
    low_speed: Vec<f64>,
    /// Rows without a stage: those of the present block while it is short, and those of a possible next block.
    held: RawSamples,
    /// Number of held rows in the present block.
    in_block: usize,
    state: MotionFinderState,
}

/// State of the motion before the next row, without the pending rows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MotionFinderState {
    /// Time of the last motion of each joint, s, `[n]`.
    pub moved: Vec<Option<f64>>,
    /// Latest times, s, and positions, rad (m), `[n]` each, for speeds that are not recorded.
    pub recent: VecDeque<(f64, Vec<f64>)>,
    /// Motion of the present block.
    pub block: MovingJoints,
    /// Start of the block, s.
    pub block_start: Option<f64>,
    /// Time of the block's last row, s.
    pub block_last: Option<f64>,
    /// Time of the previous row, s.
    pub last: Option<f64>,
    /// Stage of the block, once it is long enough.
    pub stage: Option<Stage>,
    /// Another motion, and the time since which it lasts, s.
    pub candidate: Option<(MovingJoints, f64)>,
    /// Progress of the cycle.
    pub phase: MotionPhase,
}

impl MotionFinder {
    /// Creates a finder at the start of a recording; `low_speed` `[n]` is the threshold of each joint, rad/s (m/s).
    #[must_use]
    pub fn new(low_speed: Vec<f64>) -> Self {
        let state = MotionFinderState { moved: vec![None; low_speed.len()], ..MotionFinderState::default() };
        Self { low_speed, state, ..Self::default() }
    }

    /// Continues at `state` of another finder. Rows that are pending in the other finder are not returned; later rows
    /// get the same stages without them.
    #[must_use]
    pub fn at(self, state: MotionFinderState) -> Self {
        Self { state, ..self }
    }

    /// State before the next row.
    #[must_use]
    pub fn state(&self) -> &MotionFinderState {
        &self.state
    }

    /// Number of pending rows.
    #[must_use]
    pub fn held_rows(&self) -> usize {
        self.held.rows()
    }

    /// Adds rows and returns those whose stage is known.
    #[must_use]
    pub fn push(&mut self, rows: RawSamples) -> Samples {
        let first_new = self.held.rows();
        self.held.append(rows);
        let mut stages = Vec::new();
        for row in first_new..self.held.rows() {
            let (time, motion) = (self.held.time[row], self.motion(row));
            self.state.block_start.get_or_insert(time);
            if motion == self.state.block {
                self.state.candidate = None;
                (self.in_block, self.state.block_last) = (row + 1, Some(time));
            } else {
                self.follow(motion, row, time, &mut stages);
            }
            self.settle_block(&mut stages);
            self.state.last = Some(time);
        }
        self.in_block -= stages.len();
        self.held.take_front(stages.len()).with_stages(stages)
    }

    /// Ends the recording and returns the pending rows.
    #[must_use]
    pub fn finish(&mut self) -> Samples {
        let rows = std::mem::take(&mut self.held);
        let stages = vec![self.state.stage.unwrap_or(Stage::Between); rows.rows()];
        rows.with_stages(stages)
    }

    /// Notes a motion in `row` that differs from the block's.
    fn follow(&mut self, motion: MovingJoints, row: usize, time: f64, stages: &mut Vec<Stage>) {
        match self.state.candidate {
            Some((known, since)) if known == motion => {
                if time - since >= SETTLE_S {
                    stages.resize(self.in_block, self.state.stage.unwrap_or(Stage::Between));
                    (self.state.block, self.state.block_start) = (motion, Some(since));
                    (self.state.stage, self.state.candidate) = (None, None);
                    (self.in_block, self.state.block_last) = (row + 1, Some(time));
                }
            }
            // the previous candidate was too short
            _ => {
                self.state.candidate = Some((motion, time));
                (self.in_block, self.state.block_last) = (row, self.state.last);
            }
        }
    }

    /// Assigns the present block its stage as soon as it is long enough, and its rows the same stage.
    fn settle_block(&mut self, stages: &mut Vec<Stage>) {
        if self.state.stage.is_none() {
            let lasted = self.state.block_last.zip(self.state.block_start);
            let lasted = lasted.map_or(0.0, |(last, start)| last - start);
            if self.state.block != MovingJoints::Rest && lasted < BLOCK_S {
                return;
            }
            self.state.stage = Some(self.stage_of_block());
        }
        stages.resize(self.in_block.max(stages.len()), self.state.stage.unwrap_or(Stage::Between));
    }

    fn stage_of_block(&mut self) -> Stage {
        let (stage, phase) = match (self.state.block, self.state.phase) {
            (MovingJoints::Rest, phase) => (Stage::Between, phase),
            (MovingJoints::OneJoint, _) => (Stage::Friction, MotionPhase::Friction),
            (MovingJoints::Several, MotionPhase::Friction) => (Stage::Warming, MotionPhase::Warming),
            (MovingJoints::Several, MotionPhase::Begun | MotionPhase::Warming) => {
                (Stage::Excitation, MotionPhase::Begun)
            }
        };
        self.state.phase = phase;
        stage
    }

    fn motion(&mut self, row: usize) -> MovingJoints {
        let time = self.held.time[row];
        let speeds: Vec<f64> = match &self.held.velocity {
            Some(velocity) => velocity.iter().map(|qd| qd[row].abs()).collect(),
            None => self.speeds_by_position(row),
        };
        for ((moved, speed), low) in self.state.moved.iter_mut().zip(speeds).zip(&self.low_speed) {
            if speed >= *low {
                *moved = Some(time);
            }
        }
        let moving = self.state.moved.iter().flatten().filter(|moved| time - **moved <= HOLD_S);
        match moving.count() {
            0 => MovingJoints::Rest,
            1 => MovingJoints::OneJoint,
            _ => MovingJoints::Several,
        }
    }

    /// Speeds of the joints from their positions over the last [`DIFFERENCE_S`].
    fn speeds_by_position(&mut self, row: usize) -> Vec<f64> {
        let time = self.held.time[row];
        let q: Vec<f64> = self.held.position.iter().map(|q| q[row]).collect();
        let is_long = |(then, _): &(f64, Vec<f64>)| time - then >= DIFFERENCE_S;
        while self.state.recent.len() > MOST_RECENT || self.state.recent.get(1).is_some_and(is_long) {
            self.state.recent.pop_front();
        }
        let speeds = match self.state.recent.front() {
            Some((then, before)) => {
                q.iter().zip(before).map(|(q, before)| (q - before).abs() / (time - then)).collect()
            }
            None => vec![0.0; q.len()],
        };
        self.state.recent.push_back((time, q));
        speeds
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const RATE: f64 = 50.0;

    /// Rows with these joints moving (one bit each), each for some seconds; speeds change sign every second.
    fn recording(parts: &[(u8, f64)], with_velocity: bool) -> RawSamples {
        let mut samples = RawSamples {
            position: vec![Vec::new(); 3],
            torque: vec![Vec::new(); 3],
            ..RawSamples::default()
        };
        let mut velocity = vec![Vec::new(); 3];
        let mut q = [0.0; 3];
        for (joints, seconds) in parts {
            for i in 0..(seconds * RATE) as usize {
                let swing = (std::f64::consts::TAU * i as f64 / RATE).sin();
                samples.time.push(samples.time.len() as f64 / RATE);
                for j in 0..3 {
                    let qd = if joints >> j & 1 == 1 { swing } else { 0.0 };
                    q[j] += qd / RATE;
                    velocity[j].push(qd);
                    samples.position[j].push(q[j]);
                    samples.torque[j].push(0.0);
                }
            }
        }
        samples.velocity = with_velocity.then_some(velocity);
        samples
    }

    fn found(mut rows: RawSamples, chunk: usize) -> Samples {
        let mut finder = MotionFinder::new(vec![0.02; 3]);
        let mut done = Samples::default();
        while !rows.is_empty() {
            done.append(finder.push(rows.take_front(chunk.min(rows.rows()))));
            let most = ((BLOCK_S + 2.0 * SETTLE_S) * RATE) as usize + chunk;
            assert!(finder.held.rows() <= most, "{} rows are held", finder.held.rows());
        }
        done.append(finder.finish());
        done
    }

    /// Stages in order, with their duration in seconds.
    fn runs(stages: &[Stage]) -> Vec<(Stage, f64)> {
        let chunks = stages.chunk_by(|a, b| a == b);
        chunks.map(|rows| (rows[0], (rows.len() as f64 / RATE * 10.0).round() / 10.0)).collect()
    }

    const CYCLE: [(u8, f64); 9] = [
        (0, 2.0),
        (0b111, 12.0), // excitation
        (0b001, 8.0),  // friction, joint by joint
        (0b011, 2.0),  // to the next posture
        (0b010, 8.0),
        (0b110, 2.0),
        (0b100, 8.0),
        (0b111, 15.0), // warming
        (0, 2.0),
    ];

    #[test]
    fn the_order_of_motions_tells_the_stages() {
        let twice = [CYCLE, CYCLE].concat();
        for with_velocity in [true, false] {
            let stages = found(recording(&twice, with_velocity), 37).stage;
            let mut named: Vec<Stage> = runs(&stages).into_iter().map(|(stage, _)| stage).collect();
            named.retain(|stage| *stage != Stage::Between);
            named.dedup();
            let one = [Stage::Excitation, Stage::Friction, Stage::Warming];
            assert_eq!(named, [one, one].concat(), "{with_velocity}");
            let seconds = |wanted: Stage| {
                let of_stage = runs(&stages).into_iter().filter(|(stage, _)| *stage == wanted);
                of_stage.map(|(_, seconds)| seconds).sum::<f64>()
            };
            // in each of two cycles, three boundaries of friction are late by the duration of the moving state
            let late = 6.0 * HOLD_S + 0.2;
            let expected = [(Stage::Excitation, 24.0), (Stage::Friction, 48.0), (Stage::Warming, 30.0)];
            for (stage, expected) in expected {
                assert!((seconds(stage) - expected).abs() < late, "{stage} {} {expected}", seconds(stage));
            }
        }
    }

    #[test]
    fn a_short_move_and_a_short_rest_are_no_stages() {
        let stages =
            found(recording(&[(0, 2.0), (0b011, 3.0), (0, 2.0), (0b001, 4.0), (0, 2.0)], true), 10).stage;
        assert!(stages.iter().all(|stage| *stage == Stage::Between));
        let stages = found(recording(&[(0b011, 8.0), (0, 0.5), (0b011, 8.0)], true), 10).stage;
        // the first row is at rest
        assert_eq!(runs(&stages[1..]), [(Stage::Excitation, 16.5)]);
    }

    proptest! {
        #[test]
        fn any_chunking_gives_the_same_stages(
            parts in prop::collection::vec((0_u8..8, 0.2_f64..9.0), 1..12),
            chunk in 1_usize..200,
        ) {
            let rows = recording(&parts, true);
            let whole = rows.rows().max(1);
            prop_assert_eq!(found(rows.clone(), chunk), found(rows, whole));
        }

        #[test]
        fn a_finder_that_goes_on_anywhere_gives_the_same_stages(
            parts in prop::collection::vec((0_u8..8, 0.2_f64..9.0), 1..12),
            with_velocity: bool,
            place in 0.0_f64..1.0,
            chunk in 1_usize..200,
        ) {
            let mut rows = recording(&parts, with_velocity);
            let whole = found(rows.clone(), chunk);
            let before = rows.take_front((place * rows.rows() as f64) as usize);
            let mut first = MotionFinder::new(vec![0.02; 3]);
            let skipped = before.rows();
            let _ = first.push(before);
            let mut second = MotionFinder::new(vec![0.02; 3]).at(first.state().clone());
            let mut stages = second.push(rows).stage;
            stages.extend(second.finish().stage);
            prop_assert_eq!(&stages, &whole.stage[skipped..]);
        }
    }
}
