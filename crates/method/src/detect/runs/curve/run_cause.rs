//! What explains the curve of one run, and when that is clear.

use serde::{Deserialize, Serialize};

use super::hypothesis::{Cause, Judged, PRIOR};
use crate::detect::rate::budget::advantage;
use crate::detect::verdict::MOST_ODDS;
use armwatch_model::analysis::Estimate;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Alternative, RunSummary};

/// Advantage of a named cause over none, in logarithms, beyond what the rate of false alarms asks for: curves are not
/// exactly of the form that is assumed.
const CURVE_MARGIN: f64 = 7.0;
/// Least advantage over the next cause of another kind; of a step, which scatter looks like now and then.
const LEAST_LEAD: f64 = 3.0;
const LEAST_LEAD_OF_STEP: f64 = 8.0;
/// Least step, scatter and effect of another time constant, as fractions of friction.
const LEAST_STEP: f64 = 0.05;
pub(super) const LEAST_SCATTER: f64 = 0.03;
/// Evidence of one run for another time constant that counts at most, over several runs.
const MOST_OF_ONE_RUN: f64 = 12.0;
const LEAST_SLOWING: f64 = 0.015;

/// Why the curve of a joint differs from its usual one in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct RunCause {
    /// The best cause of each kind, the likeliest first; the likeliest alone where none can be clear.
    pub(in crate::detect::runs) kinds: Vec<Kind>,
    /// How much likelier than no change the likeliest is, and than the next kind, in logarithms.
    pub(in crate::detect::runs) advantage: f64,
    pub(in crate::detect::runs) lead: f64,
    /// The factor of the slow time constant that explains the run best, with how much likelier it is than the best cause
    /// of another kind, in logarithms, without the prior; `None` where it was not looked for.
    pub(in crate::detect::runs) slowing: Option<(f64, f64)>,
    /// What it says of the warm-up, if nothing else has changed; `None` of runs that are held against no usual curve.
    pub(in crate::detect::runs) warm_up: Option<WarmUpOfRun>,
    /// Usual scatter of one cycle.
    pub(in crate::detect::runs) scatter: f64,
    /// Largest effect of the winning cause on a cycle.
    pub(in crate::detect::runs) effect: f64,
    /// Cycles.
    pub(in crate::detect::runs) cycles: usize,
    /// Least advantage over none, in logarithms, of a cause that is clear.
    pub(in crate::detect::runs) least_advantage: f64,
}

/// What a run says of a joint's warm-up.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct WarmUpOfRun {
    /// Natural logarithm of the factor of the slow time constant.
    pub(in crate::detect::runs) ln_factor: Estimate,
    /// Mean change of friction that all joints have in common, in logarithms.
    pub(in crate::detect::runs) common: f64,
}

/// The best cause of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) struct Kind {
    pub(in crate::detect::runs) cause: Cause,
    /// Posterior of all causes of the kind together, as a multiple of that of the likeliest cause.
    pub(in crate::detect::runs) weight: f64,
}

/// Advantage over no cause, in logarithms, that a cause of a run's curve needs.
pub(in crate::detect::runs) fn least_advantage(history: &[RunSummary], settings: &DetectSettings) -> f64 {
    CURVE_MARGIN + advantage(settings, history)
}

impl RunCause {
    /// Of a run with these causes, the likeliest first.
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
        // what nobody asks for
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

    /// Of a run in which nothing changed.
    #[cfg(test)]
    pub(in crate::detect::runs) fn of_nothing() -> Self {
        Self::of(&[Judged { cause: Cause::None, log_posterior: 0.0 }], 0.01, 8, 30.0)
    }

    /// The likeliest cause.
    pub(in crate::detect::runs) fn likeliest(&self) -> Cause {
        self.kinds.first().map_or(Cause::None, |first| first.cause)
    }

    /// The likeliest cause where it is clear and large enough to be worth a word: steps, scatter and other time
    /// constants. Another level of friction is judged over runs, not in one.
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

    /// Whether the likeliest cause is likelier than no change by what curves of other forms may make.
    pub(in crate::detect::runs) fn is_beyond_margin(&self) -> bool {
        self.advantage >= CURVE_MARGIN
    }

    /// Whether the clear cause is so also for a joint that is known to scatter: scatter has no price there for being rare.
    pub(in crate::detect::runs) fn is_clear_where_it_scatters(&self) -> bool {
        self.lead >= LEAST_LEAD_OF_STEP - PRIOR
    }

    /// Whether scatter that is worth a word explains the run about as well as the likeliest cause, clear or not.
    pub(in crate::detect::runs) fn may_scatter(&self) -> bool {
        let close = |of: &Kind| of.weight >= (-LEAST_LEAD).exp();
        self.kinds
            .iter()
            .any(|of| matches!(of.cause, Cause::Scatter(size) if size >= LEAST_SCATTER) && close(of))
    }

    /// Advantage over no cause, in logarithms, that a cause needs.
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

    /// Odds of another level of friction in all cycles against all other causes together, and the best of each other kind;
    /// `None` where the run is too near the usual for causes to be told apart.
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

/// How much likelier than no change, in logarithms.
fn advantage_of(judged: &[Judged]) -> f64 {
    let none = judged.iter().find(|of| of.cause == Cause::None);
    match (judged.first(), none) {
        (Some(first), Some(none)) => first.log_posterior - none.log_posterior,
        _ => 0.0,
    }
}

/// How much likelier than the next cause of another kind, in logarithms.
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
