//! Odds of the explanations of a log, and the rejected ones in words.

use super::cause::{WorkCause, WorkLoad};
use crate::detect::verdict::{MOST_ODDS, Why};
use armwatch_model::anomaly::Alternative;

/// Most rejected explanations in a verdict.
const MOST_ALTERNATIVES: usize = 3;

/// One explanation of a log.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub(super) load: Option<WorkLoad>,
    pub(super) cause: WorkCause,
    /// Cost in units of chi².
    pub(super) cost: f64,
}

/// The question that the explanations answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::detect::production) enum Asked {
    /// Is there a load? A cause without a load is an alternative.
    Load,
    /// Which cause is there, with or without a load?
    Cause,
}

/// Odds of the first of these explanations, which are sorted by cost, against all others, and the likeliest of the
/// others. Explanations with the same answer count together: one cause with two sizes, or a load with two causes.
pub(super) fn odds(fits: &[Fit], asked: Asked) -> Why {
    let least = fits.first().map_or(0.0, |fit| fit.cost);
    let mut weights: Vec<(&Fit, f64)> = Vec::new();
    for fit in fits {
        let weight = (-0.5 * (fit.cost - least)).exp();
        match weights.iter_mut().find(|(known, _)| known.is_like(fit, asked)) {
            Some((_, all)) => *all += weight,
            None => weights.push((fit, weight)),
        }
    }
    let all: f64 = weights.iter().map(|(_, weight)| weight).sum();
    let odds = |weight: f64| (weight / (all - weight).max(f64::MIN_POSITIVE)).min(MOST_ODDS);
    let own = weights.first().map(|(_, weight)| odds(*weight));
    let rejected = weights.into_iter().skip(1).take(MOST_ALTERNATIVES);
    let alternatives =
        rejected.map(|(fit, weight)| Alternative { cause: fit.words(asked), odds: odds(weight) }).collect();
    Why { odds: own, alternatives, ..Why::default() }
}

impl Fit {
    fn is_like(&self, other: &Self, asked: Asked) -> bool {
        match (asked, &self.load, &other.load) {
            (Asked::Load, Some(_), Some(_)) => true,
            (Asked::Load, Some(_), None) | (Asked::Load, None, Some(_)) => false,
            (Asked::Load, None, None) | (Asked::Cause, ..) => self.cause.is_like(&other.cause),
        }
    }

    fn words(&self, asked: Asked) -> String {
        match self.load.filter(|_| asked == Asked::Load) {
            Some(load) if load.has_seen_mass() => "a load".into(),
            Some(_) => "a load of unknown mass".into(),
            None => self.cause.words(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::JointIndex;

    #[test]
    fn one_cause_with_and_without_a_load_counts_once() {
        let load = WorkLoad { mass: 0.3, std_error: 0.1, centre: [0.0; 3] };
        let unseen = WorkLoad { std_error: 9.0, ..load };
        let gain = |part: f64| WorkCause::Gain(JointIndex::new(2), part);
        let fits = [
            Fit { load: Some(load), cause: gain(0.08), cost: 10.0 },
            Fit { load: None, cause: gain(0.09), cost: 12.0 },
            Fit { load: Some(unseen), cause: WorkCause::None, cost: 16.0 },
            Fit { load: None, cause: WorkCause::None, cost: 20.0 },
        ];
        let weight = |over: f64| (-0.5 * over).exp();
        let told = |asked: Asked| {
            let why = odds(&fits, asked);
            let causes = why.alternatives.iter().map(|of| of.cause.clone()).collect::<Vec<_>>();
            (why.odds.expect("odds"), causes)
        };
        let (own, others) = told(Asked::Cause);
        let expected = (1.0 + weight(2.0)) / (weight(6.0) + weight(10.0));
        assert!((own / expected - 1.0).abs() < 1e-12, "{own} {expected}");
        assert_eq!(others, ["no change except temperature"]);
        let (own, others) = told(Asked::Load);
        let expected = (1.0 + weight(6.0)) / (weight(2.0) + weight(10.0));
        assert!((own / expected - 1.0).abs() < 1e-12, "{own} {expected}");
        assert_eq!(
            others,
            ["a gain of +9.0 % of the torque signal of joint 3", "no change except temperature"]
        );
    }
}
