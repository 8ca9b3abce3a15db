//! Findings of `armwatch doctor` about a machine, and the daemon's messages to a service manager.

use std::fs::{self, File};
use std::io::{Seek, SeekFrom, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixDatagram;
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;

use crate::reading::{as_another_user, can_be_another_user, small_change};
use crate::small::{self, export};
use crate::support::{Workshop, text, wait_until};

/// A database of one test.
fn stored() -> Workshop {
    let workshop = small::workshop();
    workshop.add(&export("A", 5, 5));
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop
}

/// Check, level and sentence of each finding.
fn findings(json: &str) -> Vec<(String, String, String)> {
    let one = |line: &str| {
        let value: Value = serde_json::from_str(line).expect("an object a line");
        let text = |key: &str| value[key].as_str().expect(key).to_owned();
        assert!(text("level") == "ok" || !text("remedy").is_empty(), "no remedy: {line}");
        (text("check"), text("level"), text("said"))
    };
    json.lines().map(one).collect()
}

fn problems(json: &str) -> Vec<(String, String)> {
    let found = findings(json).into_iter().filter(|(_, level, _)| level == "problem");
    found.map(|(check, _, said)| (check, said)).collect()
}

#[test]
fn a_sound_database_is_fit_and_a_damaged_page_is_found() {
    let workshop = stored();
    let before = fs::read(workshop.path("armwatch.db")).expect("the database");
    let sound = workshop.run(&["doctor", "--json"]);
    let of_machine = ["disk", "shares", "limits", "clock", "unit"];
    let of_database: Vec<_> = problems(&text(&sound.stdout))
        .into_iter()
        .filter(|(check, _)| !of_machine.contains(&check.as_str()))
        .collect();
    assert_eq!(of_database, [], "{}", text(&sound.stdout));
    let checks: Vec<String> = findings(&text(&sound.stdout)).into_iter().map(|(check, ..)| check).collect();
    for check in ["configuration", "time zone", "permissions", "copies", "database", "integrity"]
        .iter()
        .chain(&of_machine)
    {
        assert!(checks.iter().any(|of| of == check), "{check} is not among {checks:?}");
    }
    assert!(fs::read(workshop.path("armwatch.db")).expect("the database") == before, "it was written to");

    // pages in the middle of the file, after those with the schema
    let mut file = File::options().write(true).open(workshop.path("armwatch.db")).expect("the database");
    file.seek(SeekFrom::Start(before.len() as u64 / 2 / 4096 * 4096)).expect("a place");
    file.write_all(&[0xA5; 16 * 4096]).expect("written");
    drop(file);
    let damaged = workshop.run(&["doctor", "--json"]);
    assert_eq!(damaged.status.code(), Some(1), "{}", text(&damaged.stderr));
    let found = problems(&text(&damaged.stdout));
    assert!(found.iter().any(|(check, _)| check == "integrity"), "{found:?}");
    let quick = workshop.run(&["doctor", "--json", "--quick"]);
    let found = problems(&text(&quick.stdout));
    assert!(!found.iter().any(|(check, _)| check == "integrity"), "{found:?}");
}

#[test]
fn a_configuration_that_cannot_be_used_is_all_that_is_told() {
    let workshop = stored();
    workshop.set("database", "7");
    let refused = workshop.stdout(&["doctor", "--json"], 2);
    let found = findings(&refused);
    assert!(
        !found.is_empty()
            && found.iter().all(|(check, level, _)| check == "configuration" && level == "problem")
    );
    let plain = workshop.stdout(&["doctor"], 2);
    assert!(plain.contains("problem  configuration: ") && plain.contains("database"), "{plain}");
}

#[test]
fn a_later_run_than_now_and_a_folder_that_may_not_be_written_to_are_problems() {
    let workshop = stored();
    small_change(&workshop.path("armwatch.db"), "UPDATE run SET ingested_at = 7258118400000000");
    let found = problems(&text(&workshop.run(&["doctor", "--json"]).stdout));
    assert!(found.iter().any(|(check, said)| check == "clock" && said.contains("2200-01-01")), "{found:?}");

    if !can_be_another_user(&workshop) {
        return;
    }
    fs::set_permissions(workshop.path(""), fs::Permissions::from_mode(0o555)).expect("permissions");
    let output = as_another_user(&workshop, &["doctor", "--json"]);
    fs::set_permissions(workshop.path(""), fs::Permissions::from_mode(0o755)).expect("permissions");
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let found = problems(&text(&output.stdout));
    let is_folder =
        |said: &str| said.starts_with("the folder of the database") && said.contains("is not writable");
    assert!(found.iter().any(|(check, said)| check == "permissions" && is_folder(said)), "{found:?}");
}

#[test]
fn a_service_manager_hears_that_the_daemon_works_is_alive_and_ends() {
    let workshop = small::workshop();
    let path = workshop.path("notify");
    let socket = UnixDatagram::bind(&path).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(60))).expect("a limit");
    let mut command = workshop.command(&["run"]);
    command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "200000").env_remove("WATCHDOG_PID");
    let mut daemon =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    let mut heard = Vec::new();
    let mut listen = |until: &str, times: usize| {
        while heard.iter().filter(|of: &&String| of.starts_with(until)).count() < times {
            let mut bytes = [0; 4096];
            let length = socket.recv(&mut bytes).unwrap_or_else(|error| panic!("{until}: {error}"));
            heard.push(String::from_utf8_lossy(&bytes[..length]).trim().to_owned());
        }
        heard.clone()
    };
    assert_eq!(listen("READY=1", 1), ["READY=1"], "the first thing that is said");
    listen("STATUS=0 exports being read, 0 wait, 0 robots to conclude", 1);
    listen("WATCHDOG=1", 3);
    let stopped = Command::new("kill").arg(daemon.id().to_string()).status().expect("kill");
    assert!(stopped.success());
    listen("STOPPING=1", 1);
    wait_until(|| daemon.try_wait().expect("a child").is_some(), || "the daemon does not end".into());
    assert_eq!(daemon.wait().expect("a child").code(), Some(0));
}
