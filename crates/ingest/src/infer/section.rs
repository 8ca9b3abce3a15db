//! Sections of a proposed layout and their keys.

use armwatch_model::text;

/// Part of a layout file.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Section {
    /// Name of the table; `None` for the start of the file.
    pub(super) title: Option<&'static str>,
    pub(super) comments: Vec<String>,
    pub(super) keys: Vec<TomlKey>,
}

/// A key with its value and the reason for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct TomlKey {
    pub(super) name: &'static str,
    /// In TOML notation.
    pub(super) value: String,
    pub(super) reasons: Vec<String>,
    /// Set if a person must decide; the key is then a comment.
    pub(super) question: Option<String>,
    /// The value is not an answer that can be tested.
    pub(super) is_open: bool,
}

impl TomlKey {
    pub(super) fn decided(name: &'static str, value: impl Into<String>) -> Self {
        Self { name, value: value.into(), reasons: Vec::new(), question: None, is_open: false }
    }

    pub(super) fn because(mut self, reason: &str) -> Self {
        self.reasons.push(reason.to_owned());
        self
    }

    /// Adds a question, with the value as the likely answer.
    pub(super) fn asked(mut self, question: &str) -> Self {
        self.question = Some(question.to_owned());
        self
    }

    /// Adds a question if there is one.
    pub(super) fn asked_if(self, question: Option<&String>) -> Self {
        match question {
            Some(question) => self.asked(question),
            None => self,
        }
    }

    /// Adds a question, with a value that only shows the form of an answer.
    pub(super) fn open(mut self, question: &str) -> Self {
        self.is_open = true;
        self.asked(question)
    }
}

/// Text in TOML notation.
pub(super) fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            '\t' => quoted.push_str("\\t"),
            c if text::is_hidden(c) => quoted.push_str(&format!("\\U{:08X}", u32::from(c))),
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}
