//! Tests of the diagnosis of simulated recordings, healthy and faulty.

use std::convert::Infallible;

use super::view::DiagnoseSettings;
use super::{diagnose_samples, runs};
use crate::analyse::{Method, analyse_cycle};
use crate::diagnose::model::combination::PlausibleSettings;
use crate::diagnose::model::{diagnose_model, top_speeds};
use crate::signal::filter::filter_signals;
use armwatch_model::analysis::finding::{Finding, FindingKind, FindingSeverity};
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::{DhParameters, JointGeometry, JointIndex, Robot};
use armwatch_model::run::{Cycle, Samples, Stage};
use armwatch_simulate::run::record::record;
use armwatch_simulate::{SimulationSettings, recording_of_run};
use armwatch_testing::{er3a, scara};

/// Comparison with an examination of every row, for runs of all lengths at all places.
#[test]
fn runs_are_found_wherever_they_lie() {
    let every_row = |values: &[f64], least: usize| {
        let mut found = Vec::new();
        let mut start = 0;
        for row in 0..values.len() {
            if row + 1 == values.len() || values[row + 1] != values[start] {
                if row + 1 - start >= least {
                    found.push((start, row + 1));
                }
                start = row + 1;
            }
        }
        found
    };
    let mut state = 1_u32;
    let mut next = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 16
    };
    for round in 0..400 {
        let mut values = Vec::new();
        while values.len() < 300 {
            let length = if next() % 4 == 0 { next() % 40 } else { next() % 3 };
            let value = f64::from(next() % 3) - 1.0;
            values.extend((0..length).map(|_| value));
        }
        values.truncate(250 + round % 50);
        for least in [2, 3, 4, 7, 20, 60] {
            assert_eq!(runs(&values, least), every_row(&values, least), "{least} {values:?}");
        }
    }
    assert_eq!(runs(&[], 4), []);
    assert_eq!(runs(&[0.0, -0.0, 0.0, -0.0], 4), [(0, 4)]);
}

/// One cycle from the simulator: friction with bump, ripple and warm-up, noise, steps.
fn cycle(robot: &Robot, seed: u64) -> Samples {
    let settings = SimulationSettings { seed, cycles: 1, warming_s: 0.0, ..SimulationSettings::default() };
    let recording = recording_of_run(robot, &settings, 0).expect("a recording");
    let n = robot.joint_count();
    let mut samples = Samples {
        position: vec![Vec::new(); n],
        velocity: Some(vec![Vec::new(); n]),
        torque: vec![Vec::new(); n],
        ..Samples::default()
    };
    let done: Result<_, Infallible> = record(&recording, seed, 0, |row| {
        samples.time.push(row.time);
        samples.stage.push(row.stage);
        for j in 0..n {
            samples.position[j].push(row.position[j]);
            samples.velocity.as_mut().expect("velocity")[j].push(row.velocity[j]);
            samples.torque[j].push(row.torque[j]);
        }
        Ok(())
    });
    done.expect("nothing fails");
    samples
}

fn diagnose(robot: &Robot, samples: &Samples) -> Vec<Finding> {
    let filtered = filter_signals(samples, 12.0).expect("conditions");
    diagnose_samples(robot, samples, &filtered, &DiagnoseSettings::default())
}

fn scale(channel: &mut [f64], factor: f64) {
    channel.iter_mut().for_each(|x| *x *= factor);
}

fn velocity(samples: &mut Samples) -> &mut Vec<Vec<f64>> {
    samples.velocity.as_mut().expect("velocity")
}

fn spoilt(robot: &Robot, spoil: impl Fn(&mut Samples)) -> Vec<Finding> {
    let mut samples = cycle(robot, 3);
    spoil(&mut samples);
    diagnose(robot, &samples)
}

