//! The fields of a line of CSV.

use std::borrow::Cow;

use armwatch_config::BLANKS;

/// The fields of a line: blanks around them and quotes taken off. A quoted field may hold the
/// delimiter; quotes doubled inside it stay doubled, since no number and no column needs them.
pub(crate) fn fields(line: &str, delimiter: u8) -> impl Iterator<Item = &str> {
    let separates = move |c: char| match delimiter {
        BLANKS => is_blank(c),
        delimiter => c == char::from(delimiter),
    };
    let blank = move |c: char| is_blank(c) && (delimiter == BLANKS || !separates(c));
    let mut rest = Some(line);
    std::iter::from_fn(move || {
        let mut text = rest?;
        if delimiter == BLANKS {
            text = text.trim_matches(is_blank);
        }
        let (field, after) = match quoted_end(text.trim_start_matches(blank)) {
            Some(end) => {
                let start = text.len() - text.trim_start_matches(blank).len();
                split_at_delimiter(text, start + end, separates)
            }
            None => split_at_delimiter(text, 0, separates),
        };
        rest = after;
        let field = field.trim_matches(blank);
        let inside = field.strip_prefix('"').and_then(|f| f.strip_suffix('"'));
        Some(inside.map_or(field, |inside| inside.trim_matches(blank)))
    })
}

/// Byte behind the closing quote of a text that begins with a quote.
fn quoted_end(text: &str) -> Option<usize> {
    let mut quotes = text.strip_prefix('"')?.match_indices('"').map(|(at, _)| at + 1).peekable();
    while let Some(quote) = quotes.next() {
        // A doubled quote is a quote inside the field.
        if quotes.next_if_eq(&(quote + 1)).is_none() {
            return Some(quote + 1);
        }
    }
    None
}

fn is_blank(character: char) -> bool {
    matches!(character, ' ' | '\t' | '\r')
}

/// The text up to the next delimiter, which is one byte, and the text behind it.
fn split_at_delimiter(
    text: &str,
    search_from: usize,
    separates: impl Fn(char) -> bool,
) -> (&str, Option<&str>) {
    match text[search_from..].find(separates) {
        Some(at) => (&text[..search_from + at], Some(&text[search_from + at + 1..])),
        None => (text, None),
    }
}

/// The byte between two cells, after [`with_tabs`] for [`BLANKS`].
pub(super) fn single(delimiter: u8) -> u8 {
    if delimiter == BLANKS { b'\t' } else { delimiter }
}

/// Lines of [`BLANKS`] with one tab between two cells and no other blanks; `None` if there is a quote.
pub(super) fn with_tabs(lines: &[u8]) -> Option<Cow<'static, [u8]>> {
    let mut out = Vec::with_capacity(lines.len());
    let mut is_due = false;
    for &byte in lines {
        match byte {
            b' ' | b'\t' | b'\r' => is_due = true,
            b'"' => return None,
            b'\n' => {
                is_due = false;
                out.push(b'\n');
            }
            byte => {
                if std::mem::take(&mut is_due) && out.last().is_some_and(|last| *last != b'\n') {
                    out.push(b'\t');
                }
                out.push(byte);
            }
        }
    }
    Some(Cow::Owned(out))
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
    fn any_number_of_blanks_separates_fields() {
        let split = |line| fields(line, BLANKS).collect::<Vec<&str>>();
        assert_eq!(split("  1.0   -2.5\t3 \r"), ["1.0", "-2.5", "3"]);
        assert_eq!(split("a \"b c\"  d"), ["a", "b c", "d"]);
        assert_eq!(split("\"a b\""), ["a b"]);
        assert_eq!(split(" "), [""]);
        let lines = with_tabs(b"  1  2\t\t3 \r\n4 5 6\n").expect("no quote");
        assert_eq!(&*lines, b"1\t2\t3\n4\t5\t6\n");
        assert_eq!(with_tabs(b"1 \"2 3\"\n"), None);
    }
}
