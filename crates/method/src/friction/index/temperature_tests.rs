//! Tests of the index with recorded temperatures: of a motor, which is neither that of the oil nor of the housing, or
//! of the air.

use super::simulated_arm::{
    ADMITTED, ADMITTED_OF_THE_UNKNOWN, Arm, BASELINE, HOUR, JOINTS, RobotFriction, Sensors, USUAL_HALL,
    WEAR_TOLERANCE, half_colder, largest, last_changes, robot_friction,
};
use crate::friction::maps::published_map::{map_friction, with_temperatures};
use crate::friction::maps::thermal_state::{MotionSpan, Rates, thermal_deficits};
use armwatch_model::analysis::CycleTemperatures;
use armwatch_model::analysis::friction::{FrictionMap, ThermalSource};
use armwatch_model::analysis::map_run::{CycleMotion, MapRun};

/// Resolutions of a drive's temperature, K.
const FINE: f64 = 0.1;
const COARSE: f64 = 1.0;

/// History of healthy runs with random rests; `spread` is the standard deviation of ambient temperature, K.
fn healthy(seed: u64, runs: usize, spread: f64, sensors: Sensors) -> Arm {
    let mut arm = Arm::with_sensors(seed, sensors.motor, sensors.ambient, sensors.step);
    arm.go_on(runs, spread, [0.0; JOINTS]);
    arm
}

const MOTORS: Sensors = Sensors { motor: true, ambient: false, step: FINE };
const HALL: Sensors = Sensors { motor: false, ambient: true, step: FINE };

fn stands_on_motors(found: &RobotFriction) -> bool {
    found.maps.len() == JOINTS
        && found.maps.iter().all(|map| matches!(map.source, ThermalSource::MotorTemperature { .. }))
}

/// Result of the same runs without any temperature.
fn blind(arm: &Arm) -> RobotFriction {
    let mut runs = arm.runs.clone();
    let spans = runs.iter_mut().flat_map(|run| &mut run.spans);
    spans.for_each(|span| span.temperatures = CycleTemperatures::default());
    robot_friction(&runs, BASELINE)
}

/// Returns true if two results are equal except for their remarks.
fn same(a: &RobotFriction, b: &RobotFriction) -> bool {
    let plain = |found: &RobotFriction| {
        let mut found = found.clone();
        found.maps.iter_mut().for_each(|map| map.remarks.clear());
        found
    };
    plain(a) == plain(b)
}

