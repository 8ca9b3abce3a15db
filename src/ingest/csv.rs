//! The rows of an export, chunk by chunk, with the place of whatever is not understood.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::blocks::{BLOCK_BYTES, Block, Blocks, Next, Passed, line_count};
use super::cell::Decimal;
use super::encoding::Found;
use super::exact::{self, LastLine, PreviousTime};
use super::layout::{ColumnMap, map_columns};
use super::parser::Parser;
use super::preamble::{self, Header};
use super::rejection::Rejection;
use crate::config::Layout;
use crate::robot::Robot;
use crate::run::Samples;

/// How an export is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadOptions {
    /// Bytes of a block.
    pub block_bytes: usize,
    /// Threads that polars may use for one block. With 1, parallelism comes from reading several
    /// exports or blocks at once. polars' own pool bounds the sum (`POLARS_MAX_THREADS`).
    pub threads: usize,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { block_bytes: BLOCK_BYTES, threads: 1 }
    }
}

/// Consecutive rows of an export.
#[derive(Debug, Clone, PartialEq)]
pub struct Chunk {
    /// The rows, in SI.
    pub samples: Samples,
    /// Line of the first row in the decompressed file, from 1.
    pub first_line: u64,
    /// Where the reader stood before them.
    pub place: Place,
}

/// Where a reader stands before a row: with it, another reader of the same export goes on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Place {
    /// Line of the row in the decompressed file, from 1.
    pub line: u64,
    /// Its first byte in the decompressed file, from 0.
    pub byte: u64,
    /// Rows before it.
    pub rows: u64,
    /// Time of the row before, as recorded and counted on.
    pub previous: Option<PreviousTime>,
    /// Number that times count from, in the export's unit, where time is a column of numbers.
    pub origin: Option<Decimal>,
    /// Moment that dates and times count from, ns from 1970, where they do.
    pub moment: Option<i64>,
}

/// What an export gives next.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Rows.
    Rows(Box<Chunk>),
    /// No whole row now; the file may still grow.
    Waiting,
    /// No more rows.
    End,
}

/// The rows of an export, chunk by chunk. Ends after the first rejection.
///
/// An export without rows gives a rejection, so at least one item comes.
#[derive(Debug)]
pub struct ExportReader<R> {
    blocks: Blocks<R>,
    parser: Parser,
    path: PathBuf,
    /// Line of the header; `None` without one.
    header_line: Option<u64>,
    previous: Option<PreviousTime>,
    left_out: Option<u64>,
    /// A rejection that follows the rows given last.
    fault: Option<Rejection>,
    rows: u64,
    done: bool,
}

