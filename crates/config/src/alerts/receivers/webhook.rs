//! `[alerts.route.webhook]`: an address that accepts webhooks.

use std::path::PathBuf;
use std::time::Duration;

use super::ReceiverKind;
use super::shared::{
    Address, HttpLogin, Secret, read_http_login, read_path, read_secret, read_timeout, read_url,
};
use crate::toml::table::Table;

/// An address that accepts webhooks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebhookSettings {
    /// Its address, `http://` or `https://`.
    pub url: Address,
    /// Key of the signature; `None`: unsigned.
    pub signing_secret: Option<Secret>,
    /// Login to its HTTP server.
    pub login: HttpLogin,
    /// Certificates, PEM, that are trusted instead of the system's.
    pub ca_file: Option<PathBuf>,
    /// Longest time for an answer.
    pub timeout: Duration,
}

impl ReceiverKind for WebhookSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let url = match table.one_of(&["url", "url_file", "url_env"]) {
            Some((0, value)) => read_url(&value).map(Address::Plain),
            Some((1, value)) => value.text().map(|path| Address::Secret(Secret::File(path.into()))),
            Some((_, value)) => value.text().map(|name| Address::Secret(Secret::Environment(name.into()))),
            None => None,
        };
        let signing_secret = read_secret(table, "signing_secret");
        let login = read_http_login(table);
        let ca_file = read_path(table, "ca_file");
        let timeout = read_timeout(table);
        Some(Self {
            url: url?,
            signing_secret: signing_secret?,
            login: login?,
            ca_file: ca_file?,
            timeout: timeout?,
        })
    }

    fn target(&self) -> String {
        match &self.url {
            Address::Plain(url) => url.clone(),
            Address::Secret(secret) => format!("the address in {secret}"),
        }
    }

    fn secrets(&self) -> Vec<&Secret> {
        let url = if let Address::Secret(secret) = &self.url { Some(secret) } else { None };
        [url, self.signing_secret.as_ref(), self.login.secret()].into_iter().flatten().collect()
    }
}
