//! Commands that only read: for users without write permission, next to a daemon, for missing things, and into a full
//! disk.

use std::fs::{self, File};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::canon;
use crate::small::{self, export};
use crate::support::{Workshop, query, text, wait_until};

/// Commands that read a database with at least two tests of robot A, the first with number 1.
const READING: [&[&str]; 13] = [
    &["status"],
    &["robots"],
    &["runs"],
    &["cycles", "--run", "1"],
    &["sql", "SELECT count(*) FROM runs"],
    &["rmsd", "--run", "1"],
    &["friction", "--run", "1"],
    &["identify", "--run", "1"],
    &["parameters", "list"],
    &["alerts", "list"],
    &["quarantine", "list"],
    &["maintenance", "--list"],
    &["calibrate"],
];

/// A database of two tests.
fn stored() -> Workshop {
    let workshop = small::workshop();
    for day in [5, 6] {
        workshop.add(&export("A", day, day));
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

/// The command as a user who may read the folder and write nothing.
pub fn as_another_user(workshop: &Workshop, arguments: &[&str]) -> Output {
    let armwatch = env!("CARGO_BIN_EXE_armwatch");
    let is_root = fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0);
    let mut command = match is_root {
        true => {
            let mut command = Command::new("setpriv");
            command.args(["--reuid=65534", "--regid=65534", "--clear-groups", armwatch]);
            command
        }
        // the folder is not writable for its owner either
        false => Command::new(armwatch),
    };
    command.args(arguments).current_dir(workshop.path("")).stdin(Stdio::null());
    command.output().expect("it runs")
}

/// Returns true if another user can start the program and read the files of the configuration: a checkout may be in a
/// private folder.
pub fn can_be_another_user(workshop: &Workshop) -> bool {
    set_mode(&workshop.path(""), 0o755);
    let can = Command::new("setpriv").arg("--version").output().is_ok()
        && as_another_user(workshop, &["config", "show"]).status.success();
    if !can {
        println!(
            "skipped: no other user can run the program here, or setpriv of util-linux is not installed"
        );
    }
    can
}

fn set_mode(path: &Path, mode: u32) {
    fs::set_permissions(path, fs::Permissions::from_mode(mode)).expect("permissions");
}

#[test]
fn a_user_who_may_not_write_can_ask_while_the_daemon_runs_and_when_it_does_not() {
    let workshop = stored();
    if !can_be_another_user(&workshop) {
        return;
    }
    let ask_all = |when: &str| {
        for arguments in READING {
            let output = as_another_user(&workshop, arguments);
            let said = text(&output.stderr);
            assert_eq!(output.status.code(), Some(0), "{when}: armwatch {arguments:?}\n{said}");
        }
    };
    set_mode(&workshop.path(""), 0o555);
    ask_all("nobody has it open");
    assert!(!workshop.path("armwatch.db-wal").exists() && !workshop.path("armwatch.db-shm").exists());
    set_mode(&workshop.path(""), 0o755);
    let daemon = workshop.daemon();
    workshop.wait_until_idle();
    ask_all("the daemon runs");
    let refused = as_another_user(&workshop, &["sql", "DELETE FROM run"]);
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
    daemon.stop();
    assert_eq!(workshop.number("SELECT count(*) FROM runs"), 2);
}

#[test]
fn nothing_is_made_or_brought_up_to_date_by_reading() {
    let workshop = stored();
    for arguments in READING.iter().filter(|of| of[0] != "calibrate") {
        let said = workshop.stderr(&[arguments, &["--db", "typo.db"][..]].concat(), 74);
        assert!(said.contains("there is no database typo.db"), "{said}");
        assert!(!workshop.path("typo.db").exists(), "armwatch {arguments:?}");
    }

    // the state left by an older version
    let older = workshop.path("older.db");
    fs::copy(workshop.path("armwatch.db"), &older).expect("a copy");
    small_change(&older, "UPDATE schema_version SET version = 50");
    let before = fs::read(&older).expect("the file");
    for arguments in READING {
        let said = workshop.stderr(&[arguments, &["--db", "older.db"][..]].concat(), 74);
        assert!(said.contains("upgrade it"), "{said}");
    }
    assert!(fs::read(&older).expect("the file") == before);
}

pub fn small_change(database: &Path, statement: &str) {
    use sqlx::Connection;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let url = format!("sqlite://{}", database.display());
        let mut connection = sqlx::SqliteConnection::connect(&url).await.expect("a connection");
        let statement = sqlx::AssertSqlSafe(statement.to_owned());
        sqlx::raw_sql(statement).execute(&mut connection).await.expect("done");
        connection.close().await.expect("closed");
    });
}

