//! Rows and times that are understood despite deviations.

use std::path::Path;

use super::{ExportReader, ReadOptions, Step};
use crate::bytes::blocks::Passed;
use crate::fixture::{made_recording, native, read_bytes, with_blocks_of};
use crate::rejection::Rejection;
use crate::table::clock::Turn;
use crate::table::mended::{Mend, Mended};
use armwatch_config::{Column, Layout, MomentFormat, RowRule, ScaledColumn, TextTime, TimeSource};
use armwatch_model::run::RawSamples;
use armwatch_testing::er3a;

const BLOCKS: [usize; 4] = [1, 700, 2500, 1 << 20];

fn text_layout(form: TextTime) -> Layout {
    Layout { time: TimeSource::Text { column: Column::Name("time".into()), form }, ..native() }
}

fn format(text: &str) -> Layout {
    text_layout(TextTime::Format(MomentFormat::new(text).expect("a format")))
}

fn numbers(to_si: f64) -> Layout {
    let column = ScaledColumn { column: Column::Name("time".into()), to_si };
    Layout { time: TimeSource::Column(column), ..native() }
}

/// The rows of an export and its repairs.
fn read(text: &[u8], layout: &Layout, block_bytes: usize) -> Result<(RawSamples, Mended), Rejection> {
    let mut reader =
        ExportReader::new(text, Path::new("a.csv"), layout, &er3a(), with_blocks_of(block_bytes))?;
    let mut rows = RawSamples::default();
    loop {
        match reader.step()? {
            Step::Rows(chunk) => rows.append(chunk.samples),
            Step::Waiting => {}
            Step::End => return Ok((rows, reader.mended().clone())),
        }
    }
}

/// A recording with differently written times, from its row and time in ms.
fn with_times(rows: usize, write: impl Fn(usize, u64) -> String) -> (RawSamples, String) {
    let (samples, text) = made_recording(rows);
    let mut lines = text.lines();
    let mut with = format!("{}\n", lines.next().expect("a header"));
    for ((row, line), time) in lines.enumerate().zip(&samples.time) {
        let (_, rest) = line.split_once(',').expect("cells");
        with.push_str(&format!("{},{rest}\n", write(row, (time * 1000.0).round() as u64)));
    }
    (samples, with)
}

fn assert_times(found: &RawSamples, expected: &RawSamples, case: &str) {
    assert_eq!(found.torque, expected.torque, "{case}");
    assert_eq!(found.time.len(), expected.time.len(), "{case}");
    for (found, expected) in found.time.iter().zip(&expected.time) {
        assert!((found - (expected - 0.0)).abs() < 1e-6, "{case}: {found} {expected}");
    }
}

/// Hours, minutes, seconds and milliseconds of a time in ms.
fn parts(ms: u64) -> (u64, u64, u64, u64) {
    (ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000)
}

#[test]
fn recordings_in_one_file_follow_one_another() {
    // three recordings of 100, 130 and 70 rows, each from its own start; times in ms
    let (starts, firsts) = ([0, 100, 230], [500_u64, 400, 0]);
    let recording = |row: usize| starts.iter().rposition(|start| row >= *start).expect("a recording");
    let times =
        |row: usize, _| (firsts[recording(row)] + 2 * (row - starts[recording(row)]) as u64).to_string();
    let (samples, text) = with_times(300, times);
    let without_counter = text.replacen(",cycle,", ",number,", 1);
    let mut layout = numbers(1e-3);
    let TimeSource::Column(column) = layout.time.clone() else { panic!("a column") };
    layout.time = TimeSource::Restarting(column);
    let expected: Vec<f64> = (0..300).map(|row| row as f64 * 0.002 + recording(row) as f64 * 0.998).collect();
    for block_bytes in BLOCKS {
        for (text, cycles) in [
            (&without_counter, (0..300).map(|row| 1 + recording(row) as u32).collect::<Vec<u32>>()),
            // the counter continues within a cycle
            (&text, (0..300).map(|row| 1 + (row / 12 + recording(row)) as u32).collect()),
        ] {
            let (rows, mended) = read(text.as_bytes(), &layout, block_bytes).expect("three recordings");
            assert_times(&rows, &RawSamples { time: expected.clone(), ..samples.clone() }, "restarts");
            assert_eq!(rows.cycle, Some(cycles));
            let places = mended.places(Mend::Clock(Turn::Restart)).expect("two places");
            assert_eq!((places.count, places.first_line), (2, 102));
        }
    }
    let rejection = read(text.as_bytes(), &numbers(1e-3), 1 << 20).expect_err("time falls");
    assert!(rejection.remedy.contains("restarts = true"), "{rejection}");
    // a bad row is reported as in any other export
    let bad = text.replacen("\n5", "\nx", 1);
    assert_eq!(read(bad.as_bytes(), &layout, 1 << 20).expect_err("a word").line, Some(2));
}

