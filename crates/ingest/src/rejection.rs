//! Why an export was not understood, and the remedy.

use std::path::Path;
use std::{fmt, io};

use armwatch_model::text;

/// Longest value shown in a message, in characters; a damaged line may contain megabytes.
const SHOWN_VALUE_CHARS: usize = 60;

/// An export that is not understood: place, value, reason and remedy.
///
/// Displayed as `R01.csv, line 1234, column trq_3: "abc" is not a number; export again or correct
/// the cell`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub struct Rejection {
    /// The file.
    pub path: Box<Path>,
    /// Line in the decompressed file, from 1; the header is line 1.
    pub line: Option<u64>,
    /// Offset of that line's first byte in the decompressed file, from 0.
    pub byte: Option<u64>,
    /// Column name in the header.
    pub column: Option<Box<str>>,
    /// Text at this place.
    pub value: Option<Box<str>>,
    /// The fault, short; if there is a value, it completes the sentence "value is ..".
    pub reason: Box<str>,
    /// The remedy.
    pub remedy: Box<str>,
    /// True if the system refused to read the file, for a reason unrelated to its content: it is read again later.
    pub is_passing: bool,
    /// True if only one row is not understood, which a layout may permit to skip.
    pub is_bad_row: bool,
}

impl Rejection {
    /// A rejection of the file as a whole.
    pub fn of_file(path: &Path, reason: impl Into<Box<str>>, remedy: impl Into<Box<str>>) -> Self {
        Self {
            path: path.into(),
            line: None,
            byte: None,
            column: None,
            value: None,
            reason: reason.into(),
            remedy: remedy.into(),
            is_passing: false,
            is_bad_row: false,
        }
    }

    /// Adds a line, from 1.
    #[must_use]
    pub fn at_line(mut self, line: u64) -> Self {
        self.line = Some(line);
        self
    }

    /// Adds the offset of the line's first byte, from 0.
    #[must_use]
    pub fn at_byte(mut self, byte: u64) -> Self {
        self.byte = Some(byte);
        self
    }

    /// Changes the line of a header that is further down, at `line`, below lines of other text.
    #[must_use]
    pub(super) fn with_header_at(mut self, line: u64) -> Self {
        let lines = line.saturating_sub(1);
        self.remedy =
            format!("the names of the columns are in line {line}: set skip_lines = {lines} in the layout")
                .into();
        self
    }

    /// Adds a column.
    #[must_use]
    pub fn in_column(mut self, column: &str) -> Self {
        self.column = Some(shortened(column).into());
        self
    }

    /// Adds the value at the place, shortened if it is very long.
    #[must_use]
    pub fn with_value(mut self, value: &str) -> Self {
        self.value = Some(shortened(value).into());
        self
    }

    /// A rejection that was stored earlier as its [`Rejection::sentence`].
    pub fn stored(path: &Path, sentence: impl Into<Box<str>>) -> Self {
        Self::of_file(path, sentence, "")
    }

    /// Place, fault and remedy without the file, as stored in the ledger next to the file's name.
    pub fn sentence(&self) -> String {
        let places = self.places();
        if places.is_empty() { self.fault() } else { format!("{places}: {}", self.fault()) }
    }

    /// The fault with its column and value, without line and remedy.
    pub fn problem(&self) -> String {
        let column = self.column.as_ref().map(|column| format!("column {column}: "));
        let value = self.value.as_ref().map(|value| format!("\"{}\" is ", value.escape_debug()));
        format!("{}{}{}", column.unwrap_or_default(), value.unwrap_or_default(), self.reason)
    }

    fn places(&self) -> String {
        let line = self.line.map(|line| format!("line {line}"));
        let column = self.column.as_ref().map(|column| format!("column {column}"));
        line.into_iter().chain(column).collect::<Vec<_>>().join(", ")
    }

    fn fault(&self) -> String {
        let value = self.value.as_ref().map(|value| format!("\"{}\" is ", value.escape_debug()));
        let remedy = if self.remedy.is_empty() { String::new() } else { format!("; {}", self.remedy) };
        let byte = self.byte.map(|byte| format!(" (the line begins at byte {byte})"));
        format!("{}{}{remedy}{}", value.unwrap_or_default(), self.reason, byte.unwrap_or_default())
    }

    /// A rejection from a failed read, with the explanation that [`super::bytes::source`] gave the error, if any. An
    /// error of the operating system may be temporary.
    pub fn from_io(path: &Path, error: &io::Error) -> Self {
        if let Some(known) = error.get_ref().and_then(|inner| inner.downcast_ref::<Unreadable>()) {
            return Self::of_file(path, known.reason.clone(), known.remedy.clone());
        }
        let (reason, remedy) = match error.kind() {
            io::ErrorKind::InvalidInput => (error.to_string(), "give the path of a CSV export"),
            io::ErrorKind::NotFound => ("no such file".into(), "check the path"),
            io::ErrorKind::PermissionDenied => {
                ("no permission to read".into(), "let this user read the file and its folder")
            }
            _ => (
                format!("read failure: {error}"),
                "check the disk or the share, and that the file is readable for this user",
            ),
        };
        Self { is_passing: error.raw_os_error().is_some(), ..Self::of_file(path, reason, remedy) }
    }
}

impl fmt::Display for Rejection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", text::of_path(&self.path))?;
        let places = self.places();
        if !places.is_empty() {
            write!(f, ", {places}")?;
        }
        write!(f, ": {}", self.fault())
    }
}

/// A stream that cannot be read to its end; wrapped in an [`io::Error`], the only error type of [`io::Read`].
#[derive(Debug, Clone, thiserror::Error)]
#[error("{reason}; {remedy}")]
pub(crate) struct Unreadable {
    pub(crate) reason: String,
    pub(crate) remedy: String,
}

fn shortened(text: &str) -> String {
    match text.char_indices().nth(SHOWN_VALUE_CHARS) {
        Some((end, _)) => format!("{}..", &text[..end]),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_where_what_why_and_the_remedy() {
        let rejection =
            Rejection::of_file(Path::new("R01.csv"), "not a number", "export again or correct the cell")
                .at_line(1234)
                .in_column("trq_3")
                .with_value("abc");
        assert_eq!(
            rejection.to_string(),
            "R01.csv, line 1234, column trq_3: \"abc\" is not a number; export again or correct the cell"
        );
        assert_eq!(
            rejection.at_byte(77).sentence(),
            "line 1234, column trq_3: \"abc\" is not a number; export again or correct the cell \
             (the line begins at byte 77)"
        );
    }

    #[test]
    fn what_the_system_refuses_may_pass_and_what_a_decoder_refuses_stays() {
        let of = |error: &io::Error| Rejection::from_io(Path::new("a.csv"), error);
        for errno in [2, 5, 13, 116] {
            let rejection = of(&io::Error::from_raw_os_error(errno));
            assert!(rejection.is_passing && !rejection.remedy.is_empty(), "{rejection}");
        }
        let cut =
            Unreadable { reason: "a gzip stream that ends too early".into(), remedy: "copy again".into() };
        assert!(!of(&io::Error::other(cut)).is_passing);
        assert!(!of(&io::Error::new(io::ErrorKind::InvalidInput, "a folder")).is_passing);
    }

    #[test]
    fn a_very_long_value_is_shortened_at_a_character() {
        let rejection = Rejection::of_file(Path::new("a"), "x", "y").with_value(&"é".repeat(1000));
        assert_eq!(rejection.value.map(|v| v.chars().count()), Some(SHOWN_VALUE_CHARS + 2));
    }
}
