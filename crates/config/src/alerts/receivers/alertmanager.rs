//! `[alerts.route.alertmanager]`: an Alertmanager, by its API version 2.

use std::path::PathBuf;
use std::time::Duration;

use super::ReceiverKind;
use super::shared::{HttpLogin, Secret, read_http_login, read_path, read_seconds, read_timeout, read_url};
use crate::toml::table::Table;

/// A minute, like Prometheus: an Alertmanager that restarts knows the open alarms again after this time.
const DEFAULT_REFRESH_S: f64 = 60.0;

/// An Alertmanager.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AlertmanagerSettings {
    /// Its address, without `/api/v2/alerts`.
    pub url: String,
    /// Login to its HTTP server.
    pub login: HttpLogin,
    /// Certificates, PEM, that are trusted instead of the system's.
    pub ca_file: Option<PathBuf>,
    /// Longest time for an answer.
    pub timeout: Duration,
    /// Time after which open alarms are sent again, because an Alertmanager forgets them at a restart.
    pub refresh: Duration,
}

impl ReceiverKind for AlertmanagerSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let url = table.required("url").and_then(|value| read_url(&value));
        let login = read_http_login(table);
        let ca_file = read_path(table, "ca_file");
        let timeout = read_timeout(table);
        let refresh = read_seconds(table, "refresh_s", 1.0, DEFAULT_REFRESH_S);
        let url = url?;
        Some(Self {
            url: url.trim_end_matches('/').trim_end_matches("/api/v2/alerts").to_owned(),
            login: login?,
            ca_file: ca_file?,
            timeout: timeout?,
            refresh: refresh?,
        })
    }

    fn target(&self) -> String {
        self.url.clone()
    }

    fn secrets(&self) -> Vec<&Secret> {
        self.login.secret().into_iter().collect()
    }
}
