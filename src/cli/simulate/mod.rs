//! `armwatch simulate`.

pub(super) mod arm_options;
pub(super) mod command;
pub(super) mod export_format;
mod files;
pub(super) mod stage_signal;
