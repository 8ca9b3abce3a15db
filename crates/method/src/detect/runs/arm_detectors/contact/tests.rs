//! Cycles of simulated tests: noise of the torque, friction that changes while a cold arm warms, and a push, as squares
//! of torque that add up.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;
use crate::detect::runs::detect;
use crate::detect::runs::fixtures::hours;
use crate::detect::runs::open_run::{UsualTests, detect_open};
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::analysis::measurements::CycleRmsd;
use armwatch_model::anomaly::CycleSeries;
use armwatch_model::anomaly::quantity::Quantity;

const JOINTS: usize = 6;
/// RMS of the torque of each joint, and the deviation of a warm cycle, Nm.
const TORQUE: [f64; JOINTS] = [20.0, 60.0, 43.0, 12.0, 8.0, 6.0];
const USUAL: [f64; JOINTS] = [0.4, 0.6, 0.7, 0.2, 0.16, 0.15];
const CYCLES: u32 = 8;

/// One test. `cold` is the torque of a cold start that no parameter explains, Nm; `pushes` have joint, cycle, force at
/// the joint (Nm) and share of the cycle.
fn test(run: i64, cold: f64, pushes: &[(usize, u32, f64, f64)]) -> RunSummary {
    let mut rng = ChaCha8Rng::seed_from_u64(99 + run as u64);
    let mut summary =
        RunSummary { run_id: run + 1, started_at: hours(24 * run), cycles: CYCLES, ..RunSummary::default() };
    for cycle in 1..=CYCLES {
        for j in 0..JOINTS {
            let noise = USUAL[j] * (1.0 + 0.05 * rng.sample::<f64, _>(StandardNormal));
            let warming = cold * TORQUE[j] / 20.0 * (-1.4 * f64::from(cycle - 1)).exp();
            let own = pushes.iter().filter(|(joint, of, ..)| (*joint, *of) == (j, cycle));
            let push: f64 = own.map(|(_, _, force, share)| force * force * share).sum();
            let square = noise * noise + warming * warming + push;
            summary.whole_cycle_rmsd.push(CycleRmsd {
                cycle,
                joint: JointIndex::new(j),
                relative_rmsd: (square / (TORQUE[j] * TORQUE[j] + push)).sqrt(),
            });
            summary.cycle_friction.push(CycleSeries {
                cycle,
                friction: CycleFriction {
                    joint: JointIndex::new(j),
                    minute: 3.0 * f64::from(cycle),
                    ln_torque: 1.0 + 0.001 * rng.sample::<f64, _>(StandardNormal),
                    offset: 0.0,
                    levels: 4,
                    speed_fraction: 0.5,
                },
            });
        }
    }
    summary.joints = (0..JOINTS)
        .map(|j| armwatch_model::analysis::JointSummary {
            joint: JointIndex::new(j),
            warm_friction: None,
            excitation_friction: None,
            half_speed_friction: None,
            friction_index: None,
            relative_rmsd: Some(0.02),
            rmsd_swing: None,
            relative_noise: None,
            torque_rms: None,
        })
        .collect();
    summary
}

fn found(history: &[RunSummary]) -> Vec<Anomaly> {
    let mut found = detect(history, &DetectSettings::default()).anomalies;
    found.retain(|of| of.quantity == Quantity::Contact);
    found
}

/// 30 Nm against joint 3 for a twentieth of a cycle.
const PUSH: (usize, u32, f64, f64) = (2, 5, 30.0, 0.05);

#[test]
fn a_push_in_one_cycle_is_an_alarm_that_names_joint_and_cycle_and_ends() {
    let history = |pushed: i64, runs: i64, cycle: u32| -> Vec<RunSummary> {
        let push = [(2, cycle, 30.0, 0.05)];
        let of = |run: i64| test(run, 3.0, if run == pushed { &push } else { &[] });
        (0..runs).map(of).collect()
    };
    for cycle in 3..CYCLES {
        for pushed in [5, 9] {
            let all = found(&history(pushed, 12, cycle));
            let [of] = &all[..] else { panic!("one alarm, cycle {cycle}: {all:?}") };
            assert_eq!((of.kind, of.severity), (AnomalyKind::Accuracy, Severity::Warning));
            assert_eq!((of.joint, of.first_cycle), (Some(JointIndex::new(2)), Some(cycle)));
            assert_eq!((of.first_run_id, of.last_run_id, of.ended), (pushed + 1, pushed + 1, true));
            // 30 Nm over a twentieth of the cycle in addition to 43 Nm: 6.7 of 43.5
            assert!(
                (of.value - 0.154).abs() < 0.01 && of.message.contains("% of this joint's torque ("),
                "{of:?}"
            );
        }
    }
}

