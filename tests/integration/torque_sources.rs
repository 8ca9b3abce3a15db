//! One run in several units is one recording; wrong gains are found from two runs.

use std::fs;
use std::path::Path;

use crate::support::{Workshop, query, text};

/// Exports contain all digits. Units, gears and their inverses round a few times, and the identification multiplies
/// that error by its condition number.
const EQUAL: f64 = 1e-9;

fn shipped(name: &str) -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(name)).expect("a file")
}

/// The ER3A with a motor of axis 6 that turns with axis 5, offsets, and gains; `scale` are the errors of the drive
/// gains.
fn arm(scale: [f64; 6]) -> String {
    let mut joint = 0;
    let mut matrix = [[0.0; 6]; 6];
    let mut lines = Vec::new();
    for line in shipped("robots/er3a.toml").lines() {
        lines.push(line.to_owned());
        if let Some(ratio) = line.strip_prefix("gear_ratio = ") {
            let ratio = ratio.split_whitespace().next().and_then(|word| word.parse::<f64>().ok());
            matrix[joint][joint] = ratio.expect("a ratio");
            let k = (joint + 1) as f64;
            lines.push(format!("drive_gain_nm_a = {}", -(10.0 + k) * scale[joint]));
            lines.push(format!("motor_torque_constant_nm_a = {}", 0.1 + 0.05 * k));
            lines.push(format!("rated_joint_torque_nm = {}", 100.0 / k));
            joint += 1;
        }
    }
    matrix[5][4] = 0.4 * matrix[5][5];
    lines.push(format!("[transmission]\nmotor_per_joint = {matrix:?}"));
    lines.join("\n")
}

fn layout(position: &str, velocity: &str, torque: &str) -> String {
    shipped("exports/native.toml")
        .replace("column = \"pos_{joint}\"\nunit = \"rad\"", position)
        .replace("column = \"vel_{joint}\"\nunit = \"rad/s\"", velocity)
        .replace("column = \"trq_{joint}\"\nunit = \"Nm\"", torque)
}

/// Writes description, layout and a configuration that names both.
fn configure(workshop: &Workshop, name: &str, robot: &str, layout: &str) {
    fs::write(workshop.path(&format!("{name}_robot.toml")), robot).expect("a description");
    fs::write(workshop.path(&format!("{name}_layout.toml")), layout).expect("a layout");
    let config = format!(
        "database = \"{name}.db\"\n[[robot]]\nname = \"*\"\ndescription = \"{name}_robot.toml\"\n\
         layout = \"{name}_layout.toml\"\n"
    );
    fs::write(workshop.path(&format!("{name}.toml")), config).expect("a configuration");
}

#[test]
fn one_run_in_any_unit_gives_the_same_parameters() {
    let workshop = Workshop::new();
    let native = layout(
        "column = \"pos_{joint}\"\nunit = \"rad\"",
        "column = \"vel_{joint}\"\nunit = \"rad/s\"",
        "column = \"trq_{joint}\"\nunit = \"Nm\"",
    );
    let amperes = layout(
        "columns = [\"A1\", \"A2\", \"A3\", \"A4\", \"A5\", \"A6\"]\nunit = \"deg\"\nsign = -1",
        "column = \"v{joint+4}\"\nunit = \"rpm\"\nsign = -1",
        "columns = [2, 3, 5, 7, 11, 13]\nunit = \"mA\"\nsign = [1, -1, 1, 1, -1, 1]",
    );
    let motors = layout(
        "column = \"pos_{joint}\"\nunit = \"rev\"\nside = \"motor\"\nsign = [1, 1, -1, 1, 1, 1]",
        "column = \"vel_{joint}\"\nunit = \"rpm\"\nsign = [1, 1, -1, 1, 1, 1]",
        "column = \"trq_{joint}\"\nunit = \"%\"\nside = \"motor\"",
    );
    let currents = motors.replace("unit = \"%\"", "unit = \"A\"");
    let percent = native.replace("unit = \"Nm\"", "unit = \"permille\"");
    let mut expected: Option<Vec<f64>> = None;
    for (name, layout) in [
        ("native", native),
        ("amperes", amperes),
        ("motors", motors),
        ("currents", currents),
        ("percent", percent),
    ] {
        configure(&workshop, name, &arm([1.0; 6]), &layout);
        let (robot, file) = (format!("{name}_robot.toml"), format!("{name}_layout.toml"));
        let shape = ["--cycles", "1", "--warming-s", "0", "--robot", &robot, "--layout", &file];
        workshop.simulate(name, &shape);
        workshop.stdout(&["ingest", name, "--config", &format!("{name}.toml")], 0);
        let database = workshop.path(&format!("{name}.db"));
        let sql = "SELECT value FROM cycle_parameters ORDER BY joint, parameter";
        let found: Vec<f64> = query(&database, sql).iter().map(|v| v.parse().expect("a number")).collect();
        assert_eq!(found.len(), 64, "{name}");
        let expected = expected.get_or_insert_with(|| found.clone());
        let norm = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
        for (found, expected) in found.iter().zip(&*expected) {
            assert!((found - expected).abs() <= EQUAL * norm, "{name}: {found} {expected}");
        }
    }
}

