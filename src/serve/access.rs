//! Who may ask: a bearer token, or programs of this machine.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use axum::http::HeaderMap;
use axum::http::header::{AUTHORIZATION, HOST, ORIGIN};
use subtle::ConstantTimeEq;

use super::answer::Refusal;
use crate::config::ServeSettings;
use crate::ingest::bytes::fingerprint::of_bytes;
use crate::run::ContentHash;

/// Environment variable with the token, where the configuration names no file.
pub const TOKEN_VARIABLE: &str = "ARMWATCH_TOKEN";

/// Shortest token: 16 characters of base 64 are 96 bits.
const SHORTEST_TOKEN: usize = 16;

/// Longest token, and most that is read of its file.
const LONGEST_TOKEN: usize = 1024;

/// Why it is not settled who may ask.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// Other machines could ask, and there is no token.
    #[error(
        "serve.listen = \"{0}\" is reached from other machines and there is no token; give serve.token_file or the \
         environment variable {TOKEN_VARIABLE}, or listen on 127.0.0.1"
    )]
    Open(std::net::SocketAddr),
    /// The file cannot be read.
    #[error("serve.token_file: {file}: {detail}", file = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        detail: String,
    },
    /// The token is easily guessed, or cannot be sent.
    #[error(
        "the token in {0} must be one line of {SHORTEST_TOKEN} to {LONGEST_TOKEN} printable characters without \
         blanks; `openssl rand -hex 24` makes one"
    )]
    Token(String),
}

/// What a request must know.
pub struct Access {
    /// The token's hash: hashes are compared, so that time says nothing of a token, not even its length.
    token: Option<ContentHash>,
}

impl std::fmt::Debug for Access {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Access").field("token", &self.token.map(|_| "..")).finish()
    }
}

impl Access {
    /// Reads the token.
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn new(settings: &ServeSettings) -> Result<Self, AccessError> {
        let (token, place) = match &settings.token_file {
            Some(path) => (Some(read(path)?), path.display().to_string()),
            None => (std::env::var(TOKEN_VARIABLE).ok().filter(|t| !t.is_empty()), TOKEN_VARIABLE.to_owned()),
        };
        let Some(token) = token else {
            if settings.listen.ip().is_loopback() {
                return Ok(Self { token: None });
            }
            return Err(AccessError::Open(settings.listen));
        };
        let token = token.trim();
        let length = SHORTEST_TOKEN..=LONGEST_TOKEN;
        if !length.contains(&token.len()) || !token.bytes().all(|byte| byte.is_ascii_graphic()) {
            return Err(AccessError::Token(place));
        }
        Ok(Self { token: Some(of_bytes(token.as_bytes())) })
    }

    /// Whether a request may be answered.
    ///
    /// # Errors
    /// 401 without the token. Where there is none, 403 unless the request names this machine: a page in a
    /// browser could otherwise ask in its user's place.
    pub fn check(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        if !is_of_own_page(headers) {
            return Err(Refusal::of_other_page());
        }
        match &self.token {
            Some(token) if bearer(headers).is_some_and(|given| is_same(token, &of_bytes(given))) => Ok(()),
            Some(_) => Err(Refusal::unauthorized()),
            None if names_this_machine(headers) => Ok(()),
            None => Err(Refusal::forbidden()),
        }
    }

    /// Whether a request may change something: only with the token, also from this machine.
    ///
    /// # Errors
    /// 401 without the token, 403 where the daemon has none.
    pub fn check_action(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        self.check(headers)?;
        if self.needs_token() { Ok(()) } else { Err(Refusal::needs_token()) }
    }

    /// Whether a request needs the token.
    pub fn needs_token(&self) -> bool {
        self.token.is_some()
    }
}

fn read(path: &Path) -> Result<String, AccessError> {
    let failed = |detail: String| AccessError::File { path: path.to_owned(), detail };
    let file = File::open(path).map_err(|error| failed(error.to_string()))?;
    let mut text = String::new();
    let limit = LONGEST_TOKEN as u64 + 2;
    file.take(limit).read_to_string(&mut text).map_err(|error| failed(error.to_string()))?;
    Ok(text)
}

/// Warns of a token that other users of the machine may read.
pub fn warn_if_open(settings: &ServeSettings) {
    use std::os::unix::fs::PermissionsExt;
    const OTHERS: u32 = 0o077;
    let Some(path) = &settings.token_file else { return };
    if path.metadata().is_ok_and(|metadata| metadata.permissions().mode() & OTHERS != 0) {
        tracing::warn!(path = %path.display(), "other users may read the token; chmod 600 it");
    }
}

