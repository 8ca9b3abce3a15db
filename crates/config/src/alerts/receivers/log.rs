//! `[alerts.route.log]`: the log of the program.

use super::ReceiverKind;
use crate::toml::table::Table;

/// The log of the program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogSettings;

impl ReceiverKind for LogSettings {
    fn read(_: &Table<'_>) -> Option<Self> {
        Some(Self)
    }

    fn target(&self) -> String {
        "the log".into()
    }
}
