//! Tests of sound recordings that look faulty in one respect, with a harmless cause.

use crate::analyse::{Method, analyse_cycle};
use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::analysis::finding::{FindingKind, FindingKinds, FindingSeverity};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::Robot;
use armwatch_model::run::{Cycle, Samples};
use armwatch_simulate::run::matched_model::{ExactSettings, record_excitation};
use armwatch_testing::er3a;
use nalgebra::Vector3;

fn recording(robot: &Robot, seed: u64, rate: f64) -> Samples {
    let settings = ExactSettings { seed, sample_rate_hz: rate, ..ExactSettings::default() };
    record_excitation(robot, &settings).expect("a recording")
}

fn analysed_with(robot: &Robot, samples: &Samples, settings: AnalysisSettings) -> CycleAnalysis {
    let method = Method::new(robot.clone(), settings).expect("base parameters");
    analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() })
}

fn analysed(robot: &Robot, samples: &Samples) -> CycleAnalysis {
    analysed_with(robot, samples, AnalysisSettings::default())
}

/// Selected rows of `samples`.
fn chosen(samples: &Samples, rows: &[usize]) -> Samples {
    let of = |channels: &[Vec<f64>]| -> Vec<Vec<f64>> {
        channels.iter().map(|channel| rows.iter().map(|&row| channel[row]).collect()).collect()
    };
    Samples {
        time: rows.iter().map(|&row| samples.time[row]).collect(),
        position: of(&samples.position),
        velocity: samples.velocity.as_deref().map(of),
        torque: of(&samples.torque),
        stage: rows.iter().map(|&row| samples.stage[row]).collect(),
        ..Samples::default()
    }
}

/// Rows of a controller of 500 Hz that a logger writes: every fifth, and sometimes the sixth.
fn uneven_rows(rows: usize) -> Vec<usize> {
    let mut state = 1_u64;
    let mut at = 0;
    let mut found = Vec::new();
    while at < rows {
        found.push(at);
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        at += if (state >> 33) % 10 < 4 { 6 } else { 5 };
    }
    found
}

#[test]
fn a_logger_with_steps_of_10_and_12_ms_is_sound() {
    let robot = er3a();
    let every = recording(&robot, 3, 500.0);
    let samples = chosen(&every, &uneven_rows(every.rows()));
    let analysis = analysed(&robot, &samples);
    assert_eq!(analysis.findings, [], "{:?}", analysis.identification);
    let rate = (samples.rows() - 1) as f64 / (samples.time[samples.rows() - 1] - samples.time[0]);
    assert!((analysis.sample_rate / rate - 1.0).abs() < 1e-6, "{} {rate}", analysis.sample_rate);
    // same accuracy as with the controller's own rows
    let own = analysed(&robot, &chosen(&every, &(0..every.rows()).step_by(5).collect::<Vec<_>>()));
    for (uneven, even) in analysis.verification.iter().zip(&own.verification) {
        let [uneven, even] = [uneven, even].map(|of| of.moving_rows.relative);
        assert!(uneven < 1.15 * even + 1e-3, "{uneven} {even}");
    }
}

#[test]
fn a_row_that_was_dropped_is_no_gap() {
    let robot = er3a();
    let every = recording(&robot, 4, 100.0);
    let rows: Vec<usize> = (0..every.rows()).filter(|row| row % 97 != 50).collect();
    let analysis = analysed(&robot, &chosen(&every, &rows));
    assert!(analysis.identification.is_ok(), "{:?}", analysis.identification);
    assert!(analysis.remarks.iter().all(|remark| !remark.contains("gap")), "{:?}", analysis.remarks);
}

/// Replaces friction of a joint by one that changes sign within `distance` after each reversal.
fn late_friction(samples: &mut Samples, joint: usize, coulomb: f64, distance: f64) {
    let velocity = samples.velocity.as_ref().expect("velocity")[joint].clone();
    let position = samples.position[joint].clone();
    let mut z = 0.0;
    for row in 1..samples.rows() {
        let step = position[row] - position[row - 1];
        z = step.signum() + (z - step.signum()) * (-step.abs() / distance).exp();
        samples.torque[joint][row] += coulomb * (z - velocity[row].signum());
    }
}

