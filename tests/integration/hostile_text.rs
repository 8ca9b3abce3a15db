//! Names that forge lines, contain commands to terminals, hide characters or are no text at all. No output contains
//! them unescaped; they stay different and lead to their files.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::PathBuf;
use std::process::Output;

use crate::robot_code;
use crate::small::{export, workshop};
use crate::support::{Workshop, text};

/// Names of robots in files, and their form in lines for users.
fn hostile() -> Vec<(Vec<u8>, String)> {
    let plain = |name: &str, shown: &str| (name.as_bytes().to_vec(), shown.to_owned());
    vec![
        plain("A\u{1b}]0;title\u{7}", "A\\u{1b}]0;title\\u{7}"),
        plain("B\nstored       forged.csv: robot X", "B\\nstored       forged.csv: robot X"),
        plain("C\r\n00:00:00Z ERROR forged", "C\\r\\n00:00:00Z ERROR forged"),
        plain("D\u{9b}31m\u{7f}", "D\\u{9b}31m\\u{7f}"),
        plain("E\u{202e}vsc", "E\\u{202e}vsc"),
        plain("F\u{2066}x\u{2069}\u{61c}\u{200f}", "F\\u{2066}x\\u{2069}\\u{61c}\\u{200f}"),
        plain("G\u{200b}\u{feff}\u{ad}", "G\\u{200b}\\u{feff}\\u{ad}"),
        plain("H\u{2028}\u{2029}", "H\\u{2028}\\u{2029}"),
        plain("I--><b>*\\", "I--><b>*\\"),
        plain("J\"\"\"'; DROP", "J\"\"\"'; DROP"),
        (b"lat\xe9in".to_vec(), "lat\\xE9in".to_owned()),
        (b"lat\xe8in".to_vec(), "lat\\xE8in".to_owned()),
        plain("lat\\xE9in", "lat\\x5CxE9in"),
        plain(&"K".repeat(240), &"K".repeat(240)),
    ]
}

/// The path of a file of this name in a folder.
fn at(workshop: &Workshop, folder: &str, name: &[u8], ending: &str) -> PathBuf {
    workshop.path(folder).join(OsString::from_vec([name, ending.as_bytes()].concat()))
}

/// Puts a different export for each name into a folder.
fn put(workshop: &Workshop, folder: &str) {
    for ((name, _), seed) in hostile().iter().zip(1..) {
        fs::write(at(workshop, folder, name, ".csv"), export("R", seed, 5).bytes).expect("written");
    }
}