#[test]
fn a_snapshot_says_what_the_database_says_and_needs_no_other_file() {
    let workshop = stored();
    let said = workshop.stdout(&["snapshot", "out/copy.db"], 0);
    assert!(said.starts_with("out/copy.db: "), "{said}");
    let copy = workshop.path("out/copy.db");
    assert!(canon::dump(&copy) == workshop.dump(), "views of the copy differ");
    let size = |path: &Path| fs::metadata(path).expect("a file").len();
    assert!(size(&copy) < size(&workshop.path("armwatch.db")));
    assert_eq!(query(&copy, "SELECT count(*) FROM torque_factor"), ["0"], "factors are left out");
    let files = |folder: &str| fs::read_dir(workshop.path(folder)).expect("a folder").count();
    assert_eq!(files("out"), 1);
    if can_be_another_user(&workshop) {
        set_mode(&workshop.path("out"), 0o555);
        let output = as_another_user(&workshop, &["status", "--db", "out/copy.db"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        set_mode(&workshop.path("out"), 0o755);
    }

    // a file that is no snapshot is not overwritten, and nothing writes to a snapshot
    let export =
        fs::read_dir(workshop.path("inbox")).expect("a folder").next().expect("one").expect("a file").path();
    for other in [workshop.path("armwatch.db"), export] {
        let before = fs::read(&other).expect("it");
        let refused = workshop.run(&["snapshot", other.to_str().expect("text")]);
        assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stderr));
        assert!(fs::read(&other).expect("it") == before);
    }
    for arguments in [&["ingest", "inbox"][..], &["maintenance", "A", "--what", "grease"]] {
        let refused = workshop.stderr(&[arguments, &["--db", "out/copy.db"]].concat(), 74);
        assert!(refused.contains("is a snapshot"), "{refused}");
    }
    workshop.stdout(&["snapshot", "out/copy.db"], 0);

    // a failed snapshot keeps the earlier copy
    let before = fs::read(&copy).expect("the copy");
    // the name of the temporary file is too long
    let long = format!("out/{}", "x".repeat(240));
    fs::rename(&copy, workshop.path(&long)).expect("renamed");
    assert_eq!(workshop.run(&["snapshot", &long]).status.code(), Some(74));
    assert!(fs::read(workshop.path(&long)).expect("the copy") == before);
}

#[test]
fn the_daemon_keeps_a_snapshot_up_to_date() {
    let workshop = small::workshop();
    workshop.configure(|config| format!("[snapshot]\nfile = \"copy.db\"\ninterval_min = 0.1\n\n{config}"));
    let daemon = workshop.daemon();
    let copy = workshop.path("copy.db");
    for (tests, day) in [(1, 5), (2, 6)] {
        workshop.add(&export("A", day, day));
        let counted = || copy.exists() && query(&copy, "SELECT count(*) FROM runs") == [tests.to_string()];
        wait_until(counted, || workshop.log());
    }
    daemon.stop();
    assert!(canon::dump(&copy) == workshop.dump());
}

/// Conclusions wait for the last export of a robot, so a stop before that leaves them to the end.
#[test]
fn the_last_snapshot_has_what_is_concluded_after_the_stop() {
    let workshop = small::workshop();
    workshop.configure(|config| format!("[snapshot]\nfile = \"copy.db\"\ninterval_min = 0.1\n\n{config}"));
    for day in 1..=28 {
        workshop.add(&export("A", 1 + day % 2, day));
    }
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) > 1 FROM runs WHERE status = 'complete'", 1);
    daemon.stop();
    assert!(
        workshop.number("SELECT count(*) FROM runs WHERE status = 'complete'") < 28,
        "it was stopped in between"
    );
    assert_eq!(workshop.number("SELECT count(*) FROM robot WHERE history <> concluded"), 0);
    assert!(canon::dump(&workshop.path("copy.db")) == workshop.dump());
}

#[test]
fn results_that_cannot_be_written_are_an_error() {
    if !Path::new("/dev/full").exists() {
        println!("skipped: there is no /dev/full");
        return;
    }
    let workshop = stored();
    for arguments in READING {
        let mut command = workshop.command(arguments);
        command.stdin(Stdio::null()).stdout(File::options().write(true).open("/dev/full").expect("a file"));
        let output = command.output().expect("it runs");
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(74), "armwatch {arguments:?}\n{said}");
        assert!(said.contains("standard output cannot be written"), "{said}");
    }
}

