//! Sound recordings of many arms, rates, frictions, clocks and lengths, through the whole analysis: they must be
//! accepted. The opposite, wrong recordings that must not pass, is in `wrong_recordings`.

use std::collections::BTreeMap;
use std::convert::Infallible;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::wrong_recordings::arms::{in_standard_dh, shipped, with_bodies};
use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{NominalJoint, Robot};
use armwatch_model::run::{Cycle, Samples, Stage};
use armwatch_simulate::arm::friction::FrictionShape;
use armwatch_simulate::run::record::record;
use armwatch_simulate::run::recording::Clock;
use armwatch_simulate::{SimulationSettings, recording_of_run};

const SHAPES: [FrictionShape; 6] = [
    FrictionShape::Gearbox,
    FrictionShape::Sign,
    FrictionShape::Smooth,
    FrictionShape::LateTurnOver,
    FrictionShape::Stiction,
    FrictionShape::Presliding,
];

/// Rates with their frequencies, higher for cheaper recordings: one of 5 kHz takes as long as fifty of 50 Hz.
const RATES_HZ: [(f64, u32); 8] =
    [(10.0, 6), (30.0, 6), (50.0, 6), (100.0, 6), (250.0, 4), (500.0, 2), (1000.0, 1), (5000.0, 1)];

/// Share of sound recordings that must give a complete cycle.
const LEAST_ACCEPTED: f64 = 0.995;

/// Distribution of the times of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Steps {
    Even,
    Alternating,
    Jittering,
    /// One row in a hundred is missing.
    Dropping,
}

const STEPS: [Steps; 4] = [Steps::Even, Steps::Alternating, Steps::Jittering, Steps::Dropping];

/// One recording of the table.
#[derive(Debug, Clone, Copy)]
struct Case {
    seed: u64,
    arm: usize,
    rate_hz: f64,
    shape: FrictionShape,
    steps: Steps,
    /// Length of the excitation that is used, s.
    length_s: f64,
    with_velocity: bool,
}

impl Case {
    /// A random case from all combinations; the same seed gives the same case.
    fn drawn(seed: u64, arms: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x50bd);
        let rates: Vec<f64> =
            RATES_HZ.iter().flat_map(|&(rate, share)| std::iter::repeat_n(rate, share as usize)).collect();
        let rate_hz = rates[rng.random_range(0..rates.len())];
        Self {
            seed,
            arm: rng.random_range(0..arms),
            rate_hz,
            shape: SHAPES[rng.random_range(0..SHAPES.len())],
            steps: STEPS[rng.random_range(0..STEPS.len())],
            // a short recording has one period of the excitation or slightly less
            length_s: if rng.random_bool(0.25) { rng.random_range(8.0..10.0) } else { f64::INFINITY },
            with_velocity: rng.random_bool(0.7),
        }
    }
}

/// An arm of a description, and true if the description contains its bodies.
fn arms() -> Vec<(&'static str, Robot, bool)> {
    vec![
        ("er3a", shipped("er3a"), true),
        ("scara", shipped("scara"), true),
        ("ur10e, standard DH", in_standard_dh(with_bodies(shipped("ur10e"))), false),
        ("tx40", with_bodies(shipped("tx40")), false),
    ]
}

/// The same arm with the bodies, frictions and noise of another specimen: bodies within a fifth; friction and noise
/// within a factor of two.
fn specimen(mut robot: Robot, seed: u64) -> Robot {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    for joint in &mut robot.joints {
        let Some(nominal) = &mut joint.nominal else { continue };
        let body = rng.random_range(0.8..1.2);
        let inertial = nominal.inertial.0.map(|value| body * value);
        let friction = rng.random_range(-1.0_f64..1.0).exp2();
        *nominal = NominalJoint {
            inertial: armwatch_model::robot::StandardParameters(inertial),
            motor_inertia: nominal.motor_inertia * rng.random_range(0.8..1.2),
            friction: nominal.friction.map(|f| friction * f),
            torque_noise: nominal.torque_noise * rng.random_range(-1.0_f64..1.0).exp2(),
            ..*nominal
        };
    }
    robot
}