/// Asserts exactly these findings, by kind and joint number (0: none).
#[track_caller]
fn assert_found(found: &[Finding], expected: &[(FindingKind, usize)]) {
    let kinds: Vec<(FindingKind, usize)> =
        found.iter().map(|f| (f.kind, f.joint.map_or(0, JointIndex::number))).collect();
    assert_eq!(kinds, expected, "{found:#?}");
}

#[test]
fn healthy_recordings_raise_nothing() {
    for (robot, seed) in [(er3a(), 1), (er3a(), 2), (scara(), 1), (scara(), 2), (scara(), 3)] {
        assert_found(&diagnose(&robot, &cycle(&robot, seed)), &[]);
    }
}

#[test]
fn a_healthy_recording_without_velocity_raises_nothing() {
    for robot in [er3a(), scara()] {
        assert_found(&spoilt(&robot, |samples| samples.velocity = None), &[]);
    }
}

#[test]
fn a_joint_that_stands_still_is_named() {
    let found = spoilt(&scara(), |samples| {
        let at = samples.position[1][0];
        samples.position[1].fill(at);
        velocity(samples)[1].fill(0.0);
    });
    assert_found(&found, &[(FindingKind::Still, 2)]);
}

#[test]
fn one_speed_only_is_named() {
    // A triangle of 0.5 rad/s with a period of 4 s; its corners are shorter than a tenth of the rows.
    let found = spoilt(&scara(), |samples| {
        for row in 0..samples.rows() {
            let phase = (samples.time[row] / 4.0).fract();
            let (q, qd) = if phase < 0.5 { (2.0 * phase - 0.5, 0.5) } else { (1.5 - 2.0 * phase, -0.5) };
            samples.position[0][row] = q;
            velocity(samples)[0][row] = qd;
        }
    });
    let one_speed = |f: &Finding| f.kind == FindingKind::OneSpeed && f.joint == Some(JointIndex::new(0));
    assert!(found.iter().any(one_speed), "{found:#?}");
    assert!(found.iter().all(|f| f.kind != FindingKind::Stuck), "{found:#?}");
}

#[test]
fn clipped_torque_is_named_with_its_limit() {
    for robot in [er3a(), scara()] {
        let mut samples = cycle(&robot, 3);
        let peak = samples.torque[1].iter().fold(0.0_f64, |peak, tau| peak.max(tau.abs()));
        let limit = 0.6 * peak;
        samples.torque[1].iter_mut().for_each(|tau| *tau = tau.clamp(-limit, limit));
        let found = diagnose(&robot, &samples);
        assert_found(&found, &[(FindingKind::Saturated, 2)]);
        assert!((found[0].evidence[0].value.abs() - limit).abs() < 1e-9 * limit);
    }
}

#[test]
fn stuck_channels_are_named() {
    for (channel, word) in [(0, "position"), (1, "velocity"), (2, "torque")] {
        let found = spoilt(&er3a(), |samples| {
            let rows = samples.rows();
            let channel = match channel {
                0 => &mut samples.position[2],
                1 => &mut velocity(samples)[2],
                _ => &mut samples.torque[2],
            };
            let value = channel[300];
            channel[300..rows].fill(value);
        });
        assert_found(&found, &[(FindingKind::Stuck, 3)]);
        assert!(found[0].sentence.contains(word), "{}", found[0].sentence);
    }
}

#[test]
fn swapped_velocities_are_named_at_both_joints() {
    for robot in [er3a(), scara()] {
        let found = spoilt(&robot, |samples| velocity(samples).swap(0, 1));
        assert_found(&found, &[(FindingKind::VelocitySwapped, 1), (FindingKind::VelocitySwapped, 2)]);
    }
}

#[test]
fn swapped_torques_are_named() {
    for (robot, a, b) in [(er3a(), 0, 3), (er3a(), 4, 5), (scara(), 0, 1)] {
        let method = Method::new(robot.clone(), AnalysisSettings::default()).expect("base parameters");
        let mut samples = cycle(&robot, 3);
        samples.torque.swap(a, b);
        let found = analyse_cycle(&method, &Cycle { number: 1, samples }).findings;
        assert_found(&found, &[(FindingKind::TorqueSwapped, a + 1)]);
    }
}

