//! `armwatch-lab benchmark`.

mod child_daemon;
mod processor_time;
mod shipped_queries;
mod soak_writers;
pub(super) mod coverage;
pub(super) mod daemons;
pub(super) mod history;
pub(super) mod soak;
pub(super) mod stages;
pub(super) mod start;
pub(super) mod throughput;
