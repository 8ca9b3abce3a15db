//! Joints by number.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// A joint of a chain. It counts from 0 internally; people read [`JointIndex::number`], which counts from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JointIndex(
    // small, since every row of a friction stage has one
    u16,
);

/// JSON contains the number that people read.
impl Serialize for JointIndex {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_u64(self.number() as u64)
    }
}

impl<'de> Deserialize<'de> for JointIndex {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = usize::deserialize(deserializer)?;
        Self::from_number(number).ok_or_else(|| de::Error::custom("joints count from 1"))
    }
}

impl JointIndex {
    /// The joint at `index`, counted from 0 at the base; beyond 65,535, which no chain has, the last one.
    #[must_use]
    pub const fn new(index: usize) -> Self {
        Self(if index < u16::MAX as usize { index as u16 } else { u16::MAX })
    }

    /// The joint with the number `number`, counted from 1 at the base; `None` for 0.
    #[must_use]
    pub const fn from_number(number: usize) -> Option<Self> {
        match number.checked_sub(1) {
            Some(index) => Some(Self::new(index)),
            None => None,
        }
    }

    /// Position in the chain, from 0 at the base.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }

    /// The number that people read, from 1 at the base.
    #[must_use]
    pub const fn number(self) -> usize {
        self.index() + 1
    }
}

impl fmt::Display for JointIndex {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.number())
    }
}
