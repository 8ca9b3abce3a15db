//! `armwatch quarantine`.

pub(super) mod command;
pub(super) mod story;
