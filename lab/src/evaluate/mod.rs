//! Detectors on simulated fleets: robots that are drawn, with summaries of their tests, through the detectors of the
//! program and through simple ones.
//!
//! This is the fast road: it draws the figures that detectors read, not torques. Geometry, bodies, friction, warmth,
//! noise, test programs and events are drawn for each robot from ranges of their own; none is a number of `simulate`.
//! Identified parameters answer to an event as least squares on a drawn test motion do, friction indices as maps
//! fitted on the robot's first tests do. `docs/evidence/detection.md` says what is measured and what is not.

mod arm;
mod design;
pub mod detectors;
mod draws;
mod event;
pub mod fleet;
mod friction_index;
mod history;
pub mod rates;
pub mod recorded;
pub mod scenario;
pub mod score;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod open_tests;
