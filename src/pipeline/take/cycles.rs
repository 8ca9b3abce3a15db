//! Cuts the rows of an export into the cycles that the analysis gets.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use super::resume_point::ResumePoint;
use crate::pipeline::cycle_memory;
use armwatch_config::Layout;
use armwatch_ingest::bytes::{fingerprint, source};
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_method::buffers::Buffers;
use armwatch_method::segment::cycles::{CutterState, CycleCutter, MAX_CYCLE_ROWS, SegmentError};
use armwatch_method::segment::joint_side::JointSide;
use armwatch_method::segment::stages::{FinderState, StageFinder};
use armwatch_method::signal::channel_delay::take_delays;
use armwatch_method::signal::filter::MIN_STRETCH_ROWS;
use armwatch_method::signal::slower::fill_slower;
use armwatch_method::signal::time_grid::sample_rate;
use armwatch_model::robot::Robot;
use armwatch_model::run::channel_delays::ChannelDelays;
use armwatch_model::run::slower::SlowerChannels;
use armwatch_model::run::stage_rule::StageRule;
use armwatch_model::run::{ContentHash, Cycle, RawSamples, Samples};

/// First rows of an export that give its sample rate. The number is fixed, so that the rate does not depend on the
/// blocks of a growing file.
pub(in crate::pipeline) const SAMPLE_RATE_ROWS: usize = 1000;

/// First rows of an export that identify its recording: noise makes the first rows of two recordings differ. They are
/// few, so that an export with a correction in a later row still counts as the same recording.
const FIRST_ROWS: usize = 16;

/// Fewest rows of a cycle: a shorter one cannot be filtered, so it gives no result.
const LEAST_ROWS: usize = MIN_STRETCH_ROWS;

/// This many shorter cycles in a row mean that the column is not a cycle counter, or that the stage signal flickers.
/// None of these cycles is returned then.
const SHORT_IN_A_ROW: usize = 100;

/// Fewest cycles of an export that is refused because all of its cycles are shorter.
const SHORT_ALONE: usize = 10;

/// Assigns the columns of an export to the joints, gives the rows their stage and cuts them into cycles.
#[derive(Debug)]
pub struct RowCutter {
    path: PathBuf,
    joint_side: JointSide,
    delays: ChannelDelays,
    slower: SlowerChannels,
    filled: Filled,
    stages: StageFinder,
    cutter: CycleCutter,
    first_times: Vec<f64>,
    /// The sample rate, if the first rows that gave it are not read again, Hz.
    known_rate: Option<f64>,
    first_rows: FirstRows,
    /// Time of the last row, s.
    last_time: f64,
    /// Rows whose stage is known.
    rows_settled: u64,
    /// Following rows with a stage that are in cycles already.
    in_cycles: u64,
    /// Rows that were pushed, including those before the first of them.
    rows_pushed: u64,
    /// Lines of rows in the file: pairs of a row and the line that follows it. It covers the open cycle and short ones;
    /// `None` if the layout skips bad rows, since lines then differ from rows.
    lines: Option<VecDeque<(u64, u64)>>,
    /// The column of the cycle counter, as the layout names it.
    counter_column: Option<String>,
    /// The source of the boundaries: a schedule, windows, or the rows.
    division: Division,
    most_rows: usize,
    /// Most memory of the analysis of a cycle, bytes.
    most_bytes: usize,
    /// Bytes of memory of a row.
    row_bytes: usize,
    /// Consecutive short cycles without a longer one after them.
    short: Vec<Cycle>,
    /// First row of the first of them in the recording.
    short_from: u64,
    /// Cycles that are ready to be taken.
    ready: VecDeque<Cycle>,
    /// The fault after the last cycle.
    fault: Option<Rejection>,
    is_ending: bool,
}

/// The source of the boundaries between cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Division {
    /// The column of the counter, or the sequence of stages.
    Recorded,
    /// A schedule of the layout.
    Schedule,
    /// Windows of production. They may be short, since logs pause, and every window has its temperatures.
    Windows,
}

/// Rows of cycles, and the number of rows with a value in the slowest channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Filled {
    /// Rows.
    pub rows: usize,
    /// Rows with a torque of each joint.
    pub torques: usize,
    /// Rows with a velocity of each joint.
    pub velocities: usize,
}

