//! The likeliest cause of each run's curve, joint by joint, against a baseline of the robot's first runs.

pub(in crate::numerics::detect::runs) mod open_run;

use super::hypothesis::{Cause, Evidence, Judged};
use super::points::{Curve, common_part, curves};
use super::template::{self, Template};
use super::within_run;
use crate::anomaly::RunSummary;
use crate::numerics::statistics::descriptive::{mean, median};
use crate::robot::JointIndex;

/// Logarithm of the prior odds of one named cause against none, of one joint in one run: one in a thousand.
const PRIOR: f64 = -7.0;
/// Scatter from cycle to cycle that a quiet joint may have, as a fraction of friction. Above it, a joint's own
/// scatter is no excuse.
const QUIET_SCATTER: [f64; 2] = [0.002, 0.015];
/// Change of the level between two runs, beyond what all joints have in common, that ends a baseline.
const LEVEL_CHANGE: f64 = 0.06;
/// Least advantage, in logarithms, of a named cause over none.
const LEAST_ADVANTAGE: f64 = 20.0;
/// Least advantage over the next cause of another kind; of a step, which scatter looks like now and then.
const LEAST_LEAD: f64 = 3.0;
const LEAST_LEAD_OF_STEP: f64 = 8.0;
/// Least step, scatter and effect of another time constant, as fractions of friction.
const LEAST_STEP: f64 = 0.05;
const LEAST_SCATTER: f64 = 0.03;
const LEAST_SLOWING: f64 = 0.015;

/// Why the curve of a joint differs from its usual one in a run.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::numerics::detect::runs) struct RunCause {
    /// All causes, the likeliest first.
    pub(in crate::numerics::detect::runs) judged: Vec<Judged>,
    /// Mean difference from the usual curve, in logarithms; not a number before there is one.
    pub(in crate::numerics::detect::runs) difference: f64,
    /// The part that all joints have in common.
    pub(in crate::numerics::detect::runs) common: f64,
    /// Usual scatter of one cycle.
    pub(in crate::numerics::detect::runs) scatter: f64,
    /// Largest effect of the winning cause on a cycle.
    effect: f64,
    /// Cycles.
    pub(in crate::numerics::detect::runs) cycles: usize,
}

impl RunCause {
    /// The likeliest cause.
    pub(in crate::numerics::detect::runs) fn likeliest(&self) -> Cause {
        self.judged.first().map_or(Cause::None, |first| first.cause)
    }

    /// The likeliest cause where it is clear and large enough to be worth a word: steps, scatter and other time
    /// constants. Another level of friction is judged over runs, not in one.
    pub(in crate::numerics::detect::runs) fn clear(&self) -> Option<Cause> {
        let cause = self.likeliest();
        let size = match cause {
            Cause::Step { size, .. } => size.abs() / LEAST_STEP,
            Cause::Scatter(size) => size / LEAST_SCATTER,
            Cause::TimeConstant(_) => self.effect / LEAST_SLOWING,
            Cause::None | Cause::Scale(_) | Cause::Start(_) | Cause::Unknown => return None,
        };
        let lead = if matches!(cause, Cause::Step { .. }) { LEAST_LEAD_OF_STEP } else { LEAST_LEAD };
        let clear = self.advantage() >= LEAST_ADVANTAGE && self.lead() >= lead;
        (size >= 1.0 && clear).then_some(cause)
    }

    /// How much likelier than no change, in logarithms.
    pub(in crate::numerics::detect::runs) fn advantage(&self) -> f64 {
        let none = self.judged.iter().find(|of| of.cause == Cause::None);
        match (self.judged.first(), none) {
            (Some(first), Some(none)) => first.log_posterior - none.log_posterior,
            _ => 0.0,
        }
    }

    /// How much likelier than the next cause of another kind, in logarithms.
    fn lead(&self) -> f64 {
        let Some(first) = self.judged.first() else { return 0.0 };
        let kind = std::mem::discriminant(&first.cause);
        let next = self.judged.iter().find(|of| std::mem::discriminant(&of.cause) != kind);
        next.map_or(f64::INFINITY, |next| first.log_posterior - next.log_posterior)
    }

