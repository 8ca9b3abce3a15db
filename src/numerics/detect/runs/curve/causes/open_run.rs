//! The likeliest cause of the curve of a run that is still being written, against the usual curves of the joints.
//!
//! The causes, their prices and their limits are those of complete runs. Only the least number of cycles is another
//! one: a step needs a cycle before it and two of the new level.

use super::{
    Cause, Curve, LEAST_SCATTER, PRIOR, RunCause, Usual, against, common_of, curves, differences,
    joint_curves, usuals,
};
use crate::analysis::friction::CycleFriction;
use crate::anomaly::RunSummary;
use crate::numerics::detect::runs::curve::points::CurvePoint;
use crate::numerics::detect::runs::curve::within_run;
use crate::robot::JointIndex;

/// Fewest cycles of a run that is held against a usual curve: one before a step and two after it.
pub(in crate::numerics::detect::runs) const FEWEST_CYCLES: usize = 3;

/// What the complete runs of a robot say of the curves of its joints.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::numerics::detect::runs) struct UsualCurves {
    /// By joint; `None` before there are two runs.
    usual: Vec<Option<Usual>>,
    /// Usual scatter of one cycle about a smooth curve, by joint.
    scatters: Vec<f64>,
    /// The speed levels that count, by joint.
    levels: Vec<Option<CycleFriction>>,
    /// Advantage over no cause, in logarithms, that a cause needs.
    least_advantage: f64,
}

impl UsualCurves {
    /// The usual curves of these runs, oldest first, as [`super::causes`] finds them.
    pub(in crate::numerics::detect::runs) fn of(
        history: &[RunSummary],
        joints: usize,
        baseline_runs: usize,
        least_advantage: f64,
    ) -> Self {
        let all: Vec<Vec<Curve>> = (0..joints).map(|j| curves(history, JointIndex::new(j))).collect();
        // runs after those of the baseline have no part in the usual curve
        let curves = joint_curves(all, baseline_runs);
        let level = |j: usize| history.iter().find_map(|run| of_joint(run, j).next().map(|(_, of)| of));
        Self {
            usual: usuals(&curves, baseline_runs, least_advantage),
            scatters: curves.iter().map(|joint| joint.scatter).collect(),
            levels: (0..joints).map(level).collect(),
            least_advantage,
        }
    }

    /// The cause of the curve of each joint of a run, `None` where it has too few cycles, or where the latest cycles
    /// say too little of it.
    ///
    /// One odd cycle looks like scatter, and may be the first after a step. So scatter is a cause only if it is one
    /// without the latest cycle, too. And it is more than a smooth curve leaves: a warm-up that is not the usual one
    /// takes its full shape with the whole run.
    pub(in crate::numerics::detect::runs) fn causes(&self, open: &RunSummary) -> Vec<Option<RunCause>> {
        let curves: Vec<Curve> =
            self.levels.iter().enumerate().map(|(j, levels)| curve(open, j, levels.as_ref())).collect();
        let before: Vec<Curve> =
            curves.iter().map(|curve| curve[..curve.len().saturating_sub(1)].to_vec()).collect();
        let is_scatter = |of: &Option<RunCause>| {
            of.as_ref().is_some_and(|of| matches!(of.clear(), Some(Cause::Scatter(_))))
        };
        let scatters_about_a_smooth_curve =
            |curve: &Curve| within_run::scatter(curve).is_some_and(|scatter| scatter >= LEAST_SCATTER);
        self.judged(&curves)
            .into_iter()
            .zip(self.judged(&before))
            .zip(before.iter().zip(&curves))
            .map(|((now, earlier), (before, curve))| {
                let lasts =
                    is_scatter(&earlier) && [before, curve].into_iter().all(scatters_about_a_smooth_curve);
                if lasts || !is_scatter(&now) { now } else { None }
            })
            .collect()
    }

    fn judged(&self, curves: &[Curve]) -> Vec<Option<RunCause>> {
        let differences = differences(&self.usual, &curves.iter().collect::<Vec<&Curve>>());
        let differences: Vec<&[(u32, f64)]> = differences.iter().map(Vec::as_slice).collect();
        let of = |(j, curve): (usize, &Curve)| {
            let needed = self.least_advantage;
            match &self.usual[j] {
                None => (curve.len() >= within_run::FEWEST_CYCLES).then(|| {
                    let judged = within_run::judge(curve, self.scatters[j], PRIOR);
                    RunCause::by_itself(judged, self.scatters[j], curve.len(), needed)
                }),
                Some(_) if curve.len() < FEWEST_CYCLES => None,
                Some(usual) => {
                    let common = common_of(&differences, j, curve);
                    // another time constant is judged over whole runs
                    against(usual, curve, differences[j], &common, needed)
                        .map(|cause| RunCause { effect: 0.0, ..cause })
                }
            }
        };
        curves.iter().enumerate().map(of).collect()
    }
}

fn of_joint(run: &RunSummary, joint: usize) -> impl Iterator<Item = (u32, CycleFriction)> {
    let own = run.cycle_friction.iter().filter(move |of| of.friction.joint.index() == joint);
    own.map(|of| (of.cycle, of.friction))
}

/// The curve of a joint; cycles with other speed levels than the joint's first one are left out.
fn curve(run: &RunSummary, joint: usize, levels: Option<&CycleFriction>) -> Curve {
    let Some(first) = levels.copied().or_else(|| of_joint(run, joint).next().map(|(_, of)| of)) else {
        return Vec::new();
    };
    of_joint(run, joint)
        .filter(|(_, of)| of.compares_with(&first))
        .map(|(cycle, of)| CurvePoint { cycle, minute: of.minute, ln_torque: of.ln_torque })
        .collect()
}
