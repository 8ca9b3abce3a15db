//! Shared parts of this crate's tests: the native layout, the fixture files, and generated exports.

use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::bytes::source::open;
use super::rejection::Rejection;
use super::table::reader::{Chunk, ExportReader, ReadOptions};
use armwatch_config::{
    AmbientTemperature, Channel, Column, JointColumns, JointDelays, JointSigns, Layout, MotorSide,
    MotorTemperature, RowRule, ScaledColumn, StageSignal, StageSource, TemperatureUnit, TextFormat,
    TimeSource, TorqueQuantity,
};
use armwatch_model::run::slower::SlowerChannels;
use armwatch_model::run::{FrictionSignal, RawSamples, Stage, StageReading};
use armwatch_testing::er3a;

/// The native layout: everything recorded, SI.
pub(super) fn native() -> Layout {
    let column = |name: &str| Column::Name(name.into());
    Layout {
        name: "native".into(),
        delimiter: b',',
        text: TextFormat::default(),
        rows: RowRule::default(),
        parts: None,
        header: true,
        time: TimeSource::Column(ScaledColumn { column: column("time"), to_si: 1.0 }),
        start: None,
        position: channel("pos_{joint}"),
        velocity: Some(channel("vel_{joint}")),
        torque: channel("trq_{joint}"),
        without_torque: Vec::new(),
        slower: SlowerChannels::default(),
        torque_quantity: TorqueQuantity::Torque,
        motor_temperature: Some(MotorTemperature {
            columns: JointColumns::Pattern("motor_temperature_{joint}_degc".into()),
            unit: TemperatureUnit::Celsius,
        }),
        ambient_temperature: Some(AmbientTemperature {
            column: column("ambient_temperature_degc"),
            unit: TemperatureUnit::Celsius,
        }),
        stage: StageSource::Signal(StageSignal {
            column: column("stage"),
            excitation: vec![1],
            friction: vec![2],
            warming: vec![3],
            between: vec![0],
        }),
        motor_side: MotorSide::default(),
        cycle: Some(column("cycle")),
        friction_joint: Some(column("joint")),
        friction_level: Some(column("level")),
    }
}

/// A channel in SI whose columns have this name.
pub(super) fn channel(pattern: &str) -> Channel {
    Channel {
        columns: JointColumns::Pattern(pattern.into()),
        to_si: 1.0,
        sign: JointSigns::All(1.0),
        delay: JointDelays::default(),
    }
}

/// Path of a file in `tests/fixtures/exports`.
pub(super) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/exports").join(name)
}

/// The whole export at `path`.
pub(super) fn read(path: &Path) -> Result<RawSamples, Rejection> {
    let options = ReadOptions::default();
    let reader = ExportReader::new(open(path)?, path, &native(), &er3a(), options)?;
    collected(reader)
}

/// The whole export `bytes`, called `a.csv`.
pub(super) fn read_bytes(
    bytes: &[u8],
    layout: &Layout,
    options: ReadOptions,
) -> Result<RawSamples, Rejection> {
    collected(ExportReader::new(bytes, Path::new("a.csv"), layout, &er3a(), options)?)
}

fn collected(reader: impl Iterator<Item = Result<Chunk, Rejection>>) -> Result<RawSamples, Rejection> {
    let mut samples = RawSamples::default();
    for chunk in reader {
        samples.append(chunk?.samples);
    }
    Ok(samples)
}

/// Blocks of this many bytes.
pub(super) fn with_blocks_of(block_bytes: usize) -> ReadOptions {
    ReadOptions { block_bytes }
}

/// A recording of arbitrary numbers, the same each time.
pub(super) fn made_recording(rows: usize) -> (RawSamples, String) {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    recording(rows, || random.random_range(-100.0..100.0))
}

/// A recording in the native layout: its samples and an export with the same content, with the shortest digits that
/// represent each number exactly.
pub(super) fn recording(rows: usize, mut number: impl FnMut() -> f64) -> (RawSamples, String) {
    let joints = 0..6;
    let mut channel =
        || -> Vec<Vec<f64>> { joints.clone().map(|_| (0..rows).map(|_| number()).collect()).collect() };
    let (position, velocity, torque) = (channel(), channel(), channel());
    let stages = Stage::ALL;
    let samples = RawSamples {
        time: (0..rows).map(|row| row as f64 * 0.002).collect(),
        position,
        velocity: Some(velocity),
        torque,
        stage: StageReading::Known((0..rows).map(|row| stages[row / 3 % 4]).collect()),
        cycle: Some((0..rows).map(|row| 1 + (row / 12) as u32).collect()),
        temperatures: None,
        friction_signal: Some(
            (0..rows)
                .map(|row| {
                    let joint = armwatch_model::robot::JointIndex::new(row % 6);
                    let tested = stages[row / 3 % 4] == Stage::Friction;
                    tested.then_some(FrictionSignal { joint, level: 1 + (row / 6 % 6) as u8 })
                })
                .collect(),
        ),
    };
    let text = export(&samples);
    (samples, text)
}

/// Rows with all channels in the native layout.
fn export(samples: &RawSamples) -> String {
    let names = |kind: &str| (1..=6).map(|joint| format!("{kind}_{joint}")).collect::<Vec<_>>().join(",");
    let mut text =
        format!("time,{},{},{},stage,cycle,joint,level\n", names("pos"), names("vel"), names("trq"));
    let velocity = samples.velocity.as_ref().expect("recorded");
    let StageReading::Known(stages) = &samples.stage else { panic!("stages are known") };
    for row in 0..samples.rows() {
        let channels = samples.position.iter().chain(velocity).chain(&samples.torque);
        let cells: Vec<String> = channels.map(|channel| channel[row].to_string()).collect();
        let stage = match stages[row] {
            Stage::Between => 0,
            Stage::Excitation => 1,
            Stage::Friction => 2,
            Stage::Warming => 3,
        };
        let signal = samples.friction_signal.as_ref().and_then(|signals| signals[row]);
        let (joint, level) = signal.map_or((0, 0), |s| (s.joint.number(), s.level));
        let cycle = samples.cycle.as_ref().map_or(1, |cycles| cycles[row]);
        text += &format!("{},{},{stage},{cycle},{joint},{level}\n", samples.time[row], cells.join(","));
    }
    text
}
