//! Every file in `tests/fixtures/configs/` has one oddity, which its name describes, and gives the problem that is
//! listed here.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::layout::layout_file::read_layout;
use super::robot::robot_file::{parse_robot, read_robot};
use super::settings::Config;
use super::summary::summary;
use super::toml::problem::ConfigErrors;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::anomaly::settings::DetectSettings;

/// Name of a file, and for each of its problems the line, the key and words of the message.
type Expectation = (&'static str, &'static [(usize, &'static str, &'static str)]);

const ROBOTS: &[Expectation] = &[
    ("sound", &[]),
    ("convention_unknown", &[(2, "convention", "is not known; write \"modified_dh\" (Craig)")]),
    ("convention_missing", &[(1, "convention", "is missing; write \"modified_dh\" (Craig)")]),
    ("standard_dh", &[]),
    ("tool_and_friction_model", &[]),
    (
        "friction_model_unknown",
        &[(5, "friction_model", "must be \"polynomial\", \"viscous_coulomb\", \"smooth\" or \"none\"")],
    ),
    ("smooth_without_speed", &[(1, "smooth_speed_rad_s", "is missing")]),
    ("smooth_speed_of_nothing", &[(6, "smooth_speed_rad_s", "has an effect only with")]),
    ("polynomial_asymmetric", &[(1, "", "no columns in the polynomial model")]),
    ("transmission_singular", &[(6, "transmission.motor_per_joint", "is singular")]),
    ("transmission_of_three_joints", &[(6, "transmission.motor_per_joint", "must have 2 rows of 2 numbers")]),
    ("gear_ratio_twice", &[(18, "joint[1].gear_ratio", "is 100 in transmission.motor_per_joint")]),
    ("gear_ratio_missing", &[(6, "joint[1].gear_ratio", "is missing")]),
    ("gear_ratio_zero", &[(16, "joint[1].gear_ratio", "must not be 0")]),
    ("coupling_without_transmission", &[(5, "coupling[1]", "does not turn with joint 1")]),
    ("coupling_of_another_motor", &[(7, "coupling[1].motor", "must be between 1 and 2")]),
    ("coupling_twice", &[(15, "coupling[2]", "already has a coupling")]),
    ("spring_without_rest", &[(5, "spring[1]", "needs both stiffness_nm_rad and rest_*, or neither")]),
    ("spring_twice", &[(8, "spring[2]", "joint 2 already has a spring")]),
    ("counterbalance_with_equal_pins", &[(7, "counterbalance[1].pins_m", "two different distances")]),
    ("parallelogram_across", &[(5, "parallelogram[1]", "must turn about parallel axes")]),
    ("parallelogram_of_the_first_joint", &[(5, "parallelogram[1]", "must turn about parallel axes")]),
    ("motor_torque_constant_zero", &[(17, "joint[1].motor_torque_constant_nm_a", "must not be 0")]),
    ("drive_gain_zero", &[(17, "joint[1].drive_gain_nm_a", "must not be 0")]),
    (
        "inertia_of_the_origin_taken_for_that_of_the_centre",
        &[(21, "joint[1].nominal.inertia_about_centre_of_mass_kg_m2", "the largest exceeds")],
    ),
    ("urdf", &[]),
    ("urdf_missing", &[(3, "urdf", "cannot be read")]),
    ("urdf_with_an_unknown_joint", &[(8, "joint[1].name", "its joints are shoulder, elbow")]),
    ("urdf_without_inertia", &[(10, "joint[1].nominal", "has no inertial tag")]),
    ("radians_given_as_degrees", &[(9, "joint[1].alpha_deg", "write alpha_rad = 1.5708 if it is in rad")]),
    (
        "degrees_given_as_radians",
        &[(9, "joint[1].alpha_rad", "between -6.3 and 6.3 rad; did you mean alpha_deg = 90?")],
    ),
    ("angle_given_twice", &[(10, "joint[1].alpha_rad", "already given as alpha_deg")]),
    (
        "range_upside_down",
        &[(13, "joint[1].position_max_deg", "must be larger than position_min, which is -140 deg")],
    ),
    ("range_in_radians_given_as_degrees", &[(13, "joint[1].position_max_deg", "a range of only 4.8 deg")]),
    (
        "millimetres_for_metres",
        &[(10, "joint[1].d_m", "= 300: must be between -10 and 10 m; did you mean 0.3 m?")],
    ),
    ("velocity_zero", &[(14, "joint[1].velocity_max_deg_s", "= 0: must be above 0 and at most 6000 deg/s")]),
    ("velocity_missing", &[(6, "joint[1].velocity_max_deg_s or velocity_max_rad_s", "is missing")]),
    ("unit_of_a_sliding_joint", &[(12, "joint[1].position_min_deg", "did you mean position_min_m?")]),
    ("joint_type_unknown", &[(7, "joint[1].type", "must be \"revolute\" or \"prismatic\"")]),
    ("key_misspelt", &[(16, "joint[1].gear_ration", "unknown key; did you mean gear_ratio?")]),
    ("mass_negative", &[(19, "joint[1].nominal.mass_kg", "= -2: must be above 0 and at most 10000 kg")]),
    ("inertia_about_the_centre_of_mass", &[(21, "joint[1].nominal.inertia_kg_m2", "one of them negative")]),
    ("inertia_entry_missing", &[(21, "joint[1].nominal.inertia_kg_m2.xy", "is missing")]),
    ("friction_that_drives", &[(23, "joint[1].nominal.friction", "at 0.883 rad/s")]),
    (
        "time_constants_swapped",
        &[(24, "joint[1].nominal.warm_up", "must be larger than t2_min, which is 40")],
    ),
    ("gravity_with_two_entries", &[(3, "gravity_m_s2", "has 2 entries, must have 3")]),
    ("speed_levels_in_percent", &[(4, "speed_levels[3]", "= 100: must be above 0 and at most 1")]),
    ("speed_levels_falling", &[(4, "speed_levels", "must increase from level to level")]),
    ("excitation_of_two_joints", &[(29, "excitation.centre_rad", "has 2 entries, must have 1")]),
    ("excitation_with_unequal_harmonics", &[(27, "excitation", "the same number of harmonics")]),
    (
        "excitation_centre_out_of_range",
        &[(29, "excitation.centre_rad", "joint 1: 3 rad is outside the joint's range")],
    ),
    ("low_speed_above_velocity", &[(6, "joint[1]", "low_speed must be smaller than velocity_max")]),
    ("ten_joints", &[(6, "joint", "joint: 10 joints, must be 1 to 9")]),
    ("no_joints", &[(1, "joint", "write one [[joint]] per joint")]),
];