#[test]
fn every_spelling_of_a_spreadsheet_or_controller_gives_the_same_times() {
    const START: u64 = (8 * 3600 + 47 * 60) * 1000;
    let clock = |ms: u64| parts(START + ms);
    type Write = Box<dyn Fn(usize, u64) -> String>;
    let cases: Vec<(Layout, Write)> = vec![
        (
            format("%m/%d/%Y %I:%M:%S.%f %p"),
            Box::new(move |_, t| {
                let (h, m, s, ms) = clock(t);
                format!("1/5/2026 {h}:{m:02}:{s:02}.{ms:03} AM")
            }),
        ),
        (
            format("%d-%b-%Y %H:%M:%S.%f"),
            Box::new(move |_, t| {
                let (h, m, s, ms) = clock(t);
                format!("05-Jan-2026 {h:02}:{m:02}:{s:02}.{ms:03}")
            }),
        ),
        (
            format("%d.%m.%y %H:%M:%S"),
            Box::new(move |_, t| {
                let (h, m, s, ms) = clock(t);
                format!("05.01.26 {h:02}:{m:02}:{s:02}.{ms:03}")
            }),
        ),
        (
            format("%H:%M:%S:%f"),
            Box::new(move |_, t| {
                let (h, m, s, ms) = clock(t);
                format!("{h}:{m:02}:{s:02}:{ms}")
            }),
        ),
        (
            format("%M:%S.%f"),
            Box::new(move |_, t| {
                let (_, m, s, ms) = clock(t);
                format!("{m:02}:{s:02}.{ms:03}")
            }),
        ),
        (
            format("%H:%M:%S"),
            Box::new(move |_, t| {
                let (h, m, s, ms) = clock(t + 20 * 3_600_000);
                format!("{h}:{m:02}:{s:02}.{ms:03}")
            }),
        ),
        (text_layout(TextTime::Duration), Box::new(|_, t| format!("T#{}m{}ms", t / 60_000, t % 60_000))),
        (numbers(60.0), Box::new(|_, t| format!("{:.9}", t as f64 / 60e3))),
        (numbers(3600.0), Box::new(|_, t| format!("{:.11}", t as f64 / 3600e3))),
        (
            numbers(86_400.0),
            Box::new(|_, t| format!("46027.{:012.0}", (0.365_972_222_222 + t as f64 / 86_400e3) * 1e12)),
        ),
    ];
    for (layout, write) in cases {
        let (expected, text) = with_times(60, write);
        let case = text.lines().nth(1).unwrap_or_default()[..30].to_owned();
        for block_bytes in BLOCKS {
            let (found, mended) =
                read(text.as_bytes(), &layout, block_bytes).unwrap_or_else(|no| panic!("{case}: {no}"));
            assert_times(&found, &expected, &case);
            assert!(mended.sentences().is_empty(), "{case}: {mended:?}");
        }
    }
}

