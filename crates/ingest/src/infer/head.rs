//! The first rows of an export whose layout is not known: encoding, delimiter, decimal mark, header.

use std::borrow::Cow;
use std::collections::{BTreeSet, VecDeque};
use std::io::Read;
use std::iter::Peekable;
use std::path::Path;

use super::names;
use super::section::quoted;
use super::time_form::{self, TimeForms};
use crate::bytes::encoding::{Found, TextReader};
use crate::rejection::Rejection;
use crate::table::cell;
use crate::table::column_map::MAX_COLUMNS;
use crate::table::fields::fields;
use armwatch_config::{BLANKS, DecimalMark, TextEncoding};

/// Bytes of text that are examined: at least a cycle of the full test of a six-axis arm.
const HEAD_BYTES: u64 = 24 << 20;

/// Lines that determine delimiter and decimal mark.
const FORMAT_LINES: usize = 400;

/// Fewest columns of a table: time, a position and a torque.
const LEAST_COLUMNS: usize = 3;

/// Cells of rows that are examined, which bounds the memory of their numbers: a table with [`HEAD_BYTES`] of text has
/// more only if its cells are shorter than the numbers of a recording.
const MOST_CELLS: usize = 4 << 20;

/// Most different words of a column that may represent stages.
const MOST_WORDS: usize = 16;

/// Least share of rows with a number for a numeric column.
const IS_NUMERIC: f64 = 0.9;

/// Largest share of non-numeric cells in a numeric column.
const MOST_BAD: f64 = 0.01;

/// Least share of numeric columns with a number for a line to be a row.
const ROW_SHARE: f64 = 0.75;

/// Last records above the rows that may contain the names.
const MOST_ABOVE: usize = 32;

/// Most lines of one record: names with line ends in them.
const MOST_LINES: usize = 200;

/// Most bytes of one record that is joined from lines.
const LONGEST_RECORD: usize = 1 << 20;

/// Numbers that a column with other cells keeps: enough for their range.
const KEPT_NUMBERS: usize = 4096;

/// The first rows, and their format.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Head {
    pub(super) encoding: Found,
    pub(super) delimiter: u8,
    pub(super) decimal: DecimalMark,
    /// True if there is a line of names.
    pub(super) header: bool,
    /// Why the layout cannot use that line and gives columns by number.
    pub(super) by_number: Option<&'static str>,
    /// True if that line begins with a comment sign.
    pub(super) commented_header: bool,
    /// Lines before the header that are neither blank nor comments.
    pub(super) skip_lines: usize,
    /// Lines between header and rows.
    pub(super) skip_after_header: usize,
    /// Name of the file, and the last lines above the names of the columns.
    pub(super) title: String,
    /// The columns in their order.
    pub(super) columns: Vec<HeadColumn>,
    pub(super) rows: usize,
}

/// A column.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct HeadColumn {
    /// Name in the header; its number if there is no name.
    pub(super) name: String,
    /// Text of the line below the header.
    pub(super) under: String,
    /// Its numbers, if nearly all cells are numbers; for dates and times, s from the first.
    pub(super) values: Option<Vec<f64>>,
    /// The first of its numbers, whatever the other cells are.
    pub(super) numbers: Vec<f64>,
    /// Cells among them that are not numbers; each has the number before it as its value.
    bad: usize,
    /// The forms that read all cells as times, for a column of text.
    pub(super) time_forms: TimeForms,
    /// The first of its cells.
    pub(super) cells: Vec<String>,
    /// The words, if the cells are few different words.
    pub(super) words: Option<Words>,
}

/// The cells of a column of words.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Words {
    /// The different words in their order.
    pub(super) words: Vec<String>,
    /// Index of each row's word among them, `[rows]`.
    pub(super) rows: Vec<u8>,
}

impl HeadColumn {
    /// The cell of the first row.
    pub(super) fn first(&self) -> &str {
        self.cells.first().map_or("", String::as_str)
    }

    /// Notes a cell of a possible column of words.
    fn note_word(&mut self, cell: &str) {
        let Some(Words { words, rows }) = &mut self.words else { return };
        let last = rows.last().copied().filter(|last| words[usize::from(*last)] == cell);
        let known =
            last.or_else(|| words.iter().position(|word| word == cell).and_then(|at| u8::try_from(at).ok()));
        match known {
            Some(at) => rows.push(at),
            None if words.len() < MOST_WORDS => {
                rows.push(words.len() as u8);
                words.push(cell.to_owned());
            }
            None => self.words = None,
        }
    }
}

