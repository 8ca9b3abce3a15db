//! Evidence of a production log: its deviation from the torque expected by a test, and how much of it each cause could
//! explain.
//!
//! A cause changes the torque of a joint along a direction that follows from the motion: more friction along the
//! joint's friction torque, a gain along all of its torque, a load along the torque of an additional body at the last
//! link. A fit of any of them needs only the products of these directions with each other and with the deviation. These
//! are some dozen numbers per joint, instead of the rows or their factors.

use crate::robot::JointIndex;

/// A direction of a joint's torque deviation, for a change of size 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorkDirection {
    /// The part of its friction that does not depend on speed; size 1 doubles it.
    Coulomb,
    /// The part that depends on speed; size 1 doubles it.
    Viscous,
    /// All of its torque; size 1 doubles the torque signal.
    Gain,
    /// A constant torque of 1 Nm (N). Known only if the friction law has a column for it.
    Offset,
    /// A standard parameter of the last link, in SI: its mass, or one of the three first moments.
    Load(u8),
}

impl WorkDirection {
    /// All directions, in the order of [`JointEvidence`].
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

    /// Its position in [`Self::ALL`].
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

/// Position of the deviation, after the directions.
pub const DEVIATION: usize = WorkDirection::ALL.len();
/// Number of products of each two of the directions and the deviation.
pub const PRODUCTS: usize = (DEVIATION + 1) * (DEVIATION + 2) / 2;

/// One joint in a window or a log: mean products, over its moving rows, of the torque along each two directions. The
/// last direction is the deviation: the measured torque minus that of the test's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointEvidence {
    /// The joint.
    pub joint: JointIndex,
    /// Windows used for the means.
    pub windows: usize,
    /// Rows used for the means, at least one.
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

    /// Index of that product in [`Self::products`].
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