#[test]
fn lists_and_answers_come_as_table_csv_and_json() {
    let workshop = stored();
    let table = workshop.stdout(&["runs"], 0);
    let lines: Vec<&str> = table.lines().collect();
    assert!(lines[0].starts_with("run_id  robot") && lines.len() == 3, "{table}");
    assert!(lines[1].contains("2026-01-06T08:47:00.000Z"), "the newest comes first\n{table}");
    let csv = workshop.stdout(&["cycles", "--run", "1", "--csv"], 0);
    assert_eq!(csv.lines().count(), 4, "{csv}");
    assert!(csv.starts_with("run_id,robot,cycle,started_at,"), "{csv}");
    let json = workshop.stdout(&["robots", "--json"], 0);
    let robot: serde_json::Value = serde_json::from_str(json.trim()).expect("one object");
    assert_eq!(
        (robot["robot"].as_str(), robot["tests"].as_i64(), robot["cycles"].as_i64()),
        (Some("A"), Some(2), Some(6))
    );

    // all digits of a stored number are printed
    let exact = workshop.stdout(
        &["sql", "SELECT value FROM cycle_parameters WHERE run_id = 1 AND cycle = 1 ORDER BY joint, parameter LIMIT 1", "--csv"],
        0,
    );
    let stored =
        "SELECT value FROM cycle_parameters WHERE run_id = 1 AND cycle = 1 ORDER BY joint, parameter LIMIT 1";
    let number = |text: &str| text.parse::<f64>().expect("a number");
    assert_eq!(number(exact.lines().last().expect("a row")), number(&workshop.query(stored)[0]));

    for (statement, said) in [
        ("SELECT missing FROM runs", "no such column"),
        ("DELETE FROM run", "reading only"),
        ("CREATE TABLE x (y)", "reading only"),
        ("SELEC", "syntax error"),
    ] {
        let refused = workshop.stderr(&["sql", statement], 2);
        assert!(refused.contains(said), "{statement}: {refused}");
    }
}

#[test]
fn the_status_says_what_is_wrong_and_where_nothing_is_known() {
    let workshop = small::workshop();
    workshop.stdout(&["ingest", "inbox"], 0);
    let empty = workshop.stdout(&["status"], 0);
    assert!(empty.contains("no test is stored yet"), "{empty}");

    let (healthy, broken) = (export("A", 1, 5), export("B", 2, 5).spoiled());
    for export in [&healthy, &broken] {
        workshop.add(export);
    }
    workshop.stdout(&["ingest", "inbox"], 1);
    let said = workshop.stdout(&["status"], 0);
    assert!(said.contains("1 robot, 1 complete test, 5 cycles"), "{said}");
    assert!(said.contains("quarantine  1 export"), "{said}");
    assert!(said.contains("alarms      none open"), "{said}");
    let told: serde_json::Value =
        serde_json::from_str(workshop.stdout(&["status", "--json"], 0).trim()).expect("one object");
    assert_eq!(told["robots"][0]["status"], "learning", "{told}");
    assert_eq!(told["quarantined"], 1, "{told}");
}

/// If `armwatch sql` refuses a statement, nothing is written, and the message has a remedy.
#[test]
fn a_question_in_sql_is_one_statement_that_reads() {
    let workshop = stored();
    let files = || fs::read_dir(workshop.path("")).expect("a folder").count();
    // a reader leaves an empty write-ahead log, like any reader of SQLite that may not change the file
    workshop.stdout(&["sql", "VALUES (1)"], 0);
    let before = files();
    for (statement, said) in [
        ("VACUUM INTO 'copy.db'", "`armwatch backup FILE`"),
        ("ATTACH 'other.db' AS other", "does not only read"),
        ("BEGIN", "does not only read"),
        ("DELETE FROM run RETURNING run_id", "reading only"),
        ("SELECT 1; VACUUM INTO 'copy.db'", "several statements"),
        ("SELECT 1; SELECT 2", "several statements"),
        ("", "armwatch sql \"SELECT"),
        (" -- nothing\n;", "there is no statement"),
        ("SELECT ?", "write :NAME"),
    ] {
        let refused = workshop.stderr(&["sql", statement], 2);
        assert!(refused.contains(said), "{statement}: {refused}");
    }
    let unknown = workshop.stderr(&["sql", "SELECT :robot", "--param", "robot=A", "--param", "joint=1"], 2);
    assert!(unknown.contains("no parameter joint: it has :robot"), "{unknown}");
    let wrong = workshop.run(&["sql", "SELECT :robot", "--param", "robot"]);
    assert!(text(&wrong.stderr).contains("NAME=VALUE"), "{}", text(&wrong.stderr));
    assert_eq!(files(), before);
}

