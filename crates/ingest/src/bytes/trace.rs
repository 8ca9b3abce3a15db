//! KUKA traces as the text of a CSV file: a header of DIAdem (`.dat`) and its binary channels (`.r64`) in the same
//! folder.
//!
//! A trace of the drives has a pair of files per drive, `NAME#1.dat`, `NAME#2.dat` and so on, with channels of the same
//! names. The first header represents the whole trace.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use super::access::asking;
use super::bag::cell;
use super::fingerprint::{HashingReader, RunningHash, regular_file};
use super::source::unreadable;
use crate::rejection::Rejection;
use armwatch_model::text;

/// First bytes of a header, from DIAdem and from other programs.
const STARTS: [&[u8]; 2] = [b"DIAEXTEN", b"#BEGINGL"];

/// Most bytes of a header. One of a hundred channels has some 30 KiB.
const MOST_HEADER_BYTES: u64 = 1 << 20;

/// Most channels of all headers.
const MOST_CHANNELS: usize = 1000;

/// Most pairs of files of one trace: an arm with external axes has twelve drives.
const MOST_DRIVES: usize = 32;

/// Rows that are converted to text at once.
const ROWS_AT_ONCE: usize = 1024;

/// Bytes of a value.
const VALUE_BYTES: u64 = 8;

/// Bytes that are read at once for the hash.
const HASHED_BYTES: usize = 1 << 20;

const REMEDY: &str = "copy the .dat and .r64 files of the trace again, together";

/// Returns true for the first bytes of a header.
pub(super) fn is_header(head: &[u8]) -> bool {
    STARTS.iter().any(|start| head.starts_with(start))
}

/// Returns true if the name is that of the first header of a trace and its binary channels are in the same folder.
pub(crate) fn is_trace(path: &Path) -> bool {
    let Some(name) = header_stem(path) else { return false };
    !name.starts_with('.') && drive_of(&name).is_none_or(|drive| drive == 1) && data_of(path).exists()
}

/// The other files of the trace that begins at `path`, in the order of the hash. Other exports have none.
pub(crate) fn companions(path: &Path) -> Vec<PathBuf> {
    let Some(name) = header_stem(path) else { return Vec::new() };
    let mut all = vec![data_of(path)];
    if drive_of(&name) == Some(1) {
        let base = name.trim_end_matches('1');
        let header = |drive: usize| path.with_file_name(format!("{base}{drive}.{}", ending(path)));
        let others = (2..=MOST_DRIVES).map(header).take_while(|header| header.exists());
        all.extend(others.flat_map(|header| [header.clone(), data_of(&header)]));
    }
    all.retain(|file| file.exists());
    all
}

/// The name of a header without its ending.
fn header_stem(path: &Path) -> Option<String> {
    ending(path)
        .eq_ignore_ascii_case("dat")
        .then(|| path.file_stem().map(|stem| stem.to_string_lossy().into_owned()))?
}

fn ending(path: &Path) -> Cow<'_, str> {
    path.extension().map_or_else(Cow::default, |ending| ending.to_string_lossy())
}

/// The number of the drive in `NAME#1`.
fn drive_of(stem: &str) -> Option<usize> {
    stem.rsplit_once('#').and_then(|(_, drive)| drive.parse().ok())
}

/// The binary channels of a header have its name.
fn data_of(header: &Path) -> PathBuf {
    let [small, capital] = ["r64", "R64"].map(|ending| header.with_extension(ending));
    if !small.exists() && capital.exists() { capital } else { small }
}

/// The rows of a trace as CSV.
pub(super) struct TraceText {
    channels: Vec<TraceChannel>,
    rows: u64,
    /// Number of the next row.
    next: u64,
    bytes: Vec<u8>,
    text: VecDeque<u8>,
}

/// A channel: `offset + factor x`, where `x` is the number of the row or the value in a file.
struct TraceChannel {
    offset: f64,
    factor: f64,
    values: Option<Values>,
    /// Values of the rows that are converted to text.
    ready: Vec<f64>,
}

