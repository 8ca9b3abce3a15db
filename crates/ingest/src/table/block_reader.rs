//! Reads valid blocks in one pass: each line has as many cells as the header, and each needed cell has a value of its
//! column.
//!
//! Anything else gives `None`, and [`super::cell_reader`] reads the block and finds the fault. Both readers cut lines
//! by the same rules ([`super::fields`]) and read unusual cells with the same functions. Only numbers that are plain,
//! have an exponent or are in quotes have a faster function here, which gives exactly the same result.

use std::num::NonZeroUsize;
use std::ops::Range;

use super::cell_reader::value;
use super::channels::{self, RawColumns};
use super::clock::TimeColumn;
use super::column_map::{ColumnMap, Role};
use super::fields::{Behind, behind, field_at, separates};
use super::plain_number::{exponent_number_at, number_at};
use crate::bytes::blocks::is_blank;
use armwatch_config::{BLANKS, DecimalMark};

/// Method of reading a column's cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CellKind {
    /// Numbers that consist of digits only.
    Number,
    /// Such numbers, one of them with an exponent.
    Exponent,
    /// Such numbers, the last of them in quotes.
    Quoted,
    /// Times relative to another origin than zero, dates, and numbers whose mark is the delimiter.
    Other,
    /// Words and temperatures: most are equal to those of the row before.
    Repeating,
    Ignored,
}

/// Reads valid blocks of one export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct BlockReader {
    kinds: Vec<CellKind>,
    point: u8,
}

/// The last cell of a column and its number.
type LastCell = Option<(Range<usize>, f64)>;

impl BlockReader {
    /// A reader of exports with these columns and this origin of times.
    pub(super) fn new(map: &ColumnMap) -> Self {
        let point = match map.decimal {
            DecimalMark::Point => b'.',
            DecimalMark::Comma => b',',
        };
        let is_apart = map.delimiter != point && !matches!(map.delimiter, b'-' | b'0'..=b'9');
        let kind = |role: &Role| match (role, map.time) {
            (Role::Ignored, _) => CellKind::Ignored,
            (Role::Time, TimeColumn::Stamped { .. }) => CellKind::Other,
            (Role::Time, TimeColumn::Recorded(_) | TimeColumn::Restarting(_))
                if map.time_origin.is_some_and(|origin| origin.digits != 0) =>
            {
                CellKind::Other
            }
            (role, _) if channels::is_text(*role, map) || role.temperature_unit().is_some() => {
                CellKind::Repeating
            }
            _ if is_apart => CellKind::Number,
            _ => CellKind::Other,
        };
        Self { kinds: map.roles.iter().map(kind).collect(), point }
    }

    /// The columns of a block of whole lines, or `None` if one of the lines is invalid.
    pub(super) fn columns(&self, text: &[u8], map: &ColumnMap) -> Option<RawColumns> {
        match map.delimiter {
            BLANKS => self.read::<true>(text, map),
            _ => self.read::<false>(text, map),
        }
    }

    fn read<const IN_BLANKS: bool>(&self, text: &[u8], map: &ColumnMap) -> Option<RawColumns> {
        // lines are about as long as the first one; each cell and its end are two bytes or more
        let first_line = text.iter().position(|byte| *byte == b'\n')? + 1;
        let rows = text.len() / first_line.max(2 * self.kinds.len());
        let rows = rows + rows / 16 + 1;
        let column = |kind: &CellKind| match kind {
            CellKind::Ignored => Vec::new(),
            _ => Vec::with_capacity(rows),
        };
        if text.last() != Some(&b'\n') {
            return None;
        }
        let mut columns: RawColumns = self.kinds.iter().map(column).collect();
        // writers use one form for all numbers of a column
        let mut kinds = self.kinds.clone();
        let mut known: Vec<LastCell> = vec![None; self.kinds.len()];
        let last = self.kinds.len().checked_sub(1)?;
        let mut at = 0;
        while at < text.len() {
            if IN_BLANKS {
                at = behind_blanks(text, at);
            }
            for (column, (kind, values)) in kinds.iter_mut().zip(&mut columns).enumerate() {
                let is_last = column == last;
                // a branch for the common kind, so that numbers stay in registers
                if *kind == CellKind::Number
                    && let Some((number, end)) = number_at(text, at, self.point)
                    && let Some(next) = plain_next::<IN_BLANKS>(text, end.get(), map.delimiter, is_last)
                {
                    values.push(number);
                    at = next;
                    continue;
                }
                if matches!(kind, CellKind::Exponent | CellKind::Quoted)
                    && let Some((number, end)) = self.number_alike(*kind, text, at)
                    && let Some(next) = plain_next::<IN_BLANKS>(text, end.get(), map.delimiter, is_last)
                {
                    values.push(number);
                    at = next;
                    continue;
                }
                if *kind == CellKind::Ignored
                    && let Some(end) = ignored_end(text, at, map.delimiter)
                    && let Some(next) = plain_next::<IN_BLANKS>(text, end, map.delimiter, is_last)
                {
                    at = next;
                    continue;
                }
                let (number, next) = self.odd_cell(text, at, column, map, (kind, &mut known[column]))?;
                values.extend(number);
                match (next, is_last) {
                    (Behind::Field(next), false) => at = next,
                    (Behind::Field(next), true) => at = end_of_empty(text, next, map.delimiter)?,
                    // columns without a name that the layout does not need may be missing
                    (Behind::Line(next), _) => {
                        at = (column + 1 >= map.least_fields).then_some(next)?;
                        break;
                    }
                }
            }
        }
        Some(columns)
    }