#[test]
fn with_motor_temperatures_hall_rest_and_wear_are_told_apart() {
    let mut arm = healthy(1, 8, 1.5, Sensors { step: COARSE, ..MOTORS });
    arm.rest(20.0 * HOUR, -half_colder());
    arm.run(-half_colder(), [0.0, 0.0, 0.04, 0.0, 0.0, 0.0]);
    let found = arm.friction();
    assert!(stands_on_motors(&found), "{:?}", found.maps);
    let changes = last_changes(&found);
    println!("colder hall, wear of joint 3: {changes:.4?}");
    for (j, change) in changes.iter().enumerate() {
        let due = if j == 2 { 0.04 } else { 0.0 };
        assert!((change - due).abs() < ADMITTED_OF_THE_UNKNOWN, "joint {j} of {changes:?}");
    }
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn with_motor_temperatures_a_colder_hall_and_a_warm_start_move_the_index_by_less_than_two_percent() {
    for step in [FINE, COARSE] {
        for (seed, minutes) in [(10, 5.0), (11, 20.0), (12, 45.0), (13, 90.0), (14, 1200.0)] {
            for hall in [0.0, -half_colder()] {
                let mut arm = healthy(seed, 12, 1.5, Sensors { step, ..MOTORS });
                arm.rest(60.0 * minutes, hall);
                arm.run(hall, [0.0; JOINTS]);
                let found = arm.friction();
                assert!(stands_on_motors(&found));
                let changes = last_changes(&found);
                println!("step {step} K, rest {minutes} min, hall {hall:.1} K: {:.4}", largest(&changes));
                assert!(largest(&changes) < ADMITTED, "{minutes} min, {hall} K: {changes:?}");
            }
        }
    }
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn with_motor_temperatures_wear_of_four_percent_is_four_percent() {
    for (seed, joint) in (20..26).zip(0..JOINTS) {
        let mut arm = healthy(seed, 12, 1.5, MOTORS);
        let hall = arm.normal();
        arm.rest(14.0 * HOUR, hall);
        let mut wear = [0.0; JOINTS];
        wear[joint] = 0.04;
        arm.run(hall, wear);
        let changes = last_changes(&arm.friction());
        println!("wear of joint {joint}: {changes:.4?}");
        for (j, change) in changes.iter().enumerate() {
            let due = if j == joint { 0.04 } else { 0.0 };
            assert!((change - due).abs() < WEAR_TOLERANCE, "joint {j} of {changes:?}");
        }
    }
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn intervals_of_arms_with_temperatures_hold_the_truth() {
    for sensors in [MOTORS, HALL] {
        let (mut inside, mut count, mut squares) = (0_u32, 0_u32, 0.0);
        for seed in 90..94 {
            let mut arm = Arm::unlike(seed);
            arm.sensors = sensors;
            arm.go_on(14, 2.0, [0.0; JOINTS]);
            for index in arm.friction().indices[BASELINE..].iter().flatten() {
                let off = (index.index.value - 1.0) / index.index.std_error;
                inside += u32::from(off.abs() < 1.96);
                count += 1;
                squares += off * off;
            }
        }
        let held = f64::from(inside) / f64::from(count);
        let ratio = (squares / f64::from(count)).sqrt();
        println!(
            "motors {}: {count} intervals, {held:.3} held, true over stated error {ratio:.2}",
            sensors.motor
        );
        assert!(held > 0.9, "{held}");
    }
}

/// Friction that a map adds at its largest speed per kelvin of colder air, with its standard error, Nm/K. The
/// covariance contains first warm and cold of each level, then the five parameters of the law; the coefficient is the
/// last.
fn effect_of_kelvin(map: &FrictionMap, coefficient: f64) -> (f64, f64) {
    let (levels, size) = (map.levels.len(), map.covariance.len().isqrt());
    let (at_cold, at_coefficient) = (2 * levels - 1, size - 1);
    let cold = map.levels.last().expect("levels").cold.value;
    let entry = |i: usize, k: usize| map.covariance[i * size + k];
    let variance = coefficient.powi(2) * entry(at_cold, at_cold)
        + 2.0 * coefficient * cold * entry(at_cold, at_coefficient)
        + cold.powi(2) * entry(at_coefficient, at_coefficient);
    (coefficient * cold, variance.sqrt())
}

/// Motion of an arm's history.
fn motion(arm: &Arm) -> Vec<MotionSpan> {
    let of_run = |run: &MapRun| -> Vec<MotionSpan> {
        let span = |span: &CycleMotion| MotionSpan {
            start: span.start + run.started_at,
            end: span.end + run.started_at,
            activity: 1.0,
        };
        run.spans.iter().map(span).collect()
    };
    arm.runs.iter().flat_map(of_run).collect()
}

/// Friction that a map predicts at 60 % of the largest speed, at a time with the temperatures `now`, Nm.
fn expected(map: &FrictionMap, spans: &[MotionSpan], time: f64, now: &CycleTemperatures) -> f64 {
    let by_motion = thermal_deficits(&Rates::of(&map.law), spans, &[time])[0];
    let motor = now.motor.get(map.joint.index()).copied().flatten();
    let [slow, fast] = with_temperatures(map.source, by_motion, motor, now.ambient).expect("measured");
    let share = map.law.slow_share.value;
    map_friction(map, 3, share * slow + (1.0 - share) * fast).expect("a level").value
}

/// Relative errors of the friction that maps predict at the start of a run.
fn start_errors(maps: &[FrictionMap], arm: &Arm, now: &CycleTemperatures) -> Vec<f64> {
    let (spans, truth) = (motion(arm), arm.friction_now(3));
    maps.iter().map(|map| expected(map, &spans, arm.now, now) / truth[map.joint.index()] - 1.0).collect()
}

/// Mean relative errors over the last run, which the maps have not learnt.
fn run_errors(maps: &[FrictionMap], arm: &Arm) -> Vec<f64> {
    let (spans, run) = (motion(arm), arm.runs.last().expect("runs"));
    let error = |map: &FrictionMap| {
        let points =
            run.points.iter().filter(|p| p.joint == map.joint && (p.speed_fraction - 0.6).abs() < 1e-9);
        let errors: Vec<f64> = points
            .map(|p| {
                let cycle = run.spans.iter().find(|span| span.end > p.time).expect("inside the run");
                expected(map, &spans, run.started_at + p.time, &cycle.temperatures) / p.torque.abs() - 1.0
            })
            .collect();
        errors.iter().sum::<f64>() / errors.len() as f64
    };
    maps.iter().map(error).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn with_motor_temperatures_the_first_minute_of_a_warm_start_is_expected_better() {
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for (seed, minutes) in [(60, 20.0), (61, 45.0), (62, 90.0)] {
        let mut arm = healthy(seed, 8, 1.5, MOTORS);
        let (measured, by_motion) = (arm.friction().maps, blind(&arm).maps);
        let hall = -3.0;
        arm.rest(60.0 * minutes, hall);
        let now = arm.readings(hall);
        with.extend(start_errors(&measured, &arm, &now));
        without.extend(start_errors(&by_motion, &arm, &now));
    }
    println!(
        "first moment of a warm start: {:.4} rms and {:.4} at most with, {:.4} and {:.4} without",
        rms(&with),
        largest(&with),
        rms(&without),
        largest(&without)
    );
    assert!(rms(&with) < rms(&without), "{with:.3?} {without:.3?}");
    assert!(largest(&with) < largest(&without), "{with:.3?} {without:.3?}");
}

#[test]
fn a_history_that_has_motor_temperatures_in_part_stands_on_motion() {
    let mut arm = Arm::new(5);
    arm.go_on(2, 1.0, [0.0; JOINTS]);
    arm.sensors = MOTORS;
    arm.go_on(4, 1.0, [0.0; JOINTS]);
    let found = arm.friction();
    assert!(same(&found, &blind(&arm)));
    for map in &found.maps {
        assert_eq!(map.source, ThermalSource::Motion);
        assert!(map.remarks[0].contains("recorded in 3 of 5 runs"), "{:?}", map.remarks);
    }
}

#[test]
fn sensors_that_are_stuck_or_of_another_joint_are_not_believed() {
    let mut arm = healthy(6, 6, 1.0, MOTORS);
    let mut noise: Vec<f64> = (0..200).map(|_| arm.normal()).collect();
    for span in arm.runs.iter_mut().flat_map(|run| &mut run.spans) {
        span.temperatures.motor[0] = Some(310.0);
        // temperature of something that warms and cools independently
        span.temperatures.motor[1] = noise.pop().map(|z| 310.0 + 6.0 * z);
    }
    let (found, by_motion) = (arm.friction(), blind(&arm));
    for (j, what) in ["moves by 0.0 K", "does not go with its friction"].into_iter().enumerate() {
        assert_eq!(found.maps[j].source, ThermalSource::Motion);
        assert!(found.maps[j].remarks[0].contains(what), "{:?}", found.maps[j].remarks);
        assert_eq!(found.maps[j].levels.len(), by_motion.maps[j].levels.len());
    }
    assert!(found.maps[2..].iter().all(|map| map.source != ThermalSource::Motion));
    assert!(largest(&last_changes(&found)) < ADMITTED, "{:?}", last_changes(&found));
}

#[test]
fn a_recorded_hall_is_expected_and_its_effect_is_the_gears() {
    let mut arm = healthy(7, 10, 3.0, HALL);
    let (measured, by_motion) = (arm.friction(), blind(&arm));
    let [lasting, cold] = arm.friction_per_kelvin();
    for map in &measured.maps {
        let ThermalSource::AmbientAndMotion { usual, coldness } = map.source else {
            panic!("{:?}", map.source)
        };
        assert!((usual - USUAL_HALL).abs() < 4.0, "{usual}");
        // the first cycles hardly resolve the fast part, so only the product of the coefficient and the cold part is
        // well known
        let (value, std_error) = effect_of_kelvin(map, coldness.value);
        let j = map.joint.index();
        println!("joint {}: {value:.3} +- {std_error:.3} Nm/K, {:.3} to {:.3}", j + 1, lasting[j], cold[j]);
        assert!(
            value > 0.9 * lasting[j] && value < 1.1 * cold[j],
            "{value} of {} to {}",
            lasting[j],
            cold[j]
        );
        assert!(value > 4.0 * std_error, "{value} {std_error}");
        assert_eq!(map.covariance.len(), (2 * map.levels.len() + 5).pow(2));
    }
    // a cold day in this environment
    arm.rest(20.0 * HOUR, -5.0);
    arm.run(-5.0, [0.0; JOINTS]);
    let (with, without) = (run_errors(&measured.maps, &arm), run_errors(&by_motion.maps, &arm));
    println!(
        "a run in a colder hall is expected to {:.4} rms with, {:.4} without",
        rms(&with),
        rms(&without)
    );
    assert!(rms(&with) < 0.4 * rms(&without), "{with:.3?} {without:.3?}");
    let hall = -half_colder();
    arm.rest(20.0 * HOUR, hall);
    arm.run(hall, [0.0; JOINTS]);
    let changes = last_changes(&arm.friction());
    assert!(largest(&changes) < ADMITTED, "{changes:?}");
}

#[test]
fn a_hall_that_hardly_changes_tells_nothing_of_itself() {
    let arm = healthy(8, 6, 0.3, HALL);
    let found = arm.friction();
    assert!(same(&found, &blind(&arm)));
    assert!(
        found.maps[0].remarks[0].contains("ambient temperature is not used"),
        "{:?}",
        found.maps[0].remarks
    );
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn runs_without_the_halls_temperature_count_as_in_the_usual_hall() {
    let mut arm = Arm::new(9);
    arm.go_on(3, 2.0, [0.0; JOINTS]);
    arm.sensors = HALL;
    arm.go_on(8, 3.0, [0.0; JOINTS]);
    let found = arm.friction();
    assert!(
        found.maps.iter().any(|map| map.source.name() == "ambient_and_motion"),
        "{:?}",
        found.maps[0].remarks
    );
    for indices in &found.indices[..] {
        assert!(indices.iter().all(|index| (index.index.value - 1.0).abs() < ADMITTED), "{indices:?}");
    }
}

/// Tests every third day over half a year, forty minutes long, after a rest of 71 hours. The air is between 13 K colder
/// and 13 K warmer than usual.
fn half_a_year(seed: u64) -> Arm {
    let mut arm = Arm::unlike(seed);
    arm.sensors = HALL;
    for day in (0..180).step_by(3) {
        let season = (std::f64::consts::TAU * f64::from(day) / 360.0 + seed as f64).sin();
        let hall = 10.0 * season + 1.5 * arm.normal();
        arm.rest(71.0 * HOUR, hall);
        arm.run_of(8, hall, [0.0; JOINTS]);
    }
    arm
}

#[test]
fn a_season_is_no_wear_where_the_hall_is_measured() {
    for seed in 30..40 {
        let found = half_a_year(seed).friction();
        let off = |joint: usize| {
            let of_joint = found.indices[BASELINE..].iter().flatten();
            let changes: Vec<f64> =
                of_joint.filter(|of| of.joint.index() == joint).map(|of| of.index.value - 1.0).collect();
            largest(&changes)
        };
        let of_joints: Vec<f64> = (0..JOINTS).map(off).collect();
        println!("arm {seed}, largest change of each joint's index: {of_joints:.3?}");
        // a warning needs 0.05
        assert!(largest(&of_joints) < 0.04, "arm {seed}: {of_joints:.3?}");
    }
}
