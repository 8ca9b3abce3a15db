use std::fs;
use std::io::Write;

use super::*;
use crate::bytes::fingerprint::{fingerprint, prefix};
use crate::fixture::{made_recording, native};
use armwatch_config::parse_layout;
use armwatch_model::run::RawSamples;
use armwatch_testing::er3a;

const NATIVE: &str = include_str!("../../../../../config/exports/native.toml");
const MOST: u64 = 1 << 30;

fn layout(parts: &str) -> Layout {
    parse_layout("a.toml", &format!("{NATIVE}\n[parts]\n{parts}")).expect("a layout")
}

/// The rows of the recording at `path`; checks that its hash is that of the files.
fn rows(path: &Path, layout: &Layout) -> Result<RawSamples, Rejection> {
    let (mut export, hash) =
        ExportReader::open(path, layout, &er3a(), ReadOptions { block_bytes: 4000 }, MOST)?;
    let mut all: Option<RawSamples> = None;
    for chunk in export.by_ref() {
        let chunk = chunk?;
        match &mut all {
            None => all = Some(chunk.samples),
            Some(all) => all.append(chunk.samples),
        }
    }
    assert_eq!(hash.so_far(), fingerprint(path).unwrap());
    all.ok_or_else(|| Rejection::of_file(path, "no rows", ""))
}

struct PartsFolder(tempfile::TempDir);

