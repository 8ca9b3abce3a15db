//! `armwatch simulate`: refused arguments, and messages about faults.

use std::fs;
use std::path::Path;

use crate::support::Workshop;

/// An export of a few seconds.
const SHORT: [&str; 8] = ["simulate", "-o", "made", "--cycles", "1", "--warming-s", "0", "--levels=none"];

/// Runs the simulator and returns its standard error.
fn said(workshop: &Workshop, more: &[&str], code: i32) -> String {
    workshop.stderr(&[&SHORT[..], more].concat(), code)
}

fn files(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder").flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn exports_that_are_there_are_replaced_and_told() {
    let workshop = Workshop::new();
    let told = said(&workshop, &["--runs", "2"], 0);
    assert!(!told.contains("replaced"), "{told}");
    let made = files(&workshop.path("made"));
    assert_eq!(made.len(), 4, "{made:?}");
    let told = said(&workshop, &["--runs", "3", "--seed", "2"], 0);
    for part in [made[0].as_str(), "and 1 more export are there already and will be replaced"] {
        assert!(told.contains(part), "{part}: {told}");
    }
    let told = said(&workshop, &["--name", "R02"], 0);
    assert!(!told.contains("replaced"), "{told}");
}

#[test]
fn a_start_that_no_export_has_is_refused_with_those_that_are_taken() {
    let workshop = Workshop::new();
    for start in ["9000-01-01T00:00:00Z", "1970-01-01T00:00:00Z"] {
        let refused = said(&workshop, &["--start", start], 2);
        assert!(
            refused.contains(&format!("--start {start}")) && refused.contains("1980 to 2199"),
            "{refused}"
        );
    }
    assert!(!workshop.path("made").exists(), "nothing is written");
    // the first and the last permitted starts can be read
    said(&workshop, &["--start", "1980-01-01T00:00:00Z"], 0);
    said(&workshop, &["--start", "2199-12-31T23:59:00Z"], 0);
    let exports: Vec<String> =
        files(&workshop.path("made")).into_iter().filter(|name| name.ends_with(".csv")).collect();
    assert_eq!(exports.len(), 2, "{exports:?}");
    for (export, start) in exports.iter().zip(["1980-01-01T00:00:00Z", "2199-12-31T23:59:00Z"]) {
        let told = workshop.stdout(&["explain", &format!("made/{export}"), "--quick"], 0);
        assert!(told.contains(start), "{told}");
    }
}

#[test]
fn a_fault_that_no_export_shows_is_told() {
    let workshop = Workshop::new();
    let told = said(&workshop, &["--fault", "wear:joint=1,from=6,rate=0.1"], 0);
    assert!(told.contains("it begins with run 6, and there is 1 run; give more --runs"), "{told}");
    let told = said(&workshop, &["--fault", "wear:joint=1,from=1,rate=0.1", "--name", "R02"], 0);
    assert!(!told.contains("--fault"), "{told}");
}

#[test]
fn a_programme_or_points_that_are_not_there_are_a_wrong_command_line() {
    let workshop = Workshop::new();
    fs::write(workshop.path("binary"), [0xff, 0xfe, 0]).expect("written");
    let absent = "none: there is no such file or folder; check the name";
    for (more, part) in [
        (&["--trajectory", "none"][..], absent),
        (&["--parts", "points", "--points", "none"], absent),
        (&["--trajectory", "binary"], "binary: is not UTF-8 text from byte 0"),
        (&["--trajectory", "inbox"], "inbox: is a folder; name a file"),
    ] {
        let refused = said(&workshop, more, 2);
        assert!(refused.contains(part), "{refused}");
    }
    assert!(!workshop.path("made").exists());
}

/// For a folder that cannot be created, every command that writes several files prints a remedy.
#[test]
fn where_nothing_can_be_written_a_remedy_is_said() {
    let workshop = Workshop::new();
    fs::write(workshop.path("file"), "").expect("written");
    for arguments in
        [&["man", "file/pages"][..], &["config", "init", "file/config"], &["simulate", "-o", "file/exports"]]
    {
        let refused = workshop.stderr(arguments, 74);
        assert!(refused.contains("cannot write file/"), "{refused}");
        assert!(refused.contains("; there is a file instead of a folder; name another folder"), "{refused}");
    }
}
