//! The settled part of a history.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::Anomaly;
use crate::run::RunKind;

/// A run's place in time: its start and its key.
pub type Moment = (Timestamp, i64);

/// The settled part of a history, as far as later windows need it. The default value has nothing settled.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Settled {
    /// Runs before the boundary when it was settled.
    pub runs: usize,
    /// Keys of the runs of the window before those that lead in, oldest first.
    pub read: Vec<i64>,
    /// The first of those that lead in to the boundary.
    pub leads_from: Option<Moment>,
    /// The first run that is not settled.
    pub boundary: Option<Moment>,
    /// The latest run that all of this depends on.
    pub follows_until: Option<Moment>,
    /// Keys of the runs with which epochs of joints began before those that lead in.
    pub first_of_epochs: Vec<i64>,
    /// Number of each joint's epochs by then, by position of the joint.
    pub epochs: Vec<u32>,
    /// Anomalies that continue beyond the boundary.
    pub open: Vec<Anomaly>,
}

/// A part of a history that a conclusion settles.
#[derive(Debug, Clone, PartialEq)]
pub struct NewlySettled {
    /// The history: that of tests, or of production logs.
    pub kind: RunKind,
    /// The settled part.
    pub settled: Settled,
    /// Anomalies that ended before its boundary.
    pub ended: Vec<Anomaly>,
}
