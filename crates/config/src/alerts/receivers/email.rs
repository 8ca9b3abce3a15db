//! `[alerts.route.email]`: mail by SMTP.

use std::path::PathBuf;
use std::time::Duration;

use super::Receiver;
use super::shared::{Encryption, Secret, read_encryption, read_login, read_path, read_port, read_timeout};
use crate::toml::table::{Table, Value};

/// Ports by encryption: `tls`, `starttls`, `none`.
const SMTP: (i64, i64, i64) = (465, 587, 25);

/// Mail.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EmailSettings {
    /// Server.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// How it is spoken to.
    pub encryption: Encryption,
    /// User and password, if the server requires them.
    pub login: Option<(String, Secret)>,
    /// Certificates, PEM, that are trusted in addition to the system's.
    pub ca_file: Option<PathBuf>,
    /// Sender, as `armwatch <armwatch@example.org>`.
    pub from: String,
    /// Receivers.
    pub to: Vec<String>,
    /// Longest time for a mail.
    pub timeout: Duration,
}

impl Receiver for EmailSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let host = table.text("host");
        let encryption = read_encryption(table, &["starttls", "tls", "none"]);
        let port = match encryption {
            Some(Encryption::Tls) => read_port(table, SMTP.0),
            Some(Encryption::None) => read_port(table, SMTP.2),
            _ => read_port(table, SMTP.1),
        };
        let login = read_login(table);
        let ca_file = read_path(table, "ca_file");
        let from = table.required("from").and_then(|value| mailbox(&value));
        let to = table.required("to").and_then(|value| {
            let items = value.items()?;
            if items.is_empty() {
                value.refuse("names nobody".into(), Some("name one address or more".into()));
                return None;
            }
            items.iter().map(mailbox).collect::<Vec<_>>().into_iter().collect::<Option<Vec<_>>>()
        });
        let timeout = read_timeout(table);
        Some(Self {
            host: host?.to_owned(),
            port: port?,
            encryption: encryption?,
            login: login?,
            ca_file: ca_file?,
            from: from?,
            to: to?,
            timeout: timeout?,
        })
    }

    fn target(&self) -> String {
        format!("{} by {}:{}", self.to.join(", "), self.host, self.port)
    }

    fn secrets(&self) -> Vec<&Secret> {
        self.login.iter().map(|(_, secret)| secret).collect()
    }
}

/// An address with `@`, alone or between angle brackets; the mail library judges the rest.
fn mailbox(value: &Value<'_>) -> Option<String> {
    let text = value.text()?.trim();
    let address = text.split_once('<').map_or(text, |(_, rest)| rest.trim_end_matches('>'));
    let is_sound = address
        .split_once('@')
        .is_some_and(|(user, host)| !user.is_empty() && !host.is_empty() && !host.contains('@'))
        && !address.contains(char::is_whitespace);
    if !is_sound {
        let hint = "write \"user@example.org\" or \"Name <user@example.org>\"";
        value.refuse("is no mail address".into(), Some(hint.into()));
    }
    is_sound.then(|| text.to_owned())
}
