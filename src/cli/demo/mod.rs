//! `armwatch demo`: a small fleet, from simulated exports to findings.

pub(super) mod command;
mod fleet;
mod verdict;
