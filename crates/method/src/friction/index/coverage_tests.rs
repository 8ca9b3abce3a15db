//! Tests of the coverage of the index's intervals, over histories of different arms.

use super::simulated_arm::{Arm, BASELINE, JOINTS};
use crate::statistics::distributions::normal_quantile;

/// Result of a series of histories.
#[derive(Default)]
struct Coverage {
    inside: usize,
    count: usize,
    squares: f64,
}

impl Coverage {
    fn add(&mut self, error: f64, std_error: f64) {
        let z = error / std_error;
        self.inside += usize::from(z.abs() < normal_quantile(0.975));
        self.count += 1;
        self.squares += z * z;
    }

    fn join(&mut self, other: &Self) {
        self.inside += other.inside;
        self.count += other.count;
        self.squares += other.squares;
    }

    /// Share of the intervals that contain the truth, and true over stated error.
    fn result(&self) -> (f64, f64) {
        let count = self.count as f64;
        (self.inside as f64 / count, (self.squares / count).sqrt())
    }
}

fn tally(seeds: std::ops::Range<u64>, runs: usize, spread: f64, wear: f64) -> [Coverage; 2] {
    let [mut worn, mut healthy] = <[Coverage; 2]>::default();
    for seed in seeds {
        let mut arm = Arm::unlike(seed);
        arm.go_on(runs - 4, spread, [0.0; JOINTS]);
        let mut by_joint = [0.0; JOINTS];
        let of = usize::try_from(seed).expect("small") % JOINTS;
        by_joint[of] = wear;
        arm.go_on(4, spread, by_joint);
        let found = arm.friction();
        for (run, indices) in found.indices.iter().enumerate().skip(BASELINE) {
            for index in indices {
                let j = index.joint.index();
                let is_worn = j == of && run >= runs - 4;
                let truth = 1.0 + if is_worn { wear } else { 0.0 };
                let tally = if is_worn { &mut worn } else { &mut healthy };
                tally.add(index.index.value - truth, index.index.std_error);
            }
        }
    }
    [worn, healthy]
}

/// Short runs at the end of a history, with one worn joint.
fn short(seeds: std::ops::Range<u64>, cycles: usize) -> (Coverage, f64) {
    let (mut tally, mut errors) = (Coverage::default(), 0.0);
    for seed in seeds {
        let mut arm = Arm::unlike(seed);
        arm.go_on(12, 1.5, [0.0; JOINTS]);
        for k in 0..3 {
            let hall = 1.5 * arm.normal();
            arm.rest([0.5, 3.0, 20.0][k] * super::simulated_arm::HOUR, hall);
            arm.run_of(cycles, hall, [0.0, 0.05, 0.0, 0.0, 0.0, 0.0]);
        }
        let found = arm.friction();
        for indices in &found.indices[12..] {
            assert_eq!(indices.len(), JOINTS);
            for (index, truth) in indices.iter().zip([1.0, 1.05, 1.0, 1.0, 1.0, 1.0]) {
                assert!(index.short);
                tally.add(index.index.value - truth, index.index.std_error);
                errors += index.index.std_error;
            }
        }
    }
    let mean = errors / tally.count as f64;
    (tally, mean)
}

/// Share of 95 % intervals that contain the truth.
const HONEST: std::ops::RangeInclusive<f64> = 0.93..=0.97;

fn told(name: &str, tally: &Coverage) -> f64 {
    let (inside, ratio) = tally.result();
    println!(
        "{name}: {} intervals, {:.1} % hold the truth, true over stated error {ratio:.2}",
        tally.count,
        100.0 * inside
    );
    inside
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn intervals_hold_the_truth() {
    let mut healthy = Coverage::default();
    for (runs, spread, wear) in [(24, 1.5, 0.04), (24, 4.0, 0.08), (12, 1.5, 0.04), (12, 0.2, 0.02)] {
        let [worn, of_healthy] = tally(100..112, runs, spread, wear);
        told(&format!("{runs} runs, hall within {spread} K, worn by {wear}"), &worn);
        told(&format!("{runs} runs, hall within {spread} K, healthy"), &of_healthy);
        healthy.join(&of_healthy);
    }
    assert!(HONEST.contains(&told("healthy joints", &healthy)));
}

#[test]
#[ignore = "histories of many arms, seconds each"]
fn intervals_of_short_runs_are_wider_and_hold_the_truth() {
    let mut all = Coverage::default();
    let mut before = f64::INFINITY;
    for cycles in [2, 3, 5] {
        let (tally, error) = short(200..212, cycles);
        told(&format!("runs of {cycles} cycles, mean standard error {error:.4}"), &tally);
        assert!(error < before, "{error} {before}");
        (before, _) = (error, all.join(&tally));
    }
    assert!(HONEST.contains(&told("short runs", &all)));
}
