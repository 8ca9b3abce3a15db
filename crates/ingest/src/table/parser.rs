//! Converts blocks to rows: valid ones in one pass with `block_reader.rs`, others with [`super::cell_reader`], which
//! either understands them or names the first bad cell.

use std::path::Path;

use super::block_reader::BlockReader;
use super::cell_reader::{PassedOver, ReadRows};
use super::channels::RawColumns;
use super::clock::{ClockOrigin, PreviousTime, TimeColumn};
use super::column_map::ColumnMap;
use super::fields::fields;
use super::mended::{Mend, MendedRow};
use super::{cell, cell_reader, channels};
use crate::bytes::blocks::Block;
use crate::rejection::Rejection;
use armwatch_model::run::RawSamples;

/// Reads blocks of one export; several threads may share it.
#[derive(Debug, Clone)]
pub struct Parser {
    map: ColumnMap,
    reader: BlockReader,
}

impl Parser {
    /// A parser for exports with these columns.
    pub fn new(map: ColumnMap) -> Self {
        let reader = BlockReader::new(&map);
        Self { map, reader }
    }

    /// Makes times relative to the first one that is understood in this block, with which the export begins. Returns
    /// true if there is one; otherwise reading reports the fault.
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
            TimeColumn::Recorded(_) | TimeColumn::Restarting(_) | TimeColumn::Wrapping { .. } => {
                let clocks = |number: &cell::Decimal| (number.to_f64() * to_s).abs() <= channels::MAX_TIME;
                let found = cells.find_map(|cell| cell::Decimal::read(cell, decimal)).filter(clocks);
                self.count_from_number(found);
                found.is_some()
            }
            TimeColumn::Counted(_) => true,
        }
    }

    /// Makes times relative to this number in the time column, if there is one.
    pub(crate) fn count_from_number(&mut self, number: Option<cell::Decimal>) {
        self.map.time_origin = number;
        self.reader = BlockReader::new(&self.map);
    }

    /// Origin of dates and times, if there is one.
    pub(crate) fn counted_from(&self) -> Option<ClockOrigin> {
        match self.map.time {
            TimeColumn::Stamped { origin, .. } => Some(origin),
            _ => None,
        }
    }

    /// Makes dates and times relative to this origin.
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

    /// Like [`Parser::read`], but skips at most `most` bad rows, see [`cell_reader::read_passing_over`].
    ///
    /// # Errors
    /// Those of [`Parser::read`], for the first bad row beyond `most`.
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
                let at = |(row, turn): (usize, _)| MendedRow {
                    mend: Mend::Clock(turn),
                    line: block.first_line + row as u64,
                    count: 1,
                    time: samples.time.get(row).copied().unwrap_or_default(),
                };
                let mended = clock.turns.into_iter().map(at).collect();
                let row = cell_reader::lines(&block.bytes).next_back().map(cell_reader::row_hash);
                Ok(ReadRows { samples, passed_over: PassedOver::default(), mended, clock: clock.last, row })
            }
            None => cell_reader::read_passing_over(block, &self.map, previous, path, most),
        }
    }

    /// Column of each channel.
    pub fn map(&self) -> &ColumnMap {
        &self.map
    }

    /// The needed columns, or `None` if anything is invalid.
    fn columns(&self, bytes: &[u8]) -> Option<RawColumns> {
        self.reader.columns(bytes, &self.map)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;
    use std::sync::Arc;

    use polars_core::prelude::{Column, DataType, Field, Schema};
    use polars_io::SerReader;
    use polars_io::csv::read::{CsvParseOptions, CsvReadOptions};
    use proptest::prelude::*;

    use super::*;
    use crate::bytes::blocks::{Blocks, Next};
    use crate::bytes::encoding::Found;
    use crate::fixture::{fixture, made_recording, native};
    use crate::table::column_map::map_columns;
    use armwatch_config::{Column as ConfigColumn, DecimalMark, Layout, TextEncoding, TextTime, TimeSource};
    use armwatch_testing::er3a;

    fn parser(header: &str) -> Parser {
        parser_of(header, &native())
    }

    fn parser_of(header: &str, layout: &Layout) -> Parser {
        Parser::new(map_columns(header, layout, &er3a(), Path::new("a.csv")).unwrap())
    }

    fn body(text: &str) -> Block {
        let mut blocks = Blocks::new(text.as_bytes(), 1 << 20, TextEncoding::Auto);
        blocks.next_line(Path::new("a.csv")).unwrap();
        match blocks.next_block(Path::new("a.csv")).unwrap() {
            Next::Block(block) => block,
            other => panic!("{other:?}"),
        }
    }

    /// The same lines by another method: polars, which reads all columns as numbers.
    fn by_polars(bytes: &[u8], columns: usize, delimiter: u8) -> RawColumns {
        let field = |column: usize| Field::new(column.to_string().into(), DataType::Float64);
        let format = CsvParseOptions::default().with_separator(delimiter);
        let frame = CsvReadOptions::default()
            .with_has_header(false)
            .with_schema(Some(Arc::new((0..columns).map(field).collect::<Schema>())))
            .with_n_threads(Some(0))
            .with_parse_options(format)
            .into_reader_with_file_handle(Cursor::new(bytes))
            .finish()
            .expect("polars reads its own");
        let numbers = |column: &Column| column.f64().expect("numbers").into_no_null_iter().collect();
        frame.columns().iter().map(numbers).collect()
    }

    fn bits(columns: &RawColumns) -> Vec<Vec<u64>> {
        columns.iter().map(|column| column.iter().map(|number| number.to_bits()).collect()).collect()
    }

    /// The lines with each cell of a row written differently.
    fn rewritten(text: &str, delimiter: char, write: impl Fn(usize, &str) -> String) -> String {
        let line = |line: &str| {
            let cells: Vec<String> = line.split(',').enumerate().map(|(at, cell)| write(at, cell)).collect();
            cells.join(&delimiter.to_string()) + "\n"
        };
        let (header, rows) = text.split_once('\n').unwrap();
        format!(
            "{}\n{}",
            header.replace(',', &delimiter.to_string()),
            rows.lines().map(line).collect::<String>()
        )
    }

    #[test]
    fn polars_reads_the_ordinary_export_with_the_same_bits() {
        let (samples, text) = made_recording(500);
        let parser = parser(text.lines().next().unwrap());
        let columns = parser.columns(&body(&text).bytes).expect("nothing is odd");
        assert_eq!(bits(&by_polars(&body(&text).bytes, 23, b',')), bits(&columns));
        assert_eq!(channels::samples(columns, &parser.map, None), Some(samples));
    }

    /// How the cell in a column is written.
    type Write<'a> = &'a dyn Fn(usize, &str) -> String;

    #[test]
    fn exponents_quotes_and_blanks_need_no_other_reader() {
        let (samples, text) = made_recording(200);
        let as_exponent = |cell: &str| format!("{:e}", cell.parse::<f64>().unwrap());
        let ways: [(&str, Write<'_>); 7] = [
            ("exponents", &|_, cell| as_exponent(cell)),
            ("Fortran", &|_, cell| as_exponent(cell).replace('e', "D")),
            ("C", &|_, cell| format!("{:.16e}", cell.parse::<f64>().unwrap())),
            ("quotes", &|_, cell| format!("\"{cell}\"")),
            ("exponents in quotes", &|_, cell| format!("\"{}\"", as_exponent(cell).to_uppercase())),
            ("blanks", &|_, cell| format!("  {cell} ")),
            ("one of each", &|at, cell| match at % 4 {
                0 => format!(" \" {cell} \" "),
                1 => as_exponent(cell),
                2 => format!("\t{cell}"),
                _ => cell.to_owned(),
            }),
        ];
        for (what, write) in ways {
            for return_too in ["", "\r"] {
                let text = rewritten(&text, ',', write).replace('\n', &format!("{return_too}\n"));
                let parser = parser(text.lines().next().unwrap());
                let columns = parser.columns(&body(&text).bytes).expect(what);
                assert_eq!(channels::samples(columns, &parser.map, None).as_ref(), Some(&samples), "{what}");
            }
        }
    }

    #[test]
    fn lines_in_blanks_are_read_as_numpy_matlab_and_c_write_them() {
        let (samples, text) = made_recording(200);
        let layout = Layout { delimiter: armwatch_config::BLANKS, ..native() };
        let ways: [(&str, Write<'_>); 4] = [
            ("one blank", &|_, cell| cell.to_owned()),
            ("columns of one width", &|_, cell| format!("{cell:>24}")),
            ("numpy", &|_, cell| format!("{:.18e}", cell.parse::<f64>().unwrap())),
            ("tabs and blanks at the end", &|at, cell| {
                if at == 22 { format!("{cell} \t") } else { format!("{cell}\t") }
            }),
        ];
        for (what, write) in ways {
            let text = rewritten(&text, ' ', write);
            let parser = parser_of(text.lines().next().unwrap(), &layout);
            let columns = parser.columns(&body(&text).bytes).expect(what);
            assert_eq!(channels::samples(columns, &parser.map, None).as_ref(), Some(&samples), "{what}");
        }
    }

    /// Slow reading gives the same rows, so only this test detects that common files are read slowly.
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

    /// Decimal commas, counts and timestamps are read fast too.
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

    /// Possible contents of a cell in a damaged file.
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

    /// polars removes a byte order mark at the start of any block, and the reader of cells never does.
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

        #[test]
        fn polars_reads_numbers_with_the_same_bits(
            numbers in proptest::collection::vec(any::<f64>().prop_filter("finite", |x| x.is_finite()), 23 * 4),
            decimals in 0..18_usize,
            exponents: bool,
            quotes: bool,
        ) {
            let (_, text) = made_recording(1);
            let cell = |number: &f64| {
                let cell = match exponents {
                    true => format!("{number:.decimals$e}"),
                    false => format!("{:.decimals$}", number % 1e9),
                };
                if quotes { format!("\"{cell}\"") } else { cell }
            };
            let lines: Vec<String> =
                numbers.chunks(23).map(|row| row.iter().map(cell).collect::<Vec<_>>().join(",") + "\n").collect();
            let bytes = lines.concat().into_bytes();
            let columns = parser(text.lines().next().unwrap()).columns(&bytes);
            prop_assert_eq!(columns.as_ref().map(bits), Some(bits(&by_polars(&bytes, 23, b','))));
        }

        /// The cell-by-cell reader gives the same numbers for each block that one pass reads.
        #[test]
        fn one_pass_takes_nothing_that_the_exact_reader_refuses(
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
