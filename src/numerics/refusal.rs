//! From findings that refuse a cycle to the causes that are stored with it.

use super::diagnose::{Finding, FindingKind, FindingSeverity};
use crate::analysis::refusal::{Channel, RefusalCause};

/// Causes of the findings that refuse a cycle, in their order.
#[must_use]
pub fn causes(findings: &[Finding]) -> Vec<RefusalCause> {
    let refusing = findings.iter().filter(|finding| finding.severity == FindingSeverity::Refuse);
    refusing.map(cause).collect()
}

fn cause(finding: &Finding) -> RefusalCause {
    let (name, channel) = described(finding);
    RefusalCause { finding: name.into(), channel, joint: finding.joint, sentence: finding.sentence.clone() }
}

/// Name of the check and what it is about.
fn described(finding: &Finding) -> (&'static str, Channel) {
    match finding.kind {
        FindingKind::Still => ("still_joint", Channel::Motion),
        FindingKind::OneSpeed => ("one_speed", Channel::Motion),
        FindingKind::ShortExcitation => ("short_excitation", Channel::Motion),
        FindingKind::Saturated => ("saturated_torque", Channel::Torque),
        FindingKind::Stuck => ("stuck_channel", named_channel(finding)),
        FindingKind::Spike => ("spike", named_channel(finding)),
        FindingKind::Repeated => ("repeated_rows", Channel::Rows),
        FindingKind::VelocitySwapped => ("swapped_velocity", Channel::Velocity),
        FindingKind::VelocityUnit => ("velocity_unit", Channel::Velocity),
        FindingKind::VelocitySign => ("velocity_sign", Channel::Velocity),
        FindingKind::VelocityUnrelated => ("unrelated_velocity", Channel::Velocity),
        FindingKind::TooFast => ("too_fast", Channel::Velocity),
        FindingKind::TorqueSwapped => ("swapped_torque", Channel::Torque),
        FindingKind::TorqueSign => ("torque_sign", Channel::Torque),
        FindingKind::TorqueDelay => ("late_torque", Channel::Torque),
        FindingKind::PositionUnit => ("position_unit", Channel::Position),
        FindingKind::OutsideLimits => ("outside_limits", Channel::Position),
        FindingKind::SmallMotion => ("small_motion", Channel::Position),
        FindingKind::TimeAxis => ("time_axis", Channel::Time),
        FindingKind::NegativeInertia => ("negative_inertia", Channel::Model),
        FindingKind::NegativeFriction => ("negative_friction", Channel::Model),
        FindingKind::FarFromNominal => ("far_from_nominal", Channel::Model),
        FindingKind::Unexplained => ("unexplained_torque", Channel::Model),
        FindingKind::Description => ("description", Channel::Model),
    }
}

/// The channel that the evidence names.
fn named_channel(finding: &Finding) -> Channel {
    let channels = [Channel::Position, Channel::Velocity, Channel::Torque];
    let named = |channel: &Channel| finding.evidence.iter().any(|of| of.name == channel.name());
    channels.into_iter().find(named).unwrap_or(Channel::Rows)
}
