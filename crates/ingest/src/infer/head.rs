//! The first rows of an export whose layout is not known: encoding, delimiter, decimal mark, header.

use std::io::Read;
use std::path::Path;

use super::super::rejection::Rejection;
use super::time_form::{self, TimeForms};
use crate::bytes::encoding::{Found, TextReader};
use crate::table::cell;
use crate::table::fields::fields;
use armwatch_config::{DecimalMark, TextEncoding};

/// Bytes of text that are looked at: a cycle of the full test of a six-axis arm and more.
const HEAD_BYTES: u64 = 24 << 20;

/// Lines from which delimiter and decimal mark are told.
const FORMAT_LINES: usize = 400;

/// Fewest columns of a table: time, a position and a torque.
const LEAST_COLUMNS: usize = 3;

/// Share of the cells of a row that are numbers, in a row of numbers: a note and a name may stand beside them.
const NUMERIC_SHARE: f64 = 0.5;

/// Cells of rows that are looked at, which bounds the memory of their numbers: a table with as many bytes of text as
/// [`HEAD_BYTES`] has more only where its cells are shorter than numbers of a recording are.
const MOST_CELLS: usize = 4 << 20;

/// Numbers that are kept of a column in which not every cell is one: enough for their range.
const KEPT_NUMBERS: usize = 4096;

/// The first rows, and how they are written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    pub(super) encoding: Found,
    pub(super) delimiter: u8,
    pub(super) decimal: DecimalMark,
    /// Whether there is a line of names.
    pub(super) header: bool,
    /// Whether that line stands behind the sign of a comment.
    pub(super) commented_header: bool,
    /// Lines before the header that are neither blank nor comments.
    pub(super) skip_lines: usize,
    /// Lines between header and rows.
    pub(super) skip_after_header: usize,
    /// The columns in their order.
    pub(super) columns: Vec<HeadColumn>,
    pub(super) rows: usize,
}

/// A column.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct HeadColumn {
    /// Name in the header; its number where there is none.
    pub(super) name: String,
    /// What a line under the header says of it.
    pub(super) under: String,
    /// Its numbers, where all cells are numbers; of dates and times, s from the first.
    pub(super) values: Option<Vec<f64>>,
    /// The first of its numbers, whatever else stands in it.
    pub(super) numbers: Vec<f64>,
    /// The forms in which all cells are times, of a column of text.
    pub(super) time_forms: TimeForms,
    /// The first of its cells.
    pub(super) cells: Vec<String>,
}

