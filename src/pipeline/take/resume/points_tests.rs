//! Reading that continues after any cycle gives the same result as reading through, for every form of export.

use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use proptest::prelude::*;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::{decoded, encoded, settings_hash};
use crate::pipeline::cycle_memory::{CycleMemory, RecordingTurn};
use crate::pipeline::take::admitted::AdmittedExport;
use crate::pipeline::take::cutting::{CutCycle, ReadEnd};
use crate::pipeline::take::intake;
use crate::pipeline::take::intake::header;
use crate::pipeline::take::resume_point::ResumePoint;
use armwatch_config::{Layout, WorkLimits, parse_layout};
use armwatch_ingest::bytes::fingerprint::fingerprint;
use armwatch_ingest::table::reader::{ReadOptions, ReadPosition};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::Robot;
use armwatch_model::run::{ContentHash, Cycle};
use armwatch_testing::er3a;

const NATIVE: &str = include_str!("../../../../config/exports/native.toml");
/// Rows per second.
const RATE: usize = 20;
const CYCLES: u32 = 5;
/// Parts of a cycle: stage, joints that move (one bit each), seconds.
const PARTS: [(usize, u8, usize); 7] =
    [(0, 0, 2), (1, 0b11_1111, 7), (2, 0b1, 6), (2, 0b11, 2), (2, 0b10, 6), (3, 0b11_1111, 7), (0, 0, 2)];
const WORDS: [&str; 4] = ["IDLE", "EXC", "FRIC", "WARM"];

/// One row: number, stage, cycle, and the cells of all joints.
struct MadeRow {
    number: usize,
    stage: usize,
    cycle: u32,
    position: String,
    velocity: String,
    torque: String,
}

fn rows() -> Vec<MadeRow> {
    let mut rows = Vec::new();
    let mut q = [0.0; 6];
    for cycle in 1..=CYCLES {
        for (stage, joints, seconds) in PARTS {
            for i in 0..seconds * RATE {
                let swing = 0.9 * (i as f64 * 0.31 + f64::from(cycle)).sin();
                let qd: Vec<f64> = (0..6)
                    .map(|j| if joints >> j & 1 == 1 { swing * (1.0 + 0.1 * f64::from(j)) } else { 0.0 })
                    .collect();
                q.iter_mut().zip(&qd).for_each(|(q, qd)| *q += qd / RATE as f64);
                let cells = |values: &[f64]| {
                    values.iter().map(|value| format!("{value:.4}")).collect::<Vec<_>>().join(",")
                };
                let number = rows.len();
                let torque: Vec<f64> =
                    (0..6).map(|j| (number * 7919 % 101) as f64 * 0.3 - f64::from(j)).collect();
                let (position, velocity, torque) = (cells(&q), cells(&qd), cells(&torque));
                rows.push(MadeRow { number, stage, cycle, position, velocity, torque });
            }
        }
    }
    rows
}

