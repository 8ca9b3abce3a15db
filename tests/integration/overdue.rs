//! Robots that no longer send tests.

use std::fs;
use std::path::Path;

use jiff::{SignedDuration, Timestamp};

use crate::support::Workshop;

const OVERDUE: &str = "SELECT count(*) FROM fleet_health WHERE status = 'overdue'";
const COMPLETE: &str = "SELECT count(*) FROM runs WHERE status = 'complete'";

/// Contents of seven tests.
fn contents(workshop: &Workshop) -> Vec<Vec<u8>> {
    let shape = ["--runs", "7", "--cycles", "1", "--warming-s", "0", "--name", "R01"];
    let made = workshop.simulate("made", &shape);
    made.iter().map(|path| fs::read(path).expect("an export")).collect()
}

/// Puts a test that began at `start` into the watched folder.
fn put(folder: &Path, start: Timestamp, content: &[u8]) {
    let name = format!("R01_{}_test.csv", start.strftime("%Y%m%d_%H%M%S"));
    fs::write(folder.join(name), content).expect("written");
}

#[test]
#[ignore = "waits half a minute for a test that does not come"]
fn a_daemon_says_once_that_a_robot_is_overdue_and_a_new_test_ends_it() {
    let workshop = Workshop::new();
    let contents = contents(&workshop);
    let daemon = workshop.daemon();
    let now = Timestamp::now();
    for (place, content) in (1..).zip(&contents[..6]) {
        put(&workshop.path("inbox"), now - SignedDuration::from_secs(8 * (6 - place)), content);
    }
    workshop.wait_for(COMPLETE, 6);
    workshop.wait_for_conclusions();
    assert_eq!(workshop.number(OVERDUE), 0);
    assert_eq!(workshop.number("SELECT count(*) FROM fleet_health WHERE expected_by IS NOT NULL"), 6);
    workshop.wait_for(OVERDUE, 6);
    let reason = "SELECT DISTINCT reason LIKE 'no test since that of 20%Z; the next was expected by 20%Z' FROM fleet_health";
    assert_eq!(workshop.query(reason), ["1"]);

    put(&workshop.path("inbox"), Timestamp::now(), &contents[6]);
    workshop.wait_for(COMPLETE, 7);
    workshop.wait_for(OVERDUE, 0);
    daemon.signal("TERM");
    daemon.end();
    let said = workshop.log().lines().filter(|line| line.contains("overdue: no test")).count();
    assert_eq!(said, 1, "{}", workshop.log());
}

#[test]
fn old_exports_are_never_overdue() {
    let workshop = Workshop::new();
    let contents = contents(&workshop);
    let daemon = workshop.daemon();
    let month_ago = Timestamp::now() - SignedDuration::from_hours(30 * 24);
    for (day, content) in (0..).zip(&contents[..6]) {
        put(&workshop.path("inbox"), month_ago + SignedDuration::from_hours(24 * day), content);
    }
    workshop.wait_for(COMPLETE, 6);
    workshop.wait_for_conclusions();
    daemon.signal("TERM");
    daemon.end();
    assert_eq!(workshop.query("SELECT watched, overdue FROM robot"), ["0|0"]);
    assert_eq!(workshop.number("SELECT count(*) FROM fleet_health WHERE expected_by IS NOT NULL"), 6);
}
