//! The curves of a robot's runs, and the common part of their joints.

use crate::statistics::descriptive::{mean, median};
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::robot::JointIndex;

/// Fewest joints whose median is the effect of ambient temperature or lubricant on all of them.
const FEWEST_IN_COMMON: usize = 3;

/// Friction of a joint in one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::runs) struct CurvePoint {
    /// Number of the cycle, from 1.
    pub(in crate::detect::runs) cycle: u32,
    /// Time since the start of the recording, min.
    pub(in crate::detect::runs) minute: f64,
    /// Natural logarithm of friction in Nm (N).
    pub(in crate::detect::runs) ln_torque: f64,
}

/// Friction of a joint over the cycles of one run, in their order; empty without friction points.
pub(in crate::detect::runs) type Curve = Vec<CurvePoint>;

/// The curves of a joint, one per run. Cycles with other speed levels than [`usual_levels`] of its first run are
/// omitted.
pub(in crate::detect::runs) fn curves(history: &[RunSummary], joint: JointIndex) -> Vec<Curve> {
    let levels = history.iter().find_map(|run| usual_levels(run, joint));
    history.iter().map(|run| levels.map_or_else(Vec::new, |levels| curve(run, joint, &levels))).collect()
}

/// The curve of a joint in a run, of the cycles with these speed levels.
pub(super) fn curve(run: &RunSummary, joint: JointIndex, levels: &CycleFriction) -> Curve {
    of_joint(run, joint)
        .filter(|(_, of)| of.compares_with(levels))
        .map(|(cycle, of)| CurvePoint { cycle, minute: of.minute, ln_torque: of.ln_torque })
        .collect()
}

/// A cycle with the speed levels of most cycles of a joint in a run, or the earliest such levels in case of a tie: a
/// plateau may be missing in a cycle. `None` if the run has no friction of the joint.
pub(super) fn usual_levels(run: &RunSummary, joint: JointIndex) -> Option<CycleFriction> {
    let alike =
        |of: &CycleFriction| of_joint(run, joint).filter(|(_, other)| of.compares_with(other)).count();
    // `max_by_key` returns the last maximum, and the order is reversed
    of_joint(run, joint).map(|(_, of)| of).rev().max_by_key(alike)
}

/// Friction of a joint in each cycle of a run, with the number of the cycle.
pub(super) fn of_joint(
    run: &RunSummary,
    joint: JointIndex,
) -> impl DoubleEndedIterator<Item = (u32, CycleFriction)> {
    let own = run.cycle_friction.iter().filter(move |of| of.friction.joint == joint);
    own.map(|of| (of.cycle, of.friction))
}

/// The common part of the other joints at each of these cycles: the median of their differences, by cycle. Zero with
/// too few of them.
pub(in crate::detect::runs) fn common_part(others: &[&[(u32, f64)]], cycles: &[u32]) -> Vec<f64> {
    let at = |cycle: &u32| {
        let found: Vec<f64> = others
            .iter()
            .filter_map(|joint| joint.iter().find(|(of, _)| of == cycle).map(|(_, difference)| *difference))
            .collect();
        if found.len() < FEWEST_IN_COMMON { 0.0 } else { median(&found).unwrap_or(0.0) }
    };
    cycles.iter().map(at).collect()
}

/// The part that all joints share in the cycles of a run: mean minute and median of the joints' differences, for each
/// cycle with enough joints. `curves` and `differences` have one entry per joint; `differences` is empty without a
/// usual curve.
pub(super) fn shared(curves: &[&Curve], differences: &[&[(u32, f64)]]) -> Curve {
    let mut cycles: Vec<u32> = differences.iter().flat_map(|of| of.iter().map(|(cycle, _)| *cycle)).collect();
    cycles.sort_unstable();
    cycles.dedup();
    let of_cycle = |cycle: u32| {
        let of_joint = |(curve, of): (&&Curve, &&[(u32, f64)])| {
            let minute = curve.iter().find(|point| point.cycle == cycle)?.minute;
            Some((minute, of.iter().find(|(own, _)| *own == cycle)?.1))
        };
        let (minutes, found): (Vec<f64>, Vec<f64>) =
            curves.iter().zip(differences).filter_map(of_joint).unzip();
        if found.len() < FEWEST_IN_COMMON {
            return None;
        }
        Some(CurvePoint { cycle, minute: mean(&minutes)?, ln_torque: median(&found)? })
    };
    cycles.into_iter().filter_map(of_cycle).collect()
}