const LAYOUTS: &[Expectation] = &[
    ("sound", &[]),
    ("in_degrees", &[]),
    ("unit_unknown", &[(10, "position.unit", "must be one of rad, deg, rev, m")]),
    ("joint_number_missing", &[(13, "torque.column", "must contain {joint}")]),
    ("joint_number_in_time", &[(5, "time.column", "must not contain {joint}")]),
    ("column_read_twice", &[(24, "if_present.cycle", "another key already reads this column")]),
    ("stage_value_with_two_meanings", &[(21, "stage.warming[1]", "already means friction")]),
    ("stage_value_not_whole", &[(19, "stage.excitation[1]", "must be a whole number")]),
    ("excitation_without_value", &[(19, "stage.excitation", "must have an entry")]),
    ("in_amperes", &[]),
    ("sign_zero", &[(15, "torque.sign", "must be 1 or -1")]),
    ("column_and_columns", &[(14, "torque.columns", "already given as column")]),
    ("column_number_twice", &[(13, "torque.columns[3]", "another key already reads this column")]),
    ("delimiter_is_a_point", &[(2, "delimiter", "must be one of")]),
    ("table_misspelt", &[(12, "torqe", "did you mean torque?")]),
];

const DAEMON: &[Expectation] = &[
    ("sound", &[]),
    ("settle_negative", &[(6, "watch.settle_s", "= -1: must be between 0 and 3600 s")]),
    (
        "retention_mistakes",
        &[
            (9, "retention.factors_of_tests_days", "must be between 0 and 36500 days"),
            (10, "retention.factors_of_production_days", "write a number of days, or \"forever\""),
            (11, "retention.factors_of_test_days", "known here: factors_of_tests_days"),
        ],
    ),
    ("retention_forever", &[]),
    ("snapshot_over_the_database", &[(9, "snapshot.file", "is the database itself; name another file")]),
    ("estimator_unknown", &[(19, "analysis.estimator", "must be \"ordinary\", \"weighted\" or \"huber\"")]),
    ("finding_misspelt", &[(19, "analysis.accept[2]", "did you mean late_torque?")]),
    ("key_misspelt", &[(5, "watch.scan_intervall_s", "did you mean scan_interval_s?")]),
    ("table_misspelt", &[(17, "analisys", "did you mean analysis?")]),
    ("number_in_quotes", &[(18, "analysis.cutoff_hz", "= \"12\": is text, must be a number")]),
    ("not_a_number", &[(18, "analysis.cutoff_hz", "= nan: must be between 0.5 and 1000 Hz")]),
    (
        "pattern_does_not_compile",
        &[(9, "recognition.file_name", "is not a regular expression: unclosed group")],
    ),
    ("pattern_without_robot", &[(9, "recognition.file_name", "has no group robot")]),
    ("pattern_with_time_but_no_date", &[(9, "recognition.file_name", "has a group time but no group date")]),
    ("time_zone_unknown", &[(10, "recognition.time_zone", "is not a time zone known on this computer")]),
    ("folder_twice", &[(4, "watch.folders[2]", "is listed twice")]),
    ("no_robot", &[(1, "robot", "is missing; write [[robot]]")]),
    ("robot_in_single_brackets", &[(12, "robot", "write [[robot]] in double brackets")]),
    ("description_missing", &[(14, "robot[1].description", "er3b.toml cannot be read")]),
    ("description_with_problems", &[(19, "joint[1].nominal.mass_kg", "robots/mass_negative.toml:19:11")]),
    (
        "currents_without_gains",
        &[(12, "robot[1]", "lacks drive_gain_nm_a of joint 1, drive_gain_nm_a of joint 2")],
    ),
    ("sliding_joint_in_degrees", &[(12, "robot[1]", "scara-example has a prismatic joint")]),
    ("robot_pattern_twice", &[(18, "robot[2].name", "is already given")]),
    ("robot_pattern_never_used", &[(18, "robot[2].name", "put the narrower pattern first")]),
    ("robot_patterns_crossing", &[(18, "robot[2].name", "some names match this and \"R*\"")]),
    (
        "warning_above_critical",
        &[(20, "detect", "drift_warning_fraction = 0.2 must be smaller than drift_critical_fraction = 0.15")],
    ),
    (
        "no_false_alarm_at_all",
        &[(21, "detect.false_alarms_per_robot_year", "must be between 0.001 and 1000")],
    ),
    ("deviations_overrule_the_rate", &[]),
    ("syntax_broken", &[(5, "", "not valid TOML")]),
    ("tokens_with_scopes", &[]),
    (
        "tokens_mistakes",
        &[
            (2, "serve.requests_per_s", "must be between 0 and 100000 1/s"),
            (6, "serve.token[1].scopes[1]", "write \"read\", \"act\" or \"upload\""),
            (7, "serve.token[2]", "two tokens have the name \"screen\""),
            (10, "serve.token[2].scopes", "has no scope"),
            (11, "serve.token[3].file", "is missing"),
            (11, "serve.token[3].scopes", "is missing"),
            (14, "serve.upload.total_timeout_min", "must be between 1 and 14400 min"),
        ],
    ),
    ("alerts", &[]),
    (
        "alerts_site_unknown",
        &[(1, "alerts", "route shift: there is no site \"Turni\"; did you mean \"Turin\"?")],
    ),
    (
        "alerts_mistakes",
        &[
            (2, "alerts.remind_after_h", "must be between 0 and 8766 h"),
            (6, "alerts.route[1].severity", "write one of \"info\", \"warning\", \"critical\""),
            (7, "alerts.route[1].quiet", "such as \"22:00-06:00\""),
            (8, "alerts.route[1].time_zone", "is not a time zone known on this computer"),
            (
                10,
                "alerts.route[1].webhook.url",
                "contains a user or a password; write user and password_file",
            ),
            (11, "alerts.route[1].webhook.signing_secret", "write signing_secret_file or signing_secret_env"),
            (14, "alerts.route[2].name", "is the name of an earlier route"),
            (15, "alerts.route[2].kinds[1]", "is not known here; write one of \"drift\""),
            (16, "alerts.route[2].digest_at", "is not a time of day"),
            (19, "alerts.route[2].email.from", "is not a mail address"),
            (20, "alerts.route[2].email.to", "names nobody"),
            (25, "alerts.route[3].command", "the route already has the receiver log"),
            (28, "alerts.route[4]", "has no receiver; write one of [alerts.route.log]"),
            (33, "alerts.route[5].mqtt", "has a user but no password"),
            (35, "alerts.route[5].mqtt.topic", "is not a topic for publishing"),
        ],
    ),
    ("key_twice", &[(7, "", "duplicate key")]),
    (
        "five_mistakes",
        &[
            (5, "watch.scan_intervall_s", "did you mean scan_interval_s?"),
            (6, "watch.settle_s", "must be between 0 and 3600 s"),
            (10, "recognition.time_zone", "must be text in quotes"),
            (14, "robot[1].description", "er3b.toml cannot be read"),
            (18, "analysis.cutoff_hz", "must be a number"),
        ],
    ),
];

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/configs").join(name)
}

