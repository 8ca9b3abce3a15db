//! The settled part of a history, and the quantities of anomalies.

use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize};

use super::Anomaly;
use crate::run::RunKind;

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

/// The name of a quantity. Not written as a reference, which derived readers would borrow from their input.
pub type QuantityName = &'static str;

/// Reads the name of a quantity.
pub(super) fn read_quantity<'de, D: Deserializer<'de>>(from: D) -> Result<QuantityName, D::Error> {
    let name = String::deserialize(from)?;
    quantity(&name).ok_or_else(|| serde::de::Error::custom(format!("no anomaly has the quantity {name}")))
}

/// A run's place in time: its start and its key.
pub type Moment = (Timestamp, i64);

/// The settled part of a history, as far as later windows need it. Nothing is settled in a default value.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Settled {
    /// Runs before the boundary when it was settled.
    pub runs: usize,
    /// Keys of the runs of the window that come before those that lead in, oldest first.
    pub read: Vec<i64>,
    /// The first of those that lead in to the boundary.
    pub leads_from: Option<Moment>,
    /// The first run that is not settled.
    pub boundary: Option<Moment>,
    /// The latest run that all of this follows from.
    pub follows_until: Option<Moment>,
    /// Keys of the runs with which epochs of joints began before those that lead in.
    pub first_of_epochs: Vec<i64>,
    /// How many epochs each joint had by then, by position of the joint.
    pub epochs: Vec<u32>,
    /// Anomalies that go on beyond the boundary.
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
