//! MQTT 5: each message is published with quality of service 1 and done when the broker acknowledges it.

use rumqttc::mqttbytes::v5::PubAckReason;
use rumqttc::{AsyncClient, MqttOptions, PublishOptions, PublishResult, QoS, TlsConfiguration, Transport};

use crate::alert::message::Message;
use crate::alert::receiver::{Receiver, SendError, Sending, Unusable};
use crate::alert::{secret, tls};
use armwatch_config::{Encryption, MqttSettings};

/// Requests that wait for the connection: the one message, and one more.
const REQUESTS: usize = 2;

/// Publishes messages.
pub(super) struct Mqtt {
    settings: MqttSettings,
    transport: Transport,
}

impl Mqtt {
    pub(super) fn new(settings: &MqttSettings) -> Result<Self, Unusable> {
        if let Some((_, password)) = &settings.login {
            secret::read(password).map_err(Unusable)?;
        }
        let transport = match settings.encryption {
            Encryption::None => Transport::Tcp,
            _ => Transport::Tls(TlsConfiguration::Rustls(tls::client(settings.ca_file.as_deref())?)),
        };
        Ok(Self { settings: settings.clone(), transport })
    }

    async fn publish(&self, message: &Message) -> Result<(), SendError> {
        let MqttSettings { host, port, timeout, .. } = &self.settings;
        // two connections of one name would end each other
        let name = format!("armwatch-{}-{}", message.origin.identity, message.route);
        let mut options = MqttOptions::new(name, (host.as_str(), *port));
        options.set_transport(self.transport.clone());
        if let Some((user, password)) = &self.settings.login {
            let password = secret::read(password).map_err(SendError::unreached)?;
            options.set_credentials(user.clone(), password);
        }
        let (client, mut connection) = AsyncClient::builder(options).capacity(REQUESTS).build();
        let topic = topic(&self.settings.topic, message);
        let publishing = async {
            let payload = message.json().to_string();
            let failed = |error: String| SendError::unreached(format!("{host}:{port}: {error}"));
            let notice = client
                .publish_tracked(topic, payload, PublishOptions::new(QoS::AtLeastOnce))
                .await
                .map_err(|error| failed(error.to_string()))?;
            match notice.wait_async().await.map_err(|error| failed(error.to_string()))? {
                PublishResult::Qos1(answer) => match answer.reason {
                    PubAckReason::Success | PubAckReason::NoMatchingSubscribers => Ok(()),
                    reason => Err(SendError::refused(format!("{host}:{port}: the broker says {reason:?}"))),
                },
                _ => Ok(()),
            }
        };
        let driving = async {
            loop {
                if let Err(error) = connection.poll().await {
                    return SendError::unreached(format!("{host}:{port}: {error}"));
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

/// Robot and anomaly as levels below the configured ones; characters that mean something in topics become `_`.
fn topic(prefix: &str, message: &Message) -> String {
    match message.alarms.as_slice() {
        [alarm] if !message.is_digest => {
            let robot = alarm.event.robot.replace(['/', '+', '#', '\0'], "_");
            format!("{prefix}/{robot}/{}", alarm.event.anomaly_id)
        }
        _ => format!("{prefix}/digest"),
    }
}
