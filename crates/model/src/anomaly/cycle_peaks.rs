//! Distance of each cycle's RMSD from those of its neighbours in a test.

use std::collections::BTreeMap;

use super::RunSummary;
use crate::analysis::median::median;

/// Shortest interval between two cycles that is a pause, as a multiple of the usual one.
const PAUSE: f64 = 1.5;

/// Differences of a joint's cycles in a test from their neighbours.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Peaks {
    /// Signed distance of each cycle from the mean of both neighbours, in logarithms.
    pub distances: Vec<f64>,
    /// Largest excess of a cycle over both neighbours, in logarithms; at least 0. A cycle after a pause does not count.
    pub furthest: f64,
}

/// The peaks of each of the first `joints` joints in a test.
#[must_use]
pub fn peaks(run: &RunSummary, joints: usize) -> Vec<Peaks> {
    let pauses = pauses(run);
    let mut by_joint = vec![Cycles(Vec::new()); joints];
    for of in run.whole_cycle_rmsd.iter().filter(|of| of.relative_rmsd > 0.0) {
        if let Some(cycles) = by_joint.get_mut(of.joint.index()) {
            cycles.0.push((of.cycle, of.relative_rmsd));
        }
    }
    by_joint.iter().map(|cycles| cycles.peaks(&pauses)).collect()
}

/// Numbers of the accepted cycles of a test with the RMSD of one joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycles(pub Vec<(u32, f64)>);

impl Cycles {
    fn peaks(&self, pauses: &[u32]) -> Peaks {
        let mut found = Peaks::default();
        for place in 1..self.0.len().saturating_sub(1) {
            let Some((distance, by)) = self.distances(place) else { continue };
            found.distances.push(distance);
            if !pauses.contains(&self.0[place].0) {
                found.furthest = found.furthest.max(by);
            }
        }
        found
    }

    /// The accepted cycles with the RMSD of the joint at this position.
    #[must_use]
    pub fn of(run: &RunSummary, joint: usize) -> Self {
        let of_joint = run.whole_cycle_rmsd.iter().filter(|of| of.joint.index() == joint);
        let known = of_joint.filter(|of| of.relative_rmsd > 0.0).map(|of| (of.cycle, of.relative_rmsd));
        Self(known.collect())
    }

    /// Distance of the cycle at this place from the mean of its neighbours, and its excess over both, in logarithms.
    /// `None` without neighbours.
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

/// Cycles before which the arm paused, as far as the times of friction points show.
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
