//! Values shared by several receivers.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use crate::alerts::values::given;
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};

const DEFAULT_TIMEOUT_S: f64 = 30.0;

/// Place of a secret, which is not in the configuration itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Secret {
    /// A file; its first line.
    File(PathBuf),
    /// A variable of the environment.
    Environment(String),
}

impl fmt::Display for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "the file {}", path.display()),
            Self::Environment(name) => write!(f, "the environment variable {name}"),
        }
    }
}

/// An address. Some are secret, because anyone who knows them can write.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// The address itself.
    Plain(String),
    /// Kept elsewhere.
    Secret(Secret),
}

/// Login to an HTTP server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum HttpLogin {
    /// No login.
    None,
    /// A bearer token.
    Bearer(Secret),
    /// User and password, RFC 7617.
    Basic {
        /// The user.
        user: String,
        /// The password.
        password: Secret,
    },
}

impl HttpLogin {
    /// The secret that it needs.
    pub(super) fn secret(&self) -> Option<&Secret> {
        match self {
            Self::None => None,
            Self::Bearer(secret) | Self::Basic { password: secret, .. } => Some(secret),
        }
    }
}

/// Encryption of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encryption {
    /// From the first byte on.
    Tls,
    /// After the server has offered it; refused without.
    StartTls,
    /// Not at all.
    None,
}

/// A server of mail or MQTT.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerSettings {
    /// Its name or address.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// Encryption of the connection.
    pub encryption: Encryption,
    /// User and password, if the server requires them.
    pub login: Option<(String, Secret)>,
    /// Trusted certificates, PEM: for a mail server in addition to the system's, for a broker instead of them.
    pub ca_file: Option<PathBuf>,
    /// Longest time for a message.
    pub timeout: Duration,
}

impl ServerSettings {
    /// Reads the keys that mail and MQTT share. `kinds` lists names, encryptions and usual ports; the first is the
    /// default.
    pub(super) fn read(table: &Table<'_>, kinds: &[(&str, Encryption, i64)]) -> Option<Self> {
        let host = table.text("host");
        let kind = match table.optional("encryption") {
            None => kinds.first(),
            Some(value) => value.text().and_then(|text| {
                let found = kinds.iter().find(|(name, ..)| *name == text);
                if found.is_none() {
                    let quoted: Vec<String> = kinds.iter().map(|(name, ..)| format!("\"{name}\"")).collect();
                    let hint = format!("write one of {}", quoted.join(", "));
                    value.refuse("is not known here".into(), Some(hint));
                }
                found
            }),
        };
        let port = match table.optional("port") {
            Some(value) => value.integer(1..=65_535),
            None => kind.map(|(_, _, port)| *port),
        };
        let (login, ca_file, timeout) = (read_login(table), read_path(table, "ca_file"), read_timeout(table));
        Some(Self {
            host: host?.to_owned(),
            port: u16::try_from(port?).ok()?,
            encryption: kind?.1,
            login: login?,
            ca_file: ca_file?,
            timeout: timeout?,
        })
    }
}

/// An address of HTTP without user and password, which are secret.
pub(super) fn read_url(value: &Value<'_>) -> Option<String> {
    let url = value.text()?;
    let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
    let Some(host) = rest.map(|rest| rest.split(['/', '?', '#']).next().unwrap_or_default()) else {
        value.refuse("is not an address".into(), Some("write http://host:port/path, or https://".into()));
        return None;
    };
    if host.contains('@') {
        let hint = "write user and password_file, or password_env, next to it";
        value.refuse_secret("contains a user or a password".into(), Some(hint.into()));
        return None;
    }
    if host.is_empty() || host.starts_with(':') {
        value.refuse("has no host".into(), None);
        return None;
    }
    Some(url.to_owned())
}

/// The secret of `NAME_file` or of the variable that `NAME_env` names.
pub(super) fn read_secret(table: &Table<'_>, name: &str) -> Option<Option<Secret>> {
    let (file, environment) = (format!("{name}_file"), format!("{name}_env"));
    if let Some(value) = table.optional(name) {
        let hint = format!("write {file} or {environment}, so that this file can be shown");
        value.refuse_secret("a secret must not be in the configuration".into(), Some(hint));
        return None;
    }
    let both = [table.optional(&file), table.optional(&environment)];
    if let [Some(_), Some(second)] = &both {
        second.refuse(format!("{file} is already given"), Some("keep one of them".into()));
        return None;
    }
    let [file, environment] = both;
    let file = file.map(|value| value.text().map(|path| Secret::File(path.into())));
    let environment = environment.map(|value| value.text().map(|name| Secret::Environment(name.to_owned())));
    given(file.or(environment))
}

pub(super) fn read_http_login(table: &Table<'_>) -> Option<HttpLogin> {
    let token = read_secret(table, "bearer_token");
    let login = read_login(table);
    match (token?, login?) {
        (Some(_), Some(_)) => {
            let hint = "keep one of them".to_owned();
            table.refuse("has a bearer token and a password".into(), Some(hint));
            None
        }
        (Some(token), None) => Some(HttpLogin::Bearer(token)),
        (None, Some((user, password))) => Some(HttpLogin::Basic { user, password }),
        (None, None) => Some(HttpLogin::None),
    }
}

/// User and password, or neither.
pub(super) fn read_login(table: &Table<'_>) -> Option<Option<(String, Secret)>> {
    let user = table.optional("user").map(|value| value.text().map(str::to_owned));
    let password = read_secret(table, "password");
    match (given(user)?, password?) {
        (Some(user), Some(password)) => Some(Some((user, password))),
        (None, None) => Some(None),
        (Some(_), None) => {
            let hint = "write password_file or password_env".to_owned();
            table.refuse("has a user but no password".into(), Some(hint));
            None
        }
        (None, Some(_)) => {
            table.refuse("has a password but no user".into(), Some("write user".into()));
            None
        }
    }
}

pub(super) fn read_path(table: &Table<'_>, key: &str) -> Option<Option<PathBuf>> {
    given(table.optional(key).map(|value| value.text().map(PathBuf::from)))
}

pub(super) fn read_timeout(table: &Table<'_>) -> Option<Duration> {
    read_seconds(table, "timeout_s", 0.1, DEFAULT_TIMEOUT_S)
}

pub(super) fn read_seconds(table: &Table<'_>, key: &str, least: f64, default: f64) -> Option<Duration> {
    let seconds = table.number_or(key, &Limits::between(least, 3600.0, "s"), default)?;
    Duration::try_from_secs_f64(seconds).ok()
}
