//! MCAP bags as the text of a CSV file, so that the same reader checks the rows of both: one row per message of the
//! type `sensor_msgs/JointState`.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use mcap::records::op;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::joint_state::{Encoding, JointStateMessage};
use super::source::unreadable;
use armwatch_model::text;

/// First bytes of a bag.
pub(super) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Names of the type of messages that are read, with ROS 2 and with ROS 1.
const TYPES: [&str; 2] = ["sensor_msgs/msg/JointState", "sensor_msgs/JointState"];

/// Largest record or chunk, compressed or not. Recorders make chunks of about 1 MiB.
const MOST_RECORD_BYTES: usize = 32 << 20;

/// Bytes that are read at once.
const READ_BYTES: usize = 1 << 20;

/// Replaces rows that a damaged bag has lost. The reader omits such a line without end, and adds a remark.
const LOST: &[u8] = b"(the bag is damaged here)";

/// Most topics that a message names.
const MOST_NAMED: usize = 5;

/// The joint states of a bag as CSV.
pub(super) struct BagText<R> {
    file: R,
    reader: LinearReader,
    path: PathBuf,
    /// Schemas of joint states, by number.
    schemas: BTreeSet<u16>,
    /// Channels of joint states, by number.
    channels: BTreeMap<u16, Topic>,
    columns: Option<Columns>,
    text: VecDeque<u8>,
    ended: bool,
}

/// A request of the reader of records.
enum ReaderRequest {
    Read(usize),
    Take(BagRecord),
}

/// Parts of the records that describe and contain joint states.
enum BagRecord {
    Schema { id: u16, name: String },
    Channel { id: u16, schema: u16, topic: String, encoding: String },
    Message { channel: u16, log_time: u64, data: Vec<u8> },
    Other,
}

impl BagRecord {
    /// Reads a record. `None` if a length in it is beyond its end; `mcap` would allocate that length.
    fn read(opcode: u8, mut data: &[u8]) -> Option<Self> {
        let data = &mut data;
        Some(match opcode {
            op::SCHEMA => Self::Schema { id: u16::from_le_bytes(array(data)?), name: string(data)? },
            op::CHANNEL => Self::Channel {
                id: u16::from_le_bytes(array(data)?),
                schema: u16::from_le_bytes(array(data)?),
                topic: string(data)?,
                encoding: string(data)?,
            },
            op::MESSAGE => {
                let channel = u16::from_le_bytes(array(data)?);
                let _sequence = array::<4>(data)?;
                let log_time = u64::from_le_bytes(array(data)?);
                let _publish_time = array::<8>(data)?;
                Self::Message { channel, log_time, data: data.to_vec() }
            }
            _ => Self::Other,
        })
    }
}

/// Takes the first bytes of `data`.
fn array<const N: usize>(data: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = data.split_first_chunk()?;
    *data = rest;
    Some(*first)
}

/// Takes a string with its length from the beginning of `data`.
fn string(data: &mut &[u8]) -> Option<String> {
    let length = usize::try_from(u32::from_le_bytes(array(data)?)).ok()?;
    let (text, rest) = data.split_at_checked(length)?;
    *data = rest;
    Some(String::from_utf8_lossy(text).into_owned())
}

struct Topic {
    name: String,
    encoding: Encoding,
    messages: u64,
}

/// Joints and quantities of the rows: those of the first message with positions and efforts.
struct Columns {
    channel: u16,
    names: Vec<String>,
    /// Presence of positions, velocities and efforts.
    has: [bool; 3],
}

impl<R: Read> BagText<R> {
    pub(super) fn new(file: R, path: &Path) -> Self {
        // a recorder that was killed leaves a bag without an end
        let options = LinearReaderOptions::default()
            .with_prevalidate_chunk_crcs(true)
            .with_skip_end_magic(true)
            .with_record_length_limit(MOST_RECORD_BYTES);
        Self {
            file,
            reader: LinearReader::new_with_options(options),
            path: path.to_owned(),
            schemas: BTreeSet::new(),
            channels: BTreeMap::new(),
            columns: None,
            text: VecDeque::new(),
            ended: false,
        }
    }

    /// Makes the next messages text.
    fn fill(&mut self) -> io::Result<()> {
        while self.text.is_empty() && !self.ended {
            let step = match self.reader.next_event() {
                None => return self.end(),
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => Ok(ReaderRequest::Read(wanted)),
                Some(Ok(LinearReadEvent::Record { data, opcode })) => BagRecord::read(opcode, data)
                    .map(ReaderRequest::Take)
                    .ok_or_else(|| "a length in a record is beyond its end".to_owned()),
                Some(Err(error)) => Err(error.to_string()),
            };
            match step {
                Ok(ReaderRequest::Take(record)) => self.take(record),
                Ok(ReaderRequest::Read(wanted)) => {
                    let count = self.file.read(self.reader.insert(wanted.min(READ_BYTES)))?;
                    self.reader.notify_read(count);
                }
                Err(error) => return self.end_early(&error),
            }
        }
        Ok(())
    }

    /// Reads the rest of the file for its hash: the end of a bag contains no joints.
    fn end(&mut self) -> io::Result<()> {
        self.ended = true;
        io::copy(&mut self.file, &mut io::sink())?;
        if self.columns.is_none() {
            return Err(self.nothing());
        }
        self.name_other_topics();
        Ok(())
    }

