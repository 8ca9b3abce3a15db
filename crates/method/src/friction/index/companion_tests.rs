//! Tests of a new baseline of one joint, with the other joints' held maps as companions.

use super::baseline::fit_maps;
use super::held_map::HeldMap;
use super::simulated_arm::{Arm, BASELINE, HOUR, JOINTS};
use super::{ReferenceMap, run_indices};
use armwatch_model::anomaly::baseline_runs::learnt_runs;
use armwatch_model::robot::JointIndex;

const REPAIRED: usize = 2;
/// Relative change of friction from the old to the new gearbox.
const CHANGE: f64 = -0.2;
const BEFORE: usize = 10;

/// Ten tests at the usual ambient temperature, five with a new gearbox in a warm season, one in a cold season.
fn history(seed: u64, warm: f64, cold: f64) -> Arm {
    let mut arm = Arm::unlike(seed);
    arm.go_on(BEFORE, 1.5, [0.0; JOINTS]);
    let mut wear = [0.0; JOINTS];
    wear[REPAIRED] = CHANGE;
    for hall in [warm; BASELINE].into_iter().chain([cold]) {
        arm.rest(14.0 * HOUR, hall);
        arm.run(hall, wear);
    }
    arm
}

/// Index minus one of the repaired joint in the last run, with or without companions, and those of the others.
fn last_changes(arm: &Arm, with_companions: bool) -> (f64, Vec<f64>) {
    let others: Vec<JointIndex> = (0..JOINTS).filter(|j| *j != REPAIRED).map(JointIndex::new).collect();
    let first: Vec<usize> = learnt_runs(&(0..BEFORE).collect::<Vec<usize>>(), BASELINE);
    let held = fit_maps(&others, &[], &arm.runs[..BEFORE], &first, BASELINE).maps;
    let companions: Vec<&HeldMap> = if with_companions { held.iter().collect() } else { Vec::new() };
    let after: Vec<usize> = (BEFORE..BEFORE + BASELINE).collect();
    let runs = &arm.runs[..BEFORE + BASELINE];
    let new = fit_maps(&[JointIndex::new(REPAIRED)], &companions, runs, &after, BASELINE).maps;
    let references: Vec<ReferenceMap<'_>> =
        held.iter().chain(&new).map(|held| ReferenceMap { held, in_baseline: false }).collect();
    let last = arm.runs.len() - 1;
    let found = run_indices(&references, &arm.runs[..last], &arm.runs[last]);
    let change = |j: JointIndex| found.iter().find(|of| of.joint == j).expect("an index").index.value - 1.0;
    (change(JointIndex::new(REPAIRED)), others.into_iter().map(change).collect())
}

#[test]
fn after_a_repair_in_a_warm_season_the_next_cold_one_is_not_taken_for_wear() {
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for seed in 400..403 {
        let arm = history(seed, 4.0, -4.0);
        let (change, others) = last_changes(&arm, true);
        assert!(others.iter().all(|change| change.abs() < 0.025), "seed {seed}: {others:?}");
        with.push(change);
        without.push(last_changes(&arm, false).0);
    }
    let worst = |of: &[f64]| of.iter().fold(0.0, |worst: f64, change| worst.max(change.abs()));
    println!("repaired joint: {with:.4?} with companions, {without:.4?} without");
    assert!(worst(&with) < 0.025, "{with:?}");
    // a small gain in this season, and never worse
    assert!(with.iter().zip(&without).all(|(with, without)| with.abs() <= without.abs()), "{without:?}");
}
