//! MQTT 5: each message is published with quality of service 1 and done when the broker acknowledges it.

use ring::digest;
use rumqttc::mqttbytes::{
    self,
    v5::{DisconnectReasonCode, PubAckReason},
};
use rumqttc::{
    AsyncClient, ConnectionError, Event, MqttOptions, Outgoing, PublishNoticeError, PublishOptions, QoS,
    StateError, TlsConfiguration, Transport,
};

use crate::alert::message::Message;
use crate::alert::receiver::{Receiver, SendError, Sending, Unusable};
use crate::alert::{secret, tls};
use armwatch_config::receivers::{Encryption, MqttSettings, ServerSettings};
use armwatch_model::text;

/// Requests that wait for the connection: the one message, and one more.
const REQUESTS: usize = 2;

/// Characters with a meaning in topics.
const SPECIAL: [char; 3] = ['/', '+', '#'];

/// Most bytes of a level with the name of a robot. A topic has 65,535 at most, and some brokers allow fewer.
const LEVEL_BYTES: usize = 1024;

/// Publishes messages.
pub(super) struct Mqtt {
    settings: MqttSettings,
    transport: Transport,
}

impl Mqtt {
    pub(super) fn new(settings: &MqttSettings) -> Result<Self, Unusable> {
        if let Some((_, password)) = &settings.server.login {
            secret::read(password).map_err(Unusable)?;
        }
        let transport = match settings.server.encryption {
            Encryption::None => Transport::Tcp,
            _ => Transport::Tls(TlsConfiguration::Rustls(tls::client(settings.server.ca_file.as_deref())?)),
        };
        Ok(Self { settings: settings.clone(), transport })
    }

    async fn publish(&self, message: &Message) -> Result<(), SendError> {
        let ServerSettings { host, port, timeout, .. } = &self.settings.server;
        // two connections of one name would end each other
        let name = format!("armwatch-{}-{}", message.origin.identity, message.route);
        let mut options = MqttOptions::new(name, (host.as_str(), *port));
        options.set_transport(self.transport.clone());
        if let Some((user, password)) = &self.settings.server.login {
            let password = secret::read(password).map_err(SendError::unreached)?;
            options.set_credentials(user.clone(), password);
        }
        let (client, mut connection) = AsyncClient::builder(options).capacity(REQUESTS).build();
        let topic = topic(&self.settings.topic, message);
        let publishing = async {
            let notice = client
                .publish_tracked(topic, message.json_text(), PublishOptions::new(QoS::AtLeastOnce))
                .await
                .map_err(|error| SendError::refused(format!("{host}:{port}: {error}")))?;
            match notice.wait_async().await {
                // a message without subscribers has been delivered
                Ok(_) | Err(PublishNoticeError::V5PubAck(PubAckReason::NoMatchingSubscribers)) => Ok(()),
                Err(PublishNoticeError::V5PubAck(reason)) => {
                    let detail = format!("{host}:{port}: the broker says {reason:?}");
                    Err(if is_of_message(reason) {
                        SendError::never(detail)
                    } else {
                        SendError::refused(detail)
                    })
                }
                Err(error) => Err(SendError::unreached(format!("{host}:{port}: {error}"))),
            }
        };
        let driving = async {
            let mut is_sent = false;
            loop {
                match connection.poll().await {
                    Ok(Event::Outgoing(Outgoing::Publish(_))) => is_sent = true,
                    Ok(_) => {}
                    Err(error) => return failure(format!("{host}:{port}: {error}"), &error, is_sent),
                }
            }
        };
        let done = async {
            tokio::select! {
                done = publishing => done,
                error = driving => Err(error),
            }
        };
        match tokio::time::timeout(*timeout, done).await {
            Ok(done) => done,
            Err(_) => {
                let seconds = timeout.as_secs_f64();
                Err(SendError::unreached(format!("{host}:{port}: no acknowledgement within {seconds} s")))
            }
        }
    }
}

impl Receiver for Mqtt {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        Box::pin(self.publish(message))
    }
}

