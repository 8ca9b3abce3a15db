//! Indices of the random effects of a run in the solution vector.

use std::ops::Range;

use super::record::JointRecord;

/// Indices of the random effects in the vector of a run: the common ambient effect of all joints, then the effects of
/// each joint.
pub(super) struct EffectLayout {
    pub(in crate::friction) joints: Vec<JointLayout>,
    /// Number of effects.
    pub(in crate::friction) size: usize,
}

/// Indices of one joint's effects: wear, its shape, ambient, start of the slow and of the fast part, then one for each
/// level.
#[derive(Debug, Clone, Copy)]
pub(super) struct JointLayout {
    pub(in crate::friction) first: usize,
    pub(in crate::friction) levels: usize,
}

impl EffectLayout {
    /// Index of the common ambient effect of all joints.
    pub(super) const COMMON_AMBIENT: usize = 0;

    pub(in crate::friction) fn of(records: &[JointRecord]) -> Self {
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
    pub(in crate::friction) fn wear(self) -> usize {
        self.first
    }

    pub(in crate::friction) fn shape(self) -> usize {
        self.first + 1
    }

    pub(in crate::friction) fn ambient(self) -> usize {
        self.first + 2
    }

    /// Indices of the slow and of the fast part.
    pub(in crate::friction) fn start(self) -> [usize; 2] {
        [self.first + 3, self.first + 4]
    }

    pub(in crate::friction) fn level(self, level: usize) -> usize {
        self.first + 5 + level
    }

    pub(in crate::friction) fn levels(self) -> Range<usize> {
        self.level(0)..self.end()
    }

    /// Index after the joint's last effect.
    pub(in crate::friction) fn end(self) -> usize {
        self.level(self.levels)
    }
}
