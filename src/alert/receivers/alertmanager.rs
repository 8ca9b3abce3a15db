//! Alertmanager, by its API version 2 (`POST /api/v2/alerts`).
//!
//! It identifies an alert by its labels and forgets all alerts at a restart. So open alarms are sent again regularly,
//! with an end far in the future; and if kind or severity, which are labels, have changed, the alert with the old ones
//! is ended in the same request.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde_json::Value;

use super::labels;
use super::webhook::check_login;
use crate::alert::http::HttpClient;
use crate::alert::message::{Message, json_text};
use crate::alert::receiver::{Receiver, SendError, Sending, Unusable};
use crate::alert::tls;
use armwatch_config::receivers::AlertmanagerSettings;

/// Duration of an open alarm unless it is sent again: a daemon that is stopped over a long weekend ends none.
const OPEN_FOR: SignedDuration = SignedDuration::from_hours(4 * 24);

/// Duration of a test alarm: longer than the usual `group_wait`, so that it is delivered.
const TRIAL_FOR: SignedDuration = SignedDuration::from_mins(5);

/// Posts messages to an Alertmanager.
pub(super) struct Alertmanager {
    url: String,
    refresh: Duration,
    http: HttpClient,
}

impl Alertmanager {
    pub(super) fn new(settings: &AlertmanagerSettings) -> Result<Self, Unusable> {
        let tls = match settings.url.starts_with("https://") {
            true => Some(tls::client(settings.ca_file.as_deref())?),
            false => None,
        };
        check_login(&settings.login)?;
        let http = HttpClient { login: settings.login.clone(), tls, timeout: settings.timeout };
        Ok(Self { url: format!("{}/api/v2/alerts", settings.url), refresh: settings.refresh, http })
    }

    async fn post(&self, message: &Message) -> Result<(), SendError> {
        let body = json_text(&alerts(message, Timestamp::now()));
        self.http.post(&self.url, &[("idempotency-key", message.key.clone())], body).await
    }
}

impl Receiver for Alertmanager {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        Box::pin(self.post(message))
    }

    fn refresh(&self) -> Option<Duration> {
        Some(self.refresh)
    }
}

fn alerts(message: &Message, now: Timestamp) -> Value {
    let mut alerts = Vec::new();
    let open_for = if message.is_trial { TRIAL_FOR } else { OPEN_FOR };
    for (place, alarm) in message.alarms.iter().enumerate() {
        let event = &alarm.event;
        // if a digest contains an anomaly twice, the later event counts
        if message.alarms[place + 1..].iter().any(|later| later.event.anomaly_id == event.anomaly_id) {
            continue;
        }
        for (kind, severity) in &event.told_before {
            alerts.push(labels::alert(alarm, message, (kind.as_str(), severity.as_str()), Some(now)));
        }
        let ends_at = if alarm.is_closed() { now } else { now + open_for };
        alerts.push(labels::alert(alarm, message, (event.kind.name(), event.severity.name()), Some(ends_at)));
    }
    Value::Array(alerts)
}
