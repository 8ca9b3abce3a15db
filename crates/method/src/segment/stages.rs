//! Stages of rows whose export does not name them: from an analogue signal, from the motion, or from a sequence in the
//! configuration. Also windows of a recording without stages.
//!
//! Rows arrive in chunks of any size and leave in the same order once their stage is known. The result does not depend
//! on the chunks. At most the rows of one debounce time, or of one block of motion, are pending.

use serde::{Deserialize, Serialize};

use super::stages_from_motion::{MotionFinder, MotionFinderState};
use armwatch_model::run::stage_rule::{LevelSettings, StageRule};
use armwatch_model::run::{RawSamples, Samples, Stage, StageReading};

/// Longest time that an analogue signal may stay outside every range, s. Any output switches faster, and every stage is
/// far longer. A longer debounce time takes precedence.
const OUTSIDE_S: f64 = 0.5;

/// Error: an analogue signal stays outside the range of every stage.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error, Serialize, Deserialize)]
#[error(
    "the stage signal stays at {level} from time {start_s} s on, which is in no stage's range; widen the ranges \
     in the layout's [stage] section, or check the signal"
)]
pub struct OutsideLevels {
    /// The level, in the unit of the export.
    pub level: f64,
    /// Time of the first row outside, s.
    pub start_s: f64,
}

/// Assigns stages to rows.
#[derive(Debug, Default)]
pub struct StageFinder {
    rule: StageRule,
    first_time: Option<f64>,
    motion: MotionFinder,
    /// Rows whose stage the analogue signal has not yet decided.
    held: RawSamples,
    signal: SignalState,
}

/// State of the analogue signal before the next row.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct SignalState {
    /// Stage of the last decided row.
    pub present: Option<Stage>,
    /// Another stage that the signal shows, and the time of its first held row, s.
    pub candidate: Option<(Stage, f64)>,
    /// First row outside every range: its level and time, s.
    pub outside: Option<OutsideLevels>,
}

/// State before the next row, without the pending rows. A finder that continues from it assigns the same stages to all
/// later rows. It does not return the rows that were pending.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct FinderState {
    /// Time of the first row of the recording, s.
    pub first_time: Option<f64>,
    /// State of the analogue signal, if the layout has one.
    pub signal: SignalState,
    /// State of the motion, if it determines the stages.
    pub motion: MotionFinderState,
}

impl StageFinder {
    /// Creates a finder at the start of a recording; `low_speed` `[n]` is the low-speed threshold of each joint, rad/s
    /// (m/s).
    #[must_use]
    pub fn new(rule: StageRule, low_speed: Vec<f64>) -> Self {
        Self { rule, motion: MotionFinder::new(low_speed), ..Self::default() }
    }

    /// Continues at `state`, which another finder had before the next row.
    #[must_use]
    pub fn at(self, state: FinderState) -> Self {
        let FinderState { first_time, signal, motion } = state;
        Self { first_time, signal, motion: self.motion.at(motion), ..self }
    }

    /// State before the next row.
    #[must_use]
    pub fn state(&self) -> FinderState {
        FinderState { first_time: self.first_time, signal: self.signal, motion: self.motion.state().clone() }
    }

    /// Number of rows that are pending until their stage is known.
    #[must_use]
    pub fn held_rows(&self) -> usize {
        self.held.rows() + self.motion.held_rows()
    }

    /// Adds rows and returns those whose stage is known, together with the fault that follows them. After a fault, push
    /// nothing more.
    ///
    /// The fault is [`OutsideLevels`]: an analogue signal outside every range.
    #[must_use]
    pub fn push(&mut self, rows: RawSamples) -> (Samples, Option<OutsideLevels>) {
        let Some(first) = self.first_time.or(rows.time.first().copied()) else {
            return (rows.with_stages(Vec::new()), None);
        };
        self.first_time = Some(first);
        if self.rule == StageRule::Recorded {
            return (rows.as_recorded(), None);
        }
        let (rows, fault) = self.staged(rows, first);
        (without_stray_signals(rows), fault)
    }

