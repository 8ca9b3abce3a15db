//! Broken exports: each is reported with its place and remedy, kept in the ledger, left unchanged, and does not delay
//! other exports.

use std::io::Read;

use crate::support::{REFERENCE_NAME, Workshop, reference};

/// The reference export as text.
pub fn decompressed() -> String {
    let file = std::fs::File::open(reference(REFERENCE_NAME)).expect("the reference export");
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).expect("gzip");
    text
}

/// A broken export: a name, a change of a good export, and the expected words.
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
        said: &["line 9010", "column cycle", "\"1\" is below the 2 that the cycle counter had reached"],
    },
    Oddity { name: "no_header", spoil: |l| joined(l[1..].to_vec()), said: &["line 1", "no header line"] },
    Oddity { name: "no_time_column", spoil: |l| without_column(l, 0), said: &["line 1", "column time"] },
    Oddity {
        name: "mark_of_a_spreadsheet",
        spoil: |l| with_cell(l, 1200, TORQUE_3, "#N/A"),
        said: &["line 1200", "column trq_3", "\"#N/A\" is not a number"],
    },
    Oddity {
        name: "infinity",
        spoil: |l| with_cell(l, 1300, 2, "-inf"),
        said: &["line 1300", "column pos_2", "\"-inf\" is not a finite number"],
    },
    Oddity {
        name: "empty_cell",
        spoil: |l| with_cell(l, 1400, 9, ""),
        said: &["line 1400", "column vel_3", "empty cell"],
    },
    Oddity {
        name: "row_of_units",
        spoil: |mut l| {
            let units = ["s"].into_iter().chain([["rad"; 6], ["rad/s"; 6], ["Nm"; 6]].into_iter().flatten());
            let row: Vec<&str> = units.chain([""; 4]).collect();
            l.insert(1, row.join(","));
            joined(l)
        },
        said: &["line 2", "column time", "\"s\" is not a number"],
    },
    Oddity {
        name: "comment_line",
        spoil: |mut l| {
            l.insert(700, "# operator took over".into());
            joined(l)
        },
        said: &["line 701", "too short"],
    },
    Oddity {
        name: "words_above_the_header",
        spoil: |mut l| {
            l.insert(0, "exported by the controller".into());
            joined(l)
        },
        said: &["line 1", "time"],
    },
    Oddity {
        name: "header_again",
        spoil: |mut l| {
            l.insert(900, l[0].clone());
            joined(l)
        },
        said: &["line 901", "repeated header"],
    },
    Oddity {
        name: "time_written_twice",
        spoil: |mut l| {
            // an identical row would be skipped
            let mut cells: Vec<&str> = l[999].split(',').collect();
            cells[13] = "0.125";
            l.insert(1000, cells.join(","));
            joined(l)
        },
        said: &["line 1001", "time"],
    },
    Oddity {
        name: "line_of_absurd_values",
        spoil: |mut l| {
            let cells: Vec<String> = l[1499]
                .split(',')
                .enumerate()
                .map(|(at, cell)| if (1..STAGE).contains(&at) { "1e9".to_owned() } else { cell.to_owned() })
                .collect();
            l[1499] = cells.join(",");
            joined(l)
        },
        said: &["line 1500", "column pos_1", "1e9"],
    },
];

fn spoiled(workshop: &Workshop, oddity: &Oddity) -> std::path::PathBuf {
    // two cycles are enough and fast
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
        assert!(row.starts_with("quarantined|") && row.contains("; "), "{}: {row}", oddity.name);
        for said in oddity.said {
            assert!(row.contains(said), "{}: \"{said}\" is not in {row}", oddity.name);
        }
        assert_eq!(std::fs::read(&path).expect("the export"), before, "{} was changed", oddity.name);
    }
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs"), i64::try_from(ODDITIES.len()).expect("few"));
    assert_eq!(workshop.query("PRAGMA integrity_check"), ["ok"]);
    assert_eq!(workshop.query("PRAGMA foreign_key_check"), [""; 0]);
}