/// A way to write a recording.
struct Writing {
    name: &'static str,
    /// Sections of the layout that differ from the native one.
    layout: Vec<(&'static str, &'static str)>,
    time: fn(usize) -> String,
    /// Cells of the stage, and the names of their columns.
    stage: (&'static str, fn(&MadeRow) -> String),
    counted: bool,
    with_velocity: bool,
    bytes: fn(String) -> Vec<u8>,
}

impl Default for Writing {
    fn default() -> Self {
        Self {
            name: "native",
            layout: Vec::new(),
            time: |row| format!("{}", row as f64 / RATE as f64),
            stage: ("stage", |row| row.stage.to_string()),
            counted: true,
            with_velocity: true,
            bytes: String::into_bytes,
        }
    }
}

const LEVELS: &str = "kind = \"levels\"\ncolumn = \"stage\"\nbetween = [-0.5, 0.5]\nexcitation = [2, 3]\n\
                      friction = [4.5, 5.5]\nwarming = [7, 8]\nhysteresis = 0.1\ndebounce_s = 0.2";

/// An analogue signal with noise within its ranges and a spike now and then.
fn level(row: &MadeRow) -> String {
    let spike = if row.number % 97 == 50 { 2.5 } else { 0.0 };
    format!("{:.3}", 2.5 * row.stage as f64 + spike + 0.4 * (row.number as f64).sin())
}

fn stamp(row: usize) -> String {
    let ms = row * 1000 / RATE;
    format!(
        "2026-03-01T{:02}:{:02}:{:02}.{:03}Z",
        8 + ms / 3_600_000,
        ms / 60_000 % 60,
        ms / 1000 % 60,
        ms % 1000
    )
}

fn writings() -> Vec<Writing> {
    let native = Writing::default;
    let words: fn(&MadeRow) -> String = |row| WORDS[row.stage].to_owned();
    let flags: fn(&MadeRow) -> String =
        |row| (1..4).map(|stage| u8::from(row.stage == stage).to_string()).collect::<Vec<_>>().join(",");
    let stage = |section| vec![("stage", section)];
    vec![
        native(),
        Writing { name: "stage sequence", counted: false, ..native() },
        Writing {
            name: "words",
            layout: stage(
                "column = \"stage\"\nbetween = [\"IDLE\"]\nexcitation = [\"EXC\"]\nfriction = [\"FRIC\"]\n\
                 warming = [\"WARM\"]",
            ),
            stage: ("stage", words),
            counted: false,
            ..native()
        },
        Writing {
            name: "a column a stage",
            layout: stage(
                "kind = \"one_hot\"\nexcitation = \"exc\"\nfriction = \"fric\"\nwarming = \"warm\"",
            ),
            stage: ("exc,fric,warm", flags),
            counted: false,
            ..native()
        },
        Writing {
            name: "levels",
            layout: stage(LEVELS),
            stage: ("stage", level),
            counted: false,
            ..native()
        },
        Writing { name: "levels and counter", layout: stage(LEVELS), stage: ("stage", level), ..native() },
        Writing { name: "motion", layout: stage("kind = \"motion\""), counted: false, ..native() },
        Writing {
            name: "motion by positions, and a counter",
            layout: stage("kind = \"motion\""),
            with_velocity: false,
            ..native()
        },
        Writing {
            name: "windows",
            layout: stage("kind = \"production\"\nwindow_s = 17"),
            counted: false,
            ..native()
        },
        Writing {
            name: "schedule",
            layout: stage(
                "kind = \"schedule\"\nsequence = [\"excitation\", \"friction\", \"warming\"]\n\
                 durations_s = [9.0, 14.0, 9.0]\nstart_s = 0.0",
            ),
            counted: false,
            ..native()
        },
        Writing {
            name: "ticks that begin anew",
            layout: vec![("time", "column = \"time\"\nunit = \"ticks\"\ntick_s = 0.05\nwraps_at = 1024")],
            time: |row| ((row + 1000) % 1024).to_string(),
            ..native()
        },
        Writing {
            name: "dates and times",
            layout: vec![("time", "column = \"time\"\nunit = \"timestamp\"")],
            time: stamp,
            ..native()
        },
        Writing {
            name: "a clock",
            time: |row| format!("{:.3}", 1.7e9 + row as f64 / RATE as f64),
            ..native()
        },
        Writing {
            name: "no header, no time",
            layout: vec![
                ("header", "false"),
                ("time", "sample_rate_hz = 20.0"),
                ("position", "column = \"{joint+1}\"\nunit = \"rad\""),
                ("velocity", "column = \"{joint+7}\"\nunit = \"rad/s\""),
                ("torque", "column = \"{joint+13}\"\nunit = \"Nm\""),
                ("stage", "column = \"20\"\nbetween = [0]\nexcitation = [1]\nfriction = [2]\nwarming = [3]"),
                ("if_present", "cycle = \"21\""),
            ],
            bytes: |text| text.split_once('\n').map_or("", |(_, rows)| rows).as_bytes().to_vec(),
            ..native()
        },
        Writing {
            name: "decimal commas, CRLF, a mark and comments",
            layout: vec![("delimiter", "\";\"\ndecimal = \",\"")],
            bytes: |text| {
                let text = text.replace(',', ";").replace('.', ",").replace('\n', "\r\n");
                format!("\u{feff}# made by a test\r\n# größer\r\n\r\n{text}").into_bytes()
            },
            ..native()
        },
        Writing {
            name: "UTF-16",
            bytes: |text| format!("\u{feff}{text}").encode_utf16().flat_map(u16::to_le_bytes).collect(),
            ..native()
        },
        Writing { name: "Windows-1252, known late", bytes: |text| noted(&text, b"\xE9"), ..native() },
        Writing { name: "UTF-8, known late", bytes: |text| noted(&text, "é".as_bytes()), ..native() },
        Writing { name: "quotes", bytes: |text| text.replace(",1,", ",\"1\",").into_bytes(), ..native() },
        Writing {
            name: "gzip",
            bytes: |text| {
                let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
                std::io::Write::write_all(&mut encoder, text.as_bytes()).expect("compressed");
                encoder.finish().expect("compressed")
            },
            ..native()
        },
        Writing { name: "a bad cell near the end", bytes: |text| spoiled(&text, 100, "x"), ..native() },
        Writing { name: "time that runs backwards", bytes: |text| spoiled(&text, 90, "0."), ..native() },
        Writing { name: "a cut line", bytes: |text| text.as_bytes()[..text.len() - 9].to_vec(), ..native() },
        Writing {
            name: "a counter that falls",
            bytes: |text| {
                let at = text.len() - 5000;
                let at = at + text[at..].find(",5\n").expect("the last cycle");
                [&text[..at], ",3\n", &text[at + 3..]].concat().into_bytes()
            },
            ..native()
        },
        Writing {
            name: "a level that belongs to nothing",
            layout: stage(LEVELS),
            stage: ("stage", |row| if row.number > 3100 { "20".into() } else { level(row) }),
            counted: false,
            ..native()
        },
    ]
}

/// Adds a column of notes that is empty except for one cell late in the file.
fn noted(text: &str, note: &[u8]) -> Vec<u8> {
    let lines = text.lines().enumerate().map(|(line, row)| {
        let note = if line == 2700 { note } else { b"" };
        let name: &[u8] = if line == 0 { b"note" } else { note };
        [row.as_bytes(), b",", name, b"\n"].concat()
    });
    lines.collect::<Vec<_>>().concat()
}

/// Puts letters at the start of the row that is `from_end` rows before the last.
fn spoiled(text: &str, from_end: usize, letters: &str) -> Vec<u8> {
    let lines: Vec<&str> = text.lines().collect();
    let bad = lines.len() - from_end;
    let rows = lines.iter().enumerate().map(|(line, row)| match line == bad {
        true => format!("{letters}{}\n", &row[2..]),
        false => format!("{row}\n"),
    });
    rows.collect::<String>().into_bytes()
}

/// The native layout with other sections and keys.
fn layout(of: &Writing) -> Layout {
    let mut text = NATIVE.to_owned();
    if !of.with_velocity {
        let (start, end) = (text.find("[velocity]").expect("there"), text.find("[torque]").expect("there"));
        text.replace_range(start..end, "");
    }
    for (key, value) in &of.layout {
        let heading = format!("\n[{key}]\n");
        if let Some(start) = text.find(&heading) {
            let after = start + heading.len();
            let end = text[after..].find("\n[").map_or(text.len(), |at| after + at);
            text.replace_range(after..end, &format!("{value}\n"));
        } else {
            let start = text.find(&format!("\n{key} = ")).expect("a key") + 1;
            let end = start + text[start..].find('\n').expect("a line");
            text.replace_range(start..end, &format!("{key} = {value}"));
        }
    }
    parse_layout("layout.toml", &text).unwrap_or_else(|errors| panic!("{}: {errors}\n{text}", of.name))
}

fn text(of: &Writing) -> String {
    let names = |kind: &str| (1..=6).map(|joint| format!("{kind}_{joint}")).collect::<Vec<_>>().join(",");
    let velocity = if of.with_velocity { format!("{},", names("vel")) } else { String::new() };
    let counter = if of.counted { ",cycle" } else { "" };
    let mut text = format!("time,{},{velocity}{},{}{counter}\n", names("pos"), names("trq"), of.stage.0);
    for row in rows() {
        let velocity = if of.with_velocity { format!("{},", row.velocity) } else { String::new() };
        let counter = if of.counted { format!(",{}", row.cycle) } else { String::new() };
        let (time, stage) = ((of.time)(row.number), (of.stage.1)(&row));
        text += &format!("{time},{},{velocity}{},{stage}{counter}\n", row.position, row.torque);
    }
    text
}

/// Exports in every form, each with its admission.
struct Exports {
    _folder: tempfile::TempDir,
    intakes: Vec<(&'static str, AdmittedExport)>,
}

static EXPORTS: LazyLock<Exports> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = Arc::new(er3a());
    let of_writing = |(number, writing): (usize, &Writing)| {
        let path: PathBuf = folder.path().join(format!("A_{number}.csv"));
        std::fs::write(&path, (writing.bytes)(text(writing))).expect("written");
        let (content, bytes) = fingerprint(&path).expect("a file");
        let start = "2026-03-01T08:00:00Z".parse().expect("a time");
        let intake = AdmittedExport {
            header: header(&path, path.display().to_string(), "A", "er3a", start, content, bytes),
            path,
            run_id: 1,
            robot: Arc::clone(&robot),
            layout: Arc::new(layout(writing)),
            named_start: true,
            cycles_stored: 0,
            resume: None,
            made_with: made_with(&layout(writing), &robot, &WorkLimits::default()),
            limits: WorkLimits::default(),
            memory: CycleMemory::new(usize::MAX),
            header_before: None,
            turn: RecordingTurn::come(),
        };
        (writing.name, intake)
    };
    let intakes = writings().iter().enumerate().map(of_writing).collect();
    Exports { _folder: folder, intakes }
});

