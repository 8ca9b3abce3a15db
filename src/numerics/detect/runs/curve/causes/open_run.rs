//! The likeliest cause of the curve of a run that is still being written, against the usual curves of the joints.
//!
//! The causes, their prices and their limits are those of complete runs. Only the least number of cycles is another
//! one: a step needs a cycle before it and two of the new level.

use super::{
    Cause, Curve, Evidence, JointCurves, LEAST_SCATTER, PRIOR, QUIET_SCATTER, RunCause, Template,
    common_part, curves, mean, median, template, templates, usual_scatter, within_run,
};
use crate::analysis::friction::CycleFriction;
use crate::anomaly::RunSummary;
use crate::numerics::detect::runs::curve::points::CurvePoint;
use crate::robot::JointIndex;

/// Fewest cycles of a run that is held against a usual curve: one before a step and two after it.
pub(in crate::numerics::detect::runs) const FEWEST_CYCLES: usize = 3;

/// What the complete runs of a robot say of the curves of its joints.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::numerics::detect::runs) struct UsualCurves(Vec<UsualCurve>);

#[derive(Debug, Clone, PartialEq)]
struct UsualCurve {
    /// `None` before there are two runs.
    template: Option<Template>,
    /// Usual scatter of one cycle.
    scatter: f64,
    /// The speed levels that count.
    levels: Option<CycleFriction>,
}

impl UsualCurves {
    /// The usual curves of these runs, oldest first, as [`super::causes`] finds them.
    pub(in crate::numerics::detect::runs) fn of(
        history: &[RunSummary],
        joints: usize,
        baseline_runs: usize,
    ) -> Self {
        let all: Vec<Vec<Curve>> = (0..joints).map(|j| curves(history, JointIndex::new(j))).collect();
        let scatters: Vec<Option<f64>> = all.iter().map(|runs| usual_scatter(runs, baseline_runs)).collect();
        let of_robot = median(&scatters.iter().flatten().copied().collect::<Vec<f64>>());
        let joint = |(curves, own): (Vec<Curve>, Option<f64>)| {
            let usual = own.or(of_robot).unwrap_or(QUIET_SCATTER[1]);
            let scatter = usual.clamp(QUIET_SCATTER[0], QUIET_SCATTER[1]);
            // runs after those of the baseline have no part in the usual curve
            let mut left = baseline_runs.max(2);
            let judged = |curve: &Curve| {
                let is_learnt = left > 0;
                left -= usize::from(is_learnt && curve.len() >= template::FEWEST_CYCLES);
                (is_learnt && curve.len() >= within_run::FEWEST_CYCLES)
                    .then(|| within_run::judge(curve, scatter, PRIOR))
            };
            JointCurves { by_itself: curves.iter().map(judged).collect(), curves, scatter }
        };
        let joints: Vec<JointCurves> = all.into_iter().zip(scatters).map(joint).collect();
        let found = joints.iter().zip(templates(&joints, baseline_runs)).enumerate();
        Self(
            found
                .map(|(j, (joint, template))| UsualCurve {
                    template,
                    scatter: joint.scatter,
                    levels: history.iter().find_map(|run| of_joint(run, j).next().map(|(_, of)| of)),
                })
                .collect(),
        )
    }

    /// The cause of the curve of each joint of a run, `None` where it has too few cycles, or where the latest cycles
    /// say too little of it.
    ///
    /// One odd cycle looks like scatter, and may be the first after a step. So scatter is a cause only if it is one
    /// without the latest cycle, too. And it is more than a smooth curve leaves: a warm-up that is not the usual one
    /// takes its full shape with the whole run.
    pub(in crate::numerics::detect::runs) fn causes(&self, open: &RunSummary) -> Vec<Option<RunCause>> {
        let curves: Vec<Curve> =
            self.0.iter().enumerate().map(|(j, usual)| curve(open, j, usual.levels.as_ref())).collect();
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
        let differences: Vec<Vec<(u32, f64)>> = self
            .0
            .iter()
            .zip(curves)
            .map(|(usual, curve)| usual.template.map_or_else(Vec::new, |template| template.difference(curve)))
            .collect();
        (0..self.0.len())
            .map(|j| {
                let others: Vec<&[(u32, f64)]> = (0..self.0.len())
                    .filter(|other| *other != j && !differences[*other].is_empty())
                    .map(|other| differences[other].as_slice())
                    .collect();
                self.0[j].cause(&curves[j], &differences[j], &others)
            })
            .collect()
    }
}

impl UsualCurve {
    fn cause(&self, curve: &Curve, differences: &[(u32, f64)], others: &[&[(u32, f64)]]) -> Option<RunCause> {
        let Some(template) = &self.template else {
            let judged = (curve.len() >= within_run::FEWEST_CYCLES)
                .then(|| within_run::judge(curve, self.scatter, PRIOR))?;
            let (scatter, cycles) = (self.scatter, curve.len());
            return Some(RunCause {
                judged,
                difference: f64::NAN,
                common: 0.0,
                scatter,
                effect: 0.0,
                cycles,
            });
        };
        if curve.len() < FEWEST_CYCLES {
            return None;
        }
        let cycles: Vec<u32> = curve.iter().map(|point| point.cycle).collect();
        let minutes: Vec<f64> = curve.iter().map(|point| point.minute).collect();
        let values: Vec<f64> = differences.iter().map(|(_, value)| *value).collect();
        let common = common_part(others, &cycles);
        let scatter = self.scatter.max(template.scatter.min(QUIET_SCATTER[1]));
        let evidence =
            Evidence { cycles: &cycles, minutes: &minutes, differences: &values, common: &common, scatter };
        Some(RunCause {
            judged: evidence.judge(template, PRIOR),
            difference: mean(&values)?,
            common: mean(&common)?,
            scatter,
            // of a time constant, which is judged over whole runs
            effect: 0.0,
            cycles: curve.len(),
        })
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
