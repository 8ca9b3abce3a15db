//! Causes of the difference of a curve, and their likelihoods.
//!
//! The differences `d` of a run from the usual curve are compared with few-parameter patterns: nothing, a factor, an
//! excess at the start, another time constant of the warm-up, a step at a cycle, one unusual cycle, scatter from cycle to
//! cycle. All patterns include random effects. One is a part that all joints have in common (ambient temperature,
//! lubricant), whose coefficient is near one. The others are a level and an excess at the start of the run itself, as
//! large as in the joint's first runs. The criterion is the maximal likelihood with the price of the parameters
//! (Schwarz 1978): `ln p = -chi²/2 - k/2 ln n` with a prior of the cause.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::template::{self, Template};
use armwatch_model::analysis::Estimate;

/// Logarithm of the prior odds of one named cause against none, per joint and run: one in a thousand.
pub(super) const PRIOR: f64 = -7.0;
/// Tolerance of patterns, as a part of the largest difference: they are models.
const PATTERN_ERROR: f64 = 0.05;
/// Standard deviation of a cycle's difference under an unknown cause.
const ANYTHING: f64 = 0.3;
/// Price of an unknown cause, in parameters: any named one that fits is likelier.
const UNKNOWN_PARAMETERS: f64 = 3.0;
/// Tried factors of the slow time constant.
const FACTORS: [f64; 12] = [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.25, 1.4, 1.6, 2.0, 2.5, 3.0];
/// Largest size of a slow decay, as a multiple of the usual excess at the start.
const MOST_EXCESS: f64 = 1.5;
/// Least scatter as a separate cause, as a multiple of the usual.
const LEAST_SCATTER_FACTOR: f64 = 2.0;

/// Cause of the difference between a curve and the usual one.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::detect::runs) enum Cause {
    /// No difference.
    None,
    /// Friction is larger by the same factor in all cycles; its natural logarithm.
    Scale(f64),
    /// The joint began colder or warmer; change as a part of the usual excess.
    Start(f64),
    /// Factor of the slow time constant of the warm-up.
    TimeConstant(f64),
    /// Friction jumps with this cycle by `size`, a logarithm.
    Step { cycle: u32, size: f64 },
    /// Friction of this cycle alone is off by `size`, a logarithm.
    OddCycle { cycle: u32, size: f64 },
    /// Friction varies from cycle to cycle with this standard deviation, in logarithms.
    Scatter(f64),
    /// None of these.
    Unknown,
}

impl Cause {
    /// Description of the cause, in words that follow "rather than".
    pub(in crate::detect::runs) fn words(&self) -> String {
        match self {
            Self::None => "no change".into(),
            Self::Scale(size) => format!("{:+.0} % friction in all cycles", 100.0 * size.exp_m1()),
            Self::Start(_) => "another temperature at the start".into(),
            Self::TimeConstant(factor) => format!("a warm-up {factor:.1} times as slow"),
            Self::Step { cycle, size } => {
                format!("a step of {:+.0} % with cycle {cycle}", 100.0 * size.exp_m1())
            }
            Self::OddCycle { cycle, .. } => format!("one unusual cycle, {cycle}"),
            Self::Scatter(size) => format!("scatter of {:.0} % from cycle to cycle", 100.0 * size),
            Self::Unknown => "a cause that is not known".into(),
        }
    }
}

/// A cause with its logarithmic posterior, up to a constant that all causes share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::detect::runs) struct Judged {
    pub(in crate::detect::runs) cause: Cause,
    pub(in crate::detect::runs) log_posterior: f64,
}

/// One run of a joint.
pub(super) struct Evidence<'a> {
    /// Numbers of the cycles.
    pub(super) cycles: &'a [u32],
    /// Their times, min.
    pub(super) minutes: &'a [f64],
    /// Differences from the usual curve.
    pub(super) differences: &'a [f64],
    /// The common part of the other joints, and the standard deviation of the joint's share in it, about one. For the
    /// part that all joints share: the effect of ambient temperature on it.
    pub(super) common: &'a [f64],
    pub(super) common_spread: f64,
    /// Standard deviation of one cycle.
    pub(super) scatter: f64,
    /// Differences between runs of the joint that have no cause.
    pub(super) random: RandomEffects,
}

