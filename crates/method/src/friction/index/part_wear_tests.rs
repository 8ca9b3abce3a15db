//! Tests of partial wear: the index and the alarms of joints with a rise of only Coulomb or only viscous friction.

use super::alarm_tests::summaries;
use super::simulated_arm::{Arm, BASELINE, CYCLES, HOUR, JOINTS};
use crate::detect::runs::detect;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{AnomalyKind, Knowledge, Severity};

/// Rise of the worn parts per test, as a fraction of their healthy size.
const RATE: f64 = 0.04;
/// Healthy tests before wear begins, and tests with it.
const HEALTHY: usize = 9;
const WORN: usize = 12;
/// Scatter of each joint's friction from day to day.
const DAY: f64 = 0.015;
/// Speed of the reported rise of friction.
const SPEED: f64 = 0.6;
/// Rise of friction beyond which an alarm is late, and beyond which no joint may be reported as healthy.
const DUE: f64 = 0.20 + 1e-9;
const NEVER_OK: f64 = 0.25;

/// Wear of the Coulomb, viscous and curvature parts of a [`super::simulated_arm::Gear`]'s friction.
const SHAPES: [(&str, [bool; 3]); 4] = [
    ("all", [true, true, true]),
    ("Coulomb", [true, false, false]),
    ("viscous", [false, true, true]),
    ("linear", [true, true, false]),
];

/// Arm with daily tests, and the worn joint's friction at [`SPEED`] by test, as a multiple of the healthy one.
fn worn_arm(seed: u64, joint: usize, worn: [bool; 3], is_brisk: bool, hall_k: f64) -> (Arm, Vec<f64>) {
    let mut arm = Arm { is_brisk, ..Arm::unlike(seed) };
    let healthy = arm.gears[joint];
    let at = |arm: &Arm| {
        arm.gears[joint].friction(SPEED, healthy.warm()) / healthy.friction(SPEED, healthy.warm())
    };
    let mut truth = Vec::new();
    for test in 0..HEALTHY + WORN {
        if test >= HEALTHY {
            for (part, healthy) in arm.gears[joint]
                .friction
                .iter_mut()
                .zip(healthy.friction)
                .zip(worn)
                .filter_map(|(of, worn)| worn.then_some(of))
            {
                *part += RATE * healthy;
            }
        }
        truth.push(at(&arm));
        daily_test(&mut arm, hall_k);
    }
    (arm, truth)
}

/// Runs a test one day later. The ambient temperature varies by `hall_k`, K, and so does the temperature at the start.
fn daily_test(arm: &mut Arm, hall_k: f64) {
    let hall = hall_k * arm.normal();
    let rest = HOUR * (22.0 + arm.normal());
    arm.rest(rest, hall);
    for joint in 0..JOINTS {
        let by = 0.05 * arm.normal() * arm.gears[joint].warm();
        arm.heat[joint].iter_mut().for_each(|kelvin| *kelvin += by);
    }
    let day = std::array::from_fn(|_| DAY * arm.normal());
    arm.run_of(if arm.is_brisk { 8 } else { CYCLES }, hall, day);
}

/// Result for one arm.
#[derive(Debug, Default)]
struct ArmResult {
    /// Friction at the first alarm of the worn joint, as a multiple of the healthy one.
    at: Option<f64>,
    /// Kind of this alarm.
    kind: Option<AnomalyKind>,
    /// Number of tests with more friction than [`NEVER_OK`] that reported the joint as healthy.
    healthy: usize,
    /// True if an alarm of the joint closed.
    has_closed: bool,
    /// Number of alarms of other joints or before wear.
    false_alarms: usize,
}

fn said(arm: &Arm, truth: &[f64], joint: usize) -> ArmResult {
    let all = summaries(arm, true);
    let mut said = ArmResult::default();
    for tests in BASELINE + 1..=all.len() {
        let findings = detect(&all[..tests], &DetectSettings::default());
        let alarms: Vec<_> =
            findings.anomalies.iter().filter(|of| of.severity >= Severity::Warning).collect();
        let own = |of: &&&_| {
            let of: &armwatch_model::anomaly::Anomaly = of;
            of.joint.is_some_and(|of| of.index() == joint) && of.last_run_id >= HEALTHY as i64
        };
        let first = alarms.iter().find(own);
        if let (None, Some(alarm)) = (said.at, first) {
            (said.at, said.kind) = (Some(truth[tests - 1]), Some(alarm.kind));
        }
        let is_open = alarms.iter().filter(own).any(|of| !of.ended);
        said.has_closed |= said.at.is_some() && !is_open;
        let health = findings.health.iter().find(|of| of.joint.index() == joint);
        let is_ok = !is_open && health.is_some_and(|of| of.knowledge == Knowledge::Compared);
        said.healthy += usize::from(is_ok && truth[tests - 1] > 1.0 + NEVER_OK);
        if tests == all.len() {
            said.false_alarms = alarms.iter().filter(|of| !own(of)).count();
        }
    }
    said
}

