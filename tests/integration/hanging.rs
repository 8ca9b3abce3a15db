//! Disks and file servers that do not answer, made with a library that is loaded before the C library and lets calls of
//! the real binary wait; and links that lead out of a watched folder.

use std::fs::{self, OpenOptions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use crate::http::{Answer, free_port, try_send};
use crate::small::{self, export};
use crate::support::{Daemon, LOG_LEVELS, Workshop, text, wait_until};

static LIBRARY: LazyLock<(tempfile::TempDir, PathBuf)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let library = folder.path().join("shim.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/integration/hanging/shim.c");
    let mut compiler = Command::new("cc");
    let compiled =
        compiler.args(["-O1", "-shared", "-fPIC", "-o"]).arg(&library).arg(source).arg("-ldl").output();
    let compiled = compiled.expect("a C compiler is there, as for the program itself");
    assert!(compiled.status.success(), "{}", text(&compiled.stderr));
    (folder, library)
});

/// A daemon whose calls of a kind hang on paths that contain `place`, as long as the file `hang` exists.
fn daemon(workshop: &Workshop, call: &str, place: &str) -> Daemon {
    let log = OpenOptions::new().create(true).append(true).open(workshop.path("daemon.log")).expect("a log");
    let mut command = workshop.command(&["run"]);
    command
        .env("LD_PRELOAD", &LIBRARY.1)
        .envs([("HANG_CALL", call), ("HANG_PATH", place)])
        .env("HANG_WHILE", workshop.path("hang"))
        .env("ARMWATCH_LOG", LOG_LEVELS)
        .stdout(Stdio::null())
        .stderr(log);
    Daemon { child: command.spawn().expect("the daemon starts") }
}

/// A folder with two watched ones and a port; `slowshare` hangs.
fn workshop() -> (Workshop, u16) {
    let (workshop, port) = (small::workshop(), free_port());
    fs::create_dir(workshop.path("slowshare")).expect("a folder");
    workshop.set("folders", "[\"slowshare\", \"inbox\"]");
    let path = workshop.path("armwatch.toml");
    let config = fs::read_to_string(&path).expect("a configuration");
    fs::write(path, format!("{config}\n[serve]\nlisten = \"127.0.0.1:{port}\"\n")).expect("written");
    fs::write(workshop.path("hang"), "").expect("written");
    (workshop, port)
}

fn put(workshop: &Workshop, folder: &str, robot: &str, seed: u32) {
    let export = export(robot, seed, 5);
    fs::write(workshop.path(folder).join(&export.name), &export.bytes).expect("written");
}

fn stored(robot: &str) -> String {
    format!("SELECT count(*) FROM runs WHERE status = 'complete' AND robot = '{robot}'")
}

fn get(port: u16, path: &str) -> Answer {
    try_send(port, &format!("GET {path}"), "", b"").expect("an answer")
}

fn ends_in_time(daemon: Daemon) {
    ends_in_time_with(daemon, 0);
}

fn ends_in_time_with(daemon: Daemon, status: i32) {
    let asked = Instant::now();
    daemon.signal("TERM");
    assert_eq!(daemon.end(), Some(status));
    assert!(asked.elapsed() < Duration::from_secs(40), "the unit kills it after 60 s: {:?}", asked.elapsed());
}

#[test]
fn a_folder_that_hangs_stops_no_other_and_is_told() {
    for call in ["opendir", "stat"] {
        let (workshop, port) = workshop();
        put(&workshop, "slowshare", "S", 1);
        let running = daemon(&workshop, call, "slowshare");
        put(&workshop, "inbox", "A", 2);
        workshop.wait_for(&stored("A"), 1);
        let said = || workshop.log().contains("not scanned since the start: no answer for 10 s");
        wait_until(said, || format!("{call}: {}", workshop.log()));
        put(&workshop, "inbox", "B", 3);
        workshop.wait_for(&stored("B"), 1);
        let status = workshop.stdout(&["status"], 0);
        assert!(status.contains("slowshare not scanned since the daemon started: no answer"), "{status}");
        let ready = get(port, "/ready");
        assert_eq!(
            (ready.status, ready.json()["folders_answer"].as_bool()),
            (503, Some(false)),
            "{}",
            ready.body
        );
        let answers =
            |folder: &serde_json::Value| (folder["answers"].as_bool(), folder["last_scan_at"].is_string());
        let folders: Vec<_> =
            ready.json()["folders"].as_array().expect("folders").iter().map(answers).collect();
        assert_eq!(folders, [(Some(true), true), (Some(false), false)], "{}", ready.body);
        let metrics = get(port, "/metrics").body;
        assert!(metrics.contains("slowshare\"} 0.0"), "never looked at: {metrics}");
        assert!(metrics.contains("slowshare\"} 0\n") && metrics.contains("inbox\"} 1\n"), "{metrics}");
        ends_in_time(running);

        // the folder answers again while a daemon runs
        let running = daemon(&workshop, call, "slowshare");
        wait_until(|| workshop.log().matches("not scanned since").count() == 2, || workshop.log());
        fs::remove_file(workshop.path("hang")).expect("removed");
        workshop.wait_for(&stored("S"), 1);
        wait_until(|| get(port, "/ready").status == 200, || get(port, "/ready").body);
        assert!(!workshop.stdout(&["status"], 0).contains("no answer"));
        ends_in_time(running);
    }
}

