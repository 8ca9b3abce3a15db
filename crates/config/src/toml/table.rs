//! Typed reading of TOML that remembers the position of every value and continues after a mistake.
//!
//! A getter returns `None` after noting a problem, or notes a missing key; callers therefore read all keys first and
//! only then give up. Keys of a table that were never read are unknown keys.

use std::cell::RefCell;
use std::ops::{Range, RangeInclusive};

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::problem::{ConfigErrors, ConfigProblem};
use super::range::Limits;
use super::suggestion;

/// Longest value shown in a problem, in characters; a longer one is cut, so that each problem
/// stays one readable line.
const SHOWN_CHARACTERS: usize = 60;

/// Reads the document `text` with `read`, which gets the root table. The file's name is only used in problems.
///
/// # Errors
///
/// Every mistake of syntax, or otherwise every mistake that `read` found.
pub(crate) fn read_document<T>(
    file: &str,
    text: &str,
    read: impl FnOnce(&Table<'_>) -> Option<T>,
) -> Result<T, ConfigErrors> {
    let source = Document {
        file,
        text,
        problems: RefCell::default(),
        adopted: RefCell::default(),
        nothing: DeTable::new(),
    };
    let (root, syntax) = DeTable::parse_recoverable(text);
    for error in &syntax {
        source.note_syntax(error);
    }
    // A document with broken syntax would give misleading further mistakes.
    if !syntax.is_empty() {
        return Err(source.into_errors());
    }
    let value = read(&Table::new(&source, String::new(), 0..0, root.get_ref()));
    match value {
        Some(value) if source.problems.borrow().is_empty() && source.adopted.borrow().is_empty() => Ok(value),
        _ => Err(source.into_errors()),
    }
}

/// A document being read, with the problems found so far.
struct Document<'t> {
    file: &'t str,
    text: &'t str,
    problems: RefCell<Vec<ConfigProblem>>,
    /// Problems of other files that this one refers to.
    adopted: RefCell<Vec<ConfigProblem>>,
    /// Replaces missing tables.
    nothing: DeTable<'t>,
}

impl Document<'_> {
    fn note(
        &self,
        at: &Range<usize>,
        key: &str,
        value: Option<String>,
        problem: String,
        hint: Option<String>,
    ) {
        let (line, column) = self.position(at.start);
        self.problems.borrow_mut().push(ConfigProblem {
            file: self.file.to_owned(),
            line: Some(line),
            column: Some(column),
            key: key.to_owned(),
            value,
            problem,
            hint,
        });
    }

    fn note_syntax(&self, error: &toml::de::Error) {
        let at = error.span().unwrap_or(0..0);
        let (line, _) = self.position(at.start);
        // One mistake often breaks the rest of its line too; only the first message is right.
        if self.problems.borrow().iter().any(|p| p.line == Some(line)) {
            return;
        }
        let message = error.message().split_whitespace().collect::<Vec<_>>().join(" ");
        self.note(&at, "", None, format!("not valid TOML: {message}"), None);
    }

    /// Line and column, from 1, of a byte offset.
    fn position(&self, offset: usize) -> (usize, usize) {
        let before = self.text.get(..offset).unwrap_or(self.text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
        (line, column)
    }

    /// The text of the file at `at`, on one line and cut to a readable length.
    fn excerpt(&self, at: &Range<usize>) -> Option<String> {
        let words = self.text.get(at.clone())?.split_whitespace().collect::<Vec<_>>().join(" ");
        let mut shown: String = words.chars().take(SHOWN_CHARACTERS).collect();
        if shown.len() < words.len() {
            shown.push_str("...");
        }
        Some(shown)
    }

    fn into_errors(self) -> ConfigErrors {
        let mut problems = self.problems.into_inner();
        problems.sort_by_key(|p| (p.line, p.column));
        problems.extend(self.adopted.into_inner());
        if problems.is_empty() {
            // Only a reader that gives up without a word leads here; say what is known.
            return ConfigErrors::of_file(self.file, "could not be read".into(), None);
        }
        ConfigErrors(problems)
    }
}

