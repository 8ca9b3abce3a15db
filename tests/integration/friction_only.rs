//! Recordings without excitation: the friction test of one joint at a time gives its points.

use std::fs;

use crate::bad_input::decompressed;
use crate::support::Workshop;

/// Column of the stage, and of the joint under friction test, in the native layout.
const STAGE: usize = 19;
const JOINT: usize = 21;

/// Rows of the reference export, those of `stage` with this number in `column`; other stages read as between.
fn part(keep: impl Fn(&[&str]) -> bool) -> String {
    let text = decompressed();
    let mut lines = text.lines();
    let header = lines.next().expect("a header").to_owned() + "\n";
    header
        + &lines
            .filter(|line| keep(&line.split(',').collect::<Vec<_>>()))
            .map(|l| l.to_owned() + "\n")
            .collect::<String>()
}

#[test]
fn the_friction_test_of_one_joint_in_a_file_gives_its_points() {
    let workshop = Workshop::new();
    fs::write(workshop.inbox("Whole_20260105_0847.csv"), decompressed()).expect("an export");
    for joint in 1..=6 {
        let text = part(|cells| cells[STAGE] == "2" && cells[JOINT] == joint.to_string());
        fs::write(workshop.inbox(&format!("J{joint}_20260105_0847.csv")), text).expect("an export");
    }
    workshop.run(&["ingest", "inbox"]);
    assert_eq!(workshop.number("SELECT COUNT(*) FROM runs WHERE status = 'complete'"), 7);
    for joint in 1..=6 {
        let points = |robot: &str| {
            workshop.query(&format!(
                "SELECT cycle, speed_fraction, direction, round(torque_nm, 1) FROM friction_points
                 WHERE robot = '{robot}' AND joint = {joint} ORDER BY cycle, speed_fraction, direction"
            ))
        };
        let (alone, whole) = (points(&format!("J{joint}")), points("Whole"));
        assert!(!whole.is_empty());
        assert_eq!(alone.len(), whole.len(), "joint {joint}");
        let reasons =
            workshop.query(&format!("SELECT DISTINCT status, reason FROM cycles WHERE robot = 'J{joint}'"));
        let expected = format!(
            "refused|the cycle has no excitation stage to identify parameters on; the friction points of joint {joint} are \
             kept"
        );
        assert_eq!(reasons, [expected]);
        let remarks =
            workshop.query(&format!("SELECT remarks FROM cycles WHERE robot = 'J{joint}'")).join(" ");
        assert!(remarks.contains(&format!("the friction stage tests joint {joint} only")), "{remarks}");
        assert!(!remarks.contains("excitation lasts") && !remarks.contains("stands still"), "{remarks}");
    }
    // gravity by the fit of the file itself, as without a model
    let others = "SELECT COUNT(*) FROM friction_points WHERE robot LIKE 'J_' AND robot <> 'J' || joint";
    assert_eq!(workshop.number(others), 0);
}
