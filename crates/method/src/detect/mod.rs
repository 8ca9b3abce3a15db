//! Detectors of changes over the runs of a robot.

mod verdict;
pub mod rate;
pub mod control_chart;
mod detector;
mod episodes;
pub mod load_message;
pub mod window;
pub mod runs;
pub mod production;
