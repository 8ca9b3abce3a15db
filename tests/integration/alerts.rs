//! `armwatch alerts` and the states of an alarm, for users and for two programs at once.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

use crate::support::Workshop;

/// Tests of one arm whose joint 3 wears from the fifth test on.
fn wearing(workshop: &Workshop, runs: &str) -> Vec<PathBuf> {
    let fault = ["--fault", "wear:joint=3,from=5,rate=0.08"];
    let shape = ["--runs", runs, "--cycles", "2", "--name", "R01", "--seed", "11"];
    let mut exports = workshop.simulate("made", &[&shape[..], &fault].concat());
    exports.sort();
    exports
}

fn ingest(workshop: &Workshop, exports: &[PathBuf]) -> String {
    let paths: Vec<&str> = exports.iter().map(|path| path.to_str().expect("a path")).collect();
    workshop.stdout(&[&["ingest"][..], &paths].concat(), 0)
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Standard error of a command that is refused because of its arguments.
fn refused(workshop: &Workshop, arguments: &[&str]) -> String {
    workshop.stderr(arguments, 2)
}

/// History of the anomaly of joint 3, in order.
fn history(workshop: &Workshop, id: &str) -> Vec<String> {
    let query = "SELECT what FROM anomaly_history WHERE anomaly_id = ";
    workshop.query(&format!("{query}{id} ORDER BY anomaly_event_id"))
}

#[test]
fn people_list_show_and_settle_an_alarm_and_it_keeps_its_number() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.stdout(&["alerts", "list"], 0), "no anomaly has been found in 0 complete runs\n");
    assert_eq!(workshop.stdout(&["alerts", "list", "--json"], 0), "");
    assert!(refused(&workshop, &["alerts", "show", "1"]).contains("there are no anomalies"));

    let exports = wearing(&workshop, "10");
    let out = ingest(&workshop, &exports[..8]);
    assert!(out.contains("R01") && out.contains("joint 3"), "{out}");
    let worn = "SELECT anomaly_id FROM anomalies WHERE joint = 3 AND state = 'open'";
    let ids = workshop.query(worn);
    let [id] = &ids[..] else { panic!("one anomaly of joint 3: {ids:?}\n{out}") };

    let listed = workshop.stdout(&["alerts", "list"], 0);
    let message = workshop.query(&format!("SELECT message FROM anomalies WHERE anomaly_id = {id}")).remove(0);
    assert!(listed.starts_with("id ") && listed.contains("R01") && listed.contains(&message), "{listed}");
    let of_robot = workshop.stdout(&["alerts", "list", "--robot", "R01", "--state", "open", "--json"], 0);
    assert!(of_robot.lines().any(|line| json(line)["anomaly_id"].as_i64() == id.parse().ok()), "{of_robot}");
    let other = workshop.stdout(&["alerts", "list", "--kind", "fleet"], 0);
    assert!(other.contains("none of the") && other.contains("--all"), "{other}");
    assert!(refused(&workshop, &["alerts", "list", "--robot", "R02"]).contains("there are runs of R01"));
    assert!(
        refused(&workshop, &["alerts", "list", "--robot", "r01", "--json"]).contains("did you mean R01?")
    );
    let unknown = refused(&workshop, &["alerts", "ack", "99"]);
    assert!(unknown.contains("there is no anomaly 99; did you mean") && unknown.contains(id), "{unknown}");

    let shown = workshop.stdout(&["alerts", "show", id, "--plot", "alarm.svg"], 0);
    for said in
        [&message, "state       open", "onset", "last seen", "limit", "moving_relative_rmsd", "opened"]
    {
        assert!(shown.contains(said), "{said} is not in\n{shown}");
    }
    // the latest of the eight tests shows it, the first does not
    let tests: Vec<&str> =
        shown.lines().skip_while(|line| !line.starts_with("run ")).skip(1).take(8).collect();
    assert!(!tests[0].contains('*') && tests[7].contains('*'), "{shown}");
    assert!(fs::read_to_string(workshop.path("alarm.svg")).expect("a picture").contains("warm friction, Nm"));

    let why = ["--why", "gearbox is ordered", "--by", "mueller"];
    let known = workshop.stdout(&[&["alerts", "ack", id][..], &why].concat(), 0);
    assert!(known.starts_with("acknowledged  anomaly") && known.contains("by mueller: gearbox"), "{known}");
    let status = workshop.stdout(&["status"], 0);
    assert!(status.contains("; 1 acknowledged (`armwatch alerts list`)"), "{status}");
    assert!(refused(&workshop, &["alerts", "ack", id]).contains("is acknowledged already"));
    ingest(&workshop, &exports[8..]);
    let told = json(&workshop.stdout(&["alerts", "show", id, "--json"], 0));
    assert_eq!(
        (told["state"].as_str(), told["tests"].as_array().map(Vec::len)),
        (Some("acknowledged"), Some(10))
    );
    let deed =
        told["history"].as_array().expect("a history").iter().find(|event| event["what"] == "acknowledged");
    assert_eq!(
        deed.map(|deed| (&deed["who"], &deed["why"])),
        Some((&"mueller".into(), &"gearbox is ordered".into()))
    );

    let past = refused(&workshop, &["alerts", "shelve", id, "--until", "2026-01-01"]);
    assert!(past.contains("has passed"), "{past}");
    let neither = refused(&workshop, &["alerts", "shelve", id]);
    assert!(neither.contains("--until <TIME>") && neither.contains("--days <N>"), "{neither}");
    let day = jiff::Timestamp::now() + jiff::SignedDuration::from_hours(24 * 30);
    let day = day.strftime("%Y-%m-%d").to_string();
    let until = format!("{day}T06:00");
    let shelved = json(&workshop.stdout(&["alerts", "shelve", id, "--until", &until, "--json"], 0));
    assert_eq!(shelved["shelved_until"].as_str(), Some(format!("{day}T06:00:00.000Z").as_str()));
    assert!(workshop.stdout(&["alerts", "list"], 0).contains(&format!("shelved until {day} 06:00Z")));

    workshop.stdout(&["alerts", "false-alarm", id, "--why", "other gripper"], 0);
    let twice = refused(&workshop, &["alerts", "false-alarm", id]);
    assert!(twice.contains(&format!("anomaly {id} is a false alarm already")), "{twice}");
    let closed =
        workshop.stdout(&["alerts", "list", "--robot", "R01", "--state", "false_alarm", "--json"], 0);
    assert_eq!(closed.lines().count(), 1, "{closed}");
    assert!(!workshop.stdout(&["alerts", "list"], 0).contains(&message));
    workshop.stdout(&["alerts", "ack", id], 0);
    workshop.stdout(&["alerts", "resolve", id, "--why", "gearbox changed"], 0);
    let told = json(&workshop.stdout(&["alerts", "show", id, "--json"], 0));
    let in_view = workshop.query(&format!(
        "SELECT first_seen_at, last_seen_at, onset_at, (SELECT max(at) FROM anomaly_history WHERE anomaly_id = {id})
         FROM anomalies WHERE anomaly_id = {id}"
    ));
    let latest = &told["history"].as_array().expect("a history").last().expect("an event")["at"];
    let times = [&told["first_seen_at"], &told["last_seen_at"], &told["onset_at"], latest];
    let times: Vec<&str> = times.iter().map(|time| time.as_str().unwrap_or_default()).collect();
    assert_eq!(in_view, [times.join("|")], "times are those of the views, to the last digit");
    let deeds = history(&workshop, id);
    assert_eq!(deeds.first().map(String::as_str), Some("opened"));
    let of_people: Vec<&String> =
        deeds.iter().filter(|what| !["opened", "worse"].contains(&what.as_str())).collect();
    assert_eq!(
        of_people,
        ["acknowledged", "shelved", "false_alarm", "acknowledged", "resolved"],
        "{deeds:?}"
    );
}

