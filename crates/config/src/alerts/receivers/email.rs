//! `[alerts.route.email]`: mail by SMTP.

use super::ReceiverKind;
use super::shared::{Encryption, Secret, ServerSettings};
use crate::toml::table::{Table, Value};

/// Encryptions with their ports.
const SMTP: [(&str, Encryption, i64); 3] =
    [("starttls", Encryption::StartTls, 587), ("tls", Encryption::Tls, 465), ("none", Encryption::None, 25)];

/// Mail.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EmailSettings {
    /// Mail server.
    pub server: ServerSettings,
    /// Sender, such as `armwatch <armwatch@example.org>`.
    pub from: String,
    /// Receivers.
    pub to: Vec<String>,
}

impl ReceiverKind for EmailSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let server = ServerSettings::read(table, &SMTP);
        let from = table.required("from").and_then(|value| mailbox(&value));
        let to = table.required("to").and_then(|value| {
            let items = value.items()?;
            if items.is_empty() {
                value.refuse("names nobody".into(), Some("name one address or more".into()));
                return None;
            }
            items.iter().map(mailbox).collect::<Vec<_>>().into_iter().collect::<Option<Vec<_>>>()
        });
        Some(Self { server: server?, from: from?, to: to? })
    }

    fn target(&self) -> String {
        format!("{} by {}:{}", self.to.join(", "), self.server.host, self.server.port)
    }

    fn secrets(&self) -> Vec<&Secret> {
        self.server.login.iter().map(|(_, secret)| secret).collect()
    }
}

/// An address with `@`, alone or between angle brackets; the mail library checks the rest.
fn mailbox(value: &Value<'_>) -> Option<String> {
    let text = value.text()?.trim();
    let address = text.split_once('<').map_or(text, |(_, rest)| rest.trim_end_matches('>'));
    let is_sound = address
        .split_once('@')
        .is_some_and(|(user, host)| !user.is_empty() && !host.is_empty() && !host.contains('@'))
        && !address.contains(char::is_whitespace);
    if !is_sound {
        let hint = "write \"user@example.org\" or \"Name <user@example.org>\"";
        value.refuse("is not a mail address".into(), Some(hint.into()));
    }
    is_sound.then(|| text.to_owned())
}