#[test]
fn an_export_that_hangs_stops_none_of_another_folder() {
    let (workshop, _) = workshop();
    for (robot, seed) in [("S", 1), ("T", 2), ("U", 3)] {
        put(&workshop, "slowshare", robot, seed);
    }
    let running = daemon(&workshop, "open", "slowshare/");
    let said = || workshop.log().contains("a read has not returned for 10 s");
    wait_until(said, || workshop.log());
    for (robot, seed) in [("A", 4), ("B", 5), ("C", 6)] {
        put(&workshop, "inbox", robot, seed);
        workshop.wait_for(&stored(robot), 1);
    }
    ends_in_time(running);
    assert!(
        workshop.log().contains("not finished, its disk or file server does not answer"),
        "{}",
        workshop.log()
    );
    fs::remove_file(workshop.path("hang")).expect("removed");
    let running = daemon(&workshop, "open", "slowshare/");
    ["S", "T", "U"].iter().for_each(|robot| workshop.wait_for(&stored(robot), 1));
    ends_in_time(running);
}

#[test]
fn an_archive_that_hangs_does_not_keep_the_daemon_from_its_end() {
    let (workshop, _) = workshop();
    fs::create_dir(workshop.path("archive")).expect("a folder");
    workshop.set("folders", "[\"inbox\"]");
    workshop.set("archive", "\"archive\"");
    let running = daemon(&workshop, "opendir", "archive");
    put(&workshop, "inbox", "A", 1);
    workshop.wait_for(&stored("A"), 1);
    ends_in_time(running);
}

/// A daemon that watches `inbox`, serves HTTP, and has `settings` at the end of its configuration.
fn served(settings: &str) -> (Workshop, u16) {
    let (workshop, port) = workshop();
    workshop.set("folders", "[\"inbox\"]");
    fs::remove_file(workshop.path("hang")).expect("removed");
    workshop.configure(|config| config + settings);
    (workshop, port)
}

/// Lets the disk of the daemon hang and waits for its message; returns the answers of `/ready` and the metrics after
/// that.
fn hangs(workshop: &Workshop, port: u16, what: &str) -> (Answer, String) {
    fs::write(workshop.path("hang"), "").expect("written");
    let said = || workshop.log().contains(&format!("the disk of {what} has not answered for 10 s"));
    wait_until(said, || workshop.log());
    // an answer is cached for a second
    wait_until(|| get(port, "/ready").status == 503, || get(port, "/ready").body);
    (get(port, "/ready"), get(port, "/metrics").body)
}

#[test]
fn a_database_whose_disk_hangs_is_told_and_keeps_the_daemon_from_no_end() {
    let (workshop, port) = served("");
    let running = daemon(&workshop, "write", &workshop.path("").display().to_string());
    put(&workshop, "inbox", "A", 1);
    workshop.wait_for(&stored("A"), 1);
    wait_until(|| get(port, "/ready").status == 200, || get(port, "/ready").body);
    fs::write(workshop.path("hang"), "").expect("written");
    put(&workshop, "inbox", "B", 2);
    let (ready, metrics) = hangs(&workshop, port, "the database");
    let (database, reason) = (&ready.json()["database"], &ready.json()["reason"]);
    assert_eq!(
        (database.as_bool(), reason.as_str()),
        (Some(false), Some("the disk of the database does not answer"))
    );
    assert!(metrics.contains("armwatch_disk_answers{disk=\"database\"} 0\n"), "{metrics}");
    assert!(metrics.contains("armwatch_database_up 0\n"), "{metrics}");
    ends_in_time_with(running, 74);
    assert!(workshop.log().contains("continues after the last stored cycle"), "{}", workshop.log());

    fs::remove_file(workshop.path("hang")).expect("removed");
    let running = daemon(&workshop, "write", "none");
    ["A", "B"].iter().for_each(|robot| workshop.wait_for(&stored(robot), 1));
    ends_in_time(running);
}