/// A table of the document.
pub(crate) struct Table<'d> {
    source: &'d Document<'d>,
    path: String,
    at: Range<usize>,
    entries: &'d DeTable<'d>,
    asked: RefCell<Vec<String>>,
    /// Missing required keys, with their hints.
    missing: RefCell<Vec<(String, Option<String>)>>,
}

impl<'d> Table<'d> {
    fn new(source: &'d Document<'d>, path: String, at: Range<usize>, entries: &'d DeTable<'d>) -> Self {
        Self { source, path, at, entries, asked: RefCell::default(), missing: RefCell::default() }
    }

    /// An empty table instead of a missing one; problems are those of `parent`.
    pub fn empty(parent: &Table<'d>) -> Self {
        Table::new(parent.source, parent.path.clone(), parent.at.clone(), &parent.source.nothing)
    }

    /// The value of `key`, if given.
    pub fn optional(&self, key: &str) -> Option<Value<'d>> {
        self.asked.borrow_mut().push(key.to_owned());
        let node = self.entries.get(key)?;
        Some(Value { source: self.source, path: self.path_of(key), node })
    }

    /// The value of `key`, which must be given.
    pub fn required(&self, key: &str) -> Option<Value<'d>> {
        self.required_or_else(key, || None)
    }

    /// The value of `key`, which must be given; `hint` is shown if it is missing.
    pub fn required_or_else(&self, key: &str, hint: impl FnOnce() -> Option<String>) -> Option<Value<'d>> {
        let value = self.optional(key);
        if value.is_none() {
            self.missing.borrow_mut().push((key.to_owned(), hint()));
        }
        value
    }

    /// Required text.
    pub fn text(&self, key: &str) -> Option<&'d str> {
        self.required(key)?.text()
    }

    /// Required number.
    pub fn number(&self, key: &str, limits: &Limits) -> Option<f64> {
        self.required(key)?.number(limits)
    }

    /// Number with a default.
    pub fn number_or(&self, key: &str, limits: &Limits, default: f64) -> Option<f64> {
        self.optional(key).map_or(Some(default), |value| value.number(limits))
    }

    /// Text with a default.
    pub fn text_or(&self, key: &str, default: &'d str) -> Option<&'d str> {
        self.optional(key).map_or(Some(default), |value| value.text())
    }

    /// Required array of numbers, of a given length if known.
    pub fn numbers(&self, key: &str, length: Option<usize>, limits: &Limits) -> Option<Vec<f64>> {
        self.required(key)?.numbers(length, limits)
    }

    /// The one value given among `keys`, which name the same quantity in different units, and
    /// its position among them.
    pub fn one_of(&self, keys: &[&str]) -> Option<(usize, Value<'d>)> {
        let choice = self.at_most_one_of(keys);
        if choice.is_none() && !keys.iter().any(|key| self.entries.contains_key(*key)) {
            self.missing.borrow_mut().push((keys.join(" or "), None));
        }
        choice
    }

    /// Like [`Self::one_of`], but all keys may be missing.
    pub fn at_most_one_of(&self, keys: &[&str]) -> Option<(usize, Value<'d>)> {
        let mut given: Vec<_> =
            keys.iter().enumerate().filter_map(|(i, key)| Some((i, self.optional(key)?))).collect();
        if given.len() > 1 {
            let first = keys[given[0].0];
            for (_, value) in &given[1..] {
                value.refuse(
                    format!("the same quantity is already given as {first}"),
                    Some("keep one of them".into()),
                );
            }
            return None;
        }
        given.pop()
    }

    /// The table under `key`, if given.
    pub fn table(&self, key: &str) -> Option<Table<'d>> {
        self.optional(key)?.table()
    }

    /// Accepts every key of the table, even if it is never read.
    pub fn pass_over(&self) {
        self.asked.borrow_mut().extend(self.entries.iter().map(|(key, _)| key.get_ref().to_string()));
    }

    /// Notes a problem of the whole table.
    pub fn refuse(&self, problem: String, hint: Option<String>) {
        self.source.note(&self.at, &self.path, None, problem, hint);
    }

    /// Adds the problems of a file that this one refers to.
    pub fn adopt(&self, errors: ConfigErrors) {
        self.source.adopted.borrow_mut().extend(errors.0);
    }

    fn path_of(&self, key: &str) -> String {
        if self.path.is_empty() { key.to_owned() } else { format!("{}.{key}", self.path) }
    }

    /// Notes the keys that were never read; returns the keys that were probably meant.
    fn refuse_unknown(&self) -> Vec<String> {
        let asked = self.asked.borrow();
        let mut meant = Vec::new();
        for (key, _) in self.entries {
            if asked.iter().any(|known| known == key.get_ref()) {
                continue;
            }
            let free = asked.iter().map(String::as_str).filter(|known| !self.entries.contains_key(*known));
            let nearest = suggestion::nearest(key.get_ref(), free);
            let hint = match nearest {
                Some(known) => format!("did you mean {known}?"),
                None => format!("known here: {}", asked.join(", ")),
            };
            meant.extend(nearest.map(str::to_owned));
            self.source.note(
                &key.span(),
                &self.path_of(key.get_ref()),
                None,
                "unknown key".into(),
                Some(hint),
            );
        }
        meant
    }
}

