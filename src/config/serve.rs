//! `[serve]`: the HTTP side of the daemon.

use std::net::SocketAddr;
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

/// Largest upload that may be allowed, 1 TiB: a bound against a mistyped number.
const MAX_MAX_BYTES: i64 = 1 << 40;

/// What the daemon serves over HTTP.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServeSettings {
    /// Address to listen on.
    pub listen: SocketAddr,
    /// File with the token that clients must know; without it, the environment may give one.
    pub token_file: Option<PathBuf>,
    /// Uploads, where they are taken.
    pub upload: Option<UploadSettings>,
}

/// How exports are taken over HTTP.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UploadSettings {
    /// Folder that uploads go to; it is watched as the others are.
    pub spool: PathBuf,
    /// Largest upload, bytes.
    pub max_bytes: u64,
    /// Most uploads at once.
    pub at_once: usize,
    /// How long a client may send next to nothing.
    pub idle_timeout: Duration,
    /// Whether exports are taken whose name says no robot of the configuration.
    pub unknown_robots: bool,
}

/// Reads `[serve]`; outer `None` after a problem, inner without the section.
pub(super) fn read_serve(table: Option<&Table<'_>>) -> Option<Option<ServeSettings>> {
    let Some(table) = table else { return Some(None) };
    let listen = match table.optional("listen") {
        Some(value) => read_address(&value),
        None => DEFAULT_LISTEN.parse().ok(),
    };
    let token_file = table.text_or("token_file", "");
    let upload = match table.table("upload") {
        Some(table) => read_upload(&table).map(Some),
        None => Some(None),
    };
    let token_file = token_file?;
    let token_file = (!token_file.is_empty()).then(|| PathBuf::from(token_file));
    Some(Some(ServeSettings { listen: listen?, token_file, upload: upload? }))
}

fn read_address(value: &Value<'_>) -> Option<SocketAddr> {
    let address = value.text()?.parse().ok();
    if address.is_none() {
        let hint = format!("write a number and a port, such as \"{DEFAULT_LISTEN}\" or \"0.0.0.0:8650\"");
        value.refuse("is no address to listen on".into(), Some(hint));
    }
    address
}

fn read_upload(table: &Table<'_>) -> Option<UploadSettings> {
    let spool = table.text_or("spool", DEFAULT_SPOOL);
    let max_bytes = match table.optional("max_bytes") {
        Some(value) => value.integer(1..=MAX_MAX_BYTES).and_then(|bytes| u64::try_from(bytes).ok()),
        None => Some(DEFAULT_MAX_BYTES),
    };
    let at_once = match table.optional("uploads_at_once") {
        Some(value) => value.integer(1..=MAX_UPLOADS_AT_ONCE).and_then(|n| usize::try_from(n).ok()),
        None => Some(DEFAULT_UPLOADS_AT_ONCE),
    };
    let idle = table.number_or("idle_timeout_s", &Limits::between(1.0, 3600.0, "s"), DEFAULT_IDLE_TIMEOUT_S);
    let unknown_robots = match table.optional("unknown_robots") {
        Some(value) => read_choice(&value),
        None => Some(false),
    };
    Some(UploadSettings {
        spool: PathBuf::from(spool?),
        max_bytes: max_bytes?,
        at_once: at_once?,
        idle_timeout: Duration::try_from_secs_f64(idle?).ok()?,
        unknown_robots: unknown_robots?,
    })
}

fn read_choice(value: &Value<'_>) -> Option<bool> {
    match value.text()? {
        "refuse" => Some(false),
        "take" => Some(true),
        _ => {
            let hint = "write \"refuse\" or \"take\"; what is taken and not recognised is quarantined";
            value.refuse("is no choice".into(), Some(hint.into()));
            None
        }
    }
}
