//! `[alerts]`: receivers of alarms, and the delivery.

pub(super) mod language;
pub(super) mod settings;
mod values;
pub mod receivers;
pub(super) mod routes;
