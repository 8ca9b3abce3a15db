//! Tests of both sides of the border: sound recordings of unknown arms are accepted, faulty ones are refused with their
//! cause. Bodies, friction, ripple and noise are random; the motions are short Fourier series, as in typical
//! recordings.
#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test, which prints its table")]

#[path = "borders/case.rs"]
mod case;

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use armwatch_method::analyse::{Method, analyse_cycle};
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::finding::{FindingKind, FindingSeverity};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{DhParameters, GeometrySource, JointGeometry, Robot};
use armwatch_model::run::{Cycle, Samples};
use armwatch_simulate::arm::dynamics::{joint_torque, rigid_chain};
use armwatch_simulate::plan::motion::MotionState;
use nalgebra::Vector3;
use rand::RngExt;
use rand_distr::StandardNormal;

use case::{Case, G, rms};

fn analysed(described: &Robot, samples: Samples) -> CycleAnalysis {
    let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
    analyse_cycle(&method, &Cycle { number: 1, samples })
}

/// Outcome of an analysis, with the reason or the doubts.
fn said(analysis: &CycleAnalysis) -> String {
    match &analysis.identification {
        Err(reason) => format!("REFUSED {reason}"),
        Ok(_) if analysis.is_doubtful() => format!("DOUBTFUL {}", analysis.remarks.join("; ")),
        Ok(_) => format!("TAKEN {}", analysis.remarks.join("; ")),
    }
}

/// Asserts that at least `share` of the cases hold, and prints those that do not.
#[track_caller]
fn holds(name: &str, cases: &[(String, bool)], share: f64) {
    let good = cases.iter().filter(|(_, good)| *good).count();
    println!("## {name}: {good} of {}", cases.len());
    cases.iter().filter(|(_, good)| !good).for_each(|(said, _)| println!("  {said}"));
    assert!(good as f64 >= share * cases.len() as f64, "{name}: {good} of {}", cases.len());
}

/// Number of joints, 4 to 7 in turn.
fn count(seed: u64) -> usize {
    4 + (seed % 4) as usize
}

#[test]
fn sound_arms_are_taken() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let samples = case.recorded();
        let analysis = analysed(&case.described(), samples);
        (format!("{seed}: {}", said(&analysis)), analysis.identification.is_ok() && !analysis.is_doubtful())
    };
    holds("sound", &(0..60).map(one).collect::<Vec<_>>(), 1.0);
}

#[test]
fn heavy_arms_with_ripple_are_taken() {
    let one = |seed: u64| {
        let mut case = Case::heavy(seed);
        let samples = case.recorded();
        let analysis = analysed(&case.described(), samples);
        (format!("{seed}: {}", said(&analysis)), analysis.identification.is_ok() && !analysis.is_doubtful())
    };
    holds("heavy", &(100..130).map(one).collect::<Vec<_>>(), 1.0);
}

#[test]
fn tilted_floors_are_a_remark() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let described = case.described();
        let tilt = case.rng.random_range(0.5..3.0_f64).to_radians();
        let turn = case.rng.random_range(0.0..TAU);
        case.robot.gravity = G * Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), -tilt.cos());
        let analysis = analysed(&described, case.recorded());
        (
            format!("{seed} {:.1} deg: {}", tilt.to_degrees(), said(&analysis)),
            analysis.identification.is_ok() && !analysis.is_doubtful(),
        )
    };
    holds("tilt", &(200..230).map(one).collect::<Vec<_>>(), 0.96);
}

#[test]
fn mountings_are_named_and_no_sign() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let described = case.described();
        let slanted = case.rng.random_bool(0.5);
        let turn = f64::from(case.rng.random_range(0..4)) * FRAC_PI_2;
        let tilt = if slanted { PI / 4.0 } else { FRAC_PI_2 };
        case.robot.gravity = G * Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), -tilt.cos());
        let analysis = analysed(&described, case.recorded());
        let said = said(&analysis);
        let good = said.contains("gravity_m_s2 = [")
            && analysis
                .findings
                .iter()
                .all(|f| f.kind != FindingKind::TorqueSign && f.kind != FindingKind::TorqueSwapped);
        (format!("{seed} {:?}: {said}", case.robot.gravity), good)
    };
    holds("mounting", &(300..330).map(one).collect::<Vec<_>>(), 0.96);
}

