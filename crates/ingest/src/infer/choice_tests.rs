//! Tests which of several columns a proposal selects, and its questions.

use std::fmt::Write;
use std::path::Path;

use super::proposal::{Hints, Proposed};
use super::{infer, infer_each_arm, name_words};
use armwatch_config::{Column, Layout, parse_layout};
use armwatch_model::robot::Robot;
use armwatch_testing::er3a;

/// Joints of the made recordings.
const N: usize = 3;

/// Rows of the made recordings, at 50 Hz.
const ROWS: usize = 400;

/// Position, velocity, acceleration and torque of a joint.
fn motion(row: usize, joint: usize) -> [f64; 4] {
    let (rate, time) = ((joint + 1) as f64 * 0.7, row as f64 / 50.0);
    let phase = rate * time + joint as f64;
    let [q, v, a] = [phase.sin(), rate * phase.cos(), -rate * rate * phase.sin()];
    [q, v, a, 3.0 * a + 2.0 * v + 10.0 * q.sin()]
}

/// Content of a column: time, a channel of [`motion`] of a joint, a constant, or one of a few values.
#[derive(Clone, Copy)]
enum Content {
    Time,
    Motion(usize, usize),
    Scaled(usize, usize, f64),
    Constant(f64),
    Gripper,
}

use Content::{Constant, Gripper, Motion, Scaled, Time};

fn recording(columns: &[(String, Content)], header: bool) -> String {
    let mut text = String::new();
    if header {
        text += &(columns.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(",") + "\n");
    }
    for row in 0..ROWS {
        let cell = |of: &Content| match *of {
            Time => row as f64 / 50.0,
            Motion(channel, joint) => motion(row, joint)[channel],
            Scaled(channel, joint, factor) => factor * motion(row, joint)[channel],
            Constant(value) => value,
            Gripper => f64::from(u8::try_from(row / 100 % 2).expect("0 or 1")),
        };
        let cells: Vec<String> = columns.iter().map(|(_, of)| format!("{:.6}", cell(of))).collect();
        writeln!(text, "{}", cells.join(",")).expect("a string");
    }
    text
}

fn joints(name: impl Fn(usize) -> String, of: impl Fn(usize) -> Content) -> Vec<(String, Content)> {
    (0..N).map(|joint| (name(joint + 1), of(joint))).collect()
}

fn proposed(columns: &[Vec<(String, Content)>], hints: Hints<'_>) -> Proposed {
    let header = !columns.iter().flatten().all(|(name, _)| name.is_empty());
    infer(recording(&columns.concat(), header).as_bytes(), Path::new("a.csv"), "a", hints).expect("a table")
}

fn time() -> Vec<(String, Content)> {
    vec![("time".into(), Time)]
}

/// The layout with the likely answers.
fn answered(proposed: &Proposed) -> Layout {
    let toml = proposed.answered.as_ref().unwrap_or_else(|| panic!("no answers\n{}", proposed.toml));
    parse_layout("a.toml", toml).unwrap_or_else(|errors| panic!("{errors}\n{toml}"))
}

fn first_of(columns: &armwatch_config::JointColumns) -> String {
    columns.of_joint(1).map_or_else(String::new, |column| match column {
        Column::Name(name) => name,
        Column::Number(number) => number.to_string(),
    })
}

/// The comments as one line.
fn words_of(toml: &str) -> String {
    toml.lines().map(|line| line.trim_start_matches('#').trim()).collect::<Vec<_>>().join(" ")
}

/// An arm of three joints, with or without names.
fn arm(names: Option<[&str; N]>) -> Robot {
    let mut robot = er3a();
    robot.joints.truncate(N);
    for (joint, of) in robot.joints.iter_mut().enumerate() {
        of.name = names.map(|names| names[joint].to_owned());
        (of.limits.position_min, of.limits.position_max) = (-3.0, 3.0);
    }
    robot
}

