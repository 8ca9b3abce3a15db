//! Production logs: compared with the robot's tests, and not part of its history.

use crate::canon::assert_sound;
use crate::small::{self, Export, export, work};
use crate::support::{Workshop, assert_alike};

fn workshop() -> Workshop {
    let workshop = Workshop::new();
    workshop.watch_work("er3a", 1 + 3 * 6);
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
    let history = "SELECT robot, joint, last_run_at, moving_relative_rmsd, friction_index, open_anomalies, status FROM fleet_health
                   UNION ALL SELECT robot, joint, speed_fraction, model, a_nm, b_nm, t1_min FROM warmup_fits";
    let before = workshop.query(history);
    let parameters = workshop.query("SELECT * FROM parameter_statistics");
    // one day later, from the same arm
    take(&workshop, "work", &[&WORK[..], &["--start", "2026-01-06T10:00:00Z", "--seed", "5"]].concat());
    assert_eq!(
        workshop.query("SELECT run_id, kind, status FROM runs ORDER BY run_id"),
        ["1|test|complete", "2|production|complete"]
    );
    assert_eq!(workshop.query(history), before);
    assert_eq!(workshop.query("SELECT * FROM parameter_statistics"), parameters);
    assert_eq!(workshop.number("SELECT count(*) FROM cycle_parameters WHERE run_id = 2"), 0);

    // 170 s are three windows; in the last one two joints stand still
    let checks = "SELECT count(*), count(DISTINCT cycle), min(reference_run_id), max(reference_run_id) FROM production_checks";
    assert_eq!(workshop.query(checks), ["18|3|1|1"]);
    assert_eq!(
        workshop.number("SELECT count(*) FROM production_checks WHERE friction_share NOT BETWEEN 0 AND 1"),
        0
    );
    assert_eq!(
        workshop
            .query("SELECT count(*), sum(windows), min(run_id), max(reference_run_id) FROM production_trend"),
        ["6|16|2|1"]
    );
    // the same warm arm: the residual is friction that no polynomial describes
    let worst = workshop.query("SELECT max(moving_relative_rmsd) FROM production_checks");
    let worst: f64 = worst[0].parse().expect("a figure");
    assert!(worst > 0.005 && worst < 0.2, "{worst}");
    // verification from factors is the second method
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
        workshop
            .query("SELECT count(*), count(friction_excess), min(reference_run_id) FROM production_checks"),
        ["18|16|2"]
    );
    // joint 3 has half as much friction again on a later day
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
    // half as much friction again, and no other change, whatever the motion
    let excess = |run: u32, joint: u32| -> f64 {
        let of = format!("FROM production_trend WHERE run_id = {run} AND joint = {joint}");
        workshop.query(&format!("SELECT friction_excess {of}"))[0].parse().expect("a figure")
    };
    assert!((excess(3, 3) - excess(1, 3) - 0.5).abs() < 0.1, "{} {}", excess(1, 3), excess(3, 3));
    assert!((excess(3, 2) - excess(1, 2)).abs() < 0.1, "{} {}", excess(1, 2), excess(3, 2));
    assert_eq!(
        workshop.query("SELECT kind, quantity, joint, run_id FROM anomalies"),
        ["drift|production_friction|3|3"]
    );
}

/// Tests of robot A on two days, production before, between and after them.
fn history() -> [Export; 5] {
    [work("A", 21, 3), export("A", 1, 5), work("A", 22, 6), export("A", 11, 8), work("A", 23, 9)]
}

fn dump_after(order: &[usize], together: bool) -> String {
    let (workshop, exports) = (small::watching_work(), history());
    for &place in order {
        workshop.add(&exports[place]);
        if !together {
            workshop.stdout(&["ingest", "inbox"], 0);
        }
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_sound(&workshop.path("armwatch.db"), &format!("{order:?}"));
    let references = "SELECT DISTINCT strftime('%d', log.started_at), strftime('%d', test.started_at)
                      FROM production_checks
                      JOIN runs AS log USING (run_id)
                      JOIN runs AS test ON test.run_id = reference_run_id ORDER BY 1";
    assert_eq!(workshop.query(references), ["03|05", "06|05", "09|08"], "{order:?}");
    workshop.canonical_dump()
}

#[test]
fn what_work_is_held_against_does_not_depend_on_the_order_in_which_files_come() {
    let expected = dump_after(&[0, 1, 2, 3, 4], false);
    for (order, together) in [([3, 4, 2, 0, 1], false), ([0, 1, 2, 3, 4], true)] {
        assert_alike(&dump_after(&order, together), &expected, &format!("{order:?}"));
    }
}

#[test]
fn a_test_that_is_corrected_is_what_work_is_held_against_from_then_on() {
    let (workshop, [_, test, log, ..]) = (small::watching_work(), history());
    for file in [&test, &log] {
        workshop.add(file);
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    let checks = "SELECT reference_run_id, group_concat(moving_rmsd_nm) FROM production_checks GROUP BY 1";
    let before = workshop.query(checks);
    // the same recording, exported again from other channels
    workshop.add(&export("A", 12, 5).named(&test.name));
    workshop.stdout(&["ingest", "inbox"], 0);
    let after = workshop.query(checks);
    assert!(before.len() == 1 && after.len() == 1 && before != after, "{before:?} {after:?}");
    assert!(after[0].starts_with("3|"), "{after:?}");
}