#[test]
fn turned_torques_are_named() {
    let one = |seed: u64| {
        let n = count(seed);
        let mut case = Case::drawn(seed, n);
        let mut samples = case.recorded();
        let turned: Vec<usize> = match seed % 3 {
            0 => vec![case.rng.random_range(0..n)],
            1 => (n - 3..n).collect(),
            _ => (0..n).collect(),
        };
        turned.iter().for_each(|&j| samples.torque[j].iter_mut().for_each(|x| *x = -*x));
        let analysis = analysed(&case.described(), samples);
        let named: Vec<usize> = analysis
            .findings
            .iter()
            .filter(|f| f.kind == FindingKind::TorqueSign)
            .filter_map(|f| f.joint)
            .map(|j| j.index())
            .collect();
        (format!("{seed} {turned:?}: {}", said(&analysis)), named == turned)
    };
    holds("signs", &(400..445).map(one).collect::<Vec<_>>(), 0.97);
}

#[test]
fn swapped_torques_are_named() {
    let one = |seed: u64| {
        let n = count(seed);
        let mut case = Case::drawn(seed, n);
        let mut samples = case.recorded();
        let a = case.rng.random_range(0..n - 1);
        let b = case.rng.random_range(a + 1..n);
        samples.torque.swap(a, b);
        let analysis = analysed(&case.described(), samples);
        let said = said(&analysis);
        let good =
            said.contains(&format!("REFUSED joints {} and {}: ", a + 1, b + 1)) && said.contains("swapped");
        (format!("{seed} {a} {b}: {said}"), good)
    };
    holds("swaps", &(500..530).map(one).collect::<Vec<_>>(), 0.97);
}

/// Checks recordings whose torque `make` computes from the motion, the torque of the bodies and the recorded torque.
#[track_caller]
fn torques_are(
    name: &str,
    seeds: std::ops::Range<u64>,
    make: fn(&mut Case, &[MotionState], &[Vec<f64>], &mut Samples),
    right: fn(&CycleAnalysis) -> bool,
    share: f64,
) {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let (mut samples, states, rigid) = case.recorded_with_motion();
        make(&mut case, &states, &rigid, &mut samples);
        let analysis = analysed(&case.described(), samples);
        (format!("{seed}: {}", said(&analysis)), right(&analysis))
    };
    holds(name, &seeds.map(one).collect::<Vec<_>>(), share);
}

fn is_taken(analysis: &CycleAnalysis) -> bool {
    analysis.identification.is_ok() && !analysis.is_doubtful()
}

fn is_computed(analysis: &CycleAnalysis, words: &str) -> bool {
    is_refused(analysis, FindingKind::ComputedTorque) && said(analysis).contains(words)
}

#[test]
fn torques_of_a_model_are_not_measured() {
    let computed = |_: &mut Case, _: &[MotionState], rigid: &[Vec<f64>], samples: &mut Samples| {
        samples.torque = rigid.to_vec();
    };
    torques_are("computed", 700..720, computed, |a| is_computed(a, "computed and not measured"), 1.0);
}

#[test]
fn accelerations_are_no_torques() {
    let acceleration = |_: &mut Case, states: &[MotionState], rigid: &[Vec<f64>], samples: &mut Samples| {
        samples.torque =
            (0..rigid.len()).map(|j| states.iter().map(|s| s.acceleration[j]).collect()).collect();
    };
    torques_are(
        "acceleration",
        720..740,
        acceleration,
        |a| is_computed(a, "an acceleration was read as torque"),
        1.0,
    );
}

#[test]
fn torques_beyond_gravity_are_named() {
    let floating = |case: &mut Case, states: &[MotionState], _: &[Vec<f64>], samples: &mut Samples| {
        let chain = rigid_chain(&case.robot).expect("bodies");
        for (row, state) in states.iter().enumerate() {
            let weight = joint_torque(&chain, &MotionState::at_rest(state.position));
            samples.torque.iter_mut().zip(weight).for_each(|(torque, weight)| torque[row] -= weight);
        }
    };
    torques_are("beyond gravity", 740..760, floating, |a| is_computed(a, "subtracted gravity"), 0.9);
}