#[test]
fn midnight_and_a_change_of_clocks_go_on_and_are_named_with_their_line() {
    let of_day = |start: u64| move |t: u64| (start + t) % 86_400_000;
    let night = of_day(86_400_000 - 40);
    let back = |t: u64| if t < 40 { 3 * 3_600_000 - 40 + t } else { 2 * 3_600_000 - 40 + t };
    let forward = |t: u64| if t < 40 { 2 * 3_600_000 - 40 + t } else { 3 * 3_600_000 - 40 + t };
    type Clock<'c> = &'c dyn Fn(u64) -> u64;
    let cases: [(Clock<'_>, &str, &str, Turn); 5] = [
        (&night, "", "%H:%M:%S.%f", Turn::Anew),
        (&back, "", "%H:%M:%S.%f", Turn::Back),
        (&back, "25.10.2026 ", "%d.%m.%Y %H:%M:%S.%f", Turn::Back),
        (&forward, "29.03.2026 ", "%d.%m.%Y %H:%M:%S.%f", Turn::Forward),
        (&forward, "29.03.2026 ", "", Turn::Forward),
    ];
    for (clock, date, form, turn) in cases {
        let (expected, text) = with_times(60, |_, t| {
            let (h, m, s, ms) = parts(clock(t));
            format!("{date}{h:02}:{m:02}:{s:02}.{ms:03}")
        });
        let layout = if form.is_empty() { text_layout(TextTime::Timestamp) } else { format(form) };
        let line =
            2 + expected.time.iter().position(|time| (time * 1000.0).round() >= 40.0).expect("a row") as u64;
        for block_bytes in BLOCKS {
            let (found, mended) = read(text.as_bytes(), &layout, block_bytes).expect(date);
            assert_times(&found, &expected, date);
            let places = mended.places(Mend::Clock(turn)).expect("named");
            assert_eq!((places.count, places.first_line), (1, line), "{date} {turn:?}, {block_bytes}");
        }
    }
}

#[test]
fn reading_goes_on_behind_a_change_of_clocks() {
    let (expected, text) = with_times(60, |_, t| {
        let (h, m, s, ms) = parts(if t < 40 { 3 * 3_600_000 - 40 + t } else { 2 * 3_600_000 - 40 + t });
        format!("{h:02}:{m:02}:{s:02}.{ms:03}")
    });
    let layout = text_layout(TextTime::Timestamp);
    let reader = || {
        ExportReader::new(text.as_bytes(), Path::new("a.csv"), &layout, &er3a(), with_blocks_of(500))
            .expect("an export")
    };
    // the first rows give the origin of times
    for chunk in reader().skip(1) {
        let chunk = chunk.expect("rows");
        let mut behind = reader();
        while behind.pass_to(&chunk.position).expect("lines") == Passed::Going {}
        let Step::Rows(next) = behind.step().expect("rows") else { panic!("no rows") };
        assert_eq!(next.samples.time[0].to_bits(), chunk.samples.time[0].to_bits());
        assert!(expected.time.iter().any(|time| (time - next.samples.time[0]).abs() < 1e-9));
    }
}

#[test]
fn rows_that_repeat_the_one_before_are_left_out_whatever_the_blocks() {
    let (expected, text) = made_recording(40);
    let lines: Vec<&str> = text.lines().collect();
    for repeated in [vec![7], vec![7, 7, 20], vec![40], (1..=40).collect()] {
        let mut with = format!("{}\n", lines[0]);
        for (number, line) in lines.iter().enumerate().skip(1) {
            let times = 1 + repeated.iter().filter(|of| **of == number).count();
            (0..times).for_each(|_| with.push_str(&format!("{line}\n")));
        }
        for block_bytes in BLOCKS {
            let (found, mended) = read(with.as_bytes(), &native(), block_bytes).expect("rows");
            assert_eq!(found, expected, "{repeated:?}, blocks of {block_bytes}");
            let places = mended.places(Mend::Repeated).expect("named");
            assert_eq!((places.count, places.first_line), (repeated.len() as u64, repeated[0] as u64 + 2));
        }
    }
}

#[test]
fn two_rows_of_one_time_with_other_cells_are_a_bad_row() {
    let (expected, text) = made_recording(40);
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let other = lines[9].replacen(lines[9].split(',').nth(13).expect("a torque"), "9.75", 1);
    lines.insert(10, other);
    let text = lines.join("\n") + "\n";
    for block_bytes in BLOCKS {
        let refused = read(text.as_bytes(), &native(), block_bytes).expect_err("one time");
        assert_eq!(refused.line, Some(11));
        let said = refused.to_string();
        assert!(said.contains("time does not advance") && said.contains("skip_bad = 10"), "{said}");
        let layout = Layout { rows: RowRule { skip_bad: 1 }, ..native() };
        assert_eq!(read(text.as_bytes(), &layout, block_bytes).expect("passed over").0, expected);
    }
}

#[test]
fn nul_bytes_behind_the_last_row_are_left_out_and_others_are_not() {
    let (expected, text) = made_recording(40);
    let nuls = |count: usize| vec![0; count];
    for count in [1, 4096, 3 << 20] {
        for block_bytes in [700, 1 << 20] {
            let with = [text.as_bytes(), &nuls(count)].concat();
            let (found, mended) = read(&with, &native(), block_bytes).expect("rows");
            assert_eq!(found, expected, "{count} NUL bytes, blocks of {block_bytes}");
            let places = mended.places(Mend::TrailingNuls).expect("named");
            assert_eq!((places.count, places.first_line), (count as u64, 42));
            // a last row that the power cut interrupted
            let cut = [&text.as_bytes()[..text.len() - 9], &nuls(count)].concat();
            assert_eq!(read(&cut, &native(), block_bytes).expect("rows").0.rows(), 39);
        }
    }
    let wide: Vec<u8> =
        format!("{text}{}", "\0".repeat(100)).encode_utf16().flat_map(u16::to_le_bytes).collect();
    assert_eq!(read(&wide, &native(), 700).expect("rows").0, expected);
    let half: usize = text.lines().take(20).map(|line| line.len() + 1).sum();
    for (count, at) in [(1, half), (600, half), (600, half + 7), (3 << 20, half)] {
        let hole = [&text.as_bytes()[..at], &nuls(count), &text.as_bytes()[at..]].concat();
        for block_bytes in [1, 700, 1 << 20] {
            let refused = read(&hole, &native(), block_bytes).expect_err("a hole");
            assert!(refused.reason.contains("NUL bytes"), "{refused}");
            assert_eq!(refused.line, Some(21), "{count} NUL bytes at {at}, blocks of {block_bytes}");
        }
    }
}

#[test]
fn a_time_that_is_not_read_names_the_setting_that_reads_it() {
    for (cell, layout, wanted) in [
        (
            "05/01/2026 08:47:00.5",
            native(),
            "set format = \"%d/%m/%Y %H:%M:%S.%f\" or \"%m/%d/%Y %H:%M:%S.%f\"",
        ),
        ("05/13/2026 08:47:00", text_layout(TextTime::Timestamp), "set format = \"%m/%d/%Y %H:%M:%S\""),
        ("8:47:00", text_layout(TextTime::Timestamp), "set format = \"%H:%M:%S\""),
        ("T#20ms", native(), "set unit = \"duration\""),
    ] {
        let (_, text) = with_times(3, |_, _| cell.to_owned());
        let refused = read_bytes(text.as_bytes(), &layout, ReadOptions::default()).expect_err(cell);
        assert!(refused.remedy.contains(wanted), "{cell}: {refused}");
    }
    let (_, text) = with_times(3, |_, _| "1.76760E+12".to_owned());
    let (_, other) = text.split_once('\n').expect("rows");
    let mut rows: Vec<&str> = other.lines().collect();
    let changed = rows[1].replacen(",0", ",0.5", 1);
    rows[1] = &changed;
    let text = format!("{}\n{}\n", text.lines().next().expect("a header"), rows.join("\n"));
    let refused = read_bytes(text.as_bytes(), &numbers(1e-3), ReadOptions::default()).expect_err("digits");
    assert!(refused.remedy.contains("the last digits of the time are lost"), "{refused}");
}

#[test]
fn cells_of_slower_channels_are_named_with_their_rates() {
    let (_, text) = made_recording(60);
    let sparse: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(row, line)| {
            let cells = line.split(',').enumerate();
            let cells = cells
                .map(|(at, cell)| if row > 1 && row % 2 == 0 && (13..19).contains(&at) { "" } else { cell });
            cells.collect::<Vec<_>>().join(",")
        })
        .collect();
    let refused = read((sparse.join("\n") + "\n").as_bytes(), &native(), 1 << 20).expect_err("slow torques");
    let said = refused.to_string();
    assert_eq!((refused.line, refused.column.as_deref()), (Some(3), Some("trq_1")));
    assert!(said.contains("a value in 30 of 60 rows (about 250.0 Hz of 500.0 Hz)"), "{said}");
    assert!(said.contains("at the rate of the slowest one; or set skip_bad = 100000"), "{said}");
    // with a rule, these cells are NaN, and others are unchanged
    let mut layout = native();
    layout.slower.torque = Some(armwatch_model::run::slower::Slower::Hold);
    let found = read((sparse.join("\n") + "\n").as_bytes(), &layout, 1 << 20).expect("rows").0;
    assert!(found.torque.iter().all(|of| of.iter().filter(|value| value.is_nan()).count() == 30));
    assert!(found.position.iter().flatten().all(|value| value.is_finite()));
}
