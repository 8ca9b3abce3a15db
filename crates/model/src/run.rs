//! Recordings: a run is one export, made of cycles, each made of stages.

pub mod arrival;
pub mod channel_delays;
pub mod slower;
pub mod stage_rule;
pub mod temperature;

use std::fmt;
use std::ops::Range;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use temperature::Temperatures;

use crate::robot::JointIndex;

crate::named_enum! {
    /// Part of a cycle, as the controller's stage signal separates them.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
    pub enum Stage {
        /// Between stages: moving to the next posture or waiting.
        Between = "between",
        /// Fourier trajectory and full-speed trajectory, for identification.
        Excitation = "excitation",
        /// Each joint alone, back and forth at constant speeds.
        Friction = "friction",
        /// All joints together, to warm the gearboxes.
        Warming = "warming",
    }
}

impl Stage {
    /// The three stages that are analysed, in the order of a test.
    pub const ANALYSED: [Self; 3] = [Self::Excitation, Self::Friction, Self::Warming];

    /// Number in the native layout.
    #[must_use]
    pub fn number(self) -> u8 {
        match self {
            Self::Between => 0,
            Self::Excitation => 1,
            Self::Friction => 2,
            Self::Warming => 3,
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Moving joint and speed level in a row of the friction stage, from the controller's signals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrictionSignal {
    /// The joint under test.
    pub joint: JointIndex,
    /// Speed level, from 1 upwards.
    pub level: u8,
}

/// Consecutive rows of a recording in SI units, one vector per channel; `S` is the channel of stages.
///
/// All vectors have the same length `rows`. Joint channels are `[n][rows]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rows<S> {
    /// Time since the start of the recording, s.
    pub time: Vec<f64>,
    /// Joint positions, rad (m); NaN in logs without positions.
    pub position: Vec<Vec<f64>>,
    /// Joint velocities, rad/s (m/s), if recorded.
    pub velocity: Option<Vec<Vec<f64>>>,
    /// Joint torques, Nm (N).
    pub torque: Vec<Vec<f64>>,
    /// Stage of each row, or the export's information about it.
    pub stage: S,
    /// Cycle counter of each row, from 1, if recorded; 0 before and after the test.
    pub cycle: Option<Vec<u32>>,
    /// Joint and level of each row, if recorded; `None` in a row outside the friction stage.
    pub friction_signal: Option<Vec<Option<FrictionSignal>>>,
    /// Motor temperatures and ambient temperature, if any is recorded.
    pub temperatures: Option<Temperatures>,
}

/// Rows whose stages are known.
pub type Samples = Rows<Vec<Stage>>;

/// Rows as in an export: `armwatch_method::segment::stages` determines their stages.
pub type RawSamples = Rows<StageReading>;

/// An export's information about the stages of rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum StageReading {
    /// The stage of each row.
    Known(Vec<Stage>),
    /// The level of an analogue signal in each row, in the unit of the export.
    Level(Vec<f64>),
    /// Nothing.
    #[default]
    Unknown,
}

/// A channel of stages, which grows and is divided with the rows.
pub trait StageChannel: Default {
    /// Appends a channel of the same kind.
    fn append(&mut self, other: Self);
    /// Removes and returns the part after the first `rows` rows.
    fn split_off(&mut self, rows: usize) -> Self;
    /// Frees memory that the rows do not need.
    fn shrink_to_fit(&mut self);
    /// Reserves memory for `rows` more rows.
    fn reserve(&mut self, rows: usize);
}

impl StageChannel for Vec<Stage> {
    fn append(&mut self, mut other: Self) {
        Self::append(self, &mut other);
    }

    fn split_off(&mut self, rows: usize) -> Self {
        Self::split_off(self, rows)
    }

    fn shrink_to_fit(&mut self) {
        Self::shrink_to_fit(self);
    }

    fn reserve(&mut self, rows: usize) {
        Self::reserve(self, rows);
    }
}

impl StageChannel for StageReading {
    fn append(&mut self, other: Self) {
        match (self, other) {
            (Self::Known(mine), Self::Known(mut theirs)) => mine.append(&mut theirs),
            (Self::Level(mine), Self::Level(mut theirs)) => mine.append(&mut theirs),
            _ => {}
        }
    }

    fn split_off(&mut self, rows: usize) -> Self {
        match self {
            Self::Known(stages) => Self::Known(stages.split_off(rows)),
            Self::Level(levels) => Self::Level(levels.split_off(rows)),
            Self::Unknown => Self::Unknown,
        }
    }

    fn shrink_to_fit(&mut self) {
        match self {
            Self::Known(stages) => stages.shrink_to_fit(),
            Self::Level(levels) => levels.shrink_to_fit(),
            Self::Unknown => {}
        }
    }

