//! Webhooks: the payload of Alertmanager's, version 4
//! (<https://prometheus.io/docs/alerting/latest/configuration/#webhook_config>), signed according to Standard Webhooks
//! (<https://www.standardwebhooks.com>).

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use jiff::Timestamp;
use ring::hmac;
use serde_json::{Value, json};

use super::labels;
use crate::alert::http::HttpClient;
use crate::alert::message::{Alarm, Message, json_text};
use crate::alert::receiver::{Receiver, SendError, Sending, Unusable};
use crate::alert::{secret, tls};
use armwatch_config::receivers::{Address, HttpLogin, Secret, WebhookSettings};

/// The payload's end time of an alarm that has not ended.
const NO_END: &str = "0001-01-01T00:00:00Z";

/// Secrets of Standard Webhooks begin with this; base 64 follows.
const SECRET_PREFIX: &str = "whsec_";

/// Posts messages to an address.
pub(super) struct Webhook {
    url: Address,
    signing_secret: Option<Secret>,
    http: HttpClient,
}

impl Webhook {
    pub(super) fn new(settings: &WebhookSettings) -> Result<Self, Unusable> {
        let url = match &settings.url {
            Address::Plain(url) => url.clone(),
            Address::Secret(place) => secret::read(place).map_err(Unusable)?,
        };
        if !url.starts_with("http://") && !url.starts_with("https://") {
            return Err(Unusable(
                "the address of the webhook does not begin with http:// or https://".into(),
            ));
        }
        let tls = match url.starts_with("https://") {
            true => Some(tls::client(settings.ca_file.as_deref())?),
            false => None,
        };
        if let Some(place) = &settings.signing_secret {
            secret::read(place).map_err(Unusable).and_then(|text| key(&text).map_err(Unusable))?;
        }
        check_login(&settings.login)?;
        let http = HttpClient { login: settings.login.clone(), tls, timeout: settings.timeout };
        Ok(Self { url: settings.url.clone(), signing_secret: settings.signing_secret.clone(), http })
    }

    async fn post(&self, message: &Message) -> Result<(), SendError> {
        let url = match &self.url {
            Address::Plain(url) => url.clone(),
            Address::Secret(place) => secret::read(place).map_err(SendError::unreached)?,
        };
        let body = json_text(&payload(message));
        let mut headers = vec![("webhook-id", message.key.clone()), ("idempotency-key", message.key.clone())];
        if let Some(place) = &self.signing_secret {
            let secret = secret::read(place).map_err(SendError::unreached)?;
            let now = Timestamp::now().as_second();
            let signed = signature(&secret, &message.key, now, &body).map_err(SendError::unreached)?;
            headers.push(("webhook-timestamp", now.to_string()));
            headers.push(("webhook-signature", signed));
        }
        self.http.post(&url, &headers, body).await
    }
}

impl Receiver for Webhook {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        Box::pin(self.post(message))
    }
}

/// Reads the secrets of a login, so that missing ones are reported when the program starts.
pub(super) fn check_login(login: &HttpLogin) -> Result<(), Unusable> {
    match login {
        HttpLogin::None => Ok(()),
        HttpLogin::Bearer(place) | HttpLogin::Basic { password: place, .. } => {
            secret::read(place).map(|_| ()).map_err(Unusable)
        }
    }
}

/// The key in a secret.
fn key(secret: &str) -> Result<Vec<u8>, String> {
    match secret.strip_prefix(SECRET_PREFIX) {
        Some(encoded) => STANDARD.decode(encoded).map_err(|_| {
            format!("the signing secret begins with {SECRET_PREFIX} and is no base 64 after it")
        }),
        None => Ok(secret.as_bytes().to_vec()),
    }
}

/// `v1,` and the HMAC-SHA256 of `id.timestamp.body` in base 64.
fn signature(secret: &str, id: &str, timestamp: i64, body: &str) -> Result<String, String> {
    let key = hmac::Key::new(hmac::HMAC_SHA256, &key(secret)?);
    let tag = hmac::sign(&key, format!("{id}.{timestamp}.{body}").as_bytes());
    Ok(format!("v1,{}", STANDARD.encode(tag)))
}

/// The payload, with `key` and `title` in addition to Alertmanager's fields.
fn payload(message: &Message) -> Value {
    let alerts: Vec<Value> = message.alarms.iter().map(|alarm| alert(alarm, message)).collect();
    let common = |field: &str| match alerts.as_slice() {
        [only] => only[field].clone(),
        _ => json!({}),
    };
    json!({
        "version": "4",
        "groupKey": message.key,
        "truncatedAlerts": 0,
        "status": message.status(),
        "receiver": message.route,
        "groupLabels": {},
        "commonLabels": common("labels"),
        "commonAnnotations": common("annotations"),
        "externalURL": message.origin.link.clone().unwrap_or_default(),
        "alerts": alerts,
        "key": message.key,
        "title": message.title(),
    })
}

fn alert(alarm: &Alarm, message: &Message) -> Value {
    let event = &alarm.event;
    let mut alert = labels::alert(alarm, message, (event.kind.name(), event.severity.name()), None);
    let (status, ends_at) = match alarm.is_closed() {
        true => ("resolved", event.at.to_string()),
        false => ("firing", NO_END.to_owned()),
    };
    alert["status"] = Value::String(status.into());
    alert["endsAt"] = Value::String(ends_at);
    if message.origin.link.is_none() {
        alert["generatorURL"] = Value::String(String::new());
    }
    // made of constant data, so that a receiver that uses it sees one alarm
    alert["fingerprint"] = Value::String(message.origin.anomaly(event.anomaly_id));
    alert
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the specification.
    #[test]
    fn the_signature_is_that_of_standard_webhooks() {
        let signed = signature(
            "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
            "msg_p5jXN8AQM9LWM0D4loKWxJek",
            1_614_265_330,
            "{\"test\": 2432232314}",
        );
        assert_eq!(signed.unwrap(), "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
        assert!(signature("whsec_*", "a", 1, "").is_err());
        assert!(signature("plain words", "a", 1, "").is_ok());
    }
}
