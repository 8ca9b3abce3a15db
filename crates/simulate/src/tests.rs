//! Tests of whole runs: contents of the files, and their dependence on the settings.

use std::collections::BTreeMap;
use std::time::Duration;

use super::arm::hall::{HallSettings, WorkingHours};
use super::arm::unit::UnitSpread;
use super::run::recording::SensorSettings;
use super::run::servo::ServoSettings;
use super::test_arms::{er3a_with_excitation, nine_joints, one_joint};
use super::*;

fn quick() -> SimulationSettings {
    SimulationSettings { cycles: 2, warming_s: 5.0, ambient_std_k: 0.0, ..SimulationSettings::default() }
}

fn simulate(robot: &Robot, settings: &SimulationSettings, run_index: u32) -> (tempfile::TempDir, RunFiles) {
    let folder = tempfile::tempdir().unwrap();
    let files = simulate_run(robot, settings, run_index, folder.path(), &mut |_| ()).unwrap();
    (folder, files)
}

fn truth_of(files: &RunFiles) -> serde_json::Value {
    serde_json::from_slice(&fs::read(&files.truth).unwrap()).unwrap()
}

struct ExportTable {
    columns: BTreeMap<String, usize>,
    rows: Vec<Vec<f64>>,
}

impl ExportTable {
    fn read(path: &Path) -> Self {
        let text = fs::read_to_string(path).unwrap();
        let mut lines = text.lines();
        let header = lines.next().unwrap();
        let columns = header.split(',').enumerate().map(|(i, c)| (c.to_owned(), i)).collect();
        let rows = lines.map(|l| l.split(',').map(|c| c.parse().unwrap()).collect()).collect();
        Self { columns, rows }
    }

    fn get(&self, row: &[f64], column: &str) -> f64 {
        row[self.columns[column]]
    }
}

#[test]
fn name_header_and_rows_are_those_of_the_native_layout() {
    let robot = er3a_with_excitation();
    let settings = SimulationSettings { first_start: "2026-01-05T08:47:00Z".parse().unwrap(), ..quick() };
    let mut reports = Vec::new();
    let folder = tempfile::tempdir().unwrap();
    let files = simulate_run(&robot, &settings, 1, folder.path(), &mut |p| reports.push(p)).unwrap();
    let name = files.export.file_name().unwrap().to_str().unwrap();
    assert_eq!(name, "R01_20260106_0847_Col23_5s_cycle2.csv");
    assert_eq!(files.truth.file_name().unwrap(), "R01_20260106_0847_Col23_5s_cycle2.truth.json");

    let text = fs::read_to_string(&files.export).unwrap();
    let expected = "time,pos_1,pos_2,pos_3,pos_4,pos_5,pos_6,vel_1,vel_2,vel_3,vel_4,vel_5,vel_6,\
                    trq_1,trq_2,trq_3,trq_4,trq_5,trq_6,stage,cycle,joint,level";
    assert_eq!(text.lines().next().unwrap(), expected);
    assert_eq!(text.lines().count() as u64, files.rows + 1);

    let truth = truth_of(&files);
    assert_eq!(truth["rows"], files.rows);
    assert_eq!(truth["run"], 2);
    assert_eq!(truth["rows_per_cycle"].as_u64().unwrap() * 2, files.rows);
    let last = reports.last().unwrap();
    assert_eq!((last.rows, last.rows_total, last.cycle), (files.rows, files.rows, 2));
}

#[test]
fn signals_tell_cycle_stage_joint_and_level_in_order() {
    let (_folder, files) = simulate(&er3a_with_excitation(), &quick(), 0);
    let table = ExportTable::read(&files.export);
    let mut changes: Vec<[u32; 4]> = Vec::new();
    for (k, row) in table.rows.iter().enumerate() {
        assert!((table.get(row, "time") - k as f64 / 50.0).abs() < 5e-5);
        let signals = ["cycle", "stage", "joint", "level"].map(|c| table.get(row, c) as u32);
        if changes.last() != Some(&signals) {
            changes.push(signals);
        }
    }
    let mut expected = Vec::new();
    for cycle in 1..=2 {
        expected.push([cycle, 0, 0, 0]);
        expected.extend([[cycle, 1, 0, 0], [cycle, 0, 0, 0]]);
        for joint in 1..=6 {
            expected.extend((1..=6).map(|level| [cycle, 2, joint, level]));
            expected.push([cycle, 0, 0, 0]);
        }
        expected.extend([[cycle, 3, 0, 0], [cycle, 0, 0, 0]]);
    }
    assert_eq!(changes, expected);
}