fn made_with(layout: &Layout, robot: &Robot, limits: &WorkLimits) -> ContentHash {
    settings_hash(layout, robot, limits, &AnalysisSettings::default())
}

/// Reads an export like the pipeline.
fn read(intake: &AdmittedExport, block_bytes: usize) -> (Vec<CutCycle>, ReadEnd) {
    let (sender, mut receiver) = mpsc::channel(1000);
    let options = ReadOptions { block_bytes };
    let end = intake::read(intake, options, &sender, &CancellationToken::new(), |_| ());
    let mut cycles = Vec::new();
    while let Ok(cycle) = receiver.try_recv() {
        cycles.push(cycle);
    }
    (cycles, end.unwrap_or_else(ReadEnd::Rejected))
}

fn only_cycles(cut: &[CutCycle]) -> Vec<&Cycle> {
    cut.iter().map(|cut| &cut.cycle).collect()
}

/// Reads one export through, and then continues after each of its cycles; returns how many of them allowed that.
fn assert_goes_on(name: &str, intake: &AdmittedExport, block_bytes: usize, other_bytes: usize) -> usize {
    let settings = intake.made_with;
    let (whole, end) = read(intake, block_bytes);
    let mut points = 0;
    for (place, cut) in whole.iter().enumerate() {
        let Some(stored) = &cut.read.resume else { continue };
        points += 1;
        let point = decoded(&stored.state, &settings).unwrap_or_else(|| panic!("{name}: its own point"));
        assert_eq!(encoded(&point, &settings).as_ref(), Some(stored), "{name}");
        let resumed =
            AdmittedExport { cycles_stored: place as u32 + 1, resume: Some(point), ..intake.clone() };
        let (after, same_end) = read(&resumed, other_bytes);
        let expected = only_cycles(&whole[place + 1..]);
        let numbers = |cycles: &[&Cycle]| {
            cycles.iter().map(|cycle| (cycle.number, cycle.samples.rows())).collect::<Vec<_>>()
        };
        let after = only_cycles(&after);
        assert_eq!(numbers(&after), numbers(&expected), "{name} behind cycle {}", place + 1);
        assert!(after == expected, "{name} behind cycle {}: other samples", place + 1);
        assert_eq!(same_end, end, "{name} behind cycle {}", place + 1);
    }
    points
}