#[test]
fn friction_of_wrists_that_turns_over_late_is_no_delay() {
    let robot = er3a();
    let coulomb = |joint: usize| robot.joints[joint].nominal.expect("nominal").friction[0];
    for seconds in [5.0, 30.0] {
        let mut samples = recording(&robot, 5, 100.0);
        for joint in 3..6 {
            late_friction(&mut samples, joint, coulomb(joint), 0.08);
        }
        let rows = samples.time.partition_point(|t| *t < seconds);
        let samples = samples.take_front(rows);
        let analysis = analysed(&robot, &samples);
        // a remark may name both causes; the parameters are valid and count
        let told = analysis.findings.iter().filter(|f| f.kind == FindingKind::TorqueDelay);
        for finding in told {
            assert_eq!(finding.severity, FindingSeverity::Warn, "{finding:?}");
            assert!(finding.sentence.contains("or friction turns over late"), "{finding:?}");
        }
        // five seconds are refused for negative inertias; a delay is not their cause either
        if seconds > 5.0 {
            assert!(analysis.identification.is_ok() && !analysis.is_doubtful(), "{:?}", analysis.findings);
        }
    }
}

#[test]
fn next_to_no_torque_need_not_be_explained() {
    let robot = er3a();
    let mut samples = recording(&robot, 6, 100.0);
    // slow variation of a third of a newton metre, while joint 2 holds a hundred
    samples.torque[5] = samples.time.iter().map(|t| 0.3 * (1.3 * t).sin()).collect();
    let analysis = analysed(&robot, &samples);
    let unexplained = |f: &&armwatch_model::analysis::finding::Finding| f.kind == FindingKind::Unexplained;
    assert_eq!(analysis.findings.iter().find(unexplained), None, "{:?}", analysis.identification);
}

#[test]
fn an_accepted_finding_marks_its_cycle_and_its_name_is_in_the_refusal() {
    let robot = er3a();
    let mut samples = recording(&robot, 7, 100.0);
    for torque in &mut samples.torque {
        torque.rotate_right(4);
    }
    let refused = analysed(&robot, &samples);
    let reason = refused.refusal().expect("late torques").to_owned();
    assert!(reason.starts_with("the torques come 40 ms after"), "{reason}");
    assert!(reason.contains("to take it anyway: [analysis] accept = [\"late_torque\""), "{reason}");
    assert!(!refused.factors.factors.is_empty() && !refused.is_doubtful());
    let accept: FindingKinds = refused
        .findings
        .iter()
        .filter(|finding| finding.severity == FindingSeverity::Refuse)
        .map(|finding| finding.kind)
        .collect();
    let taken = analysed_with(&robot, &samples, AnalysisSettings { accept, ..AnalysisSettings::default() });
    assert!(taken.identification.is_ok() && !taken.is_doubtful(), "{:?}", taken.identification);
    let said =
        taken.remarks.iter().any(|remark| remark.starts_with("accepted: the torques come 40 ms after"));
    assert!(said, "{:?}", taken.remarks);
}

#[test]
fn torques_of_the_motors_are_one_sentence() {
    let robot = er3a();
    let mut samples = recording(&robot, 8, 100.0);
    for (torque, joint) in samples.torque.iter_mut().zip(&robot.joints) {
        torque.iter_mut().for_each(|torque| *torque /= joint.gear_ratio);
    }
    let reason = analysed(&robot, &samples).refusal().expect("a unit is wrong").to_owned();
    assert!(reason.starts_with("the inertias of all 6 joints are about 1/"), "{reason}");
    assert!(reason.contains("side = \"motor\"") && reason.len() < 400, "{reason}");
}

#[test]
fn a_rate_below_four_times_the_cut_off_lowers_it_with_a_remark() {
    let robot = er3a();
    let analysis = analysed(&robot, &recording(&robot, 9, 30.0));
    assert_eq!(analysis.cutoff, 7.5);
    assert!(analysis.identification.is_ok(), "{:?}", analysis.identification);
    assert!(
        analysis.remarks.iter().any(|remark| remark.contains("analysed at 7.5 Hz")),
        "{:?}",
        analysis.remarks
    );
}

#[test]
fn a_base_off_level_is_a_remark_with_its_tilt_and_stays_out_of_joint_1() {
    let upright = er3a();
    let tilted = Robot { gravity: Vector3::new(0.35, 0.2, -9.80), ..upright.clone() };
    let truth = upright.gravity.angle(&tilted.gravity);
    let analysis = analysed(&upright, &recording(&tilted, 10, 100.0));
    assert!(analysis.identification.is_ok() && !analysis.is_doubtful(), "{:?}", analysis.findings);
    let evidence = analysis.findings.iter().flat_map(|finding| &finding.evidence);
    let tilt = evidence.filter(|of| of.name == "tilt_rad").map(|of| of.value).next().expect("a tilt");
    assert!((tilt - truth).abs() < 0.006, "{tilt} {truth}");
}