/// Reads the head of an export.
///
/// # Errors
/// A rejection of a file that cannot be read or holds no table of numbers.
pub(super) fn read(reader: impl Read, path: &Path) -> Result<Head, Rejection> {
    let mut text_reader = TextReader::new(reader, TextEncoding::Auto);
    let mut bytes = Vec::new();
    let read = (&mut text_reader).take(HEAD_BYTES).read_to_end(&mut bytes);
    let is_cut = bytes.len() as u64 == HEAD_BYTES;
    if let Err(error) = read
        && bytes.is_empty()
    {
        return Err(Rejection::from_io(path, &error));
    }
    let text = String::from_utf8_lossy(&bytes);
    // The last line may be cut, by the limit or by a writer.
    let whole = match text.rfind('\n') {
        Some(end) if is_cut || !text.ends_with('\n') => &text[..=end],
        _ => &text,
    };
    // never together: of text that is nothing but line ends, they would take 16 times its bytes
    let lines = || whole.lines().map(|line| line.trim_end_matches('\r'));
    let no_table = || {
        Rejection::of_file(
            path,
            "no table of numbers with three columns or more",
            "check that this is a CSV export; delimiters may be , ; tab and |",
        )
    };
    let sample: Vec<&str> = lines().take(FORMAT_LINES).collect();
    let format = format(&sample).ok_or_else(no_table)?;
    assembled(lines(), format, text_reader.found()).ok_or_else(no_table)
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Format {
    delimiter: u8,
    decimal: DecimalMark,
    fields: usize,
}

impl Format {
    /// Whether a line is a row: as many fields, half of them numbers.
    fn is_row(self, line: &str) -> bool {
        let count = fields(line, self.delimiter).count();
        count == self.fields && self.numbers(line) as f64 >= NUMERIC_SHARE * count as f64
    }

    fn numbers(self, line: &str) -> usize {
        fields(line, self.delimiter).filter(|cell| cell::number(cell, self.decimal).is_ok()).count()
    }
}

/// The delimiter and decimal mark that make most numbers of the first lines, in rows of equally many fields.
fn format(sample: &[&str]) -> Option<Format> {
    // From the end of the sample, where no header stands.
    let sample = &sample[sample.len() / 2..];
    let candidates = [b';', b'\t', b'|', b',']
        .into_iter()
        .flat_map(|delimiter| [DecimalMark::Point, DecimalMark::Comma].map(|decimal| (delimiter, decimal)));
    let judged = candidates.filter_map(|(delimiter, decimal)| {
        let mut counts: Vec<usize> = sample.iter().map(|line| fields(line, delimiter).count()).collect();
        counts.sort_unstable();
        let usual = *counts.get(counts.len() / 2)?;
        let format = Format { delimiter, decimal, fields: usual };
        let rows = sample.iter().filter(|line| format.is_row(line));
        let numbers: usize = rows.map(|line| format.numbers(line)).sum();
        (usual >= LEAST_COLUMNS && numbers > 0).then_some((numbers, format))
    });
    // Of equals the first: points before commas, where all numbers are whole.
    let best = judged.reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map(|(_, format)| format)
}

/// What stands above the rows.
#[derive(Debug, Default)]
struct Above<'t> {
    /// Lines before those of as many fields.
    start: usize,
    /// How many of them are neither blank nor comments.
    skipped: usize,
    /// Lines of as many fields right above the rows: names, then perhaps units.
    count: usize,
    /// How many of these are neither blank nor comments.
    said: usize,
    names: Option<&'t str>,
    under: Option<&'t str>,
}

fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with('#')
}

impl<'t> Above<'t> {
    fn note(&mut self, line: &'t str, format: Format) {
        let count = fields(line.trim_start().trim_start_matches('#'), format.delimiter).count();
        let has_fields = count.abs_diff(format.fields) <= 1 && count > 1;
        let said = usize::from(!line.trim().is_empty() && !is_comment(line));
        if !has_fields {
            let (start, skipped) = (self.start + self.count + 1, self.skipped + self.said + said);
            *self = Self { start, skipped, ..Self::default() };
            return;
        }
        match self.count {
            0 => self.names = Some(line),
            1 => self.under = Some(line),
            _ => {}
        }
        (self.count, self.said) = (self.count + 1, self.said + said);
    }
}

