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

use super::blocks::{BLOCK_BYTES, Block, Blocks, Next, line_count};
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

/// What an export gives next.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// Rows.
    Rows(Chunk),
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
    previous: Option<PreviousTime>,
    /// Subtracted from every time, s.
    origin: f64,
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
        Self::with_header(blocks, &header, path, layout, robot, options)
    }

    /// As [`ExportReader::new`], of a file that may still grow: `None` as long as its header has no
    /// line end.
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
        let mut blocks = Blocks::new(reader, options.block_bytes);
        let Some(header) = blocks.whole_header(path)? else { return Ok(None) };
        Self::with_header(blocks, &header, path, layout, robot, options).map(Some)
    }

    fn with_header(
        mut blocks: Blocks<R>,
        header: &str,
        path: &Path,
        layout: &Layout,
        robot: &Robot,
        options: ReadOptions,
    ) -> Result<Self, Rejection> {
        let map = map_columns(header, layout, robot, path)?;
        if !layout.header {
            blocks.put_back(header);
        }
        Ok(Self {
            blocks,
            parser: Parser::new(map, options.threads),
            path: path.to_owned(),
            previous: None,
            origin: 0.0,
            left_out: None,
            fault: None,
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
        let first_line = block.first_line;
        let judged = if block.unterminated { self.judge_end(&mut block) } else { Ok(()) };
        if block.bytes.is_empty() {
            return self.end();
        }
        let read = judged.and_then(|()| self.parser.read(&block, self.previous, &self.path));
        let mut samples = match read {
            Ok(samples) => samples,
            Err(rejection) => self.rows_before(block, rejection)?,
        };
        self.count_time(&mut samples);
        self.rows += samples.rows() as u64;
        Ok(Step::Rows(Chunk { samples, first_line }))
    }

    /// The rows of a block before its fault, which comes with the next chunk: what is given does not
    /// depend on where blocks end.
    ///
    /// # Errors
    /// The rejection itself where no row stands before it.
    fn rows_before(&mut self, mut block: Block, rejection: Rejection) -> Result<Samples, Rejection> {
        let sound = rejection.line.and_then(|line| line.checked_sub(block.first_line)).unwrap_or(0);
        let end = (block.bytes.iter().enumerate())
            .filter(|(_, byte)| **byte == b'\n')
            .nth(usize::try_from(sound).unwrap_or(0).wrapping_sub(1))
            .map(|(at, _)| at + 1);
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

    fn end(&self) -> Result<Step, Rejection> {
        if self.rows > 0 {
            return Ok(Step::End);
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
        let item = match self.step() {
            Ok(Step::Rows(chunk)) => Some(Ok(chunk)),
            Ok(Step::Waiting | Step::End) => None,
            Err(rejection) => Some(Err(rejection)),
        };
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
            let text = *role == Role::Ignored || channels::is_text(*role, &map);
            let kind = if text { DataType::String } else { DataType::Float64 };
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
            role if channels::is_text(*role, &self.map) => word_numbers(column, *role, &self.map),
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

/// The numbers that the words of a column stand for, or `None` if one of them stands for none.
fn word_numbers(column: &Column, role: Role, map: &ColumnMap) -> Option<Vec<f64>> {
    // a stage lasts for thousands of rows: the word of the row before is nearly always this one
    let mut last: Option<(&str, f64)> = None;
    let words = column.str().ok()?.iter().map(|word| word.unwrap_or_default());
    words
        .map(|word| match last {
            Some((known, number)) if known == word => Some(number),
            _ => {
                let found = channels::word_number(word, role, map)?;
                last = Some((word, found));
                Some(found)
            }
        })
        .collect()
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::super::fixture::{channel, fixture, native, read_bytes, recording};
    use super::*;
    use crate::config::{Column, JointSigns, ScaledColumn, StageSource, TimeSource};
    use crate::run::Stage;
    use crate::testing::er3a;

    fn with_blocks_of(block_bytes: usize) -> ReadOptions {
        ReadOptions { block_bytes, ..ReadOptions::default() }
    }

    fn made_recording(rows: usize) -> (Samples, String) {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        recording(rows, || random.random_range(-100.0..100.0))
    }

    fn parser(header: &str) -> Parser {
        Parser::new(map_columns(header, &native(), &er3a(), Path::new("a.csv")).unwrap(), 1)
    }

    fn body(text: &str) -> Block {
        let mut blocks = Blocks::new(text.as_bytes(), 1 << 20);
        blocks.header(Path::new("a.csv")).unwrap();
        match blocks.next_block(Path::new("a.csv")).unwrap() {
            Next::Block(block) => block,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn rows_without_header_time_and_stage_are_counted_and_named_by_the_layout() {
        let layout = Layout {
            header: false,
            time: TimeSource::SampleRate(5000.0),
            position: channel("{joint}"),
            velocity: None,
            torque: channel("{joint+6}"),
            stage: StageSource::Whole(Stage::Excitation),
            ..native()
        };
        let text: String = (0..50)
            .map(|row| {
                let cells: Vec<String> =
                    (0..12).map(|column| format!("{}", f64::from(row * 100 + column))).collect();
                cells.join(",") + "\n"
            })
            .collect();
        for block_bytes in [100, 1 << 20] {
            let reader = ExportReader::new(
                text.as_bytes(),
                Path::new("a.csv"),
                &layout,
                &er3a(),
                with_blocks_of(block_bytes),
            );
            let mut samples = Samples::default();
            reader.unwrap().for_each(|chunk| samples.append(chunk.unwrap().samples));
            assert_eq!((samples.rows(), samples.time[0], samples.time[49]), (50, 0.0, 49.0 / 5000.0));
            assert_eq!((samples.position[2][7], samples.torque[2][7]), (702.0, 708.0));
            assert!(samples.velocity.is_none() && samples.cycle.is_none());
            assert!(samples.stage.iter().all(|stage| *stage == Stage::Excitation));
        }
        let broken = text.replacen("1003", "x", 1);
        let reader = ExportReader::new(
            broken.as_bytes(),
            Path::new("a.csv"),
            &layout,
            &er3a(),
            ReadOptions::default(),
        );
        let rejection = reader.unwrap().find_map(Result::err).unwrap();
        assert_eq!((rejection.line, rejection.column.as_deref()), (Some(11), Some("4")));
    }

    #[test]
    fn rows_before_a_fault_come_whole_whatever_the_blocks() {
        let (_, text) = made_recording(200);
        let mut lines: Vec<&str> = text.lines().collect();
        let broken = lines[150].replacen(',', ",x", 1);
        lines[150] = &broken;
        let text = lines.join("\n") + "\n";
        for block_bytes in [600, 5000, 1 << 20] {
            let reader = ExportReader::new(
                text.as_bytes(),
                Path::new("a.csv"),
                &native(),
                &er3a(),
                with_blocks_of(block_bytes),
            );
            let items: Vec<_> = reader.unwrap().collect();
            let rows: usize = items.iter().flatten().map(|chunk| chunk.samples.rows()).sum();
            assert_eq!(rows, 149, "blocks of {block_bytes} bytes");
            assert_eq!(items.last().unwrap().as_ref().unwrap_err().line, Some(151));
        }
    }

    #[test]
    fn polars_itself_reads_the_ordinary_export() {
        let (samples, text) = made_recording(500);
        let parser = parser(text.lines().next().unwrap());
        let columns = parser.columns(&body(&text).bytes).expect("nothing is odd");
        assert_eq!(channels::samples(columns, &parser.map, None), Some(samples));
    }

    /// Slow reading gives the same rows, so only this notices if common files take the slow road.
    #[test]
    fn common_variants_do_not_need_the_exact_reader() {
        for name in ["crlf.csv", "reordered.csv", "extra_columns.csv", "trailing_delimiters.csv"] {
            let text = std::fs::read_to_string(fixture(name)).unwrap();
            let parser = parser(text.lines().next().unwrap());
            assert!(parser.columns(&body(&text).bytes).is_some(), "{name}");
        }
    }

    #[test]
    fn more_threads_read_the_same() {
        let (samples, text) = made_recording(2000);
        for threads in [0, 1, 2, 5] {
            let options = ReadOptions { threads, ..ReadOptions::default() };
            assert_eq!(read_bytes(text.as_bytes(), &native(), options).as_ref(), Ok(&samples), "{threads}");
        }
    }

    #[test]
    fn lines_and_rows_are_counted_over_chunks() {
        let (_, text) = made_recording(300);
        let path = Path::new("a.csv");
        let mut reader =
            ExportReader::new(text.as_bytes(), path, &native(), &er3a(), with_blocks_of(5000)).unwrap();
        let mut line = 2;
        let mut chunks = 0;
        for chunk in reader.by_ref() {
            let chunk = chunk.unwrap();
            assert_eq!(chunk.first_line, line);
            line += chunk.samples.rows() as u64;
            chunks += 1;
        }
        assert!(chunks > 10);
        assert_eq!((reader.rows(), reader.left_out_line()), (300, None));
        assert!(reader.next().is_none());
    }

    #[test]
    fn time_is_compared_over_chunks_and_reading_ends_at_the_rejection() {
        let (_, text) = made_recording(200);
        let twice = format!("{text}{}", text.split_once('\n').unwrap().1);
        for block_bytes in [1, 700, 5000, 1 << 20] {
            let options = with_blocks_of(block_bytes);
            let mut reader =
                ExportReader::new(twice.as_bytes(), Path::new("a.csv"), &native(), &er3a(), options).unwrap();
            let rejection = reader.find_map(Result::err).expect("time runs backwards");
            assert_eq!((rejection.line, rejection.value.as_deref()), (Some(202), Some("0")));
            assert_eq!(rejection.reason, "earlier than 0.398 in the row before: time runs backwards");
            assert!(reader.next().is_none());
        }
    }

    #[test]
    fn foreign_units_end_here() {
        let mut layout = native();
        layout.time = TimeSource::Column(ScaledColumn { column: Column::Name("time".into()), to_si: 1e-3 });
        layout.position.to_si = std::f64::consts::PI / 180.0;
        layout.torque.to_si = 50.0;
        layout.torque.sign = JointSigns::Each(vec![1.0, 1.0, 1.0, 1.0, 1.0, -1.0]);
        let (samples, text) = made_recording(20);
        let read = read_bytes(text.as_bytes(), &layout, ReadOptions::default()).unwrap();
        for row in 0..20 {
            assert_eq!(read.time[row], samples.time[row] * 1e-3);
            assert_eq!(read.position[2][row], samples.position[2][row] * (std::f64::consts::PI / 180.0));
            assert_eq!(read.torque[4][row], samples.torque[4][row] * 50.0);
            assert_eq!(read.torque[5][row], samples.torque[5][row] * -50.0);
        }
        assert_eq!(read.velocity, samples.velocity);
    }

    #[test]
    fn clock_times_are_counted_from_the_first_row_and_others_are_not() {
        let (samples, text) = made_recording(50);
        let moved = |origin: f64| {
            let lines = text.lines().enumerate().map(|(number, line)| match (number, line.split_once(',')) {
                (1.., Some((time, rest))) => format!("{},{rest}\n", time.parse::<f64>().unwrap() + origin),
                _ => format!("{line}\n"),
            });
            let moved: String = lines.collect();
            read_bytes(moved.as_bytes(), &native(), with_blocks_of(1000)).unwrap().time
        };
        // Doubles near 1.7e9 lie 2.4e-7 apart.
        let clock = moved(1.7e9);
        assert_eq!(clock[0], 0.0);
        assert!(clock.iter().zip(&samples.time).all(|(a, b)| (a - b).abs() < 5e-7));
        assert_eq!(moved(3600.0)[0], 3600.0);
    }

    #[test]
    fn a_file_that_ends_inside_a_number_is_noticed_at_any_block_size() {
        let text = std::fs::read_to_string(fixture("no_final_newline_after_torque.csv")).unwrap();
        for block_bytes in 1..text.len() + 2 {
            let path = Path::new("a.csv");
            let options = with_blocks_of(block_bytes);
            let mut reader = ExportReader::new(text.as_bytes(), path, &native(), &er3a(), options).unwrap();
            assert_eq!(reader.by_ref().map(|chunk| chunk.unwrap().samples.rows()).sum::<usize>(), 4);
            assert_eq!(reader.left_out_line(), Some(6));
        }
    }

    #[test]
    fn wherever_a_file_is_cut_no_wrong_row_comes_out() {
        let text = std::fs::read_to_string(fixture("native.csv")).unwrap();
        let whole = read_bytes(text.as_bytes(), &native(), ReadOptions::default()).unwrap();
        for keep in 0..text.len() {
            if let Ok(read) = read_bytes(&text.as_bytes()[..keep], &native(), ReadOptions::default()) {
                assert_eq!(read, whole.clone().take_front(read.rows()), "cut to {keep} bytes");
            }
        }
    }

    /// A number of any magnitude that a channel may have; larger ones come as their reciprocals.
    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![
            -1e4..1e4,
            any::<f64>().prop_map(|x| if x.abs() <= channels::MAX_POSITION { x } else { x.recip() })
        ]
    }

    /// What a cell of a damaged file may hold.
    fn cell() -> impl Strategy<Value = String> {
        let odd = [
            "",
            " ",
            "nan",
            "-inf",
            "1e999",
            "0x1",
            "1_0",
            "1.",
            ".5",
            "+1",
            "--1",
            "1 2",
            "1e",
            "\"1\"",
            "\"",
            "1\r",
            "\u{feff}1",
            "\u{a0}1",
            "1,2",
            "\n",
            "\0",
            "é",
            "infinity",
            "1e-400",
            "-0",
            "1d5",
            "1f",
        ];
        prop_oneof![
            3 => proptest::sample::select(odd.to_vec()).prop_map(str::to_owned),
            1 => "[-+0-9.eE ]{0,6}",
            1 => any::<f64>().prop_map(|x| x.to_string()),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn any_block_size_reads_the_same(block_bytes in 1_usize..9000) {
            let (samples, text) = made_recording(60);
            let read = read_bytes(text.as_bytes(), &native(), with_blocks_of(block_bytes));
            prop_assert_eq!(read, Ok(samples));
        }

        #[test]
        fn numbers_come_back_bit_by_bit(numbers in proptest::collection::vec(number(), 18..200)) {
            let mut cycle = numbers.iter().cycle();
            let (samples, text) = recording(numbers.len() / 18, || *cycle.next().expect("endless"));
            let read = read_bytes(text.as_bytes(), &native(), ReadOptions::default());
            prop_assert_eq!(read, Ok(samples));
        }

        /// The two readers are each other's second road: what polars takes, the cell-by-cell reader
        /// takes with the same numbers.
        #[test]
        fn polars_takes_nothing_that_the_exact_reader_refuses(row in 0_usize..9, column in 0_usize..23, cell in cell()) {
            let (_, text) = made_recording(9);
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            let mut cells: Vec<&str> = lines[row + 1].split(',').collect();
            cells[column] = &cell;
            lines[row + 1] = cells.join(",");
            let parser = parser(&lines[0]);
            let block = Block { bytes: (lines[1..].join("\n") + "\n").into_bytes(), first_line: 2, unterminated: false };
            let fast = parser.columns(&block.bytes).and_then(|c| channels::samples(c, &parser.map, None));
            let exact = exact::read(&block, &parser.map, None, Path::new("a.csv"));
            if let Some(samples) = fast {
                prop_assert_eq!(Ok(samples), exact);
            } else if let Err(rejection) = exact {
                prop_assert_ne!(rejection.reason, "numbers that cannot be read reliably");
            }
        }
    }
}
