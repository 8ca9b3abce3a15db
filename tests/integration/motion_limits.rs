//! Limits of test motions on torque, shape and speed: checks and exit statuses.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::Workshop;

/// Tolerance of equal sums.
const EQUAL: f64 = 1e-9;

/// The arm of the tutorial, with these lines for each joint and before the first joint.
fn describe(workshop: &Workshop, name: &str, of_joints: &str, of_arm: &str) {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/first-arm.md");
    let page = fs::read_to_string(page).expect("the tutorial");
    let mine = page.split("```toml\n").nth(1).expect("a description").split("```").next().expect("an end");
    let mine = mine.replace("gear_ratio = 100", &format!("gear_ratio = 100\n{of_joints}")).replacen(
        "[[joint]]",
        &format!("{of_arm}\n[[joint]]"),
        1,
    );
    fs::write(workshop.path(name), mine).expect("written");
}

const COUPLED: &str =
    "[transmission]\nmotor_per_joint = [[100, 0], [50, 100]]\n[[coupling]]\njoints = [1, 2]\nmotor = 2\n";

/// A motion of some degrees, and its samples.
fn motion(workshop: &Workshop) {
    let joint =
        "{\"type\": \"revolute\", \"centre_rad\": 0.2, \"a_rad_s\": [0.3, -0.3], \"b_rad_s\": [0.2, -0.1]}";
    let programme = format!(
        "{{\"format\": \"armwatch-trajectory\", \"version\": 1, \"robot\": \"mine\", \"base_frequency_hz\": 0.25, \
         \"joints\": [{joint}, {joint}]}}"
    );
    fs::write(workshop.path("motion.json"), programme).expect("written");
}

fn checked(workshop: &Workshop, file: &str, robot: &str, code: i32) -> Value {
    let shown = workshop.stdout(&["trajectory", "check", file, "--robot", robot, "--json"], code);
    serde_json::from_str(&shown).expect("JSON")
}

#[test]
fn torques_of_coupled_motors_are_checked() {
    let workshop = Workshop::new();
    motion(&workshop);
    let rated = "rated_motor_torque_nm = 0.05\npeak_joint_torque_nm = 11";
    describe(&workshop, "coupled.toml", rated, COUPLED);
    describe(&workshop, "plain.toml", rated, "");
    let found = checked(&workshop, "motion.json", "coupled.toml", 1);
    let broken = found["broken"].as_array().expect("a list");
    assert_eq!((broken.len(), &broken[0]["joint"], &broken[0]["quantity"]), (1, &2.into(), &"torque".into()));
    assert_eq!(found["not_judged"].as_array().map(Vec::len), Some(0), "{found}");
    // without inertia and friction of the coupled motor, joint torques are those of the arm without coupling
    let plain = checked(&workshop, "motion.json", "plain.toml", 1);
    let figure =
        |of: &Value, joint: usize, name: &str| of["torques"][joint][name].as_f64().expect("a number");
    for joint in 0..2 {
        for name in ["torque_rms_nm", "torque_peak_nm"] {
            assert!(
                (figure(&found, joint, name) - figure(&plain, joint, name)).abs() < EQUAL,
                "{found} {plain}"
            );
        }
    }
    // motor 1 carries tau_1 - 50/100 tau_2, motor 2 tau_2
    let duty = |of: &Value, joint| figure(of, joint, "duty_torque_rms_nm");
    assert!((duty(&found, 1) - duty(&plain, 1)).abs() < EQUAL);
    assert!((duty(&found, 0) - duty(&plain, 0)).abs() > 0.3, "{found} {plain}");
    let told = workshop.stderr(&["trajectory", "check", "motion.json", "--robot", "coupled.toml"], 1);
    assert!(told.contains("without inertia and friction of coupled motors"), "{told}");

    // a search keeps the peak torque of a joint with a coupled motor; without it, joint 1 needs 16.5 Nm
    describe(&workshop, "limited.toml", "peak_joint_torque_nm = 16", COUPLED);
    let design = ["trajectory", "design", "--harmonics", "3", "--seconds", "6", "--starts", "2", "--json"];
    let shown = workshop.stdout(&[&design[..], &["--columns", "all", "--robot", "limited.toml"]].concat(), 0);
    let shown: Value = serde_json::from_str(&shown).expect("JSON");
    assert!((0..2).all(|joint| figure(&shown, joint, "torque_peak_nm") <= 16.0), "{shown}");
}