#[test]
fn a_seed_gives_the_same_bytes_and_another_seed_others() {
    let robot = er3a_with_excitation();
    for gzip in [false, true] {
        let settings = SimulationSettings { gzip, cycles: 1, ..quick() };
        let bytes = |settings: &SimulationSettings, run| {
            let (_folder, files) = simulate(&robot, settings, run);
            (fs::read(&files.export).unwrap(), fs::read(&files.truth).unwrap())
        };
        let first = bytes(&settings, 0);
        assert_eq!(first, bytes(&settings, 0));
        let others = [
            bytes(&SimulationSettings { seed: 2, ..settings.clone() }, 0),
            bytes(&SimulationSettings { robot_name: "R02".into(), ..settings.clone() }, 0),
            bytes(&settings, 1),
        ];
        assert!(others.iter().all(|other| other.0 != first.0));
    }
}

#[test]
fn recorded_torque_on_plateaus_is_the_stated_friction_where_gravity_does_no_work() {
    // Joint 1 is vertical: its plateau torque is friction alone, apart from ripple and noise.
    let (_folder, files) = simulate(&er3a_with_excitation(), &quick(), 0);
    let table = ExportTable::read(&files.export);
    let truth = truth_of(&files);
    for level in truth["cycle_truth"][0]["friction_levels"].as_array().unwrap() {
        if level["joint"] != 1 {
            continue;
        }
        let speed = level["speed_rad_s"].as_f64().unwrap();
        let mut torque = Vec::new();
        for row in &table.rows {
            let same = table.get(row, "cycle") == 1.0
                && table.get(row, "joint") == 1.0
                && table.get(row, "level") == level["level"].as_f64().unwrap();
            // Five standard deviations of the velocity noise; no ramp row passes by chance often.
            if same && (table.get(row, "vel_1") - speed).abs() < 0.01 {
                torque.push(table.get(row, "trq_1"));
            }
        }
        let mean = torque.iter().sum::<f64>() / torque.len() as f64;
        let stated = level["torque_positive_nm"].as_f64().unwrap();
        // Noise of 0.3 Nm over the root of the rows at four standard deviations, and the ripple.
        let tolerance = 4.0 * 0.3 / (torque.len() as f64).sqrt() + 0.05;
        assert!((mean - stated).abs() < tolerance, "{level}: {mean} over {} rows", torque.len());
    }
}

#[test]
fn stated_friction_falls_from_cycle_to_cycle_and_each_level_has_both_directions() {
    let settings = SimulationSettings { cycles: 3, ..quick() };
    let (_folder, files) = simulate(&er3a_with_excitation(), &settings, 0);
    let truth = truth_of(&files);
    let levels = |cycle: usize| truth["cycle_truth"][cycle]["friction_levels"].as_array().unwrap().clone();
    assert_eq!(levels(0).len(), 36);
    for (first, last) in levels(0).iter().zip(levels(2)) {
        assert!(first["rows"].as_u64().unwrap() >= 10);
        assert!(first["minute"].as_f64().unwrap() < last["minute"].as_f64().unwrap());
        let of = |level: &serde_json::Value, key: &str| level[key].as_f64().unwrap();
        assert!(of(first, "torque_positive_nm") > of(&last, "torque_positive_nm"));
        assert!(of(first, "torque_negative_nm") < of(&last, "torque_negative_nm"));
        assert!(of(&last, "torque_positive_nm") > 0.0);
    }
}

