//! Places of the random effects of a run in the vector that is solved for.

use std::ops::Range;

use super::record::JointRecord;

/// Indices of the random effects in the vector of a run: the ambient effect common to all joints, then the effects of
/// one joint after the other.
pub(super) struct EffectLayout {
    pub(super) joints: Vec<JointLayout>,
    /// Number of effects.
    pub(super) size: usize,
}

/// Indices of one joint's effects: wear, ambient, start of the slow and of the fast part, then one for each level.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointLayout {
    pub(super) first: usize,
    pub(super) levels: usize,
}

impl EffectLayout {
    /// Index of the ambient effect common to all joints.
    pub(super) const COMMON_AMBIENT: usize = 0;

    pub(super) fn of(records: &[JointRecord]) -> Self {
        Self::with_levels(records.iter().map(|record| record.levels.len()))
    }

    /// Layout for joints with these numbers of levels.
    pub(super) fn with_levels(levels: impl Iterator<Item = usize>) -> Self {
        let (mut joints, mut size) = (Vec::new(), Self::COMMON_AMBIENT + 1);
        for levels in levels {
            let joint = JointLayout { first: size, levels };
            size = joint.end();
            joints.push(joint);
        }
        Self { joints, size }
    }
}

impl JointLayout {
    pub(super) fn wear(self) -> usize {
        self.first
    }

    pub(super) fn ambient(self) -> usize {
        self.first + 1
    }

    /// Slow and fast part.
    pub(super) fn start(self) -> [usize; 2] {
        [self.first + 2, self.first + 3]
    }

    pub(super) fn level(self, level: usize) -> usize {
        self.first + 4 + level
    }

    pub(super) fn levels(self) -> Range<usize> {
        self.level(0)..self.end()
    }

    /// Index after the joint's last effect.
    pub(super) fn end(self) -> usize {
        self.level(self.levels)
    }
}
