//! `[alerts.route.mqtt]`: a topic of an MQTT 5 broker.

use super::ReceiverKind;
use super::shared::{Encryption, Secret, ServerSettings};
use crate::toml::table::Table;
use armwatch_model::text::is_hidden;

/// Encryptions with their ports.
const MQTT: [(&str, Encryption, i64); 2] = [("tls", Encryption::Tls, 8883), ("none", Encryption::None, 1883)];

const DEFAULT_TOPIC: &str = "armwatch/alarms";

/// Most bytes of a topic; levels of robot and anomaly follow, and the protocol has 65,535 for all.
const TOPIC_BYTES: usize = 1024;

/// A topic of a broker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MqttSettings {
    /// Broker, with [`Encryption::Tls`] or [`Encryption::None`].
    pub server: ServerSettings,
    /// First levels of the topic; robot and number of the anomaly follow.
    pub topic: String,
}

impl ReceiverKind for MqttSettings {
    fn read(table: &Table<'_>) -> Option<Self> {
        let server = ServerSettings::read(table, &MQTT);
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
                    value.refuse("is not a topic for publishing".into(), Some(hint));
                }
                is_sound.then(|| topic.trim_end_matches('/').to_owned())
            }),
            None => Some(DEFAULT_TOPIC.to_owned()),
        };
        Some(Self { server: server?, topic: topic? })
    }

    fn target(&self) -> String {
        format!("{} at {}:{}", self.topic, self.server.host, self.server.port)
    }

    fn secrets(&self) -> Vec<&Secret> {
        self.server.login.iter().map(|(_, secret)| secret).collect()
    }
}