impl Head {
    /// Names of the columns in their order; numbers if there are no names.
    pub(super) fn names(&self) -> Vec<&str> {
        self.columns.iter().map(|column| column.name.as_str()).collect()
    }

    /// A column in the form of a layout: by name, or by number if the name is not unique.
    pub(super) fn reference(&self, column: usize) -> String {
        match self.has_plain_name(column) {
            true => quoted(&self.columns[column].name),
            false => (column + 1).to_string(),
        }
    }

    /// Returns true if a layout can refer to a column by its name.
    pub(super) fn has_plain_name(&self, column: usize) -> bool {
        let name = &self.columns[column].name;
        self.header
            && self.by_number.is_none()
            && !name.trim().is_empty()
            && !name.contains("{joint")
            && self.columns.iter().filter(|other| other.name == *name).count() == 1
    }
}

/// Reads the head of an export.
///
/// # Errors
/// A rejection of a file that is unreadable or contains no table of numbers.
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
    // never collected: for a text of line ends only, they would take 16 times its bytes
    let lines = || whole.lines().map(|line| line.trim_end_matches('\r'));
    let no_table = || {
        Rejection::of_file(
            path,
            "no table of numbers with at least three columns",
            "check that this is a CSV export; delimiters may be , ; tab | and blanks",
        )
    };
    let only_returns = || lines().next().is_some_and(|line| line.contains('\r')) && !text.contains('\n');
    if only_returns() {
        let remedy = "convert it, for example with `tr '\\r' '\\n'`, or export with line ends of LF or CRLF";
        return Err(Rejection::of_file(path, "the lines end only with CR", remedy));
    }
    let sample: Vec<&str> = lines().take(FORMAT_LINES).collect();
    let format = format(&sample).ok_or_else(no_table)?;
    let mut head = assembled(lines(), format, text_reader.found()).ok_or_else(no_table)?;
    head.title.insert_str(0, &path.file_name().unwrap_or_default().to_string_lossy());
    Ok(head)
}

#[derive(Debug, Clone, PartialEq)]
struct HeadFormat {
    delimiter: u8,
    decimal: DecimalMark,
    fields: usize,
    /// True for each column with numbers in most rows.
    numeric: Vec<bool>,
}

impl HeadFormat {
    /// Returns true if a line is a row: it has as many fields, with numbers where most rows have them. A line of
    /// metadata may have numbers in half of its fields.
    fn is_row(&self, line: &str) -> bool {
        let mut count = 0;
        let cells = fields(line, self.delimiter).inspect(|_| count += 1).zip(&self.numeric);
        let numbers = cells.filter(|(cell, numeric)| **numeric && self.is_number(cell)).count();
        // the zip ends with the shorter
        let count = count.max(fields(line, self.delimiter).count());
        let expected = self.numeric.iter().filter(|numeric| **numeric).count();
        count == self.fields && numbers as f64 >= ROW_SHARE * expected as f64
    }

    fn is_number(&self, cell: &str) -> bool {
        cell::number(cell, self.decimal).is_ok()
    }
}

/// The delimiter and decimal mark that give most numbers in the first lines, in rows with equal numbers of fields.
fn format(sample: &[&str]) -> Option<HeadFormat> {
    // The second half of the sample contains no header.
    let sample = &sample[sample.len() / 2..];
    let candidates = [b';', b'\t', b'|', b',', BLANKS]
        .into_iter()
        .flat_map(|delimiter| [DecimalMark::Point, DecimalMark::Comma].map(|decimal| (delimiter, decimal)));
    let judged = candidates.filter_map(|(delimiter, decimal)| {
        let mut counts: Vec<usize> = sample.iter().map(|line| fields(line, delimiter).count()).collect();
        counts.sort_unstable();
        let usual = *counts.get(counts.len() / 2)?;
        if !(LEAST_COLUMNS..=MAX_COLUMNS).contains(&usual) {
            return None;
        }
        let rows: Vec<&str> =
            sample.iter().copied().filter(|line| fields(line, delimiter).count() == usual).collect();
        let mut numbers = vec![0_usize; usual];
        for line in &rows {
            for (numbers, cell) in numbers.iter_mut().zip(fields(line, delimiter)) {
                *numbers += usize::from(cell::number(cell, decimal).is_ok());
            }
        }
        // not a share of all lines: in a short file, names are among them
        let most = numbers.iter().copied().max().unwrap_or(0);
        let least = IS_NUMERIC * most as f64;
        let numeric: Vec<bool> = numbers.iter().map(|of| *of > 0 && *of as f64 >= least).collect();
        let all: usize = numbers.iter().sum();
        let enough =
            2 * numeric.iter().filter(|numeric| **numeric).count() >= usual || 2 * all >= usual * most;
        let format = HeadFormat { delimiter, decimal, fields: usual, numeric };
        (enough && all > 0).then_some((all, format))
    });
    // The first of equal candidates: points before commas if all numbers are whole.
    let best = judged.reduce(|best, next| if next.0 > best.0 { next } else { best });
    best.map(|(_, format)| format)
}

