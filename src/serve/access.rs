//! Access to the server: requests need a bearer token or a program on this machine.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use axum::http::header::{AUTHORIZATION, COOKIE, HOST, ORIGIN};
use axum::http::{HeaderMap, HeaderValue};
use subtle::ConstantTimeEq;

use super::answer::Refusal;

pub use armwatch_config::Scope;
use armwatch_config::{ClientSettings, ServeSettings};
use armwatch_ingest::bytes::fingerprint::of_bytes;
use armwatch_model::run::ContentHash;

/// Environment variable with the token, if the configuration names no file.
pub const TOKEN_VARIABLE: &str = "ARMWATCH_TOKEN";

/// Shortest token: 16 characters of base 64 are 96 bits.
const SHORTEST_TOKEN: usize = 16;

/// Longest token, and the limit for reading its file.
const LONGEST_TOKEN: usize = 1024;

/// Error in the configuration of access.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// Other machines can send requests, and there is no token.
    #[error(
        "serve.listen = \"{0}\" is reached from other machines and there is no token; give serve.token_file or the \
         environment variable {TOKEN_VARIABLE}, or listen on 127.0.0.1"
    )]
    Open(std::net::SocketAddr),
    /// The file cannot be read.
    #[error("{key}: {file}: {detail}", file = path.display())]
    File {
        /// Key of the file in the configuration.
        key: String,
        /// The file.
        path: PathBuf,
        /// Message of the operating system.
        detail: String,
    },
    /// The token is easy to guess or cannot be sent.
    #[error(
        "the token in {0} must be one line of {SHORTEST_TOKEN} to {LONGEST_TOKEN} printable characters without \
         blanks; `openssl rand -hex 24` makes one"
    )]
    Token(String),
    /// Two names have one token, so the valid scopes would depend on their order.
    #[error("{0} and {1} hold the same token; `openssl rand -hex 24` makes another")]
    Same(String, String),
}

/// The tokens and addresses that decide access.
#[derive(Debug)]
pub struct Access {
    tokens: Vec<Token>,
    /// Name of the cookie with the token of a browser. It contains the port, because cookies of a host are shared by
    /// all its ports.
    cookie: String,
    /// Address of the dashboard for browsers, if a proxy gives it another one.
    public_url: Option<String>,
}

struct Token {
    name: String,
    /// Only hashes are compared, so that timing reveals nothing about a token, not even its length.
    hash: ContentHash,
    scopes: Vec<Scope>,
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Token")
            .field("name", &self.name)
            .field("scopes", &self.scopes)
            .finish_non_exhaustive()
    }
}

impl Access {
    /// Reads the tokens.
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn new(settings: &ServeSettings, clients: &ClientSettings) -> Result<Self, AccessError> {
        let mut tokens: Vec<Token> = Vec::new();
        let general = match &settings.token_file {
            Some(path) => Some((read(path, "serve.token_file")?, path.display().to_string())),
            None => std::env::var(TOKEN_VARIABLE)
                .ok()
                .filter(|text| !text.is_empty())
                .map(|text| (text, TOKEN_VARIABLE.to_owned())),
        };
        let general = general.map(|(text, place)| (place.clone(), text, place, Scope::ALL.to_vec()));
        let scoped = clients.tokens.iter().map(|token| {
            let text = read(&token.file, &format!("serve.token {}", token.name))?;
            Ok((token.name.clone(), text, token.file.display().to_string(), token.scopes.clone()))
        });
        for found in general.into_iter().map(Ok).chain(scoped) {
            let (name, text, place, scopes) = found?;
            let hash = hash_of(&text).ok_or(AccessError::Token(place))?;
            if let Some(other) = tokens.iter().find(|other| other.hash == hash) {
                return Err(AccessError::Same(other.name.clone(), name));
            }
            tokens.push(Token { name, hash, scopes });
        }
        if tokens.is_empty() && !settings.listen.ip().is_loopback() {
            return Err(AccessError::Open(settings.listen));
        }
        Ok(Self {
            tokens,
            cookie: format!("armwatch_{}", settings.listen.port()),
            public_url: settings.public_url.clone(),
        })
    }