#[test]
fn wrong_units_are_named() {
    let degrees = 180.0 / std::f64::consts::PI;
    let found = spoilt(&er3a(), |samples| scale(&mut velocity(samples)[3], degrees));
    assert_found(&found, &[(FindingKind::VelocityUnit, 4)]);
    assert!(found[0].sentence.contains("degrees per second"), "{}", found[0].sentence);

    let found = spoilt(&er3a(), |samples| scale(&mut velocity(samples)[3], 30.0 / std::f64::consts::PI));
    assert!(found[0].sentence.contains("turns per minute"), "{}", found[0].sentence);

    let found = spoilt(&er3a(), |samples| {
        samples.position.iter_mut().for_each(|channel| scale(channel, degrees));
        velocity(samples).iter_mut().for_each(|channel| scale(channel, degrees));
    });
    let all: Vec<_> = (1..=6).map(|j| (FindingKind::PositionUnit, j)).collect();
    assert_found(&found, &all);
}

#[test]
fn turned_signs_are_named() {
    for robot in [er3a(), scara()] {
        let method = Method::new(robot.clone(), AnalysisSettings::default()).expect("base parameters");
        for joint in 0..robot.joint_count() {
            let found = spoilt(&robot, |samples| scale(&mut velocity(samples)[joint], -1.0));
            assert_found(&found, &[(FindingKind::VelocitySign, joint + 1)]);
            let mut samples = cycle(&robot, 3);
            scale(&mut samples.torque[joint], -1.0);
            let analysis = analyse_cycle(&method, &Cycle { number: 1, samples });
            assert_found(&analysis.findings, &[(FindingKind::TorqueSign, joint + 1)]);
            assert!(!analysis.factors.factors.is_empty(), "factors are kept of a refused cycle");
        }
    }
}

#[test]
fn a_wrong_time_axis_is_told_from_a_wrong_unit() {
    let found = spoilt(&er3a(), |samples| scale(&mut samples.time, 0.8));
    assert!(found.iter().any(|f| f.kind == FindingKind::TimeAxis && f.joint.is_none()), "{found:#?}");
    assert!(found.iter().all(|f| f.kind != FindingKind::VelocityUnit), "{found:#?}");
}

#[test]
fn positions_outside_the_limits_are_named() {
    let found = spoilt(&er3a(), |samples| samples.position[1].iter_mut().for_each(|q| *q += 1.0));
    assert_found(&found, &[(FindingKind::OutsideLimits, 2)]);
    assert_eq!(found[0].severity, FindingSeverity::Refuse);
}

#[test]
fn markers_of_the_logger_are_named_with_their_time() {
    for (value, name) in [(-9999.0, "torque"), (65535.0, "torque")] {
        let found = spoilt(&er3a(), |samples| samples.torque[4][700] = value);
        assert_found(&found, &[(FindingKind::Spike, 5)]);
        let sentence = &found[0].sentence;
        assert!(sentence.contains(&format!("{name} is {value} Nm at 14.000 s")), "{sentence}");
    }
    let found = spoilt(&er3a(), |samples| velocity(samples)[1][800] = 999.0);
    assert!(
        found.iter().any(|f| f.kind == FindingKind::Spike && f.sentence.contains("velocity is 999")),
        "{found:#?}"
    );
}

#[test]
fn a_position_that_leaps_is_named_with_its_time() {
    let found = spoilt(&er3a(), |samples| samples.position[2][700] += 1.5);
    assert_found(&found, &[(FindingKind::Spike, 3)]);
    assert!(found[0].sentence.contains("from one row to the next at 14.0"), "{}", found[0].sentence);
    // there and back
    assert!((found[0].evidence[2].value - 2.0).abs() < f64::EPSILON, "{found:#?}");
}

