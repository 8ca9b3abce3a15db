//! Usual behaviour of each joint of a robot: the curve of its first runs, the differences between runs, and the scatter
//! of one cycle.

use super::hypothesis::{Cause, Judged, PRIOR, RandomEffects, USUAL_OF_ARM, USUAL_OF_JOINT};
use super::points::{Curve, CurvePoint, common_part, shared};
use super::run_cause::RunCause;
use super::template::{self, Template};
use super::within_run;
use crate::detect::runs::history::first_level::LEVEL_CHANGE;
use crate::statistics::descriptive::{mean, median};

/// Range of the scatter from cycle to cycle of a quiet joint, as a fraction of friction. A joint's own scatter is not
/// accepted as usual above it.
const QUIET_SCATTER: [f64; 2] = [0.002, 0.015];
/// Least accepted scatter of one cycle about the usual curve.
const LEAST_SCATTER_OF_CYCLE: f64 = 0.001;
/// Accepted scatter of a joint, as a multiple of the median over the arm's joints.
const MOST_OF_NEIGHBOURS: f64 = 3.0;

/// Curves of a joint and the causes of its runs without a comparison.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct JointCurves {
    pub(super) curves: Vec<Curve>,
    /// Usual scatter of one cycle about a smooth curve.
    pub(super) scatter: f64,
    /// Upper limit for a quiet joint of the arm.
    most_scatter: f64,
    /// Causes of the runs that may be in the baseline, without a comparison; `None` for runs with too few cycles, and
    /// for later ones.
    pub(super) by_itself: Vec<Option<Vec<Judged>>>,
}

/// Usual behaviour of a joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Usual {
    pub(super) template: Template,
    pub(super) random: RandomEffects,
    /// Standard deviation of one cycle.
    pub(super) scatter: f64,
}

/// Curves of all joints, with the causes, without a comparison, of those that may be in the baseline.
pub(super) fn joint_curves(all: Vec<Vec<Curve>>, baseline_runs: usize) -> Vec<JointCurves> {
    let scatters: Vec<Option<f64>> = all.iter().map(|runs| usual_scatter(runs, baseline_runs)).collect();
    let of_robot = median(&scatters.iter().flatten().copied().collect::<Vec<f64>>());
    let most_scatter = most_scatter(of_robot);
    all.into_iter()
        .zip(&scatters)
        .map(|(curves, own)| {
            let usual = own.or(of_robot).unwrap_or(QUIET_SCATTER[1]);
            let scatter = usual.clamp(QUIET_SCATTER[0], most_scatter);
            let mut left = baseline_runs.max(2);
            let judged = |curve: &Curve| {
                let is_wanted = left > 0;
                left -= usize::from(is_wanted && curve.len() >= template::FEWEST_CYCLES);
                (is_wanted && curve.len() >= within_run::FEWEST_CYCLES)
                    .then(|| within_run::judge(curve, scatter, PRIOR))
            };
            JointCurves { by_itself: curves.iter().map(judged).collect(), curves, scatter, most_scatter }
        })
        .collect()
}

/// Usual behaviour of each joint, and of the part that all joints share; `None` before there are two runs.
pub(super) fn usuals(
    joints: &[JointCurves],
    baseline_runs: usize,
    least_advantage: f64,
) -> (Vec<Option<Usual>>, Option<Usual>) {
    let learnt = templates(joints, baseline_runs, least_advantage);
    let differences: Vec<Vec<Vec<(u32, f64)>>> = joints
        .iter()
        .zip(&learnt)
        .map(|(joint, (_, template))| {
            let of = |curve: &Curve| template.as_ref().map_or_else(Vec::new, |usual| usual.difference(curve));
            joint.curves.iter().map(of).collect()
        })
        .collect();
    let of_arm = usual_of_arm(joints, &learnt, &differences);
    let of_joints = learnt
        .into_iter()
        .enumerate()
        .map(|(j, (runs, template))| {
            let (joint, template) = (&joints[j], template?);
            let own = |&run: &usize| {
                let of_run: Vec<&[(u32, f64)]> = differences.iter().map(|of| of[run].as_slice()).collect();
                let minutes = joint.curves[run].iter().map(|point| point.minute).collect();
                let common = common_of(&of_run, j, &joint.curves[run]);
                let alone = of_run[j].iter().zip(common).map(|((_, difference), common)| difference - common);
                (minutes, alone.collect())
            };
            let runs: Vec<(Vec<f64>, Vec<f64>)> = runs.iter().map(own).collect();
            let (random, scatter) = RandomEffects::of(&runs, &template, USUAL_OF_JOINT);
            let scatter = scatter.unwrap_or(joint.scatter).clamp(LEAST_SCATTER_OF_CYCLE, joint.most_scatter);
            Some(Usual { template, random, scatter })
        })
        .collect();
    (of_joints, of_arm)
}

