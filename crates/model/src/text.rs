//! Text from outside, such as names of files and robots, cells, notes and answers of servers, made safe to show.
//!
//! [`shown`] is for people: logs, terminals, messages, comments. [`json`] is for JSON and keeps the text the same.
//! [`distinct`] and [`percent`] are for names that identify: different names stay different. [`of_bytes`] makes text of
//! names that are not UTF-8, and [`to_bytes`] gives their bytes back.

use std::borrow::Cow;
use std::ffi::OsString;
use std::fmt::Write;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};

/// True for characters that are invisible or that change how others are displayed: control characters, line and
/// paragraph separators, marks of writing direction, characters without width, and noncharacters.
///
/// Unicode names these sets `Cc`, `Zl`, `Zp`, `Bidi_Control`, `Default_Ignorable_Code_Point` and
/// `Noncharacter_Code_Point`; marks of annotations, U+FFF9 to U+FFFB, are hidden too.
#[must_use]
pub fn is_hidden(character: char) -> bool {
    if character.is_ascii() {
        return character.is_ascii_control();
    }
    matches!(character,
        '\u{80}'..='\u{9f}' | '\u{ad}' | '\u{34f}' | '\u{61c}' | '\u{115f}'..='\u{1160}' | '\u{17b4}'..='\u{17b5}'
        | '\u{180b}'..='\u{180f}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}'
        | '\u{3164}' | '\u{fdd0}'..='\u{fdef}' | '\u{fe00}'..='\u{fe0f}' | '\u{feff}' | '\u{ffa0}'
        | '\u{fff0}'..='\u{fffb}' | '\u{1bca0}'..='\u{1bca3}' | '\u{1d173}'..='\u{1d17a}' | '\u{e0000}'..='\u{e0fff}')
        || u32::from(character) & 0xfffe == 0xfffe
}

/// A text on one line for display: hidden characters become `\n` or `\u{202e}`.
///
/// Converted text stays unchanged.
#[must_use]
pub fn shown(text: &str) -> Cow<'_, str> {
    replaced(text, is_hidden, |out, character| out.extend(character.escape_default()))
}

/// Like [`shown`], with line feeds and tabulators unchanged.
#[must_use]
pub fn shown_lines(text: &str) -> Cow<'_, str> {
    let is_hidden = |character| is_hidden(character) && !matches!(character, '\n' | '\t');
    replaced(text, is_hidden, |out, character| out.extend(character.escape_default()))
}

/// Like [`shown`], for a name that identifies: no two names give the same text.
#[must_use]
pub fn distinct(name: &str) -> Cow<'_, str> {
    if !name.contains(is_hidden) && !name.contains("\\u{") {
        return Cow::Borrowed(name);
    }
    let is_escaped = |character| is_hidden(character) || character == '\\';
    replaced(name, is_escaped, |out, character| out.extend(character.escape_unicode()))
}

/// Text for XML and HTML: markup as entities, hidden characters as in [`shown`] except for line feeds and tabulators.
/// XML 1.0 does not allow most of them.
#[must_use]
pub fn xml(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in shown_lines(text).chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            _ => escaped.push(character),
        }
    }
    escaped
}

/// JSON with hidden characters as `\u202e`, which a reader converts to the characters themselves.
#[must_use]
pub fn json(json: &str) -> Cow<'_, str> {
    // control characters of ASCII are only between values: in strings the writer has escaped them
    let is_escaped = |character| is_hidden(character) && (character > '\u{7e}');
    replaced(json, is_escaped, |out, character| {
        for unit in character.encode_utf16(&mut [0; 2]) {
            // writing to a string cannot fail
            let _ = write!(out, "\\u{unit:04x}");
        }
    })
}

/// A name with hidden characters, `%` and those of `special` as bytes, such as `%2F`, as in addresses. No two names
/// give the same text.
#[must_use]
pub fn percent<'n>(name: &'n str, special: &[char]) -> Cow<'n, str> {
    let is_escaped = |character| is_hidden(character) || character == '%' || special.contains(&character);
    replaced(name, is_escaped, |out, character| {
        for byte in character.encode_utf8(&mut [0; 4]).bytes() {
            let _ = write!(out, "%{byte:02X}");
        }
    })
}