fn assembled<'t>(mut lines: impl Iterator<Item = &'t str>, format: Format, encoding: Found) -> Option<Head> {
    let mut above = Above::default();
    let first_row = loop {
        let line = lines.next()?;
        if format.is_row(line) {
            break line;
        }
        above.note(line, format);
    };
    let commented = above.names.is_some_and(is_comment);
    let cells = |line: &str| -> Vec<String> {
        fields(line.trim_start().trim_start_matches('#'), format.delimiter).map(str::to_owned).collect()
    };
    let names = above.names.map(cells);
    let under = above.under.map(cells).unwrap_or_default();
    let mut columns: Vec<HeadColumn> = (0..format.fields)
        .map(|at| HeadColumn {
            name: match &names {
                Some(names) => names.get(at).cloned().unwrap_or_default(),
                None => (at + 1).to_string(),
            },
            under: under.get(at).cloned().unwrap_or_default(),
            values: Some(Vec::new()),
            numbers: Vec::new(),
            time_forms: TimeForms::default(),
            cells: Vec::new(),
        })
        .collect();
    let mut rows = 0;
    let of_rows = std::iter::once(first_row).chain(lines.filter(|line| format.is_row(line)));
    for line in of_rows.take(MOST_CELLS.div_ceil(format.fields)) {
        rows += 1;
        let cells = fields(line, format.delimiter);
        for (column, cell) in columns.iter_mut().zip(cells) {
            if column.cells.len() < time_form::MOST_CELLS {
                column.cells.push(cell.to_owned());
            }
            let number = cell::number(cell, format.decimal);
            let finite = number.as_ref().ok().copied().filter(|number| number.is_finite());
            column.numbers.extend(finite.filter(|_| column.numbers.len() < KEPT_NUMBERS));
            match (&mut column.values, number) {
                (Some(values), Ok(value)) => values.push(value),
                (values, Err(_)) => *values = None,
                (None, Ok(_)) => {}
            }
        }
    }
    for column in columns.iter_mut().filter(|column| column.values.is_none()) {
        let (forms, times) = TimeForms::of(&column.cells);
        (column.time_forms, column.values) = (forms, times);
    }
    Some(Head {
        encoding,
        delimiter: format.delimiter,
        decimal: format.decimal,
        header: names.is_some(),
        commented_header: commented,
        // Comments are skipped by themselves; other lines are counted from the start of the file.
        skip_lines: if above.skipped > 0 { above.start } else { 0 },
        skip_after_header: above.count.saturating_sub(1),
        columns,
        rows,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(text: &str) -> Head {
        read(text.as_bytes(), Path::new("a.csv")).expect("a table")
    }

    #[test]
    fn delimiter_and_decimal_mark_are_those_that_make_numbers() {
        for (text, delimiter, decimal) in [
            ("t,a,b\n0.1,1.5,2\n0.2,1.6,3\n", b',', DecimalMark::Point),
            ("t;a;b\n0,1;1,5;2\n0,2;1,6;3\n", b';', DecimalMark::Comma),
            ("t;a;b\n0.1;1.5;2\n0.2;1.6;3\n", b';', DecimalMark::Point),
            ("t\ta\tb\n0,1\t1,5\t2\n0,2\t1,6\t3\n", b'\t', DecimalMark::Comma),
            ("t,a,b\n\"0,1\",\"1,5\",2\n\"0,2\",\"1,6\",3\n", b',', DecimalMark::Comma),
            ("t|a|b\n1|2|3\n2|3|4\n", b'|', DecimalMark::Point),
        ] {
            let head = head(text);
            assert_eq!((head.delimiter, head.decimal, head.rows), (delimiter, decimal, 2), "{text}");
            assert_eq!(head.columns[1].name, "a");
        }
    }

    #[test]
    fn lines_around_the_header_are_counted() {
        let rows = "0.1,1.5,2\n0.2,1.6,3\n";
        let at = |text: &str| {
            let head = head(text);
            (head.header, head.skip_lines, head.skip_after_header, head.commented_header)
        };
        assert_eq!(at(rows), (false, 0, 0, false));
        assert_eq!(at(&format!("t,a,b\n{rows}")), (true, 0, 0, false));
        assert_eq!(at(&format!("t,a,b\ns,rad,Nm\n{rows}")), (true, 0, 1, false));
        assert_eq!(at(&format!("# x\n\nt,a,b\n{rows}")), (true, 0, 0, false));
        assert_eq!(at(&format!("# t,a,b\n{rows}")), (true, 0, 0, true));
        assert_eq!(at(&format!("Robot: R00\n\n\nt,a,b\n{rows}")), (true, 3, 0, false));
        assert_eq!(at(&format!("a,b\nc,d\nRobot: R00\nt,a,b\ns,rad,Nm\nx,y,z\n{rows}")), (true, 3, 2, false));
    }

    #[test]
    fn a_table_of_very_short_cells_is_looked_at_in_part() {
        let rows = MOST_CELLS / 4 + 100;
        let head = head(&format!("a,b,c,d\n{}", "1,2,3,4\n".repeat(rows)));
        assert_eq!(head.rows, MOST_CELLS / 4);
        assert!(head.columns.iter().all(|column| column.values.as_ref().map(Vec::len) == Some(head.rows)));
    }

    #[test]
    fn what_is_no_table_is_refused() {
        for text in ["", "hello\nworld\n", "1\n2\n3\n", "{\"a\": [1, 2, 3]}\n"] {
            assert!(read(text.as_bytes(), Path::new("a.csv")).is_err(), "{text}");
        }
    }
}