/// Characters that a terminal executes or does not show.
fn is_hidden(character: char) -> bool {
    character.is_control()
        || matches!(character, '\u{ad}' | '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

/// The output of a command, asserted to contain no hidden character.
fn said(output: &Output) -> String {
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(!said.contains(|c| c != '\n' && is_hidden(c)), "{said:?}");
    said
}

fn json(line: &str) -> serde_json::Value {
    serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"))
}

#[test]
fn commands_show_each_name_on_its_line_and_json_has_it_as_it_is() {
    let workshop = workshop();
    put(&workshop, "inbox");
    let names = hostile();
    let ingested = said(&workshop.run(&["ingest", "inbox"]));
    let stored: Vec<&str> = ingested.lines().filter(|line| line.starts_with("stored ")).collect();
    assert_eq!(stored.len(), names.len(), "{ingested}");
    for (_, shown) in &names {
        let is_of = |line: &&&str| line.contains(&format!("robot {shown}, run "));
        assert_eq!(stored.iter().filter(is_of).count(), 1, "{shown}\n{ingested}");
    }
    assert_eq!(workshop.number("SELECT count(DISTINCT robot) FROM runs"), names.len() as i64);

    for command in [&["status"][..], &["runs"], &["robots"], &["sql", "SELECT robot, source_name FROM runs"]]
    {
        let listed = said(&workshop.run(command));
        for (_, shown) in &names {
            let is_of = |line: &&str| line.contains(shown.as_str());
            assert!(listed.lines().any(|line| is_of(&line)), "{command:?}: {shown}\n{listed}");
        }
    }
    let as_json = said(&workshop.run(&["runs", "--json"]));
    let robots: Vec<String> =
        as_json.lines().map(|line| json(line)["robot"].as_str().expect("a name").to_owned()).collect();
    for (name, shown) in &names {
        // JSON has text unchanged, and escapes other bytes
        let expected =
            std::str::from_utf8(name).ok().filter(|name| !name.starts_with("lat")).unwrap_or(shown);
        assert!(robots.iter().any(|robot| robot == expected), "{expected:?}\n{robots:?}");
    }
    let odd = workshop.run(&["explain", "--quick", "inbox/A\u{1b}]0;title\u{7}.csv"]);
    assert!(said(&odd).contains("A\\u{1b}]0;title"), "{odd:?}");
    let unknown = workshop.run(&["runs", "--robot", "none\n\u{202e}"]);
    assert!(said(&unknown).contains("none\\n\\u{202e}"), "{unknown:?}");
}

#[test]
fn each_event_of_the_daemon_is_one_line() {
    for format in ["text", "json"] {
        let workshop = workshop();
        put(&workshop, "inbox");
        for ((name, _), number) in hostile().iter().zip(1..) {
            let odd = format!("time,pos_1\n0,{number}\n");
            fs::write(at(&workshop, "inbox", name, "_odd.csv"), odd).expect("written");
        }
        let mut daemon = {
            let log = fs::File::create(workshop.path("daemon.log")).expect("a log");
            let mut command = workshop.command(&["run", "--log-format", format]);
            command.stdout(std::process::Stdio::null()).stderr(log);
            crate::support::Daemon { child: command.spawn().expect("the daemon starts") }
        };
        let all = 2 * hostile().len() as i64;
        workshop.wait_for("SELECT count(*) FROM runs WHERE status IN ('complete', 'quarantined')", all);
        workshop.wait_for_conclusions();
        daemon.child.kill().expect("killed");
        daemon.child.wait().expect("an end");
        let log = workshop.log();
        assert!(!log.contains(|c| c != '\n' && is_hidden(c)), "{log:?}");
        let stored = match format {
            "json" => log.lines().filter(|line| json(line)["message"] == "stored").count(),
            _ => {
                assert!(log.lines().all(|line| line.starts_with("20") && line.contains("Z ")), "{log}");
                log.lines().filter(|line| line.contains(" INFO stored ")).count()
            }
        };
        assert_eq!(stored, hostile().len(), "{log}");
    }
}

#[test]
fn a_name_that_is_no_text_is_found_again_by_its_bytes() {
    let workshop = workshop();
    let spoiled = |seed| export("R", seed, 5).spoiled().bytes;
    let path = at(&workshop, "inbox", b"lat\xe9in", ".csv");
    fs::write(&path, spoiled(1)).expect("written");
    fs::write(at(&workshop, "inbox", b"lat\xe8in", ".csv"), spoiled(2)).expect("written");
    fs::write(at(&workshop, "inbox", b"lat\\xE9in", ".csv"), spoiled(3)).expect("written");
    workshop.run(&["ingest", "inbox"]);
    assert_eq!(workshop.number("SELECT count(DISTINCT robot) FROM runs WHERE status = 'quarantined'"), 3);
    let run = workshop.number("SELECT run_id FROM runs WHERE robot = 'lat\\xE9in'").to_string();
    let shown = json(workshop.stdout(&["quarantine", "explain", &run, "--json"], 0).trim_end());
    assert_eq!(shown["content"], "unchanged", "{shown}");
    // the corrected file is found by its path in the ledger
    fs::write(&path, export("R", 1, 5).bytes).expect("written");
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM runs WHERE robot = 'lat\\xE9in' AND status = 'complete'", 1);
    daemon.stop();
    let known = workshop.number("SELECT count(*) FROM source_file");
    let again = workshop.daemon();
    workshop.wait_until_idle();
    again.stop();
    assert_eq!(workshop.number("SELECT count(*) FROM source_file"), known, "no file is new");
    let name = path.file_name().map(OsStr::as_bytes);
    assert_eq!(name, Some(&b"lat\xe9in.csv"[..]));
    let run = workshop
        .number("SELECT run_id FROM runs WHERE robot = 'lat\\xE9in' AND status = 'complete'")
        .to_string();
    let replayed = workshop.run(&["torque", "--run", &run, "--cycle", "1"]);
    assert!(!text(&replayed.stderr).contains("is not available"), "{}", text(&replayed.stderr));
}

#[test]
fn an_arm_with_a_hostile_name_becomes_files_that_other_programs_read() {
    let workshop = Workshop::new();
    let made = workshop.simulate("made", &["--cycles", "2", "--warming-s", "0"]);
    let name = "R--->\u{1b}\u{202e}*\\\u{200b}\"\"\"<&\u{2028}\u{9b}".as_bytes();
    fs::copy(&made[0], at(&workshop, "inbox", name, ".csv")).expect("a copy");
    said(&workshop.run(&["ingest", "inbox"]));
    said(&workshop.run(&["robot", "urdf", "--run", "1", "-o", "arm.urdf"]));
    let urdf = fs::read_to_string(workshop.path("arm.urdf")).expect("the file");
    assert!(!urdf.contains(|c| c != '\n' && is_hidden(c)), "{urdf:?}");
    for event in xml::EventReader::from_str(&urdf) {
        event.unwrap_or_else(|error| panic!("{error}\n{urdf}"));
    }
    assert!(urdf.contains("robot R- - -"), "{urdf}");
    let languages = ["--language", "c", "--language", "rust", "--language", "python"];
    said(&workshop.run(&[&["robot", "code", "--run", "1", "-o", "code"][..], &languages].concat()));
    for file in fs::read_dir(workshop.path("code")).expect("a folder") {
        let code = fs::read_to_string(file.expect("a file").path()).expect("text");
        assert!(!code.contains(|c| c != '\n' && is_hidden(c)), "{code:?}");
    }
    robot_code::assert_agrees(&workshop.path("code"));
    said(&workshop.run(&["report", "1", "-o", "run.html"]));
    let page = fs::read_to_string(workshop.path("run.html")).expect("the page");
    assert!(!page.contains(|c| !matches!(c, '\n' | '\t') && is_hidden(c)));
}