#[test]
fn a_described_limit_that_is_not_checked_is_told_with_its_reason() {
    let workshop = Workshop::new();
    motion(&workshop);
    describe(&workshop, "plain.toml", "", "");
    describe(&workshop, "peak.toml", "peak_joint_torque_nm = 200", "");
    let capsule = "[[capsule]]\nlink = 2\nfrom_m = [0, 0, 0]\nto_m = [0.3, 0, 0]\nradius_m = 0.04\n";
    describe(&workshop, "shape.toml", "", capsule);
    let text = fs::read_to_string(workshop.path("peak.toml")).expect("a description");
    let bare: String = text.split("[joint.nominal]").next().expect("joint 1").to_owned()
        + "[[joint]]"
        + text.rsplit("[[joint]]").next().expect("joint 2");
    fs::write(workshop.path("bare.toml"), bare).expect("written");

    let export = ["trajectory", "export", "motion.json", "--rate-hz", "200", "--robot", "plain.toml", "-o"];
    workshop.stdout(&[&export[..], &["motion.csv"]].concat(), 0);
    workshop.stdout(&[&export[..], &["waypoints.csv", "--waypoints"]].concat(), 0);
    // limits that are not described do not count
    for (file, robot, quantity, joints, reason) in [
        ("waypoints.csv", "peak.toml", "peak torque", 2, "the file has no velocities and accelerations"),
        ("motion.json", "bare.toml", "peak torque", 2, "joint 1 has no [joint.nominal]"),
        ("motion.csv", "shape.toml", "clearance", 1, "no pairs of links (self_collision), and no --cell"),
    ] {
        assert_eq!(checked(&workshop, file, "plain.toml", 0)["kept"], true, "{file}");
        let found = checked(&workshop, file, robot, 1);
        let unchecked = found["not_judged"].as_array().expect("a list");
        assert_eq!((unchecked.len(), &found["kept"]), (joints, &false.into()), "{found}");
        for of in unchecked {
            assert_eq!(of["quantity"], quantity);
            assert!(of["reason"].as_str().expect("a reason").contains(reason), "{of}");
        }
        let shown = workshop.stdout(&["trajectory", "check", file, "--robot", robot], 1);
        assert!(shown.contains("NOT JUDGED") && shown.contains(reason), "{shown}");
        assert!(!shown.contains("Every limit is kept"), "{shown}");
    }
    checked(&workshop, "motion.csv", "peak.toml", 0);
    let design = ["trajectory", "design", "--harmonics", "2", "--seconds", "6", "--starts", "1", "--robot"];
    let told = workshop.stderr(&[&design[..], &["bare.toml"]].concat(), 0);
    assert!(told.contains("not judged: joint 2: peak torque; joint 1 has no [joint.nominal]"), "{told}");
}

#[test]
fn a_required_speed_that_is_not_reached_is_exit_status_1() {
    let workshop = Workshop::new();
    describe(&workshop, "mine.toml", "", "");
    let design = ["trajectory", "design", "--robot", "mine.toml", "--harmonics", "2", "--starts", "1"];
    let slow = ["--seconds", "40", "--reach-speed-share", "0.9", "-o", "slow.json"];
    let told = workshop.stderr(&[&design[..], &slow].concat(), 1);
    for part in [
        "of its top speed, not the required 90.0 %",
        "more harmonics per second of duration (more --harmonics than 2 or fewer --seconds than 40)",
    ] {
        assert!(told.contains(part), "{told}");
    }
    assert!(workshop.path("slow.json").exists());
    let fast = ["--seconds", "6", "--reach-speed-share", "0.3"];
    workshop.stdout(&[&design[..], &fast].concat(), 0);
}

#[test]
fn a_robot_of_the_pattern_of_all_is_named_by_its_model() {
    let workshop = Workshop::new();
    motion(&workshop);
    let told = workshop.stderr(&["trajectory", "check", "motion.json", "--robot", "R01"], 2);
    assert!(
        told.contains("if it is a robot of the entry name = \"*\", write its model, --robot er3a"),
        "{told}"
    );
    // any other pattern names the robot
    workshop.configure(|text| text.replace("name = \"*\"", "name = \"R*\""));
    let told = workshop.stderr(&["trajectory", "check", "motion.json", "--robot", "R01"], 2);
    assert!(told.contains("has 6 joints"), "{told}");
    let told = workshop.stderr(&["trajectory", "check", "motion.json", "--robot", "X01"], 2);
    assert!(told.contains("neither a robot nor a model of the configuration, which has er3a"), "{told}");
}
