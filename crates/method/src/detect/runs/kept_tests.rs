//! Kept judgements change no finding, in any order of arrival, and few are computed again.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::cause_tests::{CYCLES, JOINTS, State, fleet};
use super::detect_with;
use super::judgement::Kept;
use crate::detect::runs::detect;
use armwatch_model::analysis::measurements::CycleRmsd;
use armwatch_model::analysis::response::{ChannelFault, ChannelResponse, FaultResponse};
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Findings, RunSummary};
use armwatch_model::robot::{JointIndex, ParameterId};

const METHOD: u64 = 7;

/// Bytes of the judgements of each test, by its key.
type Bytes = BTreeMap<i64, Vec<u8>>;

/// Findings with these judgements, which are updated, and the number of tests that were evaluated again.
fn with_kept(history: &[RunSummary], bytes: &mut Bytes, settings: &DetectSettings) -> (Findings, usize) {
    let kept = Kept::new(METHOD, bytes.iter().map(|(run_id, of)| (*run_id, &of[..])));
    let (findings, judged) = detect_with(history, &[], settings, &kept);
    bytes.extend(judged.changed(&kept));
    (findings, judged.recomputed)
}

/// Findings as text: a test without result has NaN values, which equal nothing.
fn said(findings: &Findings) -> Vec<String> {
    let anomalies = findings.anomalies.iter().map(|of| format!("{of:?}"));
    let health = findings.health.iter().map(|of| format!("{of:?}"));
    anomalies.chain(health).chain([format!("{:?}", findings.expected_by)]).collect()
}

/// Effects of faults on the parameters: a gain moves those of the same joint, a position offset moves all slightly.
fn response(run: &RunSummary) -> Arc<ChannelResponse> {
    let parameters: Vec<ParameterId> = run.parameters.iter().map(|of| of.id).collect();
    let faults = (0..JOINTS).flat_map(|j| {
        let of = |fault, own: f64, others: f64| FaultResponse {
            joint: JointIndex::new(j),
            fault,
            strength: 0,
            shift: Vec::new(),
            change: parameters.iter().map(|id| if id.joint.index() == j { own } else { others }).collect(),
            unexplained: vec![0.1; JOINTS],
        };
        [
            of(ChannelFault::TorqueGain, 1.0, 0.0),
            of(ChannelFault::PositionOffset, 0.7, 0.2 * (j as f64 - 2.5)),
        ]
    });
    Arc::new(ChannelResponse { faults: faults.collect(), parameters: parameters.clone() })
}

/// A history with faults of all kinds, short checks, contacts and maintenance.
pub(super) fn life(seed: u64, tests: i64) -> Vec<RunSummary> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let begin: Vec<i64> = (0..10).map(|_| rng.random_range(3..tests)).collect();
    let lasts: Vec<i64> = (0..10).map(|_| rng.random_range(1..12)).collect();
    let is_in = |fault: usize, run: i64| (begin[fault]..begin[fault] + lasts[fault]).contains(&run);
    // joints that swing together, and one with a step
    let swing: fn(usize, u32) -> f64 = |joint, cycle| match joint {
        2 => 0.10 * f64::from(cycle * 7 % 5) - 0.2,
        3 => 0.07 * f64::from(cycle * 7 % 5) - 0.14,
        _ => 0.0,
    };
    let step: fn(usize, u32) -> f64 = |joint, cycle| if joint == 1 && cycle > 4 { 0.2 } else { 0.0 };
    let state = |run: i64| State {
        friction: if is_in(0, run) { Some(swing) } else { is_in(1, run).then_some(step) },
        swing: is_in(2, run).then_some((4, 0.08)),
        slower: is_in(3, run).then_some((0, 2.0)),
        lubricant: is_in(9, run).then_some(1.7),
        offset: is_in(4, run).then_some((1, 1.1)),
        unexplained: is_in(5, run).then_some((3, 4.0)),
        noise: seed.is_multiple_of(2).then_some((4, if is_in(7, run) { 2.0 } else { 1.0 })),
        mass: if is_in(6, run) { 0.8 } else { 0.0 },
        hall: if is_in(7, run) { 0.1 } else { 0.0 },
    };
    let mut history = fleet(tests, seed, state);
    let gain = rng.random_range(0..JOINTS);
    for (place, run) in history.iter_mut().enumerate() {
        let pushed = rng.random_bool(0.08).then(|| (rng.random_range(2..8_u32), rng.random_range(0..JOINTS)));
        for cycle in 1..=CYCLES {
            for j in 0..JOINTS {
                let cold = if cycle == 1 { 0.5 } else { 0.0 };
                let push = if pushed == Some((cycle, j)) { 1.5 } else { 0.0 };
                let relative_rmsd = 0.05 * (1.0 + cold + push + 0.05 * rng.random_range(-1.0..1.0));
                run.whole_cycle_rmsd.push(CycleRmsd { cycle, joint: JointIndex::new(j), relative_rmsd });
            }
        }
        // a gain that single tests hardly show
        if is_in(8, place as i64) {
            let own = run.parameters.iter_mut().filter(|of| of.id.joint.index() == gain);
            own.for_each(|of| of.mean *= 1.006);
        }
        if rng.random_bool(0.15) {
            let cycles = rng.random_range(1..6);
            run.cycles = cycles;
            run.cycle_friction.retain(|of| of.cycle <= cycles);
            run.whole_cycle_rmsd.retain(|of| of.cycle <= cycles);
            run.parameters.iter_mut().for_each(|of| of.cycles = cycles);
        }
        if rng.random_bool(0.05) {
            (run.cycle_friction, run.whole_cycle_rmsd, run.parameters) = Default::default();
        }
        run.response = rng.random_bool(0.7).then(|| response(run));
    }
    maintained(&mut history, &mut rng);
    history
}

