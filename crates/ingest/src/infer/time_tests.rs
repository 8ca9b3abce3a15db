//! Times in every spelling: the proposal reads them unchanged, or asks.

use std::path::Path;

use super::infer;
use super::proposal::Hints;
use crate::fixture::recording;
use crate::table::reader::{ExportReader, ReadOptions};
use armwatch_config::parse_layout;
use armwatch_testing::er3a;

const ROWS: usize = 600;

/// A recording whose times are written by `write`, from their ms.
fn export(write: impl Fn(u64) -> String) -> (Vec<f64>, String) {
    // positions, velocities and torques of each joint, row by row
    let mut number = 0;
    let (samples, text) = recording(ROWS, || {
        let (kind, joint, row) = (number / (6 * ROWS), number / ROWS % 6, number % ROWS);
        number += 1;
        let rate = 2.0 + 0.5 * joint as f64;
        let phase = rate * 0.002 * row as f64;
        [0.8 * phase.sin(), 0.8 * rate * phase.cos(), 9.0 * phase.cos()][kind]
    });
    let mut lines = text.lines();
    let mut with = format!("{}\n", lines.next().expect("a header"));
    for (line, time) in lines.zip(&samples.time) {
        let (_, rest) = line.split_once(',').expect("cells");
        with.push_str(&format!("{},{rest}\n", write((time * 1000.0).round() as u64)));
    }
    (samples.time, with)
}

fn proposed(text: &str) -> String {
    infer(text.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect("a table").toml
}

fn parts(ms: u64) -> (u64, u64, u64, u64) {
    (ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000)
}

fn clock(start_s: u64) -> impl Fn(u64) -> String {
    move |ms| {
        let (h, m, s, ms) = parts(start_s * 1000 + ms);
        format!("{h:02}:{m:02}:{s:02}.{ms:03}")
    }
}

const MORNING: u64 = 8 * 3600 + 47 * 60;

#[test]
fn every_spelling_is_proposed_as_it_is_or_asked() {
    let day = clock(MORNING);
    let twelve = |t: u64| day(t).trim_start_matches('0').to_owned() + " AM";
    let with_colon = |t: u64| day(t).replace('.', ":");
    let minutes = |t: u64| day(t)[3..].to_owned();
    let night = |t: u64| clock(0)((86_400_000 - 300 + t) % 86_400_000);
    type Write<'w> = Box<dyn Fn(u64) -> String + 'w>;
    let cases: Vec<(&str, bool, Write<'_>)> = vec![
        ("format = \"%m/%d/%Y %I:%M:%S.%f %p\"", true, Box::new(|t| format!("1/5/2026 {}", twelve(t)))),
        ("format = \"%m/%d/%Y %I:%M:%S.%f %p\"", false, Box::new(|t| format!("1/15/2026 {}", twelve(t)))),
        ("format = \"%d/%m/%Y %H:%M:%S.%f\"", true, Box::new(|t| format!("05/01/2026 {}", day(t)))),
        ("format = \"%d-%m-%Y %H:%M:%S.%f\"", true, Box::new(|t| format!("05-01-2026 {}", day(t)))),
        ("format = \"%d-%b-%Y %H:%M:%S.%f\"", false, Box::new(|t| format!("05-Jan-2026 {}", day(t)))),
        ("format = \"%d. %b %Y %H:%M:%S.%f\"", false, Box::new(|t| format!("5. Okt. 2026 {}", day(t)))),
        ("format = \"%Y-%m-%d %H:%M:%S.%f\"", false, Box::new(|t| format!("2026-1-5 {}", day(t)))),
        ("format = \"%Y-%m-%d %H:%M:%S:%f\"", false, Box::new(|t| format!("2026-01-05 {}", with_colon(t)))),
        ("format = \"%H:%M:%S.%f\"", false, Box::new(|t| day(t)[1..].to_owned())),
        ("format = \"%H:%M:%S:%f\"", false, Box::new(with_colon)),
        ("format = \"%M:%S.%f\"", false, Box::new(minutes)),
        ("format = \"%H:%M:%S.%f\"", false, Box::new(clock(25 * 3600))),
        ("format = \"%d.%m.%y %H:%M:%S.%f\"", true, Box::new(|t| format!("05.01.26 {}", day(t)))),
        ("unit = \"duration\"", false, Box::new(|t| format!("T#{t}ms"))),
        ("unit = \"timestamp\"", false, Box::new(|t| format!("2026-01-05 {}", day(t)))),
        ("unit = \"timestamp\"", false, Box::new(night)),
        ("unit = \"d\"", false, Box::new(|t| format!("{:.12}", 46_027.365_972_222 + t as f64 / 86_400e3))),
    ];
    for (key, is_asked, write) in cases {
        let (times, text) = export(write);
        let cell = text.lines().nth(1).and_then(|line| line.split(',').next()).expect("a time").to_owned();
        let toml = proposed(&text);
        let expected = if is_asked { format!("# {key}") } else { format!("\n{key}") };
        // for an ambiguous date, either order may be in the key, and the other in the question
        let other = key.replace("%m/%d", "%d/%m").replace("%m-%d", "%d-%m");
        let found = toml.contains(&expected) || (is_asked && toml.contains(&other));
        assert!(found && !toml.contains("sample_rate_hz"), "{cell}: {toml}");
        if is_asked {
            assert!(toml.contains("which of its numbers is the day?"), "{cell}: {toml}");
            continue;
        }
        let layout =
            parse_layout("a.toml", &toml).unwrap_or_else(|errors| panic!("{cell}: {errors}\n{toml}"));
        let reader =
            ExportReader::new(text.as_bytes(), Path::new("a.csv"), &layout, &er3a(), ReadOptions::default());
        let mut found = Vec::new();
        for chunk in reader.unwrap_or_else(|no| panic!("{cell}: {no}")) {
            found.extend(chunk.unwrap_or_else(|no| panic!("{cell}: {no}")).samples.time);
        }
        assert_eq!(found.len(), times.len(), "{cell}");
        assert!(found.iter().zip(&times).all(|(a, b)| (a - b).abs() < 2e-4), "{cell}: {found:?}");
    }
}

#[test]
fn lost_digits_are_asked_about() {
    let tenths = |t: u64| clock(MORNING)(t)[3..10].to_owned();
    let seconds = |t: u64| format!("05/01/2026 {}", &clock(MORNING)(t)[..8]);
    let scientific = |_: u64| "1.76760E+12".to_owned();
    let writes: [&dyn Fn(u64) -> String; 3] = [&tenths, &seconds, &scientific];
    for write in writes {
        let (_, text) = export(write);
        let toml = proposed(&text);
        assert!(toml.contains("the last digits of this time are lost"), "{toml}");
    }
}
