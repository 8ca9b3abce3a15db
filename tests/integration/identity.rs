//! Identity of recordings and files, and the settings that stored cycles depend on.

use std::fs;

use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::small::{self, Export, export, work};
use crate::support::{Daemon, Workshop, assert_alike, text};

const RUNS: &str = "SELECT source_name, kind, status FROM runs ORDER BY run_id";

/// Writes a file into the folder and ingests it; returns the standard error.
fn take(workshop: &Workshop, export: &Export) -> String {
    workshop.add(export);
    let file = workshop.inbox(&export.name).display().to_string();
    workshop.stderr(&["ingest", &file], 0)
}

fn execute(workshop: &Workshop, sql: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(workshop.path("armwatch.db"));
        let mut connection = SqliteConnection::connect_with(&options).await.expect("a connection");
        sqlx::query(sqlx::AssertSqlSafe(sql)).execute(&mut connection).await.expect("done");
        connection.close().await.expect("closed");
    });
}

#[test]
fn a_log_of_work_that_begins_with_a_test_does_not_take_its_place() {
    let test = export("A", 1, 5);
    let work = work("A", 2, 5);
    let work = work.named(&work.name.replace("_1400_", "_0847_"));
    assert_ne!(test.name, work.name);
    for of in [[&test, &work], [&work, &test]] {
        let workshop = small::watching_work();
        let said: String = of.iter().map(|export| take(&workshop, export)).collect();
        let mut runs = workshop.query(RUNS);
        runs.sort();
        let mut expected =
            [format!("{}|test|complete", test.name), format!("{}|production|complete", work.name)];
        expected.sort();
        assert_eq!(runs, expected);
        assert!(!said.contains("replaces run"), "{said}");
    }
}

#[test]
fn two_tests_of_a_day_stand_where_names_say_no_time() {
    let workshop = small::workshop();
    let pattern = "[recognition]\nfile_name = '^(?<robot>\\w+?)_(?<date>\\d{8})_.*$'\n\n";
    workshop.configure(|config| format!("{pattern}{config}"));
    take(&workshop, &export("A", 1, 5).named("A_20260105_first.csv"));
    take(&workshop, &export("A", 2, 5).named("A_20260105_second.csv"));
    // the name of the first, used again
    take(&workshop, &export("A", 3, 5).named("A_20260105_first.csv"));
    assert_eq!(
        workshop.query(RUNS),
        [
            "A_20260105_first.csv|test|complete",
            "A_20260105_second.csv|test|complete",
            "A_20260105_first.csv|test|complete"
        ]
    );
}

#[test]
fn a_recording_that_takes_a_place_and_begins_otherwise_is_warned_of_and_the_other_can_be_had_back() {
    let workshop = small::workshop();
    let first = export("A", 1, 5).named("A_20260105_0847_one.csv");
    take(&workshop, &first);
    // corrected near its end
    let corrected = first.with(|text| {
        let (before, last) = text.trim_end().rsplit_once('\n').expect("rows");
        let changed = last.replacen(".0", ".1", 1);
        assert_ne!(changed, last);
        format!("{before}\n{changed}\n")
    });
    let said = take(&workshop, &corrected.named("A_20260105_0847_corrected.csv"));
    assert!(!said.contains("begins with other rows"), "{said}");
    let said = take(&workshop, &export("A", 2, 5).named("A_20260105_0847_two.csv"));
    assert!(said.contains("replaces run 2") && said.contains("begins with other rows"), "{said}");
    assert_eq!(
        workshop.query("SELECT status, superseded_by_run_id FROM runs ORDER BY run_id"),
        ["superseded|2", "superseded|3", "complete|"]
    );
    // the remedy of the warning
    take(&workshop, &corrected.named("A_20260105_0848_corrected.csv"));
    assert_eq!(
        workshop.query("SELECT status, started_at FROM runs ORDER BY run_id"),
        [
            "superseded|2026-01-05T08:47:00.000Z",
            "complete|2026-01-05T08:48:00.000Z",
            "complete|2026-01-05T08:47:00.000Z"
        ]
    );
}