#[test]
fn what_a_push_does_to_the_rmsd_of_its_test_is_no_oscillation() {
    let swinging = |by: f64| Some(armwatch_model::analysis::RmsdSwing { value: by, cycles: CYCLES as usize });
    let history = |pushes: &[(usize, u32, f64, f64)]| -> Vec<RunSummary> {
        let of = |run: i64| {
            let mut test = test(run, 3.0, if run == 9 { pushes } else { &[] });
            for of in &mut test.joints {
                of.rmsd_swing = swinging(if run == 9 && of.joint.index() == 2 { 0.05 } else { 0.001 });
            }
            test
        };
        (0..10).map(of).collect()
    };
    let found = |pushes| detect(&history(pushes), &DetectSettings::default());
    let without = found(&[]);
    let swings = |of: &&Anomaly| of.kind == AnomalyKind::Oscillation;
    assert_eq!(without.anomalies.iter().filter(swings).count(), 1, "{:?}", without.anomalies);
    let with = found(&[PUSH]);
    assert_eq!(
        with.anomalies.iter().map(|of| of.quantity).collect::<Vec<_>>(),
        [Quantity::Contact],
        "{with:?}"
    );
}

#[test]
fn a_push_that_several_joints_feel_is_one_alarm_of_the_arm() {
    let pushes = [PUSH, (1, 5, 25.0, 0.05)];
    let history: Vec<RunSummary> =
        (0..10).map(|run| test(run, 3.0, if run == 9 { &pushes } else { &[] })).collect();
    let all = found(&history);
    let [of] = &all[..] else { panic!("one alarm: {all:?}") };
    assert_eq!((of.joint, of.first_cycle), (None, Some(5)));
    assert!(of.message.contains("joint 2") && of.message.contains("joint 3"), "{}", of.message);
}

#[test]
fn cold_starts_whatever_the_tests_before_and_pauses_are_no_contact() {
    for colder in [0.0, 4.0, 12.0] {
        let history: Vec<RunSummary> =
            (0..40).map(|run| test(run, if run % 7 == 6 { colder } else { 0.3 }, &[])).collect();
        assert_eq!(found(&history), vec![], "{colder}");
    }
    // the arm rests before its fifth cycle, and three of its joints are fitted badly then
    let mut rested: Vec<RunSummary> = (0..10).map(|run| test(run, 3.0, &[])).collect();
    let last = rested.last_mut().expect("a test");
    for of in last.whole_cycle_rmsd.iter_mut().filter(|of| of.cycle == 5 && of.joint.index() < 3) {
        of.relative_rmsd *= 4.0;
    }
    assert!(!found(&rested).is_empty(), "a contact, if there was no rest");
    let last = rested.last_mut().expect("a test");
    last.cycle_friction.iter_mut().filter(|of| of.cycle >= 5).for_each(|of| of.friction.minute += 20.0);
    assert_eq!(found(&rested), vec![]);
}

#[test]
fn what_stays_and_what_has_no_neighbours_is_no_contact() {
    let stays: Vec<(usize, u32, f64, f64)> = (4..=CYCLES).map(|cycle| (2, cycle, 30.0, 0.05)).collect();
    let ends: Vec<(usize, u32, f64, f64)> = (1..=4).map(|cycle| (2, cycle, 30.0, 0.05)).collect();
    for pushes in [&stays, &ends] {
        let history: Vec<RunSummary> =
            (0..10).map(|run| test(run, 3.0, if run == 9 { pushes } else { &[] })).collect();
        assert_eq!(found(&history), vec![]);
    }
    // the cycle before it is refused: the push may have been in both
    let mut history: Vec<RunSummary> =
        (0..10).map(|run| test(run, 3.0, if run == 9 { &[PUSH] } else { &[] })).collect();
    history[9].whole_cycle_rmsd.retain(|of| of.cycle != 4);
    assert_eq!(found(&history), vec![]);
}

/// Four years of daily tests.
#[test]
fn healthy_tests_have_no_contact() {
    let years = 4;
    let mut alarms = 0;
    for year in 0..years {
        let history: Vec<RunSummary> = (0..365).map(|day| test(1000 * year + day, 3.0, &[])).collect();
        alarms += found(&history).len();
    }
    assert!(alarms <= 1, "{alarms} in {years} years");
}

#[test]
fn a_push_is_told_one_cycle_after_it_while_the_test_is_written() {
    let complete: Vec<RunSummary> = (0..8).map(|run| test(run, 3.0, &[])).collect();
    let whole = test(8, 3.0, &[PUSH]);
    let settings = DetectSettings::default();
    let usual = UsualTests::new(&complete, JOINTS, &[], &settings);
    for cycles in 1..=CYCLES {
        let mut open = RunSummary { cycles, ..whole.clone() };
        open.cycle_friction.retain(|of| of.cycle <= cycles);
        open.whole_cycle_rmsd.retain(|of| of.cycle <= cycles);
        let found = detect_open(&usual, &[], &open, &settings);
        let shown: Vec<_> = found.iter().map(|of| (of.quantity, of.joint, of.onset.cycle)).collect();
        let wanted = if cycles > PUSH.1 {
            vec![(Quantity::Contact, Some(JointIndex::new(2)), Some(5))]
        } else {
            vec![]
        };
        assert_eq!(shown, wanted, "after cycle {cycles}: {found:#?}");
    }
}
