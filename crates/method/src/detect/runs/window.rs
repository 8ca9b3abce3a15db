//! Windows of tests: the tests that baselines and limits are learnt from.

use std::collections::BTreeSet;

use super::history::like_length::{has_parameters, of_like_length};
use crate::detect::window::Windowed;
use armwatch_model::analysis::JointSummary;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::anomaly::settled::Moment;
use armwatch_model::robot::JointIndex;

impl Windowed for RunSummary {
    fn moment(&self) -> Moment {
        (self.started_at, self.run_id)
    }

    fn epochs(&self) -> &[u32] {
        &self.epochs
    }

    fn says_something(&self) -> bool {
        !self.is_without_result()
    }

    /// The first `count` tests of each epoch, of the joints and of the arm: those with each value that baselines are
    /// learnt from, and for the arm those of similar length.
    fn heads(window: &[Self], until: usize, count: usize) -> BTreeSet<usize> {
        heads(window, until, count)
    }
}

fn heads(window: &[RunSummary], until: usize, count: usize) -> BTreeSet<usize> {
    let mut found = BTreeSet::new();
    let joints = window.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    for joint in (0..joints).map(JointIndex::new) {
        let lasting: BTreeSet<u32> = window[until..].iter().map(|run| run.epoch(joint)).collect();
        let summary = |run: &RunSummary| run.joints.iter().find(|of| of.joint == joint).copied();
        for epoch in lasting {
            let of_epoch: Vec<usize> = (0..until).filter(|at| window[*at].epoch(joint) == epoch).collect();
            let mut first = |has: &dyn Fn(&RunSummary) -> bool| {
                found.extend(of_epoch.iter().copied().filter(|at| has(&window[*at])).take(count));
                // the last test with a value
                found.extend(of_epoch.iter().copied().rfind(|at| has(&window[*at])));
            };
            first(&|run| summary(run).is_some_and(|of| JointSummary::has_result(&of)));
            first(&|run| summary(run).is_some_and(|of| of.friction_index.is_some()));
            first(&|run| has_curve(run, joint));
        }
    }
    let mut lasting: Vec<&[u32]> = window[until..].iter().map(|run| &run.epochs[..]).collect();
    lasting.sort_unstable();
    lasting.dedup();
    for epochs in lasting {
        let of_arm: Vec<usize> = (0..window.len()).filter(|at| window[*at].epochs[..] == *epochs).collect();
        for group in of_like_length(of_arm.iter().map(|at| &window[*at])) {
            let of_group = group.into_iter().map(|at| of_arm[at]).filter(|at| *at < until);
            found.extend(of_group.filter(|at| has_parameters(&window[*at])).take(count));
        }
    }
    found
}

/// Returns true if a test has friction of a joint by cycle.
fn has_curve(run: &RunSummary, joint: JointIndex) -> bool {
    run.cycle_friction.iter().any(|of| of.friction.joint == joint)
}

#[cfg(test)]
mod tests;