/// The values of a channel in a file.
struct Values {
    file: std::sync::Arc<File>,
    /// Place of the first value, and distance from one to the next, bytes.
    first: u64,
    stride: u64,
    count: u64,
    big_endian: bool,
}

impl TraceText {
    /// Opens a trace and hashes all its files.
    ///
    /// # Errors
    /// A rejection of a trace whose files do not fit together.
    pub(super) fn open(file: File, path: &Path) -> Result<(Self, RunningHash), Rejection> {
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |error: io::Error| Rejection::from_io(&path, &error)
        };
        let mut all: Box<dyn Read> = Box::new(file);
        for companion in companions(path) {
            all = Box::new(all.chain(regular_file(&companion).map_err(failed(&companion))?));
        }
        let (mut hashed, hash) = HashingReader::new(all);
        let mut buffer = vec![0; HASHED_BYTES];
        while hashed.read(&mut buffer).map_err(failed(path))? > 0 {}
        let stem = header_stem(path).unwrap_or_default();
        let drives = if drive_of(&stem) == Some(1) { MOST_DRIVES } else { 1 };
        let (mut names, mut channels) = (Vec::new(), Vec::<TraceChannel>::new());
        let mut clock: Option<(String, f64, f64)> = None;
        for drive in 1..=drives {
            let header = match drive {
                1 => path.to_owned(),
                _ => path.with_file_name(format!("{}{drive}.{}", stem.trim_end_matches('1'), ending(path))),
            };
            if drive > 1 && !header.exists() {
                break;
            }
            let described = described(&header).map_err(failed(&header))?;
            let values = values(&header, &described).map_err(failed(&header))?;
            for (of, values) in described.channels.into_iter().zip(values) {
                let (offset, factor) = (of.offset, of.factor);
                let name = match &values {
                    // every drive of a trace has the time of the first
                    None => match &clock {
                        None => {
                            clock = Some((of.shown(None), offset, factor));
                            of.shown(None)
                        }
                        Some(known) if *known == (of.shown(None), offset, factor) => continue,
                        Some(_) => {
                            let reason = format!(
                                "channel {} does not count like the first time of the trace",
                                of.name
                            );
                            return Err(Rejection::of_file(
                                &header,
                                reason,
                                "trace all drives at the same rate",
                            ));
                        }
                    },
                    Some(_) => of.shown(drive_of(&stem).map(|_| drive)),
                };
                names.push(name);
                channels.push(TraceChannel { offset, factor, values, ready: Vec::new() });
            }
        }
        let rows = channels.iter().filter_map(|of| of.values.as_ref()).map(|of| of.count).max().unwrap_or(0);
        let text = (names.join(",") + "\n").into_bytes();
        Ok((Self { channels, rows, next: 0, bytes: Vec::new(), text: text.into() }, hash))
    }

    /// Converts the next rows to text.
    fn fill(&mut self) -> io::Result<()> {
        let rows = (self.rows - self.next).min(ROWS_AT_ONCE as u64);
        for channel in &mut self.channels {
            channel.ready(self.next, rows, &mut self.bytes)?;
        }
        for row in 0..rows as usize {
            for (at, channel) in self.channels.iter().enumerate() {
                if at > 0 {
                    self.text.push_back(b',');
                }
                // a shorter channel has empty cells at its end; writing to memory does not fail
                if let Some(value) = channel.ready.get(row) {
                    let _ = write!(self.text, "{value:?}");
                }
            }
            self.text.push_back(b'\n');
        }
        self.next += rows;
        Ok(())
    }
}

impl Read for TraceText {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.text.is_empty() {
            self.fill()?;
        }
        self.text.read(buffer)
    }
}