/// Text of a name. Bytes that are not UTF-8, as old controllers write them, become `\xE9`. No two names give the same
/// text; [`to_bytes`] returns the bytes.
#[must_use]
pub fn of_bytes(name: &[u8]) -> String {
    let mut text = String::with_capacity(name.len());
    for chunk in name.utf8_chunks() {
        let mut rest = chunk.valid();
        while let Some(at) = rest.find('\\') {
            let (before, behind) = rest.split_at(at);
            text.push_str(before);
            // a name that looks like an escape
            text.push_str(if escaped_byte(behind).is_some() { "\\x5C" } else { "\\" });
            rest = &behind[1..];
        }
        text.push_str(rest);
        for byte in chunk.invalid() {
            let _ = write!(text, "\\x{byte:02X}");
        }
    }
    text
}

/// Inverse of [`of_bytes`].
#[must_use]
pub fn to_bytes(text: &str) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text;
    while let Some(at) = rest.find('\\') {
        let (before, behind) = rest.split_at(at);
        bytes.extend_from_slice(before.as_bytes());
        let (byte, length) = escaped_byte(behind).map_or((b'\\', 1), |byte| (byte, ESCAPE_LENGTH));
        bytes.push(byte);
        rest = &behind[length..];
    }
    bytes.extend_from_slice(rest.as_bytes());
    bytes
}

/// Text of a path, see [`of_bytes`].
#[must_use]
pub fn of_path(path: &Path) -> String {
    of_bytes(path.as_os_str().as_bytes())
}

/// Text of the last part of a path, see [`of_bytes`]; for a path that ends in `..`, text of all of it.
#[must_use]
pub fn of_file_name(path: &Path) -> String {
    of_bytes(path.file_name().unwrap_or(path.as_os_str()).as_bytes())
}

/// Inverse of [`of_path`].
#[must_use]
pub fn to_path(text: &str) -> PathBuf {
    OsString::from_vec(to_bytes(text)).into()
}

/// Length of `\xE9`.
const ESCAPE_LENGTH: usize = 4;

/// The byte of the escape at the start of a text.
fn escaped_byte(text: &str) -> Option<u8> {
    let digits = text.strip_prefix("\\x")?.get(..2)?;
    let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'A'..=b'F');
    digits.bytes().all(is_digit).then(|| u8::from_str_radix(digits, 16).ok()).flatten()
}

