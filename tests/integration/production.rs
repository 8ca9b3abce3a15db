//! Logs of ordinary work: held against the robot's tests, and no part of its history.

use std::fs;
use std::path::Path;

use crate::support::Workshop;

/// A workshop in which files called `*_Col19_*`, as the simulator calls exports without signals, are production.
fn workshop() -> Workshop {
    let workshop = Workshop::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).display();
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    let entry = format!(
        "[[robot]]\nname = \"*\"\nfiles = \"*_Col19_*\"\ndescription = \"{root}/config/robots/er3a.toml\"\n\
         layout = \"{root}/config/exports/production.toml\"\n\n[[robot]]"
    );
    fs::write(workshop.path("armwatch.toml"), config.replacen("[[robot]]", &entry, 1))
        .expect("a configuration");
    workshop
}

const TEST: [&str; 8] = ["--cycles", "2", "--warming-s", "10", "--name", "R07", "--initial-warm-s", "7200"];
const WORK: [&str; 10] = [
    "--cycles",
    "1",
    "--warming-s",
    "10",
    "--name",
    "R07",
    "--initial-warm-s",
    "7200",
    "--stage-signal",
    "none",
];

fn take(workshop: &Workshop, folder: &str, arguments: &[&str]) {
    workshop.simulate(folder, arguments);
    workshop.stdout(&["ingest", folder], 0);
}

#[test]
fn windows_of_work_are_held_against_the_last_test_and_leave_its_history_alone() {
    let workshop = workshop();
    take(&workshop, "test", &TEST);
    let history = "SELECT * FROM fleet_health UNION ALL SELECT robot, joint, speed_fraction, model, a_nm, b_nm, t1_min FROM warmup_fits";
    let before = workshop.query(history);
    let parameters = workshop.query("SELECT * FROM parameter_statistics");
    // a day later, from the same arm
    take(&workshop, "work", &[&WORK[..], &["--start", "2026-01-06T10:00:00Z", "--seed", "5"]].concat());
    assert_eq!(
        workshop.query("SELECT run_id, kind, status FROM runs ORDER BY run_id"),
        ["1|test|complete", "2|production|complete"]
    );
    assert_eq!(workshop.query(history), before);
    assert_eq!(workshop.query("SELECT * FROM parameter_statistics"), parameters);
    assert_eq!(workshop.number("SELECT count(*) FROM cycle_parameters WHERE run_id = 2"), 0);

    // 170 s are three windows
    let checks = "SELECT count(*), count(DISTINCT cycle), min(reference_run_id), max(reference_run_id) FROM production_checks";
    assert_eq!(workshop.query(checks), ["18|3|1|1"]);
    assert_eq!(workshop.number("SELECT count(*) FROM production_checks WHERE abs(bias_nm) > moving_rmsd_nm OR moving_rmsd_nm > max_nm"), 0);
    // the same warm arm: what is left is friction that no polynomial describes
    let worst = workshop.query("SELECT max(moving_relative_rmsd) FROM production_checks");
    let worst: f64 = worst[0].parse().expect("a figure");
    assert!(worst > 0.005 && worst < 0.2, "{worst}");
    // verification from factors is the second road
    let out = workshop.stdout(
        &["verify", "--parameters", "1", "--against", "2", "--stage", "all", "--rows", "all", "--json"],
        0,
    );
    let verified: serde_json::Value = serde_json::from_str(out.trim()).expect("an object");
    let all = |of: &&serde_json::Value| of["joint"] == 1 && of["stage"] == "all";
    let found =
        verified["rmsd"].as_array().expect("figures").iter().find(all).expect("joint 1")["rmsd_nm"].as_f64();
    let stored = workshop.query(
        "SELECT sum(rmsd_nm * rmsd_nm * samples) / sum(samples) FROM production_checks WHERE joint = 1",
    );
    let stored = stored[0].parse::<f64>().expect("a figure").sqrt();
    assert!(found.is_some_and(|found| (found - stored).abs() < 1e-9 * stored), "{found:?} {stored}");

    let rows = workshop.stdout(&["torque", "--run", "2", "--cycle", "2", "--json"], 0);
    let joint: serde_json::Value =
        serde_json::from_str(rows.lines().next().expect("a joint")).expect("an object");
    let stored = workshop.query("SELECT rmsd_nm FROM production_checks WHERE cycle = 2 AND joint = 1");
    let stored: f64 = stored[0].parse().expect("a figure");
    assert!(
        joint["rmsd_nm"].as_f64().is_some_and(|found| (found - stored).abs() < 1e-9 * stored),
        "{stored}"
    );
}

#[test]
fn work_before_the_first_test_waits_for_it_and_wear_shows() {
    let workshop = workshop();
    take(&workshop, "before", &[&WORK[..], &["--start", "2026-01-04T10:00:00Z"]].concat());
    assert_eq!(workshop.query("SELECT DISTINCT joint, reason FROM production_checks"), ["|no model yet"]);
    take(&workshop, "test", &TEST);
    assert_eq!(
        workshop.query("SELECT count(*), count(bias_nm), min(reference_run_id) FROM production_checks"),
        ["18|0|2"]
    );
    // joint 3 rubs half as much again on one later day
    let worn = ["--start", "2026-01-07T10:00:00Z", "--fault", "wear:joint=3,from=1,rate=0.5"];
    take(&workshop, "after", &[&WORK[..], &worn].concat());
    let ratio = |joint: u32| -> f64 {
        let mean = |run: u32| {
            let sql = format!(
                "SELECT sum(moving_rmsd_nm * moving_rmsd_nm * moving_samples) / sum(moving_samples) \
                 FROM production_checks WHERE joint = {joint} AND run_id = {run}"
            );
            workshop.query(&sql)[0].parse::<f64>().expect("a figure").sqrt()
        };
        mean(3) / mean(1)
    };
    assert!(ratio(3) > 1.5, "{}", ratio(3));
    for joint in [1, 2, 4, 5, 6] {
        assert!((ratio(joint) - 1.0).abs() < 0.2, "joint {joint}: {}", ratio(joint));
    }
    assert_eq!(workshop.number("SELECT count(*) FROM anomalies"), 0);
}
