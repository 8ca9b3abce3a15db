//! The public content of a database: every row of every view of the schema, in a form for comparisons with another
//! database.

use std::path::Path;

use crate::support::{Workshop, query};

/// A column that may differ between two databases of the same exports.
struct Differing {
    view: &'static str,
    column: &'static str,
    reason: &'static str,
}

/// Columns that depend on the machine and the history of the program, not on the recordings.
const OF_THE_MACHINE: [Differing; 4] = [
    Differing { view: "quarantine", column: "tries", reason: "counts how often the file was read" },
    Differing { view: "quarantine", column: "first_at", reason: "time of the machine's clock" },
    Differing { view: "quarantine", column: "last_at", reason: "time of the machine's clock" },
    Differing { view: "quarantine", column: "retry_asked_at", reason: "time of the machine's clock" },
];

/// Numbers in the order of reading the files; those of runs are replaced instead.
const OF_THE_ORDER: [Differing; 2] = [
    Differing { view: "anomalies", column: "anomaly_id", reason: "counts on with each conclusion" },
    Differing { view: "quarantine", column: "fault_id", reason: "counts on with each attempt to read" },
];

/// The public views, by name, except `deliveries`: its rows depend on the daemon and its receivers.
pub fn views(database: &Path) -> Vec<String> {
    query(
        database,
        "SELECT name FROM sqlite_schema WHERE type = 'view' AND name <> 'deliveries' ORDER BY name",
    )
}

/// Views of actions of the program and of people, which do not follow from exports. Two databases of the same exports
/// may differ in them, for example if a test arrived late in one of them.
pub const OF_DEEDS: [&str; 3] = ["anomaly_history", "baseline_changes", "maintenance_log"];

fn columns(database: &Path, view: &str) -> Vec<String> {
    query(database, &format!("SELECT name FROM pragma_table_info('{view}') ORDER BY cid"))
}

fn lists(differing: &[Differing], view: &str, column: &str) -> bool {
    differing.iter().any(|one| (one.view, one.column) == (view, column))
}

/// Every row of every public view, sorted, except for columns that depend on the machine.
pub fn dump(database: &Path) -> String {
    rows(database, |view, column| {
        (!lists(&OF_THE_MACHINE, view, column)).then(|| format!("quote(seen.\"{column}\")"))
    })
}

/// Like [`dump`], comparable between databases that were filled in another order: runs are named by robot, export and
/// content instead of their number, and anomalies and faults have no number.
pub fn canonical_dump(database: &Path) -> String {
    rows(database, |view, column| {
        if lists(&OF_THE_MACHINE, view, column) || lists(&OF_THE_ORDER, view, column) {
            None
        } else if column.ends_with("run_id") {
            Some(format!(
                "(SELECT robot || ' ' || source_name || ' ' || ifnull(content_hash, 'unfinished') FROM runs
                  WHERE runs.run_id = seen.\"{column}\")"
            ))
        } else if column == "source_path" {
            // every test has a separate folder
            Some("quote(substr(seen.source_path, instr(seen.source_path, '/inbox/') + 1))".to_owned())
        } else if (view, column) == ("runs", "reason") {
            // the reason of a superseded run names its successor by number
            let unnumbered =
                "replace(seen.reason, 'by run ' || seen.superseded_by_run_id || ':', 'by its successor:')";
            Some(format!("quote(iif(seen.superseded_by_run_id IS NULL, seen.reason, {unnumbered}))"))
        } else {
            Some(format!("quote(seen.\"{column}\")"))
        }
    })
}

/// As [`dump`], comparable between exports of one recording in files of several kinds: without the columns that describe the
/// file.
pub fn dump_of_recording(database: &Path) -> String {
    const OF_THE_FILE: [&str; 3] = ["source_name", "source_path", "content_hash"];
    rows(database, |view, column| {
        let is_left_out = lists(&OF_THE_MACHINE, view, column) || OF_THE_FILE.contains(&column);
        (!is_left_out).then(|| format!("quote(seen.\"{column}\")"))
    })
}

/// A dump without the rows of a view.
pub fn without(dump: &str, view: &str) -> String {
    let heading = format!("# {view}\n");
    let (before, after) = dump.split_once(&heading).unwrap_or_else(|| panic!("no view {view}"));
    let rest = after.find("# ").map_or("", |next| &after[next..]);
    before.to_owned() + rest
}

/// All rows with the cells that `cell` selects. They are quoted, so that cells are separate and numbers are exact.
fn rows(database: &Path, cell: impl Fn(&str, &str) -> Option<String>) -> String {
    let mut dump = String::new();
    for view in views(database).into_iter().filter(|view| !OF_DEEDS.contains(&view.as_str())) {
        let cells: Vec<String> =
            columns(database, &view).iter().filter_map(|column| cell(&view, column)).collect();
        let mut rows = query(database, &format!("SELECT {} FROM \"{view}\" AS seen", cells.join(", ")));
        rows.sort_unstable();
        dump.push_str(&format!("# {view}\n{}\n", rows.join("\n")));
    }
    dump
}

/// Asserts that SQLite finds no error in the file and that no row points to a missing one.
pub fn assert_sound(database: &Path, of: &str) {
    assert_eq!(query(database, "PRAGMA integrity_check"), ["ok"], "{of}");
    assert_eq!(query(database, "PRAGMA foreign_key_check"), [""; 0], "{of}");
}

#[test]
fn what_is_not_compared_is_a_column_of_the_schema() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    let database = workshop.path("armwatch.db");
    assert!(views(&database).len() > 20, "{:?}", views(&database));
    assert!(OF_DEEDS.iter().all(|view| views(&database).iter().any(|name| name == view)), "one is gone");
    for Differing { view, column, reason } in OF_THE_MACHINE.iter().chain(&OF_THE_ORDER) {
        let columns = columns(&database, view);
        assert!(columns.iter().any(|name| name == column), "{view}.{column} ({reason}) is gone: {columns:?}");
    }
}
