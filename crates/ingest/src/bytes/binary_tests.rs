//! Parquet files and bags give the rows of the same recording as text; damaged ones give an error or whole messages.

use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions};
use polars_core::prelude::{
    ArrowSchema, BooleanChunked, Column, CompatLevel, DataFrame, Float32Chunked, Int32Chunked, Int64Chunked,
    IntoColumn, NamedFrom, NewChunkedArray, SchemaExt, Series,
};
use polars_parquet::write::{
    CompressionOptions, Encoding, FileWriter, StatisticsOptions, Version, WriteOptions as ParquetOptions,
    row_group_iter,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::fingerprint::fingerprint;
use super::joint_state::tests::cdr;
use super::source::{open, open_hashing};
use crate::fixture::{made_recording, native, read};
use crate::rejection::Rejection;
use crate::table::reader::{Chunk, ExportReader, ReadOptions};
use armwatch_config::{Channel, Column as ConfigColumn, JointColumns, Layout, StageSource, WholeRecording};
use armwatch_model::run::{RawSamples, Stage};
use armwatch_testing::er3a;

/// How a test file is written.
#[derive(Clone, Copy)]
struct FileForm {
    compression: CompressionOptions,
    encoding: Encoding,
    version: Version,
    rows_of_group: usize,
    page_bytes: usize,
}

const USUAL: FileForm = FileForm {
    compression: CompressionOptions::Zstd(None),
    encoding: Encoding::Plain,
    version: Version::V1,
    rows_of_group: 1000,
    page_bytes: 2000,
};

fn parquet(frame: &DataFrame, how: FileForm) -> Vec<u8> {
    let schema: ArrowSchema = frame.schema().to_arrow(CompatLevel::newest());
    let options = ParquetOptions {
        statistics: StatisticsOptions::default(),
        version: how.version,
        compression: how.compression,
        data_page_size: Some(how.page_bytes),
    };
    let mut file = Vec::new();
    let mut writer = FileWriter::try_new(&mut file, schema, options).expect("a schema");
    let mut start = 0;
    while start < frame.height() {
        let mut part = frame.slice(start as i64, how.rows_of_group);
        part.rechunk_mut();
        for chunk in part.iter_chunks(CompatLevel::newest(), false) {
            let encodings = vec![vec![how.encoding]; frame.width()];
            let types = writer.parquet_schema().fields().to_vec();
            let group = row_group_iter(chunk, encodings.into(), types, writer.options());
            writer.write(part.height() as u64, group).expect("written");
        }
        start += how.rows_of_group;
    }
    writer.end(None).expect("written");
    file
}

/// The columns of a CSV text, as numbers.
fn frame(text: &str) -> DataFrame {
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().expect("a number")).collect()).collect();
    let column = |(at, name): (usize, &&str)| {
        Series::new((*name).into(), rows.iter().map(|row| row[at]).collect::<Vec<f64>>()).into_column()
    };
    DataFrame::new(rows.len(), names.iter().enumerate().map(column).collect()).expect("columns")
}

struct File {
    _folder: tempfile::TempDir,
    path: PathBuf,
}

fn file(name: &str, bytes: &[u8]) -> File {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).expect("written");
    File { _folder: folder, path }
}

fn text_of(path: &Path) -> Result<String, String> {
    let mut text = String::new();
    let mut reader = open(path).map_err(|rejection| rejection.to_string())?;
    reader.read_to_string(&mut text).map_err(|error| error.to_string())?;
    Ok(text)
}

#[test]
fn a_parquet_file_gives_the_rows_of_its_text() {
    let (samples, text) = made_recording(2500);
    let frame = frame(&text);
    for how in [
        USUAL,
        FileForm { compression: CompressionOptions::Snappy, rows_of_group: 700, ..USUAL },
        FileForm { compression: CompressionOptions::Lz4Raw, encoding: Encoding::RleDictionary, ..USUAL },
        FileForm {
            compression: CompressionOptions::Uncompressed,
            version: Version::V2,
            page_bytes: 300,
            ..USUAL
        },
        FileForm { encoding: Encoding::RleDictionary, rows_of_group: 3000, page_bytes: 1 << 20, ..USUAL },
    ] {
        let file = file("R01.parquet", &parquet(&frame, how));
        assert_eq!(read(&file.path), Ok(samples.clone()));
        let (mut reader, hash) = open_hashing(&file.path).expect("a Parquet file");
        std::io::copy(&mut reader, &mut std::io::sink()).expect("readable");
        assert_eq!(hash.so_far(), fingerprint(&file.path).expect("a file"), "the whole file is hashed");
    }
}

