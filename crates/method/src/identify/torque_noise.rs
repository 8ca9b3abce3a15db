//! Noise of the torque channels of a cycle.

use crate::signal::filter::FilteredSignals;
use crate::signal::noise::{passed, white_noise};
use armwatch_model::analysis::{RmsdScope, TorqueNoise, TorqueRmsd};
use armwatch_model::run::{Samples, Stage};

/// Noise of the torque channels in the excitation's usable rows `excitation`, for joints that move there, relative to
/// the torque of the cycle's own verification.
#[must_use]
pub fn torque_noise(
    samples: &Samples,
    filtered: &FilteredSignals,
    excitation: &[usize],
    verification: &[TorqueRmsd],
) -> Vec<TorqueNoise> {
    let passed = passed(filtered.cutoff, filtered.sample_rate);
    let of_joint = |of: &TorqueRmsd| {
        let moving = of.moving_rows;
        let torque = moving.value / moving.relative;
        let j = of.joint.index();
        let value = passed * white_noise(&samples.torque[j], &filtered.tau[j], excitation)?;
        let found = TorqueNoise { joint: of.joint, value, relative: value / torque };
        (found.relative.is_finite() && torque > 0.0).then_some(found)
    };
    let of_excitation = |of: &&TorqueRmsd| of.scope == RmsdScope::Stage(Stage::Excitation);
    verification.iter().filter(of_excitation).filter_map(of_joint).collect()
}