#[test]
fn parameters_of_a_statement_have_their_values_from_the_command_line() {
    let workshop = stored();
    let statement = "SELECT run_id FROM runs WHERE robot = :robot AND run_id > :run; -- those behind it";
    fs::write(workshop.path("question.sql"), statement).expect("written");
    let given = ["--param", "robot=A", "--param", ":run=1", "--json"];
    for asked in [["sql", "--file", "question.sql"], ["sql", "--", statement]] {
        let asked = [&asked[..1], &given, &asked[1..]].concat();
        assert_eq!(workshop.stdout(&asked, 0).trim(), r#"{"run_id":2}"#);
    }
    let missing = workshop.stderr(&["sql", "--file", "nowhere.sql"], 74);
    assert!(missing.contains("nowhere.sql"), "{missing}");

    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("dashboards/open_anomalies.sql");
    let shipped = shipped.to_str().expect("text");
    let asked = workshop.stderr(&["sql", "--file", shipped], 0);
    assert!(asked.contains("NULL, because no --param"), "{asked}");
    let all = [
        "sql",
        "--file",
        shipped,
        "--param",
        "robot=A",
        "--param",
        "severity=",
        "--param",
        "with_resolved=1",
    ];
    workshop.stdout(&all, 0);

    let twice = workshop.stdout(&["sql", "SELECT 1 AS x, 2 AS x, 3 AS y", "--json"], 0);
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(twice.trim()).expect("an object"),
        serde_json::json!({"x": 1, "x_2": 2, "y": 3})
    );
}

#[test]
fn what_is_not_there_is_told_with_what_there_is() {
    let workshop = stored();
    let told = |arguments: &[&str], code: i32| workshop.stderr(arguments, code);
    let said = told(&["identify", "--run", "1", "--cycles", "2-24"], 2);
    assert!(said.contains("run 1 has no cycle 4; it has cycles 1-3"), "{said}");
    let said = told(&["identify", "--run", "99"], 2);
    assert!(said.contains("there is no run 99; runs with cycles: 1-2"), "{said}");
    let said = told(&["verify", "--parameters", "1", "--against", "99"], 2);
    assert!(said.contains("there is no run 99; runs known: 1-2"), "{said}");
    let said = told(&["status", "--db", "inbox"], 74);
    assert!(said.contains("inbox is a folder, not a database; name the file in it"), "{said}");
    let one = workshop.stdout(&["identify", "--run", "1"], 0);
    assert!(one.starts_with("3 cycles of 1 run, model"), "{one}");

    workshop.stdout(&["snapshot", "copy.db"], 0);
    for arguments in [
        &["identify", "--run", "1"][..],
        &["identify", "--run", "1", "--each-cycle"],
        &["identify", "--run", "1", "--cycles", "1"],
        &["verify", "--robot", "A"],
        &["backup", "out.db"],
    ] {
        let said = told(&[arguments, &["--db", "copy.db"]].concat(), 2);
        assert!(said.contains("copy.db is a snapshot, a copy for readers"), "{arguments:?}: {said}");
    }
    assert!(!workshop.path("out.db").exists());
}

/// Damage that only copying finds is reported for the database, whatever the copy's name.
#[test]
fn a_damaged_database_is_named_by_its_backup() {
    let workshop = stored();
    let path = workshop.path("armwatch.db");
    let page: usize = workshop.number("PRAGMA page_size").try_into().expect("a size");
    let root: usize = workshop
        .number("SELECT rootpage FROM sqlite_schema WHERE name = 'torque_factor'")
        .try_into()
        .expect("a page");
    let mut bytes = fs::read(&path).expect("the database");
    bytes[(root - 1) * page..root * page].fill(0xff);
    fs::write(&path, bytes).expect("written");
    let said = workshop.stderr(&["backup", "out.db"], 74);
    assert!(said.contains("armwatch.db is damaged") && said.contains("restore a copy"), "{said}");
    assert!(!said.contains("out.db"), "{said}");
    assert!(!workshop.path("out.db").exists());
}