    fn reserve(&mut self, rows: usize) {
        match self {
            Self::Known(stages) => stages.reserve(rows),
            Self::Level(levels) => levels.reserve(rows),
            Self::Unknown => {}
        }
    }
}

impl<S> Rows<S> {
    /// The same rows with another channel of stages.
    #[must_use]
    pub fn with_stages<T>(self, stage: T) -> Rows<T> {
        let Self { time, position, velocity, torque, stage: _, cycle, friction_signal, temperatures } = self;
        Rows { time, position, velocity, torque, stage, cycle, friction_signal, temperatures }
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.time.len()
    }

    /// True if there is no row.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// True if positions are recorded.
    #[must_use]
    pub fn has_positions(&self) -> bool {
        !self.position.iter().any(|joint| joint.first().is_some_and(|position| position.is_nan()))
    }

    /// Number of joints `n`.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.position.len()
    }
}

impl RawSamples {
    /// The rows with the stages from their export; without any, all are between stages.
    #[must_use]
    pub fn as_recorded(mut self) -> Samples {
        let stages = match std::mem::take(&mut self.stage) {
            StageReading::Known(stages) => stages,
            StageReading::Level(_) | StageReading::Unknown => vec![Stage::Between; self.rows()],
        };
        self.with_stages(stages)
    }
}

impl<S: StageChannel> Rows<S> {
    /// Appends `other`, which has the same channels.
    pub fn append(&mut self, mut other: Self) {
        if self.is_empty() {
            *self = other;
            return;
        }
        self.time.append(&mut other.time);
        append_channels(&mut self.position, &mut other.position);
        if let (Some(mine), Some(theirs)) = (&mut self.velocity, &mut other.velocity) {
            append_channels(mine, theirs);
        }
        append_channels(&mut self.torque, &mut other.torque);
        self.stage.append(other.stage);
        if let (Some(mine), Some(theirs)) = (&mut self.cycle, &mut other.cycle) {
            mine.append(theirs);
        }
        if let (Some(mine), Some(theirs)) = (&mut self.friction_signal, &mut other.friction_signal) {
            mine.append(theirs);
        }
        if let (Some(mine), Some(theirs)) = (&mut self.temperatures, other.temperatures) {
            mine.append(theirs);
        }
    }

    /// Frees memory that the rows do not need if it exceeds a quarter of the needed memory. Channels that grew step by
    /// step have up to twice the capacity that they need.
    pub fn shrink_to_fit(&mut self) {
        let enough = self.rows() + self.rows() / 4;
        let roomy = self.channels_mut().filter(|channel| channel.capacity() > enough);
        roomy.for_each(|channel| channel.shrink_to(enough));
        self.stage.shrink_to_fit();
        self.cycle.iter_mut().for_each(Vec::shrink_to_fit);
        self.friction_signal.iter_mut().for_each(Vec::shrink_to_fit);
    }

    /// Channels of numbers: time, positions, velocities, torques.
    pub fn channels_mut(&mut self) -> impl Iterator<Item = &mut Vec<f64>> {
        let joints = self.position.iter_mut().chain(self.velocity.iter_mut().flatten());
        std::iter::once(&mut self.time).chain(joints).chain(&mut self.torque)
    }

    /// Memory of a row, bytes; without temperatures, which are few.
    #[must_use]
    pub fn row_bytes(&self) -> usize {
        let joints = self.position.len() + self.velocity.as_ref().map_or(0, Vec::len) + self.torque.len();
        let counter = self.cycle.as_ref().map_or(0, |_| size_of::<u32>());
        let signal = self.friction_signal.as_ref().map_or(0, |_| size_of::<Option<FrictionSignal>>());
        (1 + joints) * size_of::<f64>() + size_of::<Stage>() + counter + signal
    }

    /// Reserves memory for `rows` more rows; without temperatures, which are few.
    pub fn reserve(&mut self, rows: usize) {
        self.channels_mut().for_each(|channel| channel.reserve(rows));
        self.stage.reserve(rows);
        self.cycle.iter_mut().for_each(|cycle| cycle.reserve(rows));
        self.friction_signal.iter_mut().for_each(|signal| signal.reserve(rows));
    }

    /// Removes and returns the first `rows` rows; the rest stays.
    pub fn take_front(&mut self, rows: usize) -> Self {
        let first_temperatures = self.temperatures.as_mut().map(|t| t.take_front(rows));
        let rest = Self {
            time: self.time.split_off(rows),
            position: split_channels(&mut self.position, rows),
            velocity: self.velocity.as_mut().map(|v| split_channels(v, rows)),
            torque: split_channels(&mut self.torque, rows),
            stage: self.stage.split_off(rows),
            cycle: self.cycle.as_mut().map(|c| c.split_off(rows)),
            friction_signal: self.friction_signal.as_mut().map(|f| f.split_off(rows)),
            temperatures: self.temperatures.take(),
        };
        Self { temperatures: first_temperatures, ..std::mem::replace(self, rest) }
    }
}