/// Standard deviations of the differences between runs of a joint without a cause, beyond the common part of all
/// joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RandomEffects {
    /// Standard deviation of the level, in logarithms of friction.
    pub(super) level: f64,
    /// Standard deviation of the excess of each decay at the start, as a part of the usual excess.
    pub(super) start: f64,
}

/// Priors of the random effects of a joint, and of the part that all joints share, and the number of runs that a prior
/// is worth. Ambient temperature moves all joints by more than runs of one of them differ otherwise.
pub(super) const USUAL_OF_JOINT: RandomEffects = RandomEffects { level: 0.01, start: 0.05 };
pub(super) const USUAL_OF_ARM: RandomEffects = RandomEffects { level: 0.03, start: 0.05 };
const BELIEF_RUNS: f64 = 3.0;

impl RandomEffects {
    /// Estimates from the runs of the baseline, `(minutes, differences without the common part)` of each, shrunk
    /// towards `believed`. Also returns the standard deviation of a cycle about them, `None` without remaining degrees
    /// of freedom.
    pub(super) fn of(
        runs: &[(Vec<f64>, Vec<f64>)],
        template: &Template,
        believed: Self,
    ) -> (Self, Option<f64>) {
        let columns = 1 + usize::from(template.excess(0.0) > 0.0);
        let mut effects: [Vec<f64>; 2] = Default::default();
        let (mut squares, mut freedom) = (0.0, 0.0);
        for (minutes, differences) in runs {
            let x = DMatrix::from_fn(minutes.len(), columns, |i, k| match k {
                0 => 1.0,
                _ => template.excess(minutes[i]),
            });
            let y = DVector::from_row_slice(differences);
            let Ok(fitted) = x.clone().svd(true, true).solve(&y, 1e-9) else { continue };
            squares += (&y - &x * &fitted).norm_squared();
            freedom += minutes.len().saturating_sub(columns) as f64;
            effects.iter_mut().zip(fitted.iter()).for_each(|(of, size)| of.push(*size));
        }
        let deviation = |least: f64, found: &[f64]| {
            let sum: f64 = found.iter().map(|of| of * of).sum();
            ((BELIEF_RUNS * least * least + sum) / (BELIEF_RUNS + found.len() as f64)).sqrt()
        };
        let [level, start] = effects;
        let random =
            Self { level: deviation(believed.level, &level), start: deviation(believed.start, &start) };
        // the usual curve is the mean of these runs: it contains a part of their scatter, and has as much error
        let runs = runs.len() as f64;
        let inflation = (runs + 1.0) / (runs - 1.0);
        let scatter = (freedom > 0.0 && runs > 1.0).then(|| (squares / freedom * inflation).sqrt());
        (random, scatter)
    }
}