    fn take(&mut self, record: BagRecord) {
        match record {
            BagRecord::Schema { id, name } if TYPES.contains(&name.as_str()) => {
                self.schemas.insert(id);
            }
            BagRecord::Channel { id, schema, topic, encoding } if self.schemas.contains(&schema) => {
                if let Some(encoding) = Encoding::named(&encoding) {
                    self.channels.entry(id).or_insert(Topic { name: topic, encoding, messages: 0 });
                }
            }
            BagRecord::Message { channel, log_time, data } => {
                let Some(topic) = self.channels.get_mut(&channel) else { return };
                let Some(state) = JointStateMessage::read(&data, topic.encoding) else { return };
                topic.messages += 1;
                self.add(channel, log_time, &state);
            }
            BagRecord::Schema { .. } | BagRecord::Channel { .. } | BagRecord::Other => {}
        }
    }

    /// Adds a row. A message that lacks a joint or a quantity belongs to another part of the robot, such as a gripper.
    fn add(&mut self, channel: u16, log_time: u64, state: &JointStateMessage<'_>) {
        let has =
            state.values.each_ref().map(|values| !values.is_empty() && values.len() == state.names.len());
        if self.columns.is_none() && has[2] && has[0] {
            let names: Vec<String> = state.names.iter().map(|name| (*name).to_owned()).collect();
            let quantities = ["position", "velocity", "effort"];
            self.text.extend(b"time");
            for (quantity, _) in quantities.iter().zip(has).filter(|(_, has)| *has) {
                names.iter().for_each(|name| drop(write!(self.text, ",{}/{quantity}", cell(name))));
            }
            self.text.push_back(b'\n');
            self.columns = Some(Columns { channel, names, has });
        }
        let Some(columns) = self.columns.as_ref().filter(|columns| columns.channel == channel) else {
            return;
        };
        let place = |name: &String| state.names.iter().position(|one| *one == name.as_str());
        let Some(places) = columns.names.iter().map(place).collect::<Option<Vec<usize>>>() else { return };
        if columns.has.iter().zip(has).any(|(wanted, has)| *wanted && !has) {
            return;
        }
        // some publishers leave the stamp at zero
        let (seconds, nanoseconds) = match state.stamp {
            (0, 0) => ((log_time / 1_000_000_000) as i64, (log_time % 1_000_000_000) as u32),
            (seconds, nanoseconds) => (i64::from(seconds), nanoseconds),
        };
        // writing to memory does not fail
        let _ = write!(self.text, "{seconds}.{nanoseconds:09}");
        for (values, _) in state.values.iter().zip(columns.has).filter(|(_, has)| *has) {
            places.iter().for_each(|place| drop(write!(self.text, ",{:?}", values[*place])));
        }
        self.text.push_back(b'\n');
    }

    fn end_early(&mut self, error: &str) -> io::Result<()> {
        if self.columns.is_none() {
            self.ended = true;
            let reason = format!("a damaged MCAP bag without a complete message of joint states ({error})");
            return Err(unreadable(reason, "copy the bag again, or record it again"));
        }
        let path = text::of_path(&self.path);
        tracing::warn!(%path, error, "the bag is damaged; its complete messages before the damage are read");
        self.text.extend(LOST);
        self.end()
    }

    fn nothing(&self) -> io::Error {
        let topics: Vec<&str> =
            self.channels.values().map(|topic| topic.name.as_str()).take(MOST_NAMED).collect();
        let reason = match topics.as_slice() {
            [] => "an MCAP bag without a topic of type sensor_msgs/JointState".to_owned(),
            topics => format!("an MCAP bag without positions and efforts of joints in {}", topics.join(", ")),
        };
        unreadable(reason, "record a topic of type sensor_msgs/JointState with positions and efforts")
    }

    fn name_other_topics(&self) {
        let read = self.columns.as_ref().map(|columns| columns.channel);
        let others: Vec<&str> = (self.channels.iter())
            .filter(|(channel, topic)| Some(**channel) != read && topic.messages > 0)
            .map(|(_, topic)| topic.name.as_str())
            .take(MOST_NAMED)
            .collect();
        let read =
            read.and_then(|channel| self.channels.get(&channel)).map_or("", |topic| topic.name.as_str());
        if !others.is_empty() {
            let (path, others) = (text::of_path(&self.path), text::shown(&others.join(", ")).into_owned());
            tracing::warn!(%path, read, others, "the bag has several topics of joint states; one is read");
        }
    }
}

impl<R: Read> Read for BagText<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.text.is_empty() {
            self.fill()?;
        }
        self.text.read(buffer)
    }
}

/// A name as a part of a header.
pub(super) fn cell(name: &str) -> String {
    name.replace([',', '"', '\n', '\r', '\0'], "_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_length_beyond_the_end_of_its_record_is_damage() {
        let schema = [&[1, 0, 4, 0, 0, 0][..], b"name"].concat();
        assert!(matches!(BagRecord::read(op::SCHEMA, &schema), Some(BagRecord::Schema { id: 1, .. })));
        let long = [&[1, 0, 0xff, 0xff, 0xff, 0x7f][..], b"name"].concat();
        assert!(BagRecord::read(op::SCHEMA, &long).is_none());
        assert!(BagRecord::read(op::MESSAGE, &schema).is_none());
        // records that are not needed are not read
        assert!(matches!(BagRecord::read(op::CHUNK_INDEX, &long), Some(BagRecord::Other)));
    }
}