impl TraceChannel {
    /// Reads the values of `rows` rows from row `first` on.
    fn ready(&mut self, first: u64, rows: u64, bytes: &mut Vec<u8>) -> io::Result<()> {
        self.ready.clear();
        let (offset, factor) = (self.offset, self.factor);
        let Some(values) = &self.values else {
            self.ready.extend((first..first + rows).map(|row| offset + factor * row as f64));
            return Ok(());
        };
        let rows = rows.min(values.count.saturating_sub(first));
        if rows == 0 {
            return Ok(());
        }
        bytes.resize(((rows - 1) * values.stride + VALUE_BYTES) as usize, 0);
        let place = values.first + first * values.stride;
        asking(|| values.file.read_exact_at(bytes, place)).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                damaged("a trace whose binary channels became shorter while they were read")
            }
            _ => error,
        })?;
        let number = |bytes: &[u8]| {
            let mut value = [0; VALUE_BYTES as usize];
            value.copy_from_slice(&bytes[..VALUE_BYTES as usize]);
            if values.big_endian { f64::from_be_bytes(value) } else { f64::from_le_bytes(value) }
        };
        let each = bytes.chunks(values.stride as usize).map(number);
        self.ready.extend(each.map(|value| offset + factor * value));
        Ok(())
    }
}

/// A header.
struct Described {
    channels: Vec<ChannelHeader>,
    big_endian: bool,
}

/// A channel in a header.
struct ChannelHeader {
    name: String,
    unit: String,
    implicit: bool,
    /// The values of all channels of a row are adjacent, instead of those of a channel.
    block: bool,
    kind: String,
    count: u64,
    /// Number of the first value, from 1.
    pointer: u64,
    offset: f64,
    factor: f64,
}

impl ChannelHeader {
    /// The name of the column.
    fn shown(&self, drive: Option<usize>) -> String {
        let drive = drive.map_or_else(String::new, |drive| format!("#{drive}"));
        let unit = if self.unit.is_empty() { String::new() } else { format!(" [{}]", self.unit) };
        cell(&format!("{}{drive}{unit}", self.name))
    }
}

fn damaged(reason: &str) -> io::Error {
    unreadable(reason.to_owned(), REMEDY)
}

/// Reads a header.
fn described(path: &Path) -> io::Result<Described> {
    let mut bytes = Vec::new();
    let file = regular_file(path)?;
    asking(|| file.take(MOST_HEADER_BYTES + 1).read_to_end(&mut bytes))?;
    if bytes.len() as u64 > MOST_HEADER_BYTES {
        return Err(damaged("a header of a trace with more than 1 MiB"));
    }
    let text = match std::str::from_utf8(&bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => encoding_rs::WINDOWS_1252.decode(&bytes).0,
    };
    let mut found = Described { channels: Vec::new(), big_endian: false };
    let mut open: Option<ChannelHeader> = None;
    for (number, line) in (1..).zip(text.lines()) {
        let line = line.trim();
        match line {
            "#BEGINCHANNELHEADER" if open.is_none() && found.channels.len() < MOST_CHANNELS => {
                open = Some(ChannelHeader {
                    name: format!("channel {}", found.channels.len() + 1),
                    unit: String::new(),
                    implicit: false,
                    block: false,
                    kind: "REAL64".to_owned(),
                    count: 0,
                    pointer: 1,
                    offset: 0.0,
                    factor: 1.0,
                });
            }
            "#BEGINCHANNELHEADER" => {
                return Err(damaged(&format!(
                    "a header of a trace whose line {number} begins a channel inside another one, or \
                    exceeds {MOST_CHANNELS} channels"
                )));
            }
            "#ENDCHANNELHEADER" => found.channels.extend(open.take()),
            _ => {
                let Some((key, value)) = line.split_once(',') else { continue };
                let value = value.trim();
                match &mut open {
                    Some(channel) => channel.take(key, value).ok_or_else(|| {
                        damaged(&format!(
                            "a header of a trace whose line {number}, \"{}\", has an unknown value",
                            text::shown(line)
                        ))
                    })?,
                    None if key == "112" => found.big_endian = value.eq_ignore_ascii_case("Low -> High"),
                    None => {}
                }
            }
        }
    }
    if open.is_some() {
        return Err(damaged("a header of a trace that ends within a channel"));
    }
    if !found.channels.iter().any(|channel| !channel.implicit) {
        return Err(damaged("a header of a trace without a channel in a file"));
    }
    Ok(found)
}

