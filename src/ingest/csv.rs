//! Reading with polars, block by block, and with [`super::exact`] whatever polars would guess at.
//!
//! polars takes a line that is too short, ignores the header once it has a schema and reads a
//! number cut in half; so the schema here comes from the file's own header, and a block counts as
//! read only if its lines, its delimiters and its numbers are as many as they must be. Any other
//! block is read again cell by cell, which either understands it or names the first bad cell.

use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use polars::prelude::{
    Column, CsvParseOptions, CsvReadOptions, DataFrame, DataType, Field, Schema, SchemaRef, SerReader,
};

use super::blocks::{BLOCK_BYTES, Block, Blocks, line_count};
use super::channels::{self, RawColumns};
use super::exact::{self, LastLine, PreviousTime};
use super::layout::{ColumnMap, Role, map_columns};
use super::rejection::Rejection;
use crate::config::Layout;
use crate::robot::Robot;
use crate::run::Samples;

/// A first time beyond this, s, is a clock's and not counted from the recording's start: twelve
/// days are longer than any test. Times are then counted from the first row.
pub const MAX_START_TIME: f64 = 1e6;

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
}

/// The rows of an export, chunk by chunk. Ends after the first rejection.
///
/// An export without rows gives a rejection, so at least one item comes.
#[derive(Debug)]
pub struct ExportReader<R> {
    blocks: Blocks<R>,
    parser: Parser,
    path: PathBuf,
    previous: Option<PreviousTime>,
    /// Subtracted from every time, s.
    origin: f64,
    left_out: Option<u64>,
    rows: u64,
    done: bool,
}