#[test]
fn a_recording_without_any_result_does_not_replace_one_with_results() {
    let workshop = small::workshop();
    let good = export("A", 1, 5).named("A_20260105_0847_one.csv");
    take(&workshop, &good);
    // the drive was off: zero torque in every row
    let dead = good.with(|text| {
        let header = text.lines().next().expect("a header");
        let is_torque: Vec<bool> = header.split(',').map(|name| name.starts_with("trq_")).collect();
        let still = |line: &str| -> String {
            let cells = line.split(',').zip(&is_torque).map(|(cell, still)| if *still { "0" } else { cell });
            cells.collect::<Vec<_>>().join(",") + "\n"
        };
        format!("{header}\n{}", text.lines().skip(1).map(still).collect::<String>())
    });
    let runs = "SELECT status, superseded_by_run_id, reason FROM runs ORDER BY run_id";
    let loser = "superseded|1|does not replace run 1, which is the same recording: no cycle has a result";
    for name in ["A_20260105_0847_two.csv", "A_20260105_0847_two.csv"] {
        fs::write(workshop.inbox(name), &dead.bytes).expect("written");
        let output = workshop.run(&["ingest", "inbox"]);
        let said = text(&output.stderr);
        assert_eq!(workshop.query(runs), ["complete|1|".replace("|1|", "||"), loser.into()], "{said}");
    }
    // the same content at the path of the first, whose content is then lost
    fs::write(workshop.inbox(&good.name), dead.with(|text| format!("{text}\n")).bytes).expect("written");
    workshop.run(&["ingest", "inbox"]);
    assert_eq!(workshop.query(runs), ["complete||".into(), loser.to_owned(), loser.to_owned()]);
    // one with results supersedes it
    take(&workshop, &export("A", 2, 5).named("A_20260105_0847_three.csv"));
    let status = "SELECT status, superseded_by_run_id FROM runs ORDER BY run_id";
    assert_eq!(workshop.query(status), ["superseded|4", "superseded|1", "superseded|1", "complete|"]);
}

/// The explanation of a file before it is ingested.
fn explained(workshop: &Workshop, export: &Export) -> serde_json::Value {
    workshop.add(export);
    let file = workshop.inbox(&export.name).display().to_string();
    let out = workshop.stdout(&["explain", &file, "--json", "--quick"], 0);
    serde_json::from_str(out.trim()).expect("one object")
}

#[test]
fn explain_decides_as_ingest_does_and_writes_nothing() {
    let workshop = small::workshop();
    let first = export("A", 1, 5).named("A_20260105_0847_one.csv");
    take(&workshop, &first);
    take(&workshop, &export("A", 2, 5).named("A_20260105_0847_two.csv"));
    // superseded by a file of another name, it stays superseded
    let said = explained(&workshop, &first);
    assert_eq!((said["next"].as_str(), said["run_id"].as_i64()), (Some("nothing"), Some(1)), "{said}");
    take(&workshop, &first);
    assert_eq!(
        workshop.query("SELECT status, superseded_by_run_id FROM runs ORDER BY run_id"),
        ["superseded|2", "complete|"]
    );

    // an entry about a file that could not be read is checked again, and deleted when the file is stored
    let name = "A_20260106_0847_three.csv";
    let path = workshop.inbox(name);
    let hash = blake3::hash(path.as_os_str().as_encoded_bytes()).to_hex();
    let insert = format!(
        "INSERT INTO run (robot_id, model, started_at, source_name, source_path, source_bytes, content_hash, status,
                          reason)
         VALUES (1, '', 0, '{name}', '{}', 0, x'{hash}', 'quarantined', 'Permission denied')",
        path.display()
    );
    execute(&workshop, &insert);
    let open = "SELECT count(*) FROM runs WHERE status = 'quarantined'";
    assert_eq!(workshop.query(open), ["1"]);
    let third = export("A", 3, 6).named(name);
    let said = explained(&workshop, &third);
    assert_eq!(said["next"], "store", "{said}");
    assert_eq!(workshop.query(open), ["1"], "looking takes nothing away");
    take(&workshop, &third);
    assert_eq!(workshop.query(open), ["0"]);
}