impl Filled {
    fn count(&mut self, samples: &Samples) {
        let with_value = |channels: &[Vec<f64>]| {
            let counts = channels.iter().map(|of| of.iter().filter(|value| !value.is_nan()).count());
            counts.min().unwrap_or(samples.rows())
        };
        self.rows += samples.rows();
        self.torques += with_value(&samples.torque);
        self.velocities += samples.velocity.as_deref().map_or(samples.rows(), with_value);
    }
}

impl RowCutter {
    /// Creates a cutter at the start of an export; `path` is used only in messages.
    ///
    /// # Errors
    /// A rejection if the robot's transmission cannot be inverted.
    pub fn new(path: &Path, layout: &Layout, robot: &Robot) -> Result<Self, Rejection> {
        let motor = layout.motor_side;
        let joint_side = JointSide::new(robot, motor.position, motor.torque).map_err(|error| {
            Rejection::of_file(path, error.to_string(), "correct the transmission of the robot's description")
        })?;
        let rule = layout.stage.kind().rule();
        let (cutter, division) = match rule {
            StageRule::Windows { .. } => (CycleCutter::of_windows(), Division::Windows),
            StageRule::Schedule(_) => (CycleCutter::new(), Division::Schedule),
            StageRule::Recorded | StageRule::Levels(_) | StageRule::Motion => {
                (CycleCutter::new(), Division::Recorded)
            }
        };
        let low_speed = robot.joints.iter().map(|joint| joint.low_speed).collect();
        let stages = StageFinder::new(rule, low_speed);
        Ok(Self {
            path: path.to_owned(),
            joint_side,
            delays: layout.delays(robot),
            slower: layout.slower,
            filled: Filled::default(),
            stages,
            cutter,
            first_times: Vec::new(),
            known_rate: None,
            first_rows: FirstRows::default(),
            last_time: 0.0,
            rows_settled: 0,
            in_cycles: 0,
            rows_pushed: 0,
            lines: (layout.rows.skip_bad == 0).then(VecDeque::new),
            counter_column: layout.cycle.as_ref().map(ToString::to_string),
            division,
            most_rows: MAX_CYCLE_ROWS,
            most_bytes: usize::MAX,
            row_bytes: 0,
            short: Vec::new(),
            short_from: 0,
            ready: VecDeque::new(),
            fault: None,
            is_ending: false,
        })
    }

    /// Sets another bound on the rows of a cycle.
    #[must_use]
    pub fn with_most_rows(mut self, rows: usize) -> Self {
        self.cutter = self.cutter.with_most_rows(rows);
        self.most_rows = rows;
        self
    }

    /// Sets another bound on the memory of the analysis of a cycle, bytes.
    #[must_use]
    pub fn with_most_bytes(mut self, bytes: usize) -> Self {
        self.most_bytes = bytes;
        self
    }

    /// Takes the memory of cycles' channels from `buffers`.
    #[must_use]
    pub fn with_buffers(mut self, buffers: Buffers) -> Self {
        self.cutter = self.cutter.with_buffers(buffers);
        self
    }

    /// Restores the cutter that reached `point`; the next row is the first one of its position.
    #[must_use]
    pub fn at(mut self, point: &ResumePoint) -> Self {
        self.stages = self.stages.at(point.stages.clone());
        self.cutter = self.cutter.at(point.cutter);
        self.rows_settled = point.position.rows;
        self.rows_pushed = point.position.rows;
        self.in_cycles = point.cutter.rows_cut.saturating_sub(point.position.rows);
        self.known_rate = Some(point.sample_rate);
        self.first_rows.known = Some(point.first_rows);
        self
    }

    /// Bytes of memory of the rows that are in no cycle yet.
    pub fn open_bytes(&self) -> usize {
        (self.cutter.open_rows() + self.stages.held_rows()) * self.row_bytes
    }

    /// Rows of slower channels in the cycles that were cut.
    pub fn filled(&self) -> Filled {
        self.filled
    }

    /// Returns true if all cut cycles are taken: the next cycle then begins at the cutter's position.
    pub fn all_taken(&self) -> bool {
        self.ready.is_empty() && self.short.is_empty()
    }

    /// State of the stage finder before the next row.
    pub fn stages(&self) -> FinderState {
        self.stages.state()
    }

    /// State of the cutter.
    pub fn cutter(&self) -> CutterState {
        self.cutter.state()
    }

