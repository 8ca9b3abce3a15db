//! Evaluates detectors on simulated fleets: summaries of tests of randomly drawn robots are passed to the program's
//! detectors and to simple ones.
//!
//! This is the fast method: it draws the values that detectors read, not torques. Geometry, bodies, friction,
//! temperature, noise, test programmes and events are drawn for each robot from separate ranges; no value comes from
//! `simulate`. Identified parameters respond to an event like least squares on a drawn test motion, friction indices
//! like maps fitted to the robot's first tests. `docs/evidence/detection.md` lists the measured properties and the
//! omitted ones.

mod arm;
mod design;
pub mod detectors;
mod draws;
mod event;
pub mod fleet;
mod friction_index;
mod history;
pub mod recorded;
pub mod scenario;
pub mod score;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod open_tests;