/// Sets the length of the windows of production logs in a workshop.
fn with_windows(workshop: &Workshop, seconds: u32) {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/production.toml");
    let layout = fs::read_to_string(shipped).expect("the layout");
    let layout = layout.replace("window_s = 60.0", &format!("window_s = {seconds}.0"));
    fs::write(workshop.path("production.toml"), layout).expect("written");
    workshop.configure(|config| config.replace(shipped, "production.toml"));
}

/// Starts a daemon that has seen a file grow to `bytes`; unseen growth is read only after the file has settled.
fn begin_to_grow(workshop: &Workshop, path: &std::path::Path, bytes: &[u8]) -> Daemon {
    use std::io::Write;
    let (begin, rest) = bytes.split_at(bytes.len() / 4);
    fs::write(path, begin).expect("the beginning");
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    let mut file = fs::File::options().append(true).open(path).expect("the file");
    file.write_all(rest).expect("more of it");
    daemon
}

#[test]
fn windows_of_another_length_are_cut_from_the_start_of_a_log_that_is_half_stored() {
    let log = work("A", 1, 5);
    let fresh = small::watching_work();
    with_windows(&fresh, 35);
    take(&fresh, &log);
    let windows = fresh.number("SELECT count(*) FROM cycles");

    let workshop = small::watching_work();
    with_windows(&workshop, 10);
    workshop.set("settle_s", "60");
    let half = log.bytes.len() / 2;
    let path = workshop.inbox(&log.name);
    let daemon = begin_to_grow(&workshop, &path, &log.bytes[..half]);
    // more windows of this length than the whole log has of the other length
    workshop.wait_for(&format!("SELECT count(*) > {windows} FROM cycles"), 1);
    daemon.signal("KILL");
    daemon.end();
    with_windows(&workshop, 35);
    fs::write(&path, &log.bytes).expect("the whole log");
    fs::write(workshop.inbox(&format!("{}.done", log.name)), "").expect("a mark");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    workshop.wait_for_conclusions();
    assert_alike(&workshop.dump(), &fresh.dump(), "windows of 35 s");
    daemon.stop();
    assert!(workshop.log().contains("read from the start"), "{}", workshop.log());
}

/// A database that refuses the end of a run.
const REFUSING: &str = "CREATE TRIGGER refusing BEFORE UPDATE OF status ON run WHEN NEW.status = 'complete'
                        BEGIN SELECT RAISE(ABORT, 'no run may end'); END";

#[test]
fn a_run_whose_end_the_database_refuses_is_quarantined_and_a_retry_gets_it_out() {
    for follows in [false, true] {
        let workshop = small::workshop();
        let export = export("A", 1, 5);
        fs::write(workshop.inbox("none.txt"), "").expect("written");
        workshop.stdout(&["ingest", "inbox"], 0);
        execute(&workshop, REFUSING);
        workshop.add(&export);
        let open = "SELECT count(*) FROM quarantine WHERE state = 'open'";
        if follows {
            let daemon = workshop.daemon();
            workshop.wait_for(open, 1);
            daemon.stop();
        } else {
            workshop.stdout(&["ingest", "inbox"], 1);
        }
        let found = workshop.query("SELECT state, problem, remedy FROM quarantine");
        assert!(found[0].contains("no run may end"), "{found:?}");
        assert!(found[0].contains("armwatch quarantine retry 1"), "{found:?}");
        execute(&workshop, "DROP TRIGGER refusing");
        workshop.stdout(&["quarantine", "retry", "1"], 0);
        assert_eq!(workshop.query("SELECT status, cycles FROM runs"), ["complete|3"]);
    }
}

#[test]
fn a_stored_export_is_found_again_whatever_folder_a_command_is_called_in() {
    let workshop = small::workshop();
    workshop.add(&export("A", 1, 5));
    workshop.stdout(&["ingest", "inbox"], 0);
    let (config, database) = (workshop.path("armwatch.toml"), workshop.path("armwatch.db"));
    let text = fs::read_to_string(&config).expect("the configuration");
    fs::write(&config, text.replace("[\"inbox\"]", "[\"elsewhere\"]")).expect("written");
    let output = workshop
        .command(&["torque", "--run", "1", "--cycle", "2", "--db"])
        .arg(&database)
        .arg("--config")
        .arg(&config)
        .current_dir("/")
        .output()
        .expect("the program starts");
    assert!(output.status.success(), "{}", crate::support::text(&output.stderr));
}

