//! The cause of the curve of one run, and the criteria for a clear cause.

use serde::{Deserialize, Serialize};

use super::hypothesis::{Cause, Judged, PRIOR};
use crate::detect::rate::budget::advantage;
use crate::detect::verdict::MOST_ODDS;
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Alternative, RunSummary};

/// Advantage of a named cause over none, in logarithms, in addition to the part for the rate of false alarms: curves do
/// not have exactly the assumed form.
const CURVE_MARGIN: f64 = 7.0;
/// Least advantage over the next cause of another kind; more for a step, since scatter sometimes looks like one.
const LEAST_LEAD: f64 = 3.0;
const LEAST_LEAD_OF_STEP: f64 = 8.0;
/// Least step, scatter and effect of another time constant, as fractions of friction.
const LEAST_STEP: f64 = 0.05;
pub(super) const LEAST_SCATTER: f64 = 0.03;
/// Upper limit of the evidence of one run for another time constant, in sums over several runs.
const MOST_OF_ONE_RUN: f64 = 12.0;
const LEAST_SLOWING: f64 = 0.015;

/// Cause of the difference between the curve of a joint in a run and the usual one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct RunCause {
    /// The best cause of each kind, the likeliest first; only the likeliest if none can be clear.
    pub(in crate::detect::runs) kinds: Vec<Kind>,
    /// Advantage of the likeliest cause over no change, in logarithms; `lead` is that over the next kind.
    pub(in crate::detect::runs) advantage: f64,
    pub(in crate::detect::runs) lead: f64,
    /// The factor of the slow time constant that explains the run best, with its advantage over the best cause of
    /// another kind, in logarithms, without the prior; `None` if it was not fitted.
    pub(in crate::detect::runs) slowing: Option<(f64, f64)>,
    /// The warm-up of the run if nothing else has changed; `None` without a usual curve.
    pub(in crate::detect::runs) warm_up: Option<WarmUpOfRun>,
    /// Usual scatter of one cycle.
    pub(in crate::detect::runs) scatter: f64,
    /// Largest effect of the winning cause on a cycle.
    pub(in crate::detect::runs) effect: f64,
    /// Number of cycles.
    pub(in crate::detect::runs) cycles: usize,
    /// Least advantage of a clear cause over none, in logarithms.
    pub(in crate::detect::runs) least_advantage: f64,
}

/// Warm-up of a joint in a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct WarmUpOfRun {
    /// Natural logarithm of the factor of the slow time constant.
    pub(in crate::detect::runs) ln_factor: Estimate,
    /// Mean change of friction common to all joints, in logarithms.
    pub(in crate::detect::runs) common: f64,
}

/// The best cause of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct Kind {
    pub(in crate::detect::runs) cause: Cause,
    /// Posterior of all causes of the kind together, as a multiple of that of the likeliest cause.
    pub(in crate::detect::runs) weight: f64,
}

/// Least advantage of a cause of a run's curve over no cause, in logarithms.
pub(in crate::detect::runs) fn least_advantage(history: &[RunSummary], settings: &DetectSettings) -> f64 {
    CURVE_MARGIN + advantage(settings, history)
}

impl RunCause {
    /// The cause of a run from these causes, the likeliest first.
    pub(super) fn of(judged: &[Judged], scatter: f64, cycles: usize, least_advantage: f64) -> Self {
        let best = judged.first().map_or(0.0, |first| first.log_posterior);
        let mut kinds: Vec<Kind> = Vec::new();
        for of in judged {
            let weight = (of.log_posterior - best).exp();
            match kinds.iter_mut().find(|known| is_same_kind(&known.cause, &of.cause)) {
                Some(known) => known.weight += weight,
                None => kinds.push(Kind { cause: of.cause, weight }),
            }
        }
        let advantage = advantage_of(judged);
        // the others are not needed
        if advantage < CURVE_MARGIN && !matches!(kinds.first(), Some(of) if is_time_constant(&of.cause)) {
            kinds.truncate(1);
        }
        Self {
            kinds,
            advantage,
            lead: lead_of(judged),
            slowing: slowing_of(judged),
            warm_up: None,
            scatter,
            effect: 0.0,
            cycles,
            least_advantage,
        }
    }

    /// The cause of a run without a change.
    #[cfg(test)]
    pub(in crate::detect::runs) fn of_nothing() -> Self {
        Self::of(&[Judged { cause: Cause::None, log_posterior: 0.0 }], 0.01, 8, 30.0)
    }

    /// The likeliest cause.
    pub(in crate::detect::runs) fn likeliest(&self) -> Cause {
        self.kinds.first().map_or(Cause::None, |first| first.cause)
    }

