//! The likeliest cause of each run's curve, joint by joint, against a baseline of the robot's first runs.

pub(in crate::detect::runs) mod open_run;

use std::fmt::{self, Write};

use serde::{Deserialize, Serialize};

use super::hypothesis::{Cause, Evidence, PRIOR};
use super::points::{Curve, curve, curves, of_joint, shared, usual_levels};
use super::run_cause::{LEAST_SCATTER, RunCause, WarmUpOfRun};
use super::usual::{HALL_SPREAD, JointCurves, Usual, common_of, joint_curves, of_hall, usuals};
use super::{template, within_run};
use crate::detect::runs::history::first_tests::first_tests;
use crate::detect::runs::history::friction_history::COMMON_SPREAD;
use crate::statistics::descriptive::mean;
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::anomaly::RunSummary;
use armwatch_model::robot::JointIndex;

/// Least possible gain in log-likelihood over all causes for a search of causes.
const LEAST_EVIDENCE: f64 = 3.0;

/// Usual curves of the joints, from the complete runs of a robot.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::detect::runs) struct UsualCurves {
    /// By joint.
    pub(in crate::detect::runs) joints: Vec<UsualCurve>,
    /// Usual part that all joints share; `None` before two runs count for every joint.
    of_arm: Option<Usual>,
    /// Least advantage over no cause, in logarithms.
    pub(in crate::detect::runs) least_advantage: f64,
}

/// Causes of the differences between the friction curves of one run and the usual ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct RunCauses {
    /// Causes by joint.
    pub(in crate::detect::runs) of_joints: Vec<Option<RunCause>>,
    /// Cause of the part that all joints share.
    pub(in crate::detect::runs) of_arm: Option<RunCause>,
}

/// Usual curve of a joint.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::detect::runs) struct UsualCurve {
    /// `None` before there are two runs.
    usual: Option<Usual>,
    /// Usual scatter of one cycle about a smooth curve.
    scatter: f64,
    /// The compared speed levels: those of most cycles of the first run.
    levels: Option<CycleFriction>,
}

impl UsualCurves {
    /// The usual curves of these runs, oldest first. Only the first `baseline_runs` long runs of each joint are used.
    pub(in crate::detect::runs) fn of(
        history: &[RunSummary],
        joints: usize,
        baseline_runs: usize,
        least_advantage: f64,
    ) -> Self {
        let all: Vec<Vec<Curve>> = (0..joints).map(|j| curves(history, JointIndex::new(j))).collect();
        let curves = joint_curves(all, baseline_runs);
        let level = |j: usize| history.iter().find_map(|run| usual_levels(run, JointIndex::new(j)));
        let (usual, of_arm) = usuals(&curves, baseline_runs, least_advantage);
        let joints = usual.into_iter().zip(&curves).enumerate();
        let of = |(j, (usual, curves)): (usize, (Option<Usual>, &JointCurves))| UsualCurve {
            usual,
            scatter: curves.scatter,
            levels: level(j),
        };
        Self { joints: joints.map(of).collect(), of_arm, least_advantage }
    }

    /// The cause of the curve of each joint of a whole run, and of the part that all joints share; `None` if the run
    /// has no curve or nothing to compare it with.
    pub(in crate::detect::runs) fn causes(&self, run: &RunSummary) -> RunCauses {
        let curves = self.curves(run);
        let differences = self.differences(&curves);
        let differences: Vec<&[(u32, f64)]> = differences.iter().map(Vec::as_slice).collect();
        let of_arm = self.of_arm.as_ref().and_then(|usual| {
            let shared = shared(&curves.iter().collect::<Vec<&Curve>>(), &differences);
            (shared.len() >= template::FEWEST_CYCLES).then(|| self.of_arm_against(usual, &shared))
        });
        let of = |(j, curve): (usize, &Curve)| {
            let of_joint = &self.joints[j];
            match of_joint.usual.as_ref().filter(|_| curve.len() >= template::FEWEST_CYCLES) {
                Some(usual) => {
                    let common = common_of(&differences, j, curve);
                    Some(against(
                        usual,
                        curve,
                        differences[j],
                        (&common, COMMON_SPREAD),
                        self.least_advantage,
                    ))
                }
                None => self.by_itself(of_joint, curve),
            }
        };
        RunCauses { of_joints: curves.iter().enumerate().map(of).collect(), of_arm }
    }