    fn staged(&mut self, mut rows: RawSamples, first: f64) -> (Samples, Option<OutsideLevels>) {
        match &self.rule {
            StageRule::Recorded => (rows.as_recorded(), None),
            StageRule::Motion => (self.motion.push(rows), None),
            StageRule::Schedule(schedule) => {
                let (cycles, stages) = rows.time.iter().map(|time| schedule.at(time - first)).unzip();
                rows.cycle = Some(cycles);
                (rows.with_stages(stages), None)
            }
            StageRule::Windows { window } => {
                let number = |time: &f64| ((time - first) / window).floor() as u32 + 1;
                rows.cycle = Some(rows.time.iter().map(number).collect());
                let between = vec![Stage::Between; rows.rows()];
                (rows.with_stages(between), None)
            }
            StageRule::Levels(settings) => {
                let settings = settings.clone();
                self.settle(&settings, rows)
            }
        }
    }

    /// Ends the recording and returns the pending rows. They belong to the stage before them, because the next one was
    /// not confirmed.
    #[must_use]
    pub fn finish(&mut self) -> Samples {
        if self.rule == StageRule::Motion {
            return without_stray_signals(self.motion.finish());
        }
        let rows = std::mem::take(&mut self.held);
        let stages = vec![self.signal.present.unwrap_or(Stage::Between); rows.rows()];
        without_stray_signals(rows.with_stages(stages))
    }

    fn settle(&mut self, settings: &LevelSettings, rows: RawSamples) -> (Samples, Option<OutsideLevels>) {
        let first_new = self.held.rows();
        // all held rows belong to the candidate, so none is decided yet
        let mut settled = 0;
        let mut fault = None;
        self.held.append(rows);
        let mut stages = vec![Stage::Between; self.held.rows()];
        for row in first_new..self.held.rows() {
            let time = self.held.time[row];
            let level = match &self.held.stage {
                StageReading::Level(levels) => levels[row],
                StageReading::Known(_) | StageReading::Unknown => f64::NAN,
            };
            let first_stage = || settings.stage_of(level, Stage::Between).unwrap_or(Stage::Between);
            let present = *self.signal.present.get_or_insert_with(first_stage);
            let seen = self
                .signal
                .candidate
                .and_then(|(stage, _)| settings.stage_of(level, stage).filter(|seen| *seen == stage));
            let seen = seen.or_else(|| settings.stage_of(level, present));
            fault = self.note_outside(settings, seen.is_none(), OutsideLevels { level, start_s: time }, time);
            if fault.is_some() {
                break;
            }
            let goes_on = self.signal.candidate.is_some_and(|(stage, _)| seen == Some(stage));
            if !goes_on {
                stages[settled..row].fill(present);
                settled = row;
                self.signal.candidate = seen.filter(|stage| *stage != present).map(|stage| (stage, time));
            }
            match self.signal.candidate {
                Some((stage, since)) if time - since >= settings.debounce => {
                    stages[settled..=row].fill(stage);
                    settled = row + 1;
                    self.signal.present = Some(stage);
                    self.signal.candidate = None;
                }
                Some(_) => {}
                None => {
                    stages[row] = present;
                    settled = row + 1;
                }
            }
        }
        stages.truncate(settled);
        (self.held.take_front(settled).with_stages(stages), fault)
    }

    /// Returns the fault if the signal has stayed outside every range too long.
    fn note_outside(
        &mut self,
        settings: &LevelSettings,
        is_outside: bool,
        row: OutsideLevels,
        time: f64,
    ) -> Option<OutsideLevels> {
        if !is_outside {
            self.signal.outside = None;
            return None;
        }
        let first = *self.signal.outside.get_or_insert(row);
        (time - first.start_s > OUTSIDE_S.max(settings.debounce)).then_some(first)
    }
}

