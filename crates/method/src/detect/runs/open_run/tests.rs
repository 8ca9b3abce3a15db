use super::*;
use crate::detect::runs::cause_tests::{CYCLES, JOINTS, State, fleet};

/// The first cycles of a test: its friction curve, and its means with the error of so few cycles.
fn cut(run: &RunSummary, cycles: u32) -> RunSummary {
    let mut run = run.clone();
    run.cycles = cycles;
    run.cycle_friction.retain(|of| of.cycle <= cycles);
    run.parameters.iter_mut().for_each(|of| of.cycles = cycles);
    run
}

/// Anomalies in the last test of a history after each of its cycles, from the first on.
fn by_cycle(history: &[RunSummary]) -> Vec<Vec<Anomaly>> {
    let (open, complete) = history.split_last().expect("a test");
    let settings = DetectSettings::default();
    let usual = UsualTests::new(complete, JOINTS, &[], &settings);
    let of_arm = || complete.iter().filter(|run| usual.arm_run_ids().contains(&run.run_id));
    (1..=CYCLES)
        .map(|cycles| {
            let first: Vec<RunSummary> = of_arm().map(|run| cut(run, cycles)).collect();
            detect_open(&usual, &first, &cut(open, cycles), &settings)
        })
        .collect()
}

#[test]
fn healthy_tests_raise_nothing_after_any_cycle() {
    for seed in 1..=6 {
        let season = |run: i64| State { hall: 0.06 * (run as f64 / 9.0).sin(), ..State::default() };
        let history = fleet(20, seed, season);
        for runs in [1, 2, 3, 6, 12, 20] {
            assert_eq!(by_cycle(&history[..runs]), vec![vec![]; CYCLES as usize], "seed {seed}, {runs} runs");
        }
    }
}

#[test]
fn a_step_is_found_one_cycle_after_the_one_with_which_it_came() {
    let at_3 = |joint: usize, cycle: u32| if joint == 1 && cycle >= 3 { 0.22 } else { 0.0 };
    let at_5 = |joint: usize, cycle: u32| if joint == 1 && cycle >= 5 { 0.22 } else { 0.0 };
    for (step, friction) in [(3, at_3 as fn(usize, u32) -> f64), (5, at_5)] {
        for seed in 1..=4 {
            let state = |run: i64| State { friction: (run == 8).then_some(friction), ..State::default() };
            let found = by_cycle(&fleet(9, seed, state));
            for (cycle, found) in (1..).zip(found) {
                let shown: Vec<_> = found
                    .iter()
                    .map(|of| (of.kind, of.joint.map(JointIndex::number), of.onset.cycle, of.severity))
                    .collect();
                let wanted = (AnomalyKind::Step, Some(2), Some(step), Severity::Critical);
                let wanted = if cycle > step { vec![wanted] } else { vec![] };
                assert_eq!(shown, wanted, "seed {seed}, step {step}, cycle {cycle}: {found:#?}");
                assert!(found.iter().all(|of| of.odds.is_some_and(|odds| odds > 1000.0)), "{found:#?}");
                assert!(found.iter().all(|of| of.message.contains("still being written")), "{found:#?}");
            }
        }
    }
}

#[test]
fn in_the_first_test_of_a_robot_a_step_waits_for_a_curve() {
    let step = |joint: usize, cycle: u32| if joint == 4 && cycle >= 5 { 0.22 } else { 0.0 };
    let state = |_: i64| State { friction: Some(step), ..State::default() };
    let found = by_cycle(&fleet(1, 3, state));
    let first = found.iter().position(|found| !found.is_empty());
    assert!(first.is_some_and(|place| (5..7).contains(&place)), "{first:?}");
    let [step] = &found[7][..] else { panic!("one: {:#?}", found[7]) };
    assert_eq!(
        (step.kind, step.joint, step.onset.cycle),
        (AnomalyKind::Step, Some(JointIndex::new(4)), Some(5))
    );
}

#[test]
fn one_odd_cycle_is_no_step() {
    let odd = |joint: usize, cycle: u32| if joint == 1 && cycle == 4 { 0.22 } else { 0.0 };
    let state = |run: i64| State { friction: (run == 8).then_some(odd), ..State::default() };
    for found in by_cycle(&fleet(9, 2, state)) {
        assert!(found.iter().all(|of| of.kind != AnomalyKind::Step), "{found:#?}");
    }
}

#[test]
fn a_joint_that_swings_a_load_and_a_wrong_signal_are_found_in_the_first_cycles() {
    let swing = |run: i64| State { swing: (run == 8).then_some((4, 0.12)), ..State::default() };
    let load = |run: i64| State { mass: if run == 8 { 0.8 } else { 0.0 }, ..State::default() };
    let offset = |run: i64| State { offset: (run == 8).then_some((1, 1.1)), ..State::default() };
    let first = |history: &[RunSummary], kind: AnomalyKind, joint: Option<usize>| {
        let found = by_cycle(history);
        let cycle = found.iter().position(|found| !found.is_empty());
        for of in found.iter().flatten() {
            assert_eq!((of.kind, of.joint.map(JointIndex::number)), (kind, joint), "{of:#?}");
        }
        cycle.map(|place| place + 1)
    };
    let swings = first(&fleet(9, 2, swing), AnomalyKind::Oscillation, Some(5));
    assert!(swings.is_some_and(|cycle| (7..=8).contains(&cycle)), "{swings:?}");
    assert_eq!(first(&fleet(9, 7, load), AnomalyKind::Payload, None), Some(3));
    assert_eq!(first(&fleet(9, 8, offset), AnomalyKind::Sensor, Some(2)), Some(3));
}

#[test]
fn a_joint_with_a_new_baseline_is_compared_with_its_own_tests_alone() {
    let worn = |joint: usize, _: u32| if joint == 1 { 0.3 } else { 0.0 };
    let state = |run: i64| State { friction: (run >= 6).then_some(worn), ..State::default() };
    let mut history = fleet(8, 2, state);
    for run in &mut history[6..] {
        run.epochs = vec![0, 1, 0, 0, 0, 0];
    }
    let settings = DetectSettings::default();
    let usual = UsualTests::new(&history[..7], JOINTS, &[0, 1, 0, 0, 0, 0], &settings);
    assert_eq!(usual.arm_run_ids(), [history[6].run_id]);
    assert_eq!(detect_open(&usual, &[], &cut(&history[7], 8), &settings), vec![]);
}