#[test]
fn torques_beyond_friction_are_named_and_no_sign() {
    let frictionless = |case: &mut Case, _: &[MotionState], rigid: &[Vec<f64>], samples: &mut Samples| {
        for (torque, rigid) in samples.torque.iter_mut().zip(rigid) {
            let sigma = 0.005 * rms(rigid);
            let noisy = |tau: &f64| tau + sigma * case.rng.sample::<f64, _>(StandardNormal);
            *torque = rigid.iter().map(noisy).collect();
        }
    };
    torques_are("beyond friction", 760..780, frictionless, |a| is_computed(a, "subtracted friction"), 0.9);
}

#[test]
fn arms_of_little_friction_are_taken() {
    let one = |seed: u64| {
        let mut case = Case { friction: 0.015, ripple: 0.002, ..Case::drawn(seed, count(seed)) };
        let samples = case.recorded();
        let analysis = analysed(&case.described(), samples);
        (format!("{seed}: {}", said(&analysis)), is_taken(&analysis))
    };
    holds("little friction", &(780..800).map(one).collect::<Vec<_>>(), 1.0);
}

#[test]
fn torques_in_steps_are_taken_and_the_step_is_told() {
    let coarse = |_: &mut Case, _: &[MotionState], _: &[Vec<f64>], samples: &mut Samples| {
        for torque in &mut samples.torque {
            let span = torque.iter().copied().fold(f64::NEG_INFINITY, f64::max)
                - torque.iter().copied().fold(f64::INFINITY, f64::min);
            let step = (0.03 * span).min(1.0);
            torque.iter_mut().for_each(|tau| *tau = step * (*tau / step).round());
        }
    };
    let told =
        |a: &CycleAnalysis| is_taken(a) && a.findings.iter().any(|f| f.kind == FindingKind::CoarseTorque);
    torques_are("coarse", 800..820, coarse, told, 1.0);
}

#[test]
fn rows_that_are_there_four_times_are_told_once() {
    let repeated = |_: &mut Case, _: &[MotionState], _: &[Vec<f64>], samples: &mut Samples| {
        let held =
            |channel: &mut Vec<f64>| (0..channel.len()).for_each(|row| channel[row] = channel[row - row % 4]);
        samples.position.iter_mut().chain(samples.velocity.iter_mut().flatten()).for_each(held);
        samples.torque.iter_mut().for_each(held);
    };
    let told = |a: &CycleAnalysis| {
        let repeated = a.findings.iter().find(|f| f.kind == FindingKind::Repeated);
        repeated.is_some_and(|f| f.sentence.contains("each row is there 4 times"))
            && !said(a).contains("lost digits")
    };
    torques_are("rows four times", 820..830, repeated, told, 1.0);
}

#[test]
fn time_stamps_that_jitter_are_no_lost_digits() {
    let jittering = |case: &mut Case, _: &[MotionState], _: &[Vec<f64>], samples: &mut Samples| {
        let step = 1.0 / case.rate_hz;
        samples.time.iter_mut().for_each(|time| *time += 0.45 * step * case.rng.random_range(-1.0..1.0));
    };
    torques_are("jitter", 830..840, jittering, |a| !said(a).contains("lost digits"), 1.0);
}

#[test]
fn rotors_that_a_urdf_cannot_tell_are_no_wrong_unit() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        for joint in &mut case.robot.joints {
            let nominal = joint.nominal.as_mut().expect("bodies");
            nominal.motor_inertia *= 40.0;
        }
        let mut described = case.robot.clone();
        described
            .joints
            .iter_mut()
            .filter_map(|joint| joint.nominal.as_mut())
            .for_each(|of| of.motor_inertia = 0.0);
        let samples = case.recorded();
        let analysis = analysed(&described, samples);
        (format!("{seed}: {}", said(&analysis)), is_taken(&analysis))
    };
    holds("rotors", &(840..850).map(one).collect::<Vec<_>>(), 1.0);
}

#[test]
fn a_torque_ten_times_as_large_is_named() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let mut samples = case.recorded();
        let joint = case.rng.random_range(0..3);
        samples.torque[joint].iter_mut().for_each(|tau| *tau *= 10.0);
        let analysis = analysed(&case.described(), samples);
        let said = said(&analysis);
        let right =
            said.contains(&format!("scale of the torque of joint {}", joint + 1)) && !is_taken(&analysis);
        (format!("{seed} {}: {said}", joint + 1), right)
    };
    // if gravity does not act on a first joint, its own inertia absorbs most of the scale
    holds("scale", &(850..880).map(one).collect::<Vec<_>>(), 0.8);
}

