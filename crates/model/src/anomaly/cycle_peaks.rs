//! How far the RMSD of each cycle of a test stands out of its neighbours.

use std::collections::BTreeMap;

use super::RunSummary;
use super::brief::JointBrief;
use crate::analysis::median::median;

/// Interval between two cycles that is a pause, as a multiple of the usual one.
const PAUSE: f64 = 1.5;

/// Signed distances of the cycles of a test from the mean of both neighbours, in logarithms.
#[derive(Debug, Clone, PartialEq)]
pub enum Distances {
    /// Of a test whose cycles were read.
    Read(Vec<f64>),
    /// So many, of a test whose cycles are left out.
    LeftOut(usize),
}

impl Distances {
    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        match self {
            Self::Read(of) => of.len(),
            Self::LeftOut(count) => *count,
        }
    }
}

/// Distances of the cycles of a joint in a test, and the most by which one stands out of its neighbours, 0 at least.
/// One after a pause is never judged and says nothing of that.
#[must_use]
pub fn peaks_of_joint(run: &RunSummary, joint: usize) -> (Distances, f64) {
    if let Some(brief) = run.left_out() {
        let JointBrief { inner, furthest, .. } = brief.joint(joint);
        return (Distances::LeftOut(inner as usize), furthest);
    }
    let cycles = Cycles::of(run, joint);
    let pauses = pauses(run);
    let (mut distances, mut furthest) = (Vec::new(), 0.0_f64);
    for place in 1..cycles.0.len().saturating_sub(1) {
        let Some((distance, by)) = cycles.distances(place) else { continue };
        distances.push(distance);
        if !pauses.contains(&cycles.0[place].0) {
            furthest = furthest.max(by);
        }
    }
    (Distances::Read(distances), furthest)
}

/// Numbers of the accepted cycles of a test with the RMSD of one joint.
pub struct Cycles(pub Vec<(u32, f64)>);

impl Cycles {
    /// Those of the joint at this position.
    #[must_use]
    pub fn of(run: &RunSummary, joint: usize) -> Self {
        let of_joint = run.whole_cycle_rmsd.iter().filter(|of| of.joint.index() == joint);
        let known = of_joint.filter(|of| of.relative_rmsd > 0.0).map(|of| (of.cycle, of.relative_rmsd));
        Self(known.collect())
    }

    /// Distance of the cycle at this place from the mean of its neighbours, and how far it stands out of both, in
    /// logarithms. `None` without neighbours.
    #[must_use]
    pub fn distances(&self, place: usize) -> Option<(f64, f64)> {
        let [(before, a), (cycle, value), (after, b)] = [place - 1, place, place + 1].map(|of| self.0[of]);
        if before + 1 != cycle || cycle + 1 != after {
            return None;
        }
        let [a, value, b] = [a, value, b].map(f64::ln);
        Some((value - 0.5 * (a + b), value - a.max(b)))
    }
}

/// Cycles before which the arm paused, as far as friction points tell when they were.
#[must_use]
pub fn pauses(run: &RunSummary) -> Vec<u32> {
    let minutes: BTreeMap<u32, f64> =
        run.cycle_friction.iter().map(|of| (of.cycle, of.friction.minute)).collect();
    let times: Vec<(u32, f64)> = minutes.into_iter().collect();
    let interval = |pair: &[(u32, f64)]| (pair[1].1 - pair[0].1) / f64::from(pair[1].0 - pair[0].0);
    let intervals: Vec<f64> = times.windows(2).map(interval).collect();
    let usual = median(&intervals).unwrap_or(f64::INFINITY);
    let late = times.windows(2).zip(&intervals).filter(|(_, of)| **of > PAUSE * usual);
    late.map(|(pair, _)| pair[1].0).collect()
}
