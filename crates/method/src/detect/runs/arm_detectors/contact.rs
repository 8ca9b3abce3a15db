//! Contact: something pushes or holds the arm for a part of one cycle.
//!
//! The quantity is the moving relative RMSD of a joint over a whole cycle, all stages, under the cycle's own
//! parameters. A push of seconds shows in it anywhere in the cycle, and only in that cycle. The distance of a cycle
//! from its neighbours is the logarithm of its RMSD over the larger one of the cycles before and after. A cold arm fits
//! badly in its first cycle, better in the second, and so on: that is no peak. So the first cycle of a test is never
//! checked, the second only if it is worse than the cold first one, and none without accepted neighbours or after a
//! pause.
//!
//! A cycle is out if its RMSD exceeds its neighbours by a half at least, by more than chance at the set rate of false
//! alarms (Student's distribution with the joint's own scatter about its neighbours), and by half as much again as in
//! any of the latest 1,600 cycles. If all joints are out, the arm was cold, and nothing is reported. A test whose
//! likeliest cause for the joint is a step or swing of friction has its cause already.
//!
//! This is no [`Detector`](crate::detect::detector::Detector): a push loads several joints, and one alarm names them.

use std::collections::VecDeque;

use jiff::Timestamp;

use crate::detect::episodes::episodes;
use crate::detect::rate::budget::{Budget, beyond_chance};
use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::curve::run_cause::RunCause;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::robust_deviation;
use armwatch_model::anomaly::cycle_peaks::{Cycles, Peaks, pauses, peaks};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

/// Least ratio of a cycle to its neighbours.
const LEAST_RATIO: f64 = 1.5;
/// Least distance as a multiple of the largest distance of earlier cycles, in logarithms.
const BEYOND_EARLIER: f64 = 1.5;
/// Least standard deviation of a cycle about its neighbours, in logarithms.
const LEAST_SPREAD: f64 = 0.05;
/// Fewest and most cycles for the usual scatter.
const FEWEST_CYCLES: usize = 24;
const MOST_CYCLES: usize = 400;
/// Number of latest cycles whose largest distance is remembered.
const MOST_PEAKS: usize = 1600;

/// Usual distances of a joint's cycles from their neighbours.
#[derive(Debug, Clone, PartialEq, Default)]
struct UsualPeaks {
    /// Distances by test, for as many latest tests as contain [`MOST_CYCLES`] distances.
    tests: VecDeque<Vec<f64>>,
    /// Number of distances in `tests`.
    count: usize,
    /// Number of cycles and largest distance by test, for as many latest tests as contain [`MOST_PEAKS`] cycles.
    peaks: VecDeque<(usize, f64)>,
    /// Number of cycles in `peaks`.
    peak_count: usize,
}

/// Usual distances of the cycles of all joints, in the tests so far.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::detect::runs) struct UsualContacts {
    joints: Vec<UsualPeaks>,
}

/// A cycle of one joint that exceeds its neighbours.
struct Peak {
    cycle: u32,
    /// Its distance and the least distance that counts, in logarithms.
    by: f64,
    least: f64,
    value: f64,
    beside: f64,
}

impl UsualContacts {
    /// Initial state for a robot with this number of joints.
    pub(in crate::detect::runs) fn new(joints: usize) -> Self {
        Self { joints: vec![UsualPeaks::default(); joints] }
    }

    /// Usual distances of these tests, oldest first.
    pub(in crate::detect::runs) fn of(runs: &[RunSummary], joints: usize) -> Self {
        let mut usual = Self::new(joints);
        runs.iter().for_each(|run| usual.learn(peaks(run, joints)));
        usual
    }

    /// Learns a test without a contact.
    fn learn(&mut self, peaks: Vec<Peaks>) {
        for (usual, Peaks { distances, furthest }) in self.joints.iter_mut().zip(peaks) {
            usual.remember(distances.len(), furthest);
            usual.count += distances.len();
            if !distances.is_empty() {
                usual.tests.push_back(distances);
            }
            while let Some(first) = usual.tests.front()
                && usual.count - first.len() >= MOST_CYCLES
            {
                usual.count -= first.len();
                usual.tests.pop_front();
            }
        }
    }

    /// Returns true if a cycle of a test may exceed its neighbours by more than any earlier one.
    fn may_stand_out(&self, peaks: &[Peaks]) -> bool {
        let least = |usual: &UsualPeaks| LEAST_RATIO.ln().max(BEYOND_EARLIER * usual.furthest());
        self.joints.iter().zip(peaks).any(|(usual, of)| of.furthest >= least(usual))
    }

