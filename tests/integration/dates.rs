//! Recordings with impossible starts, and files whose names may be another robot's.

use std::fs;
use std::path::{Path, PathBuf};

use crate::small::{self, export};
use crate::support::{Workshop, text};

/// Sixteen tests of R01 with growing friction of joint 3 from the ninth on, oldest first.
fn worn(workshop: &Workshop) -> Vec<PathBuf> {
    let shape = ["--runs", "16", "--cycles", "2", "--warming-s", "0", "--name", "R01", "--seed", "31"];
    let wear = ["--fault", "wear:joint=3,from=9,rate=0.08"];
    let mut files = workshop.simulate("made", &[&shape[..], &wear[..]].concat());
    files.sort();
    files
}

fn add(workshop: &Workshop, files: &[PathBuf], name: impl Fn(usize, &Path) -> String) {
    for (at, file) in files.iter().enumerate() {
        fs::copy(file, workshop.inbox(&name(at, file))).expect("copied");
    }
}

fn own(_: usize, file: &Path) -> String {
    file.file_name().expect("a name").to_string_lossy().into_owned()
}

const ALARM: &str =
    "SELECT count(*) FROM anomalies WHERE joint = 3 AND severity <> 'info' AND state = 'open'";

#[test]
fn wear_is_told_beside_tests_of_another_century_and_these_are_named() {
    let workshop = Workshop::new();
    let files = worn(&workshop);
    add(&workshop, &files[..6], own);
    workshop.stdout(&["ingest", "inbox"], 0);
    add(&workshop, &files[6..9], |at, _| format!("R01_2099030{}_0847_x.csv", at + 1));
    let said = text(&workshop.run(&["ingest", "inbox"]).stderr);
    assert!(
        said.contains("days after the file arrived") && said.contains("armwatch run-date 7 --at TIME"),
        "{said}"
    );
    let status = workshop.stdout(&["status"], 0);
    assert!(
        status.contains("the last 3 tests have no place in the order of the others")
            && status.contains("R01_20990303_0847_x.csv (run 9) is dated 2099-03-03"),
        "{status}"
    );
    assert_eq!(workshop.query("SELECT DISTINCT status FROM fleet_health"), ["unknown"]);
    add(&workshop, &files[9..], own);
    workshop.stdout(&["ingest", "inbox"], 0);
    assert!(workshop.number(ALARM) > 0, "{}", workshop.stdout(&["status"], 0));
    assert_eq!(
        workshop.query("SELECT joint, kind, quantity, state FROM anomalies WHERE severity = 'info'"),
        ["|sensor|implausible_date|open"]
    );

    let next = workshop.path("R01_21060207_0847_x.csv");
    fs::copy(&files[15], &next).expect("copied");
    let mut longer = fs::read_to_string(&next).expect("an export");
    longer.push('\n');
    fs::write(&next, longer).expect("written");
    let explained = workshop.stdout(&["explain", "--quick", next.to_str().expect("a path")], 0);
    assert!(explained.contains("the start cannot be right: dated 2106-02-07 08:47Z"), "{explained}");

    // an operator corrects them; the corrections survive rereading and a restart
    for (run, day) in [(7, "11"), (8, "12"), (9, "13")] {
        let at = format!("2026-01-{day}T08:47");
        workshop.stdout(&["run-date", &run.to_string(), "--at", &at], 0);
    }
    let runs =
        "SELECT started_at, recorded_start_at, status FROM runs WHERE run_id BETWEEN 7 AND 9 ORDER BY run_id";
    let corrected = workshop.query(runs);
    assert_eq!(corrected[0], "2026-01-11T08:47:00.000Z|2099-03-01T08:47:00.000Z|complete");
    workshop.stdout(&["ingest", "--again", "7"], 0);
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.query(runs), corrected);
    assert!(workshop.number(ALARM) > 0);
    assert_eq!(
        workshop
            .number("SELECT count(*) FROM anomalies WHERE quantity = 'implausible_date' AND state = 'open'"),
        0
    );
    // corrections to a time in the future are refused
    for future in [&["--at", "2099-01-11T08:47"][..], &["--as-recorded"]] {
        workshop.stdout(&["run-date", "8", "--undo"], 0);
        let refused = workshop.run(&[&["run-date", "8"], future].concat());
        let said = text(&refused.stderr);
        assert!(!refused.status.success() && said.contains("later than now"), "{said}");
        assert!(said.contains("--force"), "{said}");
        workshop.stdout(&[&["run-date", "8"], future, &["--force"]].concat(), 0);
    }
    workshop.stdout(&["run", "date", "7", "--undo"], 0);
    assert_eq!(workshop.query(runs)[0], "2099-03-01T08:47:00.000Z||set_aside");
}

#[test]
fn names_that_may_be_another_robots_are_questioned() {
    let workshop = small::workshop();
    let take = |name: &str, seed: u32| {
        fs::write(workshop.inbox(name), &export("A", seed, 5).bytes).expect("an export");
        let output = workshop.run(&["ingest", workshop.inbox(name).to_str().expect("a path")]);
        (output.status.code(), format!("{}{}", text(&output.stdout), text(&output.stderr)))
    };
    let (code, said) = take("myarm.csv", 1);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("recognition.file_name does not match the name"), "{said}");
    let status = workshop.stdout(&["status"], 0);
    assert!(status.contains("new robot   myarm, by its only test myarm.csv"), "{status}");
    for (seed, name, why) in [
        (2, "MyArm.csv", "differs from \"myarm\" only in case"),
        (3, "myarm (1).csv", "named as a copy of an export of myarm"),
        (4, "myarm - Copy.csv", "named as a copy of an export of myarm"),
        (5, "Kopie von myarm_20260105_0847.csv", "named as a copy of an export of myarm"),
        (6, "KR7-01.03.2026 08-00.csv", "does not match recognition.file_name"),
    ] {
        let (code, said) = take(name, seed);
        assert!(code == Some(1) && said.contains(why), "{name}: {said}");
    }
    let robots = "SELECT robot FROM runs WHERE status <> 'quarantined'";
    assert_eq!(workshop.query(robots), ["myarm"]);
    // one robot in two forms of Unicode
    take("Gr\u{f6}\u{df}e_20260105_0847.csv", 7);
    take("Gro\u{308}\u{df}e_20260106_0847.csv", 8);
    assert_eq!(workshop.query("SELECT DISTINCT robot FROM runs WHERE robot LIKE 'Gr%'"), ["Gr\u{f6}\u{df}e"]);

    // the only run of a robot
    workshop.stdout(&["run", "set-aside", "1"], 0);
    assert_eq!(workshop.query("SELECT status FROM runs WHERE run_id = 1"), ["set_aside"]);
    assert!(!workshop.stdout(&["status"], 0).contains("myarm"));
    assert!(workshop.stdout(&["runs", "--status", "set_aside"], 0).contains("myarm.csv"));
    workshop.stdout(&["ingest", "inbox/myarm.csv"], 0);
    assert_eq!(workshop.query("SELECT status FROM runs WHERE run_id = 1"), ["set_aside"]);
    workshop.stdout(&["set-aside", "1", "--undo"], 0);
    assert_eq!(workshop.query("SELECT status FROM runs WHERE run_id = 1"), ["complete"]);
}
