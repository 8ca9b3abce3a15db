//! The text format of an export, which applies before columns are searched: encoding, decimal mark and the lines around
//! the header.

use crate::toml::table::{Table, Value};

/// Most lines before the header, or between it and the rows.
const MAX_SKIPPED_LINES: i64 = 10_000;

/// Longest sign that begins a comment.
const MAX_COMMENT_CHARS: usize = 8;

/// Start of a comment before the header, unless the layout gives another one.
const COMMENT: &str = "#";

/// Text format of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TextFormat {
    /// Encoding of characters.
    pub encoding: TextEncoding,
    /// Mark before the decimals of a number.
    pub decimal: DecimalMark,
    /// Lines at the start of the file that are skipped.
    pub skip_lines: usize,
    /// Lines before the header that begin with this are comments; empty for none.
    pub comment: String,
    /// Lines between the header and the first row that are skipped, such as a row of units.
    pub skip_after_header: usize,
}

impl Default for TextFormat {
    fn default() -> Self {
        Self {
            encoding: TextEncoding::Auto,
            decimal: DecimalMark::Point,
            skip_lines: 0,
            comment: COMMENT.into(),
            skip_after_header: 0,
        }
    }
}

/// Encoding of an export's characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TextEncoding {
    /// Detected by byte order mark, zero bytes and invalid UTF-8.
    #[default]
    Auto,
    /// UTF-8, with or without byte order mark.
    Utf8,
    /// UTF-16, the low byte of each unit first.
    Utf16Le,
    /// UTF-16, the high byte of each unit first.
    Utf16Be,
    /// Windows-1252, which includes the printable characters of Latin-1.
    Windows1252,
}

impl TextEncoding {
    /// All encodings by their names in layouts.
    const NAMED: [(&'static str, Self); 7] = [
        ("auto", Self::Auto),
        ("utf-8", Self::Utf8),
        ("utf-16le", Self::Utf16Le),
        ("utf-16be", Self::Utf16Be),
        ("windows-1252", Self::Windows1252),
        ("latin-1", Self::Windows1252),
        ("iso-8859-1", Self::Windows1252),
    ];

    /// Name in a layout.
    pub fn name(self) -> &'static str {
        Self::NAMED.iter().find(|(_, encoding)| *encoding == self).map_or("auto", |(name, _)| name)
    }
}

/// Mark before the decimals of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DecimalMark {
    /// `1.5`
    #[default]
    Point,
    /// `1,5`
    Comma,
}

/// Reads the keys of a layout's root table; `None` if one is wrong.
pub(crate) fn read(root: &Table<'_>) -> Option<TextFormat> {
    let usual = TextFormat::default();
    let encoding = root.optional("encoding").map_or(Some(usual.encoding), |v| read_encoding(&v));
    let decimal = root.optional("decimal").map_or(Some(usual.decimal), |v| read_decimal(&v));
    let lines = |key| root.optional(key).map_or(Some(0), |value| read_lines(&value));
    let (skip_lines, skip_after_header) = (lines("skip_lines"), lines("skip_after_header"));
    let comment = root.optional("comment").map_or(Some(usual.comment), |v| read_comment(&v));
    let after = skip_after_header?;
    if after > 0 && root.optional("header").is_some_and(|value| value.boolean() == Some(false)) {
        let value = root.optional("skip_after_header")?;
        value.refuse(
            "without a header there are no lines to skip after it".into(),
            Some("use skip_lines".into()),
        );
        return None;
    }
    Some(TextFormat {
        encoding: encoding?,
        decimal: decimal?,
        skip_lines: skip_lines?,
        comment: comment?,
        skip_after_header: after,
    })
}

fn read_encoding(value: &Value<'_>) -> Option<TextEncoding> {
    let given = value.text()?;
    let known = TextEncoding::NAMED.iter().find(|(name, _)| name.eq_ignore_ascii_case(given));
    if known.is_none() {
        let names: Vec<_> = TextEncoding::NAMED.iter().map(|(name, _)| format!("{name:?}")).collect();
        value.refuse(format!("unknown encoding, must be one of {}", names.join(", ")), None);
    }
    known.map(|(_, encoding)| *encoding)
}

fn read_decimal(value: &Value<'_>) -> Option<DecimalMark> {
    match value.any_text()? {
        "." => Some(DecimalMark::Point),
        "," => Some(DecimalMark::Comma),
        _ => {
            value.refuse("must be \".\" or \",\"".into(), None);
            None
        }
    }
}

fn read_lines(value: &Value<'_>) -> Option<usize> {
    usize::try_from(value.integer(0..=MAX_SKIPPED_LINES)?).ok()
}

fn read_comment(value: &Value<'_>) -> Option<String> {
    let sign = value.any_text()?;
    if sign.chars().count() > MAX_COMMENT_CHARS || sign.contains(['\n', '\r']) {
        value.refuse(
            format!("must be at most {MAX_COMMENT_CHARS} characters"),
            Some("write \"\" if no line is a comment".into()),
        );
        return None;
    }
    Some(sign.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::layout_file::parse_layout;

    const NATIVE: &str = include_str!("../../../../config/exports/native.toml");

    fn with(keys: &str) -> Result<TextFormat, String> {
        let text = NATIVE.replace("header = true", &format!("header = true\n{keys}"));
        parse_layout("a.toml", &text).map(|layout| layout.text).map_err(|errors| errors.to_string())
    }

    #[test]
    fn keys_may_be_left_out_and_are_read() {
        assert_eq!(with(""), Ok(TextFormat::default()));
        let keys = "encoding = \"UTF-16LE\"\ndecimal = \",\"\nskip_lines = 3\ncomment = \"//\"\n\
                    skip_after_header = 1";
        let expected = TextFormat {
            encoding: TextEncoding::Utf16Le,
            decimal: DecimalMark::Comma,
            skip_lines: 3,
            comment: "//".into(),
            skip_after_header: 1,
        };
        assert_eq!(with(keys), Ok(expected));
        assert_eq!(with("encoding = \"latin-1\"").map(|f| f.encoding), Ok(TextEncoding::Windows1252));
    }

    #[test]
    fn wrong_keys_are_refused_with_what_they_may_be() {
        for (keys, said) in [
            ("encoding = \"utf8\"", "must be one of \"auto\", \"utf-8\","),
            ("decimal = \";\"", "must be \".\" or \",\""),
            ("skip_lines = -1", "must be between 0 and 10000"),
            ("comment = \"a long sentence\"", "at most 8 characters"),
            ("skip_after_header = 1\nheader = true", "duplicate key"),
        ] {
            let errors = with(keys).expect_err(keys);
            assert!(errors.contains(said), "{keys}: {errors}");
        }
        let text = NATIVE.replace("header = true", "header = false\nskip_after_header = 1");
        let errors = parse_layout("a.toml", &text).expect_err("no header").to_string();
        assert!(errors.contains("use skip_lines"), "{errors}");
    }

    #[test]
    fn names_lead_back() {
        for (name, encoding) in TextEncoding::NAMED.into_iter().take(5) {
            assert_eq!(encoding.name(), name);
        }
    }
}
