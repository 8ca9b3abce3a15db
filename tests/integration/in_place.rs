//! The database file and its path: replacement while a program has it open, and one daemon for all its names.

use std::fs;
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt;
use std::process::{Command, Stdio};

use crate::http;
use crate::small::{self, export};
use crate::support::{Workshop, text, wait_until};

const MOVED: &str = "was moved, deleted or replaced while it was open";

/// A folder with a served database in `data`, and an archive.
fn workshop(port: u16) -> Workshop {
    let workshop = small::workshop();
    workshop.set("archive", "\"archive\"");
    let more = format!("database = \"data/armwatch.db\"\n[serve]\nlisten = \"127.0.0.1:{port}\"\n");
    workshop.configure(|config| more + &config);
    workshop
}

fn put(workshop: &Workshop, robot: &str, seed: u32, day: u32) -> std::path::PathBuf {
    let export = export(robot, seed, day);
    let path = workshop.inbox(&export.name);
    fs::write(&path, &export.bytes).expect("written");
    path
}

#[test]
fn a_daemon_whose_database_goes_from_its_path_ends_and_archives_nothing_more() {
    type Change = fn(&Workshop);
    let ways: [(&str, Change); 3] = [
        ("replaced by a backup", |workshop| {
            let database = workshop.path("data/armwatch.db");
            fs::rename(workshop.path("backup.db"), &database).expect("restored");
            for end in ["-wal", "-shm"] {
                let _ = fs::remove_file(format!("{}{end}", database.display()));
            }
        }),
        ("deleted", |workshop| fs::remove_file(workshop.path("data/armwatch.db")).expect("deleted")),
        ("folder renamed", |workshop| {
            fs::rename(workshop.path("data"), workshop.path("other")).expect("renamed");
        }),
    ];
    for (way, change) in ways {
        let workshop = workshop(http::free_port());
        let first = put(&workshop, "A", 1, 5);
        let daemon = workshop.daemon();
        wait_until(|| !first.exists(), || format!("{way}: not archived\n{}", workshop.log()));
        workshop.stdout(&["backup", "backup.db"], 0);
        change(&workshop);
        let later = put(&workshop, "A", 2, 6);
        assert_eq!(daemon.end(), Some(74), "{way}: {}", workshop.log());
        assert!(later.exists(), "{way}: archived\n{}", workshop.log());
        // the error is reported after the log is closed, with the remedy
        let said = workshop.log();
        assert!(said.contains(MOVED) && said.contains("start again"), "{way}: {said}");
        if way == "folder renamed" {
            fs::rename(workshop.path("other"), workshop.path("data")).expect("back");
        }
        // after a restart, the daemon uses the present database and reads the rest
        let daemon = workshop.daemon();
        wait_until(|| !later.exists(), || format!("{way}: not archived\n{}", workshop.log()));
        daemon.signal("TERM");
        assert_eq!(daemon.end(), Some(0), "{way}: {}", workshop.log());
        let runs =
            workshop.stdout(&["sql", "--csv", "SELECT count(*) FROM runs WHERE status = 'complete'"], 0);
        assert_eq!(runs.lines().last(), Some("2"), "{way}");
    }
}

#[test]
fn readiness_and_metrics_know_that_the_database_is_gone_before_the_daemon_looks() {
    let port = http::free_port();
    let workshop = workshop(port);
    workshop.set("scan_interval_s", "3600");
    let daemon = workshop.daemon();
    let asked = |line: &str| http::try_send(port, line, "", b"");
    let is_ready = || asked("GET /ready").is_some_and(|answer| answer.status == 200);
    wait_until(is_ready, || format!("it does not come up\n{}", workshop.log()));
    assert!(asked("GET /metrics").expect("figures").body.contains("\narmwatch_database_up 1\n"));
    assert_eq!(asked("GET /ready").expect("an answer").json()["reason"], serde_json::Value::Null);
    fs::remove_file(workshop.path("data/armwatch.db")).expect("deleted");
    // an answer is cached for a second
    wait_until(|| !is_ready(), || "it stays ready".to_owned());
    let said = asked("GET /ready").expect("an answer").json();
    assert_eq!((&said["ready"], &said["database"]), (&false.into(), &false.into()), "{said}");
    assert_eq!(said["reason"], "the open database is no longer the file at its path");
    assert!(asked("GET /metrics").expect("figures").body.contains("\narmwatch_database_up 0\n"));
    assert_eq!(asked("GET /v1/fleet").expect("an answer").status, 500);
    daemon.signal("TERM");
    assert_eq!(daemon.end(), Some(74), "{}", workshop.log());
}

#[test]
fn a_second_daemon_is_refused_under_every_name_of_the_database() {
    let workshop = small::workshop();
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    fs::create_dir(workshop.path("sub")).expect("a folder");
    symlink(workshop.path("armwatch.db"), workshop.path("sub/symbolic.db")).expect("a link");
    fs::hard_link(workshop.path("armwatch.db"), workshop.path("sub/hard.db")).expect("a link");
    symlink(workshop.path(""), workshop.path("folder")).expect("a link");
    for name in ["armwatch.db", "sub/../armwatch.db", "sub/symbolic.db", "folder/armwatch.db", "sub/hard.db"]
    {
        let said = workshop.stderr(&["run", "--db", name], 74);
        assert!(said.contains("another armwatch daemon"), "{name}: {said}");
    }
    daemon.stop();
    assert_eq!(workshop.query("PRAGMA integrity_check"), ["ok"]);
}

