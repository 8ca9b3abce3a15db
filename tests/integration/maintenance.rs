//! `armwatch maintenance`: maintenance of a robot begins a new baseline, and a withdrawn entry leaves no trace in
//! conclusions.

use serde_json::Value;

use crate::support::Workshop;

/// Full tests of a robot, with baselines of two tests.
fn tested() -> Workshop {
    let workshop = Workshop::new();
    workshop.configure(|config| config + "\n[detect]\nbaseline_runs = 2\n");
    let shape = ["--runs", "5", "--cycles", "6", "--warming-s", "0", "--name", "Left", "--interval-h", "20"];
    workshop.simulate("exports", &shape);
    workshop.stdout(&["ingest", "exports"], 0);
    workshop
}

/// The runs of the baselines of a joint, by epoch.
fn baselines(workshop: &Workshop, joint: u8) -> Vec<String> {
    workshop.query(&format!(
        "SELECT epoch || ' ' || cause || ' ' || group_concat(run_id)
         FROM (SELECT * FROM baselines WHERE robot = 'Left' AND joint = {joint} ORDER BY started_at)
         GROUP BY epoch ORDER BY epoch"
    ))
}

#[test]
fn work_on_a_joint_begins_its_baseline_anew_until_the_entry_is_taken_back() {
    let workshop = tested();
    assert_eq!(baselines(&workshop, 3), ["0 first_test 1,2"]);
    let before = workshop.dump();
    let start = workshop.query("SELECT started_at FROM runs WHERE run_id = 4").remove(0);
    let work = ["Left", "--joint", "3", "--what", "gearbox changed", "--at", &start, "--by", "mueller"];
    let work = [&["maintenance"][..], &work].concat();
    let entered = workshop.stdout(&work, 0);
    assert!(entered.starts_with("entered      1: Left, joint 3, "), "{entered}");
    assert!(entered.contains("Z: gearbox changed\n"), "{entered}");
    assert!(entered.contains("the history was evaluated with it"), "{entered}");
    assert_eq!(baselines(&workshop, 3), ["0 first_test 1,2", "1 maintenance 4,5"]);
    assert_eq!(baselines(&workshop, 2), ["0 first_test 1,2"]);
    assert_eq!(workshop.query("SELECT history - concluded FROM robot"), ["0"]);
    let again = workshop.stderr(&work, 2);
    assert!(again.contains("already entered, as number 1: Left, joint 3, "), "{again}");
    let listed: Value =
        serde_json::from_str(&workshop.stdout(&["maintenance", "--list", "Left", "--json"], 0))
            .expect("JSON");
    assert_eq!((&listed["joint"], &listed["by"]), (&3.into(), &"mueller".into()));
    // times are equal to those of the view, so that both can be joined by time
    let times = format!(
        "{}|{}",
        listed["at"].as_str().expect("a time"),
        listed["recorded_at"].as_str().expect("a time")
    );
    assert_eq!(workshop.query("SELECT at, recorded_at FROM maintenance_log"), [times]);
    let removed = workshop.stdout(&["maintenance", "--remove", "1"], 0);
    assert!(removed.starts_with("removed      1: Left, joint 3, "), "{removed}");
    assert!(removed.contains("Z: gearbox changed\n"), "{removed}");
    assert!(removed.contains("the earlier baseline is valid again"), "{removed}");
    assert_eq!(workshop.dump(), before);
}

#[test]
fn work_silences_the_alarms_of_its_joint_until_the_entry_is_taken_back() {
    let workshop = Workshop::new();
    let fault = ["--fault", "wear:joint=3,from=5,rate=0.08"];
    let shape = ["--runs", "8", "--cycles", "2", "--name", "R01", "--seed", "11"];
    workshop.simulate("exports", &[&shape[..], &fault].concat());
    workshop.stdout(&["ingest", "exports"], 0);
    let open = "SELECT anomaly_id FROM anomalies WHERE joint = 3 AND state = 'open' ORDER BY anomaly_id";
    let ids = workshop.query(open);
    assert!(!ids.is_empty());
    let others = "SELECT anomaly_id, state FROM anomalies WHERE joint <> 3 OR joint IS NULL ORDER BY 1";
    let before = workshop.query(others);
    workshop
        .stdout(&["maintenance", "R01", "--joint", "3", "--what", "gearbox changed", "--by", "mueller"], 0);
    let listed = workshop.stdout(&["alerts", "list", "--state", "maintenance", "--json"], 0);
    let mut found: Vec<String> = listed
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).expect("JSON")["anomaly_id"].to_string())
        .collect();
    found.sort_by_key(|id| id.parse::<i64>().ok());
    assert_eq!(found, ids, "{listed}");
    let last = "SELECT what || ' ' || coalesce(who, '') || ' ' || coalesce(why, '') FROM anomaly_history
                WHERE joint = 3 ORDER BY anomaly_event_id DESC LIMIT 1";
    assert_eq!(workshop.query(last), ["maintenance mueller gearbox changed"]);
    assert_eq!(workshop.query(others), before, "work on joint 3 alone");
    workshop.stdout(&["maintenance", "--remove", "1"], 0);
    assert_eq!(workshop.query(open), ids);
    assert_eq!(workshop.query(last), ["reopened  "]);
}

#[test]
fn what_cannot_be_entered_is_told_with_its_remedy() {
    let workshop = Workshop::new();
    workshop.simulate("exports", &["--runs", "1", "--cycles", "1", "--warming-s", "0", "--name", "Left"]);
    workshop.stdout(&["ingest", "exports"], 0);
    let nothing = workshop.stdout(&["maintenance", "--list"], 0);
    assert!(nothing.contains("no work was entered"), "{nothing}");
    let robot = "Left";
    let refused: [(&[&str], &str); 12] = [
        (&["maintenance", "Nobody", "--what", "grease"], "there is no robot Nobody; there are runs of Left"),
        (&["maintenance", "left", "--what", "grease"], "there is no robot left; did you mean Left?"),
        (&["maintenance", "left", "--list"], "did you mean Left?"),
        (&["maintenance", robot, "--what", "grease", "--joint", "-1"], "-1 is not in 1..=255"),
        (&["maintenance", robot, "--what", "grease", "--joint", "9"], "has no joint 9"),
        (&["maintenance", robot, "--what", "grease", "--at", "2999-01-01"], "is in the future"),
        (&["maintenance", robot, "--what", "grease", "--at", "soon"], "2026-03-01T14:30"),
        (&["maintenance", robot, "--what", "grease", "--at", "0020-01-01"], "is before 1970"),
        (&["maintenance", robot, "--what", "  "], "it is empty"),
        (&["maintenance", robot, "--what", "grease", "--by", " "], "it is empty"),
        (&["maintenance", "--remove", "7"], "no work has the number 7"),
        (&["maintenance", robot], "--what"),
    ];
    for (arguments, said) in refused {
        let output = workshop.stderr(arguments, 2);
        assert!(output.contains(said), "{arguments:?}: {output}");
    }
    assert_eq!(workshop.number("SELECT count(*) FROM maintenance_log"), 0);
}
