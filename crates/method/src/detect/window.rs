//! The window: the part of a long history that detectors use. A conclusion after the ten thousandth run costs as much as one after the
//! thousandth.
//!
//! Tests and logs of production are histories of their own. Boundaries are at every [`Lengths::step`]th run in the order of
//! recording. A history of fewer than two steps is judged as a whole. In a longer one, the latest boundary with a step of runs
//! behind it is in force, and the window contains
//!
//! * the runs that baselines and limits of later runs are learnt from ([`Windowed::heads`]),
//! * the runs around the beginning of each anomaly that is open at the boundary, so that its beginning stays,
//! * some runs that lead in to the boundary, and all runs behind it.
//!
//! Anomalies that ended before the boundary are settled and stay as they are. They are those of the window before, when a step
//! of runs behind the boundary is known. A run that arrives later with a start before the boundary is not judged.

use std::collections::{BTreeSet, HashMap, HashSet};

use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{Anomaly, AnomalyKind};

/// How long the parts of a window are, in runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lengths {
    /// From one boundary to the next.
    pub step: usize,
    /// Before the boundary; at most a step.
    pub lead: usize,
    /// First ones of an epoch, or of the logs behind a test.
    pub head: usize,
    /// On either side of the first one of an open anomaly.
    pub around: usize,
}

impl Lengths {
    /// Of tests. A year of daily ones, and the next two, are judged as a whole. Sixty-four tests have the baseline, the forty that
    /// limits are learnt from and the eight that wait meanwhile; the shape of a change is told from sixty tests before it.
    pub const OF_TESTS: Self = Self { step: 500, lead: 250, head: 64, around: 60 };
    /// Of logs of ordinary work. Those of three weeks, where one is written an hour, are judged as a whole. The level behind a test
    /// stands on its first three logs, of which some may be of other work; what is usual from log to log is learnt from
    /// those that lead in.
    pub const OF_LOGS: Self = Self { step: 250, lead: 125, head: 6, around: 8 };
}

/// A run of a history, as windows see it.
pub trait Windowed: Sized {
    /// Its place in time.
    fn moment(&self) -> Moment;

    /// Epochs of the joints that begin with it, by position: how often a joint was worked on before. Empty where it has none.
    fn epochs(&self) -> &[u32];

    /// Whether it says something beside that it is there: what does not stands beside other runs than it did, and is left out.
    fn says_something(&self) -> bool;

    /// Places before `until` of what baselines and limits are learnt from that hold from there on: of each, `count` runs.
    fn heads(window: &[Self], until: usize, count: usize) -> BTreeSet<usize>;
}

/// Place of the first run behind the boundary in the runs of its window.
fn place(settled: &Settled, window: &[impl Windowed]) -> usize {
    settled.boundary.map_or(0, |boundary| window.partition_point(|run| run.moment() < boundary))
}

/// Whether there are so many runs in this window that the next boundary is in force. They end then with the last that
/// what is settled there follows from.
#[must_use]
pub fn is_over(settled: &Settled, window: &[impl Windowed], lengths: &Lengths) -> bool {
    window.len() >= place(settled, window) + 2 * lengths.step
}

/// Anomalies that are not settled, of those `found` in the window: what lies before the boundary is known already, and what
/// was open there goes on as what it was.
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
    // the window shows no more of it
    let gone = settled.open.iter().zip(&known).filter(|(_, known)| known.is_none());
    together.extend(gone.map(|(open, _)| Anomaly { ended: true, ..open.clone() }));
    together
}

/// For each open anomaly the number of the one found that goes on with it.
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

/// What is settled at the next boundary, and the anomalies that ended before it. `window` has all runs of the window
/// that [is over](is_over) and no later ones, `together` what it says.
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
        // a run that is not in the window any more is before it
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

/// Runs with which epochs began, those that were known and those that began in these runs, and epochs of each joint.
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

/// What people hear of as one fault, as for anomalies that are stored: friction changed, or one quantity of one kind.
fn is_of_one_cause(open: &Anomaly, new: &Anomaly) -> bool {
    let is_change = |of: &Anomaly| matches!(of.kind, AnomalyKind::Drift | AnomalyKind::Step);
    (open.kind == new.kind && open.quantity.is_of_one_cause(new.quantity))
        || (is_change(open) && is_change(new))
}

/// An anomaly as the window shows it, which began as one that was open at the boundary and is of its kind.
fn going_on(open: &Anomaly, found: Anomaly) -> Anomaly {
    let kind = open.kind;
    let mut anomaly = open.clone();
    anomaly.go_on(Anomaly { kind, ..found });
    anomaly
}

#[cfg(test)]
pub(in crate::detect) mod fixtures;
