//! `[alerts]`: who is told of alarms, and how.

pub(super) mod settings;
mod values;
pub(super) mod receivers;
pub(super) mod routes;