const STYLES: [fn(&str, &str, usize) -> String; 9] = [
    |word, base, j| format!("{word}_{base}_{j}"),
    |word, base, j| format!("{base}_{word}_{j}"),
    |word, base, j| format!("J{j} {word} {base}"),
    |word, base, j| format!("{word} {base} {j}"),
    |word, base, j| format!("{word}{}{j}", capital(base)),
    |word, base, j| format!("joint{j}_{base}_{word}"),
    |word, base, j| format!("{}{}{j}", capital(base), capital(word)),
    |word, base, j| format!("A{j}.{base}.{word}"),
    |word, base, j| format!("{base}{j}_{word}"),
];

fn capital(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[test]
fn no_header_with_an_intended_and_a_measured_channel_gives_the_intended_one() {
    let bases = [
        ["position", "pos", "q", "angle"],
        ["velocity", "speed", "qd", "vel"],
        ["torque", "tau", "effort", "moment"],
    ];
    let measured = ["", "actual", "measured", "fb", "ist", "sensor", "meas", "feedback"];
    let plain = |quantity: usize, base: &'static str| {
        joints(move |j| format!("{base}_{j}"), move |j| Motion([0, 1, 3][quantity], j))
    };
    let mut headers = 0;
    for (at, word) in name_words::INTENT.split_ascii_whitespace().enumerate() {
        for quantity in 0..3 {
            let base = bases[quantity][at % 4];
            let style = STYLES[(at + quantity) % STYLES.len()];
            let by = measured[(at / 4 + quantity) % measured.len()];
            let channel = [0, 1, 3][quantity];
            let wanted = joints(|j| style(word, base, j), |j| Scaled(channel, j, 0.9));
            let name = |j| if by.is_empty() { format!("{base}_{j}") } else { style(by, base, j) };
            let right = joints(name, |j| Motion(channel, j));
            for wanted_first in [true, false] {
                let both = if wanted_first {
                    [wanted.clone(), right.clone()]
                } else {
                    [right.clone(), wanted.clone()]
                };
                let others = (0..3)
                    .filter(|other| *other != quantity)
                    .map(|other| plain(other, bases[other][(at + 1) % 4]));
                let columns: Vec<_> = std::iter::once(time()).chain(both).chain(others).collect();
                let found = proposed(&columns, Hints::default());
                let layout = answered(&found);
                let taken = match quantity {
                    0 => first_of(&layout.position.columns),
                    1 => first_of(&layout.velocity.as_ref().expect("recorded").columns),
                    _ => first_of(&layout.torque.columns),
                };
                assert_eq!(taken, name(1), "beside {}\n{}", style(word, base, 1), found.toml);
                assert_eq!(found.questions, 0, "{}", found.toml);
                headers += 1;
            }
        }
    }
    assert!(headers > 200, "{headers}");
}

#[test]
fn an_intended_channel_alone_is_a_question() {
    for (at, word) in name_words::INTENT.split_ascii_whitespace().enumerate() {
        let style = STYLES[at % STYLES.len()];
        let torque = joints(|j| style(word, "torque", j), |j| Motion(3, j));
        let columns = [
            time(),
            joints(|j| format!("q{j}"), |j| Motion(0, j)),
            joints(|j| format!("qd{j}"), |j| Motion(1, j)),
            torque,
        ];
        let found = proposed(&columns, Hints::default());
        assert_eq!(found.questions, 1, "{}", found.toml);
        assert!(words_of(&found.toml).contains("? the name says \""), "{}", found.toml);
    }
}

/// Position, velocity and torque under plain names.
fn plain() -> [Vec<(String, Content)>; 3] {
    [
        joints(|j| format!("pos_{j}"), |j| Motion(0, j)),
        joints(|j| format!("vel_{j}"), |j| Motion(1, j)),
        joints(|j| format!("trq_{j}"), |j| Motion(3, j)),
    ]
}

