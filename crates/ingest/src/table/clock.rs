//! The source of a row's time, and clocks that restart or are set: their readings are converted to continuous times.

use serde::{Deserialize, Serialize};

use armwatch_model::run::ContentHash;

/// Time between the last row of a recording and the first of the next one in the same export, s: a gap for every check.
const BETWEEN_RECORDINGS: f64 = 1.0;

/// By how much clocks are set in spring and autumn, s.
pub(super) const CHANGE_OF_CLOCKS: f64 = 3600.0;

/// Largest step between the rows before and after a change of clocks, in usual steps.
const LONGEST_STEP: f64 = 2.5;

/// Share of the usual step that is kept a row later: it follows shorter steps slowly, and longer ones at once, since
/// loggers write several rows at a time.
const KEPT: f64 = 0.98;

/// The time of the last row of the block before.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PreviousTime {
    /// Time in the export's unit, for messages.
    pub recorded: f64,
    /// Time in s.
    pub seconds: f64,
    /// Usual step of a text clock, s.
    pub step: f64,
    /// Delay of such a clock behind the time since it restarted or was set, s.
    pub shift: f64,
    /// Number of the row's cycle, continued over the recordings of an export.
    pub cycle: u32,
    /// Difference between that and its cycle counter.
    pub cycle_shift: u32,
    /// Hash of the row's text, which identifies a row that repeats it.
    pub row: Option<ContentHash>,
}

/// Source of a row's time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeColumn {
    /// The column of this index.
    Recorded(usize),
    /// The column of this index, which restarts with each recording of the export.
    Restarting(usize),
    /// The column of this index, which restarts after its largest value.
    Wrapping {
        /// Column index.
        column: usize,
        /// One more than its largest value, in its unit.
        period: f64,
    },
    /// Dates and times in the column of this index.
    Stamped {
        /// Column index.
        column: usize,
        /// Origin of the times.
        origin: ClockOrigin,
    },
    /// The number of the row at this sample rate, Hz.
    Counted(f64),
}

impl TimeColumn {
    /// Column index, if there is one.
    pub fn column(self) -> Option<usize> {
        match self {
            Self::Recorded(column)
            | Self::Restarting(column)
            | Self::Wrapping { column, .. }
            | Self::Stamped { column, .. } => Some(column),
            Self::Counted(_) => None,
        }
    }
}

/// Origin of times in a column of text, and type of its clock.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ClockOrigin {
    /// The reading of the first row, ns.
    pub nanoseconds: i64,
    /// Seconds after which the clock restarts from zero; `None` for a clock with a date and for elapsed time.
    pub period_s: Option<f64>,
    /// The clock shows local time, which changes by an hour in spring and autumn.
    pub is_local: bool,
}

/// A jump of a clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Turn {
    /// It restarts from zero.
    Anew,
    /// It was set back by an hour.
    Back,
    /// It was set forward by an hour.
    Forward,
    /// Another recording begins.
    Restart,
}

impl PreviousTime {
    /// The time of a row whose clock shows `reading` s, in an export of several recordings: a falling clock starts
    /// another one.
    #[must_use]
    pub fn next_of_recordings(before: Option<&Self>, reading: f64) -> (Self, Option<Turn>) {
        let before = before.copied().unwrap_or(Self { seconds: f64::NEG_INFINITY, ..Self::default() });
        let falls = reading + before.shift < before.seconds;
        let shift = if falls { before.seconds + BETWEEN_RECORDINGS - reading } else { before.shift };
        let next = Self { recorded: reading, seconds: reading + shift, shift, row: None, ..before };
        (next, falls.then_some(Turn::Restart))
    }

    /// Continues the cycle count for a row whose counter shows `counter`: cycles of another recording follow those
    /// before.
    fn count_cycle(&mut self, counter: u32, restarts: bool) {
        if restarts && counter.saturating_add(self.cycle_shift) <= self.cycle {
            self.cycle_shift = self.cycle.saturating_add(1).saturating_sub(counter);
        }
        self.cycle = counter.saturating_add(self.cycle_shift);
    }
}

/// Turns of a clock, each with the row after it, and the last row.
type Turns = (Vec<(usize, Turn)>, Option<PreviousTime>);

/// Converts readings, s, in an export of several recordings to times, in place, and returns the cycle of each row;
/// without a counter, each recording is a cycle.
pub(crate) fn of_recordings(
    readings: &mut [f64],
    counter: Option<Vec<u32>>,
    before: Option<PreviousTime>,
) -> (Turns, Vec<u32>) {
    let (mut last, mut turns, mut cycles) =
        (before, Vec::new(), counter.unwrap_or_else(|| vec![1; readings.len()]));
    for (row, (reading, cycle)) in readings.iter_mut().zip(&mut cycles).enumerate() {
        let (mut next, turn) = PreviousTime::next_of_recordings(last.as_ref(), *reading);
        next.count_cycle(*cycle, turn.is_some());
        turns.extend(turn.map(|turn| (row, turn)));
        (*reading, *cycle) = (next.seconds, next.cycle);
        last = Some(next);
    }
    ((turns, last), cycles)
}

