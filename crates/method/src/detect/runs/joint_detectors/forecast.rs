//! Forecast of the days when friction of a joint reaches its limits: a local trend of its tests, continued.
//!
//! Friction `y` at the times `t` of the tests is a level with noise, and the level has a slope that may grow, stay or
//! fade (local linear trend in continuous time: Harvey 1989, chapters 2.3 and 9; Durbin and Koopman 2012, chapter 3.2):
//!
//! ```text
//! y = level + e,                     var e = (r s)²
//! d level = slope dt + a dW1
//! d slope = g slope dt + b dW2
//! ```
//!
//! `s` is the standard error of the test. `g` above zero is accelerating wear, below zero stalling wear; `a` is
//! irregular wear, as in irregular use. The unit of time is the span of the tests. `g`, `a`, `b` and `r` are unknown:
//! each combination of [`GROWTHS`], [`LEVEL_NOISES`], [`SLOPE_NOISES`] and [`ERROR_SCALES`] has a weight from the
//! likelihood of the tests (Kalman filter, prediction error decomposition), and the forecast is the mixture of all. The
//! error is robust: a test further off than [`CLIPPED_AT`] standard deviations gets a larger variance, so that it is
//! just that far off (Huber 1981).
//!
//! The probability that a limit is reached before `t` is approximated by the largest probability until `t` that the
//! level is beyond it. This is exact for wear that only grows. A level that goes up and down reaches a limit somewhat
//! earlier. Since only significant trends have a forecast, the difference is small; the simulated fates of
//! docs/method.md include it.

use jiff::civil::Date;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};

use crate::detect::control_chart::Limits;
use crate::statistics::descriptive::median;
use crate::statistics::distributions::normal_probability;
use armwatch_model::anomaly::forecast::{Crossing, Forecast, Trend};

/// Fewest tests for a trend.
const FEWEST_TESTS: usize = 8;

/// Most of the latest tests for a trend: older ones say little about the present slope.
const LATEST_TESTS: usize = 120;

/// Probability of its sign that makes a slope a trend.
const SIGNIFICANT: f64 = 0.95;

/// Furthest forecast, in spans of the tests.
const HORIZON_SPANS: f64 = 4.0;

/// Furthest forecast, in days: two years.
const HORIZON_DAYS: f64 = 730.0;

/// Probabilities of begin, middle and end of the interval.
const QUANTILES: [f64; 3] = [0.1, 0.5, 0.9];

/// Largest distance of a test from its prediction with full weight, in standard deviations.
const CLIPPED_AT: f64 = 2.5;

/// Standard deviation of the first level about the first tests, as a fraction of the baseline.
const FIRST_LEVEL: f64 = 0.05;

/// Standard deviation of the first slope, as a fraction of the baseline in a span.
const FIRST_SLOPE: f64 = 0.3;

/// Growth of the slope `g`, 1/span, with prior weights. All weights were chosen for the coverage of simulated fates
/// (docs/method.md, "When a limit is reached").
const GROWTHS: [(f64, f64); 7] =
    [(-4.0, 0.07), (-2.0, 1.0), (-1.0, 0.33), (0.0, 0.15), (1.0, 0.5), (2.0, 0.18), (3.0, 0.1)];

/// Noise of the slope `b`, as a fraction of the baseline by span^1.5, with prior weights.
const SLOPE_NOISES: [(f64, f64); 4] = [(0.0, 1.0), (0.03, 0.7), (0.1, 0.03), (0.3, 0.004)];

/// Noise of the level `a`, as a fraction of the baseline by span^0.5, with prior weights.
const LEVEL_NOISES: [(f64, f64); 4] = [(0.0, 1.0), (0.02, 0.18), (0.05, 0.06), (0.1, 0.017)];

/// Scatter of the tests in stated standard errors `r`, with prior weights.
const ERROR_SCALES: [(f64, f64); 3] = [(0.75, 0.27), (1.0, 1.0), (1.3, 1.0)];

/// Weight below which a combination is omitted.
const NEGLIGIBLE: f64 = 1e-6;

/// Number of moments with a computed probability, closer together in the near future.
const MOMENTS: usize = 150;

/// The first of them after now, as a fraction of the horizon.
const FIRST_MOMENT: f64 = 0.001;

const SECONDS_PER_DAY: f64 = 86_400.0;

/// Friction of one test as a multiple of the baseline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Test {
    pub(in crate::detect::runs) at: Timestamp,
    pub(in crate::detect::runs) ratio: f64,
    /// Standard error of `ratio`, above zero.
    pub(in crate::detect::runs) std_error: f64,
}

