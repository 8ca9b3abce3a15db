//! Repairs of recorded rows before any computation: times of arrival and folded angles.

use std::borrow::Cow;

use super::arrival::{ArrivalGrid, take_arrival};
use super::fold::unfold;
use armwatch_model::analysis::finding::Finding;
use armwatch_model::robot::Robot;
use armwatch_model::run::Samples;

/// Repairs of a recording.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Restored {
    /// One sentence for each repair.
    pub remarks: Vec<String>,
    /// Reason why the times of samples are unknown.
    pub unsteady: Option<Finding>,
}

/// Assigns the times of an even grid to rows that were stamped on arrival, and unfolds the angles of rotary joints.
/// Rows that need neither are not copied.
pub fn restore(robot: &Robot, samples: &mut Cow<'_, Samples>) -> Restored {
    let mut restored = Restored::default();
    match take_arrival(samples) {
        Some(ArrivalGrid::Even(remark)) => restored.remarks.push(remark),
        Some(ArrivalGrid::Unsteady(finding)) => restored.unsteady = Some(finding),
        None => {}
    }
    restored.remarks.extend(unfold(robot, samples));
    restored
}