    /// The cycle of a test with the largest distance, by joint.
    fn peaks(&self, run: &RunSummary, alpha: f64) -> Vec<(JointIndex, Option<Peak>)> {
        let pauses = pauses(run);
        let of = |(joint, usual): (usize, &UsualPeaks)| {
            let cycles = Cycles::of(run, joint);
            if cycles.0.len() < 3 {
                return None;
            }
            let peak = usual.peak(&cycles, &pauses, alpha / self.joints.len() as f64);
            Some((JointIndex::new(joint), peak))
        };
        self.joints.iter().enumerate().filter_map(of).collect()
    }
}

impl UsualPeaks {
    /// Remembers a test with this number of inner cycles.
    fn remember(&mut self, cycles: usize, furthest: f64) {
        self.peaks.push_back((cycles, furthest));
        self.peak_count += cycles;
        while let Some((first, _)) = self.peaks.front()
            && self.peak_count - first >= MOST_PEAKS
        {
            self.peak_count -= first;
            self.peaks.pop_front();
        }
    }

    /// Largest distance of a remembered cycle.
    fn furthest(&self) -> f64 {
        self.peaks.iter().map(|(_, furthest)| *furthest).fold(0.0, f64::max)
    }

    /// The latest distances, oldest first.
    fn distances(&self) -> Vec<f64> {
        let mut found: Vec<f64> = self.tests.iter().flatten().copied().collect();
        found.drain(..found.len().saturating_sub(MOST_CYCLES));
        found
    }

    fn peak(&self, cycles: &Cycles, pauses: &[u32], alpha: f64) -> Option<Peak> {
        let inner = 1..cycles.0.len() - 1;
        let tried = inner.len() as f64;
        let of = |place: usize| {
            let (_, by) = cycles.distances(place)?;
            if by < LEAST_RATIO.ln() {
                return None;
            }
            let (cycle, value) = cycles.0[place];
            if pauses.contains(&cycle) {
                return None;
            }
            // the distances of the adjacent cycles contain this one
            let others = (1..cycles.0.len() - 1).filter(|other| other.abs_diff(place) > 1);
            let own: Vec<f64> = others.filter_map(|other| cycles.distances(other)).map(|of| of.0).collect();
            let mut all = self.distances();
            all.extend(&own);
            let known = all.len();
            if known < FEWEST_CYCLES {
                return None;
            }
            let of_own = robust_deviation(&own).filter(|_| own.len() >= 4).unwrap_or(0.0);
            let spread = robust_deviation(&all).unwrap_or(0.0).max(of_own).max(LEAST_SPREAD);
            let least = LEAST_RATIO
                .ln()
                .max(BEYOND_EARLIER * self.furthest())
                .max(beyond_chance(alpha / tried, known as f64) * spread);
            let beside = value / by.exp();
            (by >= least).then_some(Peak { cycle, by, least, value, beside })
        };
        inner.filter_map(of).max_by(|a, b| a.by.total_cmp(&b.by))
    }
}

/// A contact in one test.
struct Contact {
    /// The joint, if only one is affected.
    joint: Option<JointIndex>,
    verdict: Verdict,
}

