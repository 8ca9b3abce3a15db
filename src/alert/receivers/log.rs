//! The log of the program.

use crate::alert::message::{Alarm, Message};
use crate::alert::receiver::{Receiver, Sending};
use armwatch_model::anomaly::Severity;

/// Logs each alarm of a message as a line.
pub(super) struct Log;

impl Receiver for Log {
    fn send<'a>(&'a self, message: &'a Message) -> Sending<'a> {
        message.alarms.iter().for_each(log);
        Box::pin(std::future::ready(Ok(())))
    }
}

/// Logs a line at the level of the severity; ended alarms are logged as information.
fn log(alarm: &Alarm) {
    let event = &alarm.event;
    let (robot, joint, kind) = (&event.robot, event.joint, event.kind.name());
    let (quantity, anomaly_id, what) = (event.quantity.name(), event.anomaly_id, event.what.name());
    let (severity, score) = (event.severity.name(), event.score);
    let text = alarm.sentence();
    match event.severity {
        _ if alarm.is_closed() => {
            tracing::info!(robot, joint, kind, quantity, severity, score, anomaly_id, what, "{what}; {text}");
        }
        Severity::Info => {
            tracing::info!(robot, joint, kind, quantity, severity, score, anomaly_id, what, "{text}")
        }
        Severity::Warning => {
            tracing::warn!(robot, joint, kind, quantity, severity, score, anomaly_id, what, "{text}")
        }
        Severity::Critical => {
            tracing::error!(robot, joint, kind, quantity, severity, score, anomaly_id, what, "{text}")
        }
    }
}
