//! Thermal: the warm-up of a joint takes another time than in its first runs.
//!
//! The quantity is the slow time constant as a multiple of that of the usual curve. The comparison of causes
//! ([`super::curve`]) tells it from another level of friction and from another warmth at the start: a time constant
//! changes nothing in the first cycle and most in the middle of the warm-up. A run is out if this cause is clear and
//! moves friction of some cycle by 1.5 % or more. A smaller effect is found over several runs: the likelihood ratio
//! against the best other cause is summed, never below zero (CUSUM, Page 1954), until it is as much as one run needs. And
//! what the runs say of the factor is looked at as a series ([`super::warm_up_jump`]).

use super::curve::hypothesis::Cause;
use super::series::JointSeries;
use super::warm_up_jump::{LEAST_FACTOR, WarmUpJump};
use crate::anomaly::{AnomalyKind, Severity};
use crate::numerics::detect::detector::Detector;
use crate::numerics::detect::rate::budget::Budget;
use crate::numerics::detect::verdict::{Verdict, Why};

pub(super) struct WarmUp;

impl Detector<JointSeries<'_>> for WarmUp {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Thermal
    }

    fn quantity(&self, _: &JointSeries<'_>) -> &'static str {
        "warm_up_time_ratio"
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        // evidence for a longer and for a shorter time constant, over the runs
        let mut evidence = [0.0_f64; 2];
        let budget = Budget::new(series.settings.false_alarms_per_robot_year, series.joints, &series.starts);
        let mut jumps = WarmUpJump::new(budget.alpha());
        let verdict = |run: usize| {
            let Some(found) = series.causes[run].as_ref().filter(|_| series.runs[run].is_some()) else {
                return Verdict::Unknown;
            };
            if series.has_wrong_signal(run) {
                return Verdict::Unknown;
            }
            let slowing = found.slowing;
            for (side, sum) in evidence.iter_mut().enumerate() {
                let own = slowing.filter(|(factor, _)| (*factor > 1.0) == (side == 0));
                *sum =
                    (*sum + own.map_or(AGAINST, |(_, gain)| gain)).clamp(0.0, MOST_EVIDENCE * found.needed());
            }
            let jump = jumps.add(run, found);
            let clear = match found.clear() {
                Some(Cause::TimeConstant(factor)) => Some(factor),
                _ => slowing
                    .map(|(factor, _)| factor)
                    .filter(|factor| evidence[usize::from(*factor < 1.0)] >= found.needed()),
            };
            let (factor, usual) = match (clear, jump) {
                (Some(factor), _) => (factor, "in the joint's first tests".to_owned()),
                (None, Some(jump)) => (jump.size.exp(), format!("before, for {} tests now", jump.tests)),
                (None, None) => return Verdict::Quiet,
            };
            // one test that shows it by itself may be the first of those that do
            let onset = jump.map(|jump| (jump.since, None));
            let side = if factor > 1.0 { "longer" } else { "less" };
            let is_own = matches!(found.likeliest(), Cause::TimeConstant(_));
            Verdict::Out {
                severity: Severity::Warning,
                score: factor.ln().abs(),
                threshold: LEAST_FACTOR.ln(),
                value: factor,
                baseline: 1.0,
                message: format!(
                    "warming up takes {side} than {usual}, about {factor:.1} times as long, while cold and warm friction \
                     fit; check the lubricant and what cools the joint"
                ),
                why: Why {
                    onset,
                    odds: is_own.then(|| found.odds()),
                    alternatives: if is_own { found.alternatives() } else { Vec::new() },
                },
            }
        };
        (0..series.causes.len()).map(verdict).collect()
    }
}

/// Evidence of a run that shows nothing of it, in logarithms of likelihood.
const AGAINST: f64 = -3.0;
/// Most evidence that is kept, as a multiple of what an alarm needs, so that an alarm ends when its cause does.
const MOST_EVIDENCE: f64 = 1.5;
