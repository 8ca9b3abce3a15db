//! Windows of a long history: the same result for any order of arrival, and one anomaly for a lasting fault.

use std::collections::BTreeSet;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::detect::runs::cause_tests::{State, fleet};
use crate::detect::runs::detect;
use crate::detect::runs::kept_tests::life;
use crate::detect::window::Lengths;
use crate::detect::window::fixtures::{Judged, Said, WithRuns, said, words};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{Anomaly, AnomalyKind, RunSummary};
use armwatch_model::robot::JointIndex;

/// Windows so short that histories of some hundred tests have several.
const SHORT: Lengths = Lengths { step: 40, lead: 24, head: 24, around: 16 };

impl Judged for RunSummary {
    fn moment_of(&self) -> Moment {
        (self.started_at, self.run_id)
    }

    fn found(window: &[Self]) -> Vec<Anomaly> {
        detect(window, &DetectSettings::default()).anomalies
    }

    fn as_windowed<T>(window: &[Self], with: impl WithRuns<T>) -> T {
        with.call(window)
    }
}

#[test]
fn a_history_of_less_than_two_steps_says_what_the_whole_says() {
    for seed in 0..3 {
        let history = life(seed, 79);
        let found = detect(&history, &DetectSettings::default()).anomalies;
        let short = said(&history, Vec::new(), &SHORT);
        assert!(short.settled.is_empty() && !found.is_empty());
        assert_eq!(format!("{:?}", short.others), format!("{found:?}"));
    }
    let usual = Lengths::OF_TESTS;
    assert!(usual.lead <= usual.step && 2 * usual.step == 1000);
}

#[test]
fn whatever_came_when_the_same_is_settled() {
    let mut compared = 0;
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let history = life(seed, 200);
        let mut order: Vec<usize> = (0..history.len()).collect();
        match seed {
            0 => {}
            // most in order, some late
            1 | 2 => (0..12).for_each(|_| {
                let test = order.remove(rng.random_range(0..order.len()));
                order.insert(rng.random_range(0..order.len()), test);
            }),
            _ => order.shuffle(&mut rng),
        }
        let mut there = BTreeSet::new();
        let mut known: Vec<(Settled, Vec<Anomaly>)> = Vec::new();
        for (step, place) in order.iter().enumerate() {
            there.insert(*place);
            let moment = |place: usize| (history[place].started_at, history[place].run_id);
            known.retain(|(settled, _)| settled.follows_until < Some(moment(*place)));
            if rng.random_bool(0.03) {
                // one is removed, and may arrive again later
                let gone = there.iter().copied().nth(rng.random_range(0..there.len())).expect("a test");
                there.remove(&gone);
                known.retain(|(settled, _)| settled.follows_until < Some(moment(gone)));
            }
            if step % 13 != 12 && step + 1 < order.len() {
                continue;
            }
            let so_far: Vec<RunSummary> = there.iter().map(|&place| history[place].clone()).collect();
            let from_what_was_settled = said(&so_far, std::mem::take(&mut known), &SHORT);
            if step % 39 == 38 || step + 1 == order.len() {
                let at_once = said(&so_far, Vec::new(), &SHORT);
                assert_eq!(format!("{:?}", at_once.settled), format!("{:?}", from_what_was_settled.settled));
                assert_eq!(words(&at_once.all()), words(&from_what_was_settled.all()), "seed {seed}, {step}");
                compared += at_once.settled.len();
            }
            known = from_what_was_settled.settled;
        }
    }
    assert!(compared > 20, "{compared}");
}

#[test]
fn a_late_test_changes_what_it_would_have_changed_in_time() {
    // the second of two tests that show a load arrives late
    let state =
        |run: i64| State { mass: if (60..62).contains(&run) { 0.8 } else { 0.0 }, ..State::default() };
    let whole = fleet(200, 3, state);
    let mut without = whole.clone();
    let late = without.remove(61);
    let of = |said: &Said| -> Vec<(i64, i64)> {
        let loads = said.all().into_iter().filter(|of| of.kind == AnomalyKind::Payload);
        loads.map(|of| (of.first_run_id, of.last_run_id)).collect()
    };
    let before = said(&without, Vec::new(), &SHORT);
    assert_eq!(of(&before), [(61, 61)]);
    let mut known = before.settled;
    known.retain(|(settled, _)| settled.follows_until < Some((late.started_at, late.run_id)));
    assert!(known.len() < 2, "nothing that follows from tests behind it holds");
    let after = said(&whole, known, &SHORT);
    assert_eq!(of(&after), [(61, 62)]);
}