/// Prints the results of each shape of wear, for `seeds` and each worn joint in turn. Returns the number of arms with
/// friction beyond [`DUE`] before the first alarm, reported as healthy beyond [`NEVER_OK`], or with an alarm that
/// closed.
fn table(seeds: std::ops::Range<u64>, is_brisk: bool, hall_k: f64) -> usize {
    let mut wrong = 0;
    for (name, worn) in SHAPES {
        let (mut found, mut late, mut healthy, mut closed, mut other, mut steps) =
            (Vec::new(), 0, 0, 0, 0, 0);
        for seed in seeds.clone() {
            let joint = usize::try_from(seed).expect("small") % JOINTS;
            let (arm, truth) = worn_arm(seed, joint, worn, is_brisk, hall_k);
            let said = said(&arm, &truth, joint);
            let is_late = said.at.map_or(truth[truth.len() - 1] > 1.0 + DUE, |at| at > 1.0 + DUE);
            let is_step = said.kind.is_some_and(|kind| kind != AnomalyKind::Drift);
            if is_late || said.healthy > 0 || said.has_closed {
                let last: Vec<String> =
                    arm.friction().indices.iter().map(|of| format!("{:.2}", of[joint].index.value)).collect();
                println!("  seed {seed}, {name} of joint {}: {said:?}; index {}", joint + 1, last.join(" "));
                wrong += 1;
            }
            found.extend(said.at);
            late += usize::from(is_late);
            healthy += usize::from(said.healthy > 0);
            closed += usize::from(said.has_closed);
            other += said.false_alarms;
            steps += usize::from(is_step);
        }
        found.sort_by(f64::total_cmp);
        let median = found.get(found.len() / 2).copied().unwrap_or(f64::NAN);
        println!(
            "| {name} | {} of {} | {median:.2} | {:.2} | late {late} | healthy {healthy} | closed {closed} | no drift {steps} | false {other} |",
            found.len(),
            seeds.end - seeds.start,
            found.last().copied().unwrap_or(f64::NAN)
        );
    }
    wrong
}

#[test]
fn wear_of_a_part_is_found_before_friction_has_risen_by_a_fifth() {
    assert!(table(500..506, true, 1.0) <= 1);
}

/// The aim is 98 % of the arms. 78 of 80 are found before friction has risen by a fifth, the others before 22 %.
#[test]
#[ignore = "80 histories"]
fn wear_of_a_part_is_found_in_many_arms() {
    let wrong = table(600..620, true, 1.0);
    assert!(wrong <= 2, "{wrong} of 80");
}

/// Healthy arms at an ambient temperature of 5 to 35 °C over a year of weekly tests.
#[test]
#[ignore = "years of histories"]
fn healthy_arms_in_a_hall_of_thirty_kelvin_are_quiet() {
    let (mut alarms, mut years, mut worst) = (0, 0.0, 0.0_f64);
    for seed in 700..720 {
        let mut arm = Arm { is_brisk: true, ..Arm::unlike(seed) };
        for week in 0..52 {
            let season = 15.0 * (std::f64::consts::TAU * (f64::from(week) / 52.0 + 0.05 * seed as f64)).sin();
            let hall = season + 1.5 * arm.normal();
            arm.rest(166.0 * HOUR, hall);
            let day = std::array::from_fn(|_| DAY * arm.normal());
            arm.run_of(8, hall, day);
        }
        let found = detect(&summaries(&arm, true), &DetectSettings::default()).anomalies;
        for of in found.iter().filter(|of| of.severity >= Severity::Warning) {
            println!("seed {seed}: {:?} {:?} {}", of.kind, of.joint, of.message);
            alarms += 1;
        }
        years += 1.0;
        let indices = arm.friction().indices;
        let largest = indices.iter().flatten().map(|of| (of.index.value - 1.0).abs()).fold(0.0, f64::max);
        worst = worst.max(largest);
        println!("seed {seed}: largest change of an index {largest:.3}");
    }
    println!("{alarms} false alarms in {years} robot-years, largest change of an index {worst:.3}");
    assert!(f64::from(alarms) <= years, "{alarms} in {years} years");
}
