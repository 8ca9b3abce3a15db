//! Numbers one after the other in a BLOB, little-endian, each to its last bit.

use armwatch_model::robot::JointIndex;

/// Adds the number of a joint; an arm has nine at most.
pub(in crate::robot) fn add_joint(bytes: &mut Vec<u8>, joint: JointIndex) {
    bytes.push(u8::try_from(joint.number()).unwrap_or(u8::MAX));
}

/// Adds how many of something follow.
pub(in crate::robot) fn add_count(bytes: &mut Vec<u8>, count: usize) {
    bytes.extend(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
}

/// Adds numbers.
pub(in crate::robot) fn add_numbers<const N: usize>(bytes: &mut Vec<u8>, numbers: [f64; N]) {
    numbers.iter().for_each(|number| bytes.extend(number.to_le_bytes()));
}

/// Bytes that are read from their front; each read gives `None` at their end.
pub(in crate::robot) struct Reader<'b>(pub(in crate::robot) &'b [u8]);

impl Reader<'_> {
    pub(in crate::robot) fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    pub(in crate::robot) fn bytes(&mut self, length: usize) -> Option<&[u8]> {
        let (first, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(first)
    }

    pub(in crate::robot) fn u8(&mut self) -> Option<u8> {
        self.take().map(u8::from_le_bytes)
    }

    pub(in crate::robot) fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    pub(in crate::robot) fn i64(&mut self) -> Option<i64> {
        self.take().map(i64::from_le_bytes)
    }

    pub(in crate::robot) fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    pub(in crate::robot) fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut found = [0.0; N];
        for number in &mut found {
            *number = self.f64()?;
        }
        Some(found)
    }

    pub(in crate::robot) fn joint(&mut self) -> Option<JointIndex> {
        JointIndex::from_number(usize::from(self.u8()?))
    }

    /// As many as are counted before them.
    pub(in crate::robot) fn list<T>(
        &mut self,
        mut one: impl FnMut(&mut Self) -> Option<T>,
    ) -> Option<Vec<T>> {
        let count = self.u32()?;
        (0..count).map(|_| one(self)).collect()
    }
}