impl ClockOrigin {
    /// The time of a row whose reading is `reading` s after the origin, and the turn before it.
    #[must_use]
    pub fn next(&self, reading: f64, before: Option<&PreviousTime>) -> (PreviousTime, Option<Turn>) {
        let Some(before) = before else {
            return (PreviousTime { recorded: reading, seconds: reading, ..PreviousTime::default() }, None);
        };
        let (mut shift, mut turn) = (before.shift, None);
        let step = reading + shift - before.seconds;
        if step < 0.0
            && let Some(period) = self.period_s
        {
            // a step back by less than half a period stays one
            let periods = (-step / period).round();
            if periods > 0.0 {
                (shift, turn) = (shift + periods * period, Some(Turn::Anew));
            }
        }
        for (change, kind) in [(CHANGE_OF_CLOCKS, Turn::Back), (-CHANGE_OF_CLOCKS, Turn::Forward)] {
            let left = step + change;
            if self.is_local && turn.is_none() && left > 0.0 && left <= LONGEST_STEP * before.step {
                (shift, turn) = (shift + change, Some(kind));
            }
        }
        let seconds = reading + shift;
        let step = (seconds - before.seconds).max(KEPT * before.step);
        (PreviousTime { recorded: reading, seconds, step, shift, ..PreviousTime::default() }, turn)
    }

    /// Converts readings, s after the origin, to times, in place; returns the turns, each with the row after it, and
    /// the time of the last row.
    pub(crate) fn go_on(&self, readings: &mut [f64], before: Option<PreviousTime>) -> Turns {
        let (mut last, mut turns) = (before, Vec::new());
        for (row, reading) in readings.iter_mut().enumerate() {
            let (next, turn) = self.next(*reading, last.as_ref());
            turns.extend(turn.map(|turn| (row, turn)));
            *reading = next.seconds;
            last = Some(next);
        }
        (turns, last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(origin: ClockOrigin, mut readings: Vec<f64>) -> (Vec<f64>, Vec<(usize, Turn)>) {
        let (turns, _) = origin.go_on(&mut readings, None);
        (readings, turns)
    }

    const LOCAL: ClockOrigin = ClockOrigin { nanoseconds: 0, period_s: None, is_local: true };

    #[test]
    fn a_time_of_day_goes_on_after_midnight_and_minutes_after_the_hour() {
        for period in [86_400.0, 3600.0] {
            let daily = ClockOrigin { period_s: Some(period), ..LOCAL };
            let (found, turns) = times(daily, vec![0.0, 1.0, 2.0 - period, 3.0 - period]);
            assert_eq!((found, turns), (vec![0.0, 1.0, 2.0, 3.0], vec![(2, Turn::Anew)]), "{period}");
        }
        let (found, turns) = times(ClockOrigin { period_s: Some(86_400.0), ..LOCAL }, vec![0.0, 1.0, 0.5]);
        assert_eq!((found, turns), (vec![0.0, 1.0, 0.5], vec![]), "a step back stays one");
    }

    #[test]
    fn an_hour_to_the_step_is_a_change_of_clocks() {
        let (found, turns) = times(LOCAL, vec![0.0, 1.0, 2.0 - 3600.0, 3.0 - 3600.0]);
        assert_eq!((found, turns), (vec![0.0, 1.0, 2.0, 3.0], vec![(2, Turn::Back)]));
        let (found, turns) = times(LOCAL, vec![0.0, 1.0, 2.0 + 3600.0, 3.0 + 3600.0]);
        assert_eq!((found, turns), (vec![0.0, 1.0, 2.0, 3.0], vec![(2, Turn::Forward)]));
        for gap in [-3605.0, 3500.0, 3605.0, -1800.0] {
            let (found, turns) = times(LOCAL, vec![0.0, 1.0, 1.0 + gap]);
            assert_eq!((found[2], turns), (1.0 + gap, vec![]), "{gap}");
        }
        let universal = ClockOrigin { is_local: false, ..LOCAL };
        assert_eq!(times(universal, vec![0.0, 1.0, 3602.0]).1, vec![]);
    }

    #[test]
    fn recordings_follow_one_another_with_their_cycles() {
        let read = |times: &[f64], counter: Option<&[u32]>, before| {
            let mut times = times.to_vec();
            let ((turns, last), cycles) = of_recordings(&mut times, counter.map(<[u32]>::to_vec), before);
            (times, cycles, turns, last)
        };
        let (times, cycles, turns, last) = read(&[5.0, 6.0, 0.0, 1.0, 0.5], None, None);
        assert_eq!((times, cycles), (vec![5.0, 6.0, 7.0, 8.0, 9.0], vec![1, 1, 2, 2, 3]));
        assert_eq!(turns, [(2, Turn::Restart), (4, Turn::Restart)]);
        // in the next block
        let (times, cycles, turns, _) = read(&[1.5, 0.0], None, last);
        assert_eq!((times, cycles, turns), (vec![10.0, 11.0], vec![3, 4], vec![(1, Turn::Restart)]));
        let (_, cycles, ..) = read(&[0.0, 1.0, 0.0, 1.0, 2.0, 0.0], Some(&[1, 2, 1, 1, 2, 0]), None);
        assert_eq!(cycles, [1, 2, 3, 3, 4, 5]);
        let (_, cycles, ..) = read(&[0.0, 1.0, 0.0], Some(&[1, 1, 2]), None);
        assert_eq!(cycles, [1, 1, 2], "a counter that goes on");
        assert_eq!(
            read(&[1.0, 1.0], None, None).0,
            [1.0, 1.0],
            "a time that stands still is no other recording"
        );
    }

    #[test]
    fn rows_that_come_together_do_not_hide_a_change_of_clocks() {
        let mut readings: Vec<f64> =
            (0..40).map(|row| f64::from(row / 4) + 0.001 * f64::from(row % 4)).collect();
        let expected = readings.clone();
        readings[20..].iter_mut().for_each(|reading| *reading -= 3600.0);
        let (found, turns) = times(LOCAL, readings);
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert_eq!(turns, [(20, Turn::Back)]);
    }
}
