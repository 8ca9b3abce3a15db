//! Cuts recordings into cycles.
//!
//! A change of the recorded cycle counter begins a cycle. Without a counter, a cycle begins when the stage signal falls
//! back to an earlier stage: excitation, friction and warming follow each other in this order within a cycle.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::buffers::Buffers;
use armwatch_model::run::{Cycle, Samples, Stage};

/// Largest number of rows per cycle. At 1 kHz this is a cycle of 16 minutes, three times the thesis's. Its samples take
/// 160 MB for six joints, which bounds the memory of a run without boundaries.
pub const MAX_CYCLE_ROWS: usize = 1_000_000;

/// Largest number of rows reserved for the first cycle of a recording beyond twice those already read: six minutes at
/// 250 Hz. The length is unknown, and channels that grow in small steps waste memory.
const GUESSED_ROWS: usize = 100_000;

/// Reason why a recording has no cycles.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// The stage signal never leaves "between stages".
    #[error(
        "no stage signal: none of the {rows} rows is in an excitation, friction or warming stage; record the \
         controller's stage signal, or set its values in the layout's [stage] section"
    )]
    NoStage {
        /// Rows of the recording.
        rows: u64,
    },
    /// A cycle has no end.
    #[error(
        "no cycle boundary in {rows} rows from time {start_s} s; record a cycle counter, or the stage signal of \
         every cycle"
    )]
    Endless {
        /// Rows since the last boundary.
        rows: usize,
        /// Time of the first of these rows, s.
        start_s: f64,
    },
    /// The cycle counter is zero inside a cycle.
    #[error(
        "the cycle counter comes back to {counter} at time {time_s} s after it stood at zero; export each test to a \
         file of its own, or leave the counter as it is inside a cycle"
    )]
    CounterReturns {
        /// Counter before and after the zero.
        counter: u32,
        /// Row of its return in the recording, from 0.
        row: u64,
        /// Time of that row, s.
        time_s: f64,
    },
    /// The cycle counter decreases.
    #[error(
        "the cycle counter falls from {from} to {to} at time {time_s} s; export each test to a file of its own"
    )]
    CounterFalls {
        /// Counter before.
        from: u32,
        /// Counter after.
        to: u32,
        /// Row of the decrease in the recording, from 0.
        row: u64,
        /// Time of that row, s.
        time_s: f64,
    },
}

/// Cuts a stream of rows into cycles, one at a time. The cycles do not depend on the size of the chunks. Each row is
/// copied once. Memory is reserved for one cycle, even if a chunk holds more.
#[derive(Debug, Default)]
pub struct CycleCutter {
    /// Rows of the open cycle, except those in `chunk`.
    open: Samples,
    /// Rows of the last push.
    chunk: Samples,
    /// Number of rows of `chunk` that are in `open` or in cycles.
    taken: usize,
    /// Number of rows of `chunk` already searched for a boundary.
    searched: usize,
    stage_reached: Option<Stage>,
    counter: Option<u32>,
    /// Largest counter so far. Zero, before and after a test, is not a decrease.
    counter_reached: u32,
    /// Number of the last cycle; zero before the first.
    number_cut: u32,
    cycles_cut: u32,
    /// Number of rows before the open cycle.
    rows_cut: u64,
    rows_seen: u64,
    stage_seen: bool,
    /// Largest number of rows per cycle, if not [`MAX_CYCLE_ROWS`].
    most_rows: Option<usize>,
    /// Rows of the last cycle; the next one may have the same length.
    last_rows: usize,
    /// True if a cycle needs no stage.
    of_windows: bool,
    /// Memory for channels.
    buffers: Buffers,
}

/// State of a cutter after its last cut. Another cutter can continue with it and the later rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CutterState {
    /// Number of rows before the first row without a cycle.
    pub rows_cut: u64,
    /// Number of cycles so far.
    pub cycles_cut: u32,
    /// Number of the last cycle; zero before the first.
    pub number_cut: u32,
    /// Largest cycle counter so far.
    pub counter_reached: u32,
}

impl CycleCutter {
    /// Creates a cutter at the start of a recording.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets a limit on the rows per cycle other than [`MAX_CYCLE_ROWS`].
    #[must_use]
    pub fn with_most_rows(self, rows: usize) -> Self {
        Self { most_rows: Some(rows), ..self }
    }