/// All known keys have been read when a table is dropped. Checking here means that no table can omit the check.
impl Drop for Table<'_> {
    fn drop(&mut self) {
        let meant = self.refuse_unknown();
        for (key, hint) in self.missing.take() {
            // A misspelt key is one mistake, not an unknown one and a missing one.
            if !key.split(" or ").any(|key| meant.iter().any(|m| m == key)) {
                self.source.note(&self.at, &self.path_of(&key), None, "is missing".into(), hint);
            }
        }
    }
}

/// A value of the document.
pub(crate) struct Value<'d> {
    source: &'d Document<'d>,
    path: String,
    node: &'d Spanned<DeValue<'d>>,
}

impl<'d> Value<'d> {
    /// Returns true if this is an array.
    pub fn is_array(&self) -> bool {
        matches!(self.node.get_ref(), DeValue::Array(_))
    }

    /// Returns true if this is a whole number.
    pub fn is_integer(&self) -> bool {
        matches!(self.node.get_ref(), DeValue::Integer(_))
    }

    /// The text, if it is one; anything else is not noted as a problem.
    pub fn peek_text(&self) -> Option<&'d str> {
        match self.node.get_ref() {
            DeValue::String(text) => Some(text),
            _ => None,
        }
    }

    /// Text, which must not be empty.
    pub fn text(&self) -> Option<&'d str> {
        let text = self.any_text()?;
        if text.trim().is_empty() {
            self.refuse("must not be empty".into(), None);
            return None;
        }
        Some(text)
    }

    /// Text, which may be empty.
    pub fn any_text(&self) -> Option<&'d str> {
        match self.node.get_ref() {
            DeValue::String(text) => Some(text),
            _ => self.wrong_type("text in quotes"),
        }
    }

    /// A number within `limits`; whole numbers need no decimal point.
    pub fn number(&self, limits: &Limits) -> Option<f64> {
        self.number_or_hint(limits, |_| None)
    }

    /// A number within `limits`; one outside is refused with its hint.
    pub fn number_or_hint(&self, limits: &Limits, hint: impl FnOnce(f64) -> Option<String>) -> Option<f64> {
        let value: f64 = match self.node.get_ref() {
            DeValue::Float(number) => number.as_str().parse().ok(),
            DeValue::Integer(number) => whole(number.as_str(), number.radix()).map(|n| n as f64),
            _ => return self.wrong_type("a number"),
        }
        .unwrap_or(f64::NAN);
        if !limits.admit(value) {
            self.refuse(format!("must be {limits}"), hint(value));
            return None;
        }
        Some(value)
    }

    /// A whole number within `range`.
    pub fn integer(&self, range: RangeInclusive<i64>) -> Option<i64> {
        let DeValue::Integer(number) = self.node.get_ref() else {
            return self.wrong_type("a whole number");
        };
        match whole(number.as_str(), number.radix()).filter(|n| range.contains(n)) {
            Some(value) => Some(value),
            None => {
                self.refuse(format!("must be between {} and {}", range.start(), range.end()), None);
                None
            }
        }
    }

    /// `true` or `false`.
    pub fn boolean(&self) -> Option<bool> {
        match self.node.get_ref() {
            DeValue::Boolean(value) => Some(*value),
            _ => self.wrong_type("true or false"),
        }
    }

    /// The entries of an array.
    pub fn items(&self) -> Option<Vec<Value<'d>>> {
        match self.node.get_ref() {
            DeValue::Array(items) => Some(self.items_of(items)),
            _ => self.wrong_type("an array"),
        }
    }

    /// The entries of a list of sections, `[[key]]`.
    pub fn sections(&self) -> Option<Vec<Value<'d>>> {
        if let DeValue::Table(_) = self.node.get_ref() {
            let key = self.path.rsplit('.').next().unwrap_or_default();
            self.refuse(
                "is a single section, must be a list".into(),
                Some(format!("write [[{key}]] in double brackets")),
            );
            return None;
        }
        self.items()
    }

    /// An array of numbers, of a given length if known.
    pub fn numbers(&self, length: Option<usize>, limits: &Limits) -> Option<Vec<f64>> {
        let items = self.items()?;
        let numbers: Vec<_> = items.iter().map(|item| item.number(limits)).collect();
        if let Some(length) = length
            && items.len() != length
        {
            self.refuse(format!("has {} entries, must have {length}", items.len()), None);
            return None;
        }
        numbers.into_iter().collect()
    }

    /// A table.
    pub fn table(&self) -> Option<Table<'d>> {
        match self.node.get_ref() {
            DeValue::Table(entries) => {
                Some(Table::new(self.source, self.path.clone(), self.node.span(), entries))
            }
            _ => self.wrong_type("a table"),
        }
    }

    /// Notes a problem of this value.
    pub fn refuse(&self, problem: String, hint: Option<String>) {
        let at = self.node.span();
        let excerpt = self.source.excerpt(&at).filter(|_| !self.is_list_of_sections());
        self.source.note(&at, &self.path, excerpt, problem, hint);
    }

    /// Notes a problem of a value that must not be shown.
    pub fn refuse_secret(&self, problem: String, hint: Option<String>) {
        self.source.note(&self.node.span(), &self.path, None, problem, hint);
    }

    fn items_of(&self, items: &'d DeArray<'d>) -> Vec<Value<'d>> {
        let item = |(i, node)| Value { source: self.source, path: format!("{}[{}]", self.path, i + 1), node };
        items.iter().enumerate().map(item).collect()
    }

    /// Returns true if this is written as `[[key]]`; the file then has no value to show.
    fn is_list_of_sections(&self) -> bool {
        match self.node.get_ref() {
            DeValue::Array(items) => items.first().is_some_and(|item| {
                matches!(item.get_ref(), DeValue::Table(_)) && item.span().start <= self.node.span().start
            }),
            _ => false,
        }
    }

    fn wrong_type<T>(&self, wanted: &str) -> Option<T> {
        let given = match self.node.get_ref() {
            DeValue::String(_) => "text",
            DeValue::Integer(_) => "a whole number",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "true or false",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "an array",
            DeValue::Table(_) => "a table",
        };
        self.refuse(format!("is {given}, must be {wanted}"), None);
        None
    }
}

fn whole(digits: &str, radix: u32) -> Option<i64> {
    i64::from_str_radix(digits, radix).ok()
}
