//! `[serve]`: the HTTP side of the daemon.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use super::toml::range::Limits;
use super::toml::table::{Table, Value};

const DEFAULT_LISTEN: &str = "127.0.0.1:8650";
const DEFAULT_SPOOL: &str = "spool";
const DEFAULT_MAX_BYTES: u64 = 4 << 30;
const DEFAULT_UPLOADS_AT_ONCE: usize = 4;
const DEFAULT_IDLE_TIMEOUT_S: f64 = 30.0;

/// Most uploads at once: each holds an open file, a thread and some hundred kilobytes.
const MAX_UPLOADS_AT_ONCE: i64 = 256;

/// Largest valid upload limit and reserve, 1 TiB: a bound against a mistyped number.
const MAX_BYTES: i64 = 1 << 40;

/// Default requests per second of one client.
const DEFAULT_REQUESTS_PER_S: f64 = 50.0;

/// Default limit on the total time of an upload, min.
const DEFAULT_TOTAL_TIMEOUT_MIN: f64 = 720.0;

armwatch_model::named_enum! {
    /// Permission of a token. Each also lets a client read its own session.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub enum Scope {
        /// Read stored data.
        Read = "read",
        /// Answer alarms, enter maintenance, request that exports are read again.
        Act = "act",
        /// Send exports, and query their outcomes.
        Upload = "upload",
    }
}

/// A token in addition to that of `token_file`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenSettings {
    /// Its name in refusals and in the log.
    pub name: String,
    /// File that contains it.
    pub file: PathBuf,
    /// Its permissions, each once.
    pub scopes: Vec<Scope>,
}

/// Clients that may use HTTP, and their limits.
#[derive(Debug, Clone, PartialEq)]
pub struct ClientSettings {
    /// Tokens with scopes; that of `token_file` may do everything.
    pub tokens: Vec<TokenSettings>,
    /// Requests per second of one client, which is an IPv4 address or an IPv6 /64; 0 is no limit.
    pub requests_per_s: f64,
}

impl Default for ClientSettings {
    fn default() -> Self {
        Self { tokens: Vec::new(), requests_per_s: DEFAULT_REQUESTS_PER_S }
    }
}

/// Settings of the HTTP server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServeSettings {
    /// Address to listen on.
    pub listen: SocketAddr,
    /// File with the token that clients must know; without it, the environment may give one.
    pub token_file: Option<PathBuf>,
    /// Address of the dashboard for browsers, such as `https://plant.example/armwatch/`, if a proxy gives it another
    /// one than `listen`; it ends with a slash.
    pub public_url: Option<String>,
    /// Addresses of reverse proxies whose `X-Forwarded-For` identifies the client of a request.
    pub trusted_proxies: Vec<IpAddr>,
    /// TLS of its own, if it has a certificate.
    pub tls: Option<TlsSettings>,
    /// Uploads, where they are taken.
    pub upload: Option<UploadSettings>,
}

/// Files for TLS, in PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsSettings {
    /// Certificate of the server, followed by those of its authorities.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

/// How exports are taken over HTTP.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UploadSettings {
    /// Folder of uploads; it is watched like the others.
    pub spool: PathBuf,
    /// Largest upload, bytes.
    pub max_bytes: u64,
    /// Most uploads at once.
    pub at_once: usize,
    /// Longest time that a client may send almost nothing.
    pub idle_timeout: Duration,
    /// Longest total time of one request.
    pub total_timeout: Duration,
    /// Bytes that uploads leave free on the disks of the spool and the database; `None`: 5 % of each disk, at most 1
    /// GiB.
    pub reserve_bytes: Option<u64>,
    /// True if exports are accepted whose name gives no robot of the configuration.
    pub unknown_robots: bool,
}

/// Reads `[serve]`; outer `None` after a problem, the server's part `None` without the section.
pub(super) fn read_serve(table: Option<&Table<'_>>) -> Option<(Option<ServeSettings>, ClientSettings)> {
    let Some(table) = table else { return Some((None, ClientSettings::default())) };
    let requests = Limits::between(0.0, 100_000.0, "1/s");
    let requests_per_s = table.number_or("requests_per_s", &requests, DEFAULT_REQUESTS_PER_S);
    let tokens = match table.optional("token") {
        Some(value) => read_tokens(&value),
        None => Some(Vec::new()),
    };
    let listen = match table.optional("listen") {
        Some(value) => read_address(&value),
        None => DEFAULT_LISTEN.parse().ok(),
    };
    let token_file = table.text_or("token_file", "");
    let public_url = match table.optional("public_url") {
        Some(value) => read_public_url(&value).map(Some),
        None => Some(None),
    };
    let trusted_proxies = match table.optional("trusted_proxies") {
        Some(value) => read_proxies(&value),
        None => Some(Vec::new()),
    };
    let upload = match table.table("upload") {
        Some(table) => read_upload(&table).map(Some),
        None => Some(None),
    };
    let tls = match table.table("tls") {
        Some(table) => read_tls(&table).map(Some),
        None => Some(None),
    };
    let token_file = token_file?;
    let token_file = (!token_file.is_empty()).then(|| PathBuf::from(token_file));
    let serve = ServeSettings {
        listen: listen?,
        token_file,
        public_url: public_url?,
        trusted_proxies: trusted_proxies?,
        tls: tls?,
        upload: upload?,
    };
    Some((Some(serve), ClientSettings { tokens: tokens?, requests_per_s: requests_per_s? }))
}

