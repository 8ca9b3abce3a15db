//! The optional archive, and the limited effect of large exports on small ones.

use std::fs;

use crate::small;
use crate::support::{REFERENCE_NAME, Workshop, peak_kb, text, wait_until};

const COMPLETE_RUNS: &str = "SELECT count(*) FROM runs WHERE status = 'complete'";

#[test]
fn a_stored_export_is_moved_and_a_quarantined_one_stays() {
    let workshop = Workshop::new();
    workshop.set("archive", "\"archive\"");
    fs::create_dir(workshop.inbox("cell 7")).expect("a folder");
    let bytes = fs::read(workshop.add_reference("inbox/cell 7")).expect("the export");
    fs::write(workshop.inbox("Bad_20260105_0847.csv"), "time,pos_1\n0,1\n").expect("an export");
    let daemon = workshop.daemon();
    let target = workshop.path("archive/cell 7").join(REFERENCE_NAME);
    let source = workshop.inbox("cell 7").join(REFERENCE_NAME);
    wait_until(|| target.exists() && !source.exists(), || "the export is not moved".into());
    workshop.wait_for("SELECT count(*) FROM quarantine WHERE state = 'open'", 1);
    assert_eq!(fs::read(&target).expect("the copy"), bytes);
    // a copy of a stored export is moved too, like one left by a crash between copy and removal
    fs::write(&source, &bytes).expect("again");
    wait_until(|| !source.exists(), || "the copy is not moved".into());
    daemon.stop();
    assert!(workshop.inbox("Bad_20260105_0847.csv").exists());
    assert_eq!(workshop.query(COMPLETE_RUNS), ["1"]);
    // commands that read rows again find them in the archive
    let run = workshop.query("SELECT run_id FROM runs WHERE status = 'complete'").remove(0);
    let rows = workshop.stdout(&["torque", "--run", &run, "--cycle", "1"], 0);
    assert!(rows.lines().count() > 1000, "{}", rows.lines().count());
}

/// After a power failure, or with an older copy of the database restored, the archive has exports that the database
/// lacks.
#[test]
fn exports_in_the_archive_that_the_database_does_not_know_are_taken_at_start() {
    let workshop = small::workshop();
    workshop.set("archive", "\"archive\"");
    let exports = [small::export("A", 1, 5), small::export("A", 2, 6)];
    let take = |export: &small::Export, complete: i64| {
        let daemon = workshop.daemon();
        let source = workshop.inbox(&export.name);
        fs::write(&source, &export.bytes).expect("an export");
        workshop.wait_for(COMPLETE_RUNS, complete);
        wait_until(|| !source.exists(), || "the export is not moved".to_owned());
        daemon.stop();
    };
    take(&exports[0], 1);
    let database = workshop.path("armwatch.db");
    fs::copy(&database, workshop.path("earlier.db")).expect("a copy");
    take(&exports[1], 2);
    // an export with the name of another, with its hash in the name
    let other = small::export("A", 3, 7).named(&exports[1].name.replace("20260106", "20260107"));
    fs::create_dir_all(workshop.path("archive")).expect("a folder");
    let begin = blake3::hash(&other.bytes).to_hex();
    let name = other.name.replace(".csv", &format!("~{}.csv", &begin[..8]));
    fs::write(workshop.path("archive").join(&name), &other.bytes).expect("an export");
    fs::rename(workshop.path("earlier.db"), &database).expect("put back");
    let daemon = workshop.daemon();
    workshop.wait_for(COMPLETE_RUNS, 3);
    workshop.wait_for_conclusions();
    daemon.stop();
    assert_eq!(workshop.query("SELECT DISTINCT robot FROM runs"), ["A"]);
    assert_eq!(workshop.query("SELECT count(*) FROM runs WHERE source_name LIKE '%~%'"), ["0"]);
    assert!(workshop.log().contains("in the archive, but not in the database"), "{}", workshop.log());
    // nothing is taken twice
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    daemon.stop();
    assert_eq!(workshop.query("SELECT count(*) FROM runs"), ["3"]);
}

#[test]
fn an_archive_in_a_watched_folder_is_refused() {
    let workshop = Workshop::new();
    workshop.set("archive", "\"inbox/archive\"");
    let told = workshop.stdout(&["config", "check"], 2);
    assert!(told.contains("watch.archive") && told.contains("watched folder inbox"), "{told}");
}