impl Samples {
    /// No rows, with the same channels; `channel` creates each channel of numbers.
    #[must_use]
    pub fn without_rows(&self, channel: impl Fn() -> Vec<f64>) -> Self {
        let joints = |channels: &Vec<Vec<f64>>| channels.iter().map(|_| channel()).collect();
        Self {
            time: channel(),
            position: joints(&self.position),
            velocity: self.velocity.as_ref().map(joints),
            torque: joints(&self.torque),
            stage: Vec::new(),
            cycle: self.cycle.as_ref().map(|_| Vec::new()),
            friction_signal: self.friction_signal.as_ref().map(|_| Vec::new()),
            temperatures: self.temperatures.as_ref().map(Temperatures::without_rows),
        }
    }

    /// Appends copies of `rows` of `other`, which has the same channels. Temperatures are moved: the first ones of
    /// `other` are removed, so the ranges of several calls must be consecutive.
    pub fn append_rows(&mut self, other: &mut Self, rows: Range<usize>) {
        for (mine, theirs) in self.channels_mut().zip(other.channels_mut()) {
            mine.extend_from_slice(&theirs[rows.clone()]);
        }
        self.stage.extend_from_slice(&other.stage[rows.clone()]);
        if let (Some(mine), Some(theirs)) = (&mut self.cycle, &other.cycle) {
            mine.extend_from_slice(&theirs[rows.clone()]);
        }
        if let (Some(mine), Some(theirs)) = (&mut self.friction_signal, &other.friction_signal) {
            mine.extend_from_slice(&theirs[rows.clone()]);
        }
        if let (Some(mine), Some(theirs)) = (&mut self.temperatures, &mut other.temperatures) {
            mine.append(theirs.take_front(rows.len()));
        }
    }
}

fn append_channels(mine: &mut [Vec<f64>], theirs: &mut [Vec<f64>]) {
    for (a, b) in mine.iter_mut().zip(theirs) {
        a.append(b);
    }
}

fn split_channels(channels: &mut [Vec<f64>], at: usize) -> Vec<Vec<f64>> {
    channels.iter_mut().map(|c| c.split_off(at)).collect()
}

/// One repetition of the test: the unit of transfer and of analysis.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Number in the run, from 1.
    pub number: u32,
    /// Rows of the cycle, including those between stages.
    pub samples: Samples,
}

/// BLAKE3 hash of an export's bytes on disk: the identity of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ContentHash(pub [u8; 32]);

impl fmt::Display for ContentHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

/// The first bytes of an export, identified by their hash: the source of stored cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ContentPrefix {
    /// Number of bytes, from the first.
    pub bytes: u64,
    /// BLAKE3 hash of these bytes.
    pub hash: ContentHash,
}

/// A file by its number in its file system, independent of its name. The system uses a number again when its file is
/// gone, so it only indicates where to look; content decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct FileId {
    /// Number of the file system.
    pub device: u64,
    /// Number of the file in it.
    pub inode: u64,
}

/// Data of an export that are known before its rows are read.
#[derive(Debug, Clone, PartialEq)]
pub struct RunHeader {
    /// The individual robot, such as `R00`.
    pub robot: String,
    /// Model of its description, such as `er3a`.
    pub model: String,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// File name of the export, without its folder.
    pub source_name: String,
    /// Full path of the export, as it was found.
    pub source_path: String,
    /// Identity of the content; for a file that still grows, that of its content when it was opened.
    pub content_hash: ContentHash,
    /// Bytes of the export on disk.
    pub source_bytes: u64,
}

crate::named_enum! {
    /// Kind of a run's recording.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
    pub enum RunKind {
        /// The test: its stages serve to identify parameters and friction.
        #[default]
        Test = "test",
        /// Production, compared with the parameters of tests.
        Production = "production",
    }
}

crate::serialize_by_name!(RunKind);

crate::named_enum! {
    /// Status of a run.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
    pub enum RunStatus {
        /// Cycles are being stored.
        Streaming = "streaming",
        /// Every cycle is stored.
        Complete = "complete",
        /// The export could not be read; the reason is stored with the run.
        Quarantined = "quarantined",
        /// A corrected export superseded it; its stored results are kept, but take no part in conclusions.
        Superseded = "superseded",
        /// It was read completely, but takes no part in conclusions: a person has set it aside, or its start is
        /// implausible.
        SetAside = "set_aside",
    }
}