#[test]
fn values_of_each_type_become_cells() {
    let columns: Vec<Column> = vec![
        Series::new("a,b".into(), [Some(1.5), None, Some(1e-300)]).into_column(),
        Float32Chunked::from_slice("f".into(), &[0.1, -2.0, f32::MAX]).into_column(),
        Int32Chunked::from_slice("i".into(), &[-1, 0, 7]).into_column(),
        Int64Chunked::from_slice("l".into(), &[1_700_000_000_123_456_789, 0, -5]).into_column(),
        BooleanChunked::from_slice("b".into(), &[true, false, true]).into_column(),
        Series::new("w".into(), ["idle", "one, two", "a\nb"]).into_column(),
    ];
    for encoding in [Encoding::Plain, Encoding::RleDictionary] {
        let frame = DataFrame::new(3, columns.clone()).expect("columns");
        // polars writes no dictionary of booleans
        let frame = if encoding == Encoding::Plain { frame } else { frame.drop("b").expect("a column") };
        let file = file("a.parquet", &parquet(&frame, FileForm { encoding, ..USUAL }));
        let [b, t, f] = match encoding {
            Encoding::Plain => [",b", ",1", ",0"],
            _ => [""; 3],
        };
        let expected = format!(
            "\"a,b\",f,i,l{b},w\n1.5,0.10000000149011612,-1,1700000000123456789{t},idle\n,-2.0,0,0{f},\"one, two\"\n\
             1e-300,3.4028234663852886e38,7,-5{t},a b\n"
        );
        assert_eq!(text_of(&file.path), Ok(expected));
    }
}

#[test]
fn a_parquet_file_that_is_cut_or_no_parquet_says_so() {
    let (_, text) = made_recording(100);
    let bytes = parquet(&frame(&text), USUAL);
    for (name, bytes, said) in [
        ("cut", &bytes[..bytes.len() / 2], "ends too early"),
        ("magic alone", &b"PAR1"[..], "ends too early"),
        ("encrypted", &b"PARE0000PARE"[..], "encrypted"),
        ("no metadata", &b"PAR1\xff\xff\xff\x00PAR1"[..], "bytes of metadata"),
    ] {
        let file = file("a.parquet", bytes);
        let rejection = read(&file.path).expect_err(name);
        assert!(rejection.to_string().contains(said), "{name}: {rejection}");
    }
}

/// Names of the columns of a bag for an arm.
fn bag_layout() -> Layout {
    let columns = |quantity: &str| {
        let columns = JOINTS.iter().map(|joint| ConfigColumn::Name(format!("{joint}/{quantity}")));
        Channel { columns: JointColumns::Each(columns.collect()), ..native().position }
    };
    Layout {
        position: columns("position"),
        velocity: Some(columns("velocity")),
        torque: columns("effort"),
        stage: StageSource::Whole(WholeRecording(Stage::Excitation)),
        cycle: None,
        friction_joint: None,
        friction_level: None,
        motor_temperature: None,
        ambient_temperature: None,
        ..native()
    }
}

const JOINTS: [&str; 6] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// The recording as messages of a bag: those of an arm, with the joints in the order of the alphabet in every other one,
/// and those of a gripper between them.
fn bag(samples: &RawSamples, options: WriteOptions) -> Vec<u8> {
    let mut file = Vec::new();
    let mut writer = options.create(Cursor::new(&mut file)).expect("a writer");
    let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"").expect("a schema");
    let other = writer.add_schema("std_msgs/msg/String", "ros2msg", b"").expect("a schema");
    let topic = writer.add_channel(schema, "/joint_states", "cdr", &BTreeMap::new()).expect("a channel");
    let noise = writer.add_channel(other, "/rosout", "cdr", &BTreeMap::new()).expect("a channel");
    let mut write = |channel_id, row: usize, data: &[u8]| {
        let log_time = 1_700_000_000_000_000_000 + row as u64 * 2_000_000;
        let header = MessageHeader { channel_id, sequence: row as u32, log_time, publish_time: log_time };
        writer.write_to_known_channel(&header, data).expect("written");
    };
    let velocity = samples.velocity.as_ref().expect("recorded");
    for row in 0..samples.rows() {
        let mut order: Vec<usize> = (0..6).collect();
        if row % 2 == 1 {
            order.sort_by_key(|joint| JOINTS[*joint]);
        }
        let of = |channel: &[Vec<f64>]| order.iter().map(|joint| channel[*joint][row]).collect::<Vec<f64>>();
        let names: Vec<&str> = order.iter().map(|joint| JOINTS[*joint]).collect();
        let (position, velocity, effort) = (of(&samples.position), of(velocity), of(&samples.torque));
        let nanoseconds = row as u64 * 2_000_000;
        let stamp =
            (1_700_000_000 + (nanoseconds / 1_000_000_000) as i32, (nanoseconds % 1_000_000_000) as u32);
        write(noise, row, b"\0\x01\0\0");
        write(topic, row, &cdr(stamp, &["gripper"], [&[0.5], &[], &[]], true));
        write(topic, row, &cdr(stamp, &names, [&position, &velocity, &effort], row % 3 > 0));
    }
    writer.finish().expect("written");
    drop(writer);
    file
}