    /// Rows whose stage is known; later rows wait.
    pub fn rows_settled(&self) -> u64 {
        self.rows_settled
    }

    /// Notes the line of the first row that is pushed next, so that a fault in it is reported with its line.
    pub fn note_line(&mut self, line: u64) {
        if let Some(lines) = &mut self.lines {
            lines.push_back((self.rows_pushed, line));
        }
    }

    /// Adds the next rows. [`next_cycle`](Self::next_cycle) returns the cycles that they end.
    pub fn push(&mut self, mut samples: RawSamples) {
        let missing = SAMPLE_RATE_ROWS.saturating_sub(self.first_times.len());
        self.first_times.extend(samples.time.iter().take(missing));
        self.first_rows.note(&samples);
        self.rows_pushed += samples.rows() as u64;
        self.last_time = samples.time.last().copied().unwrap_or(self.last_time);
        self.note_row_bytes(samples.row_bytes());
        self.joint_side.apply(&mut samples);
        let (staged, fault) = self.stages.push(samples);
        self.cut(staged);
        let fault = fault.map(|fault| Rejection::of_file(&self.path, fault.to_string(), ""));
        self.fault = fault.or_else(|| self.undecided());
    }

    /// Notes the memory of a row, which bounds the rows of a cycle.
    fn note_row_bytes(&mut self, bytes: usize) {
        self.row_bytes = bytes;
        let rows = self.cycle_rows();
        if rows < self.most_rows {
            self.cutter = std::mem::take(&mut self.cutter).with_most_rows(rows);
        }
    }

    /// Most rows of a cycle, by both bounds.
    fn cycle_rows(&self) -> usize {
        self.most_rows.min(cycle_memory::most_rows(self.most_bytes, self.row_bytes).max(LEAST_ROWS))
    }

    /// The remedy for a cycle with too many rows.
    fn remedy_of_length(&self) -> String {
        match self.cycle_rows() == self.most_rows {
            true => "if cycles are that long, raise limits.cycle_max_rows".to_owned(),
            false => format!(
                "its analysis takes more than limits.cycles_max_bytes = {}, at {} bytes per row; if cycles \
                are that long, raise this limit, and with it the permitted memory of the program",
                self.most_bytes,
                cycle_memory::bytes_of_rows(1, self.row_bytes)
            ),
        }
    }

    /// Ends the export: [`next_cycle`](Self::next_cycle) then returns its last cycles.
    pub fn finish(&mut self) {
        let held = self.stages.finish();
        self.cut(held);
        self.is_ending = true;
    }

    /// The next cycle that the pushed rows end; `None` when all of them are processed. Nothing may be pushed after a
    /// fault. A short cycle waits until a longer one follows.
    ///
    /// # Errors
    /// A rejection of rows that form no cycle, after the cycles before them, and of an export without stages.
    pub fn next_cycle(&mut self) -> Result<Option<Cycle>, Rejection> {
        loop {
            if let Some(cycle) = self.ready.pop_front() {
                return Ok(Some(cycle));
            }
            match self.cutter.next_cycle() {
                Ok(Some(cycle)) => {
                    let first_row = self.cutter.state().rows_cut - cycle.samples.rows() as u64;
                    self.take(cycle, first_row)?;
                }
                Ok(None) => match self.fault.take() {
                    Some(fault) => self.fail(fault)?,
                    None if self.is_ending => self.end()?,
                    None => {
                        self.forget_lines();
                        return Ok(None);
                    }
                },
                Err(error) => self.fail(self.not_cut(&error))?,
            }
        }
    }

    /// Finds the cycle with the number `wanted` among those that the pushed rows end.
    fn find(&mut self, wanted: u32) -> Result<Option<Cycle>, Rejection> {
        while let Some(cycle) = self.next_cycle()? {
            if cycle.number == wanted {
                return Ok(Some(cycle));
            }
        }
        Ok(None)
    }

    /// Passes on rows whose stage is known, except those that are in cycles already.
    fn cut(&mut self, mut staged: Samples) {
        self.rows_settled += staged.rows() as u64;
        let in_cycles = usize::try_from(self.in_cycles).map_or(staged.rows(), |rows| rows.min(staged.rows()));
        self.in_cycles -= in_cycles as u64;
        if in_cycles > 0 {
            staged.take_front(in_cycles);
        }
        self.cutter.push(staged);
    }

