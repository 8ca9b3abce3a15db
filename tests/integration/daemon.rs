//! The daemon as a process: it stores new files, and stops on request. The effect of kills is in `crash`.

use std::io::Write;

use crate::bad_input::decompressed;
use crate::support::{REFERENCE_NAME, Workshop, assert_alike, wait_until};

const COMPLETE_RUNS: &str = "SELECT COUNT(*) FROM runs WHERE status = 'complete'";

#[test]
fn exports_that_appear_are_taken_and_a_stop_is_clean() {
    let workshop = Workshop::new();
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    workshop.add_reference("inbox");
    workshop.wait_for(COMPLETE_RUNS, 1);
    daemon.stop();
    assert!(!workshop.path("armwatch.db-wal").exists(), "the log was not taken into the database");
}

#[test]
fn an_interrupt_stops_it_too() {
    let workshop = Workshop::new();
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    daemon.signal("INT");
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn a_file_that_is_still_written_is_complete_only_once_it_stands_still() {
    let workshop = Workshop::new();
    workshop.set("settle_s", "3");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    let text = decompressed();
    let mut file = std::fs::File::create(workshop.inbox("R00_20260105_0847.csv")).expect("an export");
    // each part is seen long before the file would have settled; cuts inside lines
    for part in text.as_bytes().chunks(text.len() / 12 + 1) {
        file.write_all(part).expect("written");
        file.flush().expect("flushed");
        workshop.wait_for_a_look();
        assert_eq!(workshop.query(COMPLETE_RUNS), ["0"]);
    }
    drop(file);
    workshop.wait_for(COMPLETE_RUNS, 1);
    assert_eq!(workshop.query("SELECT status, rows, cycles FROM runs"), ["complete|42545|5"]);
    daemon.stop();
}

#[test]
fn a_broken_export_does_not_hold_up_the_others() {
    let workshop = Workshop::new();
    std::fs::write(workshop.inbox("AA_20260101_0000.csv"), "time,pos_1\n1,2\n").expect("an export");
    let daemon = workshop.daemon();
    workshop.add_reference("inbox");
    workshop.wait_for(COMPLETE_RUNS, 1);
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'quarantined'", 1);
    daemon.stop();
}

#[test]
fn a_stop_in_the_middle_of_a_run_is_continued() {
    let calm = Workshop::new();
    let shape = ["--cycles", "8", "--warming-s", "5", "--name", "A"];
    calm.simulate("inbox", &shape);
    calm.stdout(&["ingest", "inbox"], 0);

    let stopped = Workshop::new();
    stopped.simulate("inbox", &shape);
    let mut stops = 0;
    while stopped.query(COMPLETE_RUNS) != ["1"] {
        let daemon = stopped.daemon();
        let before = stopped.number("SELECT COUNT(*) FROM cycles");
        let has_more = || {
            stopped.number("SELECT COUNT(*) FROM cycles") > before || stopped.query(COMPLETE_RUNS) == ["1"]
        };
        wait_until(has_more, || format!("after {stops} stops no cycle more than {before}"));
        daemon.stop();
        stops += 1;
        assert!(stops < 20, "no headway");
    }
    assert_alike(&stopped.dump(), &calm.dump(), "after stops");
}

#[test]
fn the_same_export_twice_in_the_folder_is_one_run() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    std::fs::copy(workshop.inbox(REFERENCE_NAME), workshop.inbox("R07_20260105_0847.csv.gz"))
        .expect("a copy");
    let daemon = workshop.daemon();
    workshop.wait_for(COMPLETE_RUNS, 1);
    workshop.wait_until_idle();
    // both files were read, so the second made no run
    assert_eq!(workshop.query("SELECT COUNT(*) FROM source_file"), ["2"]);
    daemon.stop();
    assert_eq!(workshop.query("SELECT robot, cycles FROM runs"), ["R00|5"]);
}

#[test]
fn a_second_daemon_on_the_database_is_refused_and_the_first_goes_on() {
    let workshop = Workshop::new();
    let first = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    // the claim is made shortly after the schema
    workshop.wait_for_a_look();
    let said = workshop.stderr(&["run"], 74);
    let first_one = format!("another armwatch daemon (process {})", first.child.id());
    assert!(said.contains(&first_one) && said.contains("armwatch.db"), "{said}");
    workshop.add_reference("inbox");
    workshop.wait_for(COMPLETE_RUNS, 1);
    first.stop();
}

#[test]
fn a_daemon_that_starts_again_knows_its_files_and_notices_changed_ones() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    let daemon = workshop.daemon();
    workshop.wait_for(COMPLETE_RUNS, 1);
    workshop.wait_for("SELECT COUNT(*) FROM source_file", 1);
    daemon.stop();
    // another recording under the same name
    let shorter: Vec<String> = decompressed().lines().take(1 + 2 * 8509).map(str::to_owned).collect();
    std::fs::remove_file(workshop.inbox(REFERENCE_NAME)).expect("removed");
    std::fs::write(workshop.inbox(REFERENCE_NAME.trim_end_matches(".gz")), shorter.join("\n") + "\n")
        .expect("written");
    let daemon = workshop.daemon();
    workshop.wait_for(COMPLETE_RUNS, 2);
    daemon.stop();
    assert_eq!(workshop.query("SELECT cycles FROM runs ORDER BY run_id"), ["5", "2"]);
}