/// A line above the rows, or several lines joined by quotes.
#[derive(Debug)]
struct Record<'t> {
    text: Cow<'t, str>,
    lines: usize,
}

impl Record<'_> {
    fn is_comment(&self) -> bool {
        self.text.trim_start().starts_with('#')
    }

    /// Returns true if a reader of layouts counts the line: neither blank nor a comment.
    fn is_counted(&self) -> bool {
        !self.text.trim().is_empty() && !self.is_comment()
    }

    fn cells(&self, format: &HeadFormat) -> Vec<String> {
        let text = self.text.trim_start().trim_start_matches('#');
        fields(text, format.delimiter)
            .map(|cell| cell.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect()
    }
}

/// The records above the rows.
#[derive(Debug, Default)]
struct Above<'t> {
    /// Lines before the kept records, and true if a reader counts any of them.
    dropped: usize,
    is_dropped_counted: bool,
    /// The last records.
    records: VecDeque<Record<'t>>,
}

impl<'t> Above<'t> {
    fn note(&mut self, record: Record<'t>) {
        self.records.push_back(record);
        if self.records.len() > MOST_ABOVE
            && let Some(first) = self.records.pop_front()
        {
            self.dropped += first.lines;
            self.is_dropped_counted |= first.is_counted();
        }
    }

    /// The record of names: the one with most names in as many columns as the rows have, except the last line.
    fn names(&self, format: &HeadFormat) -> Option<usize> {
        let says = |record: &Record<'_>| -> Option<(usize, usize)> {
            let cells = record.cells(format);
            let fits = cells.len() > 1 && cells.len().abs_diff(format.fields) <= 1;
            let different: BTreeSet<&String> = cells.iter().filter(|cell| !cell.is_empty()).collect();
            let known = different.iter().filter(|cell| names::said(cell, "").kind.is_some()).count();
            let words = different.iter().filter(|cell| !format.is_number(cell)).count();
            (fits && words > 0).then_some((known, words))
        };
        let all = self.records.iter().enumerate().filter_map(|(at, record)| Some((says(record)?, at)));
        // the first of equal candidates: units are below names
        all.max_by_key(|(says, at)| (*says, std::cmp::Reverse(*at))).map(|(_, at)| at)
    }

    fn lines(&self, records: std::ops::Range<usize>) -> usize {
        self.records.range(records).map(|record| record.lines).sum()
    }
}

/// The next record: a line, or several lines that quotes join, above the first row.
fn record<'t>(
    first: &'t str,
    lines: &mut Peekable<impl Iterator<Item = &'t str>>,
    format: &HeadFormat,
) -> Record<'t> {
    let is_open = |text: &str| !text.matches('"').count().is_multiple_of(2);
    let mut record = Record { text: Cow::Borrowed(first), lines: 1 };
    while is_open(&record.text) && record.lines < MOST_LINES && record.text.len() < LONGEST_RECORD {
        let Some(next) = lines.next_if(|next| !format.is_row(next)) else { break };
        record.text = Cow::Owned(format!("{} {next}", record.text));
        record.lines += 1;
    }
    record
}