#[test]
fn wear_raises_friction_of_its_joint_by_the_stated_amount() {
    let settings = SimulationSettings {
        cycles: 1,
        faults: vec!["wear:joint=2,from=2,rate=0.1".parse().unwrap()],
        ..quick()
    };
    let robot = er3a_with_excitation();
    let levels = |run| {
        let (_folder, files) = simulate(&robot, &settings, run);
        let truth = truth_of(&files);
        (truth["faults"][0]["size"].as_f64().unwrap(), truth["cycle_truth"][0]["friction_levels"].clone())
    };
    let (healthy, worn) = (levels(0), levels(3));
    assert_eq!(healthy.0, 0.0);
    assert!((worn.0 - 0.3).abs() < 1e-12);
    for (a, b) in healthy.1.as_array().unwrap().iter().zip(worn.1.as_array().unwrap()) {
        let ratio = b["torque_positive_nm"].as_f64().unwrap() / a["torque_positive_nm"].as_f64().unwrap();
        let expected = if a["joint"] == 2 { 1.3 } else { 1.0 };
        assert!((ratio - expected).abs() < 1e-9, "{a}: {ratio}");
    }
}

#[test]
fn arms_of_one_and_of_nine_joints_are_recorded() {
    for (robot, columns) in [(one_joint(), 8), (nine_joints(), 32)] {
        let settings = SimulationSettings { cycles: 1, ..quick() };
        let (_folder, files) = simulate(&robot, &settings, 0);
        let table = ExportTable::read(&files.export);
        assert_eq!(table.columns.len(), columns);
        assert!(table.rows.iter().flatten().all(|x| x.is_finite()));
        let n = robot.joint_count();
        for joint in 1..=n {
            assert!(table.rows.iter().any(|r| table.get(r, "joint") as usize == joint));
        }
    }
}

#[test]
fn the_ambient_varies_from_run_to_run_if_asked() {
    let settings = SimulationSettings { ambient_std_k: 2.0, ambient_offset_k: -3.0, ..quick() };
    let offsets: Vec<f64> = (0..200).map(|run| ambient_offset(&settings, run)).collect();
    let mean = offsets.iter().sum::<f64>() / 200.0;
    // Four standard errors of the mean of 200 draws.
    assert!((mean + 3.0).abs() < 4.0 * 2.0 / 200.0_f64.sqrt(), "{mean}");
    assert_eq!(ambient_offset(&quick(), 5), 0.0);
}