fn rows_of(path: &Path) -> (RawSamples, Option<Rejection>, bool) {
    let mut samples = RawSamples::default();
    let reader = open(path)
        .and_then(|bytes| ExportReader::new(bytes, path, &bag_layout(), &er3a(), ReadOptions::default()));
    let mut reader = match reader {
        Ok(reader) => reader,
        Err(rejection) => return (samples, Some(rejection), false),
    };
    for chunk in reader.by_ref() {
        match chunk {
            Ok(Chunk { samples: rows, .. }) => samples.append(rows),
            Err(rejection) => return (samples, Some(rejection), false),
        }
    }
    let left_out = reader.left_out().is_some();
    (samples, None, left_out)
}

#[test]
fn a_bag_gives_the_rows_of_its_messages() {
    let (samples, _) = made_recording(700);
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        for chunk_size in [Some(4096), None] {
            let options = WriteOptions::new().compression(compression).chunk_size(chunk_size);
            let file = file("R01.mcap", &bag(&samples, options));
            let (rows, rejection, left_out) = rows_of(&file.path);
            assert_eq!((rejection, left_out), (None, false));
            assert_eq!(
                (&rows.position, &rows.velocity, &rows.torque),
                (&samples.position, &samples.velocity, &samples.torque)
            );
            // stamps are whole nanoseconds
            assert_eq!(rows.time, (0..700).map(|row| f64::from(2 * row) / 1000.0).collect::<Vec<f64>>());
            let (mut reader, hash) = open_hashing(&file.path).expect("a bag");
            std::io::copy(&mut reader, &mut std::io::sink()).expect("readable");
            assert_eq!(hash.so_far(), fingerprint(&file.path).expect("a file"), "the whole file is hashed");
        }
    }
}

#[test]
fn a_damaged_bag_gives_its_whole_messages() {
    let (samples, _) = made_recording(300);
    let whole = bag(&samples, WriteOptions::new().chunk_size(Some(4096)));
    for cut in [whole.len() / 3, whole.len() / 2, whole.len() * 3 / 4] {
        let file = file("R01.mcap", &whole[..cut]);
        let (rows, rejection, left_out) = rows_of(&file.path);
        assert_eq!((rejection, left_out), (None, true), "cut at {cut}");
        assert!((50..290).contains(&rows.rows()), "{} rows of a file cut at {cut}", rows.rows());
        assert_eq!(rows.torque[2], samples.torque[2][..rows.rows()]);
    }
}

#[test]
fn a_bag_without_joints_says_what_it_lacks() {
    let (samples, _) = made_recording(10);
    let none = RawSamples { torque: vec![vec![]; 6], position: vec![vec![]; 6], time: Vec::new(), ..samples };
    let file = file("R01.mcap", &bag(&none, WriteOptions::new()));
    let (_, rejection, _) = rows_of(&file.path);
    let rejection = rejection.expect("no rows").to_string();
    assert!(
        rejection.contains("an MCAP bag without positions and efforts of joints in /joint_states"),
        "{rejection}"
    );
}

/// A thousand damaged copies: cut, with other bytes, with other lengths.
pub(super) fn mutations(whole: &[u8], mut check: impl FnMut(&[u8])) {
    let mut random = ChaCha8Rng::seed_from_u64(11);
    for round in 0..1000 {
        let mut bytes = whole.to_vec();
        match round % 4 {
            0 => bytes.truncate(random.random_range(0..whole.len())),
            1 => (0..random.random_range(1..8)).for_each(|_| {
                let at = random.random_range(0..whole.len());
                bytes[at] = random.random_range(0..=255);
            }),
            // the end and the beginning have the lengths of all else
            2 => {
                let from_end: bool = random.random();
                let near = random.random_range(0..whole.len().min(2000));
                let at = if from_end { whole.len() - 1 - near } else { near };
                bytes[at] ^= 1 << random.random_range(0..8);
            }
            _ => {
                let at = random.random_range(0..whole.len() - 8);
                bytes[at..at + 8].copy_from_slice(&random.random_range(0..u64::MAX).to_le_bytes());
            }
        }
        check(&bytes);
    }
}

#[test]
fn a_thousand_damaged_parquet_files_give_rows_or_an_error() {
    let (_, text) = made_recording(400);
    let whole =
        parquet(&frame(&text), FileForm { encoding: Encoding::RleDictionary, rows_of_group: 200, ..USUAL });
    mutations(&whole, |bytes| {
        let file = file("a.parquet", bytes);
        if let Err(rejection) = read(&file.path) {
            assert!(!rejection.reason.is_empty() && !rejection.remedy.is_empty());
        }
    });
}

#[test]
fn a_thousand_damaged_bags_give_rows_or_an_error() {
    let (samples, _) = made_recording(200);
    for compression in [Compression::Lz4, Compression::Zstd] {
        let whole = bag(&samples, WriteOptions::new().compression(Some(compression)).chunk_size(Some(4096)));
        mutations(&whole, |bytes| {
            let file = file("a.mcap", bytes);
            let (rows, _, _) = rows_of(&file.path);
            assert!(rows.rows() <= samples.rows());
        });
    }
}
