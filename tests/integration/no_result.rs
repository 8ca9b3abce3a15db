//! Tests with all cycles refused: never reported as healthy.

use std::fs;
use std::path::Path;

use crate::support::Workshop;

const STATUS: &str = "SELECT DISTINCT status, last_run_at, last_result_at FROM fleet_health";

/// Six healthy tests of R01, ingested, and the next healthy one, not ingested.
pub fn watched() -> (Workshop, String) {
    let workshop = Workshop::new();
    let shape = ["--runs", "7", "--cycles", "2", "--warming-s", "0", "--name", "R01", "--seed", "11"];
    let mut files = workshop.simulate("made", &shape);
    files.sort();
    let next = fs::read_to_string(files.pop().expect("seven")).expect("an export");
    for file in &files {
        let name = file.file_name().expect("a name");
        fs::rename(file, workshop.path("inbox").join(name)).expect("moved");
    }
    let out = workshop.stdout(&["ingest", "inbox"], 0);
    assert!(out.contains("\n6 stored, 0 known, 0 quarantined, 0 without result; "), "{out}");
    assert_eq!(workshop.query("SELECT DISTINCT status FROM fleet_health"), ["ok"]);
    (workshop, next)
}

/// Writes an export with the cells of some columns changed.
pub fn altered(export: &str, path: &Path, alter: impl Fn(&str, &str) -> Option<String>) {
    let mut lines = export.lines();
    let header = lines.next().expect("a header");
    let columns: Vec<&str> = header.split(',').collect();
    let changed = |line: &str| {
        let cells = line
            .split(',')
            .zip(&columns)
            .map(|(cell, name)| alter(name, cell).unwrap_or_else(|| cell.into()));
        cells.collect::<Vec<_>>().join(",")
    };
    let rows: Vec<String> = std::iter::once(header.to_owned()).chain(lines.map(changed)).collect();
    fs::write(path, rows.join("\n") + "\n").expect("written");
}

#[test]
fn a_stuck_channel_leaves_every_joint_unknown_and_is_named() {
    let (workshop, next) = watched();
    let stuck = workshop.path("R01_20260214_0800_stuck.csv");
    altered(&next, &stuck, |name, _| (name == "trq_4").then(|| "0.0".into()));
    let out = workshop.stdout(&["ingest", stuck.to_str().expect("a path")], 1);
    assert!(out.contains("joint 4: the torque signal stands at 0"), "{out}");
    assert!(out.contains("no result: 2 of 2 cycles were refused"), "{out}");
    assert!(out.contains("\n1 stored, 0 known, 0 quarantined, 1 without result; "), "{out}");

    assert_eq!(
        workshop.query(STATUS),
        ["unknown|2026-02-14T08:00:00.000Z|2026-01-10T08:47:00.000Z"],
        "what is known is older than the latest test"
    );
    assert_eq!(workshop.number("SELECT count(*) FROM fleet_health WHERE friction_index IS NULL"), 6);
    let reason = "SELECT count(*) FROM fleet_health WHERE reason LIKE 'the latest test gave no result: all 2 cycles were \
                  refused: joint 4: the torque signal stands at 0 %known last: friction index %'";
    assert_eq!(workshop.number(reason), 6);
    let anomaly = "SELECT joint, kind, quantity, severity, state, run_id, cycle FROM anomalies";
    assert_eq!(workshop.query(anomaly), ["4|sensor|torque_signal|warning|open|7|1"]);
    let message = workshop.query("SELECT message FROM anomalies").remove(0);
    assert!(message.contains("joint 4: the torque signal stands at 0"), "{message}");

    // six joints with one reason are one line, whatever the earlier knowledge about each
    let status = workshop.stdout(&["status"], 0);
    let told = "R01: all joints: the latest test gave no result: all 2 cycles were refused: joint 4: the torque signal";
    assert!(status.contains(told), "{status}");
    assert_eq!(status.matches("the latest test gave no result").count(), 1, "{status}");
    assert!(!status.contains("known last"), "{status}");

    // the report has that reason in its conclusions and in its list of unknown joints
    workshop.stdout(&["report", "R01", "-o", "report.html"], 0);
    let page = fs::read_to_string(workshop.path("report.html")).expect("a page");
    assert_eq!(page.matches("The latest test gave no result: all 2 cycles were refused").count(), 2);
    assert!(page.contains("Known last: friction index ") && page.contains("All joints"));
    assert!(page.contains("Run 7, the latest test, has no parameters"));
    for wrong in ["There is no baseline of earlier tests", "- where - is usual", "furthest out -"] {
        assert!(!page.contains(wrong), "{wrong}");
    }

    // the same export again is still refused
    let again = workshop.stdout(&["ingest", stuck.to_str().expect("a path")], 1);
    assert!(again.contains("known") && again.contains("joint 4: the torque signal stands at 0"), "{again}");

    // a test with results ends the anomaly
    let healthy = workshop.path("R01_20260215_0800_healthy.csv");
    fs::write(&healthy, &next).expect("written");
    workshop.stdout(&["ingest", healthy.to_str().expect("a path")], 0);
    assert_eq!(workshop.query(STATUS), ["ok|2026-02-15T08:00:00.000Z|2026-02-15T08:00:00.000Z"]);
    assert_eq!(workshop.query("SELECT DISTINCT state FROM anomalies"), ["resolved"]);
}

