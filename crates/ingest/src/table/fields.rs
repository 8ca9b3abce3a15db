//! The fields of a line of CSV.

use std::ops::Range;

use crate::bytes::blocks::is_blank;
use armwatch_config::BLANKS;

/// The fields of a line, without surrounding blanks and quotes. A quoted field may contain the delimiter; doubled
/// quotes inside it stay doubled, since no number and no column needs them.
pub(crate) fn fields(line: &str, delimiter: u8) -> impl Iterator<Item = &str> {
    let mut next = Some(0);
    std::iter::from_fn(move || {
        let (field, end) = field_at(line.as_bytes(), next?, delimiter);
        next = match behind(line.as_bytes(), end, delimiter) {
            Behind::Field(start) => Some(start),
            Behind::Line(_) => None,
        };
        // fields begin and end next to ASCII characters
        Some(line.get(field).unwrap_or_default())
    })
}

/// The field that begins at `start`, with the same rules as [`fields`], and its end: a delimiter, a line feed, or the
/// end of the text.
pub(super) fn field_at(text: &[u8], start: usize, delimiter: u8) -> (Range<usize>, usize) {
    let blank = |byte: &u8| is_blank(*byte) && (delimiter == BLANKS || *byte != delimiter);
    let ends = |byte: &u8| *byte == b'\n' || separates(*byte, delimiter);
    let begin = start + text.iter().skip(start).take_while(|byte| blank(byte)).count();
    let quoted = quoted_end(&text[begin..]).unwrap_or(0);
    let end = text[begin + quoted..].iter().position(ends).map_or(text.len(), |at| begin + quoted + at);
    let field = trimmed(text, begin..end, blank);
    match &text[field.clone()] {
        [b'"', .., b'"'] => (trimmed(text, field.start + 1..field.end - 1, blank), end),
        _ => (field, end),
    }
}

/// The character after a field.
pub(super) enum Behind {
    /// Another field of the line, which begins here.
    Field(usize),
    /// The next line, which begins here.
    Line(usize),
}

/// The successor of a field that ends at `end`.
#[inline]
pub(super) fn behind(text: &[u8], end: usize, delimiter: u8) -> Behind {
    let next = match delimiter {
        BLANKS => end + text[end..].iter().take_while(|byte| is_blank(**byte)).count(),
        _ => end,
    };
    match text.get(next) {
        Some(b'\n') => Behind::Line(next + 1),
        Some(_) if delimiter == BLANKS => Behind::Field(next),
        Some(_) => Behind::Field(next + 1),
        None => Behind::Line(next),
    }
}

/// Byte after the closing quote of a text that begins with a quote; the quote closes in the same line.
fn quoted_end(text: &[u8]) -> Option<usize> {
    if text.first() != Some(&b'"') {
        return None;
    }
    let mut at = 1;
    loop {
        at += text.get(at..)?.iter().position(|byte| matches!(byte, b'"' | b'\n'))?;
        match (text[at], text.get(at + 1)) {
            (b'\n', _) => return None,
            // A doubled quote is a quote inside the field.
            (_, Some(b'"')) => at += 2,
            _ => return Some(at + 1),
        }
    }
}

fn trimmed(text: &[u8], field: Range<usize>, blank: impl Fn(&u8) -> bool) -> Range<usize> {
    let bytes = &text[field.clone()];
    let before = bytes.iter().take_while(|byte| blank(byte)).count();
    let after = bytes[before..].iter().rev().take_while(|byte| blank(byte)).count();
    field.start + before..field.end - after
}

pub(super) fn separates(byte: u8, delimiter: u8) -> bool {
    match delimiter {
        BLANKS => is_blank(byte),
        _ => byte == delimiter,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(line: &str) -> Vec<&str> {
        fields(line, b',').collect()
    }

    #[test]
    fn fields_lose_blanks_and_quotes_and_keep_quoted_delimiters() {
        assert_eq!(split("a,b"), ["a", "b"]);
        assert_eq!(split(""), [""]);
        assert_eq!(split(","), ["", ""]);
        assert_eq!(split(" a ,\tb\r"), ["a", "b"]);
        assert_eq!(split("\"a,b\", \" c \" ,d"), ["a,b", "c", "d"]);
        assert_eq!(split("\"a \"\"x\"\", y\",2"), ["a \"\"x\"\", y", "2"]);
        assert_eq!(split("5\" pipe,2"), ["5\" pipe", "2"]);
        assert_eq!(split("\"open,2"), ["\"open", "2"]);
        assert_eq!(split("\"\",\"\"\"\""), ["", "\"\""]);
        assert_eq!(fields("a\t b\t\t", b'\t').collect::<Vec<_>>(), ["a", "b", "", ""]);
    }

    #[test]
    fn a_quote_closes_in_its_line() {
        let text = b"\"open,2\n\"3\"";
        let (field, end) = field_at(text, 0, b',');
        assert_eq!((&text[field], end), (&b"\"open"[..], 5));
    }

    #[test]
    fn any_number_of_blanks_separates_fields() {
        let split = |line| fields(line, BLANKS).collect::<Vec<&str>>();
        assert_eq!(split("  1.0   -2.5\t3 \r"), ["1.0", "-2.5", "3"]);
        assert_eq!(split("a \"b c\"  d"), ["a", "b c", "d"]);
        assert_eq!(split("\"a b\""), ["a b"]);
        assert_eq!(split(" "), [""]);
        assert_eq!(split(""), [""]);
    }
}