    /// Odds of the likeliest kind of cause against all others together.
    pub(in crate::numerics::detect::runs) fn odds(&self) -> f64 {
        let Some(first) = self.judged.first() else { return 1.0 };
        self.odds_of(&first.cause)
    }

    /// The best of each other kind, with its odds, the likeliest first.
    pub(in crate::numerics::detect::runs) fn alternatives(&self) -> Vec<(Cause, f64)> {
        let mut kinds = Vec::new();
        for of in &self.judged {
            if !kinds.iter().any(|known: &Cause| is_same_kind(known, &of.cause)) {
                kinds.push(of.cause);
            }
        }
        kinds.into_iter().skip(1).map(|cause| (cause, self.odds_of(&cause))).collect()
    }

    fn odds_of(&self, cause: &Cause) -> f64 {
        let best = self.judged.first().map_or(0.0, |first| first.log_posterior);
        let (mut own, mut rest) = (0.0, 0.0);
        for of in &self.judged {
            let weight = (of.log_posterior - best).exp();
            *(if is_same_kind(&of.cause, cause) { &mut own } else { &mut rest }) += weight;
        }
        own / f64::max(rest, f64::MIN_POSITIVE)
    }
}

fn is_same_kind(a: &Cause, b: &Cause) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
}

/// A joint: its curves and what its runs by themselves say.
struct JointCurves {
    curves: Vec<Curve>,
    /// Usual scatter of one cycle about a smooth curve.
    scatter: f64,
    by_itself: Vec<Option<Vec<Judged>>>,
}

/// The cause of each run's curve, by joint and run; `None` where the run has no curve or nothing to compare it with.
pub(in crate::numerics::detect::runs) fn causes(
    history: &[RunSummary],
    joints: usize,
    baseline_runs: usize,
) -> Vec<Vec<Option<RunCause>>> {
    let all: Vec<Vec<Curve>> = (0..joints).map(|joint| curves(history, JointIndex::new(joint))).collect();
    let scatters: Vec<Option<f64>> = all.iter().map(|runs| usual_scatter(runs, baseline_runs)).collect();
    let of_robot = median(&scatters.iter().flatten().copied().collect::<Vec<f64>>());
    let joints: Vec<JointCurves> = all
        .into_iter()
        .zip(&scatters)
        .map(|(curves, own)| {
            let usual = own.or(of_robot).unwrap_or(QUIET_SCATTER[1]);
            let scatter = usual.clamp(QUIET_SCATTER[0], QUIET_SCATTER[1]);
            let by_itself = curves
                .iter()
                .map(|curve| {
                    (curve.len() >= within_run::FEWEST_CYCLES)
                        .then(|| within_run::judge(curve, scatter, PRIOR))
                })
                .collect();
            JointCurves { curves, scatter, by_itself }
        })
        .collect();
    let templates = templates(&joints, baseline_runs);
    let differences: Vec<Vec<Vec<(u32, f64)>>> = joints
        .iter()
        .zip(&templates)
        .map(|(joint, template)| match template {
            Some(template) => joint.curves.iter().map(|curve| template.difference(curve)).collect(),
            None => vec![Vec::new(); joint.curves.len()],
        })
        .collect();
    joints
        .iter()
        .enumerate()
        .map(|(j, joint)| {
            (0..history.len())
                .map(|run| {
                    let others: Vec<&[(u32, f64)]> = differences
                        .iter()
                        .enumerate()
                        .filter(|(other, of)| *other != j && !of[run].is_empty())
                        .map(|(_, of)| of[run].as_slice())
                        .collect();
                    run_cause(joint, templates[j].as_ref(), run, &differences[j][run], &others)
                })
                .collect()
        })
        .collect()
}

fn usual_scatter(runs: &[Curve], baseline_runs: usize) -> Option<f64> {
    let found: Vec<f64> = runs.iter().filter_map(within_run::scatter).take(baseline_runs.max(2)).collect();
    median(&found)
}