#[test]
fn positions_folded_into_one_turn_are_told_from_lost_digits() {
    let found = spoilt(&er3a(), |samples| {
        let channel = &mut samples.position[5];
        let middle = channel.iter().sum::<f64>() / channel.len() as f64;
        for position in channel.iter_mut().filter(|position| **position > middle + 0.8) {
            *position -= std::f64::consts::TAU;
        }
    });
    assert_found(&found, &[(FindingKind::Spike, 6)]);
    assert!(found[0].sentence.contains("folded into one turn"), "{}", found[0].sentence);
}

#[test]
fn rows_that_repeat_are_told() {
    let found = spoilt(&er3a(), |samples| {
        for row in (1..samples.rows()).step_by(10) {
            for j in 0..6 {
                samples.position[j][row] = samples.position[j][row - 1];
                samples.torque[j][row] = samples.torque[j][row - 1];
                velocity(samples)[j][row] = velocity(samples)[j][row - 1];
            }
        }
    });
    assert_found(&found, &[(FindingKind::Repeated, 0)]);
    assert_eq!(found[0].severity, FindingSeverity::Warn);
    assert!((found[0].evidence[0].value - 0.1).abs() < 0.01, "{found:#?}");
}

#[test]
fn radians_divided_into_degrees_are_told_from_a_poor_motion() {
    let found = spoilt(&scara(), |samples| {
        let degrees = 180.0 / std::f64::consts::PI;
        samples.position.iter_mut().for_each(|channel| scale(channel, 1.0 / degrees));
        velocity(samples).iter_mut().for_each(|channel| scale(channel, 1.0 / degrees));
    });
    assert!(found.iter().any(|f| f.kind == FindingKind::SmallMotion && f.joint.is_none()), "{found:#?}");
}

/// Analyses like the pipeline and returns the findings about the model.
fn judge(described: &Robot, samples: &Samples) -> Vec<Finding> {
    let method = Method::new(described.clone(), AnalysisSettings::default()).expect("base parameters");
    let analysis = analyse_cycle(&method, &Cycle { number: 1, samples: samples.clone() });
    let identified = analysis.identification.expect("parameters");
    let filtered = filter_signals(samples, 12.0).expect("conditions");
    let rows: Vec<usize> =
        (0..samples.rows()).filter(|&row| samples.stage[row] == Stage::Excitation).collect();
    let speeds = top_speeds(&filtered.qd, &rows);
    diagnose_model(described, &identified, &analysis.verification, &speeds, &PlausibleSettings::default())
}

#[test]
fn models_of_healthy_recordings_are_plausible() {
    for (robot, seed) in [(er3a(), 1), (er3a(), 2), (scara(), 1), (scara(), 2), (scara(), 3)] {
        assert_found(&judge(&robot, &cycle(&robot, seed)), &[]);
    }
}

#[test]
fn a_wrong_geometry_is_refused() {
    let robot = er3a();
    let samples = cycle(&robot, 3);
    // Like a standard table read as a modified one: each joint gets the next one's a and alpha.
    let mut shifted = robot.clone();
    for j in 0..6 {
        let row = |j: usize| robot.joints[j % 6].geometry.dh_row().expect("a table");
        let shifted_row = DhParameters { a: row(j + 1).a, alpha: row(j + 1).alpha, ..row(j) };
        shifted.joints[j].geometry = JointGeometry::modified_dh(shifted_row);
    }
    let method = Method::new(shifted, AnalysisSettings::default()).expect("base parameters");
    let analysis = analyse_cycle(&method, &Cycle { number: 1, samples });
    let reason = analysis.identification.expect_err("no numbers pass");
    // the change of the description that explains the torques is the actual one
    assert!(reason.contains("contradict the description"), "{reason}");
    assert!(reason.contains("convention = \"standard_dh\""), "{reason}");
    assert!(analysis.verification.is_empty());
}
