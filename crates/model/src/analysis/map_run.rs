//! A run as input for the fit of friction maps.

use super::{CycleTemperatures, FrictionPoint};

/// An interval of motion of all joints.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleMotion {
    /// Start, s.
    pub start: f64,
    /// End, s.
    pub end: f64,
    /// Mean magnitude of each joint's velocity, rad/s (m/s), `[n]`; empty if unknown.
    pub speeds: Vec<f64>,
    /// Mean temperatures, if recorded.
    pub temperatures: CycleTemperatures,
}

/// Motion and friction points of one run.
#[derive(Debug, Clone, PartialEq)]
pub struct MapRun {
    /// Start of the recording, UTC, s.
    pub started_at: f64,
    /// Motion, times since the start, s; ascending, without overlap.
    pub spans: Vec<CycleMotion>,
    /// Plateaus of the friction stages, times since the start, s.
    pub points: Vec<FrictionPoint>,
}
