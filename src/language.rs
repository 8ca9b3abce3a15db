//! Messages in the languages of people. The text in the code is English and a key of the tables in `language/`, which
//! pages, messages of alarms and reports share. `{0}` is the first value; `|` separates the forms for one and for more.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::LazyLock;

use serde_json::{Map, Value};

pub use armwatch_config::Language;

/// Texts by their English form.
struct Texts {
    /// Translations, in the order of [`Language::ALL`] without English.
    rows: HashMap<&'static str, Vec<&'static str>>,
    /// Keys with values, the one with most own text first: it says most about a text that it fits. Only pages choose
    /// between forms for one and for more.
    patterns: Vec<&'static str>,
}

/// Texts of pages, messages and reports.
const FILE: &str = include_str!("language/messages.tsv");

/// Clauses of the messages of detectors, which `crates/method` writes in English. Pages receive them translated.
const FINDINGS_FILE: &str = include_str!("language/findings.tsv");

/// A key with fewer letters and less text besides its values would fit too many texts, so it fits numbers only.
const FEWEST_LETTERS: usize = 4;
const LEAST_OWN_TEXT: usize = 8;

static MESSAGES: LazyLock<Texts> = LazyLock::new(|| Texts::of(FILE));
static FINDINGS: LazyLock<Texts> = LazyLock::new(|| {
    let mut texts = Texts::of(FINDINGS_FILE);
    // a key that begins with a value would take the beginning of another clause for it
    texts.patterns.sort_by_key(|key| key.starts_with('{'));
    texts
});

fn rows(file: &'static str) -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    file.lines().skip(1).filter_map(|line| {
        let mut cells = line.split('\t');
        Some((cells.next()?, cells.collect()))
    })
}

fn own_text(key: &str) -> usize {
    key.split(['{', '}']).step_by(2).map(str::len).sum()
}

impl Texts {
    fn of(file: &'static str) -> Self {
        let is_pattern =
            |key: &str, row: &[&str]| key.contains("{0}") && !row.iter().any(|text| text.contains('|'));
        let mut patterns: Vec<&str> =
            rows(file).filter(|(key, row)| is_pattern(key, row)).map(|(key, _)| key).collect();
        patterns.sort_by_key(|key| (std::cmp::Reverse(own_text(key)), *key));
        Self { rows: rows(file).collect(), patterns }
    }

    /// The translation of a key; `None` in English and for a text that is no key.
    fn translation(&self, language: Language, english: &str) -> Option<&'static str> {
        let column = Language::ALL.iter().position(|of| *of == language)?.checked_sub(1)?;
        self.rows.get(english)?.get(column).copied()
    }

    /// The translation of a key, or of a key with values in it; `None` for other texts, such as names.
    fn fitting(&self, language: Language, english: &str) -> Option<Cow<'static, str>> {
        if let Some(known) = self.translation(language, english) {
            return Some(known.into());
        }
        let (key, values) = self.patterns.iter().find_map(|key| Some((*key, values_in(english, key)?)))?;
        let value = |value| match self.fitting(language, value) {
            Some(known) => known.into_owned(),
            None if value.contains(char::is_alphabetic) => value.to_owned(),
            None => number(language, value.to_owned()),
        };
        let values: Vec<String> = values.into_iter().map(value).collect();
        let values: Vec<&str> = values.iter().map(AsRef::as_ref).collect();
        Some(filled(self.translation(language, key)?, &values).into())
    }
}

/// A message with its values.
pub fn say(language: Language, english: &str, values: &[&str]) -> String {
    debug_assert!(
        language == Language::English || MESSAGES.rows.contains_key(english),
        "{english} is not in the table"
    );
    filled(MESSAGES.translation(language, english).unwrap_or(english), values)
}

/// A text that was written in English, in another language: a key, or a key with values in it. Other texts, such as
/// names, stay as they are.
pub fn translated(language: Language, english: &str) -> Cow<'_, str> {
    if language == Language::English {
        return english.into();
    }
    MESSAGES.fitting(language, english).unwrap_or(Cow::Borrowed(english))
}

/// The message of a detector, or the reason for a status, in a language. A clause that is not in the table stays in
/// English, such as the reason for a refused cycle.
pub fn finding(language: Language, message: &str) -> Cow<'_, str> {
    if language == Language::English {
        return message.into();
    }
    let joint = message.split_once(": ").filter(|(place, _)| {
        place.strip_prefix("joint ").is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
    });
    let (place, rest) = joint.map_or((None, message), |(place, rest)| (Some(place), rest));
    let clause = |clause| FINDINGS.fitting(language, clause).unwrap_or(Cow::Borrowed(clause));
    let said = clauses(rest).into_iter().map(clause).collect::<Vec<_>>().join("; ");
    match place {
        Some(place) => format!("{}: {said}", translated(language, place)).into(),
        None => said.into(),
    }
}

/// The clauses of a message of a detector: the finding, then values and advice. A semicolon inside brackets separates
/// nothing.
pub fn clauses(message: &str) -> Vec<&str> {
    let (mut found, mut start, mut depth) = (Vec::new(), 0, 0_i32);
    for (place, letter) in message.char_indices() {
        match letter {
            '(' => depth += 1,
            ')' => depth -= 1,
            ';' if depth <= 0 && place >= start => {
                found.push(&message[start..place]);
                start = place + 1 + usize::from(message[place + 1..].starts_with(' '));
            }
            _ => {}
        }
    }
    found.push(&message[start..]);
    found
}

/// The values with which a key is a text; `None` if the key does not fit.
fn values_in<'t>(text: &'t str, key: &str) -> Option<Vec<&'t str>> {
    let mut pieces = key.split(['{', '}']).step_by(2);
    let mut rest = text.strip_prefix(pieces.next()?)?;
    let mut pieces = pieces.peekable();
    let mut values = Vec::new();
    while let Some(piece) = pieces.next() {
        let end = match pieces.peek() {
            None if piece.is_empty() => rest.len(),
            None => rest.len().checked_sub(piece.len()).filter(|end| rest.ends_with(piece) && *end > 0)?,
            Some(_) => rest.find(piece)?,
        };
        values.push(&rest[..end]);
        rest = &rest[end + piece.len()..];
    }
    let letters = key.chars().filter(|letter| letter.is_alphabetic()).count();
    let is_clear = letters >= FEWEST_LETTERS || own_text(key) >= LEAST_OWN_TEXT;
    (is_clear || values.iter().all(|value| value.parse::<f64>().is_ok())).then_some(values)
}

fn filled(text: &str, values: &[&str]) -> String {
    let mut pieces = text.split(['{', '}']);
    let mut filled = pieces.next().unwrap_or_default().to_owned();
    while let (Some(place), Some(piece)) = (pieces.next(), pieces.next()) {
        let value = place.parse().ok().and_then(|place: usize| values.get(place));
        filled.extend([value.copied().unwrap_or_default(), piece]);
    }
    filled
}

/// A number for people: in Italian and German with a decimal comma.
pub fn number(language: Language, text: String) -> String {
    match language {
        Language::Italian | Language::German => text.replace('.', ","),
        Language::English | Language::Chinese => text,
    }
}

/// The messages of a language for pages, as a JavaScript module; `None` for English, which needs none.
pub fn module(language: Language) -> Option<String> {
    let column = Language::ALL.iter().position(|of| *of == language)?.checked_sub(1)?;
    let messages: Map<String, Value> =
        rows(FILE).filter_map(|(key, row)| Some((key.to_owned(), Value::from(*row.get(column)?)))).collect();
    Some(format!("export default {};\n", Value::Object(messages)))
}

#[cfg(test)]
mod tests;
