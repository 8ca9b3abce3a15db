//! KUKA traces and TwinCAT Scope exports give the rows of the same recording as text; damaged ones give an error.

use std::fmt::Write;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::binary_tests::mutations;
use super::fingerprint::{extent, fingerprint};
use super::source::{open, open_hashing};
use super::trace::is_trace;
use crate::find::watch::scan;
use crate::fixture::{made_recording, native, read_bytes};
use crate::rejection::Rejection;
use crate::table::reader::ReadOptions;
use armwatch_config::{Column, Layout, ScaledColumn, TimeSource};
use armwatch_model::run::RawSamples;

/// Most bytes of text of a mutation: it has no more rows than the file that it was made from.
const MOST_TEXT_BYTES: usize = 4 << 20;

fn text_of(path: &Path) -> Result<String, Rejection> {
    let mut text = String::new();
    open(path)?.read_to_string(&mut text).map_err(|error| Rejection::from_io(path, &error))?;
    Ok(text)
}

/// The names of a CSV text and its numbers.
fn table(text: &str) -> (Vec<&str>, Vec<Vec<&str>>) {
    let mut lines = text.lines();
    let names = lines.next().expect("a header").split(',').collect();
    (names, lines.map(|line| line.split(',').collect()).collect())
}

/// How a trace is written.
#[derive(Clone, Copy)]
struct TraceForm {
    block: bool,
    big_endian: bool,
    words: [&'static str; 4],
}

const USUAL: TraceForm =
    TraceForm { block: true, big_endian: false, words: ["IMPLIZIT", "EXPLIZIT", "BLOCK", "KANAL"] };

/// Writes the columns of a CSV text as `stem.dat` and `stem.r64`; the first column is the time at 500 Hz.
fn write_trace(stem: &Path, text: &str, how: TraceForm) {
    let (names, rows) = table(text);
    let [implicit, explicit, block, channel] = how.words;
    let order = if how.big_endian { "Low -> High" } else { "High -> Low" };
    let mut header = format!(
        "DIAEXTENDED  {{@:ENGLISH\r\n#BEGINGLOBALHEADER\r\n112,{order}\r\n#ENDGLOBALHEADER\r\n#BEGINCHANNELHEADER\r\n\
         200,time\r\n210,{implicit}\r\n220,{}\r\n240,0\r\n241,0.002\r\n#ENDCHANNELHEADER\r\n",
        rows.len()
    );
    let mut values: Vec<f64> = Vec::new();
    for (at, name) in names.iter().enumerate().skip(1) {
        let (storage, pointer) = if how.block { (block, at) } else { (channel, (at - 1) * rows.len() + 1) };
        write!(
            header,
            "#BEGINCHANNELHEADER\r\n200,{name}\r\n202,\r\n210,{explicit}\r\n213,{storage}\r\n214,REAL64\r\n220,{}\r\n\
             221,{pointer}\r\n240,0\r\n241,0.001\r\n#ENDCHANNELHEADER\r\n",
            rows.len()
        )
        .expect("a string");
        values.extend(rows.iter().map(|row| row[at].parse::<f64>().expect("a number") * 1000.0));
    }
    if how.block {
        let channels = names.len() - 1;
        values = (0..values.len()).map(|at| values[at % channels * rows.len() + at / channels]).collect();
    }
    let bytes = |value: f64| if how.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
    std::fs::write(stem.with_extension("dat"), header).expect("written");
    std::fs::write(stem.with_extension("r64"), values.into_iter().flat_map(bytes).collect::<Vec<u8>>())
        .expect("written");
}

/// A CSV text as TwinCAT Scope writes it, with a column of times before each channel.
fn scope(text: &str, sign: &str) -> String {
    let (names, rows) = table(text);
    let comma = if sign == "," { "." } else { "," };
    let mut scope = format!(
        "Name{sign}Scope\r\nFile{sign}C:\\a.csv\r\nStarttime of export{sign}132959733843760000\r\n\
         Endtime of export{sign}132959733853750000\r\n\r\n\r\n"
    );
    for (key, value) in [("Name", None), ("Data-Type", Some("REAL64")), ("SampleTime[ms]", Some("2"))] {
        let cells = names.iter().skip(1).map(|name| format!("{key}{sign}{}", value.unwrap_or(name)));
        scope += &(cells.collect::<Vec<_>>().join(sign) + "\r\n");
    }
    scope += "\r\n";
    for (number, row) in rows.iter().enumerate() {
        let cells =
            row.iter().skip(1).map(|cell| format!("{}{sign}{}", 2 * number, cell.replace('.', comma)));
        scope += &(cells.collect::<Vec<_>>().join(sign) + "\r\n");
    }
    scope
}

/// The native layout with another column of time.
fn layout(time: &str, to_si: f64) -> Layout {
    let time = ScaledColumn { column: Column::Name(time.into()), to_si };
    Layout { time: TimeSource::Column(time), ..native() }
}

struct TraceFolder(tempfile::TempDir);

impl TraceFolder {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

/// The samples are those of the recording, to the last digits that the format keeps.
fn assert_same(path: &Path, layout: &Layout, expected: &RawSamples) {
    let text = text_of(path).unwrap_or_else(|rejection| panic!("{rejection}"));
    let found = read_bytes(text.as_bytes(), layout, ReadOptions::default())
        .unwrap_or_else(|rejection| panic!("{rejection}"));
    let near = |a: &[f64], b: &[f64]| {
        assert_eq!(a.len(), b.len());
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-14 * b.abs().max(1.0)), "{path:?}");
    };
    near(&found.time, &expected.time);
    let of = |samples: &RawSamples| {
        [samples.position.clone(), samples.velocity.clone().expect("recorded"), samples.torque.clone()]
            .concat()
    };
    for (a, b) in of(&found).iter().zip(&of(expected)) {
        near(a, b);
    }
    assert_eq!(
        (&found.stage, &found.cycle, &found.friction_signal),
        (&expected.stage, &expected.cycle, &expected.friction_signal)
    );
    let (mut reader, hash) = open_hashing(path).expect("a file");
    std::io::copy(&mut reader, &mut std::io::sink()).expect("readable");
    assert_eq!(hash.so_far(), fingerprint(path).expect("a file"), "all files are hashed");
}