#[test]
fn a_motor_side_column_holds_the_number_that_a_drive_would_show() {
    let workshop = Workshop::new();
    let native = shipped("exports/native.toml");
    let motors = native
        .replace("unit = \"rad\"", "unit = \"rev\"\nside = \"motor\"")
        .replace("unit = \"Nm\"", "unit = \"%\"\nside = \"motor\"");
    fs::write(workshop.path("arm.toml"), arm([1.0; 6])).expect("a description");
    let rows = |name: &str, layout: &str| {
        fs::write(workshop.path(&format!("{name}.toml")), layout).expect("a layout");
        let file = format!("{name}.toml");
        let shape = ["--cycles", "1", "--warming-s", "0", "--robot", "arm.toml", "--layout", &file];
        let export = fs::read_to_string(&workshop.simulate(name, &shape)[0]).expect("an export");
        let row =
            |line: &str| line.split(',').map(|c| c.parse::<f64>().expect("a number")).collect::<Vec<_>>();
        export.lines().skip(1).step_by(100).map(row).collect::<Vec<_>>()
    };
    for (joint, motor) in rows("joint", &native).iter().zip(&rows("motor", &motors)) {
        // columns: time, six positions, six velocities, six torques
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12 * (1.0 + b.abs()), "{a} {b}");
        // joint 1: gear of 121, motor of 0.64 Nm
        close(motor[1], 121.0 * joint[1] / std::f64::consts::TAU);
        close(motor[13], 100.0 * joint[13] / 121.0 / 0.64);
        // the motor of joint 6 produces all torque of that joint and 0.4 of its gear for joint 5
        let (ratio_5, ratio_6) = (ratio(4), ratio(5));
        close(motor[6], ratio_6 * (joint[6] + 0.4 * joint[5]) / std::f64::consts::TAU);
        close(motor[18], 100.0 * joint[18] / ratio_6 / 0.159);
        close(motor[17], 100.0 * (joint[17] - 0.4 * joint[18]) / ratio_5 / 0.159);
    }
}

/// Gear ratio of a joint, counted from 0, in the shipped file.
fn ratio(joint: usize) -> f64 {
    let file = shipped("robots/er3a.toml");
    let line = file.lines().filter_map(|line| line.strip_prefix("gear_ratio = ")).nth(joint);
    line.and_then(|line| line.split_whitespace().next()?.parse().ok()).expect("a ratio")
}

#[test]
fn wrong_gains_are_found_from_a_run_with_a_load() {
    const SCALE: [f64; 6] = [1.15, 0.9, 1.2, 0.85, 1.1, 0.95];
    let workshop = Workshop::new();
    let amperes = shipped("exports/native.toml").replace("unit = \"Nm\"", "unit = \"A\"");
    configure(&workshop, "true", &arm([1.0; 6]), &amperes);
    configure(&workshop, "wrong", &arm(SCALE), &amperes);
    let shape =
        ["--cycles", "6", "--warming-s", "5", "--robot", "true_robot.toml", "--layout", "true_layout.toml"];
    let load = [
        "--load-mass-kg",
        "4",
        "--load-centre-m",
        "0.06,-0.02,0.1",
        "--load-inertia-kg-m2",
        "0.01,0,0,0.01,0,0.02",
    ];
    workshop.simulate("inbox", &shape);
    let with = [&shape[..], &load, &["--seed", "2", "--start", "2026-01-06T08:47:00Z"]].concat();
    workshop.simulate("inbox", &with);
    workshop.stdout(&["ingest", "inbox", "--config", "wrong.toml"], 0);

    let ask =
        [&["robot", "drive-gains", "--config", "wrong.toml", "--without", "1", "--with", "2"][..], &load]
            .concat();
    let out = workshop.stdout(&[&ask[..], &["--json"]].concat(), 0);
    let out: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    let mut found = 0;
    for (j, of_joint) in out["joints"].as_array().expect("joints").iter().enumerate() {
        let Some(correction) = of_joint["correction"].as_f64() else {
            assert!(of_joint["reason"].as_str().is_some_and(|reason| !reason.is_empty()), "{of_joint}");
            continue;
        };
        found += 1;
        let end = |k: usize| of_joint["correction_interval"][k].as_f64().expect("an end");
        // twice the interval: one of six 95 % intervals may well miss the true value
        let error = (correction - 1.0 / SCALE[j]).abs();
        assert!(error <= end(1) - end(0), "{of_joint}, true correction {}", 1.0 / SCALE[j]);
        assert_eq!(of_joint["key"], "drive_gain_nm_a");
        let corrected = of_joint["corrected_value"].as_f64().expect("a gain");
        let expected = -(11.0 + j as f64) * SCALE[j] * correction;
        assert!((corrected / expected - 1.0).abs() < EQUAL, "{of_joint}");
    }
    assert!(found >= 4, "{out}");

    let table = workshop.stdout(&ask, 0);
    assert!(table.contains("drive_gain_nm_a then"), "{table}");
    for (arguments, said) in [
        (&["--without", "1", "--with", "1"][..], "cannot be both"),
        (&["--without", "1", "--with", "9"], "no run 9"),
        (&["--without", "1", "--with", "2", "--cycles", "7"], "no cycle 7"),
    ] {
        let ask = [&["robot", "drive-gains", "--config", "wrong.toml"][..], arguments, &load].concat();
        let output = workshop.stderr(&ask, 2);
        assert!(output.contains(said), "{output}");
    }
    // another geometry would give another position of the load
    let moved = fs::read_to_string(workshop.path("wrong_robot.toml"))
        .expect("it")
        .replace("d_m = 0.32", "d_m = 0.33");
    fs::write(workshop.path("wrong_robot.toml"), moved).expect("written");
    let output = workshop.run(&ask);
    assert!(text(&output.stderr).contains("another description"), "{}", text(&output.stderr));
}

