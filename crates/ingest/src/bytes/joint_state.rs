//! The message `sensor_msgs/JointState` as ROS 2 (CDR) and ROS 1 write it.

/// How messages are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Cdr,
    Ros1,
}

impl Encoding {
    /// Name of the type in a bag.
    pub(super) fn named(name: &str) -> Option<Self> {
        match name {
            "cdr" => Some(Self::Cdr),
            "ros1" => Some(Self::Ros1),
            _ => None,
        }
    }
}

/// The state of joints at a moment.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JointStateMessage<'m> {
    /// Seconds and nanoseconds since 1970.
    pub(super) stamp: (i32, u32),
    pub(super) names: Vec<&'m str>,
    /// Positions, velocities and efforts; empty where none are recorded.
    pub(super) values: [Vec<f64>; 3],
}

impl<'m> JointStateMessage<'m> {
    /// `None` for bytes that are not such a message.
    pub(super) fn read(data: &'m [u8], encoding: Encoding) -> Option<Self> {
        let mut message = match (encoding, data) {
            (Encoding::Ros1, _) => {
                let mut message = MessageFields { data, at: 0, is_little: true, alignment: 1, encoding };
                // the number of the message
                message.u32()?;
                message
            }
            // the first two bytes are the version of CDR: 0 and 1 align to eight bytes, 6 and 7 to four
            (Encoding::Cdr, [0, version @ (0 | 1 | 6 | 7), _, _, data @ ..]) => MessageFields {
                data,
                at: 0,
                is_little: version % 2 == 1,
                alignment: if *version > 1 { 4 } else { 8 },
                encoding,
            },
            (Encoding::Cdr, _) => return None,
        };
        let stamp = (message.u32()?.cast_signed(), message.u32()?);
        message.text()?;
        let count = message.count(4)?;
        let names = (0..count).map(|_| message.text()).collect::<Option<Vec<_>>>()?;
        let values = [message.numbers()?, message.numbers()?, message.numbers()?];
        Some(Self { stamp, names, values })
    }
}

struct MessageFields<'m> {
    data: &'m [u8],
    at: usize,
    is_little: bool,
    /// Largest alignment of a value.
    alignment: usize,
    encoding: Encoding,
}

impl<'m> MessageFields<'m> {
    fn bytes<const N: usize>(&mut self) -> Option<[u8; N]> {
        let start = self.at.next_multiple_of(self.alignment.min(N));
        let mut bytes: [u8; N] = self.data.get(start..start + N)?.try_into().ok()?;
        self.at = start + N;
        if !self.is_little {
            bytes.reverse();
        }
        Some(bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes().map(u32::from_le_bytes)
    }

    /// The number of elements of a sequence, each of `least` bytes or more.
    fn count(&mut self, least: usize) -> Option<usize> {
        let count = usize::try_from(self.u32()?).ok()?;
        (count <= (self.data.len() - self.at) / least).then_some(count)
    }

    fn text(&mut self) -> Option<&'m str> {
        let length = self.count(1)?;
        let text = std::str::from_utf8(self.data.get(self.at..self.at + length)?).ok()?;
        self.at += length;
        match self.encoding {
            Encoding::Cdr => text.strip_suffix('\0').or(Some(text).filter(|text| text.is_empty())),
            Encoding::Ros1 => Some(text),
        }
    }

    fn numbers(&mut self) -> Option<Vec<f64>> {
        let count = self.count(8)?;
        (0..count).map(|_| self.bytes().map(f64::from_le_bytes)).collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A message by another way: written, with the alignment of CDR.
    pub(in super::super) fn cdr(
        stamp: (i32, u32),
        names: &[&str],
        values: [&[f64]; 3],
        is_little: bool,
    ) -> Vec<u8> {
        let mut body: Vec<u8> = Vec::new();
        let put = |body: &mut Vec<u8>, mut bytes: Vec<u8>| {
            body.resize(body.len().next_multiple_of(bytes.len()), 0);
            if !is_little {
                bytes.reverse();
            }
            body.extend(bytes);
        };
        let text = |body: &mut Vec<u8>, text: &str| {
            put(body, (text.len() as u32 + 1).to_le_bytes().to_vec());
            body.extend(text.as_bytes());
            body.push(0);
        };
        put(&mut body, stamp.0.to_le_bytes().to_vec());
        put(&mut body, stamp.1.to_le_bytes().to_vec());
        text(&mut body, "base");
        put(&mut body, (names.len() as u32).to_le_bytes().to_vec());
        names.iter().for_each(|name| text(&mut body, name));
        for values in values {
            put(&mut body, (values.len() as u32).to_le_bytes().to_vec());
            values.iter().for_each(|value| put(&mut body, value.to_le_bytes().to_vec()));
        }
        [vec![0, u8::from(is_little), 0, 0], body].concat()
    }

    fn ros1(stamp: (i32, u32), names: &[&str], values: [&[f64]; 3]) -> Vec<u8> {
        let length = |of: usize| (of as u32).to_le_bytes();
        let mut bytes =
            [[7; 4], stamp.0.to_le_bytes(), stamp.1.to_le_bytes(), length(0), length(names.len())].concat();
        names.iter().for_each(|name| bytes.extend([&length(name.len())[..], name.as_bytes()].concat()));
        for values in values {
            bytes.extend(length(values.len()));
            values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        }
        bytes
    }

    #[test]
    fn messages_of_ros_1_and_2_are_read() {
        let (stamp, names) = ((1_700_000_000, 123_456_789), ["shoulder", "elbow_joint", "w"]);
        let values: [&[f64]; 3] = [&[1.0, -2.5, 3.25], &[], &[0.1, f64::MIN_POSITIVE, 1e300]];
        let expected =
            JointStateMessage { stamp, names: names.to_vec(), values: values.map(<[f64]>::to_vec) };
        for (bytes, encoding) in [
            (cdr(stamp, &names, values, true), Encoding::Cdr),
            (cdr(stamp, &names, values, false), Encoding::Cdr),
            (ros1(stamp, &names, values), Encoding::Ros1),
        ] {
            assert_eq!(JointStateMessage::read(&bytes, encoding).as_ref(), Some(&expected));
            for end in 0..bytes.len() {
                assert_eq!(JointStateMessage::read(&bytes[..end], encoding), None, "cut at {end}");
            }
        }
    }

    #[test]
    fn a_count_beyond_the_message_is_refused() {
        let mut bytes = ros1((1, 2), &["a"], [&[1.0], &[], &[1.0]]);
        bytes[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(JointStateMessage::read(&bytes, Encoding::Ros1), None);
    }
}
