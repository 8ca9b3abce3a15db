//! Recordings without excitation: the friction test of one joint at a time gives its points.

use std::fs;

use armwatch_testing::noise::Noise;

use crate::bad_input::decompressed;
use crate::support::Workshop;

/// Column of the stage, and of the joint under friction test, in the native layout.
const STAGE: usize = 19;
const JOINT: usize = 21;

/// The header and the rows of the reference export that `keep` returns true for.
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
    // gravity from a fit of the file itself, without a model
    let others = "SELECT COUNT(*) FROM friction_points WHERE robot LIKE 'J_' AND robot <> 'J' || joint";
    assert_eq!(workshop.number(others), 0);
}

/// Joint 5 of the ER3A moves by half a radian, once or back and forth, at a level of its speed; all other joints rest.
/// Friction is 2 + 1 v, the load 0.4 cos(q + 0.3).
fn moves_of_joint_5(back: bool, seed: u64) -> String {
    const ACCELERATION: f64 = 0.9;
    const SPEED: f64 = 0.279_25;
    const TRAVEL: f64 = 0.5;
    let (ramp, hold) = (SPEED / ACCELERATION, TRAVEL / SPEED - SPEED / ACCELERATION);
    let way = 2.0 * ramp + hold;
    let at = |t: f64| {
        let left = way - t;
        match t {
            t if t < 0.0 => (0.0, 0.0),
            t if t >= way => (TRAVEL, 0.0),
            t if t < ramp => (0.5 * ACCELERATION * t * t, ACCELERATION * t),
            t if t < ramp + hold => (0.5 * SPEED * ramp + SPEED * (t - ramp), SPEED),
            _ => (TRAVEL - 0.5 * ACCELERATION * left * left, ACCELERATION * left),
        }
    };
    let mut noise = Noise(seed);
    let columns = |name: &str| (1..=6).map(|j| format!("{name}_{j}")).collect::<Vec<_>>().join(",");
    let mut text = format!("time,{},{},{},stage,cycle\n", columns("pos"), columns("vel"), columns("trq"));
    for row in 0..800 {
        let t = f64::from(row) / 100.0;
        let (out, home) = (at(t - 1.0), at(t - 4.0));
        let (s, v) = if back { (out.0 - home.0, out.1 - home.1) } else { out };
        let q = s - 0.5;
        let friction = if v.abs() > 0.002 { 2.0 * v.signum() + v } else { 0.0 };
        let torque = friction + 0.4 * (q + 0.3).cos();
        let stage = if (0.9..7.0).contains(&t) { 2 } else { 0 };
        let torques: Vec<String> = [0.0, 30.0, 5.0, 0.0, torque, 0.0]
            .iter()
            .map(|of| format!("{:.4}", of + 0.02 * noise.normal()))
            .collect();
        text.push_str(&format!(
            "{t:.3},0,-1.57,0,0,{q:.5},0,0,0,0,0,{v:.5},0,{},{stage},1\n",
            torques.join(",")
        ));
    }
    text
}

#[test]
fn a_short_move_one_way_gives_no_friction_and_says_why() {
    let workshop = Workshop::new();
    for seed in 1..=8 {
        for (robot, back) in [("Once", false), ("Twice", true)] {
            let name = format!("{robot}{seed}_20260105_0847.csv");
            fs::write(workshop.inbox(&name), moves_of_joint_5(back, seed)).expect("an export");
        }
    }
    workshop.run(&["ingest", "inbox"]);
    let count = |of: &str| workshop.number(&format!("SELECT COUNT(*) FROM {of}"));
    assert_eq!(count("friction_points WHERE robot LIKE 'Once%'"), 0);
    let why = "cycles WHERE robot LIKE 'Once%' AND remarks LIKE '%does not tell friction from the load of gravity%'";
    assert_eq!(count(why), 8, "{:?}", workshop.query("SELECT robot, remarks FROM cycles"));
    assert_eq!(count("friction_points WHERE robot LIKE 'Twice%'"), 16);
    let wrong = "friction_points WHERE robot LIKE 'Twice%' AND abs(abs(torque_nm) - 2.279_25) > 3 * std_nm";
    assert_eq!(count(wrong), 0, "{:?}", workshop.query("SELECT torque_nm, std_nm FROM friction_points"));
}