impl Evidence<'_> {
    /// Every cause with its posterior, the likeliest first. `prior` is the logarithm of the odds of any named cause
    /// against none. If no cause could gain `least` in log-likelihood, the only result is no cause.
    pub(super) fn judge(&self, template: &Template, prior: f64, least: f64) -> Vec<Judged> {
        let n = self.cycles.len();
        let price = 0.5 * (n as f64).ln();
        let Some(weighed) = self.weighed(template) else {
            return vec![Judged { cause: Cause::Unknown, log_posterior: 0.0 }];
        };
        let mut found = vec![Judged { cause: Cause::None, log_posterior: weighed.none() }];
        if 0.5 * weighed.chi_square < least {
            return found;
        }
        let mut add = |cause: Cause, likelihood: f64, parameters: f64| {
            found.push(Judged { cause, log_posterior: likelihood + prior - parameters * price });
        };
        let (size, likelihood) = weighed.with(&DVector::from_element(n, 1.0));
        add(Cause::Scale(size), likelihood, 1.0);
        let excess = DVector::from_fn(n, |i, _| template.excess(self.minutes[i]));
        if excess.amax() > 0.0 {
            let (size, likelihood) = weighed.with(&excess);
            add(Cause::Start(size), likelihood, 1.0);
            if let Some((factor, likelihood, parameters)) = self.slowed(template, &weighed) {
                add(Cause::TimeConstant(factor), likelihood, parameters);
            }
        }
        // one cycle alone is no level; the cycles before the step are the usual curve's, or those after it if the usual
        // curve is of later runs
        for first in 1..n.saturating_sub(1) {
            let after = DVector::from_fn(n, |i, _| f64::from(u8::from(i >= first)));
            let before = after.add_scalar(-1.0);
            for pattern in [after, before] {
                let (size, likelihood) = weighed.with(&pattern);
                add(Cause::Step { cycle: self.cycles[first], size }, likelihood, 2.0);
            }
        }
        for odd in 0..n {
            let (size, likelihood) = weighed.with(&DVector::from_fn(n, |i, _| f64::from(u8::from(i == odd))));
            add(Cause::OddCycle { cycle: self.cycles[odd], size }, likelihood, 2.0);
        }
        let (size, likelihood) = self.scattered(&weighed);
        if size > LEAST_SCATTER_FACTOR * self.scatter {
            add(Cause::Scatter(size), likelihood, 1.0);
        }
        add(Cause::Unknown, self.anything(), UNKNOWN_PARAMETERS);
        found.sort_by(|a, b| b.log_posterior.total_cmp(&a.log_posterior));
        found
    }

    /// The likeliest factor of the slow time constant, with its log-likelihood and its number of parameters.
    ///
    /// A test of some cycles determines the division of its warm-up into a fast and a slow decay badly. So the slow
    /// decay may have another time constant and another size than in the usual curve, at the price of two parameters.
    /// The result is the factor that moves the usual curve by as much.
    fn slowed(&self, template: &Template, weighed: &Weighed) -> Option<(f64, f64, f64)> {
        let n = self.cycles.len();
        let slower = |factor: f64| DVector::from_fn(n, |i, _| template.slower(factor, self.minutes[i]));
        let plain = FACTORS
            .iter()
            .map(|&of| (of, weighed.with_known(&slower(of)), 1.0))
            .max_by(|a, b| a.1.total_cmp(&b.1))?;
        let most = MOST_EXCESS * template.excess(0.0);
        let mut free: Option<(DVector<f64>, f64)> = None;
        for slow in template::SLOW_MIN {
            for factor in FACTORS {
                let shape = DVector::from_fn(n, |i, _| {
                    (-self.minutes[i] / (slow * factor)).exp() - (-self.minutes[i] / slow).exp()
                });
                let (size, likelihood) = weighed.with(&shape);
                if size > 0.0 && size <= most && free.as_ref().is_none_or(|(_, best)| likelihood > *best) {
                    free = Some((shape * size, likelihood));
                }
            }
        }
        let price = n as f64;
        let as_one = |(pattern, likelihood): (DVector<f64>, f64)| {
            let nearest = FACTORS.into_iter().min_by(|a, b| {
                let distance = |of: f64| (slower(of) - &pattern).norm_squared();
                distance(*a).total_cmp(&distance(*b))
            })?;
            Some((nearest, likelihood, 3.0))
        };
        match free.and_then(as_one) {
            Some(free) if free.1 - price.ln() > plain.1 => Some(free),
            _ => Some(plain),
        }
    }

    /// Natural logarithm of the factor of the slow time constant, with its standard error, independent of the level.
    /// `None` without a slow decay.
    ///
    /// It is a first-order fit: its error is normal if the factor is one. The result is the tried or interpolated
    /// factor that gives such a fit this size.
    pub(super) fn warm_up(&self, template: &Template) -> Option<Estimate> {
        let n = self.cycles.len();
        let level = RandomEffects { level: ANYTHING, ..self.random };
        let weighed = Evidence { random: level, ..*self }.weighed(template)?;
        let pattern = DVector::from_fn(n, |i, _| template.slowing(self.minutes[i]));
        let pulled = &weighed.inverse * &pattern;
        let own = pattern.dot(&pulled);
        let size = pattern.dot(&weighed.pull) / own;
        if !size.is_finite() {
            return None;
        }
        let fitted = |factor: f64| {
            let of = DVector::from_fn(n, |i, _| template.slower(factor, self.minutes[i]));
            (pulled.dot(&of) / own, factor.ln())
        };
        let (shorter, longer) = FACTORS.split_at(FACTORS.partition_point(|factor| *factor < 1.0));
        let value = match size < 0.0 {
            true => between(size, shorter.iter().rev().map(|factor| fitted(*factor))),
            false => between(size, longer.iter().map(|factor| fitted(*factor))),
        };
        // a run with a larger residual than usual is less certain; level and factor were fitted to its cycles
        let freedom = n.saturating_sub(2).max(1) as f64;
        let rest = (weighed.chi_square - size * size * own) / freedom;
        Some(Estimate { value, std_error: (rest.max(1.0) / own).sqrt() })
    }

    /// Standard deviation of one cycle, including the error of patterns.
    fn sigma(&self) -> f64 {
        let largest = self.differences.iter().fold(0.0_f64, |largest, d| largest.max(d.abs()));
        self.scatter.hypot(PATTERN_ERROR * largest)
    }

    /// The differences beyond the common part, with their covariance from scatter and random effects: deviation of the
    /// share in the common part from one, level, excess of each decay.
    fn weighed(&self, template: &Template) -> Option<Weighed> {
        let n = self.cycles.len();
        let sigma = self.sigma();
        let common = DVector::from_row_slice(self.common);
        let decay = |of: [f64; 2]| DVector::from_fn(n, |i, _| template::decay(of, self.minutes[i]));
        let effects = [
            (&common, self.common_spread),
            (&DVector::from_element(n, 1.0), self.random.level),
            (&decay(template.fast), self.random.start),
            (&decay(template.slow), self.random.start),
        ];
        let mut covariance = DMatrix::from_diagonal_element(n, n, sigma * sigma);
        for (effect, deviation) in effects {
            covariance.ger(deviation * deviation, effect, effect, 1.0);
        }
        let inverse = covariance.cholesky()?.inverse();
        let rest = DVector::from_row_slice(self.differences) - &common;
        let pull = &inverse * &rest;
        let chi_square = rest.dot(&pull);
        Some(Weighed { inverse, pull, chi_square, log_scale: n as f64 * sigma.ln() })
    }

    /// Logarithm of the likelihood if each cycle may have any friction: normal with a wide standard deviation.
    fn anything(&self) -> f64 {
        let sum: f64 = self.differences.iter().map(|d| d * d).sum();
        -0.5 * sum / (ANYTHING * ANYTHING) - self.cycles.len() as f64 * ANYTHING.ln()
    }

    /// Standard deviation about a constant, and the logarithm of the likelihood of normal scatter with it.
    fn scattered(&self, weighed: &Weighed) -> (f64, f64) {
        let n = self.cycles.len() as f64;
        let (_, likelihood) = weighed.with(&DVector::from_element(self.cycles.len(), 1.0));
        let chi_square = -2.0 * (likelihood + weighed.log_scale);
        let freedom = (n - 1.0).max(1.0);
        let size = (chi_square / freedom).sqrt() * self.sigma();
        let price = 0.5 * n.ln();
        (size, -0.5 * freedom - n * size.max(self.scatter).ln() - price)
    }
}