#[test]
fn a_command_that_changes_what_is_stored_makes_no_database() {
    let workshop = Workshop::new();
    let commands: [&[&str]; 10] = [
        &["alerts", "ack", "1"],
        &["alerts", "resolve", "1"],
        &["alerts", "shelve", "1", "--days", "1"],
        &["alerts", "false-alarm", "1"],
        &["alerts", "test"],
        &["maintenance", "Left", "--what", "grease"],
        &["maintenance", "--remove", "1"],
        &["ingest", "--again", "1"],
        &["quarantine", "dismiss", "1", "--reason", "old"],
        &["prune"],
    ];
    for command in commands {
        let said = workshop.stderr(&[command, &["--db", "gone/fleet.db"]].concat(), 74);
        assert!(said.contains("there is no database gone/fleet.db"), "{command:?}: {said}");
        assert!(!workshop.path("gone").exists(), "{command:?}");
    }
}

#[test]
fn one_command_beside_the_daemon_loses_and_doubles_nothing() {
    let at_once = Workshop::new();
    ingest(&at_once, &wearing(&at_once, "12"));
    let rows = "SELECT robot, joint, kind, quantity, severity, state, first_seen_at, last_seen_at, onset_at, score, value,
                       peak_value, message FROM anomalies ORDER BY 1, 2, 3, 4, 7";
    let expected = at_once.query(rows);
    assert!(expected.iter().any(|row| row.starts_with("R01|3|")), "{expected:?}");

    let workshop = Workshop::new();
    let exports = wearing(&workshop, "12");
    let daemon = workshop.daemon();
    let (own, watched): (Vec<_>, Vec<_>) = exports.iter().enumerate().partition(|(place, _)| place % 2 == 0);
    for (_, path) in watched {
        fs::copy(path, workshop.inbox(path.file_name().and_then(|name| name.to_str()).expect("a name")))
            .expect("copied");
    }
    let own: Vec<PathBuf> = own.into_iter().map(|(_, path)| path.clone()).collect();
    ingest(&workshop, &own);
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 12);
    workshop.wait_for_conclusions();
    daemon.stop();
    assert_eq!(workshop.query(rows), expected);

    let doubled = "SELECT anomaly_id, what FROM (
                       SELECT anomaly_id, what, lag(what) OVER (PARTITION BY anomaly_id ORDER BY anomaly_event_id) AS before
                       FROM anomaly_history)
                   WHERE what = before AND what <> 'worse'";
    assert_eq!(workshop.query(doubled), [""; 0]);
    let lost = "SELECT anomaly_id FROM anomalies
                WHERE state = 'open' AND (
                    SELECT what FROM anomaly_history AS said WHERE said.anomaly_id = anomalies.anomaly_id
                          AND what NOT IN ('worse', 'corrected')
                    ORDER BY anomaly_event_id DESC LIMIT 1) NOT IN ('opened', 'reopened')";
    assert_eq!(workshop.query(lost), [""; 0]);
    assert!(workshop.number("SELECT count(*) FROM anomaly_history WHERE what = 'opened'") >= 1);
}

