//! Causes of a change of the arm while loads, seasons or noise differ between tests.

use super::cause_tests::{State, alarms, answers, fleet, only};
use armwatch_model::analysis::response::ChannelFault;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, RunSummary};

#[test]
fn loads_by_turns_in_the_first_tests_do_not_hide_another_one() {
    let tools = |run: i64| [0.0, 0.8, 2.0][(run % 3) as usize];
    for seed in 1..=4 {
        let quiet = fleet(24, seed, |run| State { mass: tools(run), ..State::default() });
        for runs in [7, 8, 9, 24] {
            assert_eq!(alarms(&quiet[..runs]), vec![], "seed {seed}, {runs} runs");
        }
        let more = |run: i64| if run >= 12 { 5.0 } else { tools(run) };
        let found = fleet(14, seed, |run| State { mass: more(run), ..State::default() });
        let found = only(&found, AnomalyKind::Payload, None);
        // against the nearest of the tools
        assert!(found.first_run_id == 13 && (found.value / 3.0 - 1.0).abs() < 0.1, "{found:?}");
    }
}

/// The mass that is told is that of the latest test, and a test without it ends the alarm or is no part of it.
#[test]
fn a_load_that_was_put_down_is_not_carried_by_half() {
    let tools = |run: i64| if run < 6 { 0.0 } else { [0.8, 2.0, 0.0][(run % 3) as usize] };
    for seed in 1..=4 {
        let history = fleet(18, seed, |run| State { mass: tools(run), ..State::default() });
        for runs in 7..=18 {
            let found = alarms(&history[..runs]);
            let Some(load) = found.iter().find(|of| of.kind == AnomalyKind::Payload) else {
                panic!("seed {seed}, {runs} runs: {found:?}")
            };
            let carried = tools(load.last_run_id - 1);
            assert!((load.value - carried).abs() < 0.1, "seed {seed}, {runs} runs: {carried} kg, {load:?}");
        }
    }
}

/// Friction falls by a third in summer; noise and unexplained torque stay as they are, in Nm.
#[test]
fn a_season_of_friction_is_no_noise() {
    let season = |history: &mut Vec<RunSummary>| {
        for (run, of) in history.iter_mut().enumerate() {
            let torque = 20.0 * (0.8 + 0.2 * (0.2 * run as f64).cos());
            for joint in &mut of.joints {
                joint.torque_rms = Some(torque);
                joint.relative_noise = joint.relative_noise.map(|noise| noise * 20.0 / torque);
                joint.relative_rmsd = joint.relative_rmsd.map(|rmsd| rmsd * 20.0 / torque);
            }
        }
    };
    let mut quiet = fleet(30, 9, |_| State { noise: Some((3, 1.0)), ..State::default() });
    season(&mut quiet);
    assert_eq!(alarms(&quiet), vec![]);
    // noise that has grown in summer has its own size
    let mut noisy = fleet(18, 9, |run| {
        let ratio = if run >= 15 { 4.0 } else { 1.0 };
        State {
            noise: Some((3, ratio)),
            unexplained: Some((3, if run >= 15 { 2.18 } else { 1.0 })),
            ..State::default()
        }
    });
    season(&mut noisy);
    let found = only(&noisy, AnomalyKind::Sensor, Some(4));
    assert!((found.value / 4.0 - 1.0).abs() < 0.05 && found.message.contains("noise"), "{found:?}");
}

#[test]
fn noise_of_all_signals_is_one_alarm_of_the_arm() {
    let mut history = fleet(9, 9, |_| State { noise: Some((3, 1.0)), ..State::default() });
    for run in &mut history[7..] {
        for joint in &mut run.joints {
            joint.relative_noise = joint.relative_noise.map(|noise| 3.0 * noise);
            // half of the unexplained torque is noise
            joint.relative_rmsd = joint.relative_rmsd.map(|rmsd| 1.73 * rmsd);
        }
        // parameters are known three times as badly
        for (place, of) in run.parameters.iter_mut().enumerate() {
            of.mean += if place % 2 == 0 { 8.0 } else { -8.0 } * of.std_dev / f64::from(of.cycles).sqrt();
        }
    }
    let found = only(&history, AnomalyKind::Sensor, None);
    assert!((found.value / 3.0 - 1.0).abs() < 0.05 && found.message.contains("most joints"), "{found:?}");
}

/// A ripple at the motor's turn grows with every test. Its torque moves the parameters as an offset would. From some test
/// on, the friction stage shows the part of it that does not average out.
#[test]
fn a_mechanical_fault_that_grows_becomes_no_offset() {
    const FIRST: i64 = 7;
    for (seed, rate, left) in [(13, 1.2, 0.0), (14, 1.4, 0.0), (15, 1.7, 0.0), (16, 1.4, 0.3)] {
        let ratio = |run: i64| if run < FIRST { 1.0 } else { 3.0 * f64::powi(rate, (run - FIRST) as i32) };
        let state = |run: i64| State {
            noise: Some((3, 1.0)),
            unexplained: Some((3, ratio(run))),
            offset: (run > FIRST + 2).then_some((3, left)),
            ..State::default()
        };
        let mut history = fleet(13, seed, state);
        answers(&mut history, 3, ChannelFault::TorqueOffset, 0.8, 0.1);
        for (run, of) in (0..).zip(&mut history).filter(|(run, _)| *run > FIRST) {
            // the offset that leaves as much, and what the trust in the joint leaves of its effect
            let offset = 0.2 * (ratio(run).powi(2) - 1.0).sqrt();
            let own = of.parameters.iter_mut().filter(|of| of.id.joint.index() == 3);
            own.for_each(|of| of.mean += 0.8 * offset / ratio(run).powi(2));
        }
        // the first test alone is worth knowing, the second one confirms it
        for runs in FIRST as usize + 2..=history.len() {
            let found = only(&history[..runs], AnomalyKind::Accuracy, Some(4));
            assert_eq!(found.quantity, Quantity::UnexplainedTorque, "rate {rate}: {found:?}");
            let latest = (found.first_run_id, found.last_run_id, found.ended);
            assert_eq!(latest, (FIRST + 1, runs as i64, false), "rate {rate}: {found:?}");
            assert!((found.value / ratio(runs as i64 - 1) - 1.0).abs() < 0.1, "rate {rate}: {found:?}");
        }
    }
}
