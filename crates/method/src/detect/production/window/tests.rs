//! Windows of long production: the same result for any order of arrival, and one anomaly for a lasting fault.

use std::collections::BTreeSet;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::work_logs;
use crate::detect::production::fixtures::{USUAL, detected, history, wobble};
use crate::detect::window::fixtures::{Judged, WithRuns, said, words};
use crate::detect::window::{Lengths, is_over, next};
use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{Anomaly, AnomalyKind, ProductionSummary};

/// Windows so short that histories of some hundred logs have several.
const SHORT: Lengths = Lengths { step: 40, lead: 20, head: 6, around: 8 };

impl Judged for ProductionSummary {
    fn moment_of(&self) -> Moment {
        (self.started_at, self.run_id)
    }

    fn found(window: &[Self]) -> Vec<Anomaly> {
        detected(window)
    }

    fn as_windowed<T>(window: &[Self], with: impl WithRuns<T>) -> T {
        with.call(&work_logs(window))
    }
}

/// Production of a robot with two periods of wear, another load, and a joint that is off in one log.
fn life(logs: usize) -> Vec<ProductionSummary> {
    history(logs, |i, j| {
        let worn = j == 1 && ((30..45).contains(&i) || (100..170).contains(&i));
        let off = if j == 2 && i == 77 { 0.4 } else { USUAL };
        let load = if (120..140).contains(&i) { 0.08 } else { 0.0 };
        (wobble(i, j) + if worn { 0.4 } else { 0.0 }, off + load)
    })
}

#[test]
fn logs_of_less_than_two_steps_say_what_the_whole_says() {
    let history = life(79);
    let found = detected(&history);
    let short = said(&history, Vec::new(), &SHORT);
    assert!(short.settled.is_empty() && found.len() > 1);
    assert_eq!(format!("{:?}", short.others), format!("{found:?}"));
}

#[test]
fn whatever_came_when_the_same_is_settled() {
    let history = life(240);
    let mut compared = 0;
    for seed in 0..3 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut order: Vec<usize> = (0..history.len()).collect();
        match seed {
            0 => {}
            1 => (0..12).for_each(|_| {
                let log = order.remove(rng.random_range(0..order.len()));
                order.insert(rng.random_range(0..order.len()), log);
            }),
            _ => order.shuffle(&mut rng),
        }
        let mut there = BTreeSet::new();
        let mut known: Vec<(Settled, Vec<Anomaly>)> = Vec::new();
        for (step, place) in order.iter().enumerate() {
            there.insert(*place);
            known.retain(|(settled, _)| settled.follows_until < Some(history[*place].moment_of()));
            if step % 9 != 8 && step + 1 < order.len() {
                continue;
            }
            let so_far: Vec<ProductionSummary> = there.iter().map(|&place| history[place].clone()).collect();
            let from_what_was_settled = said(&so_far, std::mem::take(&mut known), &SHORT);
            let at_once = said(&so_far, Vec::new(), &SHORT);
            assert_eq!(format!("{:?}", at_once.settled), format!("{:?}", from_what_was_settled.settled));
            assert_eq!(words(&at_once.all()), words(&from_what_was_settled.all()), "seed {seed}, {step}");
            compared += at_once.settled.len();
            known = from_what_was_settled.settled;
        }
        assert_eq!(known.len(), 5);
    }
    assert!(compared > 40, "{compared}");
}

#[test]
fn windows_find_what_the_whole_finds() {
    // a boundary may change a learnt scatter, but not clear results
    let history = life(240);
    let of = |all: &[&Anomaly]| -> Vec<_> {
        let mut found: Vec<_> =
            all.iter().map(|of| (of.joint, of.kind, of.first_run_id, of.last_run_id, of.ended)).collect();
        found.sort_unstable();
        found
    };
    let whole = detected(&history);
    let windows = said(&history, Vec::new(), &SHORT);
    assert_eq!(windows.settled.len(), 5);
    assert_eq!(of(&windows.all()), of(&whole.iter().collect::<Vec<_>>()));
    assert!(windows.longest <= 2 * 40 + 20 + 24 * 6, "{}", windows.longest);
}

#[test]
fn wear_behind_one_test_of_long_ago_is_one_anomaly_and_goes_on() {
    // no test after the first one: the level depends on logs that every later window has to read
    let mut history = history(400, |i, j| (wobble(i, j) + if j == 1 && i >= 60 { 0.5 } else { 0.0 }, USUAL));
    history.iter_mut().for_each(|log| log.reference_run_id = 1000);
    let mut known = Vec::new();
    for logs in (70..=400).step_by(11) {
        let now = said(&history[..logs], std::mem::take(&mut known), &SHORT);
        let all = now.all();
        let [wear] = all[..] else { panic!("one after {logs} logs: {all:?}") };
        assert_eq!((wear.kind, wear.ended, wear.last_run_id), (AnomalyKind::Drift, false, logs as i64));
        assert!((61..=64).contains(&wear.first_run_id), "{wear:?}");
        known = now.settled;
    }
    assert_eq!(known.len(), 9);
}

#[test]
fn a_log_against_two_tests_is_one_run() {
    let mut history = history(200, |i, j| (wobble(i, j), USUAL));
    // every tenth log spans the test after it
    let twice: Vec<ProductionSummary> = history.iter().skip(9).step_by(10).cloned().collect();
    for mut of in twice {
        of.reference_run_id += 1;
        let behind = history.iter().position(|log| log.run_id > of.run_id).unwrap_or(history.len());
        history.insert(behind, of);
    }
    assert_eq!((history.len(), work_logs(&history).len()), (220, 200));
    let all = work_logs(&history);
    let settled = Settled::default();
    assert!(is_over(&settled, &all[..80], &SHORT) && !is_over(&settled, &all[..79], &SHORT));
    let (next, _) = next(&settled, &all[..80], &[], &SHORT);
    assert_eq!((next.runs, next.leads_from.map(|(_, run_id)| run_id)), (40, Some(21)));
    // the first logs after each of the three tests before the lead-in
    assert_eq!(next.read, [1, 2, 3, 4, 5, 6, 10, 11, 12, 13, 14, 15, 20]);
}