#[test]
fn a_trace_gives_the_rows_of_its_text() {
    let (samples, text) = made_recording(2500);
    let english = ["IMPLICIT", "EXPLICIT", "BLOCK", "CHANNEL"];
    for how in [
        USUAL,
        TraceForm { block: false, ..USUAL },
        TraceForm { big_endian: true, words: english, ..USUAL },
        TraceForm { block: false, words: english, ..USUAL },
    ] {
        let folder = TraceFolder::new();
        write_trace(&folder.path("R01_20260105_0847"), &text, how);
        let path = folder.path("R01_20260105_0847.dat");
        assert_same(&path, &layout("time", 1.0), &samples);
        assert!(is_trace(&path));
    }
}

#[test]
fn the_pairs_of_files_of_the_drives_are_one_trace() {
    let (_, text) = made_recording(300);
    let (names, rows) = table(&text);
    let folder = TraceFolder::new();
    let channels = ["pos", "trq"];
    for drive in 1..=3 {
        let columns: Vec<usize> = channels
            .iter()
            .filter_map(|of| names.iter().position(|name| *name == format!("{of}_{drive}")))
            .collect();
        let lines = rows.iter().map(|row| format!("{},{},{}", row[0], row[columns[0]], row[columns[1]]));
        let text = format!("time,pos,trq\n{}", lines.collect::<Vec<_>>().join("\n"));
        write_trace(&folder.path(&format!("R01_20260105_0847_NextGenDrive#{drive}")), &text, USUAL);
    }
    std::fs::write(folder.path("PROGRAM.dat"), "DEFDAT PROGRAM").expect("written");
    let first = folder.path("R01_20260105_0847_NextGenDrive#1.dat");
    let found = scan(&[folder.0.path().to_owned()], false);
    assert_eq!(found.files.iter().map(|file| &file.path).collect::<Vec<_>>(), [&first]);
    let text = text_of(&first).unwrap_or_else(|rejection| panic!("{rejection}"));
    let (found, values) = table(&text);
    assert_eq!(found, ["time", "pos#1", "trq#1", "pos#2", "trq#2", "pos#3", "trq#3"]);
    for (row, value) in rows.iter().zip(&values) {
        for (at, name) in ["pos_1", "trq_1", "pos_2", "trq_2", "pos_3", "trq_3"].iter().enumerate() {
            let of = names.iter().position(|of| of == name).expect("a column");
            let [a, b] = [row[of], value[at + 1]].map(|cell| cell.parse::<f64>().expect("a number"));
            assert!((a - b).abs() < 1e-12, "{name}: {a} {b}");
        }
    }
    // a change of any of the files is another content and another state
    let [before, changed] = [(); 2].map(|()| {
        let metadata = std::fs::metadata(&first).expect("a file");
        let state = (fingerprint(&first).expect("files"), extent(&first, &metadata).0);
        let third = folder.path("R01_20260105_0847_NextGenDrive#3.r64");
        let bytes = std::fs::read(&third).expect("a file");
        std::fs::write(&third, &bytes[..bytes.len() - 8]).expect("written");
        state
    });
    assert_ne!(before.0, changed.0);
    assert_eq!(before.1, changed.1 + 8);
}

