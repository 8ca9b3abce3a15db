//! The likeliest cause of each run's curve, joint by joint, against a baseline of the robot's first runs.

pub(in crate::numerics::detect::runs) mod open_run;

use super::hypothesis::{Cause, Evidence, PRIOR};
use super::points::{Curve, curves};
use super::run_cause::{LEAST_SCATTER, RunCause};
use super::template;
use super::usual::{Usual, common_of, joint_curves, usuals};
use crate::anomaly::RunSummary;
use crate::numerics::statistics::descriptive::mean;
use crate::robot::JointIndex;

/// Likelihood, in logarithms, that causes together must be able to gain for any of them to be looked for.
const LEAST_EVIDENCE: f64 = 3.0;

/// The cause of each run's curve, by joint and run; `None` where the run has no curve or nothing to compare it with.
pub(in crate::numerics::detect::runs) fn causes(
    history: &[RunSummary],
    joints: usize,
    baseline_runs: usize,
    least_advantage: f64,
) -> Vec<Vec<Option<RunCause>>> {
    let all: Vec<Vec<Curve>> = (0..joints).map(|joint| curves(history, JointIndex::new(joint))).collect();
    let joints = joint_curves(all, baseline_runs);
    let usuals = usuals(&joints, baseline_runs, least_advantage);
    let mut found: Vec<Vec<Option<RunCause>>> = vec![Vec::with_capacity(history.len()); joints.len()];
    for run in 0..history.len() {
        let of_run: Vec<&Curve> = joints.iter().map(|joint| &joint.curves[run]).collect();
        let differences = differences(&usuals, &of_run);
        let differences: Vec<&[(u32, f64)]> = differences.iter().map(Vec::as_slice).collect();
        for (j, joint) in joints.iter().enumerate() {
            let curve = of_run[j];
            found[j].push(match usuals[j].as_ref().filter(|_| curve.len() >= template::FEWEST_CYCLES) {
                Some(usual) => {
                    let common = common_of(&differences, j, curve);
                    against(usual, curve, differences[j], &common, least_advantage)
                }
                None => joint
                    .alone(run)
                    .map(|judged| RunCause::by_itself(judged, joint.scatter, curve.len(), least_advantage)),
            });
        }
    }
    found
}

/// How the curves of one run differ from the usual ones, by joint; empty where there is no usual one.
fn differences(usuals: &[Option<Usual>], curves: &[&Curve]) -> Vec<Vec<(u32, f64)>> {
    let of = |(usual, curve): (&Option<Usual>, &&Curve)| {
        usual.as_ref().map_or_else(Vec::new, |usual| usual.template.difference(curve))
    };
    usuals.iter().zip(curves).map(of).collect()
}

/// Of a run with this curve, held against what is usual. `differences` are those from the usual curve, `common` the
/// part of them that all joints share.
fn against(
    usual: &Usual,
    curve: &Curve,
    differences: &[(u32, f64)],
    common: &[f64],
    least_advantage: f64,
) -> Option<RunCause> {
    let Usual { template, random, scatter } = usual;
    let cycles: Vec<u32> = curve.iter().map(|point| point.cycle).collect();
    let minutes: Vec<f64> = curve.iter().map(|point| point.minute).collect();
    let values: Vec<f64> = differences.iter().map(|(_, value)| *value).collect();
    let evidence = Evidence {
        cycles: &cycles,
        minutes: &minutes,
        differences: &values,
        common,
        scatter: *scatter,
        random: *random,
    };
    let judged = evidence.judge(template, PRIOR, LEAST_EVIDENCE);
    let effect = match judged.first().map(|first| first.cause) {
        Some(Cause::TimeConstant(factor)) => {
            minutes.iter().map(|&minute| template.slower(factor, minute).abs()).fold(0.0, f64::max)
        }
        _ => 0.0,
    };
    Some(RunCause {
        judged,
        difference: mean(&values)?,
        common: mean(common)?,
        scatter: *scatter,
        effect,
        cycles: curve.len(),
        least_advantage,
    })
}
