//! Reading blocks: plain ones with `plain_reader.rs`, others with polars, and with [`super::cell_reader`] whatever
//! polars would guess at.
//!
//! polars takes a line that is too short, ignores the header once it has a schema and reads a
//! number cut in half; so the schema here comes from the file's own header, and a block counts as
//! read only if its lines, its delimiters and its numbers are as many as they must be. Any other
//! block is read again cell by cell, which either understands it or names the first bad cell.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use polars_core::prelude::{Column, DataFrame, DataType, Field, Schema, SchemaRef};
use polars_io::SerReader;
use polars_io::csv::read::{CsvParseOptions, CsvReadOptions};

use super::cell_reader::{PassedOver, ReadRows};
use super::channels::RawColumns;
use super::clock::{ClockOrigin, PreviousTime, TimeColumn};
use super::column_map::{ColumnMap, Role};
use super::fields::{fields, single, with_tabs};
use super::mended::{Mend, Mended};
use super::plain_reader::PlainReader;
use super::{cell, cell_reader, channels};
use crate::bytes::blocks::{Block, count, line_count};
use crate::bytes::encoding::without_bom;
use crate::rejection::Rejection;
use armwatch_config::{BLANKS, DecimalMark};
use armwatch_model::run::RawSamples;

/// Reads blocks of one export; several threads may share it.
#[derive(Debug, Clone)]
pub struct Parser {
    map: ColumnMap,
    schema: SchemaRef,
    plain: Option<PlainReader>,
    threads: usize,
}

impl Parser {
    /// A parser for exports with these columns.
    #[must_use]
    pub fn new(map: ColumnMap, threads: usize) -> Self {
        let schema = schema(&map, map.names.len());
        let plain = PlainReader::new(&map);
        Self { map, schema, plain, threads }
    }

    /// Lets times count from the first of them that is understood in this block, which the export begins with.
    /// Whether there is one; others are left to reading.
    pub(crate) fn count_from(&mut self, block: &Block) -> bool {
        let Some(column) = self.map.time.column() else { return true };
        let (delimiter, decimal, to_s) = (self.map.delimiter, self.map.decimal, self.map.to_si.time);
        let mut cells = cell_reader::lines(&block.bytes)
            .filter_map(|line| fields(std::str::from_utf8(line).ok()?, delimiter).nth(column));
        match &mut self.map.time {
            TimeColumn::Stamped { origin, .. } => {
                let found = cells.find_map(|cell| cell::clock_origin(cell, &self.map.text_time));
                *origin = found.unwrap_or(*origin);
                found.is_some()
            }
            TimeColumn::Recorded(_) | TimeColumn::Wrapping { .. } => {
                let clocks = |number: &cell::Decimal| (number.to_f64() * to_s).abs() <= channels::MAX_TIME;
                let found = cells.find_map(|cell| cell::Decimal::read(cell, decimal)).filter(clocks);
                self.count_from_number(found);
                found.is_some()
            }
            TimeColumn::Counted(_) => true,
        }
    }

    /// Lets times count from this number in the column of time, where there is one.
    pub(crate) fn count_from_number(&mut self, number: Option<cell::Decimal>) {
        self.map.time_origin = number;
        self.schema = schema(&self.map, self.map.names.len());
        self.plain = PlainReader::new(&self.map);
    }

    /// What dates and times count from, where they do.
    pub(crate) fn counted_from(&self) -> Option<ClockOrigin> {
        match self.map.time {
            TimeColumn::Stamped { origin, .. } => Some(origin),
            _ => None,
        }
    }

    /// Lets dates and times count from this origin.
    pub(crate) fn count_from_moment(&mut self, moment: ClockOrigin) {
        if let TimeColumn::Stamped { origin, .. } = &mut self.map.time {
            *origin = moment;
        }
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
    ) -> Result<RawSamples, Rejection> {
        self.read_passing_over(block, previous, path, 0).map(|read| read.samples)
    }

    /// As [`Parser::read`], passing over `most` bad rows at most, see [`cell_reader::read_passing_over`].
    ///
    /// # Errors
    /// As [`Parser::read`], of the first bad row beyond `most`.
    pub fn read_passing_over(
        &self,
        block: &Block,
        previous: Option<PreviousTime>,
        path: &Path,
        most: u64,
    ) -> Result<ReadRows, Rejection> {
        let fast = self
            .columns(&block.bytes)
            .and_then(|columns| channels::samples_and_clock(columns, &self.map, previous));
        match fast {
            Some((samples, clock)) => {
                let mut mended = Mended::default();
                for (row, turn) in clock.turns {
                    mended.note(Mend::Clock(turn), 1, block.first_line + row as u64);
                }
                let row = cell_reader::lines(&block.bytes).next_back().map(cell_reader::row_hash);
                Ok(ReadRows { samples, passed_over: PassedOver::default(), mended, clock: clock.last, row })
            }
            None => cell_reader::read_passing_over(block, &self.map, previous, path, most),
        }
    }

