//! The torque signal of a joint in one run: its differences from the usual signal, and the possible faults of the
//! joint itself.

use super::baseline::{
    Baseline, LEAST_NOISE_RATIO, LEAST_OFFSET, LEAST_RMSD_RATIO, MOST_CHI_SQUARE, SIGNAL_DEVIATIONS, Usual,
    friction, offsets,
};
use super::cause::{ArmCause, SignalFault};
use super::price::MECHANICAL_PRICE;
use crate::statistics::descriptive::mean;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::robot::JointIndex;

/// Least noise that can count, as a fraction of the usual torque.
const LEAST_NOISE: f64 = 0.002;

/// A joint's torque signal in one run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Signal {
    /// Offset beyond the usual one, Nm (N), and its chi² (0 if it does not count).
    pub(super) offset: (f64, f64),
    /// The offset beyond the usual one in standard deviations, even if it does not count.
    offset_deviations: f64,
    /// Residual as a multiple of the expected one at the channel's noise, and its chi² (0 if it does not count).
    pub(super) unexplained: (f64, f64),
    /// Noise as a multiple of the usual one, and its chi² (0 if it does not count); `None` if it is unknown.
    noise: Option<(f64, f64)>,
}

impl Signal {
    pub(super) fn noise_cost(&self) -> f64 {
        self.noise.map_or(0.0, |(_, cost)| cost)
    }

    /// Noise as a multiple of the usual one; `None` if it is unknown.
    pub(super) fn noise_ratio(&self) -> Option<f64> {
        self.noise.map(|(ratio, _)| ratio)
    }

    /// True if the friction stage shows an offset, even one that is small compared with friction.
    pub(super) fn shows_offset(&self) -> bool {
        self.offset_deviations.abs() >= SIGNAL_DEVIATIONS
    }

    pub(super) fn cost(&self) -> f64 {
        self.offset.1 + self.unexplained.1 + self.noise_cost()
    }

    /// Ratio of the torque's noise or residual to its usual value, the larger of the two.
    pub(super) fn ratio(&self) -> f64 {
        self.noise.map_or(self.unexplained.0, |(ratio, _)| ratio.max(self.unexplained.0))
    }
}

/// The torque signal of a joint in a run.
pub(super) fn signal(run: &RunSummary, baseline: &Baseline, joint: JointIndex) -> Signal {
    let mut found = Signal::default();
    if let (Some(usual), Some(offset)) = (baseline.offsets[joint.index()], mean(&offsets(run, joint))) {
        let friction = friction(run, joint).unwrap_or(0.0);
        // a difference between the directions is possibly a part of friction: it may have grown with friction
        let grown = baseline.friction[joint.index()].map_or(1.0, |usual| friction / usual) * usual.value;
        let expected = offset.clamp(usual.value.min(grown), usual.value.max(grown));
        let beyond = offset - expected;
        let deviations = beyond / usual.deviation;
        let enough = beyond.abs() >= LEAST_OFFSET * friction;
        let counts = deviations.abs() >= SIGNAL_DEVIATIONS && enough;
        found.offset_deviations = deviations;
        found.offset = (beyond, if counts { (deviations * deviations).min(MOST_CHI_SQUARE) } else { 0.0 });
    }
    let mut more_noise = 0.0;
    if let (Some(usual), Some(noise)) = (baseline.noise[joint.index()], baseline.noise_of(run, joint)) {
        found.noise = Some(usual.excess_of_noise(noise));
        more_noise = (noise * noise - usual.value.exp().powi(2)).max(0.0).sqrt();
    }
    if let (Some(usual), Some(rmsd)) = (baseline.rmsd[joint.index()], baseline.rmsd_of(run, joint)) {
        let expected = usual.value.exp().hypot(more_noise);
        found.unexplained = Usual { value: expected.ln(), ..usual }.excess_of_rmsd(rmsd);
    }
    found
}

impl Usual {
    /// Ratio of a relative RMSD to the usual one, and its chi² (0 if it does not count). `self` contains the
    /// logarithm of the usual RMSD.
    pub(super) fn excess_of_rmsd(&self, rmsd: f64) -> (f64, f64) {
        let (ratio, deviations) = ((rmsd.ln() - self.value).exp(), self.deviations(rmsd.ln()));
        let counts = deviations >= SIGNAL_DEVIATIONS && ratio >= LEAST_RMSD_RATIO;
        (ratio, if counts { (deviations * deviations).min(MOST_CHI_SQUARE) } else { 0.0 })
    }

    /// Ratio of a channel's noise to the usual one, and its chi² (0 if it does not count). `self` contains the
    /// logarithm of the usual noise.
    fn excess_of_noise(&self, noise: f64) -> (f64, f64) {
        let (ratio, deviations) = ((noise.ln() - self.value).exp(), self.deviations(noise.ln()));
        let counts = deviations >= SIGNAL_DEVIATIONS && ratio >= LEAST_NOISE_RATIO && noise >= LEAST_NOISE;
        (ratio, if counts { (deviations * deviations).min(MOST_CHI_SQUARE) } else { 0.0 })
    }
}

/// Possible faults of a joint itself. Each has the part of the joint's figures that it does not explain, in units of
/// chi².
pub(super) fn own_causes(
    signal: &Signal,
    run: &RunSummary,
    baseline: &Baseline,
    joint: JointIndex,
) -> Vec<(ArmCause, f64)> {
    let of_signal = |fault| ArmCause::TorqueSignal { joint, fault };
    let (ratio, rest) = signal.unexplained;
    if signal.offset.1 > 0.0 {
        // the part of a ripple or of play that does not average out looks like an offset
        let left = signal.offset.1 + signal.noise_cost() + MECHANICAL_PRICE;
        let is_mechanical = rest > 0.0 && signal.noise.is_some();
        let mechanical = is_mechanical.then_some((ArmCause::UnexplainedTorque { joint, ratio }, left));
        let offset = (of_signal(SignalFault::Offset(signal.offset.0)), 0.0);
        return std::iter::once(offset).chain(mechanical).collect();
    }
    let mut found = Vec::new();
    match signal.noise {
        Some((noise, cost)) => {
            if cost > 0.0 {
                found.push((of_signal(SignalFault::Noise(noise)), rest));
            }
            if rest > 0.0 {
                found.push((ArmCause::UnexplainedTorque { joint, ratio }, cost + MECHANICAL_PRICE));
            }
        }
        None if rest > 0.0 => found.push((of_signal(SignalFault::Noise(ratio)), 0.0)),
        None => {}
    }
    // if the effect of a gain is known, the search along its direction covers it
    if found.is_empty() && baseline.directions.is_empty() {
        found.push((of_signal(SignalFault::Gain(own_gain(run, baseline, joint))), 0.0));
    }
    found
}

/// Relative change of the joint's parameters: least squares against their usual values.
fn own_gain(run: &RunSummary, baseline: &Baseline, joint: JointIndex) -> f64 {
    let (mut with, mut own) = (0.0, 0.0);
    for (id, usual, _) in baseline.parameters.iter().filter(|(id, ..)| id.joint == joint) {
        if let Some(of) = run.parameters.iter().find(|of| of.id == *id) {
            let weight = usual.deviation.powi(-2);
            with += weight * usual.value * (of.mean - usual.value);
            own += weight * usual.value * usual.value;
        }
    }
    if own > 0.0 { with / own } else { 0.0 }
}