    /// The likeliest cause if it is clear and large enough to be reported: steps, scatter and other time constants.
    /// Another level of friction is evaluated over several runs, not in one.
    pub(in crate::detect::runs) fn clear(&self) -> Option<Cause> {
        let cause = self.likeliest();
        let size = match cause {
            Cause::Step { size, .. } => size.exp_m1().abs() / LEAST_STEP,
            Cause::Scatter(size) => size / LEAST_SCATTER,
            Cause::TimeConstant(_) => self.effect / LEAST_SLOWING,
            Cause::None | Cause::Scale(_) | Cause::Start(_) | Cause::OddCycle { .. } | Cause::Unknown => {
                return None;
            }
        };
        let lead = if matches!(cause, Cause::Step { .. }) { LEAST_LEAD_OF_STEP } else { LEAST_LEAD };
        let clear = self.advantage >= self.least_advantage && self.lead >= lead;
        (size >= 1.0 && clear).then_some(cause)
    }

    /// Returns true if the likeliest cause is likelier than no change by more than the error of the assumed form of
    /// curves.
    pub(in crate::detect::runs) fn is_beyond_margin(&self) -> bool {
        self.advantage >= CURVE_MARGIN
    }

    /// Returns true if the clear cause is also clear for a joint with known scatter: scatter has no price for rarity
    /// there.
    pub(in crate::detect::runs) fn is_clear_where_it_scatters(&self) -> bool {
        self.lead >= LEAST_LEAD_OF_STEP - PRIOR
    }

    /// Returns true if scatter of reportable size explains the run about as well as the likeliest cause, clear or not.
    pub(in crate::detect::runs) fn may_scatter(&self) -> bool {
        let close = |of: &Kind| of.weight >= (-LEAST_LEAD).exp();
        self.kinds
            .iter()
            .any(|of| matches!(of.cause, Cause::Scatter(size) if size >= LEAST_SCATTER) && close(of))
    }

    /// Least advantage of a cause over no cause, in logarithms.
    pub(in crate::detect::runs) fn needed(&self) -> f64 {
        self.least_advantage
    }

    /// Odds of the likeliest kind of cause against all others together.
    pub(in crate::detect::runs) fn odds(&self) -> f64 {
        self.kinds.first().map_or(1.0, |first| self.odds_of(first))
    }

    /// The best of each other kind, with its odds, the likeliest first.
    pub(in crate::detect::runs) fn alternatives(&self) -> Vec<Alternative> {
        self.kinds.first().map_or_else(Vec::new, |first| self.others(first))
    }

    /// Odds of another level of friction in all cycles against all other causes together, and the best of each other
    /// kind; `None` if the run is too near the usual curve to distinguish causes.
    pub(in crate::detect::runs) fn odds_of_level(&self) -> Option<(f64, Vec<Alternative>)> {
        let level = self.kinds.iter().find(|of| matches!(of.cause, Cause::Scale(_)))?;
        (self.kinds.len() > 1).then(|| (self.odds_of(level), self.others(level)))
    }

    fn others(&self, kind: &Kind) -> Vec<Alternative> {
        let others = self.kinds.iter().filter(|of| !is_same_kind(&of.cause, &kind.cause));
        others.map(|of| Alternative { cause: of.cause.words(), odds: self.odds_of(of) }).collect()
    }

    fn odds_of(&self, kind: &Kind) -> f64 {
        let others = self.kinds.iter().filter(|of| !is_same_kind(&of.cause, &kind.cause));
        let rest: f64 = others.map(|of| of.weight).sum();
        (kind.weight / f64::max(rest, f64::MIN_POSITIVE)).min(MOST_ODDS)
    }
}

/// Advantage over no change, in logarithms.
fn advantage_of(judged: &[Judged]) -> f64 {
    let none = judged.iter().find(|of| of.cause == Cause::None);
    match (judged.first(), none) {
        (Some(first), Some(none)) => first.log_posterior - none.log_posterior,
        _ => 0.0,
    }
}

/// Advantage over the next cause of another kind, in logarithms.
fn lead_of(judged: &[Judged]) -> f64 {
    let Some(first) = judged.first() else { return 0.0 };
    let next = judged.iter().find(|of| !is_same_kind(&of.cause, &first.cause));
    next.map_or(f64::INFINITY, |next| first.log_posterior - next.log_posterior)
}

fn slowing_of(judged: &[Judged]) -> Option<(f64, f64)> {
    let (factor, own) = judged.iter().find_map(|of| match of.cause {
        Cause::TimeConstant(factor) => Some((factor, of.log_posterior - PRIOR)),
        _ => None,
    })?;
    let other = |of: &Judged| match of.cause {
        Cause::TimeConstant(_) => None,
        Cause::None => Some(of.log_posterior),
        _ => Some(of.log_posterior - PRIOR),
    };
    let best = judged.iter().filter_map(other).fold(f64::NEG_INFINITY, f64::max);
    Some((factor, (own - best).clamp(-MOST_OF_ONE_RUN, MOST_OF_ONE_RUN)))
}

fn is_same_kind(a: &Cause, b: &Cause) -> bool {
    std::mem::discriminant(a) == std::mem::discriminant(b)
}

fn is_time_constant(cause: &Cause) -> bool {
    matches!(cause, Cause::TimeConstant(_))
}
