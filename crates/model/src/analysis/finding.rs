//! Findings: faults and peculiarities of a recording or of the model made from it.

use crate::robot::JointIndex;

/// First words of the remark with which an accepted finding marks its cycle.
pub const ACCEPTED: &str = "accepted: ";

/// Consequence of a finding for the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum FindingSeverity {
    /// For information; the values count.
    Warn,
    /// The configuration accepts the finding: the values count, and a remark marks them.
    Accepted,
    /// The values are shown, but nothing is concluded from them.
    Doubt,
    /// No parameters should be computed from this.
    Refuse,
}

/// Kind of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FindingKind {
    /// A joint does not move during the excitation.
    Still,
    /// A joint moves at one speed only.
    OneSpeed,
    /// Torque is limited at a largest value.
    Saturated,
    /// A channel repeats one value while the arm moves.
    Stuck,
    /// A velocity is the derivative of another joint's position.
    VelocitySwapped,
    /// A torque belongs to another joint's motion.
    TorqueSwapped,
    /// Velocity is the derivative of position in another unit.
    VelocityUnit,
    /// Position is in another unit than the description's.
    PositionUnit,
    /// Velocity is the negative derivative of position.
    VelocitySign,
    /// Friction would drive the joint.
    TorqueSign,
    /// Velocities disagree with positions by one factor for all joints.
    TimeAxis,
    /// Velocity does not follow from position.
    VelocityUnrelated,
    /// Positions beyond the description's limits.
    OutsideLimits,
    /// Speeds beyond the description's limits.
    TooFast,
    /// The identified inertia is physically impossible.
    NegativeInertia,
    /// The identified friction would drive the joint.
    NegativeFriction,
    /// The identified inertia is far from the description's nominal one.
    FarFromNominal,
    /// The model does not explain the torque.
    Unexplained,
    /// A value far outside all others of its channel, or far from the row before.
    Spike,
    /// Rows that repeat the row before.
    Repeated,
    /// All joints move only over a small part of their range.
    SmallMotion,
    /// The excitation is very short.
    ShortExcitation,
    /// Torques are earlier or later than the motion that needs them.
    TorqueDelay,
    /// Torques contradict lengths, angles, mounting or torque scales of the description.
    Description,
    /// Torques of the motors are read as those of the joints.
    MotorTorque,
    /// Torque that is computed, or measured minus gravity or friction.
    ComputedTorque,
    /// The resolution of the recorded torque is coarse relative to the torque.
    CoarseTorque,
}

impl FindingKind {
    /// All kinds, the likeliest cause of others first: faults of a channel precede their effects on the model.
    pub const ALL: [Self; 27] = [
        Self::Stuck,
        Self::Spike,
        Self::Still,
        Self::OneSpeed,
        Self::SmallMotion,
        Self::PositionUnit,
        Self::VelocitySwapped,
        Self::VelocitySign,
        Self::VelocityUnit,
        Self::TimeAxis,
        Self::VelocityUnrelated,
        Self::OutsideLimits,
        Self::Saturated,
        Self::ComputedTorque,
        Self::TorqueSwapped,
        Self::TorqueSign,
        Self::MotorTorque,
        Self::TorqueDelay,
        Self::Description,
        Self::FarFromNominal,
        Self::NegativeFriction,
        Self::NegativeInertia,
        Self::Unexplained,
        Self::TooFast,
        Self::Repeated,
        Self::CoarseTorque,
        Self::ShortExcitation,
    ];

    /// Name as in `[analysis] accept` and `ingest --accept`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Still => "still_joint",
            Self::OneSpeed => "one_speed",
            Self::Saturated => "saturated_torque",
            Self::Stuck => "stuck_channel",
            Self::VelocitySwapped => "swapped_velocity",
            Self::TorqueSwapped => "swapped_torque",
            Self::VelocityUnit => "velocity_unit",
            Self::PositionUnit => "position_unit",
            Self::VelocitySign => "velocity_sign",
            Self::TorqueSign => "torque_sign",
            Self::TimeAxis => "time_axis",
            Self::VelocityUnrelated => "unrelated_velocity",
            Self::OutsideLimits => "outside_limits",
            Self::TooFast => "too_fast",
            Self::NegativeInertia => "negative_inertia",
            Self::NegativeFriction => "negative_friction",
            Self::FarFromNominal => "far_from_nominal",
            Self::Unexplained => "unexplained_torque",
            Self::Spike => "spike",
            Self::Repeated => "repeated_rows",
            Self::SmallMotion => "small_motion",
            Self::ShortExcitation => "short_excitation",
            Self::TorqueDelay => "late_torque",
            Self::Description => "description",
            Self::MotorTorque => "motor_torque",
            Self::ComputedTorque => "computed_torque",
            Self::CoarseTorque => "coarse_torque",
        }
    }

    /// The kind of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Place in [`FindingKind::ALL`].
    #[must_use]
    pub fn rank(self) -> usize {
        Self::ALL.iter().position(|kind| *kind == self).unwrap_or(Self::ALL.len())
    }
}

/// A set of kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FindingKinds(u32);

impl FindingKinds {
    /// True if it contains `kind`.
    #[must_use]
    pub fn contains(self, kind: FindingKind) -> bool {
        self.0 & (1 << kind.rank()) != 0
    }

    /// The union of both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// True if it is empty.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }
}

impl FromIterator<FindingKind> for FindingKinds {
    fn from_iter<I: IntoIterator<Item = FindingKind>>(kinds: I) -> Self {
        Self(kinds.into_iter().fold(0, |set, kind| set | 1 << kind.rank()))
    }
}

/// A number that supports a finding; its name ends with the unit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evidence {
    /// Name.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
}

/// A fact that a person should know about a recording before trusting values from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Kind.
    pub kind: FindingKind,
    /// Consequence for the values.
    pub severity: FindingSeverity,
    /// The joint, if it concerns one.
    pub joint: Option<JointIndex>,
    /// Fault and remedy, as a sentence.
    pub sentence: String,
    /// Numbers that support it.
    pub evidence: Vec<Evidence>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_a_name_of_its_own() {
        let mut names: Vec<&str> = FindingKind::ALL.iter().map(|kind| kind.name()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), FindingKind::ALL.len());
        for kind in FindingKind::ALL {
            assert_eq!(FindingKind::from_name(kind.name()), Some(kind));
            let set: FindingKinds = [kind].into_iter().collect();
            assert!(FindingKind::ALL.iter().all(|other| set.contains(*other) == (*other == kind)));
        }
        assert!(FindingKinds::default().is_empty());
    }
}
