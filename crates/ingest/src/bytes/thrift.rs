//! Checks metadata in Thrift's compact form before a library reads it: the library allocates memory for as many
//! elements as a list states.

/// Most elements of one list: columns times row groups of a large file.
const MOST_ELEMENTS: u64 = 1 << 18;

/// Deepest nesting; metadata of Parquet has some six levels.
const MOST_LEVELS: usize = 32;

/// Returns true if bytes begin with a struct whose lists and texts all end within them.
pub(super) fn is_sound(bytes: &[u8]) -> bool {
    ThriftWalk { bytes, at: 0 }.structure(MOST_LEVELS).is_some()
}

/// Kinds of values, as their headers number them.
mod kind {
    pub(super) const STOP: u8 = 0;
    pub(super) const TRUE: u8 = 1;
    pub(super) const FALSE: u8 = 2;
    pub(super) const BYTE: u8 = 3;
    pub(super) const I16: u8 = 4;
    pub(super) const I64: u8 = 6;
    pub(super) const DOUBLE: u8 = 7;
    pub(super) const BINARY: u8 = 8;
    pub(super) const LIST: u8 = 9;
    pub(super) const SET: u8 = 10;
    pub(super) const MAP: u8 = 11;
    pub(super) const STRUCT: u8 = 12;
}

struct ThriftWalk<'b> {
    bytes: &'b [u8],
    at: usize,
}

impl ThriftWalk<'_> {
    fn byte(&mut self) -> Option<u8> {
        let byte = *self.bytes.get(self.at)?;
        self.at += 1;
        Some(byte)
    }

    fn skip(&mut self, count: u64) -> Option<()> {
        self.at = self.at.checked_add(usize::try_from(count).ok()?).filter(|at| *at <= self.bytes.len())?;
        Some(())
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = self.byte()?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn structure(&mut self, levels: usize) -> Option<()> {
        let levels = levels.checked_sub(1)?;
        loop {
            let header = self.byte()?;
            let kind = header & 0x0f;
            if kind == kind::STOP {
                return Some(());
            }
            if header >> 4 == 0 {
                self.varint()?;
            }
            // for a field, the header contains the value
            if !matches!(kind, kind::TRUE | kind::FALSE) {
                self.value(kind, levels)?;
            }
        }
    }

    fn value(&mut self, kind: u8, levels: usize) -> Option<()> {
        match kind {
            kind::TRUE | kind::FALSE | kind::BYTE => self.skip(1),
            kind::I16..=kind::I64 => self.varint().map(|_| ()),
            kind::DOUBLE => self.skip(8),
            kind::BINARY => {
                let length = self.varint()?;
                self.skip(length)
            }
            kind::LIST | kind::SET => {
                let header = self.byte()?;
                let count = match header >> 4 {
                    15 => self.varint()?,
                    count => u64::from(count),
                };
                self.elements(count, &[header & 0x0f], levels)
            }
            kind::MAP => match self.varint()? {
                0 => Some(()),
                count => {
                    let kinds = self.byte()?;
                    self.elements(count, &[kinds >> 4, kinds & 0x0f], levels)
                }
            },
            kind::STRUCT => self.structure(levels),
            _ => None,
        }
    }

    fn elements(&mut self, count: u64, kinds: &[u8], levels: usize) -> Option<()> {
        let levels = levels.checked_sub(1)?;
        if count > MOST_ELEMENTS {
            return None;
        }
        (0..count).try_for_each(|_| kinds.iter().try_for_each(|kind| self.value(*kind, levels)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_beyond_the_bytes_are_not_sound() {
        // field 1 is a number, field 2 a list of two texts
        let sound = [0x15, 0x04, 0x19, 0x28, 1, b'a', 1, b'b', 0];
        assert!(is_sound(&sound));
        for end in 0..sound.len() {
            assert!(!is_sound(&sound[..end]), "{end}");
        }
        let states = |count: &[u8]| [&[0x19, 0xf8], count, &[1, b'a', 0]].concat();
        assert!(is_sound(&states(&[1])));
        assert!(!is_sound(&states(&[0xff, 0xff, 0xff, 0xff, 0x07])));
        assert!(!is_sound(&[0x1c; 100]), "too deep");
    }
}
