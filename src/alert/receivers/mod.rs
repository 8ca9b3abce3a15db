//! Receivers, one file each.

mod alertmanager;
mod command;
mod email;
mod labels;
mod log;
mod mqtt;
mod webhook;

use super::receiver::{Receiver, Unusable};
use armwatch_config::Route;
use armwatch_config::receivers::ReceiverSettings;

/// The receiver of a route.
///
/// # Errors
/// [`Unusable`] if it cannot work as configured: an unreadable secret, invalid certificates.
pub fn open(route: &Route) -> Result<Box<dyn Receiver>, Unusable> {
    Ok(match &route.receiver {
        ReceiverSettings::Log(_) => Box::new(log::Log),
        ReceiverSettings::Webhook(settings) => Box::new(webhook::Webhook::new(settings)?),
        ReceiverSettings::Alertmanager(settings) => Box::new(alertmanager::Alertmanager::new(settings)?),
        ReceiverSettings::Email(settings) => Box::new(email::Email::new(settings)?),
        ReceiverSettings::Mqtt(settings) => Box::new(mqtt::Mqtt::new(settings)?),
        ReceiverSettings::Command(settings) => Box::new(command::CommandReceiver::new(settings)),
    })
}