#[test]
fn a_snapshot_or_a_spool_whose_disk_hangs_stops_neither_the_exports_nor_the_end() {
    let folders = [
        ("copies", "the snapshot", "\n[snapshot]\nfile = \"copies/fleet.db\"\ninterval_min = 0.1\n"),
        ("spool", "the spool of uploads", "\n[serve.upload]\nspool = \"spool\"\n"),
    ];
    for (folder, what, settings) in folders {
        let (workshop, port) = served(settings);
        fs::create_dir_all(workshop.path(folder)).expect("a folder");
        let running = daemon(&workshop, "write", &format!("/{folder}/"));
        wait_until(
            || try_send(port, "GET /ready", "", b"").is_some_and(|of| of.status == 200),
            || workshop.log(),
        );
        put(&workshop, "inbox", "A", 1);
        let (ready, metrics) = hangs(&workshop, port, what);
        assert_eq!(ready.json()["database"].as_bool(), Some(true), "{}", ready.body);
        assert!(metrics.contains("armwatch_database_up 1\n"), "{metrics}");
        put(&workshop, "inbox", "B", 2);
        ["A", "B"].iter().for_each(|robot| workshop.wait_for(&stored(robot), 1));
        assert_eq!(get(port, "/health").status, 200);
        // the disk answers again while a daemon runs
        fs::remove_file(workshop.path("hang")).expect("removed");
        wait_until(|| workshop.log().contains("answers again"), || workshop.log());
        wait_until(|| get(port, "/ready").status == 200, || get(port, "/ready").body);
        hangs_again(&workshop, what);
        ends_in_time(running);
    }
}

/// Lets a disk hang a second time after it has answered.
fn hangs_again(workshop: &Workshop, what: &str) {
    fs::write(workshop.path("hang"), "").expect("written");
    let said = format!("the disk of {what} has not answered for 10 s");
    wait_until(|| workshop.log().matches(&said).count() == 2, || workshop.log());
}

#[test]
fn a_configuration_that_does_not_come_leaves_the_earlier_one_in_force() {
    let workshop = small::workshop();
    let running = workshop.daemon();
    workshop.wait_for_a_look();
    let config = workshop.path("armwatch.toml");
    fs::rename(&config, workshop.path("kept.toml")).expect("renamed");
    // opening it blocks, since it has no writer
    assert!(Command::new("mkfifo").arg(&config).status().expect("mkfifo runs").success());
    running.signal("HUP");
    let said = || workshop.log().contains("the configuration cannot be read: no answer for 5 s");
    wait_until(said, || workshop.log());
    put(&workshop, "inbox", "A", 1);
    let complete = || workshop.log().matches(" stored").count() > 0;
    wait_until(complete, || workshop.log());
    // a writer ends the wait, and its configuration is used
    let kept = fs::read_to_string(workshop.path("kept.toml")).expect("the configuration");
    fs::write(&config, kept).expect("written");
    wait_until(|| workshop.log().contains("configuration read again"), || workshop.log());
    running.signal("HUP");
    ends_in_time(running);
}

