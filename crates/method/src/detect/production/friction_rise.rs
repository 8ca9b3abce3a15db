//! Drift of friction in production: a joint needs more friction than in the first logs after the last test, and the
//! other joints do not.
//!
//! The quantity is the friction of a log as a multiple of the test's friction, divided by the median of this multiple
//! over the joints that move. The temperature of the whole arm cancels. Logs with another load ([`load_change`]) are
//! omitted. The baseline is the median of the first [`LEARNING_LOGS`] logs. If that is above the values after earlier
//! tests ([`EarlierTests`]), the baseline is the median of those, from the first log on. A log is out if the EWMA of
//! the difference from the baseline reaches 0.15 of the test's friction, or 4 standard deviations of the EWMA if that
//! is more. It is critical from 0.30 on ([`LIMITS`]). Less friction is never out. Section "Causes in production logs"
//! of docs/evidence/method.md has the measured false alarms and the logs until wear is found with these limits.
//!
//! If causes of a log were compared ([`causes`](super::causes)), its friction is the deviation that remains after a
//! load or a torque signal, and no log is omitted. A log whose likeliest cause is friction of the joint is out from the
//! first one on, whatever earlier logs had.

use super::causes::cause::{LEAST_WEAR, WorkCause};
use super::causes::odds::Asked;
use super::load_change;
use super::series::{JointLogs, LEARNING_LOGS};
use crate::detect::control_chart::{EWMA_WEIGHT, Ewma, Limits, median_variance, steady_variance};
use crate::detect::detector::Detector;
use crate::detect::verdict::{Verdict, Why};
use crate::statistics::descriptive::{median, robust_deviation};
use armwatch_model::analysis::ProductionJoint;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, ProductionSummary, Severity};

/// Fewest moving joints whose median counts as the effect of temperature: of three, one that wears moves the median by
/// no more than the difference between the other two.
const FEWEST_JOINTS: usize = 3;

/// Limits of friction beyond that of the other joints. Tests warn at a third of it: they move all joints alike and
/// correct for the temperature of each.
const LIMITS: Limits = Limits { warning: 0.15, critical: 0.30, sigma: 4.0 };

/// Critical friction beyond the test's and that of the other joints.
const WORN_CRITICAL: f64 = 0.6;

/// Fewest earlier tests with logs whose levels are used.
const FEWEST_TESTS: usize = 3;

/// Standard deviation of the level of logs from test to test before a robot's own is known, and the number of tests
/// that this prior is worth. A test has one temperature, and the joints of an arm warm up at different rates.
const PRIOR_TEST_SPREAD: f64 = 0.05;
const PRIOR_TESTS: f64 = 3.0;

/// Least standard deviation from log to log that few logs are accepted to have: joints of one arm warm up at different
/// rates, which shows in the morning's log of a cold arm.
const MIN_SPREAD: f64 = 0.03;

/// Most changes from log to log for the usual scatter.
const MOST_CHANGES: usize = 250;

pub(super) struct FrictionRise;

impl Detector<JointLogs<'_>> for FrictionRise {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Drift
    }

    fn quantity(&self, _: &JointLogs<'_>) -> Quantity {
        Quantity::ProductionFriction
    }

    fn judge(&self, series: &JointLogs<'_>) -> Vec<Verdict> {
        let mut verdicts = vec![Verdict::Unknown; series.history.len()];
        let other_load = load_change::with_other_load(series);
        let ratio = |log: usize| match other_load[log] {
            true => None,
            false => friction_ratio(series, log),
        };
        // changes from log to log without an anomaly
        let mut usual: Vec<f64> = Vec::new();
        let mut earlier = EarlierTests::default();
        for since_test in series.by_test(ratio) {
            let level = earlier.level(since_test.level, spread(latest(&usual)));
            let learnt_logs = if level.is_of_earlier { 0 } else { LEARNING_LOGS };
            let mut chart = Ewma::new(0.0);
            for (place, (log, ratio)) in since_test.values.into_iter().enumerate() {
                let change = ratio - level.value;
                if place < learnt_logs {
                    verdicts[log] = Verdict::Quiet;
                    usual.push(change);
                    continue;
                }
                let smoothed = chart.add(change, EWMA_WEIGHT);
                let spread = spread(latest(&usual));
                let variance = steady_variance(spread) + level.variance(spread);
                let threshold = LIMITS.threshold(variance.sqrt());
                let Some(severity) = LIMITS.severity(smoothed, threshold) else {
                    verdicts[log] = Verdict::Quiet;
                    usual.push(change);
                    continue;
                };
                verdicts[log] = Verdict::Out {
                    severity,
                    score: smoothed,
                    threshold,
                    value: ratio,
                    baseline: level.value,
                    message: message(change, &level, &series.history[log]),
                    why: Why::default(),
                };
            }
        }
        for (log, verdict) in verdicts.iter_mut().enumerate() {
            if let Some(worn) =
                worn_since_the_test(series, log).filter(|_| !matches!(verdict, Verdict::Out { .. }))
            {
                *verdict = worn;
            }
        }
        verdicts
    }
}

