//! The receiver of a route: `[alerts.route.webhook]` and its like.

use std::path::PathBuf;
use std::time::Duration;

use super::settings::{
    Address, AlertmanagerSettings, CommandSettings, EmailSettings, Encryption, HttpLogin, MqttSettings,
    ReceiverSettings, Secret, WebhookSettings,
};
use super::values::{given, texts};
use crate::toml::range::Limits;
use crate::toml::table::{Table, Value};
use armwatch_model::text::is_hidden;

/// Ports that the protocols have by themselves.
const SMTP: (i64, i64, i64) = (465, 587, 25);
const MQTT: (i64, i64) = (8883, 1883);

const DEFAULT_TIMEOUT_S: f64 = 30.0;

/// A minute, as Prometheus does: an Alertmanager that starts anew knows the open alarms after it.
const DEFAULT_REFRESH_S: f64 = 60.0;

const DEFAULT_TOPIC: &str = "armwatch/alarms";

/// Most bytes of a topic; levels of robot and anomaly follow, and the protocol has 65,535 for all.
const TOPIC_BYTES: usize = 1024;

const NAMES: [&str; 6] = ["log", "webhook", "alertmanager", "email", "mqtt", "command"];

/// The one receiver of a route; `None` after a problem.
pub(super) fn read_receiver(route: &Table<'_>) -> Option<ReceiverSettings> {
    let mut found: Vec<(&str, Value<'_>)> =
        NAMES.iter().filter_map(|name| Some((*name, route.optional(name)?))).collect();
    if found.len() > 1 {
        let (first, _) = found[0];
        for (_, value) in &found[1..] {
            let hint = "give each receiver a route of its own".to_owned();
            value.refuse(format!("the route already has the receiver {first}"), Some(hint));
        }
        return None;
    }
    let Some((name, value)) = found.pop() else {
        let hint = format!("write one of [alerts.route.{}]", NAMES.join("], [alerts.route."));
        route.refuse("has no receiver".into(), Some(hint));
        return None;
    };
    let table = value.table()?;
    match name {
        "log" => Some(ReceiverSettings::Log),
        "webhook" => read_webhook(&table).map(ReceiverSettings::Webhook),
        "alertmanager" => read_alertmanager(&table).map(ReceiverSettings::Alertmanager),
        "email" => read_email(&table).map(ReceiverSettings::Email),
        "mqtt" => read_mqtt(&table).map(ReceiverSettings::Mqtt),
        _ => read_command(&table).map(ReceiverSettings::Command),
    }
}

fn read_webhook(table: &Table<'_>) -> Option<WebhookSettings> {
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
    Some(WebhookSettings {
        url: url?,
        signing_secret: signing_secret?,
        login: login?,
        ca_file: ca_file?,
        timeout: timeout?,
    })
}

fn read_alertmanager(table: &Table<'_>) -> Option<AlertmanagerSettings> {
    let url = table.required("url").and_then(|value| read_url(&value));
    let login = read_http_login(table);
    let ca_file = read_path(table, "ca_file");
    let timeout = read_timeout(table);
    let refresh = read_seconds(table, "refresh_s", 1.0, DEFAULT_REFRESH_S);
    let url = url?;
    Some(AlertmanagerSettings {
        url: url.trim_end_matches('/').trim_end_matches("/api/v2/alerts").to_owned(),
        login: login?,
        ca_file: ca_file?,
        timeout: timeout?,
        refresh: refresh?,
    })
}

fn read_email(table: &Table<'_>) -> Option<EmailSettings> {
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
    Some(EmailSettings {
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

fn read_mqtt(table: &Table<'_>) -> Option<MqttSettings> {
    let host = table.text("host");
    let encryption = read_encryption(table, &["tls", "none"]);
    let port = read_port(table, if encryption == Some(Encryption::None) { MQTT.1 } else { MQTT.0 });
    let login = read_login(table);
    let ca_file = read_path(table, "ca_file");
    let topic = match table.optional("topic") {
        Some(value) => value.text().and_then(|topic| {
            let is_sound = !topic.contains(['+', '#'])
                && !topic.contains(is_hidden)
                && !topic.starts_with(['/', '$'])
                && topic.len() <= TOPIC_BYTES;
            if !is_sound {
                let hint = format!(
                    "write levels such as \"{DEFAULT_TOPIC}\", without +, #, control characters and a first / or $, at \
                     most {TOPIC_BYTES} bytes"
                );
                value.refuse("is no topic to publish to".into(), Some(hint));
            }
            is_sound.then(|| topic.trim_end_matches('/').to_owned())
        }),
        None => Some(DEFAULT_TOPIC.to_owned()),
    };
    let timeout = read_timeout(table);
    Some(MqttSettings {
        host: host?.to_owned(),
        port: port?,
        encryption: encryption?,
        login: login?,
        ca_file: ca_file?,
        topic: topic?,
        timeout: timeout?,
    })
}

fn read_command(table: &Table<'_>) -> Option<CommandSettings> {
    let hint =
        || Some("write the program and its arguments, such as [\"/usr/local/bin/page\", \"shift\"]".into());
    let arguments = table.required_or_else("run", hint).and_then(|value| texts(&value));
    let timeout = read_timeout(table);
    Some(CommandSettings { arguments: arguments?, timeout: timeout? })
}

/// An address of HTTP without user and password, which are secret.
fn read_url(value: &Value<'_>) -> Option<String> {
    let url = value.text()?;
    let rest = url.strip_prefix("http://").or_else(|| url.strip_prefix("https://"));
    let Some(host) = rest.map(|rest| rest.split(['/', '?', '#']).next().unwrap_or_default()) else {
        value.refuse("is no address".into(), Some("write http://host:port/path, or https://".into()));
        return None;
    };
    if host.contains('@') {
        let hint = "write user and password_file, or password_env, beside it";
        value.refuse_secret("holds a user or a password".into(), Some(hint.into()));
        return None;
    }
    if host.is_empty() || host.starts_with(':') {
        value.refuse("names no host".into(), None);
        return None;
    }
    Some(url.to_owned())
}

/// What stands in `NAME_file` or in the variable that `NAME_env` names.
fn read_secret(table: &Table<'_>, name: &str) -> Option<Option<Secret>> {
    let (file, environment) = (format!("{name}_file"), format!("{name}_env"));
    if let Some(value) = table.optional(name) {
        let hint = format!("write {file} or {environment}, so that this file can be shown");
        value.refuse_secret("a secret does not stand in the configuration".into(), Some(hint));
        return None;
    }
    let both = [table.optional(&file), table.optional(&environment)];
    if let [Some(_), Some(second)] = &both {
        second.refuse(format!("there is {file} already"), Some("keep one of them".into()));
        return None;
    }
    let [file, environment] = both;
    let file = file.map(|value| value.text().map(|path| Secret::File(path.into())));
    let environment = environment.map(|value| value.text().map(|name| Secret::Environment(name.to_owned())));
    given(file.or(environment))
}

fn read_http_login(table: &Table<'_>) -> Option<HttpLogin> {
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
fn read_login(table: &Table<'_>) -> Option<Option<(String, Secret)>> {
    let user = table.optional("user").map(|value| value.text().map(str::to_owned));
    let password = read_secret(table, "password");
    match (given(user)?, password?) {
        (Some(user), Some(password)) => Some(Some((user, password))),
        (None, None) => Some(None),
        (Some(_), None) => {
            let hint = "write password_file or password_env".to_owned();
            table.refuse("has a user and no password".into(), Some(hint));
            None
        }
        (None, Some(_)) => {
            table.refuse("has a password and no user".into(), Some("write user".into()));
            None
        }
    }
}

/// One of `names`, the first unless given.
fn read_encryption(table: &Table<'_>, names: &[&str]) -> Option<Encryption> {
    let Some(value) = table.optional("encryption") else { return encryption(names[0]) };
    let text = value.text()?;
    let found = names.iter().find(|name| **name == text).and_then(|name| encryption(name));
    if found.is_none() {
        let quoted: Vec<String> = names.iter().map(|name| format!("\"{name}\"")).collect();
        value.refuse("is not known here".into(), Some(format!("write one of {}", quoted.join(", "))));
    }
    found
}

fn encryption(name: &str) -> Option<Encryption> {
    match name {
        "tls" => Some(Encryption::Tls),
        "starttls" => Some(Encryption::StartTls),
        "none" => Some(Encryption::None),
        _ => None,
    }
}

fn read_port(table: &Table<'_>, default: i64) -> Option<u16> {
    let port = match table.optional("port") {
        Some(value) => value.integer(1..=65_535)?,
        None => default,
    };
    u16::try_from(port).ok()
}

fn read_path(table: &Table<'_>, key: &str) -> Option<Option<PathBuf>> {
    given(table.optional(key).map(|value| value.text().map(PathBuf::from)))
}

fn read_timeout(table: &Table<'_>) -> Option<Duration> {
    read_seconds(table, "timeout_s", 0.1, DEFAULT_TIMEOUT_S)
}

fn read_seconds(table: &Table<'_>, key: &str, least: f64, default: f64) -> Option<Duration> {
    let seconds = table.number_or(key, &Limits::between(least, 3600.0, "s"), default)?;
    Duration::try_from_secs_f64(seconds).ok()
}