/// Usual behaviour of the part of the curves that all joints share. The usual curve is that of their mean, over the
/// runs that count for every joint. `differences` are those of each joint and run from the joint's usual curve.
fn usual_of_arm(
    joints: &[JointCurves],
    learnt: &[(Vec<usize>, Option<Template>)],
    differences: &[Vec<Vec<(u32, f64)>>],
) -> Option<Usual> {
    let known: Vec<usize> = (0..joints.len()).filter(|&j| learnt[j].1.is_some()).collect();
    let first = *known.first()?;
    let counts = |run: &usize| known.iter().all(|&j| learnt[j].0.contains(run));
    let runs: Vec<usize> = learnt[first].0.iter().copied().filter(counts).collect();
    let curves = |run: usize| -> Vec<&Curve> { known.iter().map(|&j| &joints[j].curves[run]).collect() };
    let means: Vec<Curve> = runs.iter().map(|&run| mean_curve(&curves(run))).collect();
    let template = Template::of(&means.iter().collect::<Vec<&Curve>>())?;
    let of_run = |&run: &usize| {
        let differences: Vec<&[(u32, f64)]> = known.iter().map(|&j| differences[j][run].as_slice()).collect();
        let shared = shared(&curves(run), &differences);
        let of_hall = of_hall(&shared, &template);
        let minutes = shared.iter().map(|point| point.minute).collect();
        let alone = shared.iter().zip(of_hall).map(|(point, of_hall)| point.ln_torque - of_hall);
        (minutes, alone.collect())
    };
    let of_runs: Vec<(Vec<f64>, Vec<f64>)> =
        runs.iter().map(of_run).filter(|(minutes, _): &(Vec<f64>, Vec<f64>)| !minutes.is_empty()).collect();
    let (random, scatter) = RandomEffects::of(&of_runs, &template, USUAL_OF_ARM);
    let scatter = scatter.unwrap_or(QUIET_SCATTER[1]).clamp(LEAST_SCATTER_OF_CYCLE, QUIET_SCATTER[1]);
    Some(Usual { template, random, scatter })
}

/// Mean over the joints, of the cycles that all of them have.
fn mean_curve(curves: &[&Curve]) -> Curve {
    let Some((first, others)) = curves.split_first() else { return Curve::new() };
    let of_cycle = |point: &CurvePoint| {
        let same = |curve: &&Curve| curve.iter().find(|of| of.cycle == point.cycle).copied();
        let mut all: Vec<CurvePoint> = others.iter().map(same).collect::<Option<_>>()?;
        all.push(*point);
        let mean = |figure: fn(&CurvePoint) -> f64| mean(&all.iter().map(figure).collect::<Vec<f64>>());
        Some(CurvePoint {
            cycle: point.cycle,
            minute: mean(|of| of.minute)?,
            ln_torque: mean(|of| of.ln_torque)?,
        })
    };
    first.iter().filter_map(of_cycle).collect()
}

/// Part of the friction added to a cold joint by a lower ambient temperature that the warm joint no longer has: it
/// heats itself by more, and the part that depends on temperature is a smaller share of its friction. `HALL_SPREAD` is
/// the standard deviation of that part between arms, as a multiple: simulated ones have 0.1 to 0.6.
const LOST_BY_WARMING: f64 = 0.35;
pub(super) const HALL_SPREAD: f64 = 0.7;

/// Effect of an ambient temperature that explains the difference of the first cycle on the difference of each later
/// cycle.
pub(super) fn of_hall(shared: &[CurvePoint], template: &Template) -> Vec<f64> {
    let Some(first) = shared.first() else { return Vec::new() };
    let at_first = template.excess(first.minute);
    let left = |minute: f64| if at_first > 0.0 { template.excess(minute) / at_first } else { 1.0 };
    shared.iter().map(|point| LOST_BY_WARMING * first.ln_torque * (left(point.minute) - 1.0)).collect()
}

/// The common part of the other joints in the cycles of a joint's curve. `differences` has one entry per joint, empty
/// without a usual curve.
pub(super) fn common_of(differences: &[&[(u32, f64)]], joint: usize, curve: &Curve) -> Vec<f64> {
    let others: Vec<&[(u32, f64)]> = differences
        .iter()
        .enumerate()
        .filter(|(other, of)| *other != joint && !of.is_empty())
        .map(|(_, of)| *of)
        .collect();
    let cycles: Vec<u32> = curve.iter().map(|point| point.cycle).collect();
    common_part(&others, &cycles)
}

/// Upper limit of the accepted scatter of a joint: the other joints show the usual scatter of the arm.
fn most_scatter(of_robot: Option<f64>) -> f64 {
    let by_others = MOST_OF_NEIGHBOURS * of_robot.unwrap_or(QUIET_SCATTER[1]);
    by_others.clamp(QUIET_SCATTER[0], QUIET_SCATTER[1])
}

fn usual_scatter(runs: &[Curve], baseline_runs: usize) -> Option<f64> {
    let found: Vec<f64> = runs.iter().filter_map(within_run::scatter).take(baseline_runs.max(2)).collect();
    median(&found)
}

/// The usual curve of each joint, with its runs: the first `baseline_runs` long runs, without those with a change of
/// friction. If it changes between them, the runs before the change count if there are two, otherwise those after it.
fn templates(
    joints: &[JointCurves],
    baseline_runs: usize,
    least_advantage: f64,
) -> Vec<(Vec<usize>, Option<Template>)> {
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
            let steady = steady_runs(joint, &levels, j, &long, least_advantage);
            let template =
                Template::of(&steady.iter().map(|&run| &joint.curves[run]).collect::<Vec<&Curve>>());
            (steady, template)
        })
        .collect()
}

/// Mean logarithm of friction in a run.
fn level(curve: &Curve) -> Option<f64> {
    mean(&curve.iter().map(|point| point.ln_torque).collect::<Vec<f64>>())
}

fn steady_runs(
    joint: &JointCurves,
    levels: &[Vec<Option<f64>>],
    own: usize,
    long: &[usize],
    least_advantage: f64,
) -> Vec<usize> {
    let jumps_inside = |run: usize| {
        joint.by_itself[run].as_ref().is_some_and(|judged| {
            let clear = RunCause::of(judged, joint.scatter, 0, least_advantage);
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
    let swing = long.iter().filter_map(|&run| within_run::scatter(&joint.curves[run])).fold(0.0, f64::max);
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