/// Linear interpolation at `at` through zero and these points, which are in order of distance from zero; constant after
/// the last point.
fn between(at: f64, points: impl Iterator<Item = (f64, f64)>) -> f64 {
    let mut from = (0.0, 0.0);
    for to in points {
        if to.0 * at.signum() >= at.abs() {
            return from.1 + (to.1 - from.1) * (at - from.0) / (to.0 - from.0);
        }
        from = to;
    }
    from.1
}

/// Differences with the inverse of their covariance.
struct Weighed {
    inverse: DMatrix<f64>,
    /// The inverse times the differences.
    pull: DVector<f64>,
    chi_square: f64,
    /// Logarithm of the scale of the likelihood.
    log_scale: f64,
}

impl Weighed {
    /// Logarithm of the likelihood, up to a constant, without a pattern.
    fn none(&self) -> f64 {
        -0.5 * self.chi_square - self.log_scale
    }

    /// The likeliest size of a pattern, and the logarithm of the likelihood with it.
    fn with(&self, pattern: &DVector<f64>) -> (f64, f64) {
        let (along, own) = (pattern.dot(&self.pull), pattern.dot(&(&self.inverse * pattern)));
        (along / own, self.none() + 0.5 * along * along / own)
    }

    /// Logarithm of the likelihood with a pattern of known size.
    fn with_known(&self, pattern: &DVector<f64>) -> f64 {
        self.none() + pattern.dot(&self.pull) - 0.5 * pattern.dot(&(&self.inverse * pattern))
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::detect::runs::curve::points::{Curve, CurvePoint};

    const SCATTER: f64 = 0.003;

    /// Twelve cycles of three minutes that warm with two decays, the slow one `factor` times as slow as 30 min.
    fn run(rng: &mut ChaCha8Rng, level: f64, factor: f64) -> Curve {
        let mut point = |cycle: u32| {
            let minute = 3.0 * f64::from(cycle) - 1.5;
            let warm_up = 0.15 * (-minute / 4.0).exp() + 0.25 * (-minute / (30.0 * factor)).exp();
            let ln_torque = level + warm_up + SCATTER * rng.sample::<f64, _>(StandardNormal);
            CurvePoint { cycle, minute, ln_torque }
        };
        (1..=12).map(&mut point).collect()
    }

    /// Logarithm of the factor from each of `count` runs, against a usual curve of many runs.
    fn said(factor: f64, count: usize) -> Vec<Estimate> {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let usual: Vec<Curve> = (0..200).map(|_| run(&mut rng, 2.0, 1.0)).collect();
        let template = Template::of(&usual.iter().collect::<Vec<&Curve>>()).expect("a usual curve");
        let one = |place: usize| {
            // levels that no baseline has seen
            let curve = run(&mut rng, 2.0 + 0.1 * (place % 5) as f64, factor);
            let differences: Vec<f64> = template.difference(&curve).iter().map(|(_, of)| *of).collect();
            let evidence = Evidence {
                cycles: &curve.iter().map(|of| of.cycle).collect::<Vec<u32>>(),
                minutes: &curve.iter().map(|of| of.minute).collect::<Vec<f64>>(),
                differences: &differences,
                common: &vec![0.0; curve.len()],
                common_spread: 0.0,
                scatter: SCATTER,
                random: RandomEffects { level: 0.01, start: 0.001 },
            };
            evidence.warm_up(&template).expect("a slow decay")
        };
        (0..count).map(one).collect()
    }

    #[test]
    fn what_a_run_says_of_an_unchanged_warm_up_errs_as_it_says_whatever_the_level() {
        let scores: Vec<f64> = said(1.0, 400).iter().map(|of| of.value / of.std_error).collect();
        let count = scores.len() as f64;
        let mean = scores.iter().sum::<f64>() / count;
        let deviation = (scores.iter().map(|z| z * z).sum::<f64>() / count).sqrt();
        // the error of the pattern widens the standard errors; the usual curve's own error shifts the mean by 0.07
        assert!(mean.abs() < 0.3 && (0.2..1.15).contains(&deviation), "{mean} {deviation}");
    }

    #[test]
    fn the_factor_comes_out_though_the_fit_is_of_first_order() {
        for factor in [0.5, 0.8, 1.4, 2.0] {
            let said = said(factor, 100);
            let mean = said.iter().map(|of| of.value).sum::<f64>() / said.len() as f64;
            assert!((mean.exp() / factor - 1.0).abs() < 0.12, "{factor}: {}", mean.exp());
        }
    }
}
