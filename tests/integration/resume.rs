//! Resumed reading after a restart from the end of stored cycles, by the real daemon.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;
use std::sync::LazyLock;

use sqlx::Connection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

use crate::small::{self, Export};
use crate::support::{Daemon, Workshop, assert_alike};

const COMPLETE: &str = "SELECT COUNT(*) FROM runs WHERE status = 'complete'";
const CYCLES: &str = "SELECT COUNT(*) FROM cycles";

/// Pieces of a cycle that are written one by one, so that blocks of rows are far shorter than a cycle.
const PIECES: usize = 12;

/// Place after the last row of cycle `number`.
fn end_of_cycle(export: &Export, number: u32) -> usize {
    let lines = export.lines();
    let cycle = |line: &[u8]| {
        let text = std::str::from_utf8(line).expect("text");
        text.split(',').nth(14).and_then(|cell| cell.parse::<u32>().ok())
    };
    lines
        .iter()
        .take_while(|line| cycle(line).is_none_or(|cycle| cycle <= number))
        .map(|line| line.len())
        .sum()
}

/// Appends bytes in pieces that the daemon reads one by one.
fn append(workshop: &Workshop, daemon: &Daemon, path: &Path, bytes: &[u8]) {
    let is_known = path.exists();
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    for (number, piece) in bytes.chunks(bytes.len() / PIECES + 1).enumerate() {
        file.write_all(piece).expect("written");
        // it is opened after it was seen growing
        if number == 0 && !is_known {
            workshop.wait_for_a_look();
        } else {
            daemon.wait_until_read(path);
        }
    }
}

/// Content of the database after the export was read once, the same for all tests.
fn golden() -> &'static str {
    static GOLDEN: LazyLock<String> = LazyLock::new(|| {
        let (export, workshop) = (the_export(), small::workshop());
        workshop.add(&export);
        workshop.stdout(&["ingest", "inbox"], 0);
        workshop.dump()
    });
    &GOLDEN
}

fn the_export() -> Export {
    small::export("A", 1, 5)
}

fn kill(daemon: Daemon) {
    daemon.signal("KILL");
    assert_eq!(daemon.end(), None);
}

fn stop(daemon: Daemon) {
    daemon.stop();
}

/// Kills a daemon after it has stored two cycles of a growing export; returns the byte to resume from.
fn killed_behind_two_cycles(workshop: &Workshop, export: &Export) -> usize {
    workshop.set("settle_s", "60");
    let daemon = workshop.daemon();
    let path = workshop.inbox(&export.name);
    let (first, second) = (end_of_cycle(export, 1), end_of_cycle(export, 2));
    append(workshop, &daemon, &path, &export.bytes[..first]);
    append(workshop, &daemon, &path, &export.bytes[first..second + 2000]);
    workshop.wait_for(CYCLES, 2);
    kill(daemon);
    let point = workshop.query("SELECT cycles, byte FROM resume_point");
    let (cycles, byte) = point.first().and_then(|row| row.split_once('|')).expect("a point");
    assert_eq!(cycles, "2");
    let byte = byte.parse().expect("a byte");
    // after the first cycle, since blocks are far shorter; and at the beginning of a row
    assert!((first..=second).contains(&byte), "{byte} is not in {first}..={second}");
    assert_eq!(export.bytes[byte - 1], b'\n');
    byte
}

/// Lets a daemon read the rest of an export and returns its log.
fn finished(workshop: &Workshop, export: &Export) -> String {
    let path = workshop.inbox(&export.name);
    let written = usize::try_from(std::fs::metadata(&path).expect("an export").len()).expect("a size");
    let mut file = OpenOptions::new().append(true).open(&path).expect("an export");
    file.write_all(&export.bytes[written..]).expect("written");
    std::fs::write(workshop.inbox(&format!("{}.done", export.name)), "").expect("a mark");
    let daemon = workshop.daemon();
    workshop.wait_for(COMPLETE, 1);
    assert_alike(&workshop.dump(), golden(), "dump");
    stop(daemon);
    workshop.log()
}

#[test]
fn a_killed_daemon_goes_on_reading_where_stored_cycles_end() {
    let (export, workshop) = (the_export(), small::workshop());
    let byte = killed_behind_two_cycles(&workshop, &export);
    let log = finished(&workshop, &export);
    assert_eq!(log.matches(&format!("resumed at byte {byte}")).count(), 1, "{log}");
}

/// A stored state may be of an older version, or damaged.
#[test]
fn a_state_that_is_not_understood_is_no_state() {
    let (export, workshop) = (the_export(), small::workshop());
    killed_behind_two_cycles(&workshop, &export);
    let half = "UPDATE resume_point SET state = substr(state, 1, length(state) / 2)";
    execute(&workshop.path("armwatch.db"), half);
    let log = finished(&workshop, &export);
    assert!(!log.contains("resumed at byte") && log.contains("read from the start"), "{log}");
}

/// Columns may have another meaning in another layout.
#[test]
fn another_layout_does_not_go_on_with_the_state_of_the_first() {
    let (export, workshop) = (the_export(), small::workshop());
    killed_behind_two_cycles(&workshop, &export);
    let native = concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/native.toml");
    let text = std::fs::read_to_string(native).expect("the layout");
    std::fs::write(workshop.path("other.toml"), text.replace("name = \"native\"", "name = \"other\""))
        .expect("written");
    let config = workshop.path("armwatch.toml");
    let text = std::fs::read_to_string(&config).expect("the configuration");
    std::fs::write(&config, text.replace(native, "other.toml")).expect("written");
    let log = finished(&workshop, &export);
    assert!(!log.contains("resumed at byte") && log.contains("read from the start"), "{log}");
}

#[test]
fn a_complete_export_that_grows_again_is_gone_on_with_where_its_last_whole_cycle_ends() {
    let (export, workshop) = (the_export(), small::workshop());
    workshop.set("settle_s", "2");
    let path = workshop.inbox(&export.name);
    let daemon = workshop.daemon();
    let (first, second) = (end_of_cycle(&export, 1), end_of_cycle(&export, 2));
    append(&workshop, &daemon, &path, &export.bytes[..first]);
    append(&workshop, &daemon, &path, &export.bytes[first..second]);
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete' AND cycles = 2", 1);
    assert_eq!(
        workshop.query("SELECT cycles FROM resume_point"),
        ["1"],
        "the end of the file has cut the second"
    );
    append(&workshop, &daemon, &path, &export.bytes[second..]);
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete' AND cycles = 3", 1);
    assert_alike(&workshop.dump(), golden(), "dump");
    let log = workshop.log();
    assert!(log.contains("resumed at byte"), "{log}");
    stop(daemon);
}

fn execute(database: &Path, sql: &str) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(database);
        let mut connection = SqliteConnection::connect_with(&options).await.expect("a connection");
        sqlx::query(sqlx::AssertSqlSafe(sql)).execute(&mut connection).await.expect("done");
        connection.close().await.expect("closed");
    });
}
