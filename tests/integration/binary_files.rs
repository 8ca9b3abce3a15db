//! Recordings as Parquet files and MCAP bags, and the memory that the program needs for them.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;

use mcap::WriteOptions;
use mcap::records::MessageHeader;
use polars_core::prelude::{ArrowSchema, CompatLevel, DataFrame, IntoColumn, NamedFrom, SchemaExt, Series};
use polars_parquet::write::{
    CompressionOptions, Encoding, FileWriter, StatisticsOptions, Version, WriteOptions as ParquetOptions,
    row_group_iter,
};

use crate::memory::{MOST_KB, confined};
use crate::small;
use crate::support::{Workshop, query};

/// Columns of numbers as a Parquet file with one row group.
pub fn parquet(names: &[&str], columns: &[Vec<f64>]) -> Vec<u8> {
    let rows = columns[0].len();
    let column = |(name, values): (&&str, &Vec<f64>)| Series::new((*name).into(), values).into_column();
    let mut frame = DataFrame::new(rows, names.iter().zip(columns).map(column).collect()).expect("columns");
    frame.rechunk_mut();
    let schema: ArrowSchema = frame.schema().to_arrow(CompatLevel::newest());
    let options = ParquetOptions {
        statistics: StatisticsOptions::default(),
        version: Version::V1,
        compression: CompressionOptions::Snappy,
        data_page_size: Some(1 << 16),
    };
    let mut file = Vec::new();
    let mut writer = FileWriter::try_new(&mut file, schema, options).expect("a schema");
    for chunk in frame.iter_chunks(CompatLevel::newest(), false) {
        let types = writer.parquet_schema().fields().to_vec();
        let encodings = vec![vec![Encoding::Plain]; names.len()].into();
        let group = row_group_iter(chunk, encodings, types, writer.options());
        writer.write(rows as u64, group).expect("written");
    }
    writer.end(None).expect("written");
    file
}

/// Joint states as a bag: moments in ns, names of the joints, and `[n][rows]` of positions, velocities and efforts.
pub fn bag(moments: &[u64], joints: &[String], channels: [&[Vec<f64>]; 3]) -> Vec<u8> {
    let mut file = Vec::new();
    let mut writer = WriteOptions::new().create(Cursor::new(&mut file)).expect("a writer");
    let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"").expect("a schema");
    let channel_id = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new()).expect("a channel");
    for (row, log_time) in (0..).zip(moments.iter().copied()) {
        let values = channels.map(|channel| channel.iter().map(|joint| joint[row as usize]).collect());
        let header = MessageHeader { channel_id, sequence: row, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, &joint_state(log_time, joints, values)).expect("written");
    }
    writer.finish().expect("written");
    drop(writer);
    file
}

/// The message in CDR, little-endian.
fn joint_state(moment: u64, joints: &[String], channels: [Vec<f64>; 3]) -> Vec<u8> {
    let mut body: Vec<u8> = Vec::new();
    let count = |body: &mut Vec<u8>, count: usize| {
        body.resize(body.len().next_multiple_of(4), 0);
        body.extend((count as u32).to_le_bytes());
    };
    count(&mut body, (moment / 1_000_000_000) as usize);
    count(&mut body, (moment % 1_000_000_000) as usize);
    // the frame has no name
    count(&mut body, 1);
    body.push(0);
    count(&mut body, joints.len());
    for name in joints {
        count(&mut body, name.len() + 1);
        body.extend([name.as_bytes(), b"\0"].concat());
    }
    for values in channels {
        count(&mut body, values.len());
        body.resize(body.len().next_multiple_of(8), 0);
        values.iter().for_each(|value| body.extend(value.to_le_bytes()));
    }
    [vec![0, 1, 0, 0], body].concat()
}

/// Names and columns of an export as text.
pub fn table(text: &str) -> (Vec<&str>, Vec<Vec<f64>>) {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let mut columns = vec![Vec::new(); names.len()];
    for line in lines {
        let cells = line.split(',').map(|cell| cell.parse::<f64>().expect("a number"));
        columns.iter_mut().zip(cells).for_each(|(column, cell)| column.push(cell));
    }
    (names, columns)
}

/// Columns whose names begin with `prefix`.
pub fn channel(names: &[&str], columns: &[Vec<f64>], prefix: &str) -> Vec<Vec<f64>> {
    let of = names.iter().zip(columns).filter(|(name, _)| name.starts_with(prefix));
    of.map(|(_, values)| values.clone()).collect()
}

/// Writes the configuration `of_bag.toml` for bags whose joints are called `joint_1` and so on.
fn describe_bags(workshop: &Workshop, stage: &str) {
    fs::write(workshop.path("bag.toml"), bag_layout(stage)).expect("written");
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    let native = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/native.toml");
    fs::write(workshop.path("of_bag.toml"), config.replace(native, "bag.toml")).expect("written");
}

/// A layout of such bags.
pub fn bag_layout(stage: &str) -> String {
    let channel = |title: &str, quantity: &str, unit: &str| {
        format!("[{title}]\ncolumn = \"joint_{{joint}}/{quantity}\"\nunit = \"{unit}\"\n")
    };
    [
        "name = \"bag\"\ndelimiter = \",\"\nheader = true\n[time]\ncolumn = \"time\"\nunit = \"s\"\n"
            .to_owned(),
        channel("position", "position", "rad"),
        channel("velocity", "velocity", "rad/s"),
        channel("torque", "effort", "Nm"),
        format!("[stage]\n{stage}\n"),
    ]
    .concat()
}

/// Most memory that sixteen times the rows may add, kB.
const MOST_MORE_KB: u64 = 20_000;