#[test]
fn each_way_to_write_an_export_has_points_to_go_on_from() {
    for (name, intake) in &EXPORTS.intakes {
        let points = assert_goes_on(name, intake, 20_000, 1 << 20);
        assert!(points >= 2, "{name}: {points} points");
    }
}

/// A point with its settings.
fn a_point(name: &str) -> (Vec<u8>, ContentHash) {
    let (_, intake) = EXPORTS.intakes.iter().find(|(of, _)| *of == name).expect("a name");
    let settings = intake.made_with;
    let mut points = read(intake, 20_000).0.into_iter().filter_map(|cut| cut.read.resume);
    (points.next_back().expect("a point").state, settings)
}

#[test]
fn a_state_with_a_byte_changed_or_missing_or_of_other_settings_is_none() {
    let (state, settings) = a_point("motion by positions, and a counter");
    assert!(decoded(&state, &settings).is_some());
    for byte in 0..state.len() {
        let mut changed = state.clone();
        changed[byte] ^= 0x10;
        assert_eq!(decoded(&changed, &settings), None, "byte {byte}");
        assert_eq!(decoded(&state[..byte], &settings), None, "the first {byte} bytes");
    }
    let (_, intake) = &EXPORTS.intakes[0];
    let mut robot = er3a();
    robot.joints[0].position_offset += 1e-9;
    let analysis = AnalysisSettings { cutoff: 1.0, ..AnalysisSettings::default() };
    let others = [
        made_with(&EXPORTS.intakes[1].1.layout, &robot, &intake.limits),
        made_with(&intake.layout, &robot, &intake.limits),
        made_with(&intake.layout, &intake.robot, &WorkLimits { cycle_rows: 7, ..intake.limits }),
        settings_hash(&intake.layout, &intake.robot, &intake.limits, &analysis),
    ];
    others.iter().for_each(|other| assert_eq!(decoded(&state, other), None));
}

