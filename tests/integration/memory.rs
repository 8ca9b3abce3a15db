//! The program under a memory limit, with exports that would need more memory than that.

use std::fmt::Write as _;
use std::fs;
use std::ops::Range;
use std::process::{Command, Stdio};

use crate::support::{Workshop, pass, peak_kb, text};

/// Limit of the program's address space, kB.
const ADDRESSES_KB: u64 = 1 << 20;

/// Most memory that it may have at any moment, kB.
pub const MOST_KB: u64 = 300_000;

/// What a run under the limit came to.
pub struct Confined {
    pub code: Option<i32>,
    pub peak_kb: u64,
    pub said: String,
}

/// Runs the program with so little address space that it is killed when it takes gigabytes.
pub fn confined(workshop: &Workshop, arguments: &[&str]) -> Confined {
    let limit = format!("ulimit -v {ADDRESSES_KB}; exec \"$0\" \"$@\"");
    let said = workshop.path("said.txt");
    let mut child = Command::new("sh")
        .args(["-c", &limit, env!("CARGO_BIN_EXE_armwatch")])
        .args(arguments)
        .current_dir(workshop.path(""))
        // each arena of the allocator uses address space, and a machine with many processors has many
        .env("MALLOC_ARENA_MAX", "2")
        .stdin(Stdio::null())
        .stdout(fs::File::create(&said).expect("a file"))
        .stderr(fs::File::create(workshop.path("errors.txt")).expect("a file"))
        .spawn()
        .expect("the program starts");
    let mut peak = 0;
    let status = loop {
        peak = peak_kb(child.id()).unwrap_or(0).max(peak);
        if let Some(status) = child.try_wait().expect("a status") {
            break status;
        }
        pass(std::time::Duration::from_millis(2));
    };
    let read = |name: &str| fs::read(workshop.path(name)).map(|bytes| text(&bytes)).expect("its words");
    Confined { code: status.code(), peak_kb: peak, said: read("said.txt") + &read("errors.txt") }
}

/// An export of a six-joint arm that stands still. Each row has time, stage and, if there is one, the cycle, then
/// `further` columns that no layout names.
fn still(
    rows: Range<u32>,
    time_step: f64,
    row: impl Fn(u32) -> (u32, Option<String>),
    further: usize,
) -> String {
    let mut export = String::from("time");
    for channel in ["pos", "vel", "trq"] {
        (1..=6).for_each(|joint| _ = write!(export, ",{channel}_{joint}"));
    }
    let counted = row(rows.start).1.is_some();
    export += if counted { ",stage,cycle" } else { ",stage" };
    (0..further).for_each(|column| _ = write!(export, ",further_{column}"));
    export.push('\n');
    for at in rows {
        let (stage, cycle) = row(at);
        _ = write!(export, "{:.3}{}{stage}", f64::from(at) * time_step, ",".to_owned() + &"0,".repeat(18));
        cycle.into_iter().for_each(|cycle| _ = write!(export, ",{cycle}"));
        export += &",0".repeat(further);
        export.push('\n');
    }
    export
}

/// The rows of a simulated export of one cycle, repeated to `rows` rows, with a cycle counter that counts `every` rows.
fn counting_rows(simulated: &str, rows: usize, every: usize) -> String {
    let mut lines = simulated.lines();
    let header = lines.next().expect("a header");
    let place = header.split(',').position(|name| name == "cycle").expect("a counter");
    let lines: Vec<&str> = lines.collect();
    let mut export = format!("{header}\n");
    for row in 0..rows {
        let cells = lines[row % lines.len()].split(',').skip(1);
        _ = write!(export, "{:.3}", row as f64 * 0.004);
        for (at, cell) in (1..).zip(cells) {
            _ = match at == place {
                true => write!(export, ",{}", 1 + row / every),
                false => write!(export, ",{cell}"),
            };
        }
        export.push('\n');
    }
    export
}

