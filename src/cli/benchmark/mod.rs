//! `armwatch benchmark`.

pub(super) mod coverage;
pub(super) mod throughput;