fn assembled<'t>(lines: impl Iterator<Item = &'t str>, format: HeadFormat, encoding: Found) -> Option<Head> {
    let mut lines = lines.peekable();
    let mut above = Above::default();
    let first_row = loop {
        let line = lines.next()?;
        if format.is_row(line) {
            break line;
        }
        above.note(record(line, &mut lines, &format));
    };
    let at = above.names(&format);
    let commented = at.is_some_and(|at| above.records[at].is_comment());
    let names = at.map(|at| above.records[at].cells(&format));
    let under = at.and_then(|at| above.records.get(at + 1)).map(|record| record.cells(&format));
    let under = under.filter(|cells| cells.len().abs_diff(format.fields) <= 1).unwrap_or_default();
    let mut columns: Vec<HeadColumn> = (0..format.fields)
        .map(|at| HeadColumn {
            name: match &names {
                Some(names) => names.get(at).cloned().unwrap_or_default(),
                None => (at + 1).to_string(),
            },
            under: under.get(at).cloned().unwrap_or_default(),
            values: Some(Vec::new()),
            numbers: Vec::new(),
            bad: 0,
            time_forms: TimeForms::default(),
            cells: Vec::new(),
            words: Some(Words::default()),
        })
        .collect();
    let mut rows = 0;
    let of_rows = std::iter::once(first_row).chain(lines.filter(|line| format.is_row(line)));
    for line in of_rows.take(MOST_CELLS.div_ceil(format.fields)) {
        rows += 1;
        let cells = fields(line, format.delimiter);
        for (column, cell) in columns.iter_mut().zip(cells) {
            column.note_word(cell);
            if column.cells.len() < time_form::MOST_CELLS {
                column.cells.push(cell.to_owned());
            }
            let number = cell::number(cell, format.decimal);
            let finite = number.as_ref().ok().copied().filter(|number| number.is_finite());
            column.numbers.extend(finite.filter(|_| column.numbers.len() < KEPT_NUMBERS));
            let Some(values) = &mut column.values else { continue };
            match (number, values.last().copied()) {
                (Ok(value), _) => values.push(value),
                // a few bad cells leave the column one of numbers
                (Err(_), Some(last)) => {
                    values.push(last);
                    column.bad += 1;
                }
                (Err(_), None) => column.values = None,
            }
        }
    }
    for column in columns.iter_mut().filter(|column| column.bad as f64 > MOST_BAD * rows as f64) {
        column.values = None;
    }
    for column in columns.iter_mut().filter(|column| column.values.is_none()) {
        let (forms, times) = TimeForms::of(&column.cells);
        (column.time_forms, column.values) = (forms, times);
    }
    // a reader counts the fields of the header, which it reads line by line
    let is_used = |column: &HeadColumn| !column.first().is_empty() || !column.numbers.is_empty();
    let used = columns.iter().rposition(is_used).map_or(0, |last| last + 1);
    let is_short = names.as_ref().is_some_and(|names| names.len() < used);
    let by_number = at.and_then(|at| match above.records[at].lines {
        _ if is_short => Some("there are fewer names than columns"),
        1 => None,
        _ => Some("the names contain line ends"),
    });
    // a note after the last name leaves the names in place; a number may belong to a column before the first
    let header = names.is_some() && !(is_short && columns[used - 1].values.is_some());
    if !header {
        columns.iter_mut().enumerate().for_each(|(at, column)| column.name = (at + 1).to_string());
    }
    let first = at.filter(|_| by_number.is_none()).unwrap_or(above.records.len());
    // Readers skip comments automatically; they count other lines from the start of the file.
    let is_counted = above.is_dropped_counted || above.records.range(..first).any(Record::is_counted);
    let is_skipped = is_counted || (by_number.is_some() && !above.records.is_empty());
    let below = if first < above.records.len() { first + 1 } else { first };
    let title = above.records.range(..first).map(|record| format!("\n{}", record.text)).collect();
    Some(Head {
        title,
        encoding,
        delimiter: format.delimiter,
        decimal: format.decimal,
        header,
        by_number,
        commented_header: commented && by_number.is_none(),
        skip_lines: if is_skipped { above.dropped + above.lines(0..first) } else { 0 },
        skip_after_header: above.lines(below..above.records.len()),
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
            ("# t a b\n1.0e+00 2.5e-01 3\n2.0e+00 3.5e-01 4\n", BLANKS, DecimalMark::Point),
            ("  t    a\t b\n  1.0D+00   2.5  3 \n  2.0D+00  -3.5  4 \n", BLANKS, DecimalMark::Point),
            ("t a b\n0,1 1,5 2\n0,2 1,6 3\n", BLANKS, DecimalMark::Comma),
            ("t, a, b\n1, 2, 3\n2, 3, 4\n", b',', DecimalMark::Point),
            ("t;\ta;\tb\n1;\t2;\t3\n2;\t3;\t4\n", b';', DecimalMark::Point),
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