/// A first start as root leaves a lock file that the user of the service cannot open.
#[test]
fn a_lock_file_of_root_is_named_by_the_daemon_and_by_doctor() {
    const USER: u32 = 65_534;
    let workshop = small::workshop();
    workshop.stdout(&["ingest", "inbox"], 0);
    let lock = workshop.path("armwatch.db.daemon");
    fs::write(&lock, "1\n").expect("a lock file");
    fs::set_permissions(&lock, std::os::unix::fs::PermissionsExt::from_mode(0o600)).expect("private");
    fs::set_permissions(workshop.path(""), std::os::unix::fs::PermissionsExt::from_mode(0o755))
        .expect("open");
    let own = |name: &str| std::os::unix::fs::chown(workshop.path(name), Some(USER), Some(USER));
    let as_user = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_armwatch"));
        command.args(arguments).current_dir(workshop.path("")).stdin(Stdio::null()).uid(USER).gid(USER);
        command.output().ok().filter(|_| own("").is_ok() && own("armwatch.db").is_ok())
    };
    // the first call changes the owner of the folder
    if as_user(&["--version"]).is_none() || as_user(&["config", "show"]).is_none_or(|of| !of.status.success())
    {
        println!("skipped: no other user can run the program here");
        return;
    }
    let refused = as_user(&["run"]).expect("it runs");
    let said = text(&refused.stderr);
    assert_eq!(refused.status.code(), Some(74), "{said}");
    assert!(said.contains("armwatch.db.daemon") && said.contains("chown"), "{said}");
    let doctor = text(&as_user(&["doctor", "--quick"]).expect("it runs").stdout);
    let problem = doctor.lines().find(|line| line.contains("the lock file")).unwrap_or_default();
    assert!(problem.starts_with("problem") && problem.contains("chown"), "{doctor}");
    // root changes the owner of the lock file to that of the database
    let daemon = workshop.daemon();
    workshop.wait_for_a_look();
    daemon.stop();
    let owner = std::os::unix::fs::MetadataExt::uid(&fs::metadata(&lock).expect("the lock file"));
    assert_eq!(owner, USER);
}

#[test]
fn an_address_is_never_the_name_of_a_file() {
    let workshop = small::workshop();
    let nobody = "POSTGRES://armwatch:secret@127.0.0.1:1/fleet";
    for (database, code, says) in [
        (nobody, 74, "no server answers"),
        ("mysql://armwatch:secret@db/fleet", 2, "an address of mysql"),
        ("Oracle://armwatch:secret@db/fleet", 2, "an address of Oracle"),
    ] {
        let said = workshop.stderr(&["ingest", "inbox", "--db", database], code);
        assert!(said.contains(says) && !said.contains("secret"), "{database}: {said}");
    }
    workshop.configure(|config| format!("database = \"mysql://a:secret@db/fleet\"\n{config}"));
    let said = workshop.stdout(&["config", "check"], 2);
    assert!(said.contains("database") && said.contains("mysql") && !said.contains("secret"), "{said}");
    let mut names: Vec<String> = fs::read_dir(workshop.path(""))
        .expect("the folder")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["armwatch.toml", "inbox"]);
}

/// A small ext4 has blocks of 1 KiB. A full one must not end the program by a signal.
#[test]
fn a_full_disk_with_small_blocks_is_said_to_be_full() {
    const SCRIPT: &str = r#"
truncate -s 24M image && mkfs.ext4 -q -b 1024 -m 0 image 2>/dev/null && mount -o loop image disk 2>/dev/null || exit 99
"$ARMWATCH" ingest inbox --db disk/armwatch.db >/dev/null 2>&1
status=$?
dd if=/dev/zero of=disk/filler bs=1024 count=100000 2>/dev/null
for slack in 0 8 16 40 100 300 1000 1900 2500; do
    truncate -s "-$((slack * 1024))" disk/filler
    for command in "runs" "status" "ingest inbox" "sql SELECT(1)"; do
        timeout 60 "$ARMWATCH" $command --db disk/armwatch.db >/dev/null 2>>said
        echo "$slack $command: $?"
    done
    dd if=/dev/zero bs=1024 count=100000 2>/dev/null >>disk/filler
done
rm disk/filler
timeout 60 "$ARMWATCH" sql --csv "SELECT count(*) FROM runs" --db disk/armwatch.db
umount disk
echo "first $status"
"#;
    let workshop = small::workshop();
    put(&workshop, "A", 1, 5);
    fs::create_dir(workshop.path("disk")).expect("a mount point");
    let script = Command::new("unshare")
        .args(["--mount", "sh", "-c", SCRIPT])
        .current_dir(workshop.path(""))
        .env("ARMWATCH", env!("CARGO_BIN_EXE_armwatch"))
        .env_remove("ARMWATCH_CONFIG")
        .output();
    let Some(script) = script.ok().filter(|script| script.status.success()) else {
        println!("skipped: this machine mounts no file system of a file");
        return;
    };
    let out = text(&script.stdout);
    assert!(out.ends_with("\n1\nfirst 0\n"), "{out}");
    let ended: Vec<&str> = out.lines().filter(|line| line.contains(": ")).collect();
    assert_eq!(ended.len(), 36, "{out}");
    for line in &ended {
        assert!(line.ends_with(": 0") || line.ends_with(": 74"), "{line}\n{out}");
    }
    assert!(ended[0].ends_with(": 74") && ended[35].ends_with(": 0"), "{out}");
    let said = fs::read_to_string(workshop.path("said")).expect("what was said");
    assert!(said.contains("blocks of 1024 bytes") && said.contains("free space there"), "{said}");
}
