//! Exports of makers are recognised by their columns, and files that only look like them are not.

use std::path::{Path, PathBuf};

use super::infer;
use super::proposal::{Hints, Proposed};
use crate::bytes::source::open;
use armwatch_config::{Layout, LayoutUnits, TimeSource, layout_units, maker_layouts, parse_layout};
use armwatch_model::robot::Robot;
use armwatch_testing::er3a;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/makers").join(name)
}

fn proposed(name: &str, hints: Hints<'_>) -> Proposed {
    let path = file(name);
    infer(open(&path).expect("a file"), &path, "a", hints).expect("a table")
}

fn of_text(text: &str) -> Proposed {
    infer(text.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect("a table")
}

fn text_of(name: &str) -> String {
    std::fs::read_to_string(file(name)).expect("a file")
}

fn answered(found: &Proposed) -> Layout {
    let text = found.answered.as_ref().unwrap_or_else(|| panic!("an open question\n{}", found.toml));
    parse_layout("proposed", text).unwrap_or_else(|errors| panic!("{errors}\n{text}"))
}

fn torque(found: &Proposed, joint: usize) -> String {
    answered(found).torque.columns.of_joint(joint).map_or_else(String::new, |column| column.to_string())
}

fn words_of(toml: &str) -> String {
    toml.lines().map(|line| line.trim_start_matches("# ")).collect::<Vec<_>>().join(" ")
}

#[test]
fn exports_of_makers_are_recognised_with_their_units() {
    let units = |time, position, velocity, torque| LayoutUnits { time, position, velocity, torque };
    let si = |time| units(Some(time), "rad", Some("rad/s"), "Nm");
    let currents = units(Some("s"), "rad", Some("rad/s"), "A");
    for (name, shipped, questions, first_torque, expected) in [
        ("ur_rtde.csv", "ur_rtde", 1, "actual_current_0", currents),
        ("ur_rtde_comma.csv", "ur10e_current", 1, "actual_current_0", currents),
        ("ros_topic_echo.csv", "ros_topic_echo", 3, "22", si("ns")),
        ("ros_joint_states.csv", "ros_joint_states", 3, "/joint_states/elbow_joint/effort", si("s")),
        ("rostopic_echo.csv", "ros_joint_states", 3, "field.effort0", si("ns")),
        ("franka_log.csv", "franka_log", 0, "state.tau_J[0]", si("ms")),
        ("franka_states.csv", "franka_states", 0, "field.tau_J0", si("ns")),
        (
            "kuka_trace_NextGenDrive#1.dat",
            "kuka_trace",
            0,
            "Istmoment#1 [Nm]",
            units(Some("s"), "deg", None, "Nm"),
        ),
        ("twincat_scope.csv", "twincat_scope", 0, "fActTorque_A1 [Nm]", units(Some("ms"), "deg", None, "Nm")),
        (
            "codesys_trace.csv",
            "codesys_trace",
            1,
            "PLC_PRG.Axis1.fActTorque",
            units(Some("ms"), "deg", Some("deg/s"), "Nm"),
        ),
    ] {
        assert_recognised(&proposed(name, Hints::default()), shipped, questions, first_torque, expected);
    }
}

/// The columns are those of the names, and what the names do not say is a question.
#[test]
fn exports_of_recorders_are_recognised_by_a_line_or_by_variables_and_their_units_asked() {
    let units = |time, position, velocity, torque| LayoutUnits { time, position, velocity, torque };
    for (name, shipped, questions, first_torque, expected) in [
        (
            "br_trace.csv",
            "br_trace",
            1,
            "MpAxisBasic_01.Info.CyclicRead.Torque.Value",
            units(Some("s"), "deg", Some("deg/s"), "Nm"),
        ),
        (
            "abb_tunemaster.csv",
            "abb_tunemaster",
            1,
            "ROB_1 axis 1 torque",
            units(Some("s"), "deg", Some("deg/s"), "Nm"),
        ),
        // the disturbance torque is calculated
        (
            "fanuc_axis_log.csv",
            "fanuc_axis_log",
            2,
            "$MOR_GRP[1].$CUR_DIS_TRQ[1]",
            units(Some("ms"), "rad", None, "Nm"),
        ),
        ("denso_control_log.csv", "denso_control_log", 1, "J1 Current", units(Some("ms"), "deg", None, "A")),
        (
            "staubli_recorder.csv",
            "staubli_recorder",
            1,
            "jntTorque_1",
            units(Some("s"), "deg", Some("deg/s"), "Nm"),
        ),
    ] {
        // the name of the file is no evidence here
        assert_recognised(&of_text(&text_of(name)), shipped, questions, first_torque, expected);
    }
}

fn assert_recognised(
    found: &Proposed,
    shipped: &'static str,
    questions: usize,
    first_torque: &str,
    expected: LayoutUnits,
) {
    assert_eq!((found.shipped, found.questions), (Some(shipped), questions), "{}", found.toml);
    assert_eq!(torque(found, 1), first_torque, "{}", found.toml);
    assert_eq!(layout_units(&answered(found)), expected, "{}", found.toml);
    assert!(found.toml.contains(&format!("the shipped layout {shipped} ")), "{}", found.toml);
}

#[test]
fn a_recorder_is_named_by_one_word_and_not_by_two() {
    let text = text_of("denso_control_log.csv");
    let without_title = text.split_once('\n').expect("a title").1;
    let of_file = |name: &str| {
        infer(without_title.as_bytes(), Path::new(name), "a", Hints::default()).expect("a table")
    };
    for (name, shipped) in [
        ("a.csv", None),
        ("FANUC_R01.csv", Some("fanuc_axis_log")),
        ("abb-and-denso.csv", None),
        ("abbreviated.csv", None),
    ] {
        let found = of_file(name);
        assert_eq!(found.shipped, shipped, "{name}\n{}", found.toml);
        assert_eq!(torque(&found, 1), "J1 Current", "{name}");
    }
}

#[test]
fn a_shipped_layout_loads_or_asks() {
    let mut asking = Vec::new();
    for (name, text) in maker_layouts() {
        match parse_layout(name, text) {
            Ok(layout) => assert_eq!(layout.name, name),
            Err(errors) => {
                assert!(text.contains("\n# ? "), "{name}: {errors}");
                asking.push(name);
            }
        }
    }
    asking.sort_unstable();
    let without_columns = [
        "abb_tunemaster",
        "br_trace",
        "codesys_trace",
        "denso_control_log",
        "fanuc_axis_log",
        "staubli_recorder",
        "twincat_scope",
    ];
    assert_eq!(asking, without_columns);
}

/// An arm whose joints have the names of a UR arm.
fn ur() -> Robot {
    let mut robot = er3a();
    let names = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];
    for (joint, name) in robot.joints.iter_mut().zip(names) {
        joint.name = Some(format!("{name}_joint"));
        (joint.limits.position_min, joint.limits.position_max) = (-6.3, 6.3);
    }
    robot
}