#[test]
fn a_trace_whose_files_do_not_fit_says_so() {
    let (_, text) = made_recording(50);
    let written = |how: fn(&mut String, &mut Vec<u8>)| {
        let folder = TraceFolder::new();
        write_trace(&folder.path("R01"), &text, USUAL);
        let [header, values] = ["R01.dat", "R01.r64"].map(|name| folder.path(name));
        let mut text = std::fs::read_to_string(&header).expect("a header");
        let mut bytes = std::fs::read(&values).expect("values");
        how(&mut text, &mut bytes);
        std::fs::write(&header, text).expect("written");
        match bytes.is_empty() {
            true => std::fs::remove_file(&values).expect("removed"),
            false => std::fs::write(&values, bytes).expect("written"),
        }
        text_of(&header).expect_err("an error")
    };
    let cut = written(|_, bytes| bytes.truncate(bytes.len() / 2));
    assert_eq!(
        &*cut.reason, "a trace whose header describes 8800 bytes of channels, and R01.r64 has 4400",
        "{cut}"
    );
    let missing = written(|_, bytes| bytes.clear());
    assert!(
        missing.is_passing && &*missing.reason == "no such file" && missing.to_string().contains("R01"),
        "{missing}"
    );
    for (rejection, said) in [
        (
            written(|text, _| *text = text.replacen("221,1\r", "221,0\r", 1)),
            "\"221,0\", has an unknown value",
        ),
        (
            written(|text, _| *text = text.replacen("221,1\r", "221,23\r", 1)),
            "channel pos_1 is not within the file",
        ),
        (
            written(|text, _| *text = text.replacen("REAL64", "INT16", 1)),
            "channel pos_1 has values of the type INT16",
        ),
        (
            written(|text, _| *text = text.replacen("220,50", "220,99999999999999999999", 2)),
            "has an unknown value",
        ),
        (written(|text, _| *text = text.replace("EXPLIZIT", "IMPLIZIT")), "without a channel in a file"),
        (written(|text, _| text.truncate(text.len() - 30)), "ends within a channel"),
        (written(|text, _| text.push_str(&"201,comment\r\n".repeat(100_000))), "more than 1 MiB"),
    ] {
        assert!(rejection.to_string().contains(said), "{rejection}");
    }
}

#[test]
fn a_scope_export_gives_the_rows_of_its_text() {
    let (samples, text) = made_recording(2500);
    for sign in ["\t", ";", ","] {
        let folder = TraceFolder::new();
        let path = folder.path("R01_20260105_0847.csv");
        std::fs::write(&path, scope(&text, sign)).expect("written");
        assert_same(&path, &layout("scope_time_ms", 1e-3), &samples);
        assert!(!super::source::is_plain(&std::fs::read(&path).expect("a file")), "no part of it is read");
    }
}