fn read_tokens(value: &Value<'_>) -> Option<Vec<TokenSettings>> {
    let mut names: Vec<String> = Vec::new();
    let read = |section: Value<'_>| {
        let table = section.table()?;
        let name = table.text("name").map(str::to_owned);
        let file = table.text("file").map(PathBuf::from);
        let scopes = table.required("scopes").and_then(|value| read_scopes(&value));
        if let Some(name) = &name {
            if names.contains(name) {
                section.refuse(
                    format!("two tokens have the name \"{name}\""),
                    Some("give each its own name".into()),
                );
                return None;
            }
            names.push(name.clone());
        }
        Some(TokenSettings { name: name?, file: file?, scopes: scopes? })
    };
    // collect all of them, so that every problem is reported
    value.sections()?.into_iter().map(read).collect::<Vec<_>>().into_iter().collect()
}

fn read_scopes(value: &Value<'_>) -> Option<Vec<Scope>> {
    let items = value.items()?;
    if items.is_empty() {
        value.refuse(
            "has no scope".into(),
            Some("write one or more of \"read\", \"act\" and \"upload\"".into()),
        );
        return None;
    }
    let read = |item: Value<'_>| {
        let text = item.text()?;
        let scope = Scope::ALL.into_iter().find(|scope| scope.name() == text);
        if scope.is_none() {
            item.refuse("is not a scope".into(), Some("write \"read\", \"act\" or \"upload\"".into()));
        }
        scope
    };
    let scopes: Option<Vec<Scope>> = items.into_iter().map(read).collect::<Vec<_>>().into_iter().collect();
    scopes.map(|mut scopes| {
        scopes.sort_unstable();
        scopes.dedup();
        scopes
    })
}

fn read_public_url(value: &Value<'_>) -> Option<String> {
    let text = value.text()?;
    let place = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
    let is_address = place.is_some_and(|place| {
        !place.is_empty()
            && !place.starts_with(['/', ':'])
            && place.bytes().all(|byte| byte.is_ascii_graphic() && !b"?#@\"\\<>".contains(&byte))
    });
    if !is_address {
        let hint = "write the address that people open, such as \"https://plant.example/armwatch/\"";
        value.refuse("is not the address of a page".into(), Some(hint.into()));
        return None;
    }
    Some(format!("{}/", text.trim_end_matches('/')))
}

fn read_proxies(value: &Value<'_>) -> Option<Vec<IpAddr>> {
    let read = |item: Value<'_>| {
        let address = item.text()?.parse().ok();
        if address.is_none() {
            item.refuse(
                "is not an IP address".into(),
                Some("write such as \"127.0.0.1\" or \"fd00::7\"".into()),
            );
        }
        address
    };
    value.items()?.into_iter().map(read).collect::<Vec<_>>().into_iter().collect()
}

fn read_tls(table: &Table<'_>) -> Option<TlsSettings> {
    let certificate = table.text("certificate").map(PathBuf::from);
    let key = table.text("key").map(PathBuf::from);
    Some(TlsSettings { certificate: certificate?, key: key? })
}

fn read_address(value: &Value<'_>) -> Option<SocketAddr> {
    let address = value.text()?.parse().ok();
    if address.is_none() {
        let hint = format!("write a number and a port, such as \"{DEFAULT_LISTEN}\" or \"0.0.0.0:8650\"");
        value.refuse("is not a listening address".into(), Some(hint));
    }
    address
}

fn read_upload(table: &Table<'_>) -> Option<UploadSettings> {
    let spool = table.text_or("spool", DEFAULT_SPOOL);
    let max_bytes = match table.optional("max_bytes") {
        Some(value) => value.integer(1..=MAX_BYTES).and_then(|bytes| u64::try_from(bytes).ok()),
        None => Some(DEFAULT_MAX_BYTES),
    };
    let at_once = match table.optional("uploads_at_once") {
        Some(value) => value.integer(1..=MAX_UPLOADS_AT_ONCE).and_then(|n| usize::try_from(n).ok()),
        None => Some(DEFAULT_UPLOADS_AT_ONCE),
    };
    let idle = table.number_or("idle_timeout_s", &Limits::between(1.0, 3600.0, "s"), DEFAULT_IDLE_TIMEOUT_S);
    let total = Limits::between(1.0, 14_400.0, "min");
    let total = table.number_or("total_timeout_min", &total, DEFAULT_TOTAL_TIMEOUT_MIN);
    let reserve_bytes = match table.optional("reserve_bytes") {
        Some(value) => value.integer(0..=MAX_BYTES).and_then(|bytes| u64::try_from(bytes).ok()).map(Some),
        None => Some(None),
    };
    let unknown_robots = match table.optional("unknown_robots") {
        Some(value) => read_choice(&value),
        None => Some(false),
    };
    Some(UploadSettings {
        spool: PathBuf::from(spool?),
        max_bytes: max_bytes?,
        at_once: at_once?,
        idle_timeout: Duration::try_from_secs_f64(idle?).ok()?,
        total_timeout: Duration::try_from_secs_f64(60.0 * total?).ok()?,
        reserve_bytes: reserve_bytes?,
        unknown_robots: unknown_robots?,
    })
}

fn read_choice(value: &Value<'_>) -> Option<bool> {
    match value.text()? {
        "refuse" => Some(false),
        "take" => Some(true),
        _ => {
            let hint = "write \"refuse\" or \"take\"; with \"take\", unrecognised files are quarantined";
            value.refuse("is not a valid choice".into(), Some(hint.into()));
            None
        }
    }
}