#[test]
fn every_second_candidate_is_a_question_that_names_both() {
    let [position, velocity, torque] = plain();
    let arm = |side: &'static str| {
        [("q", 0), ("qd", 1), ("tau", 3)]
            .map(|(base, channel)| joints(move |j| format!("{side}_{base}{j}"), move |j| Motion(channel, j)))
    };
    let current = joints(|j| format!("current_{j}"), |j| Scaled(3, j, 0.1));
    let motor = joints(|j| format!("A{j}_pos_mot_deg"), |j| Scaled(0, j, 180.0 / std::f64::consts::PI));
    let dead = joints(|j| format!("A{j}_pos_se_deg"), |j| if j == 0 { Motion(0, j) } else { Constant(0.0) });
    let [left, right] = [arm("L"), arm("R")];
    /// Columns, the torque that is proposed, and names in the question.
    type Case = (Vec<Vec<(String, Content)>>, &'static str, &'static [&'static str]);
    let cases: [Case; 4] = [
        (
            [&[time()][..], &left, &right].concat(),
            "L_tau1",
            &["\"L_q{joint}\"", "\"R_q{joint}\"", "\"R_qd{joint}\"", "\"R_tau{joint}\""],
        ),
        (
            vec![time(), position.clone(), velocity.clone(), torque.clone(), current],
            "trq_1",
            &["\"current_{joint}\""],
        ),
        (
            vec![time(), dead, motor, velocity.clone(), torque.clone()],
            "trq_1",
            &["\"A{joint}_pos_mot_deg\", the set in which more columns move", "\"A{joint}_pos_se_deg\""],
        ),
        (
            vec![
                time(),
                position,
                velocity,
                torque,
                joints(|j| format!("torque_filtered_{j}"), |j| Scaled(3, j, 0.99)),
            ],
            "trq_1",
            &["\"torque_filtered_{joint}\""],
        ),
    ];
    for (columns, torque, named) in cases {
        let found = proposed(&columns, Hints::default());
        assert!(found.questions > 0, "{}", found.toml);
        let said = words_of(&found.toml);
        for name in named {
            assert!(said.contains(name), "{name}\n{}", found.toml);
        }
        assert_eq!(first_of(&answered(&found).torque.columns), torque, "{}", found.toml);
    }
}

#[test]
fn encoders_of_motors_and_links_are_compared() {
    let [link, velocity, torque] = plain();
    let motor = joints(|j| format!("motor_pos_{j}"), |j| Scaled(0, j, -100.0));
    let found = proposed(&[time(), motor, link, velocity, torque], Hints::default());
    let said = words_of(&found.toml);
    let compared = "the second set is [-100.0000, -100.0000, -100.0000] times the first, and differs from that by at most";
    assert!(found.questions == 1 && said.contains(compared), "{}", found.toml);
    assert_eq!(first_of(&answered(&found).position.columns), "pos_1", "{}", found.toml);
}

#[test]
fn joints_without_a_quantity_are_positions_with_a_question() {
    let [_, velocity, torque] = plain();
    let found = proposed(
        &[time(), joints(|j| format!("J{j}"), |j| Motion(0, j)), velocity, torque],
        Hints::default(),
    );
    assert!(
        found.questions == 1 && words_of(&found.toml).contains("Are these the positions?"),
        "{}",
        found.toml
    );
    assert_eq!(first_of(&answered(&found).position.columns), "J1", "{}", found.toml);
    let found = proposed(
        &[
            time(),
            joints(|j| format!("j{j}"), |j| Motion(0, j)),
            joints(|j| format!("x{j}"), |j| Motion(3, j)),
        ],
        Hints::default(),
    );
    assert!(found.joints == N && found.toml.contains("column = \"j{joint}\""), "{}", found.toml);
}

#[test]
fn each_of_several_arms_gets_a_layout_without_a_question() {
    let arm = |words: &'static str| {
        [("q", 0), ("qd", 1), ("tau", 3)]
            .map(|(base, channel)| joints(move |j| format!("{words}_{base}{j}"), move |j| Motion(channel, j)))
    };
    let each = |columns: &[Vec<(String, Content)>]| {
        let found = infer_each_arm(
            recording(&columns.concat(), true).as_bytes(),
            Path::new("a.csv"),
            "cell",
            Hints::default(),
        );
        found.expect("a table")
    };
    for [one, other] in [["L", "R"], ["left", "right"], ["arm1", "arm2"]] {
        let found = each(&[&[time()][..], &arm(one), &arm(other)].concat());
        assert_eq!(found.len(), 2, "{one}");
        for ((words, layout), side) in found.iter().zip([one, other]) {
            assert!(layout.toml.contains(&format!("name = \"cell_{}\"", words.as_deref().expect("an arm"))));
            assert_eq!(first_of(&answered(layout).torque.columns), format!("{side}_tau1"), "{}", layout.toml);
            assert_eq!(first_of(&answered(layout).position.columns), format!("{side}_q1"), "{}", layout.toml);
        }
    }
    // the two sides of the gears of one arm
    let [position, velocity, torque] = plain();
    let motor = joints(|j| format!("motor_pos_{j}"), |j| Scaled(0, j, 100.0));
    let motor_torque = joints(|j| format!("motor_trq_{j}"), |j| Scaled(3, j, 0.01));
    let found = each(&[time(), position, velocity, torque, motor, motor_torque]);
    assert_eq!((found.len(), &found[0].0), (1, &None));
}