/// The rows of a small export one after another, as often as `times`, with times and cycles that go on.
fn repeated(columns: &[Vec<f64>], times: u32) -> Vec<Vec<f64>> {
    let rows = columns[0].len();
    let period = columns[0][rows - 1] + columns[0][1];
    let cycles = columns[columns.len() - 1].iter().copied().fold(0.0, f64::max);
    // time is first, and the counter is last
    let step = |at: usize| match at {
        0 => period,
        at if at + 1 == columns.len() => cycles,
        _ => 0.0,
    };
    let of = |(at, values): (usize, &Vec<f64>)| {
        (0..times)
            .flat_map(|time| values.iter().map(move |value| value + f64::from(time) * step(at)))
            .collect()
    };
    columns.iter().enumerate().map(of).collect()
}

#[test]
fn memory_for_binary_files_does_not_grow_with_their_rows() {
    let workshop = small::workshop();
    let export = small::export("R01", 1, 5);
    let text = std::str::from_utf8(&export.bytes).expect("text");
    let (mut names, mut columns) = table(text);
    // the counter of cycles last
    let cycle = names.iter().position(|name| *name == "cycle").expect("a counter");
    let (name, counter) = (names.remove(cycle), columns.remove(cycle));
    names.push(name);
    columns.push(counter);
    describe_bags(&workshop, "kind = \"schedule\"\nsequence = [\"excitation\"]\ndurations_s = [20.0]");
    let mut peaks = BTreeMap::<&str, Vec<u64>>::new();
    for times in [2, 32] {
        let columns = repeated(&columns, times);
        let joints: Vec<String> = (1..=4).map(|joint| format!("joint_{joint}")).collect();
        let moments: Vec<u64> =
            columns[0].iter().map(|time| 1_700_000_000_000_000_000 + (time * 1e9) as u64).collect();
        let [position, velocity, torque] = ["pos", "vel", "trq"].map(|of| channel(&names, &columns, of));
        for (kind, config, bytes) in [
            ("parquet", "armwatch.toml", parquet(&names, &columns)),
            ("mcap", "of_bag.toml", bag(&moments, &joints, [&position, &velocity, &torque])),
        ] {
            let folder = format!("{kind}{times}");
            fs::create_dir(workshop.path(&folder)).expect("a folder");
            fs::write(workshop.path(&format!("{folder}/R01_20260105_0847.{kind}")), bytes).expect("written");
            let database = format!("{folder}.db");
            let run = confined(&workshop, &["ingest", &folder, "--db", &database, "--config", config]);
            assert_eq!(run.code, Some(0), "{folder}: {}", run.said);
            let rows = query(&workshop.path(&database), "SELECT rows FROM runs").concat();
            assert_eq!(rows, columns[0].len().to_string(), "{folder}");
            peaks.entry(kind).or_default().push(run.peak_kb);
        }
    }
    println!("{peaks:?}");
    assert!(peaks.values().all(|peaks| peaks[1] < peaks[0] + MOST_MORE_KB), "{peaks:?}");
}

/// Damaged copies of both are read, or refused with a reason, in little memory.
#[test]
fn damaged_binary_files_take_little_memory_and_end_no_command() {
    let workshop = Workshop::new();
    describe_bags(&workshop, "whole_recording = \"excitation\"");
    let rows = 3000;
    let names: Vec<String> = ["pos", "vel", "trq"]
        .iter()
        .flat_map(|of| (1..=6).map(move |joint| format!("{of}_{joint}")))
        .chain(["time".to_owned(), "stage".to_owned()])
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let value = |name: &str, row: u32| match name {
        "time" => 0.01 * f64::from(row),
        "stage" => 1.0,
        _ => 1e-4 * f64::from(row),
    };
    let columns: Vec<Vec<f64>> =
        names.iter().map(|name| (0..rows).map(|row| value(name, row)).collect()).collect();
    let joints: Vec<String> = (1..=6).map(|joint| format!("joint_{joint}")).collect();
    let moments: Vec<u64> =
        (0..rows).map(|row| 1_700_000_000_000_000_000 + u64::from(row) * 10_000_000).collect();
    let [position, velocity, torque] = ["pos", "vel", "trq"].map(|of| channel(&names, &columns, of));
    for (kind, config, whole) in [
        ("parquet", "armwatch.toml", parquet(&names, &columns)),
        ("mcap", "of_bag.toml", bag(&moments, &joints, [&position, &velocity, &torque])),
    ] {
        let length = whole.len();
        fs::create_dir(workshop.path(kind)).expect("a folder");
        for copy in 0..24_usize {
            let mut bytes = whole.clone();
            // lengths are near the beginning and the end
            let at = match copy % 3 {
                0 => 8 + copy * 5,
                1 => length - 12 - copy * 7,
                _ => length * copy / 24,
            };
            match copy % 4 {
                0 => bytes.truncate(at),
                1 => bytes[at..at + 8].fill(0xff),
                2 => bytes[at..at + 4].copy_from_slice(&[0xff, 0xff, 0xff, 0x7f]),
                _ => bytes[at] ^= 0x40,
            }
            fs::write(workshop.path(&format!("{kind}/R{copy:02}_20260105_0847.{kind}")), bytes)
                .expect("written");
        }
        let database = format!("{kind}.db");
        let run = confined(&workshop, &["ingest", kind, "--db", &database, "--config", config]);
        assert!(matches!(run.code, Some(0 | 1)), "{:?}: {}", run.code, run.said);
        assert!(!run.said.contains("panicked"), "{}", run.said);
        assert!(run.peak_kb < MOST_KB, "{} kB", run.peak_kb);
        let refused =
            query(&workshop.path(&database), "SELECT reason FROM runs WHERE status = 'quarantined'");
        assert!(refused.len() > 3 && refused.iter().all(|reason| !reason.is_empty()), "{kind}: {refused:?}");
    }
}