#[test]
fn torques_in_percent_of_rated_are_named_as_such() {
    let percent = |case: &mut Case, _: &[MotionState], _: &[Vec<f64>], samples: &mut Samples| {
        let last = samples.torque.len() - 1;
        for (joint, torque) in samples.torque.iter_mut().enumerate() {
            // rated torques of wrists are a twentieth of the shoulder's
            let rated = 300.0 * 0.05_f64.powf(joint as f64 / last as f64) * case.rng.random_range(0.8..1.2);
            torque.iter_mut().for_each(|tau| *tau *= 100.0 / rated);
        }
    };
    let named = |a: &CycleAnalysis| {
        is_refused(a, FindingKind::Description) && said(a).contains("percent of the joint's rated torque")
    };
    torques_are("percent", 890..910, percent, named, 0.9);
}

#[test]
fn lengths_of_the_wrong_sign_are_named_and_no_mounting() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let mut described = case.described();
        let long: Vec<usize> = (1..described.joint_count())
            .filter(|&j| described.joints[j].geometry.placement().translation.norm() > 0.25)
            .collect();
        let joint = long[case.rng.random_range(0..long.len())];
        let geometry = described.joints[joint].geometry;
        let mut placement = *geometry.placement();
        placement.translation = -placement.translation;
        described.joints[joint].geometry = match *geometry.source() {
            GeometrySource::Urdf(origin) => JointGeometry::urdf(placement, origin),
            _ => {
                let row = geometry.dh_row().expect("a row");
                JointGeometry::modified_dh(DhParameters { a: -row.a, d: -row.d, ..row })
            }
        };
        let analysis = analysed(&described, case.recorded());
        let said = said(&analysis);
        let right = ["a_m of joint", "d_m of joint", "origin", "turned by 180", "other way"]
            .iter()
            .any(|words| said.contains(words));
        (format!("{seed} {}: {said}", joint + 1), right)
    };
    holds("lengths", &(910..940).map(one).collect::<Vec<_>>(), 0.9);
}

#[test]
fn a_turned_torque_of_an_arm_off_level_is_named() {
    let one = |seed: u64| {
        let n = count(seed);
        let mut case = Case::drawn(seed, n);
        let described = case.described();
        let turn = case.rng.random_range(0.0..TAU);
        let tilt = 2.5_f64.to_radians();
        case.robot.gravity = G * Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), -tilt.cos());
        let mut samples = case.recorded();
        let joint = case.rng.random_range(0..n);
        samples.torque[joint].iter_mut().for_each(|tau| *tau = -*tau);
        let analysis = analysed(&described, samples);
        let named: Vec<usize> = analysis
            .findings
            .iter()
            .filter(|f| f.kind == FindingKind::TorqueSign)
            .filter_map(|f| f.joint)
            .map(|j| j.index())
            .collect();
        (format!("{seed} {}: {}", joint + 1, said(&analysis)), named == [joint])
    };
    // 28 of 30 at present
    holds("signs off level", &(940..970).map(one).collect::<Vec<_>>(), 0.93);
}

fn is_refused(analysis: &CycleAnalysis, kind: FindingKind) -> bool {
    analysis.findings.iter().any(|f| f.kind == kind && f.severity == FindingSeverity::Refuse)
}

#[test]
fn late_torques_are_named() {
    let one = |seed: u64| {
        let mut case = Case::drawn(seed, count(seed));
        let mut samples = case.recorded();
        let rows = (0.04 * case.rate_hz).round() as usize;
        samples.torque.iter_mut().for_each(|torque| torque.rotate_right(rows));
        let analysis = analysed(&case.described(), samples);
        (format!("{seed}: {}", said(&analysis)), is_refused(&analysis, FindingKind::TorqueDelay))
    };
    // the others get a remark: friction that changes sign late looks the same in ten seconds
    holds("late", &(600..620).map(one).collect::<Vec<_>>(), 0.8);
}