impl<R: Read> ExportReader<R> {
    /// Reads the header. `path` is for messages only.
    ///
    /// # Errors
    /// A rejection of the file or its header, as [`preamble::read`] and [`map_columns`] give it.
    pub fn new(
        reader: R,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Self, Rejection> {
        let read = Self::of_growing(reader, path, layout, robot, options)?;
        read.ok_or_else(|| Rejection::of_file(path, "an empty file", exact::CUT_REMEDY))
    }

    /// As [`ExportReader::new`], of a file that may still grow: `None` as long as its header has no
    /// line end; also of an empty file.
    ///
    /// # Errors
    /// As [`ExportReader::new`].
    pub fn of_growing(
        reader: R,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Option<Self>, Rejection> {
        let mut blocks = Blocks::new(reader, options.block_bytes, layout.text.encoding);
        let Some(header) = preamble::read(&mut blocks, layout, path)? else { return Ok(None) };
        Self::with_header(blocks, &header, path, layout, robot, options).map(Some)
    }

    fn with_header(
        blocks: Blocks<R>,
        header: &Header,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Self, Rejection> {
        let map =
            map_columns(&header.text, layout, robot, path).map_err(|rejection| match rejection.line {
                Some(_) => rejection.at_line(header.line),
                None => rejection,
            })?;
        Ok(Self {
            blocks,
            header_line: layout.header.then_some(header.line),
            parser: Parser::new(map, options.threads),
            path: path.to_owned(),
            previous: None,
            left_out: None,
            fault: None,
            rows: 0,
            done: false,
        })
    }

    /// Where each channel stands.
    #[must_use]
    pub fn columns(&self) -> &ColumnMap {
        self.parser.map()
    }

    /// How the file writes its text, as far as it was read.
    #[must_use]
    pub fn encoding(&self) -> Found {
        self.blocks.encoding()
    }

    /// Rows given so far.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// The last line, where it was left out because its last number may be cut; see
    /// [`exact::judge_last_line`].
    #[must_use]
    pub fn left_out_line(&self) -> Option<u64> {
        self.left_out
    }

    /// Passes over rows, a block of them at most, on the way to `place`, where a reader of the same export stood.
    /// To be called before the first [`ExportReader::step`], until it says [`Passed::There`]; with
    /// [`Passed::Elsewhere`] the export is another one, and this reader is of no use.
    ///
    /// # Errors
    /// A rejection of a file that cannot be read so far.
    pub fn pass_to(&mut self, place: &Place) -> Result<Passed, Rejection> {
        let passed = self.blocks.pass_to(place.line, place.byte, &self.path)?;
        if passed == Passed::There {
            (self.rows, self.previous) = (place.rows, place.previous);
            self.parser.count_from_number(place.origin);
            place.moment.into_iter().for_each(|moment| self.parser.count_from_moment(moment));
        }
        Ok(passed)
    }

    fn place(&self, block: &Block) -> Place {
        Place {
            line: block.first_line,
            byte: block.first_byte,
            rows: self.rows,
            previous: self.previous,
            origin: self.parser.map().time_origin,
            moment: self.parser.counted_from(),
        }
    }

    /// The next rows. To be asked again after [`Step::Waiting`], and no more after [`Step::End`] or a
    /// rejection.
    ///
    /// # Errors
    /// A rejection of the first line that is not understood, after the rows before it.
    pub fn step(&mut self) -> Result<Step, Rejection> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let mut block = match self.blocks.next_block(&self.path)? {
            Next::Block(block) => block,
            Next::Later => return Ok(Step::Waiting),
            Next::End => return self.end(),
        };
        let (first_line, place) = (block.first_line, self.place(&block));
        if self.rows == 0 {
            self.parser.count_from(&block);
        }
        let judged = if block.unterminated { self.judge_end(&mut block) } else { Ok(()) };
        if block.bytes.is_empty() {
            return self.end();
        }
        let read = judged.and_then(|()| self.parser.read(&block, self.previous, &self.path));
        let samples = match read {
            Ok(samples) => samples,
            Err(rejection) => {
                let rejection = self.placed(rejection, &block);
                self.rows_before(block, rejection)?
            }
        };
        self.note_time(&samples);
        self.rows += samples.rows() as u64;
        Ok(Step::Rows(Box::new(Chunk { samples, first_line, place })))
    }

    /// The rejection of a line of `block` with its place in the file, and with what a first line of words means.
    fn placed(&self, mut rejection: Rejection, block: &Block) -> Rejection {
        let Some(line) = rejection.line else { return rejection };
        let before = start_of_line(block, line).and_then(|at| block.bytes.get(..at)).unwrap_or_default();
        rejection = rejection.at_byte(block.first_byte + block.encoding.bytes_in_file(before));
        if self.header_line.is_some_and(|header| header + 1 == line) && &*rejection.reason == "not a number" {
            rejection.remedy =
                "if this line gives units or types, set skip_after_header = 1 in the layout".into();
        }
        rejection
    }

    /// The rows of a block before its fault, which comes with the next chunk: what is given does not
    /// depend on where blocks end.
    ///
    /// # Errors
    /// The rejection itself where no row stands before it.
    fn rows_before(&mut self, mut block: Block, rejection: Rejection) -> Result<Samples, Rejection> {
        let end = rejection.line.and_then(|line| start_of_line(&block, line)).filter(|end| *end > 0);
        let Some(end) = end else { return Err(rejection) };
        block.bytes.truncate(end);
        let Ok(samples) = self.parser.read(&block, self.previous, &self.path) else { return Err(rejection) };
        self.fault = Some(rejection);
        Ok(samples)
    }

    fn judge_end(&mut self, block: &mut Block) -> Result<(), Rejection> {
        let lines = line_count(&block.bytes);
        let number = block.first_line + lines.saturating_sub(1);
        let last = exact::lines(&block.bytes).last().unwrap_or_default();
        let length = last.len() + 1;
        if exact::judge_last_line(last, number, self.parser.map(), &self.path)? == LastLine::Doubtful {
            tracing::warn!(
                path = %self.path.display(),
                line = number,
                "the last line has no line end and its last number may be cut; the row is left out"
            );
            self.left_out = Some(number);
            block.bytes.truncate(block.bytes.len().saturating_sub(length));
        }
        Ok(())
    }

    fn end(&self) -> Result<Step, Rejection> {
        if self.rows > 0 {
            return Ok(Step::End);
        }
        let reason = "a header and no rows";
        Err(Rejection::of_file(&self.path, reason, "export again, with the recording in it"))
    }

    fn note_time(&mut self, samples: &Samples) {
        let Some(last) = samples.time.last() else { return };
        let map = self.parser.map();
        let origin = map.time_origin.map_or(0.0, Decimal::to_f64);
        self.previous = Some(PreviousTime { recorded: last / map.to_si.time + origin, seconds: *last });
    }
}

/// Where a line of a block begins.
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
