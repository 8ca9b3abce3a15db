//! Detectors: what changes over the runs of a robot.

pub mod runs;
mod friction;
mod results;
pub mod verdict;
pub mod production;