#[test]
fn a_payload_is_found_within_its_intervals_although_gains_are_wrong() {
    const SCALE: [f64; 6] = [1.08, 0.93, 1.1, 0.92, 1.05, 0.97];
    let workshop = Workshop::new();
    let amperes = shipped("exports/native.toml").replace("unit = \"Nm\"", "unit = \"A\"");
    configure(&workshop, "true", &arm([1.0; 6]), &amperes);
    configure(&workshop, "wrong", &arm(SCALE), &amperes);
    let shape =
        ["--cycles", "4", "--warming-s", "5", "--robot", "true_robot.toml", "--layout", "true_layout.toml"];
    workshop.simulate("inbox", &shape);
    let load = ["--load-mass-kg", "2.8", "--load-centre-m", "0.06,-0.02,0.1", "--seed", "2"];
    workshop.simulate("inbox", &[&shape[..], &load, &["--start", "2026-01-06T08:47:00Z"]].concat());
    workshop.simulate("inbox", &[&shape[..], &["--name", "Other", "--seed", "3"]].concat());
    workshop.stdout(&["ingest", "inbox", "--config", "wrong.toml"], 0);
    let runs = query(&workshop.path("wrong.db"), "SELECT run_id FROM runs ORDER BY robot, started_at");
    let names = query(&workshop.path("wrong.db"), "SELECT source_name FROM runs ORDER BY robot, started_at");
    let [other, empty, loaded] = <[String; 3]>::try_from(runs).expect("three runs");
    let ask = |empty: &str, loaded: &str| {
        workshop.run(&["payload", "--config", "wrong.toml", "--empty", empty, "--loaded", loaded, "--json"])
    };

    // a run can be named by its number and by its export
    let by_number = text(&ask(&empty, &loaded).stdout);
    assert_eq!(by_number, text(&ask(&names[1], &names[2]).stdout));
    let found: serde_json::Value = serde_json::from_str(&by_number).expect("JSON");
    for (place, truth) in [2.8, 0.06, -0.02, 0.1].into_iter().enumerate() {
        let of = &found["quantities"][place];
        let end = |key: &str| of[key].as_f64().expect("shown");
        assert!((end("interval_low")..=end("interval_high")).contains(&truth), "{of}, not {truth}");
        // no interval is too wide to be useful
        let (low, high) = (end("interval_low"), end("interval_high"));
        assert!(high - low < if place == 0 { 1.0 } else { 0.1 }, "{of}");
    }
    assert_eq!(found["stated_gain_uncertainty"], 0.15);
    let table =
        workshop.stdout(&["payload", "--config", "wrong.toml", "--empty", &empty, "--loaded", &loaded], 0);
    assert!(table.contains("mass_kg") && table.contains("drive gains: error up to 15 %"), "{table}");

    workshop.stdout(&["set-aside", &loaded, "--config", "wrong.toml"], 0);
    for (of, with, said) in [
        (&empty, &loaded, "is set aside: choose another test"),
        (&empty, &empty, "cannot be both"),
        (&empty, &other, "compare two tests of one robot"),
        (&empty, &"none.csv".to_owned(), "neither the number of a run nor the name of an export"),
    ] {
        let output = ask(of, with);
        assert_eq!(output.status.code(), Some(2), "{of} {with}");
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
    }
}

#[test]
fn missing_gains_are_named_before_any_export_is_read() {
    let workshop = Workshop::new();
    configure(&workshop, "ur10e", &shipped("robots/ur10e.toml"), &shipped("exports/ur10e_current.toml"));
    let said = workshop.stderr(&["ingest", "inbox", "--config", "ur10e.toml"], 2);
    for word in ["drive_gain_nm_a of joint 1", "joint 6", "ur10e_robot.toml", "robot drive-gains"] {
        assert!(said.contains(word), "{word}: {said}");
    }
    let mut robot = String::new();
    for line in shipped("robots/ur10e.toml").lines() {
        robot += &format!("{line}\n");
        if line.starts_with("gear_ratio") {
            robot += "drive_gain_nm_a = 10\n";
        }
    }
    configure(&workshop, "ur10e", &robot, &shipped("exports/ur10e_current.toml"));
    workshop.stdout(&["config", "check", "--config", "ur10e.toml"], 0);
}