    /// Where each channel stands.
    #[must_use]
    pub fn map(&self) -> &ColumnMap {
        &self.map
    }

    /// The needed columns, or `None` if anything is out of the ordinary.
    fn columns(&self, bytes: &[u8]) -> Option<RawColumns> {
        let bytes = match self.map.delimiter {
            BLANKS => with_tabs(bytes)?,
            _ => Cow::Borrowed(bytes),
        };
        let bytes = &*bytes;
        let plain = self.plain.as_ref().and_then(|plain| plain.columns(bytes));
        plain.or_else(|| {
            let rows = usize::try_from(line_count(bytes)).ok().filter(|rows| *rows > 0)?;
            self.columns_by_polars(bytes, rows)
        })
    }

    /// The needed columns of a block of `rows` lines as polars reads them.
    fn columns_by_polars(&self, bytes: &[u8], rows: usize) -> Option<RawColumns> {
        let map = &self.map;
        // Without quotes a delimiter is a delimiter: with as many as there must be, and polars
        // refusing lines with more, no line has fewer.
        let delimiters = usize::try_from(count(bytes, single(map.delimiter))).ok()?;
        let fields = delimiters / rows + 1;
        let regular = delimiters % rows == 0
            && (map.least_fields..=map.names.len() + 1).contains(&fields)
            && !bytes.contains(&b'"')
            && !bytes.contains(&0)
            // polars would take a byte order mark away at the start of every block
            && without_bom(bytes).len() == bytes.len()
            && std::str::from_utf8(bytes).is_ok();
        if !regular {
            return None;
        }
        let frame = self.parsed(&self.with_points(bytes)?, fields).filter(|frame| frame.height() == rows)?;
        let mut columns = Vec::with_capacity(map.names.len());
        for (column, role) in frame.columns().iter().zip(&map.roles) {
            columns.push(match (role, map.time) {
                (Role::Ignored, _) => Vec::new(),
                (Role::Time, TimeColumn::Stamped { origin, .. }) => self.moments(column, origin)?,
                (Role::Time, TimeColumn::Recorded(_)) => match clock_origin(map) {
                    Some(origin) => times_since(column, origin)?,
                    None => numbers(column, rows)?,
                },
                (role, _) if channels::is_text(*role, map) => word_numbers(column, map)?,
                (role, _) if role.temperature_unit().is_some() => temperatures(column)?,
                _ => numbers(column, rows)?,
            });
        }
        columns.resize(map.names.len(), Vec::new());
        let beyond = frame.columns().get(map.names.len());
        beyond.is_none_or(is_blank).then_some(columns)
    }

    /// The text with decimal points. Where it has commas, points become commas at the same time, so that a
    /// number with a point does not become another number but none.
    fn with_points<'b>(&self, bytes: &'b [u8]) -> Option<Cow<'b, [u8]>> {
        match self.map.decimal {
            DecimalMark::Point => Some(Cow::Borrowed(bytes)),
            DecimalMark::Comma if self.map.delimiter == b',' => None,
            DecimalMark::Comma => Some(bytes.iter().copied().map(swapped).collect()),
        }
    }

    /// Seconds from `origin` to the dates and times of a column without a gap.
    fn moments(&self, column: &Column, origin: ClockOrigin) -> Option<Vec<f64>> {
        let blank = |c: char| matches!(c, ' ' | '\t' | '\r');
        let comma = self.map.decimal == DecimalMark::Comma;
        let moment = |cell: Option<&str>| {
            let cell = cell?.trim_matches(blank);
            match comma {
                true => {
                    cell_reader::stamped(&cell.chars().map(as_written).collect::<String>(), &self.map, origin)
                }
                false => cell_reader::stamped(cell, &self.map, origin),
            }
        };
        column.str().ok()?.iter().map(moment).collect()
    }

    fn parsed(&self, bytes: &[u8], fields: usize) -> Option<DataFrame> {
        let format =
            CsvParseOptions::default().with_separator(single(self.map.delimiter)).with_quote_char(None);
        // polars cuts a block into sixteen parts for each of its threads, whatever pool they run
        // on; only 0 keeps a block whole, and one part is parsed by one thread.
        let threads = if self.threads <= 1 { 0 } else { self.threads };
        let schema = match fields == self.map.names.len() {
            true => Arc::clone(&self.schema),
            false => schema(&self.map, fields),
        };
        CsvReadOptions::default()
            .with_has_header(false)
            .with_schema(Some(schema))
            .with_n_threads(Some(threads))
            .with_parse_options(format)
            .into_reader_with_file_handle(Cursor::new(bytes))
            .finish()
            .ok()
    }
}