    /// The cause of the part that all joints share, compared with the usual part.
    fn of_arm_against(&self, usual: &Usual, shared: &Curve) -> RunCause {
        let differences: Vec<(u32, f64)> =
            shared.iter().map(|point| (point.cycle, point.ln_torque)).collect();
        let of_hall = of_hall(shared, &usual.template);
        let cause = against(usual, shared, &differences, (&of_hall, HALL_SPREAD), self.least_advantage);
        // the first cycle depends on the ambient temperature and on the temperature at the start
        let common = shared.first().map_or(0.0, |first| first.ln_torque);
        RunCause { warm_up: cause.warm_up.map(|of| WarmUpOfRun { common, ..of }), ..cause }
    }

    /// Writes all inputs of judgements, with all bits of each number; without [`Self::least_advantage`], which is
    /// applied to the results.
    pub(in crate::detect::runs) fn write(&self, to: &mut impl Write) -> fmt::Result {
        write!(to, "{:?}{:?}", self.joints, self.of_arm)
    }

    /// The cause of a joint's curve without a comparison; `None` if it has too few cycles.
    fn by_itself(&self, joint: &UsualCurve, curve: &Curve) -> Option<RunCause> {
        (curve.len() >= within_run::FEWEST_CYCLES).then(|| {
            let judged = within_run::judge(curve, joint.scatter, PRIOR);
            RunCause::of(&judged, joint.scatter, curve.len(), self.least_advantage)
        })
    }

    fn curves(&self, run: &RunSummary) -> Vec<Curve> {
        self.joints.iter().enumerate().map(|(j, of)| curve_at(run, j, of.levels)).collect()
    }

    /// Differences of the curves of one run from the usual ones, by joint; empty without a usual one.
    fn differences(&self, curves: &[Curve]) -> Vec<Vec<(u32, f64)>> {
        let of = |(joint, curve): (&UsualCurve, &Curve)| {
            joint.usual.as_ref().map_or_else(Vec::new, |usual| usual.template.difference(curve))
        };
        self.joints.iter().zip(curves).map(of).collect()
    }
}

/// The cause of a run with this curve, compared with the usual one. `differences` are those from the usual curve.
/// `common` is the part of them that all joints share, with the standard deviation of the joint's share.
fn against(
    usual: &Usual,
    curve: &Curve,
    differences: &[(u32, f64)],
    (common, common_spread): (&[f64], f64),
    least_advantage: f64,
) -> RunCause {
    let Usual { template, random, scatter } = usual;
    let cycles: Vec<u32> = curve.iter().map(|point| point.cycle).collect();
    let minutes: Vec<f64> = curve.iter().map(|point| point.minute).collect();
    let values: Vec<f64> = differences.iter().map(|(_, value)| *value).collect();
    let evidence = Evidence {
        cycles: &cycles,
        minutes: &minutes,
        differences: &values,
        common,
        common_spread,
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
    let common = mean(common).unwrap_or(0.0);
    let warm_up = evidence.warm_up(template).map(|ln_factor| WarmUpOfRun { ln_factor, common });
    RunCause { effect, warm_up, ..RunCause::of(&judged, *scatter, curve.len(), least_advantage) }
}

/// The curve of a joint, of the cycles with these speed levels, or with the usual ones of the run itself.
fn curve_at(run: &RunSummary, joint: usize, levels: Option<CycleFriction>) -> Curve {
    let joint = JointIndex::new(joint);
    levels.or_else(|| usual_levels(run, joint)).map_or_else(Vec::new, |levels| curve(run, joint, &levels))
}

/// Number of first tests in the baseline: enough long ones of each joint, as far as they exist.
pub(in crate::detect::runs) fn tests_of_usual(
    history: &[RunSummary],
    joints: usize,
    baseline_runs: usize,
) -> usize {
    let fewest = [template::FEWEST_CYCLES, within_run::FEWEST_CYCLES];
    let in_all = |run: &RunSummary, j: usize| of_joint(run, JointIndex::new(j)).count();
    let long = |cycles: &dyn Fn(usize) -> usize| -> Vec<bool> {
        (0..joints).map(cycles).flat_map(|cycles| fewest.map(|fewest| cycles >= fewest)).collect()
    };
    let mut levels: Vec<Option<CycleFriction>> = vec![None; joints];
    first_tests(
        history.len(),
        baseline_runs.max(2),
        |test| long(&|j| in_all(&history[test], j)),
        |test| {
            let run = &history[test];
            for (j, levels) in levels.iter_mut().enumerate() {
                *levels = levels.or_else(|| usual_levels(run, JointIndex::new(j)));
            }
            long(&|j| curve_at(run, j, levels[j]).len())
        },
    )
}
