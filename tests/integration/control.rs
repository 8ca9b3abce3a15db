//! Control of the daemon while it runs and before: SIGHUP, a second daemon, the checks of a configuration.

use std::fs;

use crate::support::{Workshop, text};

fn said(workshop: &Workshop, what: &str) -> usize {
    workshop.log().matches(what).count()
}

#[test]
fn a_hangup_reads_the_configuration_again_and_a_wrong_one_changes_nothing() {
    let workshop = Workshop::new();
    fs::create_dir(workshop.path("second")).expect("a folder");
    let daemon = workshop.daemon();
    workshop.wait_until(|| said(&workshop, "watching") == 1);
    let sound = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");

    workshop.configure(|config| {
        config.replace("settle_s = 0.2", "settle_s = -1").replace("scan_interval_s = 0.1", "scan = 1")
    });
    daemon.signal("HUP");
    workshop.wait_until(|| said(&workshop, "the earlier configuration stays in force") == 1);
    let problems = workshop.log();
    assert!(problems.contains("watch.settle_s") && problems.contains("watch.scan"), "{problems}");

    // errors that only `run` would detect are refused as well
    fs::write(workshop.path("armwatch.toml"), sound.replace("[\"inbox\"]", "[\"/\"]")).expect("written");
    daemon.signal("HUP");
    workshop.wait_until(|| said(&workshop, "the earlier configuration stays in force") == 2);
    assert!(workshop.log().contains("is the whole file system"), "{}", workshop.log());

    // a missing file does not activate the shipped settings
    fs::remove_file(workshop.path("armwatch.toml")).expect("deleted");
    daemon.signal("HUP");
    workshop.wait_until(|| said(&workshop, "the earlier configuration stays in force") == 3);

    // another folder and database: the folder is watched now, the database is used from the next start on
    let new = sound.replace("[\"inbox\"]", "[\"inbox\", \"second\"]");
    fs::write(workshop.path("armwatch.toml"), format!("database = \"other.db\"\n{new}")).expect("written");
    daemon.signal("HUP");
    workshop.wait_until(|| said(&workshop, "configuration read again") == 1);
    workshop.add_reference("second");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete'", 1);
    assert!(workshop.log().contains("`database` has changed") && !workshop.path("other.db").exists());
    daemon.stop();
}

#[test]
fn a_second_daemon_that_serves_is_told_of_the_first_and_not_of_its_port() {
    let workshop = Workshop::new();
    let port = std::net::TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("it").port();
    workshop.configure(|config| format!("[serve]\nlisten = \"127.0.0.1:{port}\"\n\n{config}"));
    let first = workshop.daemon();
    workshop.wait_until(|| said(&workshop, "serving HTTP") == 1);
    let message = workshop.stderr(&["run"], 74);
    let first_one = format!("another armwatch daemon (process {})", first.child.id());
    assert!(message.contains(&first_one) && !message.contains("serve.listen"), "{message}");
    first.stop();
}

/// A change of the configuration, and the expected message.
type Case = (&'static str, fn(String) -> String, &'static str);

#[test]
fn what_run_would_refuse_is_found_by_config_check() {
    let cases: [Case; 6] = [
        (
            "a token file that is not there",
            |config| format!("[serve]\ntoken_file = \"none\"\n\n{config}"),
            "serve.token_file: none",
        ),
        (
            "a token that is too short",
            |config| format!("[serve]\ntoken_file = \"short\"\n\n{config}"),
            "one line of 16 to 1024",
        ),
        (
            "an open address without a token",
            |config| format!("[serve]\nlisten = \"0.0.0.0:0\"\n\n{config}"),
            "there is no token",
        ),
        ("the whole file system", |config| config.replace("[\"inbox\"]", "[\"/\"]"), "watch.folders[1]"),
        (
            "a folder as database",
            |config| format!("database = \"inbox\"\n{config}"),
            "is a folder; name a file",
        ),
        (
            "a copy for readers over the database, spelt otherwise",
            |config| format!("{config}\n[snapshot]\nfile = \"inbox/../armwatch.db\"\n"),
            "snapshot.file = \"inbox/../armwatch.db\": is the database itself",
        ),
    ];
    for (case, change, says) in cases {
        let workshop = Workshop::new();
        fs::write(workshop.path("short"), "secret\n").expect("written");
        workshop.configure(change);
        let check = workshop.run(&["config", "check"]);
        let found = text(&check.stdout);
        assert_eq!(check.status.code(), Some(2), "{case}: {found}");
        assert!(found.contains(says), "{case}: {found}");
        let run = workshop.stderr(&["run"], 2);
        assert!(run.contains(says), "{case}: {run}");
    }
}

#[test]
fn the_daemon_creates_a_relative_folder_and_no_check_warns_of_it() {
    let workshop = Workshop::new();
    fs::remove_dir(workshop.path("inbox")).expect("an empty folder");
    let check = workshop.run(&["config", "check"]);
    assert!(
        check.status.success() && !text(&check.stderr).contains("watch.folders"),
        "{}",
        text(&check.stderr)
    );
    let daemon = workshop.daemon();
    workshop.wait_until(|| workshop.path("inbox").is_dir());
    assert!(workshop.log().contains("created a watched folder"), "{}", workshop.log());
    workshop.add_reference("inbox");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete'", 1);
    daemon.stop();
}

#[test]
fn a_folder_that_is_not_there_or_lies_in_another_is_warned_of() {
    let workshop = Workshop::new();
    fs::create_dir(workshop.inbox("left")).expect("a folder");
    let later = workshop.path("later");
    let folders = format!("[\"inbox\", \"inbox/left\", \"{}\"]", later.display());
    workshop.configure(|config| config.replace("[\"inbox\"]", &folders));
    let check = workshop.stdout(&["config", "check"], 0);
    assert!(check.contains("warning: ") && check.contains("watch.folders[2]"), "{check}");
    let missing = format!("watch.folders[3] = \"{}\": does not exist or is not readable", later.display());
    assert!(check.contains(&missing), "{check}");

    let daemon = workshop.daemon();
    workshop.wait_until(|| said(&workshop, "cannot read a watched place") > 0);
    fs::create_dir(&later).expect("a folder");
    workshop.add_reference("later");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete'", 1);
    daemon.stop();
    let log = workshop.log();
    let missing: Vec<&str> =
        log.lines().filter(|line| line.contains("WARN") && line.contains("later")).collect();
    assert!(missing.len() == 1 && missing[0].contains("check that it exists"), "{log}");
}