fn bearer(headers: &HeaderMap) -> Option<&[u8]> {
    let value = headers.get(AUTHORIZATION)?.as_bytes();
    let (scheme, token) = value.split_at_checked("bearer ".len())?;
    scheme.eq_ignore_ascii_case(b"bearer ").then(|| token.trim_ascii())
}

/// Whether two hashes are equal, in a time that does not depend on where they differ.
fn is_same(a: &ContentHash, b: &ContentHash) -> bool {
    a.0.ct_eq(&b.0).into()
}

/// Whether a request comes from no page, or from one of this server: a browser says where its page is from.
fn is_of_own_page(headers: &HeaderMap) -> bool {
    let Some(origin) = headers.get(ORIGIN) else { return true };
    let host = headers.get(HOST).and_then(|host| host.to_str().ok());
    let origin = origin.to_str().ok().and_then(|origin| origin.split_once("://"));
    origin.is_some_and(|(_, place)| host.is_some_and(|host| host.eq_ignore_ascii_case(place)))
}

fn names_this_machine(headers: &HeaderMap) -> bool {
    let Some(host) = headers.get(HOST).and_then(|host| host.to_str().ok()) else { return false };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.trim_start_matches('[').trim_end_matches(']').parse::<std::net::IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(listen: &str, token_file: Option<PathBuf>) -> ServeSettings {
        ServeSettings { listen: listen.parse().unwrap(), token_file, upload: None }
    }

    fn headers(name: &'static str, value: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(name, value.parse().unwrap());
        headers
    }

    #[test]
    fn the_token_and_nothing_like_it_opens() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        std::fs::write(&path, "0123456789abcdef0123\n").unwrap();
        let access = Access::new(&settings("0.0.0.0:0", Some(path))).unwrap();
        assert!(!format!("{access:?}").contains("0123"), "{access:?}");
        for good in ["Bearer 0123456789abcdef0123", "bearer  0123456789abcdef0123"] {
            assert!(access.check(&headers("authorization", good)).is_ok(), "{good}");
        }
        for bad in
            ["Bearer 0123456789abcdef012", "Bearer ", "Basic 0123456789abcdef0123", "0123456789abcdef0123"]
        {
            assert!(access.check(&headers("authorization", bad)).is_err(), "{bad}");
        }
        assert!(access.check(&headers("host", "localhost")).is_err());
    }

    #[test]
    fn a_short_a_broken_and_a_missing_token_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        for text in ["short", "0123456789abcdef 0123", "0123456789abcdef\nx", ""] {
            std::fs::write(&path, text).unwrap();
            let refused = Access::new(&settings("127.0.0.1:0", Some(path.clone())));
            assert!(matches!(refused, Err(AccessError::Token(_))), "{text:?}");
        }
        std::fs::remove_file(&path).unwrap();
        let refused = Access::new(&settings("127.0.0.1:0", Some(path)));
        assert!(matches!(refused, Err(AccessError::File { .. })));
    }

    #[test]
    fn what_changes_something_needs_a_token_and_no_other_page_asks() {
        let open = Access { token: None };
        let mut own = headers("host", "127.0.0.1:8650");
        assert!(open.check(&own).is_ok() && open.check_action(&own).is_err());
        own.insert("origin", "http://127.0.0.1:8650".parse().unwrap());
        assert!(open.check(&own).is_ok());
        for other in ["http://evil.example", "http://127.0.0.1:3000", "null"] {
            own.insert("origin", other.parse().unwrap());
            assert!(open.check(&own).is_err(), "{other}");
        }
        let closed = Access { token: Some(of_bytes(b"0123456789abcdef")) };
        let mut told = headers("authorization", "Bearer 0123456789abcdef");
        assert!(closed.check_action(&told).is_ok());
        told.insert("host", "arm.example".parse().unwrap());
        told.insert("origin", "https://evil.example".parse().unwrap());
        assert!(closed.check_action(&told).is_err());
    }

    #[test]
    fn without_a_token_only_this_machine_is_named() {
        let access = Access { token: None };
        for host in ["localhost", "localhost:8650", "127.0.0.1:8650", "[::1]:8650", "[::1]"] {
            assert!(access.check(&headers("host", host)).is_ok(), "{host}");
        }
        for host in ["evil.example", "127.0.0.1.evil.example:8650", "10.0.0.1"] {
            assert!(access.check(&headers("host", host)).is_err(), "{host}");
        }
        assert!(access.check(&HeaderMap::new()).is_err());
    }
}