impl PartsFolder {
    fn new(files: &[(&str, &str)]) -> Self {
        let case = Self(tempfile::tempdir().unwrap());
        files.iter().for_each(|(name, text)| fs::write(case.path(name), text).unwrap());
        case
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

fn whole(text: &str) -> RawSamples {
    let case = PartsFolder::new(&[("a.csv", text)]);
    rows(&case.path("a.csv"), &native()).unwrap()
}

/// Text of some columns, by number from 0.
fn columns(text: &str, wanted: &[usize]) -> String {
    let line = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        wanted.iter().map(|&at| cells[at]).collect::<Vec<_>>().join(",") + "\n"
    };
    text.lines().map(line).collect()
}

#[test]
fn parts_after_each_other_are_read_as_one_file() {
    let (_, text) = made_recording(600);
    let header = text.split_inclusive('\n').next().unwrap();
    let ends: Vec<usize> = text.match_indices('\n').map(|(at, _)| at + 1).collect();
    let expected = whole(&text);
    let layout = layout("match = \"after\"");
    let [first, second] = [ends[150], ends[401]];
    let with_header = |part: &str| format!("{header}{part}");
    for (cut, parts) in [
        (
            "each with a header",
            [text[..first].to_owned(), with_header(&text[first..second]), with_header(&text[second..])],
        ),
        (
            "without a header",
            [text[..first].to_owned(), text[first..second].to_owned(), text[second..].to_owned()],
        ),
        (
            "within a line",
            [text[..first + 20].to_owned(), text[first + 20..second].to_owned(), text[second..].to_owned()],
        ),
        (
            "without line ends",
            [
                text[..first - 1].to_owned(),
                with_header(&text[first..second - 1]),
                with_header(&text[second..]),
            ],
        ),
    ] {
        let names = ["a_0.csv", "a_1.csv", "a_2.csv"];
        let case = PartsFolder::new(&[(names[0], &parts[0]), (names[1], &parts[1]), (names[2], &parts[2])]);
        assert_eq!(rows(&case.path("a_{0+}.csv"), &layout).unwrap(), expected, "{cut}");
    }
    // packed, and in another encoding
    let case = PartsFolder::new(&[("b_1.csv", &text[..first])]);
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packed.write_all(with_header(&text[first..second]).as_bytes()).unwrap();
    fs::write(case.path("b_2.csv"), packed.finish().unwrap()).unwrap();
    let wide: Vec<u8> = [0xFEFF]
        .into_iter()
        .chain(with_header(&text[second..]).encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    fs::write(case.path("b_3.csv"), wide).unwrap();
    assert_eq!(rows(&case.path("b_{1+}.csv"), &layout).unwrap(), expected);
}

#[test]
fn a_recording_begins_with_the_bytes_that_it_had_before_the_next_part_came() {
    let (_, text) = made_recording(400);
    let cut = text.len() / 2;
    let case = PartsFolder::new(&[("a_0.csv", &text[..cut])]);
    let [one, all] = ["a_0.csv", "a_{0+}.csv"].map(|name| case.path(name));
    let (hash, bytes) = fingerprint(&one).unwrap();
    assert_eq!(fingerprint(&all).unwrap(), (hash, bytes));
    fs::write(case.path("a_1.csv"), &text[cut..]).unwrap();
    assert_eq!(prefix(&all, bytes).unwrap().map(|of| of.hash), Some(hash));
    // state at the storing of a cycle in the middle of a part
    let (export, running) = ExportReader::open(
        &all,
        &layout("match = \"after\""),
        &er3a(),
        ReadOptions { block_bytes: 900 },
        MOST,
    )
    .unwrap();
    for chunk in export {
        chunk.unwrap();
        let read = running.prefix();
        assert_eq!(prefix(&all, read.bytes).unwrap(), Some(read));
    }
    assert_eq!(running.so_far(), fingerprint(&all).unwrap());
}

#[test]
fn parts_side_by_side_are_read_as_one_file() {
    let (_, text) = made_recording(600);
    let expected = whole(&text);
    let (positions, velocities): (Vec<usize>, Vec<usize>) =
        ((0..7).chain(19..23).collect(), (7..13).collect());
    let torques: Vec<usize> = [0].into_iter().chain(13..19).collect();
    let parts = [columns(&text, &positions), columns(&text, &velocities), columns(&text, &torques)];
    let case =
        PartsFolder::new(&[("a_pos.csv", &parts[0]), ("a_vel.csv", &parts[1]), ("a_trq.csv", &parts[2])]);
    let by_row = layout("match = \"row\"\nnames = [\"pos\", \"vel\", \"trq\"]");
    let path = case.path("a_{pos|vel|trq}.csv");
    assert_eq!(rows(&path, &by_row).unwrap(), expected);
    // a writer that stops a little later
    let shorter: String = parts[1].split_inclusive('\n').take(597).collect();
    fs::write(case.path("a_vel.csv"), &shorter).unwrap();
    assert_eq!(rows(&path, &by_row).unwrap().rows(), 596);
    let short: String = parts[1].split_inclusive('\n').take(301).collect();
    fs::write(case.path("a_vel.csv"), &short).unwrap();
    let rejection = rows(&path, &by_row).unwrap_err();
    assert!(
        rejection.reason.contains("part a_vel.csv ends after 300 rows, part a_pos.csv has more"),
        "{rejection}"
    );
    fs::remove_file(case.path("a_vel.csv")).unwrap();
    let rejection = rows(&path, &by_row).unwrap_err();
    assert!(rejection.reason.contains("without its part a_vel.csv"), "{rejection}");
}

#[test]
fn rows_of_the_same_time_stand_side_by_side() {
    let (_, text) = made_recording(600);
    let expected = whole(&text);
    let positions: Vec<usize> = (0..13).chain(19..23).collect();
    let torques: Vec<usize> = [0].into_iter().chain(13..19).collect();
    let of_positions = columns(&text, &positions);
    // the torques begin 7 rows later, and lack no other row
    let mut of_torques = columns(&text, &torques);
    let ends: Vec<usize> = of_torques.match_indices('\n').map(|(at, _)| at + 1).collect();
    of_torques.replace_range(ends[0]..ends[7], "");
    let case = PartsFolder::new(&[("a_q.csv", &of_positions), ("a_tau.csv", &of_torques)]);
    let by_time = layout("match = \"time\"\nnames = [\"q\", \"tau\"]");
    let found = rows(&case.path("a_{q|tau}.csv"), &by_time).unwrap();
    assert_eq!(found.rows(), expected.rows() - 7);
    assert_eq!(found.torque[3], expected.torque[3][7..]);
    assert_eq!(found.position[2], expected.position[2][7..]);
    // without its time, a part cannot be matched
    fs::write(case.path("a_tau.csv"), columns(&text, &torques[1..])).unwrap();
    let rejection = rows(&case.path("a_{q|tau}.csv"), &by_time).unwrap_err();
    assert!(rejection.reason.contains("part a_tau.csv has no column of time"), "{rejection}");
}
