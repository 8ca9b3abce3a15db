//! The window: the part of a long history that detectors use. A conclusion after the ten thousandth run costs as much
//! as one after the thousandth.
//!
//! Tests and production logs are separate histories. Boundaries are at every [`Lengths::step`]th run in the order of
//! recording. A history of fewer than two steps is evaluated as a whole. In a longer one, the latest boundary with a
//! step of runs after it is in force, and the window contains
//!
//! * the runs that baselines and limits of later runs are learnt from ([`Windowed::heads`]),
//! * the runs around the onset of each anomaly that is open at the boundary, so that its onset stays,
//! * some lead-in runs before the boundary, and all runs after it.
//!
//! Anomalies that ended before the boundary are settled and do not change. They are those of the previous window at the
//! time when a step of runs after the boundary is known. A run that arrives later with a start before the boundary is
//! not evaluated.

use std::collections::{BTreeSet, HashMap, HashSet};

use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{Anomaly, AnomalyKind};

/// Lengths of the parts of a window, in runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lengths {
    /// From one boundary to the next.
    pub step: usize,
    /// Lead-in before the boundary; at most a step.
    pub lead: usize,
    /// First runs of an epoch, or first logs after a test.
    pub head: usize,
    /// Runs on either side of the first run of an open anomaly.
    pub around: usize,
}

impl Lengths {
    /// Lengths for tests. Daily tests of two and a half years are evaluated as a whole. Sixty-four tests contain the
    /// baseline, the forty that limits are learnt from, and the eight that wait before they are learnt. The shape of a
    /// change depends on the sixty tests before it.
    pub const OF_TESTS: Self = Self { step: 500, lead: 250, head: 64, around: 60 };
    /// Lengths for production logs. Hourly logs of three weeks are evaluated as a whole. The level after a test is the
    /// median of its first three logs, and some of these may be of other work. The usual difference from log to log is
    /// learnt from the lead-in.
    pub const OF_LOGS: Self = Self { step: 250, lead: 125, head: 6, around: 8 };
}

/// A run of a history, as needed by windows.
pub trait Windowed: Sized {
    /// Position in time.
    fn moment(&self) -> Moment;

    /// Epochs of the joints that begin with it, by position: the number of earlier maintenances of the joint. Empty if
    /// it has none.
    fn epochs(&self) -> &[u32];

    /// True if the run has a result. A run without one is omitted: its neighbours in the window differ from those in
    /// the history.
    fn says_something(&self) -> bool;

    /// Places before `until` of the runs that baselines and limits after `until` are learnt from: `count` runs of each.
    fn heads(window: &[Self], until: usize, count: usize) -> BTreeSet<usize>;
}

/// Place of the first run after the boundary in the window.
fn place(settled: &Settled, window: &[impl Windowed]) -> usize {
    settled.boundary.map_or(0, |boundary| window.partition_point(|run| run.moment() < boundary))
}

/// Returns true if the window has enough runs for the next boundary. The window then ends with the last run that the
/// settled anomalies depend on.
#[must_use]
pub fn is_over(settled: &Settled, window: &[impl Windowed], lengths: &Lengths) -> bool {
    window.len() >= place(settled, window) + 2 * lengths.step
}

/// Anomalies that are not settled, from those `found` in the window. Those before the boundary are known already. Those
/// that were open at the boundary continue under their first kind and onset.
#[must_use]
pub fn put_together(settled: &Settled, window: &[impl Windowed], found: Vec<Anomaly>) -> Vec<Anomaly> {
    if settled.boundary.is_none() {
        return found;
    }
    let places = places(window);
    let boundary = place(settled, window);
    let is_behind = |of: &Anomaly| places.get(&of.last_run_id).is_some_and(|place| *place >= boundary);
    let known = matched(settled, &found);
    let mut together = Vec::with_capacity(found.len());
    for (number, anomaly) in found.into_iter().enumerate() {
        match known.iter().position(|of| *of == Some(number)) {
            Some(open) => together.push(going_on(&settled.open[open], anomaly)),
            None if is_behind(&anomaly) => together.push(anomaly),
            None => {}
        }
    }
    // open anomalies that the window no longer shows have ended
    let gone = settled.open.iter().zip(&known).filter(|(_, known)| known.is_none());
    together.extend(gone.map(|(open, _)| Anomaly { ended: true, ..open.clone() }));
    together
}