#[test]
fn a_daemon_ends_shelving_and_says_what_happened() {
    let workshop = Workshop::new();
    let exports = wearing(&workshop, "9");
    ingest(&workshop, &exports[..8]);
    let id = workshop.query("SELECT anomaly_id FROM anomalies WHERE joint = 3 AND state = 'open'").remove(0);
    let soon = jiff::Timestamp::now() + jiff::SignedDuration::from_secs(2);
    workshop.stdout(&["alerts", "shelve", &id, "--until", &soon.to_string(), "--why", "soon over"], 0);
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT count(*) FROM anomaly_history WHERE what = 'unshelved'", 1);
    workshop.wait_for("SELECT count(*) FROM anomalies WHERE joint = 3 AND state = 'open'", 1);
    workshop.wait_until(|| workshop.log().contains("unshelved"));
    daemon.stop();
    let again = workshop.daemon();
    workshop.wait_until(|| workshop.log().contains("`armwatch alerts list` shows them"));
    again.stop();
    assert_eq!(workshop.number("SELECT count(*) FROM anomaly_history WHERE what = 'unshelved'"), 1);
}

#[test]
fn a_complete_run_is_taken_anew_from_its_export_with_its_number() {
    let workshop = Workshop::new();
    let export = workshop.add_reference("inbox");
    let description = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/robots/er3a.toml"));
    let description = description.expect("the description");
    workshop.use_file("description", "arm.toml");
    fs::write(workshop.path("arm.toml"), &description).expect("written");
    workshop.stdout(&["ingest", "inbox"], 0);
    let before = workshop.dump();

    let said = workshop.stdout(&["ingest", "--again", "1"], 0);
    assert!(said.starts_with("stored") && said.contains("run 1, 5 cycles"), "{said}");
    assert_eq!(workshop.dump(), before, "nothing was corrected");

    let law = "friction_model = \"polynomial\"";
    assert!(description.contains(law));
    let corrected = description.replace(law, "friction_model = \"viscous_coulomb\"");
    fs::write(workshop.path("arm.toml"), corrected).expect("written");
    assert!(workshop.stdout(&["ingest", "inbox"], 0).starts_with("known"), "it is not read again by itself");
    assert_eq!(workshop.number("SELECT count(*) FROM cycle_parameters WHERE parameter LIKE 'f4%'"), 30);
    workshop.stdout(&["ingest", "--again", "1"], 0);
    assert_eq!(workshop.number("SELECT count(*) FROM cycle_parameters WHERE parameter LIKE 'f4%'"), 0);
    assert_eq!(workshop.query("SELECT run_id, status, cycles FROM runs"), ["1|complete|5"]);

    assert!(refused(&workshop, &["ingest", "--again", "7"]).contains("there is no run 7"));
    assert!(refused(&workshop, &["ingest", "inbox", "--again", "1"]).contains("cannot be used with"));
    let after = workshop.dump();
    fs::remove_file(export).expect("removed");
    assert!(refused(&workshop, &["ingest", "--again", "1"]).contains("put it back"));
    assert_eq!(workshop.dump(), after, "stored results stay");
}
