//! Of a long history, the tests by which a robot is judged: so many that a conclusion of the ten thousandth test costs what that of
//! the thousandth did.
//!
//! Boundaries lie at every [`Lengths::step`]th test in the order of recording. A history of fewer than two steps is judged as a
//! whole. Of a longer one, the latest boundary with a step of tests behind it is in force, and the window has
//!
//! * the first tests of each epoch that goes on: what baselines and limits are learnt from,
//! * the tests about the beginning of each anomaly that is open at the boundary, so that it begins where it began,
//! * some tests that lead in to the boundary, and all tests behind it.
//!
//! What had ended before the boundary is settled and stays as it is. It is what the window before says when a step of tests
//! behind the boundary is known, so that nothing changes as a window takes the place of the one before. What is settled
//! therefore follows from the tests alone, boundary by boundary from the first test on, in whatever order they came.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};

use jiff::Timestamp;

use super::like_length::{has_parameters, of_like_length};
use crate::analysis::JointSummary;
use crate::anomaly::peer::Peer;
use crate::anomaly::{Anomaly, AnomalyKind, RunSummary};
use crate::numerics::detect::verdict::DetectSettings;
use crate::robot::JointIndex;

/// How long the parts of a window are, in tests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lengths {
    /// From one boundary to the next.
    pub step: usize,
    /// Before the boundary; at most a step.
    pub lead: usize,
    /// First ones of an epoch.
    pub head: usize,
    /// On either side of the first one of an open anomaly.
    pub around: usize,
}

/// A year of daily tests, and the next two, are judged as a whole. Sixty-four tests have the baseline, the forty that limits are
/// learnt from and the eight that wait meanwhile; the shape of a change is told from sixty tests before it.
impl Default for Lengths {
    fn default() -> Self {
        Self { step: 500, lead: 250, head: 64, around: 60 }
    }
}

/// Changes whenever the program settles something else in the same history. What another version of the program has settled is
/// not believed either.
const METHOD: (u64, &str) = (4, env!("CARGO_PKG_VERSION"));

/// Hash of what is settled in a history, beside its tests: settings, lengths and the other robots of the model.
#[must_use]
pub fn basis(settings: &DetectSettings, peers: &[Peer], lengths: &Lengths) -> u64 {
    let mut hasher = DefaultHasher::new();
    METHOD.hash(&mut hasher);
    // numbers are written to their last bit
    format!("{settings:?} {lengths:?} {peers:?}").hash(&mut hasher);
    hasher.finish()
}

/// Quantities of anomalies that windows settle.
const QUANTITIES: [&str; 21] = [
    "friction_index",
    "common_friction_ratio",
    "warm_friction_nm",
    "excitation_friction_nm",
    "friction_swing",
    "warm_up_time_ratio",
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
];

/// The quantity of this name; `None` for a name that no anomaly of tests has.
#[must_use]
pub fn quantity(name: &str) -> Option<&'static str> {
    QUANTITIES.iter().find(|known| **known == name).copied()
}

/// A test's place in time: its start and its key.
pub type Moment = (Timestamp, i64);

/// What is settled of a history before a boundary, as far as later windows ask for it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settled {
    /// Tests before the boundary; 0 where a history has none.
    pub tests: usize,
    /// Keys of the tests of the window that stand before those that lead in, oldest first.
    pub read: Vec<i64>,
    /// The first of those that lead in; `None` without a boundary.
    pub leads_from: Option<Moment>,
    /// The latest test that all of this follows from.
    pub follows_until: Option<Moment>,
    /// Keys of the tests with which epochs of joints began before those that lead in, and how many epochs each joint had.
    pub first_of_epochs: Vec<i64>,
    /// By position of the joint.
    pub epochs: Vec<u32>,
    /// Anomalies that go on beyond the boundary.
    pub open: Vec<Anomaly>,
}

impl Lengths {
    /// Most tests, from the first that leads in to the boundary on, that a window may have before another boundary is in
    /// force.
    #[must_use]
    pub fn most_behind(&self, settled: &Settled) -> usize {
        self.lead.min(settled.tests) + 2 * self.step
    }
}

impl Settled {
    /// Place of the first test behind the boundary in the tests of its window.
    fn place(&self, lengths: &Lengths) -> usize {
        self.read.len() + lengths.lead.min(self.tests)
    }

    /// Whether there are so many tests in this window that the next boundary is in force. They end then with the last that
    /// what is settled there follows from.
    #[must_use]
    pub fn is_over(&self, window: &[RunSummary], lengths: &Lengths) -> bool {
        window.len() >= self.place(lengths) + 2 * lengths.step
    }

    /// Anomalies that are not settled, of those `found` in the window: what lies before the boundary is known already, and what
    /// was open there goes on as what it was.
    #[must_use]
    pub fn put_together(
        &self,
        window: &[RunSummary],
        found: Vec<Anomaly>,
        lengths: &Lengths,
    ) -> Vec<Anomaly> {
        if self.tests == 0 {
            return found;
        }
        let places = places(window);
        let boundary = self.place(lengths);
        let is_behind = |of: &Anomaly| places.get(&of.last_run_id).is_some_and(|place| *place >= boundary);
        let known = self.matched(&found);
        let mut together = Vec::with_capacity(found.len());
        for (number, anomaly) in found.into_iter().enumerate() {
            match known.iter().position(|of| *of == Some(number)) {
                Some(open) => together.push(going_on(&self.open[open], anomaly)),
                None if is_behind(&anomaly) => together.push(anomaly),
                None => {}
            }
        }
        // the window shows no more of it
        let gone = self.open.iter().zip(&known).filter(|(_, known)| known.is_none());
        together.extend(gone.map(|(open, _)| Anomaly { ended: true, ..open.clone() }));
        together
    }