impl<R: Read> ExportReader<R> {
    /// Reads the header. `path` is for messages only.
    ///
    /// # Errors
    /// A rejection of the file or its header, as [`Blocks::header`] and [`map_columns`] give it.
    pub fn new(
        reader: R,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Self, Rejection> {
        let mut blocks = Blocks::new(reader, options.block_bytes);
        let header = blocks.header(path)?;
        let map = map_columns(&header, layout, robot, path)?;
        Ok(Self {
            blocks,
            parser: Parser::new(map, options.threads),
            path: path.to_owned(),
            previous: None,
            origin: 0.0,
            left_out: None,
            rows: 0,
            done: false,
        })
    }

    /// Where each channel stands.
    #[must_use]
    pub fn columns(&self) -> &ColumnMap {
        &self.parser.map
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

    fn next_chunk(&mut self) -> Result<Option<Chunk>, Rejection> {
        let Some(mut block) = self.blocks.next_block(&self.path)? else { return self.end() };
        if block.unterminated {
            self.judge_end(&mut block)?;
            if block.bytes.is_empty() {
                return self.end();
            }
        }
        let mut samples = self.parser.read(&block, self.previous, &self.path)?;
        self.count_time(&mut samples);
        self.rows += samples.rows() as u64;
        Ok(Some(Chunk { samples, first_line: block.first_line }))
    }

    fn judge_end(&mut self, block: &mut Block) -> Result<(), Rejection> {
        let lines = line_count(&block.bytes);
        let number = block.first_line + lines.saturating_sub(1);
        let last = exact::lines(&block.bytes).last().unwrap_or_default();
        let length = last.len() + 1;
        if exact::judge_last_line(last, number, &self.parser.map, &self.path)? == LastLine::Doubtful {
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

    fn end(&self) -> Result<Option<Chunk>, Rejection> {
        if self.rows > 0 {
            return Ok(None);
        }
        let reason = "a header and no rows";
        Err(Rejection::of_file(&self.path, reason, "export again, with the recording in it"))
    }

    fn count_time(&mut self, samples: &mut Samples) {
        let (Some(first), Some(last)) = (samples.time.first(), samples.time.last()) else { return };
        if self.previous.is_none() && first.abs() > MAX_START_TIME {
            self.origin = *first;
        }
        let factor = self.parser.map.to_si.time;
        self.previous = Some(PreviousTime { recorded: last / factor, seconds: *last });
        if self.origin != 0.0 {
            samples.time.iter_mut().for_each(|time| *time -= self.origin);
        }
    }
}

impl<R: Read> Iterator for ExportReader<R> {
    type Item = Result<Chunk, Rejection>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = self.next_chunk().transpose();
        self.done = !matches!(item, Some(Ok(_)));
        item
    }
}

/// Reads blocks of one export; several threads may share it.
#[derive(Debug, Clone)]
pub struct Parser {
    map: ColumnMap,
    schema: SchemaRef,
    threads: usize,
}

impl Parser {
    /// A parser for exports with these columns.
    #[must_use]
    pub fn new(map: ColumnMap, threads: usize) -> Self {
        // Columns go by number, since names may be empty or come twice.
        let field = |(column, role): (usize, &Role)| {
            let kind = if *role == Role::Ignored { DataType::String } else { DataType::Float64 };
            Field::new(column.to_string().into(), kind)
        };
        let schema = map.roles.iter().enumerate().map(field).collect::<Schema>();
        Self { map, schema: Arc::new(schema), threads }
    }

    /// The rows of a block whose lines are whole; time must be later than `previous`.
    ///
    /// # Errors
    /// A rejection of the first cell that is not understood.
    pub fn read(
        &self,
        block: &Block,
        previous: Option<PreviousTime>,
        path: &Path,
    ) -> Result<Samples, Rejection> {
        let fast = self
            .columns(&block.bytes)
            .and_then(|columns| channels::samples(columns, &self.map, previous.map(|p| p.seconds)));
        match fast {
            Some(samples) => Ok(samples),
            None => exact::read(block, &self.map, previous, path),
        }
    }

    /// The needed columns as polars reads them, or `None` if anything is out of the ordinary.
    fn columns(&self, bytes: &[u8]) -> Option<RawColumns> {
        let rows = usize::try_from(line_count(bytes)).ok()?;
        // Without quotes a delimiter is a delimiter: with as many as there must be, and polars
        // refusing lines with more, no line has fewer.
        let delimiters = bytes.iter().filter(|byte| **byte == self.map.delimiter).count();
        let regular = delimiters == rows * self.map.names.len().saturating_sub(1)
            && !bytes.contains(&b'"')
            && !bytes.contains(&0)
            && std::str::from_utf8(bytes).is_ok();
        if !regular {
            return None;
        }
        let frame = self.parsed(bytes).filter(|frame| frame.height() == rows)?;
        let needed = |(column, role): (&Column, &Role)| match role {
            Role::Ignored => Some(Vec::new()),
            _ => numbers(column, rows),
        };
        frame.columns().iter().zip(&self.map.roles).map(needed).collect()
    }

    fn parsed(&self, bytes: &[u8]) -> Option<DataFrame> {
        let format = CsvParseOptions::default().with_separator(self.map.delimiter).with_quote_char(None);
        // polars cuts a block into sixteen parts for each of its threads, whatever pool they run
        // on; only 0 keeps a block whole, and one part is parsed by one thread.
        let threads = if self.threads <= 1 { 0 } else { self.threads };
        CsvReadOptions::default()
            .with_has_header(false)
            .with_schema(Some(self.schema.clone()))
            .with_n_threads(Some(threads))
            .with_parse_options(format)
            .into_reader_with_file_handle(Cursor::new(bytes))
            .finish()
            .ok()
    }
}

/// The numbers of a column without a gap.
fn numbers(column: &Column, rows: usize) -> Option<Vec<f64>> {
    let column = column.f64().ok().filter(|c| c.null_count() == 0)?;
    let mut values = Vec::with_capacity(rows);
    for part in column.downcast_iter() {
        values.extend_from_slice(part.values().as_slice());
    }
    Some(values)
}