/// The file's time is that of its last row, also if it was read while it was written.
#[test]
fn a_recording_whose_name_says_no_start_began_its_duration_before_its_file_was_written() {
    let export = export("A", 1, 5).named("A.csv");
    let written: std::time::SystemTime =
        std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_700_000_000);
    let starts = [false, true].map(|follows| {
        let workshop = small::workshop();
        let path = workshop.inbox(&export.name);
        let stamp = |path: &std::path::Path| {
            let file = fs::File::options().write(true).open(path).expect("the export");
            file.set_modified(written).expect("a time");
        };
        if follows {
            workshop.set("settle_s", "60");
            let half = export.bytes.len() / 2;
            let daemon = begin_to_grow(&workshop, &path, &export.bytes[..half]);
            workshop.wait_for("SELECT count(*) > 0 FROM runs WHERE status = 'streaming'", 1);
            use std::io::Write;
            let mut file = fs::File::options().append(true).open(&path).expect("the export");
            file.write_all(&export.bytes[half..]).expect("the rest");
            drop(file);
            stamp(&path);
            fs::write(workshop.inbox("A.csv.done"), "").expect("a mark");
            workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
            daemon.stop();
        } else {
            fs::write(&path, &export.bytes).expect("an export");
            stamp(&path);
            workshop.stdout(&["ingest", "inbox"], 0);
        }
        let runs = workshop.query("SELECT started_at FROM runs");
        assert_eq!(workshop.query("SELECT started_at FROM cycles WHERE cycle = 1"), runs);
        (runs, workshop.query("SELECT cycle, started_at FROM cycles ORDER BY cycle"))
    });
    assert_eq!(starts[0], starts[1]);
    let text = std::str::from_utf8(&export.bytes).expect("text");
    let last = text.lines().last().and_then(|line| line.split(',').next()).expect("a time");
    let duration: f64 = last.parse().expect("seconds");
    let started: jiff::Timestamp = starts[0].0[0].parse().expect("a time");
    let found = 1_700_000_000.0 - started.as_microsecond() as f64 * 1e-6;
    assert!((found - duration).abs() < 2e-3, "{found} {duration}");
}

/// Any file that ends with .csv may be in a watched folder.
#[test]
fn a_file_that_is_no_export_makes_no_robot() {
    let workshop = small::workshop();
    fs::write(workshop.inbox("notes.csv"), "to do,done\ncall,yes\n").expect("a file");
    workshop.stdout(&["ingest", "inbox"], 1);
    assert_eq!(workshop.query("SELECT name FROM robot"), ["unknown"]);
    assert_eq!(workshop.query("SELECT robot, source_name FROM quarantine"), ["unknown|notes.csv"]);
    take(&workshop, &export("A", 1, 5).named("A.csv"));
    assert_eq!(
        workshop.query("SELECT robot, status FROM runs ORDER BY run_id"),
        ["unknown|quarantined", "A|complete"]
    );
}

/// The time is kept as by `cp -p` and `rsync -t`.
#[test]
fn a_corrected_export_of_the_same_size_and_time_is_read() {
    let workshop = small::workshop();
    let first = export("A", 1, 5);
    let path = workshop.inbox(&first.name);
    fs::write(&path, &first.bytes).expect("an export");
    let time = fs::metadata(&path).expect("the file").modified().expect("a time");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    daemon.stop();
    let corrected = first.with(|text| {
        let (before, last) = text.trim_end().rsplit_once('\n').expect("rows");
        let changed = last.replacen(".0", ".1", 1);
        assert_ne!(changed, last);
        format!("{before}\n{changed}\n")
    });
    assert_eq!(corrected.bytes.len(), first.bytes.len());
    fs::write(&path, &corrected.bytes).expect("the corrected export");
    fs::File::options().write(true).open(&path).expect("it").set_modified(time).expect("a time");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'superseded'", 1);
    daemon.stop();
}
