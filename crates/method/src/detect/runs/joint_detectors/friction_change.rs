//! Which runs of a joint have friction away from its baseline, and whether it drifted there or stepped.
//!
//! Which runs are out is the affair of the control chart ([`super::friction_drift`]). The shape is that of the runs about
//! the beginning: a level that jumps, `s` from run `k` on, or a ramp, `c (i - k + 1)`. Both have one size, so the smaller
//! sum of squares decides, with a prior for the rate of a ramp.

use crate::detect::runs::curve::hypothesis::Cause;
use crate::detect::runs::curve::run_cause::RunCause;
use crate::detect::runs::history::friction_history::{FrictionHistory, Observed};

/// Runs before the first that is out, in which a jump may have come: an average is late.
const RUNS_BEFORE: usize = 6;
/// Runs before the first that is out, in which a ramp may have begun: slow wear takes weeks to its limit.
const RUNS_OF_RAMP: usize = 60;
/// Runs after the beginning that tell a ramp from a jump. Later ones say what happened later.
const RUNS_AFTER: usize = 8;
/// Usual largest rate of wear, as a fraction of friction a run.
const USUAL_RATE: f64 = 0.06;
/// By how much less than a ramp a jump must leave, in units of chi²: friction wears more often than it jumps.
const JUMP_PRICE: f64 = 4.0;
/// Part of the largest change below which friction has returned. A repair does not show how friction changed before.
const BACK: f64 = 0.25;

/// How friction came to where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    /// Slowly, from this run on.
    Drift { run: usize },
    /// At once, in this run and with this cycle, where a cycle is known; by this fraction.
    Step { run: usize, cycle: Option<u32>, size: f64 },
}

/// The shape of an episode: of runs that are out from `first` to `last`, as places in the history. `change` is the smoothed change
/// of the first of them: what came to it is of its sign.
pub(super) fn shape(
    friction: &FrictionHistory,
    causes: &[Option<RunCause>],
    change: f64,
    first: usize,
    last: usize,
) -> Shape {
    let near = first.saturating_sub(RUNS_BEFORE)..=first;
    let inside = near.rev().find_map(|run| match causes.get(run)?.as_ref()?.clear()? {
        Cause::Step { cycle, size } if size * change > 0.0 => {
            Some(Shape::Step { run, cycle: Some(cycle), size: size.exp_m1() })
        }
        _ => None,
    });
    if let Some(step) = inside {
        return step;
    }
    let mut compared: Vec<&Observed> = friction
        .runs
        .iter()
        .filter(|of| of.run + RUNS_OF_RAMP >= first && of.run <= last && of.run < first + RUNS_AFTER)
        .filter(|of| friction.has_changed_at_first || !friction.is_learnt_from(of))
        .collect();
    // where friction changed in the tests of the baseline, its level is that of the first of them
    let level = compared.first().filter(|_| friction.has_changed_at_first).map_or(1.0, |of| of.ratio);
    let mut most = 0.0_f64;
    let is_back = |of: &&Observed| {
        let by = (of.ratio - level) * change.signum();
        most = if of.run >= first { most.max(by) } else { most };
        of.run > first && by < BACK * most
    };
    if let Some(back) = compared.iter().position(is_back) {
        compared.truncate(back);
    }
    let Some(out) = compared.iter().position(|of| of.run >= first) else {
        return Shape::Drift { run: first };
    };
    let mut best: Option<(f64, Shape)> = None;
    for begin in 0..=out {
        let place = compared[begin].run;
        let of = |pattern: &dyn Fn(usize) -> f64| {
            let weight = |of: &Observed| friction.variance(of).recip();
            let (mut with, mut own) = (0.0, 0.0);
            for (i, observed) in compared.iter().enumerate() {
                with += weight(observed) * pattern(i) * (observed.ratio - level);
                own += weight(observed) * pattern(i) * pattern(i);
            }
            let size = with / own;
            let rest = compared
                .iter()
                .enumerate()
                .map(|(i, observed)| weight(observed) * (observed.ratio - level - size * pattern(i)).powi(2));
            (size, rest.sum::<f64>())
        };
        let after = |i: usize| if i >= begin { (i - begin + 1) as f64 } else { 0.0 };
        let (size, rest) = of(&|i| f64::from(u8::from(i >= begin)));
        let (rate, ramp_rest) = of(&after);
        let ramp_rest = ramp_rest + (rate / USUAL_RATE).powi(2);
        // a jump shows in the average within a few runs
        let rest = if begin + RUNS_BEFORE >= out { rest } else { f64::INFINITY };
        let step = (size, rest + JUMP_PRICE, Shape::Step { run: place, cycle: None, size });
        for (size, rest, shape) in [step, (rate, ramp_rest, Shape::Drift { run: place })] {
            if size * change > 0.0 && best.is_none_or(|(least, _)| rest < least) {
                best = Some((rest, shape));
            }
        }
    }
    best.map_or(Shape::Drift { run: first }, |(_, shape)| shape)
}