fn replaced<'t>(
    text: &'t str,
    is_replaced: impl Fn(char) -> bool,
    replace: impl Fn(&mut String, char),
) -> Cow<'t, str> {
    let Some(first) = text.find(&is_replaced) else { return Cow::Borrowed(text) };
    let mut out = String::with_capacity(text.len() + 16);
    out.push_str(&text[..first]);
    for character in text[first..].chars() {
        match is_replaced(character) {
            true => replace(&mut out, character),
            false => out.push(character),
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    /// Names with characters of each hidden kind.
    const HOSTILE: [&str; 18] = [
        "R\u{1b}]0;x\u{7}01",
        "R\n01",
        "R\r01",
        "R\t01",
        "R\u{7f}01",
        "R\u{9b}2J",
        "R\u{202e}10",
        "R\u{2066}10\u{2069}",
        "R\u{61c}01",
        "R\u{200f}01",
        "R\u{200b}01",
        "R\u{feff}01",
        "R\u{2028}01",
        "R\u{ad}01",
        "R\u{fdd0}01",
        "R\u{ffff}01",
        "R\u{e0041}01",
        "R\0",
    ];

    /// Names that look like the escapes of others.
    const ALIKE: [&str; 8] =
        ["R\\n01", "R\\u{202e}10", "R\\u{5c}u{202e}10", "R%0A01", "R/01", "R%2F01", "R\\xE9", "C:\\new\\R01"];

    #[test]
    fn nothing_hidden_is_left_and_ordinary_text_stays() {
        for text in HOSTILE {
            for safe in [shown(text), distinct(text), percent(text, &[]), xml(text).into(), json(text)] {
                let is_left = |c: char| is_hidden(c) && !c.is_ascii();
                assert!(!safe.contains(is_left), "{safe:?}");
            }
            assert!(!shown(text).contains(is_hidden), "{text:?}");
            assert_eq!(shown(&shown(text)), shown(text));
        }
        for text in
            ["", "R01", "Süd", "Su\u{308}d", "架台 3", "\u{5d0}\u{5d1}", "C:\\exports\\R01.csv", "a\u{a0}b"]
        {
            for safe in [shown(text), distinct(text), json(text), percent(text, &['/'])] {
                assert_eq!(safe, text);
            }
        }
        assert_eq!(shown("a\nb\u{1b}[2J\u{202e}ü"), "a\\nb\\u{1b}[2J\\u{202e}ü");
        assert_eq!(shown_lines("a\n\tb\r\u{200b}"), "a\n\tb\\r\\u{200b}");
        assert_eq!(xml("<\u{1b}\u{202e}&\"\n"), "&lt;\\u{1b}\\u{202e}&amp;&quot;\n");
        assert_eq!(percent("Hall 3/R+1#\n%", &['/', '+', '#']), "Hall 3%2FR%2B1%23%0A%25");
    }

    #[test]
    fn names_that_identify_stay_different() {
        let names: Vec<&str> = HOSTILE.into_iter().chain(ALIKE).collect();
        let visible: HashSet<Cow<'_, str>> = names.iter().map(|name| distinct(name)).collect();
        let bytes: HashSet<Cow<'_, str>> = names.iter().map(|name| percent(name, &['/'])).collect();
        assert_eq!((visible.len(), bytes.len()), (names.len(), names.len()), "{visible:?}\n{bytes:?}");
    }

    #[test]
    fn json_says_the_same() {
        for text in HOSTILE.into_iter().chain(ALIKE) {
            // as written by a writer of JSON
            let written: String = text
                .chars()
                .map(|c| match c {
                    '\\' => "\\\\".to_owned(),
                    c if c < ' ' => format!("\\u{:04x}", u32::from(c)),
                    c => c.to_string(),
                })
                .collect();
            let escaped = json(&written);
            let units: Vec<u16> = escaped
                .replace("\\\\", "\\u005c")
                .split("\\u")
                .enumerate()
                .flat_map(|(place, part)| match place {
                    0 => part.encode_utf16().collect::<Vec<u16>>(),
                    _ => {
                        let unit = u16::from_str_radix(&part[..4], 16).expect("four digits");
                        std::iter::once(unit).chain(part[4..].encode_utf16()).collect()
                    }
                })
                .collect();
            assert_eq!(String::from_utf16(&units).expect("text"), text);
        }
    }

    #[test]
    fn bytes_that_are_no_text_stay_different_and_come_back() {
        let names: [&[u8]; 12] = [
            b"lat\xe9in",
            b"lat\xe8in",
            b"lat\\xE9in",
            b"lat\\x5CxE9in",
            b"lat\\\xe9in",
            b"lat\\xe9in",
            b"lat\\",
            b"lat\\x",
            "lat\u{fffd}in".as_bytes(),
            "latéin".as_bytes(),
            b"\xed\xa0\x80",
            b"a\xf0\x9f\x98/b",
        ];
        let texts: HashSet<String> = names.iter().map(|name| of_bytes(name)).collect();
        assert_eq!(texts.len(), names.len());
        for name in names {
            assert_eq!(to_bytes(&of_bytes(name)), name);
        }
        assert_eq!(of_bytes(b"/in/lat\xe9in.csv"), "/in/lat\\xE9in.csv");
        assert_eq!(of_bytes(b"C:\\new\\x.csv"), "C:\\new\\x.csv");
    }
}