#[test]
fn impossible_settings_are_refused_by_name() {
    let robot = er3a_with_excitation();
    let folder = tempfile::tempdir().unwrap();
    let refusals = [
        ("robot_name", SimulationSettings { robot_name: "../x".into(), ..quick() }),
        ("sample_rate_hz", SimulationSettings { sample_rate_hz: f64::NAN, ..quick() }),
        ("cycles", SimulationSettings { cycles: 0, ..quick() }),
        ("warming_s", SimulationSettings { warming_s: -1.0, ..quick() }),
        ("interval", SimulationSettings { runs: 2, interval: Duration::from_secs(1), ..quick() }),
        ("interval", SimulationSettings { interval: Duration::MAX, ..quick() }),
        (
            "fault",
            SimulationSettings { faults: vec!["wear:joint=7,from=1,rate=0.1".parse().unwrap()], ..quick() },
        ),
    ];
    for (key, settings) in refusals {
        let error = simulate_run(&robot, &settings, 3, folder.path(), &mut |_| ()).unwrap_err();
        assert!(error.to_string().starts_with(key), "{key}: {error}");
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_separate_folder_takes_the_truth() {
    let truth = tempfile::tempdir().unwrap();
    let settings = SimulationSettings { cycles: 1, truth_dir: Some(truth.path().join("truth")), ..quick() };
    let (folder, files) = simulate(&one_joint(), &settings, 0);
    assert!(files.truth.starts_with(truth.path()) && files.truth.exists());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn what_a_coupled_motor_adds_is_said_to_be_absent() {
    let mut robot = er3a_with_excitation();
    assert!(not_simulated(&robot).is_empty());
    let (joint, motor_joint) = (JointIndex::new(4), JointIndex::new(5));
    robot.couplings = vec![Coupling { joint, motor_joint, ratio: 1.0 }];
    let settings = SimulationSettings { cycles: 1, levels: Some(Vec::new()), ..quick() };
    let (_folder, files) = simulate(&robot, &settings, 0);
    let truth = truth_of(&files);
    let said = truth["not_simulated"][0].as_str().unwrap();
    assert!(
        said.starts_with("inertia and friction of the motor of joint 6") && said.contains("joint 5"),
        "{said}"
    );
    assert_eq!(truth["not_simulated"].as_array().unwrap().len(), 1);
}

#[test]
fn an_export_that_grows_shows_its_rows_on_the_way_and_is_the_same_in_the_end() {
    let robot = one_joint();
    let settings = SimulationSettings { grows: true, ..quick() };
    let folder = tempfile::tempdir().unwrap();
    let stem = file_stem(1, &settings, start_of_run(&settings, 0).unwrap());
    let path = folder.path().join(format!("{stem}.csv"));
    let mut lines = Vec::new();
    let files = simulate_run(&robot, &settings, 0, folder.path(), &mut |progress| {
        lines.push((fs::read_to_string(&path).unwrap().lines().count() as u64, progress.rows));
    })
    .unwrap();
    // ten times a second of 50 rows, with a header
    assert!(lines.len() as u64 >= files.rows / 5, "{}", lines.len());
    assert!(lines.iter().all(|(lines, rows)| *lines == rows + 1), "{lines:?}");
    let (_other, at_once) = simulate(&robot, &quick(), 0);
    assert_eq!(fs::read(&files.export).unwrap(), fs::read(&at_once.export).unwrap());
    let compressed = SimulationSettings { gzip: true, ..settings };
    let refused = simulate_run(&robot, &compressed, 0, folder.path(), &mut |_| ()).unwrap_err();
    assert!(refused.to_string().contains("not compressed"), "{refused}");
}

#[test]
fn noise_of_the_torque_has_the_correlation_and_standard_deviation_that_are_asked_for() {
    let robot = one_joint();
    let mut silent = robot.clone();
    silent.joints[0].nominal.as_mut().unwrap().torque_noise = 0.0;
    let torques = |robot: &Robot, torque_correlation: f64| -> Vec<f64> {
        let sensors = SensorSettings { torque_correlation, ..SensorSettings::default() };
        let (_folder, files) = simulate(robot, &SimulationSettings { cycles: 6, sensors, ..quick() }, 0);
        let table = ExportTable::read(&files.export);
        table.rows.iter().map(|row| table.get(row, "trq_1")).collect()
    };
    let truth = torques(&silent, 0.0);
    for correlation in [0.0, 0.8] {
        let noise: Vec<f64> =
            torques(&robot, correlation).iter().zip(&truth).map(|(noisy, truth)| noisy - truth).collect();
        let mean_of = |products: &mut dyn Iterator<Item = f64>| products.sum::<f64>() / noise.len() as f64;
        let variance = mean_of(&mut noise.iter().map(|x| x * x));
        let lagged = mean_of(&mut noise.windows(2).map(|pair| pair[0] * pair[1]));
        // some thousand rows, of which one in nine is independent at 0.8: a few per cent
        assert!(noise.len() > 4000, "{}", noise.len());
        assert!((lagged / variance - correlation).abs() < 0.06, "{correlation}: {}", lagged / variance);
        let stated = robot.joints[0].nominal.unwrap().torque_noise;
        assert!((variance.sqrt() / stated - 1.0).abs() < 0.1, "{} {stated}", variance.sqrt());
    }
    let odd = SimulationSettings { stiffness: vec![(JointIndex::new(3), 1e4)], ..quick() };
    let folder = tempfile::tempdir().unwrap();
    assert!(simulate_run(&robot, &odd, 0, folder.path(), &mut |_| ()).is_err(), "no joint 4");
}

/// Rows of one channel, without noise and steps of all sensors.
fn silent(robot: &Robot, change: impl Fn(&mut SimulationSettings)) -> Vec<RecordedRow> {
    let mut robot = robot.clone();
    robot.joints.iter_mut().for_each(|joint| joint.nominal.as_mut().unwrap().torque_noise = 0.0);
    let sensors = SensorSettings {
        position_noise: 0.0,
        position_step: 0.0,
        velocity_noise: 0.0,
        velocity_step: 0.0,
        ..SensorSettings::default()
    };
    let mut settings = SimulationSettings { cycles: 1, warming_s: 0.0, sensors, ..quick() };
    change(&mut settings);
    let mut rows = Vec::new();
    rows_of_run(&robot, &settings, 0, |row| rows.push(*row)).unwrap();
    rows
}

#[test]
fn signals_have_the_steps_and_the_hum_that_are_asked_for() {
    let robot = one_joint();
    let (plain, stepped) = (silent(&robot, |_| ()), silent(&robot, |of| of.sensors.torque_step = 0.25));
    for (plain, stepped) in plain.iter().zip(&stepped) {
        let steps = stepped.torque[0] / 0.25;
        assert!((steps - steps.round()).abs() < 1e-9);
        assert!((stepped.torque[0] - plain.torque[0]).abs() <= 0.125 + 1e-9);
    }
    // two hertz, so that 50 rows a second show them
    let humming = silent(&robot, |of| of.sensors.torque_hum = Some([2.0, 0.3]));
    for (plain, humming) in plain.iter().zip(&humming) {
        let expected = 0.3 * (std::f64::consts::TAU * 2.0 * plain.time).sin();
        assert!((humming.torque[0] - plain.torque[0] - expected).abs() < 1e-9);
    }
}

#[test]
fn a_controller_that_is_late_records_the_motion_it_makes() {
    let robot = er3a_with_excitation();
    let plain = silent(&robot, |_| ());
    let late = silent(&robot, |of| of.servo = ServoSettings { lag_s: 0.0, delay_s: 0.04 });
    // two rows at 50 Hz; the stage signals are those of the plan
    for k in 2..plain.len() {
        assert_eq!(late[k].stage, plain[k].stage);
        for j in 0..6 {
            assert!((late[k].position[j] - plain[k - 2].position[j]).abs() < 1e-9, "row {k}");
        }
    }
    // a cycle must not begin before the arm has finished the previous one
    let far_behind = ServoSettings { lag_s: 0.15, delay_s: 0.1 };
    let settings = |rest_s: f64| SimulationSettings { servo: far_behind, rest_s, ..quick() };
    assert!(settings::check(&robot, &settings(0.0)).is_err());
    assert!(settings::check(&robot, &settings(0.2)).is_ok());
    let behind = silent(&robot, |of| of.servo = ServoSettings { lag_s: 0.05, delay_s: 0.0 });
    let furthest = |rows: &[RecordedRow]| {
        rows.iter().zip(&plain).map(|(a, b)| (a.position[0] - b.position[0]).abs()).fold(0.0, f64::max)
    };
    let fastest = plain.iter().map(|row| row.velocity[0].abs()).fold(0.0, f64::max);
    let lag = furthest(&behind) / fastest;
    assert!((0.04..0.055).contains(&lag), "{lag} s behind at the largest speed");
}

#[test]
fn friction_grows_with_direction_and_load_and_the_truth_says_so() {
    let settings = SimulationSettings {
        friction_direction: 0.2,
        friction_load: 0.1,
        ripples: Some(vec![RippleOrder { order: 1.0, part: 0.01 }, RippleOrder { order: 4.0, part: 0.02 }]),
        cycles: 1,
        ..quick()
    };
    let robot = er3a_with_excitation();
    let (_folder, files) = simulate(&robot, &settings, 0);
    let truth = truth_of(&files);
    assert_eq!(truth["joints"][0]["friction_direction"], 0.2);
    assert_eq!(truth["joints"][3]["friction_load"], 0.1);
    let ripples = &truth["joints"][3]["ripples"];
    assert_eq!(ripples[0]["amplitude_nm"], truth["joints"][3]["ripple_nm"]);
    assert_eq!(ripples[1]["order"], 4.0);
    let levels = truth["cycle_truth"][0]["friction_levels"].as_array().unwrap();
    let both = |joint: u64| -> Vec<[f64; 2]> {
        let own = levels.iter().filter(|level| level["joint"] == joint);
        own.map(|of| ["torque_positive_nm", "torque_negative_nm"].map(|key| of[key].as_f64().unwrap()))
            .collect()
    };
    // joint 1 is vertical: at constant speed it carries almost nothing
    for [up, down] in both(1) {
        assert!((up / -down / 1.5 - 1.0).abs() < 0.03, "{up} {down}");
    }
    let plain = truth_of(&simulate(&robot, &SimulationSettings { cycles: 1, ..quick() }, 0).1);
    let levels = plain["cycle_truth"][0]["friction_levels"].as_array().unwrap();
    let without: Vec<f64> = levels
        .iter()
        .filter(|level| level["joint"] == 2)
        .map(|level| level["torque_positive_nm"].as_f64().unwrap())
        .collect();
    for ([up, _], without) in both(2).iter().zip(without) {
        assert!(*up > 1.2 * without + 1.0, "gravity loads the shoulder: {up} {without}");
    }
    let joint = &plain["joints"][0];
    assert!(joint["friction_direction"].is_null() && joint["friction_load"].is_null(), "{joint}");
    // settings that are not used leave truth files unchanged
    assert!(joint["ripples"].is_null());
    for key in ["following_lag_s", "command_delay_s", "torque_step_nm", "torque_hum_hz_nm", "heating_by_work"]
    {
        assert!(plain[key].is_null(), "{key}");
    }
}

#[test]
fn gears_cool_at_rest_where_they_warm_by_work() {
    let robot = one_joint();
    let multipliers = |heating: Heating, rest_s: f64| -> Vec<f64> {
        let settings = SimulationSettings { heating, rest_s, cycles: 4, warming_s: 60.0, ..quick() };
        let truth = truth_of(&simulate(&robot, &settings, 0).1);
        let cycles = truth["cycle_truth"].as_array().unwrap();
        cycles.iter().map(|of| of["joints"][0]["multiplier"].as_f64().unwrap()).collect()
    };
    let (clock, work) = (multipliers(Heating::Time, 0.0), multipliers(Heating::Work, 0.0));
    for (clock, work) in clock.iter().zip(&work) {
        // a cold gear loses more than usual and warms slightly sooner
        assert!(clock - work < 0.1 && *work <= clock + 1e-9, "{work} {clock}");
    }
    let rested = multipliers(Heating::Work, 1800.0);
    assert!(rested[3] > work[3] + 0.2 && rested[3] < work[0], "{rested:?} {work:?}");
    let by_clock = multipliers(Heating::Time, 1800.0);
    assert!(by_clock[3] < work[3], "time alone warms at rest too: {by_clock:?}");
}

#[test]
fn units_of_a_fleet_differ_and_shifts_and_seasons_set_temperature_and_ambient() {
    let robot = er3a_with_excitation();
    let fleet = SimulationSettings {
        unit_spread: UnitSpread { friction: 0.2, bodies: 0.01 },
        hall: HallSettings { season_k: 6.0, day_k: 0.0 },
        work: Some(WorkingHours { shifts: vec![[6.0, 14.0]], days: 5 }),
        runs: 2,
        interval: Duration::from_secs(183 * 24 * 3600),
        ..quick()
    };
    let truth = |name: &str, run: u32| {
        let settings = SimulationSettings { robot_name: name.into(), ..fleet.clone() };
        truth_of(&simulate(&robot, &settings, run).1)
    };
    let (one, two, later) = (truth("R01", 0), truth("R02", 0), truth("R01", 1));
    let viscous = |of: &serde_json::Value| of["joints"][0]["warm_friction_f1_f4"][1].as_f64().unwrap();
    assert!((viscous(&one) / viscous(&two) - 1.0).abs() > 0.01);
    assert_eq!(viscous(&one), viscous(&later), "a unit stays what it is");
    // 08:47 on a Monday in January, and half a year later
    assert!((one["initial_warm_s"].as_f64().unwrap() - 10_020.0).abs() < 1.0, "{one}");
    let hall = |of: &serde_json::Value| of["ambient_offset_k"].as_f64().unwrap();
    assert!(hall(&one) < -5.5 && hall(&later) > 5.5, "{} {}", hall(&one), hall(&later));
}