/// The excitation stage of a case, and half a second before and after it.
fn recorded(robot: &Robot, case: &Case) -> Samples {
    let settings = SimulationSettings {
        seed: case.seed,
        cycles: 1,
        warming_s: 0.0,
        sample_rate_hz: case.rate_hz,
        friction: case.shape,
        clock: match case.steps {
            Steps::Even | Steps::Dropping => Clock::Even,
            Steps::Alternating => Clock::Alternating(1.0 / 11.0),
            Steps::Jittering => Clock::Jittering(0.1),
        },
        ..SimulationSettings::default()
    };
    let mut recording = recording_of_run(robot, &settings, 0).expect("a recording");
    let excitation = || recording.plan.segments.iter().filter(|s| s.stage == Stage::Excitation);
    let first = excitation().map(|s| s.start).fold(f64::INFINITY, f64::min);
    let last = excitation().map(|s| s.start + s.duration).fold(0.0, f64::max);
    let end = last.min(first + case.length_s);
    recording.plan.duration = end + 0.5;
    let n = robot.joint_count();
    let mut rng = ChaCha8Rng::seed_from_u64(case.seed ^ 0xd209);
    let mut samples = Samples {
        position: vec![Vec::new(); n],
        velocity: case.with_velocity.then(|| vec![Vec::new(); n]),
        torque: vec![Vec::new(); n],
        ..Samples::default()
    };
    let done: Result<_, Infallible> = record(&recording, case.seed, 0, |row| {
        if case.steps == Steps::Dropping && rng.random_bool(0.01) {
            return Ok(());
        }
        samples.time.push(row.time);
        samples.stage.push(if row.time > end { Stage::Between } else { row.stage });
        for j in 0..n {
            samples.position[j].push(row.position[j]);
            samples.torque[j].push(row.torque[j]);
            if let Some(velocity) = &mut samples.velocity {
                velocity[j].push(row.velocity[j]);
            }
        }
        Ok(())
    });
    done.expect("nothing fails");
    samples
}

/// Number of recordings with one property, and of those that were refused.
#[derive(Debug, Default)]
struct Tally {
    cases: usize,
    refused: usize,
}

/// Analyses the cases `seeds`; returns the refused ones, and counts by property.
fn balance(seeds: std::ops::Range<u64>) -> (Vec<String>, BTreeMap<String, Tally>) {
    let arms = arms();
    let methods: Vec<Method> = arms
        .iter()
        .map(|(_, robot, described)| {
            let mut robot = robot.clone();
            if !described {
                robot.joints.iter_mut().for_each(|joint| joint.nominal = None);
            }
            Method::new(robot, AnalysisSettings::default()).expect("base parameters")
        })
        .collect();
    let one = |seed: u64| {
        let case = Case::drawn(seed, arms.len());
        let robot = specimen(arms[case.arm].1.clone(), seed);
        let samples = recorded(&robot, &case);
        let analysis = analyse_cycle(&methods[case.arm], &Cycle { number: 1, samples });
        (case, why_not(&analysis))
    };
    let halves: Vec<Vec<(Case, Option<String>)>> = std::thread::scope(|scope| {
        let half = |odd: u64| {
            let seeds = seeds.clone();
            let one = &one;
            scope.spawn(move || seeds.filter(|seed| seed % 2 == odd).map(one).collect())
        };
        [half(0), half(1)].into_iter().map(|half| half.join().expect("no panic")).collect()
    });
    let mut refused = Vec::new();
    let mut counts: BTreeMap<String, Tally> = BTreeMap::new();
    for (case, why) in halves.into_iter().flatten() {
        let length = if case.length_s.is_finite() { "short" } else { "whole" };
        let properties = [
            format!("arm: {}", arms[case.arm].0),
            format!("rate: {:>4} Hz", case.rate_hz),
            format!("friction: {:?}", case.shape),
            format!("steps: {:?}", case.steps),
            format!("length: {length}"),
            format!("velocity column: {}", case.with_velocity),
        ];
        for property in properties {
            let tally = counts.entry(property).or_default();
            tally.cases += 1;
            tally.refused += usize::from(why.is_some());
        }
        refused.extend(why.map(|why| format!("{} {case:?}: {why}", arms[case.arm].0)));
    }
    (refused, counts)
}

/// The reason for a cycle that is not complete; `None` if it is.
fn why_not(analysis: &CycleAnalysis) -> Option<String> {
    let doubts = || analysis.is_doubtful().then(|| analysis.remarks.join("; "));
    analysis.identification.as_ref().err().cloned().or_else(doubts)
}

#[track_caller]
fn assert_taken(seeds: std::ops::Range<u64>) {
    let cases = (seeds.end - seeds.start) as usize;
    let (refused, counts) = balance(seeds);
    println!("| property | recordings | taken |\n|---|---|---|");
    for (property, tally) in &counts {
        println!("| {property} | {} | {} |", tally.cases, tally.cases - tally.refused);
    }
    println!("| all | {cases} | {} |", cases - refused.len());
    refused.iter().for_each(|why| println!("{why}"));
    let accepted = 1.0 - refused.len() as f64 / cases as f64;
    assert!(
        accepted >= LEAST_ACCEPTED,
        "{accepted:.4} of {cases} taken, the first not: {:?}",
        refused.first()
    );
}

#[test]
fn sound_recordings_of_many_arms_are_taken() {
    assert_taken(0..60);
}

/// Prints the table of docs/evidence/method.md:
/// `cargo test --test integration -- --ignored --nocapture sound_recordings`.
#[test]
#[ignore = "minutes: 1,200 recordings"]
fn sound_recordings_of_twelve_hundred_are_taken() {
    assert_taken(1000..2200);
}
