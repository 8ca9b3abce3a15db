//! Detectors: what changes over the runs of a robot.

pub mod verdict;
mod control_chart;
mod detector;
mod episodes;
pub mod runs;
pub mod production;
