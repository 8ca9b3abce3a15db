//! The likeliest cause of the curve of a run that is still being written, against the usual curves of the joints.
//!
//! The causes, their prices and their limits are those of complete runs. Only the least number of cycles differs: a
//! step needs a cycle before it and two of the new level.

use super::{COMMON_SPREAD, Cause, Curve, LEAST_SCATTER, RunCause, UsualCurves, against, common_of};
use crate::detect::runs::curve::within_run;
use armwatch_model::anomaly::RunSummary;

/// Fewest cycles of a run that is compared with a usual curve: one before a step and two after it.
pub(in crate::detect::runs) const FEWEST_CYCLES: usize = 3;

impl UsualCurves {
    /// The cause of the curve of each joint of a run; `None` if it has too few cycles, or if the latest cycles are not
    /// enough evidence.
    ///
    /// One unusual cycle looks like scatter, and may be the first after a step. So scatter is a cause only if it is also
    /// one without the latest cycle. It must also exceed the residual of a smooth curve: an unusual warm-up takes its
    /// full shape with the whole run.
    pub(in crate::detect::runs) fn causes_of_open(&self, open: &RunSummary) -> Vec<Option<RunCause>> {
        let curves = self.curves(open);
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
        let differences = self.differences(curves);
        let differences: Vec<&[(u32, f64)]> = differences.iter().map(Vec::as_slice).collect();
        let of = |(j, curve): (usize, &Curve)| match &self.joints[j].usual {
            None => self.by_itself(&self.joints[j], curve),
            Some(_) if curve.len() < FEWEST_CYCLES => None,
            Some(usual) => {
                let common = common_of(&differences, j, curve);
                // another time constant is only a cause of whole runs
                let cause =
                    against(usual, curve, differences[j], (&common, COMMON_SPREAD), self.least_advantage);
                Some(RunCause { effect: 0.0, ..cause })
            }
        };
        curves.iter().enumerate().map(of).collect()
    }
}