/// Exports, each with the words of its reason; the first of them used gigabytes before the limit.
fn mutations(simulated: &str) -> Vec<(String, &'static str)> {
    const COUNTS_ROWS: &str = "the column cycle counts rows, not cycles: 100 cycles in a row have 1 row each";
    const TOO_OFTEN: &str = "the column cycle changes too often to count cycles: 100 cycles in a row";
    const FLICKERS: &str = "the stage signal returns to an earlier stage too often: 100 cycles in a row";
    let counted = |cycle: u32| Some(cycle.to_string());
    let mut exports = vec![
        (still(1..10_501, 1.0, |row| (1, counted(row)), 0), COUNTS_ROWS),
        (counting_rows(simulated, 36_000, 1), COUNTS_ROWS),
        (counting_rows(simulated, 36_000, 5), TOO_OFTEN),
        (counting_rows(simulated, 36_000, 20), TOO_OFTEN),
        // long enough to be filtered, and far too short for the steps of the low-pass
        (counting_rows(simulated, 12_000, 40), "250 cycles in a row gave neither parameters nor friction"),
        // rising by more than one, from any number on, and with pauses
        (still(1..4000, 0.004, |row| (1, counted(7 * row + 900_000)), 0), COUNTS_ROWS),
        (still(1..4000, 0.004, |row| (1, counted(u32::MAX - 4000 + row)), 0), "is not in 0 to 1000000"),
        (still(1..4000, 0.004, |row| (1, counted(if row % 2 == 0 { 0 } else { row })), 0), COUNTS_ROWS),
        // alternating, falling, below zero, not whole
        (
            still(1..4000, 0.004, |row| (1, counted(1 + row % 2)), 0),
            "below the 2 that the cycle counter had reached",
        ),
        (
            still(1..4000, 0.004, |row| (1, counted(5000 - row)), 0),
            "below the 4999 that the cycle counter had reached",
        ),
        (still(1..4000, 0.004, |row| (1, Some(format!("-{row}"))), 0), "column cycle: \"-1\""),
        (still(1..4000, 0.004, |row| (1, Some(format!("{row}.5"))), 0), "column cycle: \"1.5\""),
        (still(1..4000, 0.004, |row| (1, Some(format!("{row}00000000"))), 0), "column cycle: "),
        // without a counter, by the stages
        (still(1..4000, 0.004, |row| (3 - row % 3, None), 0), FLICKERS),
        (still(1..4000, 0.004, |row| (1 + row % 2, None), 0), FLICKERS),
        (still(1..4000, 0.004, |row| ([1, 1, 3, 0, 0, 2][row as usize % 6], None), 0), FLICKERS),
        (still(1..4000, 0.004, |_| (0, None), 0), "no stage signal"),
        (still(1..4000, 0.004, |row| (0, counted(row)), 0), "no stage signal"),
        // additional columns
        (still(1..400, 0.004, |row| (1, counted(row)), 2000), COUNTS_ROWS),
    ];
    for rows in [2, 3, 5, 8, 13, 21, 31] {
        for stages in [[1, 1, 1], [2, 2, 2], [3, 3, 3], [1, 2, 3], [3, 2, 1]] {
            let row = |row: u32| (stages[row as usize % 3], counted(1 + row / rows));
            exports.push((still(1..110 * rows, 0.004, row, 0), TOO_OFTEN));
        }
    }
    exports
}

#[test]
fn no_pattern_of_cycles_and_stages_takes_more_memory_than_its_rows() {
    let workshop = Workshop::new();
    let simulated = workshop.simulate("simulated", &["--cycles", "1", "--warming-s", "5"]);
    let simulated = fs::read_to_string(&simulated[0]).expect("an export");
    let mutations = mutations(&simulated);
    assert!(mutations.len() >= 50, "{}", mutations.len());
    for (place, (export, _)) in mutations.iter().enumerate() {
        fs::write(workshop.inbox(&format!("M{place:02}_20260105_0847.csv")), export).expect("written");
    }
    let Confined { code, peak_kb, said } = confined(&workshop, &["ingest", "inbox"]);
    assert_eq!(code, Some(1), "{said}");
    for (place, (_, words)) in mutations.iter().enumerate() {
        let of_run = format!("FROM runs WHERE source_name = 'M{place:02}_20260105_0847.csv'");
        let found = workshop.query(&format!("SELECT status || ': ' || reason {of_run}"));
        assert!(found.len() == 1 && found[0].starts_with("quarantined: "), "{place}: {found:?}\n{said}");
        assert!(found[0].contains(words), "{place}: {words}\n{found:?}");
        let cycles = if words.starts_with("250") { 250 } else { 0 };
        assert_eq!(workshop.number(&format!("SELECT cycles {of_run}")), cycles, "{place}: {found:?}");
    }
    assert_eq!(workshop.number("SELECT count(*) FROM cycles"), 250);
    assert!(peak_kb <= MOST_KB, "{peak_kb} kB");
}