/// Three channels: 2 ms, 10 ms, and 2 ms that begin 4 ms later. Each value is its time.
#[test]
fn slower_and_later_channels_of_a_scope_export_hold_their_last_value() {
    let mut text = "Name\tScope\nFile\ta\nStarttime of export\t1\n\nName\tfast\tName\tslow\tName\tlate\n\
                    Unit\tV (Voltage)\tUnit\t(None)\tUnit\t(None)\n\n"
        .to_owned();
    for row in 0..20 {
        let [fast, slow, late] = [2 * row, 10 * row, 2 * row + 4];
        let slow = if slow < 40 { format!("{slow}\t{slow}") } else { "\t".to_owned() };
        writeln!(text, "{fast}\t{fast}\t{slow}\t{late}\t{late}").expect("a string");
    }
    text += "EOF\n";
    let folder = TraceFolder::new();
    let path = folder.path("a.csv");
    std::fs::write(&path, &text).expect("written");
    let rows = (2..20).map(|row| format!("{},{},{},{}", 2 * row, 2 * row, 2 * row / 10 * 10, 2 * row));
    let expected = format!("scope_time_ms,fast [V],slow,late\n{}\n", rows.collect::<Vec<_>>().join("\n"));
    assert_eq!(text_of(&path).expect("a text"), expected);
    for (damage, said) in [
        (text.replace("\n4\t", "\nx\t"), "line 10 has \"x\" instead of a time"),
        (text.replace("\n8\t8", "\n1\t8"), "line 12 has the time 1 ms after a later one"),
        (text.replace("\n8\t8", "\n\t"), "line 13 has a time after the end of its channel"),
        (text.replace("\nName\tfast", "\nNames\tfast"), "should be before a line of names"),
        (text.replace("Name\tslow", &"x".repeat(2 << 20)), "is longer than 1 MiB"),
    ] {
        std::fs::write(&path, damage).expect("written");
        let rejection = text_of(&path).expect_err("an error");
        assert!(rejection.to_string().contains(said), "{rejection}");
    }
    // an export of another kind whose first column has the same name
    std::fs::write(&path, "Name,pos_1\n1,2\n").expect("written");
    assert_eq!(text_of(&path).expect("a text"), "Name,pos_1\n1,2\n");
}

#[test]
fn a_thousand_damaged_traces_give_rows_or_an_error() {
    let (_, text) = made_recording(60);
    let folder = TraceFolder::new();
    write_trace(&folder.path("R01"), &text, USUAL);
    let [header, values] = ["R01.dat", "R01.r64"].map(|name| folder.path(name));
    let [whole, bytes] = [&header, &values].map(|path| std::fs::read(path).expect("a file"));
    let mut outcomes = [0; 2];
    let mut check = |path: &Path, damaged: &[u8]| {
        std::fs::write(path, damaged).expect("written");
        match text_of(&header) {
            Ok(text) => {
                assert!(text.len() <= MOST_TEXT_BYTES, "{} bytes", text.len());
                outcomes[0] += 1;
            }
            Err(rejection) => {
                assert!(!rejection.reason.is_empty() && !rejection.remedy.is_empty(), "{rejection}");
                outcomes[1] += 1;
            }
        }
    };
    mutations(&whole, |damaged| check(&header, damaged));
    std::fs::write(&header, &whole).expect("written");
    mutations(&bytes, |damaged| check(&values, damaged));
    assert!(outcomes.iter().all(|count| *count > 50), "{outcomes:?}");
}

#[test]
fn a_thousand_damaged_scope_exports_give_rows_or_an_error() {
    let (_, text) = made_recording(60);
    let folder = TraceFolder::new();
    let path = folder.path("R01.csv");
    mutations(scope(&text, "\t").as_bytes(), |damaged| {
        std::fs::write(&path, damaged).expect("written");
        match text_of(&path) {
            Ok(text) => assert!(text.len() <= MOST_TEXT_BYTES, "{} bytes", text.len()),
            Err(rejection) => {
                assert!(!rejection.reason.is_empty() && !rejection.remedy.is_empty(), "{rejection}")
            }
        }
    });
}
