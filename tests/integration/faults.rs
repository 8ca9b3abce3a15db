//! Faults of disks and of other programs, made with a library that is loaded before the C library and lets system calls
//! of the real binary fail. Data that was not stored because of a fault is stored after it, and the rows are those of
//! an undisturbed run.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::LazyLock;

use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};
use sqlx::{ConnectOptions, Executor};

use crate::canon::{assert_sound, canonical_dump};
use crate::small::{self, Export, export};
use crate::support::{Workshop, assert_alike, end_of, query, text, wait_until};

const STATES: &str = "SELECT source_name, status, cycles FROM runs ORDER BY 1";

/// A setting of the library, see `shim.c`.
type Setting = (&'static str, &'static str);

/// Message about a database on such a disk.
const REFUSED: &str = "disk refused a write or a read of database";

const EIO: Setting = ("FAULT_ERRNO", "5");
const ENOSPC: Setting = ("FAULT_ERRNO", "28");
const EINTR: Setting = ("FAULT_ERRNO", "4");
const ONCE: Setting = ("FAULT_TIMES", "1");
const READ: Setting = ("FAULT_CALL", "read");
const WRITE: Setting = ("FAULT_CALL", "write");
const SYNC: Setting = ("FAULT_CALL", "sync");
const DATABASE: Setting = ("FAULT_PATH", "armwatch.db");
const EXPORTS: Setting = ("FAULT_PATH", "inbox/");

/// The library, and the results of the exports of all cases without a fault.
struct Bench {
    folder: tempfile::TempDir,
    exports: Vec<Export>,
    golden: String,
    states: Vec<String>,
}

static BENCH: LazyLock<Bench> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/integration/faults/shim.c");
    let compiled = Command::new("cc")
        .args(["-O1", "-shared", "-fPIC", "-o"])
        .arg(folder.path().join("shim.so"))
        .arg(source)
        .arg("-ldl")
        .output()
        .expect("a C compiler is there, as for the program itself");
    assert!(compiled.status.success(), "{}", text(&compiled.stderr));
    let exports = vec![export("A", 1, 5), export("B", 2, 5).gzip(), export("C", 3, 5).spoiled()];
    let workshop = small::workshop();
    put(&workshop, &exports);
    workshop.stdout(&["ingest", "inbox"], 1);
    let database = workshop.path("armwatch.db");
    Bench { folder, exports, golden: canonical_dump(&database), states: query(&database, STATES) }
});

fn put(workshop: &Workshop, exports: &[Export]) {
    for export in exports {
        workshop.add(export);
    }
}

/// A daemon with settings of the library, and the file of its standard error.
struct Faulty {
    child: Child,
    said: PathBuf,
}

impl Faulty {
    fn start(workshop: &Workshop, settings: &[Setting]) -> Self {
        let said = workshop.path("said");
        let mut command = workshop.command(&["run"]);
        if !settings.is_empty() {
            command.env("LD_PRELOAD", BENCH.folder.path().join("shim.so"));
        }
        let child = command
            .envs(settings.iter().copied())
            .stdout(Stdio::null())
            .stderr(File::create(&said).expect("a file"))
            .spawn()
            .expect("the daemon starts");
        Self { child, said }
    }

    /// Waits for a state of the database; fails if the daemon ends before that.
    fn wait(&mut self, workshop: &Workshop, wanted: impl Fn(&[String]) -> bool, case: &str) {
        let said = self.said.clone();
        let said = || fs::read_to_string(&said).unwrap_or_default();
        let is_so = || {
            // a signal before it watches would end it at once
            if said().contains("watching") && wanted(&states(workshop)) {
                return true;
            }
            let ended = self.child.try_wait().expect("a child");
            assert!(ended.is_none(), "{case}: ended with {ended:?}\n{}", said());
            false
        };
        wait_until(is_so, || format!("{case}: {:#?}\n{}", states(workshop), said()));
    }

    fn end(&mut self, case: &str) -> Option<i32> {
        let said = self.said.clone();
        let missing =
            || format!("{case}: the daemon does not end\n{}", fs::read_to_string(said).unwrap_or_default());
        end_of(&mut self.child, missing)
    }

