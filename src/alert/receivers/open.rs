//! From the configuration to a receiver.

use super::alertmanager::Alertmanager;
use super::command::CommandReceiver;
use super::email::Email;
use super::log::Log;
use super::mqtt::Mqtt;
use super::webhook::Webhook;
use crate::alert::receiver::{Receiver, Unusable};
use armwatch_config::{ReceiverSettings, Route};

/// The receiver of a route.
///
/// # Errors
/// [`Unusable`] if it cannot work as it is configured: a secret that cannot be read, certificates that are none.
pub fn open(route: &Route) -> Result<Box<dyn Receiver>, Unusable> {
    Ok(match &route.receiver {
        ReceiverSettings::Log => Box::new(Log),
        ReceiverSettings::Webhook(settings) => Box::new(Webhook::new(settings)?),
        ReceiverSettings::Alertmanager(settings) => Box::new(Alertmanager::new(settings)?),
        ReceiverSettings::Email(settings) => Box::new(Email::new(settings)?),
        ReceiverSettings::Mqtt(settings) => Box::new(Mqtt::new(settings)?),
        ReceiverSettings::Command(settings) => Box::new(CommandReceiver::new(settings)),
    })
}
