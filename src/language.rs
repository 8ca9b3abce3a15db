//! Messages in the languages of people. The text in the code is English and the key of `language/messages.tsv`, which
//! pages, messages of alarms and reports share. `{0}` is the first value; `|` separates the forms for one and for more.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::LazyLock;

use serde_json::{Map, Value};

pub use armwatch_config::Language;

const FILE: &str = include_str!("language/messages.tsv");

/// A key with fewer letters besides its values would fit too many texts, so it fits numbers only.
const FEWEST_LETTERS: usize = 4;

/// Translations by English text, in the order of [`Language::ALL`] without English.
static TABLE: LazyLock<HashMap<&str, Vec<&str>>> = LazyLock::new(|| rows().collect());

/// Keys with values, the one with most own text first: it says most about a text that it fits. Only pages choose between
/// forms for one and for more.
static PATTERNS: LazyLock<Vec<&str>> = LazyLock::new(|| {
    let is_pattern =
        |key: &str, row: &[&str]| key.contains("{0}") && !row.iter().any(|text| text.contains('|'));
    let mut keys: Vec<&str> = rows().filter(|(key, row)| is_pattern(key, row)).map(|(key, _)| key).collect();
    let own = |key: &str| key.split(['{', '}']).step_by(2).map(str::len).sum::<usize>();
    keys.sort_by_key(|key| (std::cmp::Reverse(own(key)), *key));
    keys
});

fn rows() -> impl Iterator<Item = (&'static str, Vec<&'static str>)> {
    FILE.lines().skip(1).filter_map(|line| {
        let mut cells = line.split('\t');
        Some((cells.next()?, cells.collect()))
    })
}

/// The translation of a key; `None` in English and for a text that is no key.
fn translation(language: Language, english: &str) -> Option<&'static str> {
    let column = Language::ALL.iter().position(|of| *of == language)?.checked_sub(1)?;
    TABLE.get(english)?.get(column).copied()
}

/// A message with its values.
#[must_use]
pub fn say(language: Language, english: &str, values: &[&str]) -> String {
    debug_assert!(
        language == Language::English || TABLE.contains_key(english),
        "{english} is not in the table"
    );
    filled(translation(language, english).unwrap_or(english), values)
}

/// A text that was written in English, in another language: a key, or a key with values in it. Other texts, such as
/// names, stay as they are.
#[must_use]
pub fn translated(language: Language, english: &str) -> Cow<'_, str> {
    if language == Language::English {
        return english.into();
    }
    if let Some(known) = translation(language, english) {
        return known.into();
    }
    let fitting = PATTERNS.iter().find_map(|key| Some((*key, values_in(english, key)?)));
    let Some((key, values)) = fitting else { return english.into() };
    let values: Vec<Cow<'_, str>> = values.into_iter().map(|value| translated(language, value)).collect();
    let values: Vec<&str> = values.iter().map(AsRef::as_ref).collect();
    say(language, key, &values).into()
}

/// The values with which a key is a text; `None` if the key does not fit.
fn values_in<'t>(text: &'t str, key: &str) -> Option<Vec<&'t str>> {
    let letters = key.chars().filter(|letter| letter.is_alphabetic()).count();
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
    let fits = letters >= FEWEST_LETTERS || values.iter().all(|value| value.parse::<f64>().is_ok());
    fits.then_some(values)
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
#[must_use]
pub fn number(language: Language, text: String) -> String {
    match language {
        Language::Italian | Language::German => text.replace('.', ","),
        Language::English | Language::Chinese => text,
    }
}

/// The messages of a language for pages, as a JavaScript module; `None` for English, which needs none.
#[must_use]
pub fn module(language: Language) -> Option<String> {
    let column = Language::ALL.iter().position(|of| *of == language)?.checked_sub(1)?;
    let messages: Map<String, Value> =
        rows().filter_map(|(key, row)| Some((key.to_owned(), Value::from(*row.get(column)?)))).collect();
    Some(format!("export default {};\n", Value::Object(messages)))
}

#[cfg(test)]
mod tests;
