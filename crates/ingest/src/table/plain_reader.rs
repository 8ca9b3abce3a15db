//! Plain blocks read in one pass: each line as many cells as the header, a number in each that is needed.
//!
//! Anything else, such as a quote, a blank or an exponent, gives `None`, and the block goes to the readers that know
//! more: [`super::polars_reader`], then [`super::cell_reader`] with its messages. What is read here is what they read,
//! to the last bit.

use super::channels::{self, RawColumns};
use super::clock::TimeColumn;
use super::column_map::{ColumnMap, Role};
use super::fields::single;
use super::plain_number::number_at;
use armwatch_config::DecimalMark;

/// What is asked of the cells of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Number,
    Ignored,
}

/// Reads plain blocks of one export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PlainReader {
    kinds: Vec<Kind>,
    delimiter: u8,
    point: u8,
}

impl PlainReader {
    /// `None` for exports of which a needed column holds more than numbers: words, temperatures, which may be missing,
    /// dates, and clocks that count from another time than zero.
    pub(super) fn new(map: &ColumnMap) -> Option<Self> {
        let kind = |role: &Role| match role {
            Role::Ignored => Some(Kind::Ignored),
            Role::Time => match map.time {
                TimeColumn::Stamped { .. } => None,
                TimeColumn::Recorded(_) => {
                    map.time_origin.is_none_or(|origin| origin.digits == 0).then_some(Kind::Number)
                }
                TimeColumn::Wrapping { .. } | TimeColumn::Counted(_) => Some(Kind::Number),
            },
            role if channels::is_text(*role, map) || role.temperature_unit().is_some() => None,
            _ => Some(Kind::Number),
        };
        let point = match map.decimal {
            DecimalMark::Point => b'.',
            DecimalMark::Comma => b',',
        };
        let delimiter = single(map.delimiter);
        let sound = delimiter != point && !matches!(delimiter, b'-' | b'0'..=b'9');
        let kinds = map.roles.iter().map(kind).collect::<Option<Vec<Kind>>>()?;
        sound.then_some(Self { kinds, delimiter, point })
    }

    /// The columns of a block of whole lines, or `None` where one of them is not plain.
    pub(super) fn columns(&self, text: &[u8]) -> Option<RawColumns> {
        // lines are about as long as the first one, in which each cell is a byte and its end at least
        let first_line = text.iter().position(|byte| *byte == b'\n')? + 1;
        let rows = text.len() / first_line.max(2 * self.kinds.len());
        let rows = rows + rows / 16 + 1;
        let column = |kind: &Kind| match kind {
            Kind::Number => Vec::with_capacity(rows),
            Kind::Ignored => Vec::new(),
        };
        let mut columns: RawColumns = self.kinds.iter().map(column).collect();
        let last = self.kinds.len().checked_sub(1)?;
        let mut at = 0;
        while at < text.len() {
            for (column, (kind, values)) in self.kinds.iter().zip(&mut columns).enumerate() {
                let end = match kind {
                    Kind::Number => {
                        let (number, end) = number_at(text, at, self.point)?;
                        values.push(number);
                        end.get()
                    }
                    Kind::Ignored => self.cell_end(text, at)?,
                };
                let is_end = *text.get(end)? == self.delimiter;
                at = match (is_end, column < last) {
                    (true, true) => end + 1,
                    (false, false) => line_end(text, end)?,
                    _ => return None,
                };
            }
        }
        Some(columns)
    }

    /// Where a cell that is not needed ends; `None` if a quote, a zero byte or a character beyond ASCII stands in it.
    fn cell_end(&self, text: &[u8], start: usize) -> Option<usize> {
        let ends = |byte: &u8| *byte == self.delimiter || matches!(byte, b'\n' | b'\r' | b'"' | 0 | 0x80..);
        let end = start + text.get(start..)?.iter().position(ends)?;
        (text[end] == self.delimiter || matches!(text[end], b'\n' | b'\r')).then_some(end)
    }
}

/// Where the next line begins, behind the line end at `at`.
#[inline]
fn line_end(text: &[u8], at: usize) -> Option<usize> {
    match text.get(at)? {
        b'\n' => Some(at + 1),
        b'\r' if text.get(at + 1) == Some(&b'\n') => Some(at + 2),
        _ => None,
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

    fn reader(header: &str, layout: &Layout) -> PlainReader {
        let map = map_columns(header, layout, &er3a(), Path::new("a.csv")).expect("a header");
        PlainReader::new(&map).expect("numbers only")
    }

    /// The same lines by another road: split and parsed by the standard library.
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

    #[test]
    fn an_ordinary_export_is_plain() {
        let (_, text) = made_recording(300);
        let (header, body) = halves(&text);
        let reader = reader(header, &native());
        assert_eq!(reader.columns(body.as_bytes()), Some(split(body)));
        let with_returns = body.replace('\n', "\r\n");
        assert_eq!(reader.columns(with_returns.as_bytes()), Some(split(body)));
    }

    #[test]
    fn what_is_odd_is_left_to_others() {
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
            ("a blank", body.replacen(first, &format!(" {first}"), 1)),
            ("a quote", body.replacen(first, &format!("\"{first}\""), 1)),
            ("an exponent", body.replacen(first, "1e-3", 1)),
            ("a plus", body.replacen(first, "+1", 1)),
            ("a word", body.replacen(first, "nan", 1)),
            ("a short line", body.replacen(&format!("{first},"), "", 1)),
            ("a long line", body.replacen(first, &format!("{first},1"), 1)),
            ("no line end", body.trim_end().to_owned()),
        ];
        for (what, body) in odd {
            assert_eq!(reader.columns(body.as_bytes()), None, "{what}");
        }
    }

    #[test]
    fn other_columns_are_passed_over_and_commas_read() {
        let (_, text) = made_recording(50);
        let (header, body) = halves(&text);
        let expected = split(body);
        let layout = Layout { delimiter: b';', ..native() };
        let mut layout = layout;
        layout.text.decimal = DecimalMark::Comma;
        let more =
            |line: &str, cell: &str| format!("{cell};{};{cell}\n", line.replace(',', ";").replace('.', ","));
        let lines: String = body.lines().map(|line| more(line, "ab c")).collect();
        let header = more(header, "note").trim_end().replacen("note", "remark", 1);
        let found = reader(&header, &layout).columns(lines.as_bytes()).expect("plain");
        assert_eq!(found[1..found.len() - 1], expected);
        for odd in ["a\"b", "a\0b", "\u{e4}"] {
            let lines: String = body.lines().map(|line| more(line, odd)).collect();
            assert_eq!(reader(&header, &layout).columns(lines.as_bytes()), None);
        }
    }
}