/// Friction of a joint that swings from cycle to cycle.
fn swinging(joint: usize, cycle: u32) -> f64 {
    if joint == 4 { 0.10 * f64::from(cycle * 7 % 5) - 0.2 } else { 0.0 }
}

/// Kind, joint, first and last test.
fn spans(of: &[&Anomaly]) -> Vec<(AnomalyKind, Option<JointIndex>, i64, i64)> {
    of.iter().map(|of| (of.kind, of.joint, of.first_run_id, of.last_run_id)).collect()
}

#[test]
fn a_fault_that_stays_is_one_anomaly_over_all_boundaries() {
    type Fault = fn(State) -> State;
    let faults: [(AnomalyKind, Fault); 4] = [
        (AnomalyKind::Step, |of| State {
            friction: Some(|joint, _| if joint == 2 { 0.2 } else { 0.0 }),
            ..of
        }),
        (AnomalyKind::Payload, |of| State { mass: 0.8, ..of }),
        (AnomalyKind::Oscillation, |of| State { friction: Some(swinging), ..of }),
        (AnomalyKind::Sensor, |of| State { offset: Some((1, 1.1)), ..of }),
    ];
    for (kind, fault) in faults {
        let history = fleet(290, 5, |run| match run >= 50 {
            true => fault(State::default()),
            false => State::default(),
        });
        let mut known = Vec::new();
        let mut first = BTreeSet::new();
        for tests in (52..=290).step_by(17) {
            let now = said(&history[..tests], std::mem::take(&mut known), &SHORT);
            let of_kind: Vec<&Anomaly> = now.all().into_iter().filter(|of| of.kind == kind).collect();
            let [of] = of_kind[..] else {
                panic!("{kind}: one after {tests} tests: {:?}", spans(&now.all()))
            };
            assert!(!of.ended && of.last_run_id == tests as i64, "{kind} after {tests} tests: {of:?}");
            first.insert((of.first_run_id, of.onset.run_id));
            known = now.settled;
        }
        assert_eq!(known.len(), 6);
        assert_eq!(first.len(), 1, "{kind} begins at {first:?}");
    }
}

#[test]
fn what_has_ended_stays_as_it_is() {
    let state =
        |run: i64| State { mass: if (20..30).contains(&run) { 0.8 } else { 0.0 }, ..State::default() };
    let history = fleet(280, 4, state);
    let mut known = Vec::new();
    let mut seen = BTreeSet::new();
    for tests in (33..=280).step_by(19) {
        let now = said(&history[..tests], std::mem::take(&mut known), &SHORT);
        let loads: Vec<&Anomaly> =
            now.all().into_iter().filter(|of| of.kind == AnomalyKind::Payload).collect();
        assert_eq!(loads.len(), 1, "after {tests} tests: {loads:?}");
        seen.insert(format!("{:?}", loads[0]));
        known = now.settled;
    }
    assert_eq!(seen.len(), 1, "{seen:#?}");
}

#[test]
fn work_on_the_arm_ends_what_was_open_and_windows_stay_short() {
    let state =
        |run: i64| State { mass: if (30..150).contains(&run) { 0.8 } else { 0.0 }, ..State::default() };
    let mut history = fleet(520, 6, state);
    for run in &mut history[150..] {
        run.epochs = vec![1; 6];
    }
    let now = said(&history, Vec::new(), &SHORT);
    let loads: Vec<&Anomaly> = now.all().into_iter().filter(|of| of.kind == AnomalyKind::Payload).collect();
    assert_eq!(loads.len(), 1, "{loads:?}");
    assert_eq!((loads[0].first_run_id, loads[0].last_run_id, loads[0].ended), (31, 150, true));
    // number of tests for the detectors, of 520 as of 120
    let short = said(&history[..120], Vec::new(), &SHORT);
    assert!(short.longest >= 80 && now.longest <= 80 + 24 + 2 * 24 + 33 + 6, "{} of 520", now.longest);
    // of each joint and epoch
    let (settled, _) = now.settled.last().expect("something settled");
    assert_eq!((settled.runs, &settled.epochs[..]), (480, &[2; 6][..]));
    assert_eq!(settled.first_of_epochs, [151]);
}