    /// The header that makes a browser send `token` with each request: for 90 days with `keep`, otherwise until the
    /// browser is closed. Scripts cannot read the cookie, and browsers do not send it with requests of other sites.
    ///
    /// # Errors
    /// 401 for an unknown token.
    pub fn log_in(&self, token: &str, keep: bool, is_secure: bool) -> Result<String, Refusal> {
        let token = token.trim();
        self.token_of(token.as_bytes())?;
        let age = if keep { "; Max-Age=7776000" } else { "" };
        Ok(self.cookie_of(token, age, is_secure))
    }

    /// The header that makes a browser forget its token.
    pub fn log_out(&self, is_secure: bool) -> String {
        self.cookie_of("", "; Max-Age=0", is_secure)
    }

    fn cookie_of(&self, value: &str, age: &str, is_secure: bool) -> String {
        let secure = if is_secure { "; Secure" } else { "" };
        format!("{}={value}; Path=/; HttpOnly; SameSite=Strict{age}{secure}", self.cookie)
    }

    /// Checks that a request may do the actions of `scope`. Without tokens, requests that name this machine may read
    /// and upload; otherwise a page in a browser could send requests in its user's name. Changes always need a token.
    ///
    /// # Errors
    /// 401 for a missing or unknown token. 403 for a token without the scope, for a page at another address, and if no
    /// token is configured.
    pub fn check_for(&self, scope: Scope, headers: &HeaderMap) -> Result<(), Refusal> {
        self.check_own_page(headers)?;
        if self.tokens.is_empty() {
            return match scope {
                _ if !names_this_machine(headers) => Err(Refusal::forbidden()),
                Scope::Act => Err(Refusal::needs_token()),
                Scope::Read | Scope::Upload => Ok(()),
            };
        }
        let held = self.held(headers)?;
        if held.scopes.contains(&scope) { Ok(()) } else { Err(Refusal::out_of_scope(&held.name, scope)) }
    }

    /// Refuses requests of pages at another address.
    ///
    /// # Errors
    /// 403.
    pub fn check_own_page(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        if is_of_own_page(headers, self.public_url.as_deref()) {
            Ok(())
        } else {
            Err(Refusal::of_other_page(headers))
        }
    }

    /// Name of the token of a request; empty without one.
    pub fn token_name(&self, headers: &HeaderMap) -> &str {
        self.held(headers).map_or("", |token| &token.name)
    }

    /// The token of a request.
    fn held(&self, headers: &HeaderMap) -> Result<&Token, Refusal> {
        let given = bearer(headers).or_else(|| cookie(headers, &self.cookie));
        self.token_of(given.filter(|given| !given.is_empty()).ok_or_else(Refusal::unauthorized)?)
    }

    fn token_of(&self, given: &[u8]) -> Result<&Token, Refusal> {
        let given = of_bytes(given);
        // compares all, so that timing does not reveal the matching token
        let mut held = None;
        for token in &self.tokens {
            if is_same(&token.hash, &given) {
                held = Some(token);
            }
        }
        held.ok_or_else(Refusal::wrong_token)
    }

    /// Checks that a request may read stored data.
    ///
    /// # Errors
    /// Those of [`Access::check_for`].
    pub fn check(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        self.check_for(Scope::Read, headers)
    }

    /// Returns true if a request needs a token.
    pub fn needs_token(&self) -> bool {
        !self.tokens.is_empty()
    }
}

/// The hash of a token; `None` if the token is easy to guess or cannot be sent.
fn hash_of(text: &str) -> Option<ContentHash> {
    let token = text.trim();
    let is_usable = (SHORTEST_TOKEN..=LONGEST_TOKEN).contains(&token.len())
        && token.bytes().all(|byte| byte.is_ascii_graphic());
    is_usable.then(|| of_bytes(token.as_bytes()))
}