    /// Takes a cut cycle that starts at row `first_row` of the recording, and releases it unless it is short.
    fn take(&mut self, mut cycle: Cycle, first_row: u64) -> Result<(), Rejection> {
        cycle.samples.shrink_to_fit();
        if self.slower != SlowerChannels::default() {
            self.filled.count(&cycle.samples);
        }
        fill_slower(self.slower, &mut cycle.samples).map_err(|(quantity, joint)| {
            Rejection::of_file(
                &self.path,
                format!("cycle {} has no {quantity} of joint {joint}", cycle.number),
                "export the channel, or name the joint in torque.not_recorded of the layout",
            )
        })?;
        take_delays(&self.delays, &mut cycle.samples);
        if cycle.samples.rows() >= LEAST_ROWS || self.division == Division::Windows {
            self.ready.extend(self.short.drain(..));
            self.ready.push_back(cycle);
            return Ok(());
        }
        if self.short.is_empty() {
            self.short_from = first_row;
        }
        self.short.push(cycle);
        if self.short.len() < SHORT_IN_A_ROW { Ok(()) } else { Err(self.too_short()) }
    }

    /// Ends with the last cycles.
    fn end(&mut self) -> Result<(), Rejection> {
        self.is_ending = false;
        let CutterState { cycles_cut, rows_cut, .. } = self.cutter.state();
        let last = std::mem::take(&mut self.cutter).finish().map_err(|error| self.not_cut(&error))?;
        let cut = cycles_cut as usize + usize::from(last.is_some());
        last.map_or(Ok(()), |cycle| self.take(cycle, rows_cut))?;
        if self.short.len() == cut && cut >= SHORT_ALONE {
            return Err(self.too_short());
        }
        self.ready.extend(self.short.drain(..));
        Ok(())
    }

    /// Releases the cycles before a fault first.
    fn fail(&mut self, fault: Rejection) -> Result<(), Rejection> {
        if self.short.is_empty() {
            return Err(fault);
        }
        self.ready.extend(self.short.drain(..));
        self.fault = Some(fault);
        Ok(())
    }

    /// Forgets the lines of rows of cycles that are not short.
    fn forget_lines(&mut self) {
        if let Some(lines) = &mut self.lines {
            let kept_from =
                if self.short.is_empty() { self.cutter.state().rows_cut } else { self.short_from };
            while lines.get(1).is_some_and(|(rows, _)| *rows <= kept_from) {
                lines.pop_front();
            }
        }
    }

    /// The rejection of more rows without a stage than a cycle may have.
    fn undecided(&self) -> Option<Rejection> {
        let held = self.stages.held_rows();
        (held > self.cycle_rows()).then(|| {
            let reason = format!(
                "{held} rows with an undecided stage: the times of these rows hardly advance, or the \
                recording has more rows than the bound of a cycle in the time that decides a stage"
            );
            let remedy = format!("check the unit of [time] in the layout; {}", self.remedy_of_length());
            Rejection::of_file(&self.path, reason, remedy)
        })
    }

    /// The rejection of cycles that are too short to be cycles.
    fn too_short(&self) -> Rejection {
        let short = &self.short;
        let rows = || short.iter().map(|cycle| cycle.samples.rows());
        let (least, most) = (rows().min().unwrap_or(0), rows().max().unwrap_or(0));
        let counted = short.iter().any(|cycle| cycle.samples.cycle.is_some());
        let column = self.counter_column.as_deref().filter(|_| counted);
        let size = match (least, most) {
            (1, 1) => "1 row each".to_owned(),
            (least, most) if least == most => format!("{most} rows each"),
            (least, most) => format!("{least} to {most} rows"),
        };
        let cycles = format!(
            "{} cycles in a row have {size}, but a cycle needs at least {LEAST_ROWS} rows",
            short.len()
        );
        let (said, remedy) = match (self.division, column) {
            (Division::Schedule, _) => (
                "the schedule of the layout is too fast".to_owned(),
                "correct the durations under [stage] of the layout, which are in s, or the unit of [time]",
            ),
            (_, Some(column)) => (
                match most {
                    1 => format!("the column {column} counts rows, not cycles"),
                    _ => format!("the column {column} changes too often to count cycles"),
                },
                "under [if_present] of the layout, set `cycle` to the column that counts the repetitions of \
                the test, or remove that key: cycles then follow from the stages",
            ),
            (_, None) => (
                "the stage signal returns to an earlier stage too often".to_owned(),
                "check the value of each stage under [stage] of the layout; docs/exports.md shows how to \
                read a signal that flickers",
            ),
        };
        let mut rejection = Rejection::of_file(&self.path, format!("{said}: {cycles}"), remedy);
        rejection.line = self.line_of(self.short_from);
        rejection
    }