#[test]
fn large_exports_do_not_hold_up_small_ones_of_other_robots() {
    let workshop = Workshop::new();
    let made = |robot: &str, cycles: &str| {
        let of = ["--warming-s", "5", "--name", robot, "--cycles", cycles];
        let files = workshop.simulate("inbox", &of);
        fs::metadata(&files[0]).expect("a file").len()
    };
    // the large ones are first by name
    let large = ["A", "B"].map(|robot| made(robot, "12"));
    let small = ["C", "D", "E"].map(|robot| made(robot, "1"));
    assert!(large.iter().all(|bytes| small.iter().all(|small| small < bytes)), "{small:?} {large:?}");
    let limits = format!("[limits]\nbacklog_files = 1\nlarge_file_bytes = {}\n\n", large[0].min(large[1]));
    workshop.configure(|config| limits + &config);
    let daemon = workshop.daemon();
    let small = format!("{COMPLETE_RUNS} AND robot IN ('C', 'D', 'E')");
    workshop.wait_for(&small, 3);
    // the second large one is not read by then
    assert!(workshop.number(COMPLETE_RUNS) <= 4, "{:?}", workshop.query("SELECT robot, status FROM runs"));
    daemon.stop();
}

#[test]
fn exports_that_wait_for_room_come_to_the_same_results() {
    let free = Workshop::new();
    let bounded = Workshop::new();
    let limits = "[limits]\nbacklog_files = 4\nlarge_file_bytes = 1\ncycles_max_bytes = 7500000\n\n";
    bounded.configure(|config| format!("{limits}{config}"));
    let results = [&free, &bounded].map(|workshop| {
        for robot in ["A", "B", "C", "D"] {
            workshop.simulate("inbox", &["--warming-s", "5", "--name", robot, "--cycles", "3", "--rate-hz", "100"]);
        }
        let daemon = workshop.daemon();
        workshop.wait_for(COMPLETE_RUNS, 4);
        daemon.stop();
        workshop.query(
            "SELECT robot, cycle, joint, parameter, value FROM cycle_parameters ORDER BY robot, cycle, joint, parameter",
        )
    });
    assert_eq!(results[0].len(), 4 * 3 * 64);
    assert_eq!(results[0], results[1]);
    let said = |workshop: &Workshop| workshop.log().contains("limits.cycles_max_bytes = 7500000");
    assert!(!said(&free) && said(&bounded), "{}", bounded.log());
}

#[test]
fn bounds_that_are_configured_hold_and_say_their_key() {
    let workshop = Workshop::new();
    let path = workshop.path("armwatch.toml");
    let config = fs::read_to_string(&path).expect("the configuration");
    workshop.add_reference("inbox");
    for (limit, key) in [
        ("export_max_bytes = 1000000", "limits.export_max_bytes"),
        ("cycle_max_rows = 1000", "limits.cycle_max_rows"),
    ] {
        fs::write(&path, format!("[limits]\n{limit}\n\n{config}")).expect("it");
        let told = workshop.stdout(&["ingest", "inbox"], 1);
        assert!(told.contains(key), "{told}");
    }
    fs::write(&path, format!("[limits]\nbacklog_files = 0\nexport_max_bytes = -1\n\n{config}")).expect("it");
    let told = workshop.run(&["config", "check"]);
    assert_eq!(told.status.code(), Some(2));
    let told = text(&told.stdout);
    assert!(told.contains("limits.backlog_files") && told.contains("limits.export_max_bytes"), "{told}");
}

#[test]
#[ignore = "makes 100,000 files, or as many as ARMWATCH_FILES says"]
fn a_folder_of_very_many_files_takes_little_memory() {
    let files = std::env::var("ARMWATCH_FILES").map_or(100_000, |text| text.parse().expect("a whole number"));
    let peak = |files: u32| {
        let workshop = Workshop::new();
        for file in 0..files {
            // all of one robot, so that they are read one at a time while all are scanned
            let name = format!(
                "R00_20260105_{:02}{:02}{:02}_{file}.csv",
                file / 3600 % 24,
                file / 60 % 60,
                file % 60
            );
            fs::write(workshop.inbox(&name), format!("time,pos_1\n0,{file}\n")).expect("an export");
        }
        let daemon = workshop.daemon();
        // by then every file was scanned twice and is queued
        workshop.wait_for("SELECT count(*) >= 20 FROM quarantine", 1);
        let peak = peak_kb(daemon.child.id()).expect("its peak");
        daemon.stop();
        peak
    };
    let (few, many) = (peak(100), peak(files));
    // two paths, two times and a queue place per file are half a kilobyte; a scan holds them a second time
    let by_file = (many.saturating_sub(few)) as f64 * 1024.0 / f64::from(files);
    assert!(by_file < 1500.0, "{by_file} bytes a file, {few} kB for 100 files, {many} kB for {files}");
}
