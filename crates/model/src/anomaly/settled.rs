//! What is settled of a history, and the quantities of anomalies.

use jiff::Timestamp;

use super::Anomaly;

/// Quantities of anomalies.
pub const QUANTITIES: [&str; 26] = [
    "friction_index",
    "common_friction_ratio",
    "warm_friction_nm",
    "excitation_friction_nm",
    "friction_swing",
    "warm_up_time_ratio",
    "common_warm_up_time_ratio",
    "moving_relative_rmsd",
    "friction_of_model_nm",
    "rmsd_of_model",
    "load_kg",
    "torque_signal",
    "position_offset_rad",
    "unexplained_torque",
    "inertial_parameters",
    "contact",
    "position_signal",
    "velocity_signal",
    "time_stamps",
    "rows",
    "motion",
    "model",
    "production_friction",
    "production_relative_rmsd",
    "production_torque_signal",
    "production_load_kg",
];

/// The quantity of this name; `None` for a name that no anomaly has.
#[must_use]
pub fn quantity(name: &str) -> Option<&'static str> {
    QUANTITIES.iter().find(|known| **known == name).copied()
}

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