    /// The rejection of rows that form no cycle, with the place of the faulty cell, if any.
    fn not_cut(&self, error: &SegmentError) -> Rejection {
        let remedy = match error {
            SegmentError::Endless { .. } => &self.remedy_of_length(),
            SegmentError::CounterFalls { .. } => "export each test to its own file",
            SegmentError::CounterReturns { .. } => {
                "export each test to its own file, or do not change the counter inside a cycle"
            }
            SegmentError::NoStage { .. } => "",
        };
        let of_cell = |reason: String, row: u64, value: u32| {
            let mut rejection = Rejection::of_file(&self.path, reason, remedy).with_value(&value.to_string());
            rejection.line = self.line_of(row);
            match &self.counter_column {
                Some(column) => rejection.in_column(column),
                None => rejection,
            }
        };
        match *error {
            SegmentError::CounterFalls { from, to, row, time_s } => {
                let reason =
                    format!("below the {from} that the cycle counter had reached, at time {time_s} s");
                of_cell(reason, row, to)
            }
            SegmentError::CounterReturns { counter, row, time_s } => {
                let reason = format!(
                    "the cycle counter of a cycle that had ended, when it stood at zero, at time {time_s} s"
                );
                of_cell(reason, row, counter)
            }
            SegmentError::NoStage { .. } | SegmentError::Endless { .. } => {
                Rejection::of_file(&self.path, error.to_string(), remedy)
            }
        }
    }

    /// The line of a row, counted from 0, in the decompressed file; `None` if unknown.
    fn line_of(&self, row: u64) -> Option<u64> {
        let (rows, line) = self.lines.as_ref()?.iter().rfind(|(rows, _)| *rows <= row)?;
        Some(line + (row - rows))
    }

    /// Hash of time, positions and torques of the first rows, in SI units: it does not depend on how the file writes
    /// them.
    pub fn first_rows(&self) -> ContentHash {
        self.first_rows.known.unwrap_or_else(|| fingerprint::of_bytes(&self.first_rows.bytes))
    }

    /// Time from the first row to the last one so far, s.
    pub fn last_time(&self) -> f64 {
        self.last_time
    }

    /// Rows per second of the first rows, Hz; zero if unknown.
    pub fn sample_rate(&self) -> f64 {
        let found = || sample_rate(&self.first_times).unwrap_or(0.0);
        self.known_rate.unwrap_or_else(found)
    }
}

/// The first rows of an export as recorded, or their hash if they are not read again.
#[derive(Debug, Default)]
struct FirstRows {
    rows: usize,
    bytes: Vec<u8>,
    known: Option<ContentHash>,
}

impl FirstRows {
    fn note(&mut self, samples: &RawSamples) {
        let missing = if self.known.is_some() { 0 } else { FIRST_ROWS - self.rows };
        for row in 0..missing.min(samples.rows()) {
            let joints = samples.position.iter().chain(&samples.torque);
            for channel in std::iter::once(&samples.time).chain(joints) {
                self.bytes.extend(channel.get(row).copied().unwrap_or_default().to_bits().to_le_bytes());
            }
            self.rows += 1;
        }
    }
}

/// Reads the cycle with the number `wanted` for display; `None` if the export does not have it. Reads no further than
/// its end.
///
/// # Errors
/// A rejection of the file, of its rows, or of a recording without cycles.
pub fn read_cycle(
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    wanted: u32,
) -> Result<Option<Cycle>, Rejection> {
    let (export, _) =
        ExportReader::open(path, layout, robot, ReadOptions::default(), source::MAX_DECOMPRESSED_BYTES)?;
    let mut cutter = RowCutter::new(path, layout, robot)?;
    for chunk in export {
        let chunk = chunk?;
        cutter.note_line(chunk.first_line);
        cutter.push(chunk.samples);
        if let Some(found) = cutter.find(wanted)? {
            return Ok(Some(found));
        }
    }
    cutter.finish();
    cutter.find(wanted)
}

#[cfg(test)]
mod tests;
