//! Thermal: the warm-up of a joint takes another time than in its first runs.
//!
//! The quantity is the slow time constant as a multiple of that of the usual curve. The comparison of causes
//! ([`super::curve`]) tells it from another level of friction and from another warmth at the start: a time constant
//! changes nothing in the first cycle and most in the middle of the warm-up. A run is out if this cause is clear and
//! moves friction of some cycle by 1.5 % or more.

use super::curve::hypothesis::Cause;
use super::series::JointSeries;
use crate::anomaly::{Alternative, AnomalyKind, Severity};
use crate::numerics::detect::detector::Detector;
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
        let verdict = |run: usize| {
            let Some(found) = series.causes[run].as_ref().filter(|_| series.runs[run].is_some()) else {
                return Verdict::Unknown;
            };
            let Some(Cause::TimeConstant(factor)) = found.clear() else { return Verdict::Quiet };
            let rejected = |(cause, odds): (Cause, f64)| Alternative { cause: cause.words(), odds };
            let side = if factor > 1.0 { "longer" } else { "less" };
            Verdict::Out {
                severity: Severity::Warning,
                score: factor.ln().abs(),
                threshold: LEAST_FACTOR.ln(),
                value: factor,
                baseline: 1.0,
                message: format!(
                    "warming up takes {side} than in the joint's first tests, about {factor:.1} times as long, while \
                     cold and warm friction fit; check the lubricant and what cools the joint"
                ),
                why: Why {
                    onset: None,
                    odds: Some(found.odds()),
                    alternatives: found.alternatives().into_iter().map(rejected).collect(),
                },
            }
        };
        (0..series.causes.len()).map(verdict).collect()
    }
}

/// Least ratio of time constants that is tried.
const LEAST_FACTOR: f64 = 1.25;
