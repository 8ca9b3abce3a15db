//! The outbox: events of anomalies and their deliveries to receivers.

pub(super) mod event;
pub(super) mod alarm;
pub(super) mod routes;
pub(super) mod clock;
pub(super) mod queue;
pub(super) mod reminders;
#[cfg(test)]
mod tests;
