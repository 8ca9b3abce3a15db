//! The rows of an export, chunk by chunk, with the place of any error.

use std::io::Read;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::cell::Decimal;
use super::cell_reader::{LastLine, PassedOver, ReadRows};
use super::clock::{ClockOrigin, PreviousTime, TimeColumn};
use super::column_map::{ColumnMap, known_columns, map_columns};
use super::mended::{Mend, Mended, MendedRow, Places};
use super::parser::Parser;
use super::preamble::Header;
use super::{cell_reader, channels, plausible, preamble, sparse};
use crate::bytes::blocks::{BLOCK_BYTES, Block, Blocks, Next, Passed, line_count};
use crate::bytes::encoding::Found;
use crate::rejection::Rejection;
use armwatch_config::Layout;
use armwatch_model::robot::Robot;
use armwatch_model::run::{ContentHash, RawSamples};
use armwatch_model::text;

/// Lines below an invalid header that are searched for a header, so that the message can give the number of lines to
/// skip.
const MOST_LINES_ABOVE_HEADER: usize = 100;

/// Options for reading an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadOptions {
    /// Bytes of a block.
    pub block_bytes: usize,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { block_bytes: BLOCK_BYTES }
    }
}

/// Consecutive rows of an export.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    /// The rows, in SI.
    pub samples: RawSamples,
    /// Line of the first row in the decompressed file, from 1.
    pub first_line: u64,
    /// Position of the reader before them.
    pub position: ReadPosition,
    /// Repairs in them, in order.
    pub mended: Vec<MendedRow>,
}

/// Position of a reader before a row: it lets another reader of the same export continue there.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ReadPosition {
    /// Line of the row in the decompressed file, from 1.
    pub line: u64,
    /// Its first byte in the decompressed file, from 0.
    pub byte: u64,
    /// Rows before it.
    pub rows: u64,
    /// Bad rows before it that were skipped, in addition to those.
    pub rows_skipped: u64,
    /// Time of the row before, as recorded and as converted.
    pub previous: Option<PreviousTime>,
    /// Number that times are relative to, in the export's unit, if time is a column of numbers.
    pub origin: Option<Decimal>,
    /// Origin of dates and times, if there are any.
    pub moment: Option<ClockOrigin>,
}

/// Next item of an export.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Some rows.
    Rows(Box<Chunk>),
    /// No whole row yet; the file may still grow.
    Waiting,
    /// No more rows.
    End,
}

/// A last line that was omitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeftOut {
    /// Its number in the decompressed file, from 1.
    pub line: u64,
    /// Why, as a clause about "the last line".
    pub reason: &'static str,
}

/// Reason for a last line that is valid but has no line end.
const MAY_BE_CUT: &str = "has no line end and its last number may be cut";

/// Reason for a last line that has too few fields, or whose last cell is not understood.
const IS_CUT: &str = "has too few fields or ends inside a cell";

/// The rows of an export, chunk by chunk. Ends after the first rejection.
///
/// An export without rows gives a rejection, so there is at least one item.
#[derive(Debug)]
pub struct ExportReader<R> {
    blocks: Blocks<R>,
    parser: Parser,
    path: PathBuf,
    /// The header has columns of the layout, so messages may quote the file from the first row on.
    is_known: bool,
    /// Line of the header; `None` without one.
    header_line: Option<u64>,
    /// The header, of this file or of the rows before its first one; `None` if columns are selected by number.
    header: Option<String>,
    previous: Option<PreviousTime>,
    /// True if the origin of times is known.
    has_moment: bool,
    /// Most bad rows that are skipped.
    most_bad: u64,
    passed_over: PassedOver,
    mended: Mended,
    /// Repairs since the chunk given last.
    newly_mended: Vec<MendedRow>,
    /// A line with too few fields, of which it is not known yet whether it is the last.
    held: Option<Block>,
    left_out: Option<LeftOut>,
    /// A rejection that follows the rows returned last.
    fault: Option<Rejection>,
    rows: u64,
    done: bool,
}

