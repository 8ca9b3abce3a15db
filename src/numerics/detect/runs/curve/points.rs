//! The curves of a robot's runs, and what their joints have in common.

use crate::analysis::friction::CycleFriction;
use crate::anomaly::RunSummary;
use crate::numerics::statistics::descriptive::median;
use crate::robot::JointIndex;

/// Fewest joints whose median is what a hall or a lubricant does to all of them.
const FEWEST_IN_COMMON: usize = 3;

/// Friction of a joint in one cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::numerics::detect::runs) struct CurvePoint {
    /// Number of the cycle, from 1.
    pub(in crate::numerics::detect::runs) cycle: u32,
    /// Since the start of the recording, min.
    pub(in crate::numerics::detect::runs) minute: f64,
    /// Natural logarithm of friction, of Nm (N).
    pub(in crate::numerics::detect::runs) ln_torque: f64,
}

/// Friction of a joint over the cycles of one run, in their order; empty without friction points.
pub(in crate::numerics::detect::runs) type Curve = Vec<CurvePoint>;

/// The curves of a joint, one a run. Cycles whose speed levels are not those of the joint's first cycle are left out.
pub(in crate::numerics::detect::runs) fn curves(history: &[RunSummary], joint: JointIndex) -> Vec<Curve> {
    let of_joint = |run: &RunSummary| -> Vec<(u32, CycleFriction)> {
        let own = run.cycle_friction.iter().filter(|of| of.friction.joint == joint);
        own.map(|of| (of.cycle, of.friction)).collect()
    };
    let all: Vec<Vec<(u32, CycleFriction)>> = history.iter().map(of_joint).collect();
    let Some((_, first)) = all.iter().flatten().next().copied() else { return vec![Vec::new(); all.len()] };
    let point =
        |(cycle, of): (u32, CycleFriction)| CurvePoint { cycle, minute: of.minute, ln_torque: of.ln_torque };
    all.into_iter()
        .map(|run| run.into_iter().filter(|(_, of)| of.compares_with(&first)).map(point).collect())
        .collect()
}

/// What the other joints have in common at each of these cycles: the median of their differences, by cycle. Zero with
/// too few of them.
pub(in crate::numerics::detect::runs) fn common_part(others: &[&[(u32, f64)]], cycles: &[u32]) -> Vec<f64> {
    let at = |cycle: &u32| {
        let found: Vec<f64> = others
            .iter()
            .filter_map(|joint| joint.iter().find(|(of, _)| of == cycle).map(|(_, difference)| *difference))
            .collect();
        if found.len() < FEWEST_IN_COMMON { 0.0 } else { median(&found).unwrap_or(0.0) }
    };
    cycles.iter().map(at).collect()
}