#[test]
fn names_of_the_description_give_the_order_of_joint_states() {
    let robot = ur();
    let hints = Hints { robot: Some(&robot), ..Hints::default() };
    for (name, first, third) in [
        ("ros_topic_echo.csv", "24", "22"),
        (
            "ros_joint_states.csv",
            "/joint_states/shoulder_pan_joint/effort",
            "/joint_states/elbow_joint/effort",
        ),
        ("rostopic_echo.csv", "field.effort2", "field.effort0"),
    ] {
        let found = proposed(name, hints);
        assert_eq!(found.questions, 0, "{name}\n{}", found.toml);
        assert_eq!((torque(&found, 1).as_str(), torque(&found, 3).as_str()), (first, third), "{name}");
    }
    // the other spellings of recorders
    let plain = text_of("ros_joint_states.csv");
    let underlined = plain.replace("/joint_states/", "").replace("_joint/", "_joint_");
    let found = infer(underlined.as_bytes(), Path::new("a.csv"), "a", hints).expect("a table");
    assert_eq!((found.questions, torque(&found, 3).as_str()), (0, "elbow_joint_effort"), "{}", found.toml);
}

#[test]
fn drive_gains_of_the_description_answer_the_question_about_currents() {
    let found = proposed("ur_rtde.csv", Hints::default());
    assert!(words_of(&found.toml).contains("? currents become torques by drive_gain_nm_a"), "{}", found.toml);
    let mut robot = ur();
    robot.joints.iter_mut().for_each(|joint| joint.drive_gain = Some(10.0));
    let found = proposed("ur_rtde.csv", Hints { robot: Some(&robot), ..Hints::default() });
    assert_eq!((found.questions, found.shipped), (0, Some("ur_rtde")), "{}", found.toml);
}

/// Multiplies the numbers of the columns whose names contain `part`.
fn scaled(text: &str, delimiter: char, part: &str, factor: f64) -> String {
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let chosen: Vec<bool> = header.split(delimiter).map(|name| name.contains(part)).collect();
    let row = |line: &str| {
        let cells = line.split(delimiter).zip(&chosen).map(|(cell, chosen)| match chosen {
            true => format!("{:.6}", factor * cell.parse::<f64>().expect("a number")),
            false => cell.to_owned(),
        });
        cells.collect::<Vec<_>>().join(&delimiter.to_string())
    };
    std::iter::once(header.to_owned()).chain(lines.map(row)).map(|line| line + "\n").collect()
}