fn read(path: &Path, key: &str) -> Result<String, AccessError> {
    let failed = |detail: String| AccessError::File { key: key.to_owned(), path: path.to_owned(), detail };
    let file = File::open(path).map_err(|error| failed(error.to_string()))?;
    let mut text = String::new();
    let limit = LONGEST_TOKEN as u64 + 2;
    file.take(limit).read_to_string(&mut text).map_err(|error| failed(error.to_string()))?;
    Ok(text)
}

/// Warns of a token file that other users of the machine may read.
pub fn warn_if_open(settings: &ServeSettings, clients: &ClientSettings) {
    use std::os::unix::fs::PermissionsExt;
    const OTHERS: u32 = 0o077;
    for path in settings.token_file.iter().chain(clients.tokens.iter().map(|token| &token.file)) {
        if path.metadata().is_ok_and(|metadata| metadata.permissions().mode() & OTHERS != 0) {
            tracing::warn!(path = %path.display(), "other users may read the token; chmod 600 it");
        }
    }
}

fn bearer(headers: &HeaderMap) -> Option<&[u8]> {
    let value = headers.get(AUTHORIZATION)?.as_bytes();
    let (scheme, token) = value.split_at_checked("bearer ".len())?;
    scheme.eq_ignore_ascii_case(b"bearer ").then(|| token.trim_ascii())
}

/// The value of a cookie.
fn cookie<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a [u8]> {
    let all = headers.get_all(COOKIE).into_iter().filter_map(|value| value.to_str().ok());
    let mut pairs = all.flat_map(|value| value.split(';')).filter_map(|pair| pair.trim().split_once('='));
    pairs.find(|(found, _)| *found == name).map(|(_, value)| value.as_bytes())
}

/// Returns true if two hashes are equal. The time does not depend on the position of a difference.
fn is_same(a: &ContentHash, b: &ContentHash) -> bool {
    a.0.ct_eq(&b.0).into()
}