/// Maintenance of the arm or of one joint, on some days.
fn maintained(history: &mut [RunSummary], rng: &mut ChaCha8Rng) {
    let count = history.len();
    for _ in 0..rng.random_range(0..3) {
        let (from, joint) = (rng.random_range(0..count), rng.random_range(0..2 * JOINTS));
        for run in &mut history[from..] {
            run.epochs.resize(JOINTS, 0);
            for (j, epoch) in run.epochs.iter_mut().enumerate() {
                *epoch += u32::from(joint >= JOINTS || j == joint);
            }
        }
    }
}

#[test]
fn kept_judgements_change_no_finding_whatever_arrives_when() {
    let (mut kinds, mut checked) = (BTreeSet::new(), 0);
    for seed in 0..8 {
        let mut rng = ChaCha8Rng::seed_from_u64(900 + seed);
        let all = life(seed, 44);
        let mut order: Vec<usize> = (0..all.len()).collect();
        if seed % 3 > 0 {
            order.shuffle(&mut rng);
        }
        let (mut kept, mut arrived) = (Bytes::new(), BTreeSet::new());
        let mut settings = DetectSettings::default();
        let mut history = all.clone();
        for (step, place) in order.into_iter().enumerate() {
            arrived.insert(place);
            if rng.random_bool(0.1) {
                // one is deleted, and may arrive again
                let gone = arrived.iter().copied().nth(rng.random_range(0..arrived.len()));
                if let Some(gone) = gone {
                    arrived.remove(&gone);
                }
            }
            if rng.random_bool(0.05) {
                maintained(&mut history, &mut rng);
            }
            if rng.random_bool(0.05) {
                settings.false_alarms_per_robot_year = rng.random_range(0.05..50.0);
            }
            // batches, like a conclusion after several tests
            if step % 6 != 5 && step + 1 < all.len() {
                continue;
            }
            let whole: Vec<RunSummary> = arrived.iter().map(|&place| history[place].clone()).collect();
            let expected = detect(&whole, &settings);
            kinds.extend(expected.anomalies.iter().map(|of| of.kind));
            let (found, _) = with_kept(&whole, &mut kept, &settings);
            assert_eq!(said(&found), said(&expected), "seed {seed}, step {step}");
            checked += 1;
        }
        // all at once, without kept judgements
        let (found, _) = with_kept(&history, &mut Bytes::new(), &settings);
        assert_eq!(said(&found), said(&detect(&history, &settings)), "seed {seed}");
    }
    println!("{checked} histories with {kinds:?}");
    assert!(kinds.len() >= 5 && checked > 50, "{checked} histories with {kinds:?}");
}

#[test]
fn one_more_test_is_judged_alone() {
    let settings = DetectSettings::default();
    let history = fleet(120, 5, |_| State::default());
    let mut kept = Bytes::new();
    assert_eq!(with_kept(&history[..119], &mut kept, &settings).1, 119);
    let (found, recomputed) = with_kept(&history, &mut kept, &settings);
    assert_eq!(said(&found), said(&detect(&history, &settings)));
    assert_eq!(recomputed, 1);
    assert_eq!(with_kept(&history, &mut kept, &settings).1, 0);
}

#[test]
fn judgements_of_other_cycles_or_of_another_method_do_not_hold() {
    let settings = DetectSettings::default();
    let step: fn(usize, u32) -> f64 = |joint, cycle| if joint == 1 && cycle > 4 { 0.2 } else { 0.0 };
    let of = |stepped: i64| {
        fleet(30, 5, |run| State { friction: (run == stepped).then_some(step), ..State::default() })
    };
    let (healthy, stepped) = (of(-1), of(20));
    let mut kept = Bytes::new();
    with_kept(&healthy, &mut kept, &settings);
    let (found, recomputed) = with_kept(&stepped, &mut kept.clone(), &settings);
    assert!(recomputed > 0 && !found.anomalies.is_empty());
    assert_eq!(said(&found), said(&detect(&stepped, &settings)));
    let of_other = Kept::new(METHOD + 1, kept.iter().map(|(run_id, of)| (*run_id, &of[..])));
    assert_eq!(detect_with(&healthy, &[], &settings, &of_other).1.recomputed, 30);
    // truncated bytes count as none
    let cut = Kept::new(METHOD, kept.iter().map(|(run_id, of)| (*run_id, &of[..of.len() / 2])));
    assert_eq!(detect_with(&healthy, &[], &settings, &cut).1.recomputed, 30);
}
