use super::*;
use crate::detect::runs::cause_tests::{State, alarms, fleet, only};
use crate::detect::runs::detect;
use crate::detect::runs::open_run::UsualTests;
use armwatch_model::anomaly::Knowledge;

/// Torque of all joints, Nm.
const TORQUE: f64 = 20.0;
/// First test of another unit, from 0.
const FIRST: usize = 8;
/// Changes of friction and noise with another unit, by joint, in logarithms.
const FRICTION: [f64; 6] = [0.30, -0.12, -0.35, 0.15, 0.02, 0.38];
const NOISE: [f64; 6] = [0.25, -0.20, 0.05, 0.30, -0.35, 0.15];

/// Daily tests of an arm with known torques. `differs` returns the changes of friction and noise in a test by joint, in
/// logarithms.
fn tests(runs: i64, seed: u64, differs: impl Fn(usize, usize) -> (f64, f64)) -> Vec<RunSummary> {
    let mut history = fleet(runs, seed, |_| State { noise: Some((0, 1.0)), ..State::default() });
    for (run, of) in history.iter_mut().enumerate() {
        for cycle in &mut of.cycle_friction {
            cycle.friction.ln_torque += differs(run, cycle.friction.joint.index()).0;
        }
        for (j, joint) in of.joints.iter_mut().enumerate() {
            let (friction, noise) = differs(run, j);
            joint.torque_rms = Some(TORQUE);
            joint.friction_index =
                joint.friction_index.map(|of| Estimate { value: of.value * friction.exp(), ..of });
            joint.relative_noise = joint.relative_noise.map(|of| of * noise.exp());
        }
    }
    history
}

fn other_unit(run: usize, joint: usize) -> (f64, f64) {
    if run >= FIRST { (FRICTION[joint], NOISE[joint]) } else { (0.0, 0.0) }
}

#[test]
fn another_unit_is_one_alarm_of_the_arm_from_its_first_test_on() {
    for seed in 1..=4 {
        let history = tests(18, seed, other_unit);
        for runs in FIRST + 1..=18 {
            let found = only(&history[..runs], AnomalyKind::Step, None);
            assert_eq!(found.quantity, Quantity::ArmIdentity, "seed {seed}, {runs} tests: {found:?}");
            let first = FIRST as i64 + 1;
            assert_eq!((found.first_run_id, found.last_run_id, found.ended), (first, runs as i64, false));
            let health = detect(&history[..runs], &DetectSettings::default()).health;
            let learns = health.iter().all(|of| of.knowledge == Knowledge::Learning);
            assert_eq!(learns, runs < FIRST + 5, "seed {seed}, {runs} tests: {health:?}");
        }
    }
}

#[test]
fn units_that_differ_in_friction_alone_are_found() {
    for seed in 1..=4 {
        let history = tests(12, seed, |run, joint| (other_unit(run, joint).0, 0.0));
        assert_eq!(only(&history, AnomalyKind::Step, None).quantity, Quantity::ArmIdentity);
    }
}

/// The index of the first test is uncertain: the arm differs from the one that the friction map is of.
#[test]
fn a_first_test_that_is_too_uncertain_belongs_to_the_unit_of_the_next() {
    for seed in 1..=4 {
        let mut history = tests(16, seed, other_unit);
        for of in &mut history[FIRST].joints {
            let uncertain = |of: Estimate| Estimate { value: of.value.sqrt(), std_error: 0.1 };
            of.friction_index = of.friction_index.map(uncertain);
        }
        for runs in FIRST + 2..=16 {
            let found = only(&history[..runs], AnomalyKind::Step, None);
            assert_eq!((found.quantity, found.first_run_id), (Quantity::ArmIdentity, FIRST as i64 + 1));
        }
    }
}

#[test]
fn wear_of_another_unit_is_found_against_its_own_level() {
    for seed in 1..=4 {
        let worn = |run: usize, joint: usize| {
            let (friction, noise) = other_unit(run, joint);
            let tests = if joint == 2 { run.saturating_sub(FIRST + 7) } else { 0 };
            (friction + 0.04 * tests as f64, noise)
        };
        let found = alarms(&tests(20, seed, worn));
        let of_joint = found.iter().find(|of| of.joint == Some(JointIndex::new(2)));
        assert!(of_joint.is_some_and(|of| of.kind == AnomalyKind::Drift && !of.ended), "{seed}: {found:#?}");
        assert_eq!(found.len(), 2, "and the arm's: {found:#?}");
    }
}

#[test]
fn a_test_that_is_still_written_is_compared_with_those_of_the_latest_unit() {
    let history = tests(15, 1, other_unit);
    let of = |runs: usize| {
        let usual = UsualTests::new(&history[..runs], 6, &[], &DetectSettings::default());
        usual.arm_run_ids().to_vec()
    };
    assert_eq!((of(FIRST), of(15)), (vec![1, 2, 3, 4, 5], vec![9, 10, 11, 12, 13]));
    let maintained = UsualTests::new(&history, 6, &[1; 6], &DetectSettings::default());
    assert!(maintained.arm_run_ids().is_empty());
}

#[test]
fn the_first_unit_continues_if_it_returns() {
    let swapped = |run: usize, joint: usize| match run {
        8 | 9 => other_unit(FIRST, joint),
        10.. if joint == 4 => (0.05 * (run - 9) as f64, 0.0),
        _ => (0.0, 0.0),
    };
    for seed in 1..=4 {
        let found = alarms(&tests(15, seed, swapped));
        let [of_joint, of_arm] = &found[..] else { panic!("seed {seed}: {found:#?}") };
        assert_eq!((of_joint.kind, of_joint.joint.map(JointIndex::number)), (AnomalyKind::Drift, Some(5)));
        assert_eq!((of_arm.quantity, of_arm.last_run_id, of_arm.ended), (Quantity::ArmIdentity, 10, true));
    }
}

#[test]
fn joints_that_change_together_keep_their_own_alarms() {
    for seed in 1..=4 {
        for worn in [&[1_usize][..], &[1, 4], &[0, 2, 5]] {
            for wear in [|_: usize| 1.0, |run: usize| 0.15 * (run - FIRST + 1) as f64] {
                let history = tests(14, seed, |run, joint| match worn.contains(&joint) && run >= FIRST {
                    true => (wear(run) * FRICTION[joint].abs().max(0.2), 0.0),
                    false => (0.0, 0.0),
                });
                let found = alarms(&history);
                let joints: Vec<usize> = found.iter().filter_map(|of| Some(of.joint?.index())).collect();
                assert!(worn.iter().all(|of| joints.contains(of)), "seed {seed}: {found:#?}");
                assert!(found.iter().all(|of| of.quantity != Quantity::ArmIdentity), "{found:#?}");
            }
        }
    }
}

/// Another lubricant changes friction of all joints, of one by twice as much as of another.
#[test]
fn a_change_that_all_joints_share_is_no_other_unit() {
    for seed in 1..=4 {
        for size in [0.3, -0.25] {
            let share = [1.0, 0.7, 1.3, 0.9, 1.1, 0.6];
            let history = tests(
                14,
                seed,
                |run, joint| if run >= FIRST { (size * share[joint], 0.0) } else { (0.0, 0.0) },
            );
            let found = detect(&history, &DetectSettings::default()).anomalies;
            assert!(found.iter().all(|of| of.quantity != Quantity::ArmIdentity), "{found:#?}");
        }
    }
}