#[test]
fn the_names_of_a_maker_with_other_units_are_not_its_layout() {
    let ur = text_of("ur_rtde_comma.csv");
    let degrees = scaled(&ur, ',', "actual_q", 1.0_f64.to_degrees());
    let franka = text_of("franka_log.csv");
    let franka_degrees =
        scaled(&scaled(&franka, ',', "state.q", 1.0_f64.to_degrees()), ',', "state.dq", 1.0_f64.to_degrees());
    for (case, text, position, velocity, torque) in [
        ("degrees", &degrees, "deg", "deg/s", "A"),
        (
            "degrees of positions alone",
            &scaled(&ur, ',', "actual_q_", 1.0_f64.to_degrees()),
            "deg",
            "rad/s",
            "A",
        ),
        ("milliamperes", &scaled(&ur, ',', "current", 1000.0), "rad", "rad/s", "mA"),
        ("degrees of franka", &franka_degrees, "deg", "deg/s", "Nm"),
    ] {
        let found = of_text(text);
        assert_eq!(found.shipped, None, "{case}\n{}", found.toml);
        let said = "The columns have the names of the shipped layout";
        assert!(words_of(&found.toml).contains(said), "{case}\n{}", found.toml);
        let units = layout_units(&answered(&found));
        let found = (units.position, units.velocity, units.torque);
        assert_eq!(found, (position, Some(velocity), torque), "{case}");
    }
    // libfranka writes ms; velocities show the seconds
    let seconds = of_text(&scaled(&franka, ',', "time", 1e-3));
    let TimeSource::Column(time) = answered(&seconds).time else { panic!("{}", seconds.toml) };
    assert_eq!((seconds.shipped, time.to_si), (None, 1.0), "{}", seconds.toml);
}

#[test]
fn another_order_of_columns_is_the_layout_and_a_missing_channel_is_not() {
    let ur = text_of("ur_rtde_comma.csv");
    let reversed: String =
        ur.lines().map(|line| line.split(',').rev().collect::<Vec<_>>().join(",") + "\n").collect();
    let found = of_text(&reversed);
    assert_eq!((found.shipped, torque(&found, 1).as_str()), (Some("ur10e_current"), "actual_current_0"));
    for missing in ["actual_current_5", "actual_q_3", "actual_qd_0"] {
        let found = of_text(&ur.replace(missing, "note"));
        assert_eq!(found.shipped, None, "{missing}");
        let whole = found.questions > 0 || found.joints == 6;
        assert!(whole, "{missing}\n{}", found.toml);
    }
    // no torque but that which the controller calculates
    let target = of_text(&ur.replace("actual_current", "target_moment"));
    assert!(target.shipped.is_none() && target.questions > 0, "{}", target.toml);
    // joint states whose efforts are not recorded
    let echo: String = text_of("ros_topic_echo.csv")
        .lines()
        .map(|line| line.split(',').take(21).collect::<Vec<_>>().join(",") + "\n")
        .collect();
    let found = of_text(&echo);
    assert!(found.shipped.is_none() && found.questions > 0, "{}", found.toml);
}

/// The following error of a drive, and the set values of a controller, are not measurements.
#[test]
fn set_values_and_following_errors_are_no_second_candidates() {
    let text = text_of("codesys_trace.csv").replace("fActVelocity", "fSetPosition");
    let found = of_text(&text);
    assert_eq!(found.questions, 1, "{}", found.toml);
    assert_eq!(
        answered(&found).position.columns.of_joint(1).map(|of| of.to_string()).as_deref(),
        Some("PLC_PRG.Axis1.fActPosition")
    );
    let drives = "Zeit [ms],Istposition A1,Istposition A2,Positionsschleppfehler A1,Positionsschleppfehler A2,Istmoment A1,Istmoment A2\n";
    let row = |row: u32| {
        let t = f64::from(row) / 50.0;
        format!(
            "{},{:.5},{:.5},{:.5},{:.5},{:.5},{:.5}\n",
            20 * row,
            t.sin(),
            (2.0 * t).sin(),
            0.01 * t.cos(),
            0.02 * t.cos(),
            t.cos(),
            (2.0 * t).cos()
        )
    };
    let found = of_text(&(drives.to_owned() + &(0..200).map(row).collect::<String>()));
    assert_eq!(found.questions, 0, "{}", found.toml);
}
