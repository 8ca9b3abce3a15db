//! Cause of the torque in a production log that its test does not predict.
//!
//! Nothing is learnt from other logs: a log is compared with the error of the test itself. The model of the deviation
//! of joint `j` is
//!
//! ```text
//! (c + c_j) coulomb_j + (v + v_j) viscous_j + torque of the cause + noise
//! ```
//!
//! Here `coulomb_j` and `viscous_j` are the parts of the joint's friction torque by the test's parameters. `c` and `v`
//! are common to all joints and depend on the temperature of the arm; `c_j` and `v_j` are the differences between its
//! joints. All are random effects with stated standard deviations ([`hypothesis`]). The noise of a joint is the
//! residual of the test, or the residual of the log that no cause explains if that is more. It counts as a fixed number
//! of independent values, however long the log is ([`fit`]): a program repeats itself, and so does the model's error.
//!
//! A cause adds torque along its directions ([`WorkDirection`](armwatch_model::analysis::work_evidence::WorkDirection))
//! with its own sizes. A load may accompany each of the others, since production uses tools. The cost of a hypothesis
//! is the least sum of its weighted squared residuals and of its random effects, in units of chi², plus a price per
//! parameter and one for a torque signal. A cause is clear if the cost without it is higher by twice the logarithm that
//! follows from the rate of false alarms.

pub(super) mod cause;
mod hypothesis;
pub(super) mod fit;
pub(super) mod odds;

use self::cause::{WorkCause, WorkLoad};
use self::fit::{Beside, JointRest, Solution, System};
use self::hypothesis::{Hypothesis, load_columns};
use self::odds::{Asked, Fit, odds};
use crate::detect::rate::budget::Budget;
use crate::detect::verdict::Why;
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::anomaly::settings::DetectSettings;

/// Price of an unknown cause: it explains anything.
const UNKNOWN_PRICE: f64 = 150.0;
/// Extra log-likelihood that a cause needs, since random effects and noise are stated and not estimated.
const MARGIN: f64 = 5.0;

/// The causes of one log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LogCauses {
    /// Least advantage of a clear cause over none, in units of chi².
    least: f64,
    /// All hypotheses, the likeliest first.
    fits: Vec<Fit>,
    /// Residuals of the joints under the likeliest known cause.
    pub(super) joints: Vec<JointRest>,
}

impl LogCauses {
    /// The load, if it is clear.
    pub(super) fn load(&self) -> Option<WorkLoad> {
        let load = self.fits.first()?.load.filter(WorkLoad::is_plain)?;
        (self.advantage_of_load() >= self.least).then_some(load)
    }

    /// The likeliest cause in addition to a load, clear or not.
    pub(super) fn likeliest(&self) -> WorkCause {
        self.fits.first().map_or(WorkCause::None, |of| of.cause)
    }

    /// The cause in addition to a load, if it is clear.
    pub(super) fn cause(&self) -> WorkCause {
        let Some(Fit { cause, .. }) = self.fits.first() else { return WorkCause::None };
        if cause.is_large() && self.advantage() >= self.least { *cause } else { WorkCause::None }
    }

    /// Increase of the cost without the cause that accompanies a load, in units of chi².
    pub(super) fn advantage(&self) -> f64 {
        self.over(|fit| fit.cause == WorkCause::None)
    }

    fn advantage_of_load(&self) -> f64 {
        self.over(|fit| fit.load.is_none() && fit.cause != WorkCause::Unknown)
    }

    fn over(&self, is_without: impl Fn(&Fit) -> bool) -> f64 {
        match (self.fits.first(), self.fits.iter().find(|fit| is_without(fit))) {
            (Some(best), Some(without)) => without.cost - best.cost,
            _ => 0.0,
        }
    }

    /// Odds of the found cause, and the likeliest rejected explanations.
    pub(super) fn why(&self, asked: Asked) -> Why {
        odds(&self.fits, asked)
    }
}

/// The causes of each log; `None` for logs without evidence.
pub(super) fn causes(history: &[ProductionSummary], settings: &DetectSettings) -> Vec<Option<LogCauses>> {
    let joints =
        history.iter().flat_map(|log| &log.evidence).map(|of| of.joint.index() + 1).max().unwrap_or(0);
    let starts: Vec<_> = history.iter().map(|log| log.started_at).collect();
    let alpha = Budget::new(settings.false_alarms_per_robot_year, joints, &starts).alpha();
    let least = 2.0 * (MARGIN - alpha.ln());
    history.iter().map(|log| causes_of(log, least)).collect()
}

fn causes_of(log: &ProductionSummary, least: f64) -> Option<LogCauses> {
    if log.evidence.is_empty() {
        return None;
    }
    let system = System::of(log)?;
    let load_columns = load_columns(&log.evidence).and_then(|columns| system.beside(columns));
    let mut found: Vec<(Fit, Option<Solution>)> = Vec::new();
    for hypothesis in Hypothesis::all(log.evidence.len()) {
        let own = hypothesis.columns(&log.evidence).and_then(|columns| system.beside(columns));
        let Some(own) = own else { continue };
        for with_load in std::iter::once(None).chain(load_columns.as_ref().map(Some)) {
            let columns: Vec<&Beside> = own.iter().chain(with_load.into_iter().flatten()).collect();
            let Some(solution) = system.solve(&columns, hypothesis.price(columns.len())) else { continue };
            let load = with_load.map(|_| system.load(&solution));
            let cause = system.cause(hypothesis, &solution);
            found.push((Fit { load, cause, cost: solution.cost }, Some(solution)));
        }
    }
    let unknown = Fit { load: None, cause: WorkCause::Unknown, cost: system.least_left() + UNKNOWN_PRICE };
    found.push((unknown, None));
    found.sort_by(|a, b| a.0.cost.total_cmp(&b.0.cost));
    // an unknown cause has no residuals of the joints; use the likeliest known one
    let joints = found.iter().find_map(|(_, solution)| Some(system.rest(solution.as_ref()?)))?;
    Some(LogCauses { least, fits: found.into_iter().map(|(fit, _)| fit).collect(), joints })
}

#[cfg(test)]
mod tests;
