//! Broken exports: each is named with its place and remedy, kept in the ledger, left untouched, and
//! delays no other.

use std::io::Read;

use crate::support::{REFERENCE_NAME, Workshop, reference};

/// The reference export as text.
pub fn decompressed() -> String {
    let file = std::fs::File::open(reference(REFERENCE_NAME)).expect("the reference export");
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).expect("gzip");
    text
}

/// One oddity: a name, what is done to a good export, and what must be said of it.
struct Oddity {
    name: &'static str,
    spoil: fn(Vec<String>) -> String,
    said: &'static [&'static str],
}

fn joined(lines: Vec<String>) -> String {
    lines.join("\n") + "\n"
}

fn with_cell(mut lines: Vec<String>, line: usize, column: usize, value: &str) -> String {
    let mut cells: Vec<&str> = lines[line - 1].split(',').collect();
    cells[column] = value;
    lines[line - 1] = cells.join(",");
    joined(lines)
}

fn without_column(lines: Vec<String>, column: usize) -> String {
    joined(
        lines
            .iter()
            .map(|line| {
                let cells = line.split(',').enumerate().filter(|(at, _)| *at != column).map(|(_, cell)| cell);
                cells.collect::<Vec<_>>().join(",")
            })
            .collect(),
    )
}

/// Columns of the native layout: time, 6 positions, 6 velocities, 6 torques, stage, ...
const TORQUE_3: usize = 15;
const STAGE: usize = 19;

const ODDITIES: &[Oddity] = &[
    Oddity { name: "missing_column", spoil: |l| without_column(l, TORQUE_3), said: &["trq_3"] },
    Oddity {
        name: "text_in_a_number",
        spoil: |l| with_cell(l, 1000, TORQUE_3, "abc"),
        said: &["line 1000", "column trq_3", "\"abc\" is not a number"],
    },
    Oddity { name: "empty_file", spoil: |_| String::new(), said: &["empty"] },
    Oddity { name: "header_only", spoil: |l| format!("{}\n", l[0]), said: &["no rows"] },
    Oddity {
        name: "cut_last_line",
        spoil: |l| {
            let text = joined(l[..3000].to_vec());
            text[..text.len() - 40].to_owned()
        },
        said: &["line 3000", "cut"],
    },
    Oddity {
        name: "nan",
        spoil: |l| with_cell(l, 2000, 8, "NaN"),
        said: &["line 2000", "column vel_2", "NaN"],
    },
    Oddity {
        name: "time_running_backwards",
        spoil: |l| with_cell(l, 2500, 0, "1.0000"),
        said: &["line 2500", "column time"],
    },
    Oddity { name: "no_stage_column", spoil: |l| without_column(l, STAGE), said: &["stage"] },
    Oddity {
        name: "stage_always_zero",
        spoil: |l| {
            let silent = l.iter().enumerate().map(|(at, line)| {
                let mut cells: Vec<&str> = line.split(',').collect();
                if at > 0 {
                    cells[STAGE] = "0";
                }
                cells.join(",")
            });
            joined(silent.collect())
        },
        said: &["no stage signal"],
    },
    Oddity {
        name: "wrong_joint_count",
        spoil: |l| {
            let wide = l.iter().enumerate().map(|(at, line)| {
                if at == 0 { format!("{line},pos_7,vel_7,trq_7") } else { format!("{line},0,0,0") }
            });
            joined(wide.collect())
        },
        said: &["7 joints", "6"],
    },
    Oddity {
        name: "absurd_value",
        spoil: |l| with_cell(l, 1500, TORQUE_3, "1e200"),
        said: &["line 1500", "column trq_3", "1e200"],
    },
    Oddity {
        name: "cycle_counter_falls",
        spoil: |l| {
            let at = l.iter().position(|line| line.split(',').nth(20) == Some("2")).expect("a second cycle");
            with_cell(l, at + 500, 20, "1")
        },
        said: &["falls from 2 to 1"],
    },
];

fn spoiled(workshop: &Workshop, oddity: &Oddity) -> std::path::PathBuf {
    // two cycles are enough, and quick
    let lines: Vec<String> = decompressed().lines().take(1 + 2 * 8509).map(str::to_owned).collect();
    let path = workshop.inbox(&format!("{}_20260105_0847.csv", oddity.name));
    std::fs::write(&path, (oddity.spoil)(lines)).expect("an export");
    path
}

#[test]
fn every_oddity_is_quarantined_with_its_place_and_a_remedy() {
    let workshop = Workshop::new();
    for oddity in ODDITIES {
        let path = spoiled(&workshop, oddity);
        let before = std::fs::read(&path).expect("the export");
        let out = workshop.stdout(&["ingest", path.to_str().expect("a path")], 1);
        for said in oddity.said.iter().chain(&[oddity.name]) {
            assert!(out.contains(said), "{}: \"{said}\" is not in {out}", oddity.name);
        }
        assert!(out.contains("; "), "{}: no remedy in {out}", oddity.name);
        let row = workshop.query(&format!(
            "SELECT status, reason FROM runs WHERE source_name = '{}_20260105_0847.csv'",
            oddity.name
        ));
        let [row] = &row[..] else { panic!("{}: {row:?}", oddity.name) };
        assert!(row.starts_with("quarantined|") && row.len() > 20, "{}: {row}", oddity.name);
        assert_eq!(std::fs::read(&path).expect("the export"), before, "{} was changed", oddity.name);
    }
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs"), i64::try_from(ODDITIES.len()).expect("few"));
    assert_eq!(workshop.query("PRAGMA integrity_check"), ["ok"]);
    assert_eq!(workshop.query("PRAGMA foreign_key_check"), [""; 0]);
}

#[test]
fn the_other_files_go_on_and_the_exit_status_remembers() {
    let workshop = Workshop::new();
    for oddity in &ODDITIES[..3] {
        spoiled(&workshop, oddity);
    }
    workshop.add_reference("inbox");
    let out = workshop.stdout(&["ingest", "inbox"], 1);
    assert_eq!((out.matches("quarantined ").count(), out.matches("stored ").count()), (3, 1), "{out}");
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycles WHERE robot = 'R00'"), 5);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs WHERE status = 'quarantined'"), 3);
}

#[test]
fn whole_cycles_before_a_fault_are_kept_but_take_no_part_in_conclusions() {
    let workshop = Workshop::new();
    let lines: Vec<String> = decompressed().lines().map(str::to_owned).collect();
    let text = with_cell(lines, 3 * 8509 + 10, TORQUE_3, "x");
    std::fs::write(workshop.inbox("R00_20260105_0847.csv"), text).expect("an export");
    let out = workshop.stdout(&["ingest", "inbox"], 1);
    assert!(out.contains("3 cycles before it are stored"), "{out}");
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycles"), 3);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM fleet_health"), 0);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM warmup_fits"), 0);
}

#[test]
fn a_quarantined_export_is_read_again_when_a_person_asks() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    let good = std::fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    std::fs::write(workshop.path("armwatch.toml"), good.replace("\"*\"", "\"Other*\""))
        .expect("a configuration");
    let out = workshop.stdout(&["ingest", "inbox"], 1);
    assert!(out.contains("no description for robot"), "{out}");
    std::fs::write(workshop.path("armwatch.toml"), good).expect("a configuration");
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.query("SELECT robot, status, cycles FROM runs"), ["R00|complete|5"]);
}
