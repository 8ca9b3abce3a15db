//! The export that was made with Pinocchio, independent of this program, compared with the results of an established
//! stack.

use crate::support::{REFERENCE_NAME, Workshop};

/// Moving relative RMSD of the excitation stage, joints 1 to 6, from a fourth-order zero-phase
/// Butterworth low-pass at 12 Hz, central differences, 64 columns and scaled least squares in SciPy.
const ESTABLISHED_RMSD: [(u32, [f64; 6]); 2] = [
    (1, [0.0289, 0.0123, 0.0166, 0.0250, 0.0208, 0.0295]),
    (5, [0.0349, 0.0127, 0.0175, 0.0329, 0.0212, 0.0364]),
];

/// Mean friction on the plateaus at 60 % speed in cycle 1, from the same stack, Nm.
const ESTABLISHED_FRICTION_NM: [f64; 6] = [26.92, 38.31, 15.33, 26.34, 7.97, 5.62];

/// True mean friction at 60 % speed in the export (`R00_truth.json`), cycles 1 and 5, Nm.
const TRUE_FRICTION_NM: [(u32, [f64; 6]); 2] =
    [(1, [26.836, 38.345, 15.352, 26.331, 7.98, 5.642]), (5, [20.561, 30.03, 13.078, 20.217, 6.689, 4.535])];

/// A plateau of one or two seconds averages torque noise and ripple to about half a percent.
const FRICTION_TOLERANCE: f64 = 0.01;

fn ingested() -> Workshop {
    let workshop = Workshop::new();
    let export = workshop.add_reference("inbox");
    let out = workshop.stdout(&["ingest", export.to_str().expect("a path")], 0);
    assert!(out.contains("5 cycles, 42545 rows"), "{out}");
    workshop
}

fn real(workshop: &Workshop, sql: &str) -> f64 {
    workshop.query(sql).first().and_then(|cell| cell.parse().ok()).unwrap_or(f64::NAN)
}

#[test]
fn accuracy_is_no_worse_than_the_established_stacks() {
    let workshop = ingested();
    for (cycle, by_joint) in ESTABLISHED_RMSD {
        for (joint, established) in (1..).zip(by_joint) {
            let ours = real(
                &workshop,
                &format!(
                    "SELECT moving_relative_rmsd FROM cycle_rmsd WHERE cycle = {cycle} AND joint = {joint} AND \
                     stage = 'excitation' AND verification = 'self'"
                ),
            );
            assert!(ours <= established, "cycle {cycle}, joint {joint}: {ours} against {established}");
            assert!(ours > 0.2 * established, "cycle {cycle}, joint {joint}: {ours} is too good to be true");
        }
    }
}

#[test]
fn plateau_friction_is_the_established_stacks_and_the_truth() {
    let workshop = ingested();
    let mean = |cycle: u32, joint: usize| {
        real(
            &workshop,
            &format!(
                "SELECT AVG(ABS(torque_nm)) FROM friction_points WHERE cycle = {cycle} AND joint = {joint} AND \
                 speed_fraction = 0.6"
            ),
        )
    };
    for (joint, established) in (1..).zip(ESTABLISHED_FRICTION_NM) {
        let ours = mean(1, joint);
        assert!((ours / established - 1.0).abs() < FRICTION_TOLERANCE, "joint {joint}: {ours} {established}");
    }
    for (cycle, by_joint) in TRUE_FRICTION_NM {
        for (joint, truth) in (1..).zip(by_joint) {
            let ours = mean(cycle, joint);
            assert!(
                (ours / truth - 1.0).abs() < FRICTION_TOLERANCE,
                "cycle {cycle}, joint {joint}: {ours} {truth}"
            );
        }
    }
}

#[test]
fn every_cycle_has_64_parameters_with_errors_and_both_directions_of_friction() {
    let workshop = ingested();
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_parameters"), 5 * 64);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM cycle_parameters WHERE NOT std_error > 0"), 0);
    assert_eq!(
        workshop.number(
            "SELECT COUNT(*) FROM (SELECT 1 FROM friction_points WHERE speed_fraction = 0.6 \
             GROUP BY cycle, joint HAVING COUNT(DISTINCT direction) = 2)"
        ),
        5 * 6
    );
    assert_eq!(workshop.number("SELECT COUNT(*) FROM friction_points WHERE torque_nm * direction <= 0"), 0);
    // every joint warms up, so none of these curves is flat
    assert_eq!(
        workshop.number("SELECT COUNT(*) FROM warmup_fits WHERE speed_fraction = 0.6 AND model = 'constant'"),
        0
    );
}

#[test]
fn signals_that_are_missing_come_from_the_motion() {
    let with_signals = ingested();
    let without = Workshop::new();
    let plain = crate::bad_input::decompressed();
    let mut stripped = String::new();
    for line in plain.lines() {
        let cells: Vec<&str> = line.split(',').collect();
        stripped.push_str(&cells[..20].join(","));
        stripped.push('\n');
    }
    std::fs::write(without.inbox(REFERENCE_NAME.trim_end_matches(".gz")), stripped).expect("an export");
    without.stdout(&["ingest", "inbox"], 0);
    assert_eq!(without.number("SELECT cycles FROM runs"), 5);
    let friction = "SELECT joint, speed_fraction, direction, torque_nm FROM friction_points WHERE cycle = 3";
    let reference = with_signals.query(friction);
    let mut compared = 0;
    for row in without.query(friction) {
        let (key, ours) = row.rsplit_once('|').expect("cells");
        let theirs = reference.iter().find_map(|row| row.strip_prefix(key)?.strip_prefix('|'));
        let Some(theirs) = theirs else { continue };
        let (a, b): (f64, f64) = (ours.parse().expect("a number"), theirs.parse().expect("a number"));
        assert!((a / b - 1.0).abs() < FRICTION_TOLERANCE, "{key}: {a} {b}");
        compared += 1;
    }
    assert!(compared >= 58, "{compared} of {} points were found in the motion", reference.len());
    // without a counter a cycle begins with its excitation: the rest before it belongs to the last cycle
    let rmsd =
        "SELECT moving_relative_rmsd FROM cycle_rmsd WHERE cycle = 3 AND stage = 'excitation' ORDER BY joint";
    for (a, b) in with_signals.query(rmsd).iter().zip(without.query(rmsd)) {
        let (a, b): (f64, f64) = (a.parse().expect("a number"), b.parse().expect("a number"));
        assert!((a / b - 1.0).abs() < 0.02, "{a} {b}");
    }
}

#[test]
fn one_content_is_one_run_whatever_its_name() {
    let workshop = ingested();
    let before = workshop.dump();
    std::fs::create_dir(workshop.inbox("sub")).expect("a folder");
    std::fs::copy(workshop.inbox(REFERENCE_NAME), workshop.inbox("sub/R99_20260106_0847_copy.csv.gz"))
        .expect("a copy");
    let out = workshop.stdout(&["ingest", "inbox", "inbox"], 0);
    assert_eq!(out.lines().filter(|line| line.starts_with("known ")).count(), 4, "{out}");
    assert!(out.contains("\n0 stored, 4 known, 0 quarantined, 0 without result; "), "{out}");
    assert_eq!(workshop.dump(), before);
}
