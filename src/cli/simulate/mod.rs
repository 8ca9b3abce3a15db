//! `armwatch simulate`.

pub(super) mod command;
pub(super) mod export_format;
pub(super) mod stage_signal;