/// Forecast from tests, oldest first; `limits` are changes of friction from 1. `None` with fewer than [`FEWEST_TESTS`]
/// tests, which are too few for a trend or its absence.
///
/// Dates are calendar days: they assume that the robot continues to be used as between these tests.
pub(super) fn forecast(tests: &[Test], limits: &Limits) -> Option<Forecast> {
    let tests = &tests[tests.len().saturating_sub(LATEST_TESTS)..];
    let (first, last) = (tests.first()?.at, tests.last()?.at);
    let span_days = last.duration_since(first).as_secs_f64() / SECONDS_PER_DAY;
    if tests.len() < FEWEST_TESTS || span_days <= 0.0 {
        return None;
    }
    let members = members(tests, first, span_days);
    let rising: f64 = members.iter().map(|of| of.weight * of.state.is_rising()).sum();
    let (trend, side) = match rising {
        _ if rising > SIGNIFICANT => (Trend::Rising, 1.0),
        _ if rising < 1.0 - SIGNIFICANT => (Trend::Falling, -1.0),
        _ => return Some(Forecast::default()),
    };
    let horizon = HORIZON_SPANS.min(HORIZON_DAYS / span_days);
    let reach = |limit: f64| reach(&members, side, limit, horizon);
    let [warning, critical] = [limits.warning, limits.critical.max(limits.warning)].map(reach);
    if [warning, critical].iter().all(|of| *of == Reach::Beyond) {
        return Some(Forecast::default());
    }
    let crossing = |of: Reach| match of {
        Reach::Passed | Reach::Beyond => None,
        Reach::Ahead(quantiles) => crossing(last, quantiles.map(|of| of.map(|spans| spans * span_days))),
    };
    Some(Forecast { trend, warning_at: crossing(warning), critical_at: crossing(critical) })
}

/// One combination of unknowns, its state after the tests, and its weight.
struct Member {
    weight: f64,
    dynamics: Dynamics,
    state: TrendState,
}

#[derive(Debug, Clone, Copy)]
struct Dynamics {
    growth: f64,
    slope_noise: f64,
    level_noise: f64,
}

/// Level and slope after a test, with their covariance; the slope is that of one span.
#[derive(Debug, Clone, Copy)]
struct TrendState {
    level: f64,
    slope: f64,
    level_variance: f64,
    covariance: f64,
    slope_variance: f64,
}

impl TrendState {
    /// Probability that the slope is above zero.
    fn is_rising(&self) -> f64 {
        normal_probability(self.slope / self.slope_variance.sqrt())
    }

    /// The state after `spans` without a test.
    fn after(&self, spans: f64, dynamics: &Dynamics) -> Self {
        let Dynamics { growth, slope_noise, level_noise } = *dynamics;
        let (b2, a2) = (slope_noise * slope_noise, level_noise * level_noise);
        // the slope becomes `kept` times as large, and adds `gained` times itself to the level
        let (kept, gained, of_level, of_both, of_slope) = if (growth * spans).abs() < 1e-6 {
            (1.0, spans, spans.powi(3) / 3.0, spans * spans / 2.0, spans)
        } else {
            let once = (growth * spans).exp_m1() / growth;
            let twice = (2.0 * growth * spans).exp_m1() / (2.0 * growth);
            let of_level = (twice - 2.0 * once + spans) / (growth * growth);
            (1.0 + growth * once, once, of_level, (twice - once) / growth, twice)
        };
        Self {
            level: self.level + gained * self.slope,
            slope: kept * self.slope,
            level_variance: self.level_variance
                + 2.0 * gained * self.covariance
                + gained * gained * self.slope_variance
                + b2 * of_level.max(0.0)
                + a2 * spans,
            covariance: kept * (self.covariance + gained * self.slope_variance) + b2 * of_both,
            slope_variance: kept * kept * self.slope_variance + b2 * of_slope,
        }
    }

    /// The state after a test of the value `ratio`, and the logarithm of the predictive density of that value.
    fn with(&self, ratio: f64, variance: f64) -> (Self, f64) {
        let off = ratio - self.level;
        let expected = self.level_variance + variance;
        let total = expected.max(off * off / (CLIPPED_AT * CLIPPED_AT));
        let (to_level, to_slope) = (self.level_variance / total, self.covariance / total);
        let state = Self {
            level: self.level + to_level * off,
            slope: self.slope + to_slope * off,
            level_variance: (1.0 - to_level) * self.level_variance,
            covariance: (1.0 - to_level) * self.covariance,
            slope_variance: self.slope_variance - to_slope * self.covariance,
        };
        (state, -0.5 * (total.ln() + off * off / total))
    }
}