#[test]
fn values_of_the_tool_and_accelerations_are_no_second_candidates() {
    let [position, velocity, torque] = plain();
    let tool = joints(|j| format!("actual_TCP_speed_{j}"), |j| Scaled(1, j, 0.3));
    let acceleration = joints(|j| format!("qdd_{j}"), |j| Motion(2, j));
    let found = proposed(&[time(), position, velocity, torque, tool, acceleration], Hints::default());
    assert_eq!(found.questions, 0, "{}", found.toml);
    // accelerations under the name of torques
    let [position, velocity, _] = plain();
    let named = joints(|j| format!("effort_{j}"), |j| Motion(2, j));
    let found = proposed(&[time(), position, velocity, named], Hints::default());
    let said = words_of(&found.toml);
    assert!(said.contains("? which columns hold the torques?") && found.answered.is_none(), "{}", found.toml);
    assert!(said.contains("effort_1 (an acceleration, the derivative of the velocities)"), "{}", found.toml);
}

#[test]
fn a_recorder_of_robot_data_gives_its_currents_and_not_its_target_moments() {
    let text = include_str!("../../../../tests/fixtures/infer/rtde_target_moment.csv");
    let found = infer(text.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect("a table");
    // whether the description has drive gains
    assert_eq!(found.questions, 1, "{}", found.toml);
    assert_eq!(first_of(&answered(&found).torque.columns), "actual_current_0");
    assert!(
        words_of(&found.toml)
            .contains("target_moment_0 (by its name a command or a calculated value, not measured)")
    );
    let alone = text.replace("actual_current", "note");
    let found = infer(alone.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect("a table");
    assert!(
        found.questions == 1 && words_of(&found.toml).contains("? the name says \"target\""),
        "{}",
        found.toml
    );
}

/// Columns without names.
fn nameless(columns: &[&[Content]]) -> Vec<Vec<(String, Content)>> {
    columns.iter().map(|block| block.iter().map(|of| (String::new(), *of)).collect()).collect()
}

fn block(channel: usize) -> [Content; N] {
    std::array::from_fn(|joint| Motion(channel, joint))
}

#[test]
fn blocks_without_names_are_found_by_their_derivatives() {
    let robot = arm(None);
    let hints = Hints { robot: Some(&robot), sample_rate: Some(50.0), ..Hints::default() };
    for (columns, position, velocity, torque) in [
        (nameless(&[&block(0), &block(1), &block(2), &block(3)]), "1", "4", "10"),
        (nameless(&[&block(0), &block(1), &block(3), &block(2)]), "1", "4", "7"),
        (nameless(&[&[Time], &block(0), &block(1), &block(3)]), "2", "5", "8"),
        (
            nameless(&[
                &[Time],
                &block(0),
                &[Constant(0.03)],
                &block(1),
                &[Constant(0.0)],
                &block(3),
                &[Constant(0.1)],
            ]),
            "2",
            "6",
            "10",
        ),
        // a resting joint
        (
            nameless(&[
                &[Time],
                &[Constant(0.2), Motion(0, 1), Motion(0, 2)],
                &[Constant(0.0), Motion(1, 1), Motion(1, 2)],
                &[Constant(1.0), Motion(3, 1), Motion(3, 2)],
            ]),
            "2",
            "5",
            "8",
        ),
    ] {
        for hints in [hints, Hints { sample_rate: Some(50.0), ..Hints::default() }] {
            let found = proposed(&columns, hints);
            if hints.robot.is_none() && matches!(columns[1][0].1, Constant(_)) {
                // without the number of joints, the first seems to be none
                assert!(found.questions >= 3, "{}", found.toml);
                continue;
            }
            let layout = answered(&found);
            let taken = [
                first_of(&layout.position.columns),
                first_of(&layout.velocity.as_ref().expect("recorded").columns),
                first_of(&layout.torque.columns),
            ];
            assert_eq!(taken, [position, velocity, torque], "{}", found.toml);
            assert_eq!(found.joints, N);
            // the unit of the torques is asked; without a description, the number of joints too
            assert!(found.questions > 0 && (hints.robot.is_some() || found.questions >= 3), "{}", found.toml);
        }
    }
    // there is no proof of their meaning: torques never without a question
    let found = proposed(&nameless(&[&[Time], &block(0), &block(3)]), hints);
    assert!(words_of(&found.toml).contains("this follows only from their order"), "{}", found.toml);
    let found = proposed(&nameless(&[&[Time], &block(0), &block(2), &block(3)]), hints);
    assert_eq!(first_of(&answered(&found).torque.columns), "8", "{}", found.toml);
    // two blocks may be torques
    let found = proposed(&nameless(&[&[Time], &block(0), &block(1), &block(3), &block(3)]), hints);
    assert!(words_of(&found.toml).contains("columns 8 to 10 or"), "{}", found.toml);
}

#[test]
fn joints_that_are_named_and_not_numbered_are_found() {
    let names = ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"];
    let spelling: [fn(&str, &str) -> String; 3] = [
        |joint, quantity| format!("{joint}_{quantity}"),
        |joint, quantity| format!("/joint_states/{joint}/{quantity}"),
        |joint, quantity| format!("{quantity}.{joint}"),
    ];
    // like some recorders: in alphabetical order
    let sorted = [1, 0, 2];
    let robot = arm(Some(names));
    for spell in spelling {
        let of = |quantity: &'static str, channel: usize| -> Vec<(String, Content)> {
            sorted.iter().map(|joint| (spell(names[*joint], quantity), Motion(channel, *joint))).collect()
        };
        let columns = [
            time(),
            of("position", 0),
            of("velocity", 1),
            of("effort", 3),
            sorted
                .iter()
                .map(|joint| (spell(names[*joint], "temperature"), Constant(30.0 + *joint as f64)))
                .collect(),
        ];
        let found = proposed(&columns, Hints { robot: Some(&robot), ..Hints::default() });
        let layout = answered(&found);
        assert_eq!(found.questions, 0, "{}", found.toml);
        assert_eq!(first_of(&layout.position.columns), spell(names[0], "position"));
        assert_eq!(first_of(&layout.torque.columns), spell(names[0], "effort"));
        let temperature = layout.motor_temperature.as_ref().expect("one per joint");
        assert_eq!(first_of(&temperature.columns), spell(names[0], "temperature"));
        // without the names of the joints, the order is a question
        for robot in [None, Some(arm(None))] {
            let found = proposed(&columns, Hints { robot: robot.as_ref(), ..Hints::default() });
            assert_eq!(found.questions, 4, "{}", found.toml);
            assert_eq!(first_of(&answered(&found).torque.columns), spell(names[1], "effort"));
        }
    }
    let columns = [
        time(),
        joints(|j| format!("pos_joint{j}"), |j| Motion(0, j)),
        joints(|j| format!("vel_joint{j}"), |j| Motion(1, j)),
        joints(|j| format!("eff_joint{j}"), |j| Motion(3, j)),
        joints(|j| format!("Temperature_J{j}"), |_| Constant(31.0)),
    ];
    let found = proposed(&columns, Hints::default());
    assert_eq!(found.questions, 0, "{}", found.toml);
    assert!(found.toml.contains("[motor_temperature]"), "{}", found.toml);
}

#[test]
fn arrays_of_ros_have_the_order_of_their_names() {
    let names = ["shoulder_pan_joint", "elbow_joint", "wrist_1_joint"];
    let sorted = [1, 0, 2];
    let of = |quantity: &str, channel: usize| -> Vec<(String, Content)> {
        let element = |(at, joint): (usize, &usize)| {
            (format!("/joint_states/{quantity}[{at}]"), Motion(channel, *joint))
        };
        sorted.iter().enumerate().map(element).collect()
    };
    let columns = [time(), of("position", 0), of("velocity", 1), of("effort", 3)];
    let plain = recording(&columns.concat(), true);
    let with_names = |(row, line): (usize, &str)| {
        let cells = (0..N).map(|at| match row {
            0 => format!(",/joint_states/name[{at}]"),
            _ => format!(",{}", names[sorted[at]]),
        });
        format!("{line}{}\n", cells.collect::<String>())
    };
    let named: String = plain.lines().enumerate().map(with_names).collect();
    let robot = arm(Some(names));
    let in_order = arm(Some(["a1", "a2", "a3"]));
    for (text, robot, questions, first) in [
        (&named, Some(&robot), 0, "/joint_states/effort[1]"),
        (&named, None, 3, "/joint_states/effort[0]"),
        (&plain, Some(&robot), 3, "/joint_states/effort[0]"),
        (&plain, Some(&in_order), 0, "/joint_states/effort[0]"),
        (&plain, None, 3, "/joint_states/effort[0]"),
    ] {
        let hints = Hints { robot, ..Hints::default() };
        let found = infer(text.as_bytes(), Path::new("a.csv"), "a", hints).expect("a table");
        assert_eq!(found.questions, questions, "{}", found.toml);
        assert_eq!(first_of(&answered(&found).torque.columns), first, "{}", found.toml);
    }
}

#[test]
fn a_gripper_beside_numbered_joints_is_no_joint() {
    let [position, velocity, torque] = plain();
    let gripper = vec![("gripper_position".to_owned(), Constant(0.03))];
    let found = proposed(&[time(), position, velocity, torque, gripper], Hints::default());
    assert!(found.questions == 0 && found.joints == N, "{}", found.toml);
}

#[test]
fn a_rate_that_does_not_go_with_the_velocities_is_a_question() {
    let columns = nameless(&[&block(0), &block(1), &block(3)]);
    let robot = arm(None);
    let with =
        |rate| proposed(&columns, Hints { robot: Some(&robot), sample_rate: rate, ..Hints::default() });
    let right = with(Some(50.0));
    assert!(
        right.toml.contains("sample_rate_hz = 50.0") && !right.toml.contains("# sample_rate_hz"),
        "{}",
        right.toml
    );
    for wrong in [5.0, 1000.0, 60.0] {
        let found = with(Some(wrong));
        assert!(found.toml.contains("# sample_rate_hz = 50.0"), "{}", found.toml);
        assert!(words_of(&found.toml).contains(&format!("{wrong:?} Hz were given")), "{}", found.toml);
    }
}

#[test]
fn a_column_of_few_values_is_asked_about_unless_the_motion_confirms_it() {
    let [position, velocity, torque] = plain();
    let with = |name: &str| {
        let signal = vec![(name.to_owned(), Gripper)];
        proposed(&[time(), position.clone(), velocity.clone(), torque.clone(), signal], Hints::default())
    };
    let found = with("output_register");
    assert!(
        found.questions == 1 && words_of(&found.toml).contains("the motion does not confirm it"),
        "{}",
        found.toml
    );
    assert!(!found.toml.contains("\nwhole_recording"), "{}", found.toml);
    // words in blocks
    for (words, questions) in [(["pause", "Exc", "friction", "warm-up"], 0), (["A", "B", "C", "D"], 1)] {
        let plain = recording(&[time(), position.clone(), velocity.clone(), torque.clone()].concat(), true);
        let text: String = plain
            .lines()
            .enumerate()
            .map(|(row, line)| match row {
                0 => format!("{line},Phase\n"),
                _ => format!("{line},{}\n", words[(row - 1) / 100]),
            })
            .collect();
        let found = infer(text.as_bytes(), Path::new("a.csv"), "a", Hints::default()).expect("a table");
        assert!(found.questions.min(1) == questions, "{}", found.toml);
        assert!(found.toml.contains("column = \"Phase\""), "{}", found.toml);
        assert!(!found.toml.contains("\nwhole_recording"), "{}", found.toml);
    }
}
