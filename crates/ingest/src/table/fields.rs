//! The fields of a line of CSV.

/// The fields of a line: blanks around them and quotes taken off. A quoted field may hold the
/// delimiter; quotes doubled inside it stay doubled, since no number and no column needs them.
pub(crate) fn fields(line: &str, delimiter: u8) -> impl Iterator<Item = &str> {
    let delimiter = char::from(delimiter);
    let blank = move |c: char| matches!(c, ' ' | '\t' | '\r') && c != delimiter;
    let mut rest = Some(line);
    std::iter::from_fn(move || {
        let text = rest?;
        let (field, after) = match quoted_end(text.trim_start_matches(blank)) {
            Some(end) => {
                let start = text.len() - text.trim_start_matches(blank).len();
                split_at_delimiter(text, start + end, delimiter)
            }
            None => split_at_delimiter(text, 0, delimiter),
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

fn split_at_delimiter(text: &str, search_from: usize, delimiter: char) -> (&str, Option<&str>) {
    match text[search_from..].find(delimiter) {
        Some(at) => {
            let at = search_from + at;
            (&text[..at], Some(&text[at + delimiter.len_utf8()..]))
        }
        None => (text, None),
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
}
