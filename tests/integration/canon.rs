//! All that users see of a database, made comparable between databases that were filled in another order.

use std::path::Path;

use crate::support::query;

/// Every row of every public view, sorted. Runs are named by robot, export and content instead of their number,
/// and anomalies and faults have no number: these follow the order in which files come to their turn. Left out is also
/// how often and when a fault was met: that tells what the program went through, not what it concludes.
pub fn canonical_dump(database: &Path) -> String {
    let mut dump = String::new();
    for view in query(database, "SELECT name FROM sqlite_schema WHERE type = 'view' ORDER BY name") {
        let mut rows = query(database, &canonical_select(database, &view));
        rows.sort_unstable();
        dump.push_str(&format!("# {view}\n{}\n", rows.join("\n")));
    }
    dump
}

fn canonical_select(database: &Path, view: &str) -> String {
    let columns = query(database, &format!("SELECT name FROM pragma_table_info('{view}')"));
    let of_history = |column: &str| {
        view == "quarantine" && ["tries", "first_at", "last_at", "retry_asked_at"].contains(&column)
    };
    let numbers = ["anomaly_id", "fault_id"];
    let compared = columns.iter().filter(|column| !numbers.contains(&column.as_str()) && !of_history(column));
    let cells = compared.map(|column| {
        if column.ends_with("run_id") {
            format!(
                "(SELECT robot || ' ' || source_name || ' ' || ifnull(content_hash, 'unfinished') FROM runs
                  WHERE runs.run_id = seen.\"{column}\")"
            )
        } else if view == "runs" && column == "reason" {
            "replace(reason, 'by run ' || superseded_by_run_id || ':', 'by its successor:')".to_owned()
                + " AS without_number, iif(superseded_by_run_id IS NULL, reason, '')"
        } else if column == "source_path" {
            // below the folder of the test
            let folder = database.parent().unwrap_or(Path::new("")).display();
            format!("replace(seen.source_path, '{folder}/', '')")
        } else {
            // exact also for numbers, and no cell runs into the next one
            format!("quote(seen.\"{column}\")")
        }
    });
    format!("SELECT {} FROM \"{view}\" AS seen", cells.collect::<Vec<_>>().join(", "))
}

/// Asserts that SQLite finds nothing wrong with the file and that no row points to one that is not there.
pub fn assert_sound(database: &Path, of: &str) {
    assert_eq!(query(database, "PRAGMA integrity_check"), ["ok"], "{of}");
    assert_eq!(query(database, "PRAGMA foreign_key_check"), [""; 0], "{of}");
}