/// Every combination that is not negligible; the weights sum to one.
fn members(tests: &[Test], first: Timestamp, span_days: f64) -> Vec<Member> {
    let spans: Vec<f64> = tests
        .iter()
        .map(|test| test.at.duration_since(first).as_secs_f64() / SECONDS_PER_DAY / span_days)
        .collect();
    let begin: Vec<f64> = tests.iter().take(3).map(|test| test.ratio).collect();
    let start = TrendState {
        level: median(&begin).unwrap_or(1.0),
        slope: 0.0,
        level_variance: FIRST_LEVEL * FIRST_LEVEL,
        covariance: 0.0,
        slope_variance: FIRST_SLOPE * FIRST_SLOPE,
    };
    let mut members = Vec::new();
    for (growth, of_growth) in GROWTHS {
        for (slope_noise, of_slope) in SLOPE_NOISES {
            for (level_noise, of_level) in LEVEL_NOISES {
                for (scale, of_scale) in ERROR_SCALES {
                    let dynamics = Dynamics { growth, slope_noise, level_noise };
                    let mut log_weight = (of_growth * of_slope * of_level * of_scale).ln();
                    let (mut state, mut now) = (start, 0.0);
                    for (test, &at) in tests.iter().zip(&spans) {
                        let std_error = scale * test.std_error;
                        let (next, log_density) =
                            state.after(at - now, &dynamics).with(test.ratio, std_error * std_error);
                        log_weight += log_density;
                        (state, now) = (next, at);
                    }
                    members.push(Member { weight: log_weight, dynamics, state });
                }
            }
        }
    }
    let largest = members.iter().map(|of| of.weight).fold(f64::NEG_INFINITY, f64::max);
    members.iter_mut().for_each(|of| of.weight = (of.weight - largest).exp());
    members.retain(|of| of.weight > NEGLIGIBLE);
    let total: f64 = members.iter().map(|of| of.weight).sum();
    members.iter_mut().for_each(|of| of.weight /= total);
    members
}

/// Time until a limit is reached.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reach {
    /// Reached already, more likely than not.
    Passed,
    /// Spans from now with the probabilities [`QUANTILES`]; `None` beyond the horizon.
    Ahead([Option<f64>; 3]),
    /// Not reached within the horizon, more likely than not.
    Beyond,
}

/// Time until the level has changed by `limit` towards `side`.
fn reach(members: &[Member], side: f64, limit: f64, horizon: f64) -> Reach {
    let beyond = |spans: f64| -> f64 {
        let one = |of: &Member| {
            let then = of.state.after(spans, &of.dynamics);
            let change = side * (then.level - 1.0);
            of.weight * normal_probability((change - limit) / then.level_variance.sqrt())
        };
        members.iter().map(one).sum()
    };
    let mut quantiles = [None; 3];
    let (mut before, mut reached) = (0.0, beyond(0.0));
    if reached >= QUANTILES[1] {
        return Reach::Passed;
    }
    if reached >= QUANTILES[0] {
        quantiles[0] = Some(0.0);
    }
    for moment in 0..MOMENTS {
        let spans = horizon * FIRST_MOMENT.powf(1.0 - moment as f64 / (MOMENTS - 1) as f64);
        let now = beyond(spans).max(reached);
        for (quantile, probability) in quantiles.iter_mut().zip(QUANTILES) {
            if quantile.is_none() && now >= probability {
                *quantile = Some(before + (spans - before) * (probability - reached) / (now - reached));
            }
        }
        (before, reached) = (spans, now);
    }
    match quantiles[1] {
        Some(_) => Reach::Ahead(quantiles),
        None => Reach::Beyond,
    }
}

/// The days that are `days` after `last`; the interval is rounded outwards.
fn crossing(last: Timestamp, [lower, by, upper]: [Option<f64>; 3]) -> Option<Crossing> {
    let day = |days: f64| -> Option<Date> {
        let after = SignedDuration::try_from_secs_f64(days * SECONDS_PER_DAY).ok()?;
        Some(last.checked_add(after).ok()?.to_zoned(TimeZone::UTC).date())
    };
    let upper = match upper {
        Some(days) => Some(day(days)?.tomorrow().ok()?),
        None => None,
    };
    Some(Crossing { by: day(by?)?, lower: day(lower?)?, upper })
}

#[cfg(test)]
mod tests;
