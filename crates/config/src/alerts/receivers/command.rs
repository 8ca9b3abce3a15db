//! `[alerts.route.command]`: a program.

use std::time::Duration;

use super::ReceiverKind;
use super::shared::read_timeout;
use crate::alerts::values::texts;
use crate::toml::table::Table;

/// A program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandSettings {
    /// The program and its arguments; no shell.
    pub arguments: Vec<String>,
    /// Time after which it is killed.
    pub timeout: Duration,
}

impl ReceiverKind for CommandSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let hint = || {
            Some("write the program and its arguments, such as [\"/usr/local/bin/page\", \"shift\"]".into())
        };
        let arguments = table.required_or_else("run", hint).and_then(|value| texts(&value));
        let timeout = read_timeout(table);
        Some(Self { arguments: arguments?, timeout: timeout? })
    }

    fn target(&self) -> String {
        self.arguments.first().cloned().unwrap_or_default()
    }
}
