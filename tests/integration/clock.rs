//! Results of a recording do not depend on the start of its clock.

use std::fs;
use std::path::PathBuf;

use crate::canon::OF_DEEDS;
use crate::small;
use crate::support::{Workshop, assert_alike, query};

/// Columns that depend on the bytes of a file: another clock is another text.
const OF_THE_BYTES: [&str; 2] = ["content_hash", "source_bytes"];

const SHAPE: [&str; 8] = ["--cycles", "6", "--warming-s", "2", "--rate-hz", "30", "--name", "R07"];

/// Tests of six days, and a production log after them.
fn recordings(workshop: &Workshop) -> Vec<PathBuf> {
    let scara = format!("{}/config/robots/scara.toml", env!("CARGO_MANIFEST_DIR"));
    let robot = [&SHAPE[..], &["--robot", &scara]].concat();
    let tests = workshop.simulate("made", &[&robot[..], &["--runs", "6"]].concat());
    let later = ["--start", "2026-01-10T18:00:00Z", "--seed", "5", "--stage-signal", "none"];
    let work = workshop.simulate("made", &[&robot[..], &later].concat());
    tests.into_iter().chain(work).collect()
}

/// The same export with a clock that began `seconds` earlier; times keep all digits.
fn with_clock(export: &str, seconds: u64) -> String {
    let mut lines = export.split_inclusive('\n');
    let header = lines.next().expect("a header").to_owned();
    assert!(header.starts_with("time,"), "{header}");
    lines.fold(header, |text, line| {
        let (time, rest) = line.split_once(',').expect("a time");
        let (whole, decimals) = time.split_once('.').unwrap_or((time, "0"));
        let whole = whole.parse::<u64>().expect("seconds") + seconds;
        text + &format!("{whole}.{decimals},{rest}")
    })
}

/// All rows of all views, in a fixed order within each.
fn rows(workshop: &Workshop) -> String {
    let database = workshop.path("armwatch.db");
    let views = query(&database, "SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name");
    assert!(views.len() > 15, "{views:?}");
    let mut dump = String::new();
    for view in views.into_iter().filter(|view| !OF_DEEDS.contains(&view.as_str())) {
        let columns = query(&database, &format!("SELECT name FROM pragma_table_info('{view}')"));
        let compared: Vec<String> = columns
            .iter()
            .filter(|column| !OF_THE_BYTES.contains(&column.as_str()))
            .map(|column| format!("quote(\"{column}\")"))
            .collect();
        let mut rows = query(&database, &format!("SELECT {} FROM \"{view}\"", compared.join(", ")));
        rows.sort_unstable();
        dump += &format!("# {view}\n{}\n", rows.join("\n"));
    }
    dump
}

#[test]
fn a_clock_that_does_not_begin_at_zero_changes_no_row_of_any_view() {
    let maker = small::workshop();
    let recordings = recordings(&maker);
    let dumps = [0, 36_000, 1_700_000_000].map(|seconds| {
        let workshop = small::watching_work();
        for path in &recordings {
            let export = fs::read_to_string(path).expect("an export");
            let name = path.file_name().expect("a name").to_str().expect("text");
            fs::write(workshop.inbox(name), with_clock(&export, seconds)).expect("written");
        }
        workshop.stdout(&["ingest", "inbox"], 0);
        // the compared rows exist
        for (sql, least) in [
            ("SELECT count(*) FROM runs WHERE status = 'complete'", 7),
            ("SELECT count(*) FROM warmup_fits WHERE model <> 'constant'", 1),
            ("SELECT count(*) FROM run_friction_index", 1),
            ("SELECT count(*) FROM production_checks WHERE reference_run_id = 6", 1),
        ] {
            let found = workshop.number(sql);
            assert!(found >= least, "{sql}: {found}");
        }
        rows(&workshop)
    });
    for (dump, clock) in dumps[1..].iter().zip(["36,000 s", "1.7e9 s"]) {
        assert_alike(dump, &dumps[0], clock);
    }
}
