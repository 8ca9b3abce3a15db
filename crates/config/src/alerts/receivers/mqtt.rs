//! `[alerts.route.mqtt]`: a topic of an MQTT 5 broker.

use std::path::PathBuf;
use std::time::Duration;

use super::Receiver;
use super::shared::{Encryption, Secret, read_encryption, read_login, read_path, read_port, read_timeout};
use crate::toml::table::Table;
use armwatch_model::text::is_hidden;

/// Ports by encryption: `tls`, `none`.
const MQTT: (i64, i64) = (8883, 1883);

const DEFAULT_TOPIC: &str = "armwatch/alarms";

/// Most bytes of a topic; levels of robot and anomaly follow, and the protocol has 65,535 for all.
const TOPIC_BYTES: usize = 1024;

/// A topic of a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// Broker.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// [`Encryption::Tls`] or [`Encryption::None`].
    pub encryption: Encryption,
    /// User and password, if the broker requires them.
    pub login: Option<(String, Secret)>,
    /// Certificates, PEM, that are trusted in place of the system's.
    pub ca_file: Option<PathBuf>,
    /// First levels of the topic; robot and number of the anomaly follow.
    pub topic: String,
    /// Longest time for an acknowledgement.
    pub timeout: Duration,
}

impl Receiver for MqttSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
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
        Some(Self {
            host: host?.to_owned(),
            port: port?,
            encryption: encryption?,
            login: login?,
            ca_file: ca_file?,
            topic: topic?,
            timeout: timeout?,
        })
    }

    fn target(&self) -> String {
        format!("{} at {}:{}", self.topic, self.host, self.port)
    }

    fn secrets(&self) -> Vec<&Secret> {
        self.login.iter().map(|(_, secret)| secret).collect()
    }
}