/// The contact in one test, at `place` of the history. `causes` are the likeliest ones of its friction curves, by
/// joint.
fn contact(
    usual: &UsualContacts,
    run: &RunSummary,
    place: usize,
    causes: &[Option<Cause>],
    alpha: f64,
) -> Option<Contact> {
    let peaks = usual.peaks(run, alpha);
    // a jump of friction inside a cycle raises its residual, and the next cycle is the first odd one of the friction
    // curve
    let is_free = |joint: JointIndex, peak: &Peak| match causes.get(joint.index()).copied().flatten() {
        Some(Cause::Step { .. } | Cause::Scatter(_)) => false,
        Some(Cause::OddCycle { cycle, .. }) => cycle == peak.cycle,
        _ => true,
    };
    let (first, strongest) = peaks
        .iter()
        .filter_map(|(joint, peak)| peak.as_ref().map(|peak| (*joint, peak)))
        .filter(|(joint, peak)| is_free(*joint, peak))
        .max_by(|a, b| a.1.by.total_cmp(&b.1.by))?;
    let with: Vec<(JointIndex, &Peak)> = peaks
        .iter()
        .filter_map(|(joint, peak)| peak.as_ref().map(|peak| (*joint, peak)))
        .filter(|(_, peak)| peak.cycle == strongest.cycle)
        .collect();
    if with.len() > 2 && with.len() == peaks.len() {
        return None;
    }
    let alone = with.len() == 1;
    let figure = |(joint, peak): &(JointIndex, &Peak)| {
        let of =
            if alone { "this joint's torque".to_owned() } else { format!("the torque of joint {joint}") };
        format!("{:.1} % of {of} ({:.1} % in the cycles next to it)", 100.0 * peak.value, 100.0 * peak.beside)
    };
    let figures: Vec<String> = with.iter().map(figure).collect();
    let link = with.iter().map(|(joint, _)| joint.number()).max().unwrap_or(first.number());
    let place_of_touch = if alone {
        String::new()
    } else {
        format!("; a force on the arm loads the joints before it, so look from link {link} on to the tool")
    };
    Some(Contact {
        joint: alone.then_some(first),
        verdict: Verdict::Out {
            severity: Severity::Warning,
            score: strongest.by.exp(),
            threshold: strongest.least.exp(),
            value: strongest.value,
            baseline: strongest.beside,
            message: format!(
                "in cycle {} of this test alone the identified model misses {}{place_of_touch}; something pushed or held \
                 the arm for a part of that cycle: look for contact with a fixture, a cable or a person",
                strongest.cycle,
                figures.join(" and ")
            ),
            why: Why { onset: Some((place, Some(strongest.cycle))), ..Why::default() },
        },
    })
}

/// Probability of a false alarm of this channel per test.
pub(in crate::detect::runs) fn alpha(
    history: &[RunSummary],
    joints: usize,
    settings: &DetectSettings,
) -> f64 {
    let starts: Vec<Timestamp> = history.iter().map(|run| run.started_at).collect();
    Budget::new(settings.false_alarms_per_robot_year, joints, &starts).alpha()
}

/// Contacts in complete tests that are compared with each other, oldest first. `causes` are those of the friction
/// curves, by joint and run.
pub(in crate::detect::runs) fn contacts(
    history: &[RunSummary],
    causes: &[Vec<Option<RunCause>>],
    moments: &[(i64, Timestamp)],
    settings: &DetectSettings,
) -> Vec<Anomaly> {
    let joints = causes.len();
    let alpha = alpha(history, joints, settings);
    let mut usual = UsualContacts::new(joints);
    let mut found: Vec<Option<Contact>> = Vec::with_capacity(history.len());
    for (place, run) in history.iter().enumerate() {
        let peaks = peaks(run, joints);
        let contact = usual.may_stand_out(&peaks).then(|| {
            let likeliest: Vec<Option<Cause>> =
                causes.iter().map(|of| of.get(place)?.as_ref().map(RunCause::likeliest)).collect();
            contact(&usual, run, place, &likeliest, alpha)
        });
        let contact = contact.flatten();
        if contact.is_none() {
            usual.learn(peaks);
        }
        found.push(contact);
    }
    anomalies(&found, history, moments)
}

/// The contact in a test that is still being written. `alpha` is the probability of a false alarm.
pub(in crate::detect::runs) fn open_contact(
    usual: &UsualContacts,
    alpha: f64,
    open: &RunSummary,
    causes: &[Option<Cause>],
    moment: (i64, Timestamp),
) -> Vec<Anomaly> {
    let found = [contact(usual, open, 0, causes, alpha)];
    anomalies(&found, std::slice::from_ref(open), &[moment])
}

fn has_rmsd(run: &RunSummary) -> bool {
    !run.whole_cycle_rmsd.is_empty()
}

/// Joins contacts of the same joint in successive tests.
fn anomalies(
    found: &[Option<Contact>],
    history: &[RunSummary],
    moments: &[(i64, Timestamp)],
) -> Vec<Anomaly> {
    let mut named: Vec<Option<JointIndex>> = found.iter().flatten().map(|of| of.joint).collect();
    named.sort_unstable();
    named.dedup();
    let of_joint = |joint: Option<JointIndex>| {
        let verdict = |(contact, run): (&Option<Contact>, &RunSummary)| match contact {
            Some(of) if of.joint == joint => of.verdict.clone(),
            _ if !has_rmsd(run) => Verdict::Unknown,
            _ => Verdict::Quiet,
        };
        let verdicts = found.iter().zip(history).map(verdict).collect();
        episodes(moments, joint, AnomalyKind::Accuracy, Quantity::Contact, verdicts)
    };
    named.into_iter().flat_map(of_joint).collect()
}

#[cfg(test)]
mod tests;