    /// A number in the form of the one before in its column.
    #[inline(never)]
    fn number_alike(&self, kind: CellKind, text: &[u8], at: usize) -> Option<(f64, NonZeroUsize)> {
        match kind {
            CellKind::Quoted => quoted_number_at(text, at, self.point),
            _ => exponent_number_at(text, at, self.point).or_else(|| number_at(text, at, self.point)),
        }
    }

    /// The number of any cell and its successor; no number for a cell that is not needed.
    #[cold]
    #[inline(never)]
    fn odd_cell(
        &self,
        text: &[u8],
        at: usize,
        column: usize,
        map: &ColumnMap,
        (found, known): (&mut CellKind, &mut LastCell),
    ) -> Option<(Option<f64>, Behind)> {
        let kind = *self.kinds.get(column)?;
        if kind == CellKind::Number
            && let Some((number, next, as_written)) = self.odd_number(text, at, map.delimiter)
        {
            *found = as_written;
            return Some((Some(number), next));
        }
        let (field, end) = field_at(text, at, map.delimiter);
        let cell = text.get(field.clone())?;
        let number = match (kind, known.as_ref()) {
            (CellKind::Repeating, Some((before, number))) if text.get(before.clone()) == Some(cell) => {
                Some(*number)
            }
            _ => {
                let role = *map.roles.get(column)?;
                let cell = std::str::from_utf8(cell).ok().filter(|cell| !cell.contains('\0'))?;
                match kind {
                    CellKind::Ignored => None,
                    CellKind::Repeating if channels::is_text(role, map) => {
                        Some(channels::word_number(cell, map)?)
                    }
                    CellKind::Repeating => Some(channels::temperature(cell, map.decimal)),
                    CellKind::Number | CellKind::Exponent | CellKind::Quoted | CellKind::Other => {
                        Some(value(cell, role, map).ok()?)
                    }
                }
            }
        };
        if kind == CellKind::Repeating {
            *known = number.map(|number| (field, number));
        }
        Some((number, behind(text, end, map.delimiter)))
    }

    /// A number with an exponent, in quotes or after blanks, its successor, and the probable form of the next row's.
    fn odd_number(&self, text: &[u8], at: usize, delimiter: u8) -> Option<(f64, Behind, CellKind)> {
        let at = at + text[at..].iter().take_while(|byte| **byte == b' ').count();
        let exponent = || exponent_number_at(text, at, self.point).map(|found| (found, CellKind::Exponent));
        let plain = || number_at(text, at, self.point).map(|found| (found, CellKind::Number));
        let quoted = quoted_number_at(text, at, self.point).map(|found| (found, CellKind::Quoted));
        let ((number, end), kind) = quoted.or_else(exponent).or_else(plain)?;
        let end = end.get() + usize::from(text.get(end.get()..end.get() + 2) == Some(b"\r\n"));
        let byte = *text.get(end)?;
        (byte == b'\n' || separates(byte, delimiter)).then(|| (number, behind(text, end, delimiter), kind))
    }
}

/// A number, with an exponent or without, in quotes.
#[inline]
fn quoted_number_at(text: &[u8], at: usize, point: u8) -> Option<(f64, NonZeroUsize)> {
    if text.get(at) != Some(&b'"') {
        return None;
    }
    let is_closed = |(_, end): &(f64, NonZeroUsize)| text.get(end.get()) == Some(&b'"');
    let plain = number_at(text, at + 1, point).filter(is_closed);
    let (number, end) = plain.or_else(|| exponent_number_at(text, at + 1, point).filter(is_closed))?;
    Some((number, end.checked_add(1)?))
}

/// The end of a cell that is not needed, or its first byte that needs another check.
#[inline]
fn ignored_end(text: &[u8], start: usize, delimiter: u8) -> Option<usize> {
    let ends = |byte: &u8| *byte == delimiter || matches!(byte, b'\n' | b'\r' | b'\t' | b'"' | 0 | 0x80..);
    Some(start + text.get(start..)?.iter().position(ends)?)
}

/// The start of the next cell or, after the last one, of the next line, for a cell that ends at `end`. `None` for
/// anything that is not plain.
#[inline(always)]
fn plain_next<const IN_BLANKS: bool>(text: &[u8], end: usize, delimiter: u8, is_last: bool) -> Option<usize> {
    if IN_BLANKS {
        let next = behind_blanks(text, end);
        return match (is_last, *text.get(next)? == b'\n') {
            (true, true) => Some(next + 1),
            (false, false) if next > end => Some(next),
            _ => None,
        };
    }
    match (is_last, *text.get(end)?) {
        (false, byte) if byte == delimiter => Some(end + 1),
        (true, b'\n') => Some(end + 1),
        (true, b'\r') if text.get(end + 1) == Some(&b'\n') => Some(end + 2),
        _ => None,
    }
}