impl<R: Read> ExportReader<R> {
    /// Reads the header. `path` is for messages only.
    ///
    /// # Errors
    /// A rejection of the file or its header, from [`preamble::read`] and [`map_columns`].
    pub fn new(
        reader: R,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Self, Rejection> {
        let read = Self::of_growing(reader, path, layout, robot, options)?;
        read.ok_or_else(|| Rejection::of_file(path, "an empty file", cell_reader::CUT_REMEDY))
    }

    /// Like [`ExportReader::new`], for a file that may still grow: `None` as long as its header has no line end; also
    /// for an empty file.
    ///
    /// # Errors
    /// Those of [`ExportReader::new`].
    pub fn of_growing(
        reader: R,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Option<Self>, Rejection> {
        let mut blocks = Blocks::new(reader, options.block_bytes, layout.text.encoding);
        let Some(header) = preamble::read(&mut blocks, layout, path)? else { return Ok(None) };
        Self::with_header(blocks, &header, path, layout, robot).map(Some)
    }

    fn with_header(
        mut blocks: Blocks<R>,
        header: &Header,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
    ) -> Result<Self, Rejection> {
        let is_known = plausible::shows_export(known_columns(&header.text, layout, robot, path));
        let map = match map_columns(&header.text, layout, robot, path) {
            Ok(map) => map,
            Err(rejection) if rejection.line.is_none() => return Err(rejection),
            Err(rejection) => {
                let rejection = rejection.at_line(header.line);
                let below = lines_below(&mut blocks, path);
                let is_header = |(text, _): &&(String, u64)| map_columns(text, layout, robot, path).is_ok();
                if let Some((_, line)) = below.iter().find(is_header).filter(|_| layout.header) {
                    return Err(rejection.with_header_at(*line));
                }
                // without a column the message quotes nothing
                let may_be_quoted = is_known
                    || rejection.column.is_none()
                    || plausible::is_export(&header.text, below.iter().map(|(text, _)| &**text));
                return Err(match may_be_quoted {
                    true => rejection,
                    false => plausible::no_export(path, header.line, &header.text, layout),
                });
            }
        };
        Ok(Self {
            blocks,
            is_known,
            header_line: layout.header.then_some(header.line),
            header: layout.header.then(|| header.text.clone()),
            parser: Parser::new(map),
            path: path.to_owned(),
            previous: None,
            has_moment: false,
            most_bad: layout.rows.skip_bad,
            passed_over: PassedOver::default(),
            mended: Mended::default(),
            newly_mended: Vec::new(),
            held: None,
            left_out: None,
            fault: None,
            rows: 0,
            done: false,
        })
    }

    /// Column of each channel.
    pub fn columns(&self) -> &ColumnMap {
        self.parser.map()
    }

    /// The header of the rows; `None` if columns are selected by number.
    pub fn header(&self) -> Option<&str> {
        self.header.as_deref()
    }

    /// Encoding of the file, as far as it was read.
    pub fn encoding(&self) -> Found {
        self.blocks.encoding()
    }

    /// Rows returned so far.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// The last line, if it was omitted because the writer did not complete it; see [`cell_reader::judge_last_line`].
    pub fn left_out(&self) -> Option<LeftOut> {
        self.left_out
    }

    /// The bad rows that were skipped so far; the first of them is unknown if another reader found it.
    pub fn passed_over(&self) -> &PassedOver {
        &self.passed_over
    }

    /// Repairs so far, as far as this reader made them.
    pub fn mended(&self) -> &Mended {
        &self.mended
    }

    /// Sentences about a cut last row and bytes behind it, which the rows do not contain.
    pub fn left_out_at_end(&self) -> Vec<String> {
        let mut behind = Mended::default();
        if let Some(Places { count, first_line }) = self.mended.places(Mend::TrailingNuls) {
            behind.note(Mend::TrailingNuls, count, first_line);
        }
        let line = self.left_out.map(|LeftOut { line, reason }| {
            format!("line {line}: the last line {reason}; the row is left out")
        });
        line.into_iter().chain(behind.sentences()).collect()
    }

    /// Passes over rows, a block of them at most, on the way to `position`, where a reader of the same export stood.
    /// To be called before the first [`ExportReader::step`], until it says [`Passed::There`]; with
    /// [`Passed::Elsewhere`] the export is another one, and this reader is of no use.
    ///
    /// # Errors
    /// A rejection of a file that is unreadable within this part.
    pub fn pass_to(&mut self, position: &ReadPosition) -> Result<Passed, Rejection> {
        let passed = self.blocks.pass_to(position.line, position.byte, &self.path)?;
        if passed == Passed::There {
            (self.rows, self.previous) = (position.rows, position.previous);
            self.passed_over.rows = position.rows_skipped;
            self.parser.count_from_number(position.origin);
            self.has_moment = true;
            position.moment.into_iter().for_each(|moment| self.parser.count_from_moment(moment));
        }
        Ok(passed)
    }

    fn position_before(&self, block: &Block) -> ReadPosition {
        ReadPosition {
            line: block.first_line,
            byte: block.first_byte,
            rows: self.rows,
            rows_skipped: self.passed_over.rows,
            previous: self.previous,
            origin: self.parser.map().time_origin,
            moment: self.parser.counted_from(),
        }
    }

    /// The next rows. Must be called again after [`Step::Waiting`], and not after [`Step::End`] or a rejection.
    ///
    /// # Errors
    /// A rejection of the first line that is not understood, after the rows before it.
    pub fn step(&mut self) -> Result<Step, Rejection> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        loop {
            let mut block = match self.blocks.next_block(&self.path)? {
                Next::Block(block) => block,
                Next::Later => return Ok(Step::Waiting),
                Next::End => return self.end(),
            };
            // more lines prove that the short line was not the last one
            if let Some(held) = self.held.take() {
                self.take_rows(held)?;
            }
            match block.unterminated {
                true => self.judge_end(&mut block)?,
                false => self.hold_short_line(&mut block),
            }
            if block.bytes.is_empty() {
                continue;
            }
            let (first_line, position) = (block.first_line, self.position_before(&block));
            let samples = self.take_rows(block)?;
            if !samples.is_empty() {
                let mended = std::mem::take(&mut self.newly_mended);
                return Ok(Step::Rows(Box::new(Chunk { samples, first_line, position, mended })));
            }
        }
    }

    /// The rows of a block, counted. A fault after some of them is returned by the next step.
    fn take_rows(&mut self, block: Block) -> Result<RawSamples, Rejection> {
        if !self.has_moment {
            self.has_moment = self.parser.count_from(&block);
        }
        let left = self.most_bad.saturating_sub(self.passed_over.rows);
        let read = self.parser.read_passing_over(&block, self.previous, &self.path, left);
        // the count of rows includes all lines
        let lines = match self.parser.map().time {
            TimeColumn::Counted(_) => line_count(&block.bytes),
            _ => 0,
        };
        let ReadRows { samples, passed_over, mended, clock, row } = match read {
            Ok(read) => {
                self.blocks.give_back(block.bytes);
                read
            }
            Err(rejection) => {
                let rejection = self.placed(rejection, &block);
                self.rows_before(block, rejection, left)?
            }
        };
        self.note_time(&samples, lines, (row, clock));
        self.rows += samples.rows() as u64;
        self.passed_over.add(passed_over);
        self.mended.add(&mended);
        self.newly_mended.extend(mended);
        Ok(samples)
    }

    /// Adds the place in the file to the rejection of a line of `block`, and an explanation if a first line consists of
    /// words.
    fn placed(&self, mut rejection: Rejection, block: &Block) -> Rejection {
        let Some(line) = rejection.line else { return rejection };
        let before = start_of_line(block, line).and_then(|at| block.bytes.get(..at)).unwrap_or_default();
        rejection = rejection.at_byte(block.first_byte + block.encoding.bytes_in_file(before));
        if self.header_line.is_some_and(|header| header + 1 == line) && &*rejection.reason == "not a number" {
            rejection.remedy =
                "if this line gives units or types, set skip_after_header = 1 in the layout".into();
            return rejection;
        }
        if sparse::explain(&mut rejection, self.parser.map(), block) {
            return rejection;
        }
        rejection.remedy = self.with_skip_bad(&rejection).into();
        rejection
    }

    /// The remedy for a bad row, with the setting that skips such rows.
    fn with_skip_bad(&self, rejection: &Rejection) -> String {
        let remedy = &rejection.remedy;
        match (rejection.is_bad_row, self.most_bad) {
            (false, _) => remedy.to_string(),
            (true, 0) => {
                format!(
                    "{remedy}; or allow a few such rows to be skipped: skip_bad = 10 under [rows] in the layout"
                )
            }
            (true, most) => format!(
                "{remedy}; as many bad rows as skip_bad = {most} under [rows] of the layout permits were \
                skipped before it"
            ),
        }
    }

    /// The rows of a block before its fault, which comes with the next chunk: the result does not depend on the block
    /// boundaries.
    ///
    /// # Errors
    /// The rejection itself if there is no row before it.
    fn rows_before(
        &mut self,
        mut block: Block,
        rejection: Rejection,
        most: u64,
    ) -> Result<ReadRows, Rejection> {
        let end = rejection.line.and_then(|line| start_of_line(&block, line)).filter(|end| *end > 0);
        let Some(end) = end else { return Err(self.unquoted(rejection)) };
        block.bytes.truncate(end);
        let read = self.parser.read_passing_over(&block, self.previous, &self.path, most);
        match read {
            Ok(read) if !read.samples.is_empty() => {
                self.fault = Some(rejection);
                Ok(read)
            }
            _ => Err(self.unquoted(rejection)),
        }
    }

    /// The rejection of a row with no understood row before it. If no column name shows that the file is an export, it
    /// may be any file, and its text is not quoted.
    fn unquoted(&self, mut rejection: Rejection) -> Rejection {
        if self.rows == 0 && !self.is_known {
            let names = &self.parser.map().names;
            let number = rejection
                .column
                .as_deref()
                .and_then(|column| names.iter().position(|name| **name == *column));
            rejection.column = number.map(|number| (number + 1).to_string().into());
            rejection.value = None;
        }
        rejection
    }

    /// Removes the last line of a block if it has too few fields: the next block shows if it is the file's last.
    fn hold_short_line(&mut self, block: &mut Block) {
        let last = cell_reader::lines(&block.bytes).next_back().unwrap_or_default();
        if !cell_reader::is_short(last, self.parser.map()) {
            return;
        }
        let start = block.bytes.len().saturating_sub(last.len() + 1);
        let bytes = block.bytes.split_off(start);
        self.held = Some(Block {
            first_line: block.first_line + line_count(&block.bytes),
            first_byte: block.first_byte + block.encoding.bytes_in_file(&block.bytes),
            bytes,
            encoding: block.encoding,
            unterminated: false,
        });
    }

    /// Removes the last line of a file without line end from its block if it may be cut.
    fn judge_end(&mut self, block: &mut Block) -> Result<(), Rejection> {
        let lines = line_count(&block.bytes);
        let number = block.first_line + lines.saturating_sub(1);
        let last = cell_reader::lines(&block.bytes).next_back().unwrap_or_default();
        let length = last.len() + 1;
        let reason = match cell_reader::judge_last_line(last, number, self.parser.map(), &self.path)? {
            LastLine::Whole => return Ok(()),
            LastLine::Doubtful => MAY_BE_CUT,
            LastLine::Cut => IS_CUT,
        };
        self.leave_out(number, reason);
        block.bytes.truncate(block.bytes.len().saturating_sub(length));
        Ok(())
    }

    fn leave_out(&mut self, line: u64, reason: &'static str) {
        tracing::warn!(path = %text::of_path(&self.path), line, "the last line {reason}; the row is skipped");
        self.left_out = Some(LeftOut { line, reason });
    }

    fn end(&mut self) -> Result<Step, Rejection> {
        if let Some(held) = self.held.take() {
            self.leave_out(held.first_line, IS_CUT);
        }
        if let Some((nuls, line)) = self.blocks.trailing_nuls() {
            self.mended.note(Mend::TrailingNuls, nuls, line);
        }
        if self.rows > 0 {
            if self.passed_over.rows > 0 {
                self.remark_passed_over();
            }
            for remark in self.mended.sentences() {
                tracing::warn!(path = %text::of_path(&self.path), "{remark}");
            }
            return Ok(Step::End);
        }
        if let Some(first) = self.passed_over.first.take() {
            return Err(*first);
        }
        if let Some(LeftOut { line, .. }) = self.left_out {
            return Err(
                Rejection::of_file(&self.path, cell_reader::CUT, cell_reader::CUT_REMEDY).at_line(line)
            );
        }
        let reason = "a header but no rows";
        Err(Rejection::of_file(&self.path, reason, "export again, with the rows of the recording"))
    }

    fn remark_passed_over(&self) {
        let first = self.passed_over.first.as_ref().map(|first| first.sentence()).unwrap_or_default();
        let (path, rows) = (text::of_path(&self.path), self.passed_over.rows);
        tracing::warn!(%path, rows, first, "bad rows were skipped, as skip_bad of the layout permits");
    }

    /// Notes the last time of a block of `lines` lines, with the hash of its last line and the reading of its clock
    /// there.
    fn note_time(
        &mut self,
        samples: &RawSamples,
        lines: u64,
        (row, clock): (Option<ContentHash>, Option<PreviousTime>),
    ) {
        let (before, map) = (self.previous, self.parser.map());
        if let Some(last) = samples.time.last() {
            let origin = map.time_origin.map_or(0.0, Decimal::to_f64);
            let recorded = last / map.to_si.time + origin;
            self.previous = Some(PreviousTime { recorded, seconds: *last, row, ..clock.unwrap_or_default() });
        }
        // counted rows continue after the last line, also if it was skipped
        if let TimeColumn::Counted(rate) = map.time
            && let Some(last) = usize::try_from(lines).ok().and_then(|lines| lines.checked_sub(1))
            && self.fault.is_none()
        {
            let times = channels::counted([last], rate, before.map(|before| before.seconds));
            let at = |seconds: &f64| PreviousTime {
                recorded: *seconds,
                seconds: *seconds,
                ..PreviousTime::default()
            };
            self.previous = times.first().map(at);
        }
    }
}

/// The lines below an invalid header, with their numbers.
fn lines_below<R: Read>(blocks: &mut Blocks<R>, path: &Path) -> Vec<(String, u64)> {
    // line by line, so that it does not depend on how much was read
    let next = || blocks.next_line(path).ok().flatten().map(|line| (line.text, line.number));
    std::iter::from_fn(next).take(MOST_LINES_ABOVE_HEADER).collect()
}

/// Start of a line of a block.
fn start_of_line(block: &Block, line: u64) -> Option<usize> {
    match line.checked_sub(block.first_line)? {
        0 => Some(0),
        lines => {
            let ends = block.bytes.iter().enumerate().filter(|(_, byte)| **byte == b'\n');
            ends.map(|(at, _)| at + 1).nth(usize::try_from(lines).ok()?.checked_sub(1)?)
        }
    }
}

impl<R: Read> Iterator for ExportReader<R> {
    type Item = Result<Chunk, Rejection>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = match self.step() {
            Ok(Step::Rows(chunk)) => Some(Ok(*chunk)),
            Ok(Step::Waiting | Step::End) => None,
            Err(rejection) => Some(Err(rejection)),
        };
        self.done = !matches!(item, Some(Ok(_)));
        item
    }
}

mod going_on;

#[cfg(test)]
mod tests;

#[cfg(test)]
mod odd_exports_tests;

#[cfg(test)]
mod mended_tests;

#[cfg(test)]
mod temperature_tests;
