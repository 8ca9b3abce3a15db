//! Actions of writers on files, one row each, with one real daemon that sees them all at once: the expected runs
//! afterwards, and after a restart.

mod rows;
mod stage;

use std::panic::AssertUnwindSafe;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::canon::assert_sound;
use crate::small;
use crate::support::{Daemon, LOG_LEVELS, Workshop};
use rows::{ROWS, Row};
use stage::{SETTLE, Stage, Watched};

/// Number of rows that act at once; each waits most of its time.
const ACTING: usize = 12;

#[test]
fn whatever_the_writer_does_the_runs_are_those_of_its_recordings() {
    let workshop = small::workshop();
    workshop.set("folders", "[\"inbox\", \"later\", \"again\"]");
    workshop.set("settle_s", &SETTLE.as_secs_f64().to_string());
    workshop.set("live_files", "16");
    let daemon = start(&workshop);
    let watched = Watched::new(&workshop);
    let failures = play(&workshop, &watched);
    assert!(failures.is_empty(), "{} of {} rows:\n{}", failures.len(), ROWS.len(), failures.join("\n"));
    assert_calm(&workshop, &watched, "while the daemon runs");
    stop(daemon);
    let daemon = start(&workshop);
    assert_calm(&workshop, &watched, "after a restart");
    stop(daemon);
    assert_sound(&workshop.path("armwatch.db"), "matrix");
    println!("{} rows", ROWS.len());
}

/// Runs all rows, some at once, and returns the failed ones.
fn play(workshop: &Workshop, watched: &Watched) -> Vec<String> {
    let (finished, next) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        let looking = scope.spawn(|| watched.look_until(&finished));
        let act = || {
            let mut failures = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(row) = ROWS.get(number) else { return failures };
                let stage = Stage::new(workshop, watched, number);
                let acted = std::panic::catch_unwind(AssertUnwindSafe(|| (row.act)(&stage)));
                if acted.is_err() || !stage.becomes(row.runs) {
                    failures.push(failure(row, &stage));
                }
            }
        };
        let acting: Vec<_> = (0..ACTING).map(|_| scope.spawn(act)).collect();
        let failures = acting.into_iter().flat_map(|acting| acting.join().expect("a thread")).collect();
        finished.store(true, Ordering::Relaxed);
        looking.join().expect("a thread");
        failures
    })
}

fn failure(row: &Row, stage: &Stage) -> String {
    format!("{}: wanted {:?}, found {:#?}", row.name, row.runs, stage.runs())
}

/// Asserts that every row has the expected runs after the daemon has no work left.
fn assert_calm(workshop: &Workshop, watched: &Watched, when: &str) {
    workshop.wait_until_idle();
    watched.look();
    for (number, row) in ROWS.iter().enumerate() {
        let stage = Stage::new(workshop, watched, number);
        assert!(stage.is(row.runs), "{when}: {}", failure(row, &stage));
    }
}

/// Starts the daemon without the capabilities that override permissions, if the tests run as root.
fn start(workshop: &Workshop) -> Daemon {
    let without =
        ["--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-dac_override,-dac_read_search"];
    let program = env!("CARGO_BIN_EXE_armwatch");
    let powerless = Command::new("setpriv").args(without).arg("true").status().is_ok_and(|s| s.success());
    let mut command = if powerless { Command::new("setpriv") } else { Command::new(program) };
    if powerless {
        command.args(without).arg(program);
    }
    let said =
        std::fs::File::options().create(true).append(true).open(workshop.path("daemon.log")).expect("a file");
    command
        .env("ARMWATCH_LOG", LOG_LEVELS)
        .arg("run")
        .current_dir(workshop.path(""))
        .env_remove("ARMWATCH_CONFIG");
    let child = command.stdout(std::process::Stdio::null()).stderr(said).spawn().expect("the daemon starts");
    let daemon = Daemon { child };
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE run_id < 0", 0);
    daemon
}

fn stop(daemon: Daemon) {
    daemon.stop();
}

#[test]
#[ignore = "quarantining two thousand files takes a quarter of a minute"]
fn two_thousand_files_at_once_are_found_although_their_events_are_lost() {
    let workshop = small::workshop();
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    // it reads no events while it is stopped: more are created than the system queues for it
    daemon.signal("STOP");
    for round in 0..4 {
        for number in 0..2000 {
            let name = format!("A_20260105_0847_{number}.csv");
            std::fs::write(workshop.inbox(&name), format!("time,{number}\n{round}\n")).expect("written");
        }
    }
    daemon.signal("CONT");
    let start = Instant::now();
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'quarantined'", 2000);
    println!("2000 files in {:.1?}", start.elapsed());
    stop(daemon);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs"), 2000);
    assert_sound(&workshop.path("armwatch.db"), "many files");
}

#[test]
fn a_file_that_vanished_while_no_daemon_ran_ends_its_run_which_goes_on_when_it_is_back() {
    let workshop = small::workshop();
    let export = small::export("A", 1, 5);
    let path = workshop.inbox(&export.name);
    let half = export.bytes.len() / 2;
    let mut daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    stage::append_slowly(&path, &export.bytes[..half], 10, Duration::from_millis(60));
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'streaming' AND cycles > 0", 1);
    daemon.child.kill().expect("killed");
    daemon.child.wait().expect("a child");
    std::fs::remove_file(&path).expect("removed");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'quarantined'", 1);
    let reason = workshop.query("SELECT reason, cycles > 0 FROM runs");
    assert_eq!(
        reason,
        ["the file vanished before it was read to its end; put it back, or export it again|1"]
    );
    std::fs::write(&path, &export.bytes).expect("written");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete' AND cycles = 3", 1);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs"), 1);
    stop(daemon);
    assert_sound(&workshop.path("armwatch.db"), "vanished");
}