/// Deletes joint and level of rows outside the friction stage, because they are meaningless there.
fn without_stray_signals(mut rows: Samples) -> Samples {
    for (signal, stage) in rows.friction_signal.iter_mut().flatten().zip(&rows.stage) {
        if *stage != Stage::Friction {
            *signal = None;
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::run::stage_rule::Schedule;
    use proptest::prelude::*;

    const RATE: f64 = 100.0;

    fn settings() -> LevelSettings {
        LevelSettings {
            ranges: vec![
                (Stage::Between, [-0.5, 0.8]),
                (Stage::Excitation, [1.2, 1.8]),
                (Stage::Friction, [2.2, 2.8]),
                (Stage::Warming, [3.2, 3.8]),
            ],
            hysteresis: 0.15,
            debounce: 0.05,
        }
    }

    fn recording(levels: &[f64]) -> RawSamples {
        let time: Vec<f64> = (0..levels.len()).map(|row| row as f64 / RATE).collect();
        RawSamples {
            position: vec![time.clone()],
            torque: vec![time.clone()],
            stage: StageReading::Level(levels.to_vec()),
            time,
            ..RawSamples::default()
        }
    }

    fn found(rule: &StageRule, mut rows: RawSamples, chunk: usize) -> Result<Samples, OutsideLevels> {
        let mut finder = StageFinder::new(rule.clone(), Vec::new());
        let mut settled = Samples::default();
        while !rows.is_empty() {
            let front = rows.take_front(chunk.min(rows.rows()));
            let (rows, fault) = finder.push(front);
            settled.append(rows);
            if let Some(fault) = fault {
                return Err(fault);
            }
            let most = (settings().debounce * RATE) as usize + 1;
            assert!(finder.held.rows() <= most, "{} rows are held", finder.held.rows());
        }
        settled.append(finder.finish());
        Ok(settled)
    }

    fn stages(levels: &[f64]) -> Vec<Stage> {
        found(&StageRule::Levels(settings()), recording(levels), 7).expect("in range").stage
    }

    #[test]
    fn a_stage_counts_from_its_first_row_and_chatter_is_none() {
        let mut levels = vec![0.0; 20];
        levels.extend([1.5; 30]);
        levels.extend([0.9, 2.0]); // on the way through no range
        levels.extend([2.5; 30]);
        levels[5] = 3.5; // a spike
        levels[35] = 1.85; // beyond the range and inside the hysteresis
        let stages = stages(&levels);
        let expected = |row: usize| match row {
            0..20 => Stage::Between,
            20..52 => Stage::Excitation,
            _ => Stage::Friction,
        };
        (0..levels.len()).for_each(|row| assert_eq!(stages[row], expected(row), "row {row}"));
    }

    #[test]
    fn a_jump_over_a_level_does_not_visit_it() {
        let mut levels = vec![0.0; 10];
        levels.extend([1.5, 2.5]);
        levels.extend([3.5; 10]);
        let stages = stages(&levels);
        assert!(stages[..12].iter().all(|stage| *stage == Stage::Between));
        assert!(stages[12..].iter().all(|stage| *stage == Stage::Warming));
    }

    #[test]
    fn a_level_that_belongs_to_nothing_is_refused_with_level_and_time() {
        let mut levels = vec![0.0; 10];
        levels.extend([5.0; 100]);
        let rule = StageRule::Levels(settings());
        let error = found(&rule, recording(&levels), 9).expect_err("no stage has 5");
        assert_eq!(error, OutsideLevels { level: 5.0, start_s: 0.1 });
    }

    #[test]
    fn a_schedule_repeats_from_its_start() {
        let sequence = vec![(Stage::Excitation, 0.2), (Stage::Between, 0.1), (Stage::Warming, 0.3)];
        let rule = StageRule::Schedule(Schedule { start: 0.1, sequence });
        let rows = found(&rule, recording(&[0.0; 150]), 11).expect("time says it all");
        let at = |row: usize| (rows.cycle.as_ref().expect("counted")[row], rows.stage[row]);
        assert_eq!(at(5), (0, Stage::Between));
        assert_eq!(
            (at(15), at(35), at(45)),
            ((1, Stage::Excitation), (1, Stage::Between), (1, Stage::Warming))
        );
        assert_eq!((at(75), at(135)), ((2, Stage::Excitation), (3, Stage::Excitation)));
    }

    #[test]
    fn windows_count_by_time_whatever_the_recording_counts() {
        let mut rows = recording(&[0.0; 250]);
        rows.cycle = Some(vec![9; 250]);
        let rows = found(&StageRule::Windows { window: 1.0 }, rows, 13).expect("no stages");
        let cycles = rows.cycle.expect("counted");
        assert_eq!((cycles[0], cycles[99], cycles[101], cycles[249]), (1, 1, 2, 3));
    }

    /// Levels that stay, chatter, fall between ranges or, rarely, are far from any range.
    fn levels() -> impl Strategy<Value = Vec<f64>> {
        const LEVELS: [f64; 7] = [0.0, 1.5, 2.5, 3.5, 2.0, 1.0, 5.0];
        let steps = prop::collection::vec((0_usize..7, 1_usize..20), 1..40);
        let noise = prop::collection::vec(-0.3_f64..0.3, 32);
        (steps, noise).prop_map(|(steps, noise)| {
            let levels = steps.into_iter().flat_map(|(level, rows)| std::iter::repeat_n(LEVELS[level], rows));
            levels.zip(noise.iter().cycle()).map(|(level, noise)| level + noise).collect()
        })
    }

    /// Rows with a known stage, also those before a fault, and the fault.
    fn settled(
        mut finder: StageFinder,
        mut rows: RawSamples,
        chunk: usize,
    ) -> (Vec<Stage>, Option<OutsideLevels>) {
        let mut stages = Vec::new();
        while !rows.is_empty() {
            let (done, fault) = finder.push(rows.take_front(chunk.min(rows.rows())));
            stages.extend(done.stage);
            if fault.is_some() {
                return (stages, fault);
            }
        }
        stages.extend(finder.finish().stage);
        (stages, None)
    }

    proptest! {
        /// Regression: rows in the same chunk as a fault were lost.
        #[test]
        fn any_chunking_gives_the_same_rows_and_the_same_fault(levels in levels(), chunk in 1_usize..60) {
            let finder = || StageFinder::new(StageRule::Levels(settings()), Vec::new());
            let whole = settled(finder(), recording(&levels), levels.len());
            prop_assert_eq!(settled(finder(), recording(&levels), chunk), whole);
        }

        #[test]
        fn a_finder_that_goes_on_anywhere_gives_the_same_stages(
            levels in levels(),
            place in 0.0_f64..1.0,
            chunk in 1_usize..60,
        ) {
            let finder = || StageFinder::new(StageRule::Levels(settings()), Vec::new());
            let mut rows = recording(&levels);
            let (whole, fault) = settled(finder(), rows.clone(), levels.len());
            let skipped = (place * levels.len() as f64) as usize;
            let mut first = finder();
            let early = first.push(rows.take_front(skipped)).1;
            prop_assume!(early.is_none());
            let (stages, same_fault) = settled(finder().at(first.state()), rows, chunk);
            prop_assert_eq!(same_fault, fault);
            // if a recording ends with a fault, rows before it may still be pending
            prop_assert_eq!(&stages[..], whole.get(skipped..).unwrap_or_default());
        }

        #[test]
        fn any_chunking_gives_the_same_stages(levels in levels(), chunk in 1_usize..60) {
            let rule = StageRule::Levels(settings());
            let (whole, cut) = (found(&rule, recording(&levels), levels.len()), found(&rule, recording(&levels), chunk));
            prop_assert_eq!(cut, whole);
        }
    }
}