#[test]
fn a_cycle_counter_that_counts_rows_is_told_by_the_daemon_and_by_explain_too() {
    let workshop = Workshop::new();
    let export = still(1..10_501, 1.0, |row| (1, Some(row.to_string())), 0);
    let path = workshop.inbox("R01_20260105_0847.csv");
    fs::write(&path, export).expect("written");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM quarantine", 1);
    let peak = peak_kb(daemon.child.id()).expect("its peak");
    daemon.stop();
    assert!(peak <= MOST_KB, "{peak} kB");
    assert_eq!(workshop.number("SELECT count(*) FROM cycles"), 0);
    let remedy = workshop.query("SELECT remedy FROM quarantine");
    assert!(remedy[0].contains("under [if_present] of the layout"), "{remedy:?}");
    let Confined { code, peak_kb, said } = confined(&workshop, &["explain", "inbox/R01_20260105_0847.csv"]);
    assert!(code == Some(1) && said.contains("the column cycle counts rows, not cycles"), "{said}");
    assert!(peak_kb <= MOST_KB, "{peak_kb} kB");
}

/// Regression: each line used 16 bytes.
#[test]
fn a_layout_is_inferred_from_a_file_of_line_ends_in_little_memory() {
    let workshop = Workshop::new();
    fs::write(workshop.path("empty.csv"), vec![b'\n'; 32 << 20]).expect("written");
    let Confined { code, peak_kb, said } = confined(&workshop, &["layout", "infer", "empty.csv"]);
    assert!(code != Some(0) && said.contains("no table of numbers"), "{code:?} {said}");
    assert!(peak_kb <= 150_000, "{peak_kb} kB");
}

/// A cycle whose analysis would need more than the memory limit of all cycles is refused; the row is the same however
/// the file is read.
#[test]
fn a_cycle_beyond_the_limit_in_bytes_is_refused_with_the_limit() {
    let workshop = Workshop::new();
    let set = |bytes: u32| {
        workshop.configure(|config| format!("[limits]\ncycles_max_bytes = {bytes}\n\n{config}"));
    };
    // 30,000 rows of about 160 bytes in one cycle
    let export = still(1..30_001, 0.01, |_| (1, Some("1".to_owned())), 0);
    fs::write(workshop.inbox("R01_20260105_0847.csv"), export).expect("written");
    set(2_000_000);
    let Confined { said, peak_kb, .. } = confined(&workshop, &["ingest", "inbox"]);
    for word in
        ["no cycle boundary in", "limits.cycles_max_bytes = 2000000", "bytes per row", "raise this limit"]
    {
        assert!(said.contains(word), "{word}: {said}");
    }
    assert!(peak_kb <= MOST_KB, "{peak_kb} kB");
    let rows = |said: &str| {
        let of = said.split("no cycle boundary in ").nth(1).and_then(|rest| rest.split(' ').next());
        of.and_then(|rows| rows.parse::<u32>().ok()).expect("rows")
    };
    assert!((4_000..6_000).contains(&rows(&said)), "{said}");
    set(20_000_000);
    let Confined { said, .. } = confined(&workshop, &["ingest", "inbox"]);
    assert!(!said.contains("no cycle boundary"), "{said}");
}

/// Windows of production may be short: all of them are stored, one after the other.
#[test]
fn windows_of_one_row_take_no_more_memory_than_their_rows() {
    let workshop = Workshop::new();
    workshop.configure(|config| config.replace("native.toml", "production.toml"));
    let export = still(1..301, 100.0, |_| (1, None), 0);
    fs::write(workshop.inbox("R01_20260105_0847.csv"), export).expect("written");
    let Confined { peak_kb, said, .. } = confined(&workshop, &["ingest", "inbox"]);
    assert_eq!(workshop.number("SELECT count(*) FROM cycles WHERE status = 'refused'"), 300, "{said}");
    assert!(peak_kb <= MOST_KB, "{peak_kb} kB");
}