    /// Uses `buffers` for the channels of cycles.
    #[must_use]
    pub fn with_buffers(self, buffers: Buffers) -> Self {
        Self { buffers, ..self }
    }

    /// Creates a cutter for a recording without stages, whose counter numbers windows.
    #[must_use]
    pub fn of_windows() -> Self {
        Self { of_windows: true, ..Self::default() }
    }

    /// Continues at `state` of another cutter; the next row is the one after its last cut.
    #[must_use]
    pub fn at(self, state: CutterState) -> Self {
        let CutterState { rows_cut, cycles_cut, number_cut, counter_reached } = state;
        // every cycle cut so far had a stage
        let stage_seen = cycles_cut > 0;
        Self { rows_cut, rows_seen: rows_cut, cycles_cut, number_cut, counter_reached, stage_seen, ..self }
    }

    /// State after the last cut.
    #[must_use]
    pub fn state(&self) -> CutterState {
        // all rows after the last cut have one counter, so `counter_reached` may already include it
        CutterState {
            rows_cut: self.rows_cut,
            cycles_cut: self.cycles_cut,
            number_cut: self.number_cut,
            counter_reached: self.counter_reached,
        }
    }

    /// Number of rows in the open cycle.
    #[must_use]
    pub fn open_rows(&self) -> usize {
        self.open.rows() + self.chunk.rows() - self.taken
    }

    /// Adds rows. [`next_cycle`](Self::next_cycle) returns the cycles that they end.
    pub fn push(&mut self, chunk: Samples) {
        self.rows_seen += chunk.rows() as u64;
        match self.searched < self.chunk.rows() {
            true => self.chunk.append(chunk),
            false => (self.chunk, self.taken, self.searched) = (chunk, 0, 0),
        }
    }

    /// Next cycle that the pushed rows end; `None` after all rows are searched. After a fault, push nothing more.
    ///
    /// # Errors
    /// [`SegmentError::Endless`], [`SegmentError::CounterFalls`] and [`SegmentError::CounterReturns`], after the cycles
    /// before the fault.
    pub fn next_cycle(&mut self) -> Result<Option<Cycle>, SegmentError> {
        let most_rows = self.most_rows.unwrap_or(MAX_CYCLE_ROWS);
        while self.searched < self.chunk.rows() {
            let row = self.searched;
            let cycle = if self.begins_cycle(row)? { self.cut(row) } else { None };
            // checked per row, so that the result does not depend on the chunks
            let rows = self.open.rows() + row - self.taken;
            if rows >= most_rows {
                let start_s = self.open.time.first().copied().unwrap_or(self.chunk.time[self.taken]);
                return Err(SegmentError::Endless { rows: rows + 1, start_s });
            }
            self.note_row(row);
            self.searched += 1;
            if cycle.is_some() {
                return Ok(cycle);
            }
        }
        self.open = self.rows_until(self.chunk.rows());
        self.push(Samples::default());
        Ok(None)
    }

    /// Ends the recording and returns its last cycle, if the remaining rows hold a stage. Take all other cycles first.
    ///
    /// # Errors
    /// [`SegmentError::NoStage`] if no row of the whole recording was in a stage.
    pub fn finish(mut self) -> Result<Option<Cycle>, SegmentError> {
        if !self.stage_seen && !self.of_windows {
            return Err(SegmentError::NoStage { rows: self.rows_seen });
        }
        Ok(self.cut(self.chunk.rows()))
    }

    fn begins_cycle(&self, row: usize) -> Result<bool, SegmentError> {
        if let Some(counters) = &self.chunk.cycle {
            let (Some(from), to) = (self.counter, counters[row]) else { return Ok(false) };
            let time_s = self.chunk.time[row];
            let row = self.rows_cut + (self.open.rows() + row - self.taken) as u64;
            if to != 0 && to < self.counter_reached {
                return Err(SegmentError::CounterFalls { from: self.counter_reached, to, row, time_s });
            }
            if to != from && to != 0 && to == self.number_cut {
                return Err(SegmentError::CounterReturns { counter: to, row, time_s });
            }
            return Ok(to != from);
        }
        let stage = self.chunk.stage[row];
        Ok(stage != Stage::Between && self.stage_reached.is_some_and(|reached| stage < reached))
    }

    fn note_row(&mut self, row: usize) {
        self.counter = self.chunk.cycle.as_ref().map(|counters| counters[row]);
        self.counter_reached = self.counter_reached.max(self.counter.unwrap_or(0));
        let stage = self.chunk.stage[row];
        if stage != Stage::Between {
            self.stage_reached = Some(stage);
            self.stage_seen = true;
        }
    }

