//! The settled part of a history.

use jiff::Timestamp;

use super::Anomaly;

/// A run's place in time: its start and its key.
pub type Moment = (Timestamp, i64);

/// What is settled of a history before a boundary, as far as later windows ask for it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settled {
    /// Runs before the boundary; 0 where a history has none.
    pub runs: usize,
    /// Keys of the runs of the window that stand before those that lead in, oldest first.
    pub read: Vec<i64>,
    /// The first of those that lead in; `None` without a boundary.
    pub leads_from: Option<Moment>,
    /// The latest run that all of this follows from.
    pub follows_until: Option<Moment>,
    /// Keys of the runs with which epochs of joints began before those that lead in, and how many epochs each joint had.
    pub first_of_epochs: Vec<i64>,
    /// By position of the joint.
    pub epochs: Vec<u32>,
    /// Anomalies that go on beyond the boundary.
    pub open: Vec<Anomaly>,
}