#[test]
fn a_link_publishes_no_secret() {
    let workshop = small::workshop();
    let secrets =
        ["0ed3d197c2b7a1f0a9d4e6b85c3f2710\n", "root:$y$j9T$hunter2:19000:0:99999:7:::\nuser:hunter2:1:2\n"];
    let links = ["A_20260301_0800.csv", "B_20260301_0800.csv"];
    for (number, (secret, link)) in secrets.iter().zip(links).enumerate() {
        let file = workshop.path(&format!("secret{number}"));
        fs::write(&file, secret).expect("written");
        symlink(&file, workshop.inbox(link)).expect("a link");
    }
    let shows = |text: &str| ["0ed3d197", "hunter2", "19000"].iter().any(|secret| text.contains(secret));
    let bytes = || {
        let read = |name: &str| fs::read(workshop.path(name)).unwrap_or_default();
        String::from_utf8_lossy(&[read("armwatch.db"), read("armwatch.db-wal")].concat()).into_owned()
    };
    put(&workshop, "inbox", "A", 1);
    let ingested = workshop.run(&["ingest", "inbox"]);
    let said = text(&ingested.stderr);
    assert_eq!(said.matches("is a link to a place outside the watched folder").count(), 2, "{said}");
    assert_eq!(workshop.query("SELECT source_name FROM quarantine"), [""; 0]);
    assert_eq!(workshop.number(&stored("A")), 1);
    assert!(!shows(&bytes()) && !shows(&said));
    let doctor = workshop.run(&["doctor", "--quick", "--json"]);
    assert_eq!(
        text(&doctor.stdout).matches("is a link to a place outside").count(),
        2,
        "{}",
        text(&doctor.stdout)
    );

    // the daemon lists them, without their targets
    let running = workshop.daemon();
    let listed = "SELECT count(*) FROM quarantine WHERE problem = 'a link to a place outside the watched \
        folder' AND remedy LIKE '%follow_links = true%'";
    workshop.wait_for(listed, 2);
    assert!(!workshop.stdout(&["quarantine", "list", "--json"], 0).contains("secret0"));
    fs::remove_file(workshop.inbox(links[1])).expect("removed");
    workshop.wait_for(listed, 1);
    symlink(workshop.path("secret1"), workshop.inbox(links[1])).expect("a link");
    workshop.wait_for(listed, 2);
    ends_in_time(running);

    // followed, because the setting says so: they are no exports, and their content is described
    workshop.set("follow_links", "true");
    let running = workshop.daemon();
    workshop.wait_for(
        "SELECT count(*) FROM quarantine WHERE problem LIKE 'not an export: the line has 1 column %'",
        2,
    );
    ends_in_time(running);
    assert!(!shows(&bytes()), "the database quotes a secret");
    assert!(!shows(&workshop.log()), "{}", workshop.log());
    let explained = workshop.run(&["quarantine", "explain", links[0]]);
    assert!(text(&explained.stdout).contains("0ed3d197"), "who may read the file is shown its line");
}

#[test]
fn a_file_with_a_time_ahead_is_read_again_when_it_is_corrected() {
    let workshop = small::workshop();
    let export = export("A", 1, 5);
    let path = workshop.inbox(&export.name);
    let ahead = std::time::SystemTime::UNIX_EPOCH + Duration::from_secs(1_893_456_000);
    let write = |bytes: &[u8], path: &Path| {
        fs::write(path, bytes).expect("written");
        OpenOptions::new().write(true).open(path).expect("a file").set_modified(ahead).expect("a time");
    };
    write(&export.bytes, &path);
    let running = workshop.daemon();
    workshop.wait_for(&stored("A"), 1);
    // of the same size, in place and then by a rename
    for number in [2, 3] {
        let mut corrected = export.bytes.clone();
        let at = corrected.iter().rposition(u8::is_ascii_digit).expect("a digit");
        let point = corrected[..at].iter().rposition(|byte| *byte == b'.').expect("decimals");
        corrected[point + 1] = b'0' + (corrected[point + 1] - b'0' + number) % 10;
        if number == 2 {
            write(&corrected, &path);
        } else {
            write(&corrected, &workshop.path("corrected"));
            fs::rename(workshop.path("corrected"), &path).expect("renamed");
        }
        workshop.wait_for("SELECT count(*) FROM runs", number.into());
    }
    ends_in_time(running);
}

#[test]
fn secrets_that_others_may_read_are_told() {
    let workshop = small::workshop();
    let token = workshop.path("token");
    fs::write(&token, "0ed3d197c2b7a1f0a9d4e6b85c3f2710\n").expect("written");
    fs::set_permissions(&token, fs::Permissions::from_mode(0o644)).expect("permissions");
    let path = workshop.path("armwatch.toml");
    let config = fs::read_to_string(&path).expect("a configuration");
    let port = free_port();
    let serve = format!("\n[serve]\nlisten = \"127.0.0.1:{port}\"\ntoken_file = \"{}\"\n", token.display());
    fs::write(path, config + &serve).expect("written");
    const SAID: &str = "is readable by every user of this computer";
    let checked = workshop.stdout(&["config", "check"], 0);
    assert!(checked.contains(SAID), "{checked}");
    let doctor = workshop.run(&["doctor", "--quick"]);
    assert!(text(&doctor.stdout).contains(SAID), "{}", text(&doctor.stdout));
    let running = workshop.daemon();
    wait_until(|| workshop.log().contains(SAID), || workshop.log());
    ends_in_time(running);
    fs::set_permissions(&token, fs::Permissions::from_mode(0o600)).expect("permissions");
    assert!(!workshop.stdout(&["config", "check"], 0).contains("is readable by"));
}