fn check<T>(name: &str, expectations: &[Expectation], read: impl Fn(&Path) -> Result<T, ConfigErrors>) {
    let folder = folder(name);
    for (stem, expected) in expectations {
        let path = folder.join(format!("{stem}.toml"));
        let problems = read(&path).err().map_or_else(Vec::new, |errors| errors.0);
        let shown = problems.iter().map(|p| format!("\n{p}")).collect::<String>();
        assert_eq!(problems.len(), expected.len(), "{stem}:{shown}");
        for (problem, (line, key, words)) in problems.iter().zip(*expected) {
            assert_eq!((problem.line, problem.key.as_str()), (Some(*line), *key), "{stem}:{shown}");
            assert!(problem.to_string().contains(words), "{stem}: {words} not in{shown}");
        }
    }
    let listed: BTreeSet<_> = expectations.iter().map(|(stem, _)| format!("{stem}.toml")).collect();
    let found: BTreeSet<_> = std::fs::read_dir(&folder)
        .expect("the folder of fixtures")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".toml"))
        .collect();
    assert_eq!(listed, found, "every fixture is expected to yield something");
}

#[test]
fn each_robot_fixture_yields_its_problem() {
    check("robots", ROBOTS, read_robot);
}

#[test]
fn each_layout_fixture_yields_its_problem() {
    check("layouts", LAYOUTS, read_layout);
}

