//! Causes that are stored with a refused cycle, from its findings.

use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::refusal::{Channel, RefusalCause};

/// Causes of the findings that refuse a cycle, in order.
#[must_use]
pub fn causes(findings: &[Finding]) -> Vec<RefusalCause> {
    let refusing = findings.iter().filter(|finding| finding.severity == FindingSeverity::Refuse);
    refusing.map(cause).collect()
}

fn cause(finding: &Finding) -> RefusalCause {
    let Finding { kind, joint, sentence, .. } = finding;
    RefusalCause {
        finding: kind.name().into(),
        channel: channel(finding),
        joint: *joint,
        sentence: sentence.clone(),
    }
}

/// Channel of a finding.
fn channel(finding: &Finding) -> Channel {
    match finding.kind {
        FindingKind::Still | FindingKind::OneSpeed | FindingKind::ShortExcitation => Channel::Motion,
        FindingKind::Stuck | FindingKind::Spike => named_channel(finding),
        FindingKind::Repeated => Channel::Rows,
        FindingKind::VelocitySwapped
        | FindingKind::VelocityUnit
        | FindingKind::VelocitySign
        | FindingKind::VelocityUnrelated
        | FindingKind::TooFast => Channel::Velocity,
        FindingKind::Saturated
        | FindingKind::TorqueSwapped
        | FindingKind::TorqueSign
        | FindingKind::TorqueDelay
        | FindingKind::MotorTorque
        | FindingKind::ComputedTorque
        | FindingKind::CoarseTorque => Channel::Torque,
        FindingKind::PositionUnit | FindingKind::OutsideLimits | FindingKind::SmallMotion => {
            Channel::Position
        }
        FindingKind::TimeAxis => Channel::Time,
        FindingKind::NegativeInertia
        | FindingKind::NegativeFriction
        | FindingKind::FarFromNominal
        | FindingKind::Unexplained
        | FindingKind::Description => Channel::Model,
    }
}

/// Channel named in the evidence.
fn named_channel(finding: &Finding) -> Channel {
    let channels = [Channel::Position, Channel::Velocity, Channel::Torque];
    let named = |channel: &Channel| finding.evidence.iter().any(|of| of.name == channel.name());
    channels.into_iter().find(named).unwrap_or(Channel::Rows)
}