    /// Cuts the rows before row `row` of the chunk as a cycle. Rows before the first stage of a test, and rows with a
    /// counter of zero, are not a cycle.
    fn cut(&mut self, row: usize) -> Option<Cycle> {
        let samples = self.rows_until(row);
        self.last_rows = samples.rows();
        self.rows_cut += samples.rows() as u64;
        self.stage_reached = None;
        let staged = match self.of_windows {
            true => !samples.is_empty(),
            false => samples.stage.iter().any(|stage| *stage != Stage::Between),
        };
        let number = match samples.cycle.as_ref().and_then(|counters| counters.first()) {
            Some(counter) => *counter,
            None => self.cycles_cut + u32::from(staged),
        };
        if !staged || number == 0 {
            return None;
        }
        self.cycles_cut += 1;
        self.number_cut = number;
        Some(Cycle { number, samples })
    }

    /// Returns the rows of the open cycle before row `row` of the chunk.
    fn rows_until(&mut self, row: usize) -> Samples {
        let mut open = std::mem::take(&mut self.open);
        let rows = self.taken..row;
        self.taken = row;
        if rows.is_empty() {
            return open;
        }
        let is_first = self.rows_cut == 0 && open.is_empty();
        if is_first && rows.len() == self.chunk.rows() {
            self.taken = 0;
            return std::mem::take(&mut self.chunk);
        }
        if open.is_empty() {
            // end of the chunk: cycles of one test have similar lengths
            let room = match row == self.chunk.rows() {
                true => rows.len().max(self.last_rows + self.last_rows / 64),
                false => rows.len(),
            };
            open = self.chunk.without_rows(|| self.buffers.room(room));
            open.reserve(room);
        } else if open.time.capacity() < open.rows() + rows.len() {
            let room = GUESSED_ROWS.min(8 * open.rows()).saturating_sub(open.rows());
            open.reserve(room.max(rows.len()));
        }
        open.append_rows(&mut self.chunk, rows);
        open
    }
}