/// Verdict of a log whose likeliest cause is friction of this joint. It does not depend on earlier logs.
fn worn_since_the_test(series: &JointLogs<'_>, log: usize) -> Option<Verdict> {
    let causes = series.causes[log].as_ref()?;
    let WorkCause::Friction(joint, beyond) = causes.cause() else { return None };
    let value = 1.0 + beyond;
    (joint == series.joint).then(|| Verdict::Out {
        severity: if beyond >= WORN_CRITICAL { Severity::Critical } else { Severity::Warning },
        score: beyond,
        threshold: LEAST_WEAR,
        value,
        baseline: 1.0,
        message: format!(
            "in production friction is {:.0} % above what the last test predicts, beyond what the other joints \
             have; check lubrication, gearbox and brake, and run a test",
            100.0 * beyond
        ),
        why: causes.why(Asked::Cause),
    })
}

/// The latest changes, [`MOST_CHANGES`] at most.
fn latest(usual: &[f64]) -> &[f64] {
    &usual[usual.len().saturating_sub(MOST_CHANGES)..]
}

/// Standard deviation from log to log.
fn spread(usual: &[f64]) -> f64 {
    robust_deviation(usual).unwrap_or(0.0).max(MIN_SPREAD)
}

/// Level with which the logs after a test are compared.
struct Level {
    value: f64,
    /// True if it is the level of the logs after earlier tests.
    is_of_earlier: bool,
    /// Variance of a test's level about the usual one, plus that of the usual one itself.
    of_tests: f64,
}

impl Level {
    /// Variance in addition to that of the log itself, which has the standard deviation `spread`.
    fn variance(&self, spread: f64) -> f64 {
        match self.is_of_earlier {
            true => self.of_tests,
            false => median_variance(spread, LEARNING_LOGS),
        }
    }
}

/// Levels of the logs after each test so far, as multiples of that test's friction. They show how the friction of a
/// healthy joint in production compares with a test, and how exactly a test determines it. A test after wear contains
/// the wear, so the level stays.
#[derive(Default)]
struct EarlierTests(Vec<f64>);

impl EarlierTests {
    /// The level for the logs after the next test; the first of these logs have the level `own`.
    fn level(&mut self, own: f64, spread: f64) -> Level {
        let of_own = Level { value: own, is_of_earlier: false, of_tests: 0.0 };
        let (count, known) = (self.0.len() as f64, median(&self.0));
        let Some(value) = known.filter(|_| self.0.len() >= FEWEST_TESTS) else {
            self.0.push(own);
            return of_own;
        };
        let scatter = robust_deviation(&self.0).unwrap_or(0.0);
        let square = (count * scatter * scatter + PRIOR_TESTS * PRIOR_TEST_SPREAD * PRIOR_TEST_SPREAD)
            / (count + PRIOR_TESTS);
        let of_tests = square + median_variance(square.sqrt(), self.0.len());
        let deviation = (of_tests + median_variance(spread, LEARNING_LOGS)).sqrt();
        if own - value > LIMITS.threshold(deviation) {
            return Level { value, is_of_earlier: true, of_tests };
        }
        self.0.push(own);
        of_own
    }
}

fn message(change: f64, level: &Level, log: &ProductionSummary) -> String {
    let compared = match level.is_of_earlier {
        true => "that of the logs after earlier tests, from the first logs since the last test on",
        false => "that of the first logs since the last test",
    };
    format!(
        "in production friction is {:.0} % above {compared}{}; check lubrication, gearbox and brake, and run a test",
        100.0 * change / level.value,
        if log.joints.len() < FEWEST_JOINTS { "" } else { ", and not in the other joints" }
    )
}

/// Friction of a log as a multiple of the test's, divided by that of the other joints: the common part is the effect of
/// temperature. `None` if the joint does not move.
fn friction_ratio(series: &JointLogs<'_>, log: usize) -> Option<f64> {
    // without the part that a load or a torque signal explains, if that is known
    let rest = |of: &ProductionJoint| {
        let causes = series.causes[log].as_ref()?;
        causes.joints.iter().find(|rest| rest.joint == of.joint).map(|rest| rest.friction)
    };
    let multiple = |of: &ProductionJoint| 1.0 + rest(of).unwrap_or(of.friction.excess);
    let own = series.of(log).map(multiple)?;
    let joints = &series.history[log].joints;
    if joints.len() < FEWEST_JOINTS {
        return Some(own);
    }
    let common = median(&joints.iter().map(multiple).collect::<Vec<_>>())?;
    (common > 0.0).then_some(own / common)
}

#[cfg(test)]
mod tests;