#[test]
fn each_daemon_fixture_yields_its_problem() {
    check("daemon", DAEMON, Config::read);
}

#[test]
fn the_shipped_folder_loads_from_disk_as_it_does_from_the_program() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/armwatch.toml");
    let disk = Config::read(&path).unwrap_or_else(|errors| panic!("{errors}"));
    let shipped = Config::shipped().unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(summary(&disk), summary(&shipped));
    assert_eq!(disk.fleet[0].description, shipped.fleet[0].description);
    assert_eq!(disk.fleet[0].layout, shipped.fleet[0].layout);
}

#[test]
fn what_the_shipped_file_says_is_what_holds_without_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("armwatch.toml");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let robot = format!(
        "[[robot]]\nname = \"*\"\ndescription = '{0}/robots/er3a.toml'\nlayout = '{0}/exports/native.toml'\n",
        config.display()
    );
    std::fs::write(&path, robot).expect("written");
    let least = Config::read(&path).unwrap_or_else(|errors| panic!("{errors}"));
    let shipped = Config::shipped().unwrap_or_else(|errors| panic!("{errors}"));
    assert_eq!(summary(&least), summary(&shipped));
    assert_eq!((least.analysis, least.detect), (AnalysisSettings::default(), DetectSettings::default()));
    assert_eq!((shipped.analysis, shipped.detect), (AnalysisSettings::default(), DetectSettings::default()));
}