#[test]
fn degrees_read_as_radians_leave_every_joint_unknown() {
    let (workshop, next) = watched();
    let degrees = workshop.path("R01_20260214_0800_degrees.csv");
    altered(&next, &degrees, |name, cell| {
        let turned = name.starts_with("pos_") || name.starts_with("vel_");
        turned.then(|| cell.parse::<f64>().expect("a number").to_degrees().to_string())
    });
    workshop.stdout(&["ingest", degrees.to_str().expect("a path")], 1);
    assert_eq!(workshop.query("SELECT DISTINCT status FROM fleet_health"), ["unknown"]);
    let named = "SELECT count(*) > 0 FROM anomalies
                 WHERE kind IN ('sensor', 'accuracy') AND state = 'open' AND severity = 'warning'";
    assert_eq!(
        workshop.number(named),
        1,
        "{:?}",
        workshop.query("SELECT joint, kind, message FROM anomalies")
    );
}

#[test]
fn a_run_with_one_bad_cycle_is_judged_by_the_others() {
    let (workshop, next) = watched();
    let partly = workshop.path("R01_20260214_0800_partly.csv");
    // the first half of the recording is its first cycle
    let rows: Vec<&str> = next.lines().collect();
    let (first, second) = rows.split_at(rows.len() / 2);
    altered(&first.join("\n"), &partly, |name, _| (name == "trq_4").then(|| "0.0".into()));
    let stuck = fs::read_to_string(&partly).expect("an export");
    fs::write(&partly, stuck + &second.join("\n") + "\n").expect("written");
    let out = workshop.stdout(&["ingest", partly.to_str().expect("a path")], 0);
    assert!(out.contains("cycle 1 without parameters: joint 4: the torque signal"), "{out}");
    let shown = workshop.query("SELECT status, reason FROM fleet_health");
    assert_eq!(workshop.query("SELECT DISTINCT status FROM fleet_health"), ["ok"], "{shown:?}");
    let told = "SELECT count(*) FROM fleet_health
                WHERE reason LIKE '1 of 2 cycles of the latest test were refused: joint 4: %'";
    assert_eq!(workshop.number(told), 6, "{shown:?}");
    assert_eq!(workshop.number("SELECT count(*) FROM anomalies"), 0);
}

#[test]
fn a_robot_whose_latest_export_is_in_quarantine_is_unknown() {
    let (workshop, next) = watched();
    let broken = workshop.path("R01_20260214_0800_broken.csv");
    fs::write(&broken, next.replacen("trq_4", "torque_four", 1)).expect("written");
    workshop.stdout(&["ingest", broken.to_str().expect("a path")], 1);
    let told = "SELECT count(*) FROM fleet_health
                WHERE status = 'unknown' AND reason LIKE 'the latest export, R01_20260214_0800_broken.csv, is in quarantine: %trq_4%'";
    assert_eq!(workshop.number(told), 6, "{:?}", workshop.query("SELECT status, reason FROM fleet_health"));
    // an old export changes nothing
    let workshop = watched().0;
    let old = workshop.path("R01_20251224_0800_broken.csv");
    fs::write(&old, "time\n0\n").expect("written");
    workshop.stdout(&["ingest", old.to_str().expect("a path")], 1);
    assert_eq!(workshop.query("SELECT DISTINCT status FROM fleet_health"), ["ok"]);
}