    /// Waits until all is stored, or the daemon has ended before that.
    fn completes(&mut self, workshop: &Workshop, case: &str) -> bool {
        let said = self.said.clone();
        let mut has_ended = false;
        let is_over = || {
            let is_done = states(workshop) == BENCH.states;
            has_ended = !is_done && self.child.try_wait().expect("a child").is_some();
            is_done || has_ended
        };
        wait_until(is_over, || format!("{case}: {}", fs::read_to_string(said).unwrap_or_default()));
        !has_ended
    }

    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(sent.expect("kill runs").success());
    }

    fn stop(&mut self, case: &str) {
        self.signal("TERM");
        assert_eq!(self.end(case), Some(0), "{case}: {}", self.said());
    }

    fn said(&self) -> String {
        fs::read_to_string(&self.said).unwrap_or_default()
    }
}

impl Drop for Faulty {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn states(workshop: &Workshop) -> Vec<String> {
    let database = workshop.path("armwatch.db");
    if database.exists() { query(&database, STATES) } else { Vec::new() }
}

/// Lets a daemon without faults store the rest, and compares.
fn finish(workshop: &Workshop, case: &str) {
    let mut daemon = Faulty::start(workshop, &[]);
    daemon.wait(workshop, |states| states == BENCH.states, case);
    daemon.stop(case);
    compare(workshop, case);
}

fn compare(workshop: &Workshop, case: &str) {
    let database = workshop.path("armwatch.db");
    assert_alike(&canonical_dump(&database), &BENCH.golden, case);
    assert_sound(&database, case);
}

/// Checks that the daemon reads all exports in spite of the fault.
fn goes_on(case: &str, settings: &[Setting]) {
    let workshop = small::workshop();
    put(&workshop, &BENCH.exports);
    let mut daemon = Faulty::start(&workshop, settings);
    daemon.wait(&workshop, |states| states == BENCH.states, case);
    daemon.stop(case);
    compare(&workshop, case);
}

/// Checks that the daemon stops with status 74 and names the reason; without the fault it stores the rest.
fn stops(case: &str, settings: &[Setting], says: &str) {
    let workshop = small::workshop();
    put(&workshop, &BENCH.exports);
    let mut daemon = Faulty::start(&workshop, settings);
    assert_eq!(daemon.end(case), Some(74), "{case}: {}", daemon.said());
    let said = daemon.said();
    assert!(said.contains(says) && said.contains("armwatch.db"), "{case}: {said}");
    assert!(!said.contains("panicked"), "{case}: {said}");
    finish(&workshop, case);
}

#[test]
fn reads_that_fail_once_are_tried_again() {
    goes_on("while the content is hashed", &[READ, EXPORTS, EIO, ONCE, ("FAULT_AFTER", "100000")]);
    let plain = BENCH.exports[0].bytes.len() + 60_000;
    goes_on("while rows are read", &[READ, ("FAULT_PATH", "inbox/A"), EIO, ONCE, after(plain)]);
    goes_on("opening", &[("FAULT_CALL", "open"), EXPORTS, ("FAULT_ERRNO", "13"), ("FAULT_TIMES", "3")]);
}

#[test]
fn reads_that_are_interrupted_or_short_change_nothing() {
    goes_on("interrupted", &[READ, EXPORTS, EINTR, ("FAULT_EVERY", "3")]);
    goes_on("short", &[READ, EXPORTS, ("FAULT_SHORT", "17")]);
}

#[test]
#[ignore = "more of the same as in the quick tests"]
fn reads_that_fail_or_take_their_time_anywhere_change_nothing() {
    goes_on("first byte", &[READ, EXPORTS, EIO, ONCE]);
    let packed = BENCH.exports[1].bytes.len() + 60_000;
    goes_on("while rows are unpacked", &[READ, ("FAULT_PATH", "inbox/B"), EIO, ONCE, after(packed)]);
    goes_on("slow", &[READ, EXPORTS, ("FAULT_SLEEP_US", "3000")]);
    goes_on("renaming", &[("FAULT_CALL", "rename"), EIO, ("FAULT_PATH", "/")]);
}

fn after(bytes: usize) -> Setting {
    ("FAULT_AFTER", bytes.to_string().leak())
}

#[test]
fn an_export_on_a_broken_place_of_the_disk_holds_up_nobody_and_is_read_when_it_can_be() {
    let workshop = small::workshop();
    put(&workshop, &BENCH.exports);
    let half = BENCH.exports[0].bytes.len() + BENCH.exports[0].bytes.len() / 2;
    let mut daemon = Faulty::start(&workshop, &[READ, ("FAULT_PATH", "inbox/A"), EIO, after(half)]);
    let others = |states: &[String]| BENCH.states[1..].iter().all(|state| states.contains(state));
    daemon.wait(&workshop, others, "others");
    assert!(!states(&workshop).contains(&BENCH.states[0]));
    daemon.stop("broken place");
    assert!(daemon.said().contains("cannot be read now, trying again"), "{}", daemon.said());
    finish(&workshop, "broken place");
}

#[test]
fn a_database_on_a_full_disk_stops_the_daemon_and_loses_nothing() {
    stops("no room for a cycle", &[WRITE, DATABASE, ENOSPC, ("FAULT_AFTER", "600000")], REFUSED);
}

#[test]
#[ignore = "a fault at every place of a run takes minutes"]
fn a_disk_that_is_full_at_any_place_loses_nothing() {
    let mut stopped = 0;
    // from zero bytes up to the full size of the database
    for bytes in (0..).step_by(61_000) {
        let workshop = small::workshop();
        put(&workshop, &BENCH.exports);
        let case = format!("full after {bytes} bytes");
        let mut daemon = Faulty::start(&workshop, &[WRITE, DATABASE, ENOSPC, after(bytes)]);
        if daemon.completes(&workshop, &case) {
            break;
        }
        assert_eq!(daemon.end(&case), Some(74), "{case}: {}", daemon.said());
        assert!(daemon.said().contains(REFUSED), "{case}: {}", daemon.said());
        finish(&workshop, &case);
        stopped += 1;
    }
    println!("{stopped} places");
    assert!(stopped > 5, "{stopped}");
}

#[test]
fn a_disk_that_fails_to_sync_or_to_truncate_loses_nothing() {
    stops("schema", &[SYNC, DATABASE, EIO], REFUSED);
    // a failed checkpoint leaves the log unchanged: committed data is read from there
    let settings = [SYNC, ("FAULT_PATH", "armwatch.db-wal"), EIO, ("FAULT_AFTER", "1")];
    let workshop = small::workshop();
    put(&workshop, &BENCH.exports);
    let mut daemon = Faulty::start(&workshop, &settings);
    if daemon.completes(&workshop, "log") {
        daemon.signal("TERM");
    }
    let code = daemon.end("log");
    assert!(matches!(code, Some(0 | 74)), "{code:?}: {}", daemon.said());
    finish(&workshop, "log");
}

/// A source may be moved only after the commit that completes its run is safe against a power failure.
#[test]
fn a_source_stays_as_long_as_its_run_is_not_synced() {
    let workshop = small::workshop();
    workshop.set("archive", "\"archive\"");
    let export = &BENCH.exports[0];
    put(&workshop, std::slice::from_ref(export));
    // the schema is created; SQLite syncs the header of a new log, and after that it cannot be synced
    fs::create_dir(workshop.path("none")).expect("a folder");
    workshop.stdout(&["ingest", "none"], 0);
    let settings = [SYNC, ("FAULT_PATH", "armwatch.db-wal"), EIO, ("FAULT_AFTER", "1")];
    let mut daemon = Faulty::start(&workshop, &settings);
    // the kernel reports a lost write once, so the daemon cannot continue
    assert_eq!(daemon.end("archive"), Some(74), "{}", daemon.said());
    assert!(workshop.inbox(&export.name).exists(), "its run is not synced\n{}", daemon.said());
    assert_eq!(workshop.number("SELECT count(*) FROM runs WHERE status = 'complete'"), 1);
    // a repaired disk
    let mut daemon = Faulty::start(&workshop, &[]);
    wait_until(|| !workshop.inbox(&export.name).exists(), || daemon.said());
    daemon.stop("archive");
}

#[test]
#[ignore = "waits for longer than the busy timeout of ten seconds"]
fn another_writer_that_holds_the_lock_is_waited_for_and_nothing_is_lost() {
    let workshop = small::workshop();
    let mut daemon = Faulty::start(&workshop, &[]);
    daemon.wait(&workshop, |_| workshop.path("armwatch.db.daemon").exists(), "start");
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
    let database = workshop.path("armwatch.db");
    let mut other: SqliteConnection =
        runtime.block_on(SqliteConnectOptions::new().filename(&database).connect()).expect("a connection");
    runtime.block_on(other.execute("BEGIN IMMEDIATE")).expect("the lock");
    put(&workshop, &BENCH.exports);
    const GAVE_UP: &str = "stayed locked by another writer";
    wait_until(|| daemon.said().contains(GAVE_UP), || format!("it goes on waiting\n{}", daemon.said()));
    assert_eq!(states(&workshop), [""; 0]);
    runtime.block_on(other.execute("ROLLBACK")).expect("released");
    daemon.wait(&workshop, |states| states == BENCH.states, "after the lock");
    daemon.stop("locked");
    compare(&workshop, "locked");
}

/// A separate file system that is full except for $SLACK bytes; the script ends with 99 if the machine has none.
const FULL_DISK: &str = r#"
mount -t tmpfs -o size=8m tmpfs disk 2>/dev/null || exit 99
"$ARMWATCH" ingest empty --db disk/armwatch.db >/dev/null 2>&1
dd if=/dev/zero of=disk/filler bs=4096 count=100000 2>/dev/null
truncate -s "-$SLACK" disk/filler
timeout 60 "$ARMWATCH" run --db disk/armwatch.db 2>said
echo "status $?" >>said
rm disk/filler
timeout 60 "$ARMWATCH" ingest inbox --db disk/armwatch.db >/dev/null 2>&1
cp disk/armwatch.db out/
"#;

#[test]
fn a_disk_that_is_really_full_stops_storing_and_quarantining_and_loses_nothing() {
    // an export without a date in its name is quarantined before any other data of it is stored
    let dateless = [export("A", 1, 5).named("A_20269999_0847.csv")];
    let cases = [(&BENCH.exports[..], "49152"), (&BENCH.exports[..], "300000"), (&dateless[..], "49152")];
    for (exports, slack) in cases {
        let Some((said, workshop)) = on_a_full_disk(exports, slack) else { return };
        let case = format!("{} exports, {slack} bytes free", exports.len());
        assert!(said.contains("status 74") && said.contains("free space there"), "{case}: {said}");
        let database = workshop.path("out/armwatch.db");
        assert_sound(&database, &case);
        if exports.len() > 1 {
            assert_alike(&canonical_dump(&database), &BENCH.golden, &case);
        } else {
            assert_eq!(query(&database, STATES), ["A_20269999_0847.csv|quarantined|0"], "{case}");
        }
    }
}

/// Messages of the daemon on a full disk, and a folder with the database after space was freed; `None` if the machine
/// has no such file system.
fn on_a_full_disk(exports: &[Export], slack: &str) -> Option<(String, Workshop)> {
    let workshop = small::workshop();
    put(&workshop, exports);
    for folder in ["disk", "empty", "out"] {
        fs::create_dir(workshop.path(folder)).expect("a folder");
    }
    let script = Command::new("unshare")
        .args(["--user", "--map-root-user", "--mount", "sh", "-c", FULL_DISK])
        .current_dir(workshop.path(""))
        .env("ARMWATCH", env!("CARGO_BIN_EXE_armwatch"))
        .env("SLACK", slack)
        .env_remove("ARMWATCH_CONFIG")
        .output();
    if !script.as_ref().is_ok_and(|script| script.status.success()) {
        println!("skipped: this machine gives no file system of its own ({script:?})");
        return None;
    }
    let said = fs::read_to_string(workshop.path("said")).expect("what it said");
    Some((said, workshop))
}
