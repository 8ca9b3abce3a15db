//! What a log of ordinary work leaves of the torque that a test leads to expect, and how much of it each cause could take.
//!
//! A cause changes the torque of a joint along a direction that follows from the motion: more friction along the joint's
//! friction torque, a gain along all of its torque, a load along what a body at the last link adds. The products of these
//! directions with each other and with the deviation are all that a fit of any of them needs. They are some dozen numbers
//! a joint, in place of the rows or their factors.

use crate::robot::JointIndex;

/// A direction in which the torque of a joint may deviate, for a change of size 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkDirection {
    /// The part of its friction that does not depend on speed, as much again.
    Coulomb,
    /// The part that does, as much again.
    Viscous,
    /// All of its torque, as much again: the torque signal reads twice as much.
    Gain,
    /// A constant torque of 1 Nm (N). Known only where the friction law has a column for it.
    Offset,
    /// A standard parameter of the last link, in SI: its mass, or one of the three first moments.
    Load(u8),
}

impl WorkDirection {
    /// All of them, in the order of [`JointEvidence`].
    pub const ALL: [Self; 8] = [
        Self::Coulomb,
        Self::Viscous,
        Self::Gain,
        Self::Offset,
        Self::Load(0),
        Self::Load(1),
        Self::Load(2),
        Self::Load(3),
    ];

    /// Parameters of a load: mass and first moments.
    pub const LOAD: usize = 4;

    /// Its place among [`Self::ALL`].
    #[must_use]
    pub fn place(self) -> usize {
        match self {
            Self::Coulomb => 0,
            Self::Viscous => 1,
            Self::Gain => 2,
            Self::Offset => 3,
            Self::Load(of) => 4 + usize::from(of),
        }
    }
}

/// Place of the deviation, behind the directions.
pub const DEVIATION: usize = WorkDirection::ALL.len();
/// Products of each two of the directions and the deviation.
pub const PRODUCTS: usize = (DEVIATION + 1) * (DEVIATION + 2) / 2;

/// One joint in a window or a log: mean products, over the rows in which it moves, of the torque along each two
/// directions. Behind the directions stands the deviation: the measured torque less that of the test's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointEvidence {
    /// The joint.
    pub joint: JointIndex,
    /// Windows behind the means.
    pub windows: usize,
    /// Rows behind the means, one at least.
    pub samples: usize,
    /// (Nm)² ((N)²) for directions of size 1: the upper triangle, row after row.
    pub products: [f64; PRODUCTS],
}

impl JointEvidence {
    /// Mean product of two directions by their places, in either order.
    #[must_use]
    pub fn product(&self, a: usize, b: usize) -> f64 {
        self.products[Self::index(a, b)]
    }

    /// Where that stands among [`Self::products`].
    #[must_use]
    pub fn index(a: usize, b: usize) -> usize {
        let (a, b) = (a.min(b), a.max(b));
        a * (2 * DEVIATION + 3 - a) / 2 + b - a
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_has_one_place() {
        let mut seen = Vec::new();
        for a in 0..=DEVIATION {
            for b in a..=DEVIATION {
                assert_eq!(JointEvidence::index(a, b), JointEvidence::index(b, a));
                seen.push(JointEvidence::index(a, b));
            }
        }
        assert_eq!(seen, (0..PRODUCTS).collect::<Vec<_>>());
        for (place, direction) in WorkDirection::ALL.into_iter().enumerate() {
            assert_eq!(direction.place(), place);
        }
    }
}