/// What polars is to take from lines of so many fields. Columns go by number, since names may be empty or come
/// twice.
fn schema(map: &ColumnMap, fields: usize) -> SchemaRef {
    let field = |column: usize| {
        let kind = match (map.roles.get(column), map.time) {
            (None | Some(Role::Ignored), _) | (Some(Role::Time), TimeColumn::Stamped { .. }) => {
                DataType::String
            }
            // doubles would lose the last digits of a clock
            (Some(Role::Time), _) if clock_origin(map).is_some() => DataType::String,
            (Some(role), _) if channels::is_text(*role, map) || role.temperature_unit().is_some() => {
                DataType::String
            }
            _ => DataType::Float64,
        };
        Field::new(column.to_string().into(), kind)
    };
    Arc::new((0..fields).map(field).collect::<Schema>())
}

/// What times of a clock are counted from that does not begin at zero.
fn clock_origin(map: &ColumnMap) -> Option<cell::Decimal> {
    map.time_origin.filter(|origin| matches!(map.time, TimeColumn::Recorded(_)) && origin.digits != 0)
}

fn swapped(byte: u8) -> u8 {
    match byte {
        b',' => b'.',
        b'.' => b',',
        other => other,
    }
}

/// A character before its commas and points were swapped.
fn as_written(swapped: char) -> char {
    match swapped {
        ',' => '.',
        '.' => ',',
        other => other,
    }
}

/// Whether a column of text holds nothing, as behind a delimiter at the end of each line.
fn is_blank(column: &Column) -> bool {
    let blank = |cell: Option<&str>| cell.is_none_or(|cell| cell.trim().is_empty());
    column.str().is_ok_and(|cells| cells.iter().all(blank))
}

/// The numbers that the words of a column stand for, or `None` if one of them stands for none.
fn word_numbers(column: &Column, map: &ColumnMap) -> Option<Vec<f64>> {
    // a stage lasts for thousands of rows: the word of the row before is nearly always this one
    let mut last: Option<(&str, f64)> = None;
    let words = column.str().ok()?.iter().map(|word| word.unwrap_or_default());
    words
        .map(|word| match last {
            Some((known, number)) if known == word => Some(number),
            _ => {
                let found = channels::word_number(word, map)?;
                last = Some((word, found));
                Some(found)
            }
        })
        .collect()
}

/// The numbers of a column of temperatures, whose cells may hold none. Decimal commas are points already.
fn temperatures(column: &Column) -> Option<Vec<f64>> {
    // a drive gives a new value once in hundreds of rows
    let mut last = ("", f64::NAN);
    let cells = column.str().ok()?.iter().map(|cell| cell.unwrap_or_default());
    let number = |cell| {
        if last.0 != cell {
            let blank = |c: char| matches!(c, ' ' | '\t' | '\r');
            last = (cell, channels::temperature(cell.trim_matches(blank), DecimalMark::Point));
        }
        last.1
    };
    Some(cells.map(number).collect())
}