fn run_cause(
    joint: &JointCurves,
    template: Option<&Template>,
    run: usize,
    differences: &[(u32, f64)],
    others: &[&[(u32, f64)]],
) -> Option<RunCause> {
    let curve = &joint.curves[run];
    let Some(template) = template.filter(|_| curve.len() >= template::FEWEST_CYCLES) else {
        let judged = joint.by_itself[run].clone()?;
        return Some(RunCause {
            judged,
            difference: f64::NAN,
            common: 0.0,
            scatter: joint.scatter,
            effect: 0.0,
            cycles: curve.len(),
        });
    };
    let cycles: Vec<u32> = curve.iter().map(|point| point.cycle).collect();
    let minutes: Vec<f64> = curve.iter().map(|point| point.minute).collect();
    let values: Vec<f64> = differences.iter().map(|(_, value)| *value).collect();
    let common = common_part(others, &cycles);
    let scatter = joint.scatter.max(template.scatter.min(QUIET_SCATTER[1]));
    let evidence =
        Evidence { cycles: &cycles, minutes: &minutes, differences: &values, common: &common, scatter };
    let judged = evidence.judge(template, PRIOR);
    let effect = match judged.first().map(|first| first.cause) {
        Some(Cause::TimeConstant(factor)) => {
            minutes.iter().map(|&minute| template.slower(factor, minute).abs()).fold(0.0, f64::max)
        }
        _ => 0.0,
    };
    Some(RunCause {
        judged,
        difference: mean(&values)?,
        common: mean(&common)?,
        scatter,
        effect,
        cycles: curve.len(),
    })
}

/// The usual curve of each joint: of its first `baseline_runs` long runs, without those in which friction changes.
/// Where it changes among them, the runs before the change count if there are two, else those after it.
fn templates(joints: &[JointCurves], baseline_runs: usize) -> Vec<Option<Template>> {
    let levels: Vec<Vec<Option<f64>>> =
        joints.iter().map(|joint| joint.curves.iter().map(level).collect()).collect();
    joints
        .iter()
        .enumerate()
        .map(|(j, joint)| {
            let long: Vec<usize> = (0..joint.curves.len())
                .filter(|&run| joint.curves[run].len() >= template::FEWEST_CYCLES)
                .take(baseline_runs.max(2))
                .collect();
            let steady = steady_runs(joint, &levels, j, &long);
            Template::of(&steady.iter().map(|&run| &joint.curves[run]).collect::<Vec<&Curve>>())
        })
        .collect()
}

/// Mean logarithm of friction in a run.
fn level(curve: &Curve) -> Option<f64> {
    mean(&curve.iter().map(|point| point.ln_torque).collect::<Vec<f64>>())
}

fn steady_runs(joint: &JointCurves, levels: &[Vec<Option<f64>>], own: usize, long: &[usize]) -> Vec<usize> {
    let jumps_inside = |run: usize| {
        joint.by_itself[run].as_ref().is_some_and(|judged| {
            let clear = RunCause {
                judged: judged.clone(),
                difference: f64::NAN,
                common: 0.0,
                scatter: joint.scatter,
                effect: 0.0,
                cycles: 0,
            };
            matches!(clear.clear(), Some(Cause::Step { .. }))
        })
    };
    let change = |before: usize, after: usize| {
        let of = |levels: &Vec<Option<f64>>| Some(levels[after]? - levels[before]?);
        let others: Vec<f64> = levels
            .iter()
            .enumerate()
            .filter(|(j, _)| *j != own)
            .filter_map(|(_, of_joint)| of(of_joint))
            .collect();
        of(&levels[own]).map_or(0.0, |own| own - median(&others).unwrap_or(0.0))
    };
    // a joint that swings from cycle to cycle has levels that swing too
    let swing = joint.curves.iter().filter_map(within_run::scatter).fold(0.0, f64::max);
    let limit = LEVEL_CHANGE.max(3.0 * swing);
    let changed = (1..long.len()).find(|&at| {
        jumps_inside(long[at])
            || (change(long[at - 1], long[at]).abs() > limit && !jumps_inside(long[at - 1]))
    });
    match changed {
        None => long.to_vec(),
        Some(at) if at >= 2 => long[..at].to_vec(),
        Some(at) => {
            let first = if jumps_inside(long[at]) { at + 1 } else { at };
            long[first.min(long.len())..].to_vec()
        }
    }
}