#[inline]
fn behind_blanks(text: &[u8], at: usize) -> usize {
    at + text[at..].iter().take_while(|byte| is_blank(**byte)).count()
}

/// The next line after cells that are empty.
fn end_of_empty(text: &[u8], mut at: usize, delimiter: u8) -> Option<usize> {
    loop {
        let (field, end) = field_at(text, at, delimiter);
        match behind(text, end, delimiter) {
            _ if !field.is_empty() => return None,
            Behind::Field(next) => at = next,
            Behind::Line(next) => return Some(next),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::fixture::{made_recording, native};
    use crate::table::column_map::map_columns;
    use armwatch_config::Layout;
    use armwatch_testing::er3a;

    fn reader(header: &str, layout: &Layout) -> (BlockReader, ColumnMap) {
        let map = map_columns(header, layout, &er3a(), Path::new("a.csv")).expect("a header");
        (BlockReader::new(&map), map)
    }

    /// The same lines by another method: split and parsed by the standard library.
    fn split(text: &str) -> RawColumns {
        let mut columns = RawColumns::new();
        for line in text.lines() {
            for (column, cell) in line.split(',').enumerate() {
                columns.resize(columns.len().max(column + 1), Vec::new());
                columns[column].push(cell.parse().expect("a number"));
            }
        }
        columns
    }

    fn halves(text: &str) -> (&str, &str) {
        text.split_once('\n').expect("a header")
    }

    fn columns((reader, map): &(BlockReader, ColumnMap), text: &str) -> Option<RawColumns> {
        reader.columns(text.as_bytes(), map)
    }

    #[test]
    fn an_ordinary_export_is_read() {
        let (_, text) = made_recording(300);
        let (header, body) = halves(&text);
        let reader = reader(header, &native());
        assert_eq!(columns(&reader, body), Some(split(body)));
        let with_returns = body.replace('\n', "\r\n");
        assert_eq!(columns(&reader, &with_returns), Some(split(body)));
    }

    #[test]
    fn what_is_unsound_is_left_to_the_reader_of_cells() {
        let (_, text) = made_recording(20);
        let (header, body) = halves(&text);
        let reader = reader(header, &native());
        let first = body.split_once(',').expect("cells").0;
        let odd: [(&str, String); 10] = [
            (
                "a blank line",
                format!("\n{}", body.lines().skip(1).map(|l| format!("{l}\n")).collect::<String>()),
            ),
            ("an empty cell", body.replacen(first, "", 1)),
            ("a quote that does not close", body.replacen(first, &format!("\"{first}"), 1)),
            ("an exponent without digits", body.replacen(first, "1e", 1)),
            ("two signs", body.replacen(first, "--1", 1)),
            ("a word", body.replacen(first, "x", 1)),
            ("a NUL", body.replacen(first, "1\0", 1)),
            ("a short line", body.replacen(&format!("{first},"), "", 1)),
            ("a long line", body.replacen(first, &format!("{first},1"), 1)),
            ("no line end", body.trim_end().to_owned()),
        ];
        for (what, body) in odd {
            assert_eq!(columns(&reader, &body), None, "{what}");
        }
    }

    #[test]
    fn other_columns_are_passed_over_and_commas_read() {
        let (_, text) = made_recording(50);
        let (header, body) = halves(&text);
        let expected = split(body);
        let mut layout = Layout { delimiter: b';', ..native() };
        layout.text.decimal = DecimalMark::Comma;
        let more =
            |line: &str, cell: &str| format!("{cell};{};{cell}\n", line.replace(',', ";").replace('.', ","));
        let header = more(header, "note").trim_end().replacen("note", "remark", 1);
        let reader = reader(&header, &layout);
        let with = |cell| body.lines().map(|line| more(line, cell)).collect::<String>();
        for sound in ["ab c", "", " ", "a\"b", "\"a;b\"", "\u{e4}", "a\tb"] {
            let found = columns(&reader, &with(sound)).expect(sound);
            assert_eq!(found[1..found.len() - 1], expected, "{sound}");
        }
        assert_eq!(columns(&reader, &with("a\0b")), None);
        let mut broken = with("a").into_bytes();
        broken[0] = 0xFF;
        assert_eq!(reader.0.columns(&broken, &reader.1), None, "no UTF-8");
    }

    #[test]
    fn columns_without_a_name_may_be_missing_and_cells_beyond_the_header_empty() {
        let (_, text) = made_recording(20);
        let (header, body) = halves(&text);
        let reader = reader(&format!("{header},,"), &native());
        for end in ["", ",", ",,", ",,,", ", ,\"\",\t"] {
            let found = columns(&reader, &body.replace('\n', &format!("{end}\n"))).expect(end);
            assert_eq!(found[..23], split(body), "{end}");
        }
        assert_eq!(columns(&reader, &body.replace('\n', ",,,1\n")), None);
    }
}