#[test]
fn an_exception_comes_before_the_rest_and_files_in_common_are_read_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("armwatch.toml");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let entry = |name: &str, arm: &str| {
        format!(
            "[[robot]]\nname = \"{name}\"\ndescription = '{0}/robots/{arm}.toml'\nlayout = '{0}/exports/native.toml'\n",
            config.display()
        )
    };
    std::fs::write(&path, entry("S1", "scara") + &entry("S*", "er3a") + &entry("*", "er3a"))
        .expect("written");
    let config = Config::read(&path).unwrap_or_else(|errors| panic!("{errors}"));
    let model = |robot: &str| config.robot_entry(robot).map(|entry| entry.description.model.as_str());
    assert_eq!(
        [model("S1"), model("S10"), model("R00")],
        [Some("scara-example"), Some("er3a"), Some("er3a")]
    );
    assert!(Arc::ptr_eq(&config.fleet[1].description, &config.fleet[2].description));
    assert!(Arc::ptr_eq(&config.fleet[0].layout, &config.fleet[2].layout));
}

#[test]
fn an_entry_for_some_files_comes_before_that_for_all_of_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("armwatch.toml");
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let entry = |files: &str, layout: &str| {
        format!(
            "[[robot]]\nname = \"*\"\n{files}description = '{0}/robots/er3a.toml'\nlayout = '{0}/exports/{layout}.toml'\n",
            config.display()
        )
    };
    let (work, tests) = (entry("files = \"*_work*\"\n", "production"), entry("", "native"));
    std::fs::write(&path, format!("{work}{tests}")).expect("written");
    let config = Config::read(&path).unwrap_or_else(|errors| panic!("{errors}"));
    let layout = |file: &str| config.export_entry("R00", file).map(|entry| entry.layout.name.as_str());
    assert_eq!([layout("R00_work.csv"), layout("R00.csv")], [Some("production"), Some("native")]);
    assert_eq!(config.robot_entry("R00").map(|entry| entry.layout.name.as_str()), Some("native"));
    std::fs::write(&path, format!("{tests}{work}")).expect("written");
    let errors = Config::read(&path).expect_err("one is never used");
    assert!(errors.to_string().contains("matches all files of these robots"), "{errors}");
}

#[test]
fn files_that_are_no_text_or_far_too_large_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("robot.toml");
    std::fs::write(&path, b"model = \"a\"\nconvention = \"\xff\"\n").expect("written");
    let errors = read_robot(&path).expect_err("not UTF-8");
    assert_eq!(errors.0[0].line, Some(2));
    std::fs::write(&path, vec![b'#'; (1 << 20) + 1]).expect("written");
    let errors = read_robot(&path).expect_err("too large");
    assert!(errors.to_string().contains("is larger than 1048576 bytes"), "{errors}");
    assert!(read_robot(folder.path()).is_err());
}

#[test]
fn a_description_cut_off_anywhere_is_refused_or_read_but_never_panics() {
    let text = include_str!("../../../config/robots/er3a.toml");
    let lines = text.lines().count();
    for (end, _) in text.char_indices().step_by(23) {
        if let Err(errors) = parse_robot("cut.toml", &text[..end]) {
            assert!(!errors.0.is_empty());
            assert!(
                errors.0.iter().all(|p| p.line.is_some_and(|line| (1..=lines).contains(&line))),
                "{errors}"
            );
        }
    }
}

proptest::proptest! {
    #[test]
    fn any_text_is_refused_with_problems_and_never_panics(text in "[\\[\\]{}=\"'a-z0-9_.,\n \u{e9}\u{0}-]{0,80}") {
        let errors = parse_robot("any.toml", &text).expect_err("no arm");
        proptest::prop_assert!(!errors.0.is_empty());
    }
}
