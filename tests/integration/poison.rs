//! Exports that end the program are not retried forever, and faults of growing files are visible at once.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::small::{self, export};
use crate::support::{Workshop, pass, text};

/// Puts an export into the inbox whose first cycle takes a second to read and analyse, so that a kill interrupts it.
/// Returns its path.
#[cfg(target_os = "linux")]
fn put_large(workshop: &Workshop, robot: &str) -> PathBuf {
    let scara = concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots/scara.toml");
    let shape = ["--cycles", "2", "--warming-s", "60", "--rate-hz", "250", "--robot", scara];
    let which = ["--name", robot, "--seed", "1", "--start", "2026-01-05T08:47:00Z"];
    let made = workshop.simulate("made", &[&shape[..], &which[..]].concat()).remove(0);
    let path = workshop.inbox(name_of(&made));
    fs::rename(made, &path).expect("moved");
    path
}

#[cfg(target_os = "linux")]
fn name_of(path: &Path) -> &str {
    path.file_name().and_then(|name| name.to_str()).expect("a name")
}

/// Kills the daemon each time it has a file open, until `is_over`. Returns the number of kills.
#[cfg(target_os = "linux")]
fn kill_whoever_opens(workshop: &Workshop, path: &Path, is_over: impl Fn() -> bool) -> usize {
    let wanted = path.canonicalize().expect("a path");
    let mut kills = 0;
    loop {
        let mut daemon = workshop.daemon();
        let files = format!("/proc/{}/fd", daemon.child.id());
        let has_it_open = || {
            let files = fs::read_dir(&files).into_iter().flatten().flatten();
            files.into_iter().any(|file| fs::read_link(file.path()).is_ok_and(|target| target == wanted))
        };
        let mut is_open = false;
        workshop.wait_until(|| {
            // an export is open for some hundredths of a second
            for _ in 0..50 {
                is_open = is_open || has_it_open();
                if is_open {
                    return true;
                }
                pass(Duration::from_millis(1));
            }
            is_over()
        });
        if !is_open {
            daemon.stop();
            return kills;
        }
        daemon.child.kill().expect("it lives until it is killed");
        assert_eq!(daemon.child.wait().expect("a child").code(), None, "the daemon ended by itself");
        kills += 1;
        assert!(kills < 9, "it is tried for ever\n{}", workshop.log());
    }
}

#[test]
#[cfg(target_os = "linux")]
fn an_export_that_ends_the_program_is_quarantined_after_three_attempts_and_others_are_stored() {
    let workshop = small::workshop();
    let poison = put_large(&workshop, "P");
    // names after the poison's, of the same robot, and of others
    let others = [export("P", 2, 6), export("A", 3, 5), export("Z", 4, 5)];
    for one in &others {
        workshop.add(one);
    }
    let is_quarantined = || {
        workshop.path("armwatch.db").exists()
            && workshop.number("SELECT count(*) FROM runs WHERE status = 'quarantined'") == 1
            && workshop.number("SELECT count(*) FROM runs WHERE status = 'complete'") == 3
    };
    assert_eq!(kill_whoever_opens(&workshop, &poison, is_quarantined), 3);
    assert_eq!(
        workshop.query("SELECT source_name, problem, state FROM quarantine"),
        [format!("{}|reading this export has ended the program three times|open", name_of(&poison))]
    );
    let log = workshop.log();
    assert!(log.contains("the program ended while this export was read"), "{log}");
    // another start does not retry it, but a user can
    let daemon = workshop.daemon();
    workshop.wait_until_idle();
    daemon.stop();
    assert_eq!(workshop.number("SELECT count(*) FROM attempt"), 0);
    let run = workshop.number("SELECT run_id FROM quarantine").to_string();
    workshop.stdout(&["quarantine", "retry", &run], 0);
    assert_eq!(workshop.number("SELECT count(*) FROM runs WHERE status = 'complete'"), 4);
}

#[test]
#[cfg(target_os = "linux")]
fn an_export_that_is_innocent_clears_itself() {
    let workshop = small::workshop();
    put_large(&workshop, "I");
    // killed twice for another reason
    for attempts in 1..=2 {
        let mut daemon = workshop.daemon();
        let begun = format!(
            "SELECT count(*) FROM attempt WHERE work = 'export' AND attempts = {attempts} AND process IS NOT NULL"
        );
        workshop.wait_until(|| workshop.path("armwatch.db").exists() && workshop.query(&begun) == ["1"]);
        daemon.child.kill().expect("it lives until it is killed");
        daemon.child.wait().expect("a child");
    }
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    daemon.stop();
    assert_eq!(workshop.number("SELECT count(*) FROM attempt"), 0);
}

#[test]
fn a_growing_file_with_a_bad_row_is_seen_while_it_grows() {
    let workshop = small::workshop();
    // longer than a writer is delayed on a busy machine
    workshop.set("settle_s", "3.0");
    workshop.add(&export("B", 1, 5));
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 1);
    workshop.wait_for_conclusions();
    workshop.wait_for("SELECT count(*) FROM fleet_health WHERE status = 'unknown'", 0);

    let growing = export("B", 2, 6);
    let lines = growing.lines();
    let bad = lines.len() / 2;
    let path = workshop.inbox(&growing.name);
    let written = [&lines[..bad].concat()[..], b"nothing\n"].concat();
    fs::write(&path, lines[..2].concat()).expect("written");
    workshop.wait_for_a_look();
    fs::write(&path, &written).expect("written");
    let corrected = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // it grows continuously
        let writer = scope.spawn(|| {
            let mut file = fs::File::options().append(true).open(&path).expect("the file");
            for line in lines[bad..].iter().cycle() {
                if corrected.load(Ordering::Relaxed) {
                    return;
                }
                file.write_all(line).expect("a row");
                pass(Duration::from_millis(20));
            }
        });
        workshop.wait_for("SELECT count(*) FROM blocked_files", 1);
        let line = bad + 1;
        let message = format!("cannot be read beyond line {line} since 20%: %");
        for sql in [
            format!("SELECT count(*) FROM blocked_files WHERE robot = 'B' AND line = {line} AND message LIKE '{message}'"),
            format!(
                "SELECT count(*) FROM runs
                 WHERE status = 'streaming' AND reason_line = {line} AND blocked_at IS NOT NULL AND reason LIKE '{message}'"
            ),
        ] {
            assert_eq!(workshop.query(&sql), ["1"], "{sql}");
        }
        let health = workshop.query("SELECT DISTINCT status, reason FROM fleet_health");
        let said = format!("unknown|{} cannot be read beyond line {line} since ", growing.name);
        assert!(health.len() == 1 && health[0].starts_with(&said), "{health:?}");
        let status = text(&workshop.run(&["status"]).stdout);
        assert!(
            status.contains(&format!("blocked     {} cannot be read beyond line {line}", growing.name)),
            "{status}"
        );
        // the row is corrected, and the writer continues
        let mended = workshop.path("mended");
        fs::write(&mended, lines[..bad + 1].concat()).expect("written");
        corrected.store(true, Ordering::Relaxed);
        writer.join().expect("the writer");
        fs::rename(&mended, &path).expect("renamed");
        let mut file = fs::File::options().append(true).open(&path).expect("the file");
        file.write_all(&lines[bad + 1..].concat()).expect("the rest");
    });
    workshop.wait_for("SELECT count(*) FROM blocked_files", 0);
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 2);
    let reasons =
        workshop.query("SELECT status, reason FROM runs WHERE reason IS NOT NULL AND status <> 'superseded'");
    assert_eq!(reasons, [""; 0]);
    daemon.stop();
}