#[test]
fn bad_rows_within_the_bound_of_the_layout_are_passed_over_counted_and_said() {
    let workshop = Workshop::new();
    let lines: Vec<String> = decompressed().lines().take(1 + 2 * 8509).map(str::to_owned).collect();
    std::fs::write(workshop.inbox("Good_20260105_0847.csv"), joined(lines.clone())).expect("an export");
    let mut bad = lines.clone();
    bad[4000] = bad[4000].split(',').take(7).collect::<Vec<_>>().join(",");
    bad[4001] = with_cell(bad.clone(), 4002, TORQUE_3, "").lines().nth(4001).expect("a row").to_owned();
    bad[9000] = "#!".into();
    let last = bad.len() - 1;
    bad[last] = bad[last].split(',').take(3).collect::<Vec<_>>().join(",");
    std::fs::write(workshop.inbox("Bad_20260105_0847.csv"), joined(bad)).expect("an export");
    let refused = workshop.stdout(&["ingest", "inbox"], 1);
    assert!(
        refused.contains("line 4001: line too short") && refused.contains("skip_bad = 10 under [rows]"),
        "{refused}"
    );

    let native =
        std::fs::read_to_string(format!("{}/config/exports/native.toml", env!("CARGO_MANIFEST_DIR")));
    let layout = native.expect("a layout") + "\n[rows]\nskip_bad = 3\n";
    std::fs::write(workshop.path("layout.toml"), layout).expect("a layout");
    workshop.use_file("layout", "layout.toml");
    assert!(workshop.stdout(&["config", "check"], 0).contains("up to 3 bad rows skipped"));
    let said = workshop.stdout(&["explain", "inbox/Bad_20260105_0847.csv"], 0);
    assert!(said.contains("3 bad rows are skipped") && said.contains("line 4001: line too short"), "{said}");
    assert!(said.contains("the last line has too few fields"), "{said}");
    workshop.stdout(&["ingest", "inbox"], 0);
    let runs = workshop.query("SELECT robot, status, rows, rows_skipped FROM runs ORDER BY robot");
    assert_eq!(runs, ["Bad|complete|17014|3", "Good|complete|17018|0"]);
    let levels = "SELECT COUNT(*) FROM cycle_parameters WHERE robot = 'Bad'";
    assert!(workshop.number(levels) > 0);
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

/// Parameters of the only cycle of a run, with their standard errors, by joint and name.
fn parameters(workshop: &Workshop, robot: &str) -> Vec<(String, f64, f64)> {
    let rows = workshop.query(&format!(
        "SELECT joint || ' ' || parameter, value, std_error FROM cycle_parameters WHERE robot = '{robot}' AND cycle = 1 \
         ORDER BY joint, parameter"
    ));
    let row = |row: &String| {
        let mut cells = row.split('|');
        let mut next = || cells.next().expect("a cell").to_owned();
        (next(), next().parse().expect("a value"), next().parse().expect("a standard error"))
    };
    rows.iter().map(row).collect()
}

/// Compares two sets of parameters, in standard errors.
#[track_caller]
fn assert_unchanged(found: &[(String, f64, f64)], expected: &[(String, f64, f64)], standard_errors: f64) {
    assert!(!expected.is_empty());
    assert_eq!(found.len(), expected.len());
    for ((name, value, _), (_, wanted, error)) in found.iter().zip(expected) {
        assert!((value - wanted).abs() <= standard_errors * error, "{name}: {value}, {wanted} +- {error}");
    }
}

/// The real recording as lines, without its header.
fn real_rows() -> (String, Vec<String>) {
    let file = std::fs::File::open(reference("tx40/TX40_0000-4000ms_5kHz.csv.gz")).expect("the recording");
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(file).read_to_string(&mut text).expect("gzip");
    let mut lines = text.lines().map(str::to_owned);
    (lines.next().expect("a header"), lines.collect())
}

/// A workshop for recordings of the real arm; with `timed`, their first column is the time in s.
fn real_workshop(timed: bool) -> Workshop {
    let workshop = Workshop::new();
    let root = env!("CARGO_MANIFEST_DIR");
    let mut layout =
        std::fs::read_to_string(format!("{root}/config/exports/motor_side.toml")).expect("a layout");
    if timed {
        layout = layout.replace("sample_rate_hz = 5000.0", "column = \"time\"\nunit = \"s\"");
    }
    std::fs::write(workshop.path("layout.toml"), layout).expect("a layout");
    let config = format!(
        "[watch]\nfolders = [\"inbox\"]\n\n[[robot]]\nname = \"*\"\ndescription = \"{root}/config/robots/tx40.toml\"\n\
         layout = \"layout.toml\"\n"
    );
    std::fs::write(workshop.path("armwatch.toml"), config).expect("a configuration");
    workshop
}

fn write(workshop: &Workshop, robot: &str, header: &str, rows: &[String]) {
    let text = format!("{header}\n{}", joined(rows.to_vec()));
    std::fs::write(workshop.inbox(&format!("{robot}_20200101_0000.csv")), text).expect("an export");
}

#[test]
fn standstill_and_a_cut_last_line_leave_the_parameters_of_a_real_recording_as_they_are() {
    let (header, rows) = real_rows();
    let workshop = real_workshop(false);
    write(&workshop, "Plain", &header, &rows);
    // one second of rest before the motion: the first row, repeated
    let rested: Vec<String> =
        std::iter::repeat_n(rows[0].clone(), 5000).chain(rows.iter().cloned()).collect();
    write(&workshop, "Rested", &header, &rested);
    let text = format!("{header}\n{}", joined(rows.clone()));
    std::fs::write(workshop.inbox("Cut_20200101_0000.csv"), &text[..text.len() - 4]).expect("an export");
    workshop.stdout(&["ingest", "inbox"], 0);
    let plain = parameters(&workshop, "Plain");
    assert_eq!(plain.len(), 61);
    // rows at rest are not used, but the first 83 ms of the motion now have rows before them and are used
    assert_unchanged(&parameters(&workshop, "Rested"), &plain, 0.5);
    // the export is one of 20,000 rows shorter, so the unused end begins one row earlier
    assert_unchanged(&parameters(&workshop, "Cut"), &plain, 0.1);
    assert_eq!(workshop.number("SELECT rows FROM runs WHERE robot = 'Cut'"), 19_999);
}

#[test]
fn alternating_steps_give_the_parameters_of_even_ones() {
    /// Both take a row of the same recording every 11 ms on average, but not the same rows: their noise is nearly
    /// independent, and the difference has the variance of both. The limit is four standard errors of it, which one of
    /// 61 parameters exceeds in one of 250 recordings.
    const INDEPENDENT_NOISE: f64 = 4.0 * std::f64::consts::SQRT_2;
    let (header, rows) = real_rows();
    let workshop = real_workshop(true);
    let timed = |steps: [usize; 2]| -> Vec<String> {
        let mut at = 0;
        let mut taken = Vec::new();
        for step in steps.into_iter().cycle() {
            let Some(row) = rows.get(at) else { break };
            taken.push(format!("{:.4},{row}", at as f64 / 5000.0));
            at += step;
        }
        taken
    };
    let header = format!("time,{header}");
    write(&workshop, "Even", &header, &timed([55, 55]));
    write(&workshop, "Alternating", &header, &timed([50, 60]));
    workshop.stdout(&["ingest", "inbox"], 0);
    let (even, alternating) = (parameters(&workshop, "Even"), parameters(&workshop, "Alternating"));
    assert_eq!(even.len(), 61);
    assert_unchanged(&alternating, &even, INDEPENDENT_NOISE);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycles WHERE remarks LIKE '%gap%'"), 0);
}