/// Contiguous ranges of `0..rows` with `holds` true.
pub(crate) fn ranges_where(rows: usize, holds: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut ranges = Vec::new();
    let mut start = None;
    for row in 0..rows {
        match (holds(row), start) {
            (true, None) => start = Some(row),
            (false, Some(first)) => {
                ranges.push(first..row);
                start = None;
            }
            _ => {}
        }
    }
    if let Some(first) = start {
        ranges.push(first..rows);
    }
    ranges
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn samples(stages: &[u8], counters: Option<&[u32]>) -> Samples {
        let stage = |s: &u8| Stage::ALL[usize::from(*s)];
        let time: Vec<f64> = (0..stages.len()).map(|i| i as f64 * 0.01).collect();
        Samples {
            position: vec![time.clone()],
            velocity: Some(vec![time.clone()]),
            torque: vec![time.clone()],
            time,
            stage: stages.iter().map(stage).collect(),
            cycle: counters.map(<[u32]>::to_vec),
            friction_signal: None,
            temperatures: None,
        }
    }

    /// Pushes rows and returns the cycles that they end, and the fault after them.
    fn push(cutter: &mut CycleCutter, rows: Samples) -> (Vec<Cycle>, Option<SegmentError>) {
        let mut cycles = Vec::new();
        cutter.push(rows);
        loop {
            match cutter.next_cycle() {
                Ok(Some(cycle)) => cycles.push(cycle),
                Ok(None) => return (cycles, None),
                Err(fault) => return (cycles, Some(fault)),
            }
        }
    }

    fn fault(cutter: &mut CycleCutter, rows: Samples) -> SegmentError {
        push(cutter, rows).1.expect("a fault")
    }

    fn cut_all(samples: Samples, chunk: usize) -> Vec<(u32, usize)> {
        let (found, fault) = cut_from(CycleCutter::new(), samples, chunk);
        assert_eq!(fault, None);
        without_states(&found)
    }

    #[test]
    fn the_stage_sequence_cuts_where_it_falls_back() {
        let stages = [0, 0, 1, 1, 0, 2, 2, 0, 3, 3, 0, 1, 1, 2, 3, 3, 0, 0];
        assert_eq!(cut_all(samples(&stages, None), 100), vec![(1, 11), (2, 7)]);
    }

    #[test]
    fn a_missing_stage_does_not_join_two_cycles() {
        let stages = [2, 2, 3, 2, 3, 3, 2];
        assert_eq!(cut_all(samples(&stages, None), 100), vec![(1, 3), (2, 3), (3, 1)]);
    }

    #[test]
    fn the_counter_wins_and_zero_is_outside_the_test() {
        let stages = [0, 1, 1, 3, 0, 1, 3, 3, 0, 0];
        let counters = [0, 1, 1, 1, 3, 3, 3, 3, 0, 0];
        assert_eq!(cut_all(samples(&stages, Some(&counters)), 100), vec![(1, 3), (3, 4)]);
    }

    #[test]
    fn a_counter_that_falls_is_refused_with_both_values() {
        let mut cutter = CycleCutter::new();
        let error = fault(&mut cutter, samples(&[1, 1, 1], Some(&[5, 5, 3])));
        assert_eq!(error, SegmentError::CounterFalls { from: 5, to: 3, row: 2, time_s: 0.02 });
    }

    #[test]
    fn the_row_of_a_fault_counts_from_the_start_of_the_recording_whatever_the_pieces() {
        let recording = || samples(&[1, 1, 2, 1, 1, 2, 1], Some(&[4, 4, 4, 5, 5, 5, 2]));
        for chunk in [1, 2, 7] {
            let (_, fault) = cut_from(CycleCutter::new(), recording(), chunk);
            let row = fault.map(|fault| match fault {
                SegmentError::CounterFalls { row, .. } => row,
                other => panic!("{other}"),
            });
            assert_eq!(row, Some(6), "pieces of {chunk} rows");
        }
    }

    /// Regression: the database refused two cycles with one number, which stopped the program.
    #[test]
    fn a_counter_that_comes_back_from_zero_is_refused_unless_no_stage_was_before() {
        let mut cutter = CycleCutter::new();
        let error = fault(&mut cutter, samples(&[1, 1, 1], Some(&[1, 0, 1])));
        assert_eq!(error, SegmentError::CounterReturns { counter: 1, row: 2, time_s: 0.02 });
        assert_eq!(cut_all(samples(&[0, 0, 1], Some(&[1, 0, 1])), 100), vec![(1, 1)]);
    }

    #[test]
    fn a_recording_without_stages_is_refused() {
        let mut cutter = CycleCutter::new();
        assert_eq!(push(&mut cutter, samples(&[0, 0, 0], None)), (vec![], None));
        assert_eq!(cutter.finish(), Err(SegmentError::NoStage { rows: 3 }));
    }

    #[test]
    fn an_endless_cycle_is_refused_before_memory_grows() {
        let mut cutter = CycleCutter::new();
        let chunk = samples(&vec![1; MAX_CYCLE_ROWS + 1], None);
        let rows = MAX_CYCLE_ROWS + 1;
        assert_eq!(fault(&mut cutter, chunk), SegmentError::Endless { rows, start_s: 0.0 });
    }

    /// Regression: each cycle reserved room for a whole block, and all cycles of a block were cut before the first was
    /// returned.
    #[test]
    fn cycles_of_a_block_take_no_more_than_their_rows_and_come_one_at_a_time() {
        let rows = 10_000;
        let counters: Vec<u32> = (1..=rows as u32).collect();
        let mut cutter = CycleCutter::new();
        cutter.push(samples(&vec![1; rows], Some(&counters)));
        let first = cutter.next_cycle().expect("no fault").expect("a cycle");
        assert_eq!((first.number, first.samples.rows(), cutter.open_rows()), (1, 1, rows - 1));
        let mut cut = 1;
        while let Some(mut cycle) = cutter.next_cycle().expect("no fault") {
            cut += 1;
            assert_eq!(cycle.number, cut);
            assert!(cycle.samples.channels_mut().all(|channel| channel.capacity() <= 8));
        }
        assert_eq!((cut, cutter.open_rows()), (rows as u32 - 1, 1));
    }

    #[test]
    fn a_cycle_is_cut_without_being_copied_again() {
        let cycle_rows = 50_000;
        let counters: Vec<u32> = (0..3 * cycle_rows).map(|row| 1 + row / cycle_rows).collect();
        let mut rest = samples(&vec![1; counters.len()], Some(&counters));
        let mut cutter = CycleCutter::new();
        let mut places = Vec::new();
        while !rest.is_empty() {
            push(&mut cutter, rest.take_front(rest.rows().min(7000)));
            if cutter.rows_cut > 0 {
                places.push((cutter.rows_cut, cutter.open.time.as_ptr()));
            }
        }
        places.dedup();
        // one address for each of the second and third cycle
        assert_eq!(places.len(), 2);
    }

    /// Cycles of a recording in chunks of `chunk` rows, each with its rows and the state of the cutter, and the fault
    /// that ends it.
    fn cut_from(
        mut cutter: CycleCutter,
        mut rest: Samples,
        chunk: usize,
    ) -> (Vec<(u32, usize, CutterState)>, Option<SegmentError>) {
        let mut found = Vec::new();
        while !rest.is_empty() {
            let (cycles, fault) = push(&mut cutter, rest.take_front(chunk.min(rest.rows())));
            let state = cutter.state();
            found.extend(cycles.iter().map(|cycle| (cycle.number, cycle.samples.rows(), state)));
            if fault.is_some() {
                return (found, fault);
            }
        }
        let state = cutter.state();
        match cutter.finish() {
            Ok(last) => found.extend(last.map(|last| (last.number, last.samples.rows(), state))),
            Err(fault) => return (found, Some(fault)),
        }
        (found, None)
    }

    fn without_states(found: &[(u32, usize, CutterState)]) -> Vec<(u32, usize)> {
        found.iter().map(|(number, rows, _)| (*number, *rows)).collect()
    }

    /// Counters that rise, fall, return, and stay at zero.
    fn counters() -> impl Strategy<Value = Vec<u32>> {
        let steps = prop::collection::vec((0_u32..6, 1_usize..12), 1..20);
        steps.prop_map(|steps| {
            let mut reached = 0;
            let step = |(step, rows)| {
                let counter = match step {
                    0 => 0,
                    1 => reached,
                    2 => u32::saturating_sub(reached, 1),
                    _ => reached + 1,
                };
                reached = reached.max(counter);
                std::iter::repeat_n(counter, rows)
            };
            steps.into_iter().flat_map(step).collect()
        })
    }

    proptest! {
        /// Regression: cycles that end in the same chunk as a fault were lost.
        #[test]
        fn any_chunking_gives_the_same_cycles_and_the_same_fault(
            counters in prop::option::of(counters()),
            stages in prop::collection::vec(0_u8..4, 240),
            most_rows in 3_usize..40,
            chunk in 1_usize..50,
        ) {
            let stages = &stages[..counters.as_ref().map_or(240, Vec::len)];
            let rows = samples(stages, counters.as_deref());
            let cutter = || CycleCutter::new().with_most_rows(most_rows);
            let (whole, fault) = cut_from(cutter(), rows.clone(), rows.rows());
            let (cut, same_fault) = cut_from(cutter(), rows, chunk);
            prop_assert_eq!(without_states(&cut), without_states(&whole));
            prop_assert_eq!(same_fault, fault);
        }

        #[test]
        fn a_cutter_that_stands_behind_a_cut_goes_on_as_the_other_did(
            counters in prop::option::of(counters()),
            stages in prop::collection::vec(0_u8..4, 240),
            chunk in 1_usize..50,
        ) {
            let stages = &stages[..counters.as_ref().map_or(240, Vec::len)];
            let rows = samples(stages, counters.as_deref());
            let (whole, fault) = cut_from(CycleCutter::new(), rows.clone(), 1);
            for (place, (_, _, state)) in whole.iter().enumerate() {
                let mut rest = rows.clone();
                rest.take_front(usize::try_from(state.rows_cut).expect("few"));
                let (after, same_fault) = cut_from(CycleCutter::new().at(*state), rest, chunk);
                // the last cycle ends with the recording, without a cut after it
                let expected = if state.cycles_cut as usize > place { &whole[place + 1..] } else { &whole[place..] };
                prop_assert_eq!(without_states(&after), without_states(expected));
                prop_assert_eq!(&same_fault, &fault);
            }
        }

        #[test]
        fn any_chunking_gives_the_same_cycles(
            stages in prop::collection::vec(0_u8..4, 1..200),
            chunk in 1_usize..50,
        ) {
            prop_assume!(stages.iter().any(|s| *s != 0));
            let whole = cut_all(samples(&stages, None), stages.len());
            prop_assert_eq!(cut_all(samples(&stages, None), chunk), whole);
        }
    }
}
