//! `armwatch simulate`.

pub(super) mod arm_options;
pub(super) mod command;
pub(super) mod export_format;
pub(super) mod stage_signal;
