//! `armwatch benchmark`.

pub(super) mod coverage;
pub(super) mod history;
pub(super) mod stages;
pub(super) mod throughput;