/// Returns true if a request is from no page or from a page of this server. The address of the server is
/// `public_url` or the Host of the request.
///
/// Browsers say so in `Sec-Fetch-Site`. No page can set this header, and it passes proxies that change the Host.
/// Browsers send it only over TLS and on this machine. Otherwise the Origin of the page must be the requested address.
fn is_of_own_page(headers: &HeaderMap, public_url: Option<&str>) -> bool {
    if let Some(site) = headers.get("sec-fetch-site") {
        return site == "same-origin" || site == "none";
    }
    let Some(origin) = headers.get(ORIGIN).map(HeaderValue::to_str) else { return true };
    let Ok(Some((scheme, place))) = origin.map(|origin| origin.split_once("://")) else { return false };
    let host = headers.get(HOST).and_then(|host| host.to_str().ok());
    let is_public = public_url.is_some_and(|url| {
        let rest = url.strip_prefix(scheme).and_then(|rest| rest.strip_prefix("://"));
        rest.and_then(|rest| rest.split('/').next()).is_some_and(|of| of.eq_ignore_ascii_case(place))
    });
    is_public || host.is_some_and(|host| host.eq_ignore_ascii_case(place))
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
        ServeSettings {
            listen: listen.parse().unwrap(),
            token_file,
            public_url: None,
            trusted_proxies: Vec::new(),
            tls: None,
            upload: None,
        }
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
        let access = Access::new(&settings("0.0.0.0:0", Some(path)), &ClientSettings::default()).unwrap();
        assert!(!format!("{access:?}").contains("0123"), "{access:?}");
        for good in ["Bearer 0123456789abcdef0123", "bearer  0123456789abcdef0123"] {
            assert!(access.check_for(Scope::Act, &headers("authorization", good)).is_ok(), "{good}");
        }
        for bad in
            ["Bearer 0123456789abcdef012", "Bearer ", "Basic 0123456789abcdef0123", "0123456789abcdef0123"]
        {
            assert!(access.check_for(Scope::Read, &headers("authorization", bad)).is_err(), "{bad}");
        }
        assert!(access.check_for(Scope::Read, &headers("host", "localhost")).is_err());
    }

    #[test]
    fn a_short_a_broken_and_a_missing_token_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        for text in ["short", "0123456789abcdef 0123", "0123456789abcdef\nx", ""] {
            std::fs::write(&path, text).unwrap();
            let refused =
                Access::new(&settings("127.0.0.1:0", Some(path.clone())), &ClientSettings::default());
            assert!(matches!(refused, Err(AccessError::Token(_))), "{text:?}");
        }
        std::fs::remove_file(&path).unwrap();
        let refused = Access::new(&settings("127.0.0.1:0", Some(path)), &ClientSettings::default());
        assert!(matches!(refused, Err(AccessError::File { .. })));
    }

    #[test]
    fn what_changes_something_needs_a_token_and_no_other_page_asks() {
        let open = access(Vec::new());
        let mut own = headers("host", "127.0.0.1:8650");
        assert!(open.check_for(Scope::Read, &own).is_ok() && open.check_for(Scope::Act, &own).is_err());
        own.insert("origin", "http://127.0.0.1:8650".parse().unwrap());
        assert!(open.check_for(Scope::Upload, &own).is_ok());
        for other in ["http://evil.example", "http://127.0.0.1:3000", "null"] {
            own.insert("origin", other.parse().unwrap());
            assert!(open.check_for(Scope::Read, &own).is_err(), "{other}");
        }
        let closed = access(vec![token("all", b"0123456789abcdef", &Scope::ALL)]);
        let mut told = headers("authorization", "Bearer 0123456789abcdef");
        assert!(closed.check_for(Scope::Act, &told).is_ok());
        told.insert("host", "arm.example".parse().unwrap());
        told.insert("origin", "https://evil.example".parse().unwrap());
        assert!(closed.check_for(Scope::Act, &told).is_err());
    }

    fn access(tokens: Vec<Token>) -> Access {
        Access { tokens, cookie: "armwatch_8650".into(), public_url: None }
    }

    #[test]
    fn a_page_behind_a_proxy_is_told_from_a_foreign_one() {
        let of = |pairs: &[(&'static str, &str)]| {
            let mut all = HeaderMap::new();
            for (name, value) in pairs {
                all.insert(*name, value.parse().unwrap());
            }
            all
        };
        let url = Some("https://plant.example/armwatch/");
        let (own, foreign) = ("https://plant.example", "https://evil.example");
        // nginx without settings puts its own view of the upstream into Host
        for (site, origin, with_url, expected) in [
            (Some("same-origin"), own, None, true),
            (Some("cross-site"), own, url, false),
            (Some("same-site"), foreign, url, false),
            (None, own, url, true),
            (None, own, None, false),
            (None, "http://plant.example", url, false),
            (None, "https://plant.example:444", url, false),
            (None, foreign, url, false),
            (None, "null", url, false),
        ] {
            let mut sent = of(&[("host", "127.0.0.1:8650"), ("origin", origin)]);
            if let Some(site) = site {
                sent.insert("sec-fetch-site", site.parse().unwrap());
            }
            assert_eq!(is_of_own_page(&sent, with_url), expected, "{site:?} {origin} {with_url:?}");
        }
        assert!(is_of_own_page(&of(&[("host", "plant.example"), ("origin", own)]), None));
    }

    fn token(name: &str, text: &[u8], scopes: &[Scope]) -> Token {
        Token { name: name.into(), hash: of_bytes(text), scopes: scopes.to_vec() }
    }

    #[test]
    fn a_token_does_what_its_scopes_say_and_each_refusal_says_why() {
        let access = access(vec![
            token("all", b"0123456789abcdef", &Scope::ALL),
            token("cell 3", b"fedcba9876543210", &[Scope::Upload]),
        ]);
        let said = |given: &str, scope| {
            let answer = access.check_for(scope, &headers("authorization", given));
            answer.map_err(|refusal| (refusal.status.as_u16(), refusal.sentence))
        };
        assert!(Scope::ALL.iter().all(|scope| said("Bearer 0123456789abcdef", *scope).is_ok()));
        assert_eq!(said("Bearer fedcba9876543210", Scope::Upload), Ok(()));
        let (status, sentence) = said("Bearer fedcba9876543210", Scope::Act).unwrap_err();
        assert!(status == 403 && sentence.contains("cell 3") && sentence.contains("act"), "{sentence}");
        let (status, wrong) = said("Bearer another-token-0123", Scope::Read).unwrap_err();
        let (other, missing) = said("Bearer ", Scope::Read).unwrap_err();
        assert!((status, other) == (401, 401) && wrong != missing, "{wrong}, {missing}");
    }

    #[test]
    fn a_browser_that_has_logged_in_sends_its_token_as_a_cookie() {
        let access = access(vec![token("all", b"0123456789abcdef", &[Scope::Read])]);
        let set = access.log_in(" 0123456789abcdef\n", true, true).unwrap();
        assert_eq!(
            set,
            "armwatch_8650=0123456789abcdef; Path=/; HttpOnly; SameSite=Strict; Max-Age=7776000; Secure"
        );
        let sent = headers("cookie", "theme=dark; armwatch_8650=0123456789abcdef; armwatch_8651=other");
        assert!(access.check_for(Scope::Read, &sent).is_ok());
        assert_eq!(access.check_for(Scope::Act, &sent).unwrap_err().status, 403);
        for other in ["armwatch_8651=0123456789abcdef", "armwatch_8650=", "armwatch_8650=0123456789abcdeg"] {
            assert_eq!(access.check_for(Scope::Read, &headers("cookie", other)).unwrap_err().status, 401);
        }
        assert!(access.log_in("0123456789abcde", false, false).is_err());
        assert!(
            access.log_out(false).starts_with("armwatch_8650=; ")
                && access.log_out(false).contains("Max-Age=0")
        );
        let mut foreign = sent;
        foreign.insert("host", "arm.example".parse().unwrap());
        foreign.insert("origin", "https://evil.example".parse().unwrap());
        assert_eq!(access.check_for(Scope::Read, &foreign).unwrap_err().status, 403);
    }

    #[test]
    fn tokens_of_the_configuration_are_read_and_two_are_not_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let files = ["a", "b"].map(|name| folder.path().join(name));
        let clients = |scopes: &[Scope]| ClientSettings {
            tokens: vec![armwatch_config::TokenSettings {
                name: "b".into(),
                file: files[1].clone(),
                scopes: scopes.to_vec(),
            }],
            ..ClientSettings::default()
        };
        std::fs::write(&files[0], "0123456789abcdef").unwrap();
        std::fs::write(&files[1], "fedcba9876543210\n").unwrap();
        let general = settings("0.0.0.0:0", Some(files[0].clone()));
        let access = Access::new(&general, &clients(&[Scope::Read])).unwrap();
        assert!(access.check_for(Scope::Read, &headers("authorization", "Bearer fedcba9876543210")).is_ok());
        assert!(Access::new(&settings("0.0.0.0:0", None), &clients(&[Scope::Read])).is_ok());
        std::fs::write(&files[1], "0123456789abcdef").unwrap();
        let same = Access::new(&general, &clients(&[Scope::Read]));
        assert!(matches!(same, Err(AccessError::Same(..))), "{same:?}");
        std::fs::remove_file(&files[1]).unwrap();
        let gone = Access::new(&general, &clients(&[Scope::Read])).unwrap_err().to_string();
        assert!(gone.starts_with("serve.token b: "), "{gone}");
    }

    #[test]
    fn without_a_token_only_this_machine_is_named() {
        let access = access(Vec::new());
        for host in ["localhost", "localhost:8650", "127.0.0.1:8650", "[::1]:8650", "[::1]"] {
            assert!(access.check_for(Scope::Read, &headers("host", host)).is_ok(), "{host}");
        }
        for host in ["evil.example", "127.0.0.1.evil.example:8650", "10.0.0.1"] {
            assert!(access.check_for(Scope::Read, &headers("host", host)).is_err(), "{host}");
        }
        assert!(access.check_for(Scope::Read, &HeaderMap::new()).is_err());
    }
}