/// The transaction of a cycle must not grow by unneeded data.
#[test]
fn a_state_takes_less_than_a_kilobyte() {
    for (name, intake) in &EXPORTS.intakes {
        for point in read(intake, 20_000).0.into_iter().filter_map(|cut| cut.read.resume) {
            assert!(point.state.len() < 1000, "{name}: {} bytes", point.state.len());
        }
    }
}

/// A valid point, but of another file.
#[test]
fn a_file_that_does_not_have_the_place_is_another_one() {
    let (_, intake) = &EXPORTS.intakes[0];
    let (state, settings) = a_point("native");
    let point = decoded(&state, &settings).expect("its own point");
    let positions = [
        ReadPosition { byte: point.position.byte + 1, ..point.position },
        ReadPosition { line: point.position.line + 1, ..point.position },
        ReadPosition { line: 1_000_000, ..point.position },
    ];
    for position in positions {
        let resume = Some(ResumePoint { position, ..point.clone() });
        let elsewhere = AdmittedExport { cycles_stored: 1, resume, ..intake.clone() };
        assert_eq!(read(&elsewhere, 20_000), (vec![], ReadEnd::Changed), "{position:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn reading_goes_on_behind_any_cycle_whatever_the_blocks(
        export in 0..writings().len(),
        block_bytes in 2_000_usize..120_000,
        other_bytes in 2_000_usize..600_000,
    ) {
        let (name, intake) = &EXPORTS.intakes[export];
        assert_goes_on(name, intake, block_bytes, other_bytes);
    }
}