/// The error of a message whose connection ended; `is_sent` if the message was on its way to the broker.
fn failure(detail: String, error: &ConnectionError, is_sent: bool) -> SendError {
    use DisconnectReasonCode as Reason;
    match error {
        ConnectionError::MqttState(
            StateError::OutgoingPacketTooLarge { .. }
            | StateError::Deserialization(mqttbytes::Error::OutgoingPacketTooLarge { .. }),
        ) => SendError::never(detail),
        ConnectionError::MqttState(StateError::ServerDisconnect { reason_code, .. }) if is_sent => {
            match reason_code {
                Reason::MalformedPacket
                | Reason::ProtocolError
                | Reason::TopicNameInvalid
                | Reason::PacketTooLarge
                | Reason::PayloadFormatInvalid => SendError::never(detail),
                Reason::ServerShuttingDown | Reason::ServerBusy | Reason::SessionTakenOver => {
                    SendError::unreached(detail)
                }
                _ => SendError::refused(detail),
            }
        }
        // a broker that hangs up on a message may take the next one
        _ if is_sent => SendError::refused(detail),
        _ => SendError::unreached(detail),
    }
}

/// True for reasons that concern the message itself, so that the broker refuses it every time.
fn is_of_message(reason: PubAckReason) -> bool {
    matches!(reason, PubAckReason::TopicNameInvalid | PubAckReason::PayloadFormatInvalid)
}

/// Robot and anomaly as levels below the configured ones.
fn topic(prefix: &str, message: &Message) -> String {
    match message.alarms.as_slice() {
        [alarm] if !message.is_digest => {
            format!("{prefix}/{}/{}", level(&alarm.event.robot), alarm.event.anomaly_id)
        }
        _ => format!("{prefix}/digest"),
    }
}

/// A name as one level of a topic, see [`text::percent`]. Different names have different levels; the end of a very long
/// one is a hash.
fn level(name: &str) -> String {
    let level = text::percent(name, &SPECIAL);
    if level.len() <= LEVEL_BYTES {
        return level.into_owned();
    }
    let hash = digest::digest(&digest::SHA256, name.as_bytes());
    let hash: String = hash.as_ref().iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    // no name has `~` after a percent sign
    let end = format!("%~{hash}");
    let begin = level.floor_char_boundary(LEVEL_BYTES - end.len());
    format!("{}{end}", &level[..begin])
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;

    #[test]
    fn each_name_is_one_level_of_its_own_that_a_broker_takes() {
        let long = "R".repeat(70_000);
        let names = [
            "R01",
            "R/01",
            "R%2F01",
            "R_01",
            "R+",
            "R#",
            "R\0",
            "R\u{1b}[31m",
            "R\u{9f}",
            "R\n",
            "R\u{202e}",
            "R\u{ffff}",
            "R\\xE9",
            "Süd",
            &long,
            &long[1..],
        ];
        let levels: HashSet<String> = names.iter().map(|name| level(name)).collect();
        assert_eq!(levels.len(), names.len(), "{levels:?}");
        for level in &levels {
            assert!(level.len() <= LEVEL_BYTES && !level.contains(SPECIAL), "{level}");
            assert!(!level.contains(text::is_hidden), "{level:?}");
        }
        assert_eq!(
            (level("R01"), level("Süd"), level("R/1\n")),
            ("R01".into(), "Süd".into(), "R%2F1%0A".into())
        );
    }

    #[test]
    fn a_broker_that_hangs_up_on_a_message_is_there() {
        let ended = |reason_code| {
            ConnectionError::MqttState(StateError::ServerDisconnect { reason_code, reason_string: None })
        };
        let aborted = || ConnectionError::MqttState(StateError::ConnectionAborted);
        let too_large =
            ConnectionError::MqttState(StateError::OutgoingPacketTooLarge { pkt_size: 9, max: 8 });
        for (error, is_sent, expected) in [
            (ended(DisconnectReasonCode::MalformedPacket), true, SendError::never("x")),
            (ended(DisconnectReasonCode::TopicNameInvalid), true, SendError::never("x")),
            (ended(DisconnectReasonCode::QuotaExceeded), true, SendError::refused("x")),
            (ended(DisconnectReasonCode::ServerShuttingDown), true, SendError::unreached("x")),
            (ended(DisconnectReasonCode::MalformedPacket), false, SendError::unreached("x")),
            (aborted(), true, SendError::refused("x")),
            (aborted(), false, SendError::unreached("x")),
            (too_large, false, SendError::never("x")),
        ] {
            assert_eq!(failure("x".into(), &error, is_sent), expected, "{error}");
        }
    }
}