/// How much larger than `origin` the numbers of a column of text are, without a gap. Decimal commas are points
/// already.
fn times_since(column: &Column, origin: cell::Decimal) -> Option<Vec<f64>> {
    let blank = |c: char| matches!(c, ' ' | '\t' | '\r');
    let since = |cell: Option<&str>| {
        cell::Decimal::read(cell?.trim_matches(blank), DecimalMark::Point)?.minus(origin)
    };
    column.str().ok()?.iter().map(since).collect()
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

    use super::*;
    use crate::bytes::blocks::{Blocks, Next};
    use crate::bytes::encoding::Found;
    use crate::fixture::{fixture, made_recording, native};
    use crate::table::column_map::map_columns;
    use armwatch_config::{Column as ConfigColumn, Layout, TextEncoding, TextTime, TimeSource};
    use armwatch_testing::er3a;

    fn parser(header: &str) -> Parser {
        parser_of(header, &native())
    }

    fn parser_of(header: &str, layout: &Layout) -> Parser {
        Parser::new(map_columns(header, layout, &er3a(), Path::new("a.csv")).unwrap(), 1)
    }

    fn body(text: &str) -> Block {
        let mut blocks = Blocks::new(text.as_bytes(), 1 << 20, TextEncoding::Auto);
        blocks.next_line(Path::new("a.csv")).unwrap();
        match blocks.next_block(Path::new("a.csv")).unwrap() {
            Next::Block(block) => block,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn polars_itself_reads_the_ordinary_export() {
        let (samples, text) = made_recording(500);
        let parser = parser(text.lines().next().unwrap());
        let columns = parser.columns_by_polars(&body(&text).bytes, 500).expect("nothing is odd");
        let plain = parser.plain.as_ref().and_then(|plain| plain.columns(&body(&text).bytes));
        assert_eq!(plain.as_ref(), Some(&columns), "nor for the plain reader");
        assert_eq!(channels::samples(columns, &parser.map, None), Some(samples));
    }

    /// Slow reading gives the same rows, so only this notices if common files take the slow road.
    #[test]
    fn common_variants_do_not_need_the_exact_reader() {
        for name in [
            "crlf.csv",
            "reordered.csv",
            "extra_columns.csv",
            "trailing_delimiters.csv",
            "crlf_in_the_middle.csv",
            "trailing_delimiters_in_rows.csv",
            "trailing_delimiter_in_header.csv",
        ] {
            let text = std::fs::read_to_string(fixture(name)).unwrap();
            let parser = parser(text.lines().next().unwrap());
            assert!(parser.columns(&body(&text).bytes).is_some(), "{name}");
        }
    }

    /// Decimal commas, counts and timestamps go the fast way too.
    #[test]
    fn other_numbers_and_times_do_not_need_the_exact_reader() {
        let mut comma = native();
        comma.delimiter = b';';
        comma.text.decimal = DecimalMark::Comma;
        let stamped = Layout {
            time: TimeSource::Text { column: ConfigColumn::Name("time".into()), form: TextTime::Timestamp },
            ..native()
        };
        for (name, layout) in [("decimal_commas.csv", comma), ("timestamps.csv", stamped)] {
            let text = std::fs::read_to_string(fixture(name)).unwrap();
            let mut parser = parser_of(text.lines().next().unwrap(), &layout);
            let block = body(&text);
            parser.count_from(&block);
            let columns = parser.columns(&block.bytes).expect(name);
            let fast = channels::samples(columns, &parser.map, None);
            assert_eq!(fast.as_ref().map(|samples| &samples.time[..2]), Some(&[0.0, 0.002][..]), "{name}");
            assert_eq!(fast, cell_reader::read(&block, &parser.map, None, Path::new("a.csv")).ok(), "{name}");
        }
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

    /// polars takes a byte order mark away wherever a block begins, and the reader of cells nowhere.
    #[test]
    fn a_byte_order_mark_where_a_block_begins_is_no_number() {
        let (_, text) = made_recording(9);
        let (header, rows) = text.split_once('\n').unwrap();
        let read =
            |rows: &str| parser(header).read(&body(&format!("{header}\n{rows}")), None, Path::new("a.csv"));
        assert!(read(rows).is_ok());
        let rejection = read(&format!("\u{feff}{rows}")).unwrap_err();
        assert_eq!(rejection.column.as_deref(), Some("time"));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(128))]

        /// The two readers are each other's second road: what polars takes, the cell-by-cell reader
        /// takes with the same numbers.
        #[test]
        fn polars_takes_nothing_that_the_exact_reader_refuses(
            row in 0_usize..9,
            column in 0_usize..23,
            cell in cell(),
            comma: bool,
        ) {
            let (_, text) = made_recording(9);
            let mut layout = native();
            let text = if comma {
                layout.delimiter = b';';
                layout.text.decimal = DecimalMark::Comma;
                text.replace(',', ";").replace('.', ",")
            } else {
                text
            };
            let delimiter = char::from(layout.delimiter).to_string();
            let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
            let mut cells: Vec<&str> = lines[row + 1].split(&delimiter).collect();
            cells[column] = &cell;
            lines[row + 1] = cells.join(&delimiter);
            let parser = parser_of(&lines[0], &layout);
            let block = Block {
                bytes: (lines[1..].join("\n") + "\n").into_bytes(),
                first_line: 2,
                first_byte: 0,
                encoding: Found::Utf8,
                unterminated: false,
            };
            let fast = parser.columns(&block.bytes).and_then(|c| channels::samples(c, &parser.map, None));
            let exact = cell_reader::read(&block, &parser.map, None, Path::new("a.csv"));
            if let Some(samples) = fast {
                prop_assert_eq!(Ok(samples), exact);
            } else if let Err(rejection) = exact {
                prop_assert_ne!(&*rejection.reason, "numbers that cannot be read reliably");
            }
        }
    }
}
