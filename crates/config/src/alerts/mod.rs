//! `[alerts]`: who is told of alarms, and how.

pub(super) mod language;
pub(super) mod settings;
mod values;
pub mod receivers;
pub(super) mod routes;