impl ChannelHeader {
    /// Stores the value of a key; `None` if it is not one of those that are read.
    fn take(&mut self, key: &str, value: &str) -> Option<()> {
        let number = |value: &str| value.parse::<f64>().ok().filter(|number| number.is_finite());
        match key {
            "200" if !value.is_empty() => self.name = value.to_owned(),
            "202" => self.unit = value.to_owned(),
            "210" => self.implicit = one_of(value, ["IMPLICIT", "IMPLIZIT"], ["EXPLICIT", "EXPLIZIT"])?,
            "213" => self.block = one_of(value, ["BLOCK", "BLOCK"], ["CHANNEL", "KANAL"])?,
            "214" => self.kind = value.to_ascii_uppercase(),
            "220" => self.count = value.parse().ok()?,
            "221" => self.pointer = value.parse().ok().filter(|pointer| *pointer > 0)?,
            "240" if !value.is_empty() => self.offset = number(value)?,
            "241" if !value.is_empty() => self.factor = number(value)?,
            _ => {}
        }
        Some(())
    }
}

fn one_of(value: &str, yes: [&str; 2], no: [&str; 2]) -> Option<bool> {
    let is = |words: [&str; 2]| words.iter().any(|word| word.eq_ignore_ascii_case(value));
    (is(yes) || is(no)).then(|| is(yes))
}

/// The values of each channel of a header. A channel that the header computes has `None`. All bytes of the file must
/// belong to some channel, so that a value is never assigned to another one.
fn values(header: &Path, described: &Described) -> io::Result<Vec<Option<Values>>> {
    let path = data_of(header);
    let file = regular_file(&path)?;
    let bytes = asking(|| file.metadata())?.len();
    let file = std::sync::Arc::new(file);
    let explicit = || described.channels.iter().filter(|channel| !channel.implicit);
    let wanted = explicit().map(|channel| u128::from(channel.count)).sum::<u128>() * u128::from(VALUE_BYTES);
    if wanted != u128::from(bytes) {
        let name = text::of_file_name(&path);
        return Err(damaged(&format!(
            "a trace whose header describes {wanted} bytes of channels, and {name} has {bytes}"
        )));
    }
    if let Some(other) = explicit().find(|channel| channel.kind != "REAL64") {
        let reason = format!(
            "a trace whose channel {} has values of the type {}",
            text::shown(&other.name),
            text::shown(&other.kind)
        );
        return Err(unreadable(reason, "trace into REAL64 channels (.r64)"));
    }
    let in_block = explicit().filter(|channel| channel.block).count() as u64;
    let of = |channel: &ChannelHeader| {
        if channel.implicit {
            return Ok(None);
        }
        let stride = if channel.block { in_block * VALUE_BYTES } else { VALUE_BYTES };
        let first = (channel.pointer - 1).checked_mul(VALUE_BYTES);
        let end = first.and_then(|first| {
            channel.count.checked_sub(1)?.checked_mul(stride)?.checked_add(first)?.checked_add(VALUE_BYTES)
        });
        match (first, end) {
            (Some(first), Some(end)) if end <= bytes => {
                let (file, big_endian) = (std::sync::Arc::clone(&file), described.big_endian);
                Ok(Some(Values { file, first, stride, count: channel.count, big_endian }))
            }
            _ => Err(damaged(&format!(
                "a trace whose channel {} is not within the file",
                text::shown(&channel.name)
            ))),
        }
    };
    described.channels.iter().map(of).collect()
}
