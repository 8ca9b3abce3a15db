//! Windows of production logs: the logs that levels are learnt from.

use std::collections::{BTreeMap, BTreeSet};

use crate::detect::window::Windowed;
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::anomaly::settled::Moment;
use armwatch_model::robot::JointIndex;

/// Tests before the lead-in whose logs determine median and scatter of the levels. Half of them are the first ones, so
/// that a long-lasting rise does not become usual.
const TESTS: usize = 24;

/// A log with its comparison with each of its tests, at least one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorkLog<'a>(&'a [ProductionSummary]);

/// The logs of a history, oldest first.
#[must_use]
pub fn work_logs(history: &[ProductionSummary]) -> Vec<WorkLog<'_>> {
    history.chunk_by(|a, b| a.run_id == b.run_id).map(WorkLog).collect()
}

impl Windowed for WorkLog<'_> {
    fn moment(&self) -> Moment {
        (self.0[0].started_at, self.0[0].run_id)
    }

    fn epochs(&self) -> &[u32] {
        &[]
    }

    fn says_something(&self) -> bool {
        true
    }

    /// The first `count` logs of each joint after each of the first and of the latest tests: levels are computed from
    /// them.
    fn heads(window: &[Self], until: usize, count: usize) -> BTreeSet<usize> {
        let mut by_test: BTreeMap<i64, BTreeMap<JointIndex, Vec<usize>>> = BTreeMap::new();
        let mut tests = Vec::new();
        for (place, log) in window[..until].iter().enumerate() {
            for of in log.0 {
                if !by_test.contains_key(&of.reference_run_id) {
                    tests.push(of.reference_run_id);
                }
                let logs = by_test.entry(of.reference_run_id).or_default();
                for joint in &of.joints {
                    let first = logs.entry(joint.joint).or_default();
                    if first.len() < count && first.last() != Some(&place) {
                        first.push(place);
                    }
                }
            }
        }
        let (first, later) = tests.split_at(tests.len().min(TESTS / 2));
        let kept = first.iter().chain(later.iter().rev().take(TESTS - first.len()));
        kept.filter_map(|test| by_test.get(test)).flat_map(BTreeMap::values).flatten().copied().collect()
    }
}

#[cfg(test)]
mod tests;