/// For each open anomaly, the index of the found anomaly that continues it.
fn matched(settled: &Settled, found: &[Anomaly]) -> Vec<Option<usize>> {
    let mut pairs = Vec::new();
    for (o, open) in settled.open.iter().enumerate() {
        for (n, new) in found.iter().enumerate() {
            let is_at_once = new.first_seen_at <= open.last_seen_at && open.first_seen_at <= new.last_seen_at;
            if open.joint == new.joint && is_of_one_cause(open, new) && is_at_once {
                let apart = open.first_seen_at.duration_since(new.first_seen_at).abs();
                pairs.push((open.kind != new.kind, new.ended, apart, o, n));
            }
        }
    }
    pairs.sort_unstable();
    let (mut known, mut used) = (vec![None; settled.open.len()], HashSet::new());
    for (.., o, n) in pairs {
        if known[o].is_none() && used.insert(n) {
            known[o] = Some(n);
        }
    }
    known
}

/// State at the next boundary, and the anomalies that ended before it. `window` has all runs of the window that [is
/// over](is_over) and no later ones; `together` has its anomalies.
#[must_use]
pub fn next(
    settled: &Settled,
    window: &[impl Windowed],
    together: &[Anomaly],
    lengths: &Lengths,
) -> (Settled, Vec<Anomaly>) {
    let places = places(window);
    let boundary = place(settled, window) + lengths.step;
    let leads_from = boundary - lengths.lead.min(lengths.step);
    let place_of = |run_id: i64| places.get(&run_id).copied();
    let (mut open, mut ended) = (Vec::new(), Vec::new());
    for anomaly in together {
        // a run that is no longer in the window was before it
        let [first, last] = [anomaly.first_run_id, anomaly.last_run_id].map(|of| place_of(of).unwrap_or(0));
        if anomaly.ended && last < boundary {
            ended.push(anomaly.clone());
        } else if first < boundary {
            open.push(anomaly.clone());
        }
    }
    let mut read: BTreeSet<usize> = Windowed::heads(window, leads_from, lengths.head);
    for anomaly in &open {
        for of in [anomaly.onset.run_id, anomaly.first_run_id].into_iter().filter_map(place_of) {
            read.extend(of.saturating_sub(lengths.around)..=of + lengths.around);
        }
    }
    read.retain(|at| *at < leads_from && window[*at].says_something());
    let (first_of_epochs, epochs) = epochs_before(settled, &window[..leads_from]);
    let next = Settled {
        runs: settled.runs + lengths.step,
        read: read.into_iter().map(|at| window[at].moment().1).collect(),
        leads_from: window.get(leads_from).map(Windowed::moment),
        boundary: window.get(boundary).map(Windowed::moment),
        follows_until: window.last().map(Windowed::moment),
        first_of_epochs,
        epochs,
        open,
    };
    (next, ended)
}

/// Runs that began epochs, both earlier ones and those among these runs, and the number of epochs of each joint.
fn epochs_before(settled: &Settled, runs: &[impl Windowed]) -> (Vec<i64>, Vec<u32>) {
    let (mut first, mut known) = (settled.first_of_epochs.clone(), settled.epochs.clone());
    for run in runs {
        known.resize(known.len().max(run.epochs().len()), 0);
        let mut begins = false;
        for (known, epoch) in known.iter_mut().zip(run.epochs()) {
            begins |= *epoch >= *known;
            *known = (*known).max(epoch + 1);
        }
        if begins {
            first.push(run.moment().1);
        }
    }
    (first, known)
}

fn places(window: &[impl Windowed]) -> HashMap<i64, usize> {
    window.iter().enumerate().map(|(place, run)| (run.moment().1, place)).collect()
}

/// Returns true if both are one fault to users, as for stored anomalies: changed friction, or one quantity of one kind.
fn is_of_one_cause(open: &Anomaly, new: &Anomaly) -> bool {
    let is_change = |of: &Anomaly| matches!(of.kind, AnomalyKind::Drift | AnomalyKind::Step);
    (open.kind == new.kind && open.quantity.is_of_one_cause(new.quantity))
        || (is_change(open) && is_change(new))
}

/// The open anomaly, continued by the one that the window shows; it keeps its kind.
fn going_on(open: &Anomaly, found: Anomaly) -> Anomaly {
    let kind = open.kind;
    let mut anomaly = open.clone();
    anomaly.go_on(Anomaly { kind, ..found });
    anomaly
}

#[cfg(test)]
pub(in crate::detect) mod fixtures;