    /// For each open anomaly the number of the one found that goes on with it.
    fn matched(&self, found: &[Anomaly]) -> Vec<Option<usize>> {
        let mut pairs = Vec::new();
        for (o, open) in self.open.iter().enumerate() {
            for (n, new) in found.iter().enumerate() {
                let is_at_once =
                    new.first_seen_at <= open.last_seen_at && open.first_seen_at <= new.last_seen_at;
                if open.joint == new.joint && is_of_one_cause(open, new) && is_at_once {
                    let apart = open.first_seen_at.duration_since(new.first_seen_at).abs();
                    pairs.push((open.kind != new.kind, new.ended, apart, o, n));
                }
            }
        }
        pairs.sort_unstable();
        let (mut known, mut used) = (vec![None; self.open.len()], HashSet::new());
        for (.., o, n) in pairs {
            if known[o].is_none() && used.insert(n) {
                known[o] = Some(n);
            }
        }
        known
    }

    /// What is settled at the next boundary, and the anomalies that ended before it. `window` has all tests of the window
    /// that [is over](Self::is_over) and no later ones, `together` what it says.
    #[must_use]
    pub fn next(
        &self,
        window: &[RunSummary],
        together: &[Anomaly],
        lengths: &Lengths,
    ) -> (Self, Vec<Anomaly>) {
        let places = places(window);
        let boundary = self.place(lengths) + lengths.step;
        let leads_from = boundary - lengths.lead.min(lengths.step);
        let place = |run_id: i64| places.get(&run_id).copied();
        let (mut open, mut ended) = (Vec::new(), Vec::new());
        for anomaly in together {
            // a test that is not in the window any more is before it
            let [first, last] = [anomaly.first_run_id, anomaly.last_run_id].map(|of| place(of).unwrap_or(0));
            if anomaly.ended && last < boundary {
                ended.push(anomaly.clone());
            } else if first < boundary {
                open.push(anomaly.clone());
            }
        }
        let mut read: BTreeSet<usize> = heads(window, leads_from, lengths.head);
        for anomaly in &open {
            for of in [anomaly.onset.run_id, anomaly.first_run_id].into_iter().filter_map(place) {
                read.extend(of.saturating_sub(lengths.around)..=of + lengths.around);
            }
        }
        // a test without result says nothing but that, and stands beside others than it did
        read.retain(|at| *at < leads_from && !window[*at].is_without_result());
        let moment = |of: &RunSummary| (of.started_at, of.run_id);
        let (first_of_epochs, epochs) = self.epochs_before(&window[..leads_from]);
        let next = Self {
            tests: self.tests + lengths.step,
            read: read.into_iter().map(|at| window[at].run_id).collect(),
            leads_from: window.get(leads_from).map(moment),
            follows_until: window.last().map(moment),
            first_of_epochs,
            epochs,
            open,
        };
        (next, ended)
    }

    /// Tests with which epochs began, those that were known and those that began in these tests, and epochs of each joint.
    fn epochs_before(&self, tests: &[RunSummary]) -> (Vec<i64>, Vec<u32>) {
        let (mut first, mut known) = (self.first_of_epochs.clone(), self.epochs.clone());
        for run in tests {
            known.resize(known.len().max(run.epochs.len()), 0);
            let mut begins = false;
            for (known, epoch) in known.iter_mut().zip(&run.epochs) {
                begins |= *epoch >= *known;
                *known = (*known).max(epoch + 1);
            }
            if begins {
                first.push(run.run_id);
            }
        }
        (first, known)
    }
}

fn places(window: &[RunSummary]) -> HashMap<i64, usize> {
    window.iter().enumerate().map(|(place, run)| (run.run_id, place)).collect()
}

/// What people hear of as one fault, as for anomalies that are stored: friction changed, or one quantity of one kind.
fn is_of_one_cause(open: &Anomaly, new: &Anomaly) -> bool {
    let is_change = |of: &Anomaly| matches!(of.kind, AnomalyKind::Drift | AnomalyKind::Step);
    (open.kind == new.kind && open.quantity == new.quantity) || (is_change(open) && is_change(new))
}

/// An anomaly as the window shows it, which began as one that was open at the boundary and is of its kind.
fn going_on(open: &Anomaly, found: Anomaly) -> Anomaly {
    let kind = open.kind;
    let mut anomaly = open.clone();
    anomaly.go_on(Anomaly { kind, ..found });
    anomaly
}

/// Places before `until` of the first `count` tests of each epoch, of the joints and of the arm, that is found from there on: of
/// those with each figure that baselines are learnt from, and of the arm those of like length.
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
                // since when there is no figure any more
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

/// Whether a test has friction of a joint by cycle.
fn has_curve(run: &RunSummary, joint: JointIndex) -> bool {
    match run.left_out() {
        Some(brief) => brief.joint(joint.index()).friction > 0,
        None => run.cycle_friction.iter().any(|of| of.friction.joint == joint),
    }
}

#[cfg(test)]
mod tests;
