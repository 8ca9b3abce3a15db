//! Drift of friction: the friction of a joint leaves its baseline and stays away from it.
//!
//! The quantity is friction as a multiple of the joint's first runs ([`FrictionHistory`]): the friction index or, for
//! runs without one, warm friction or friction of the excitation. The detector follows its EWMA; a run with a larger
//! standard error has a smaller weight. A run is out if the EWMA differs from 1 by `drift_warning` (a fraction, 0.05
//! unless configured), or by the limit of chance at the set rate of false alarms, if that is more ([`LevelLimit`]). It
//! is critical from `drift_critical` (0.15) on. Friction that has fallen by less has the severity `info`, since gears
//! are run in and greased. If two tests in a row are each beyond chance on one side of the average, they move it to
//! their level. A change is over below three quarters of its limit. A smaller change is also a warning if it grows with
//! every test ([`super::steady_rise`]).

use super::forecast::{Test, forecast};
use super::friction_change::{Shape, shape};
use super::level_limit::LevelLimit;
use super::steady_rise::{Rise, steady_rise};
use crate::detect::control_chart::{Limits, UnequalEwma, steady_variance};
use crate::detect::detector::Detector;
use crate::detect::runs::curve::run_cause::RunCause;
use crate::detect::runs::history::friction_history::{FrictionHistory, Observed, Source};
use crate::detect::runs::series::JointSeries;
use crate::detect::verdict::{Verdict, Why, apart};
use armwatch_model::anomaly::forecast::{Forecast, Trend};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Standard errors of a run's own ratio below which no change counts: much of them is the error of the friction map,
/// which is the same in all runs and is not averaged away.
const MAP_ERRORS: f64 = 3.0;
/// Part of its limit below which a change is over.
const CLOSING: f64 = 0.75;

pub(super) struct FrictionDrift;

impl Detector<JointSeries<'_>> for FrictionDrift {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Drift
    }

    fn quantity(&self, series: &JointSeries<'_>) -> Quantity {
        series.friction.source.quantity()
    }

    fn judge(&self, series: &JointSeries<'_>) -> Vec<Verdict> {
        let Judged { mut verdicts, rises, changes, .. } = judged(series);
        for (first, last) in episodes(&verdicts, &changes) {
            match episode_shape(series, &rises, &changes, first, last) {
                // reported by another detector
                Shape::Step { .. } => verdicts[first..=last].fill(Verdict::Quiet),
                Shape::Drift { run } => {
                    for (place, verdict) in (first..=last).zip(&mut verdicts[first..=last]) {
                        if let Verdict::Out { why, .. } = verdict {
                            *why = Why { onset: Some((run, None)), ..why_level(series, place) };
                        }
                    }
                }
            }
        }
        if let (Some(Verdict::Out { message, value, baseline, .. }), Some(outlook)) =
            (verdicts.last_mut(), outlook(series))
        {
            message.push_str(&at_this_rate(&outlook, *value > *baseline));
        }
        verdicts
    }
}

/// Odds and alternatives of another level of friction, from the causes of a test's friction curve.
pub(super) fn why_level(series: &JointSeries<'_>, run: usize) -> Why {
    let compared = series.causes.get(run).and_then(Option::as_ref).and_then(RunCause::odds_of_level);
    let (odds, alternatives) = compared.unzip();
    Why { odds, alternatives: alternatives.unwrap_or_default(), ..Why::default() }
}

/// Forecast of friction after the latest run. A jump of friction is not part of a trend, so runs before the last one
/// are omitted.
pub(in crate::detect::runs) fn outlook(series: &JointSeries<'_>) -> Option<Forecast> {
    let friction = series.friction;
    let Judged { verdicts, limit, rises, changes } = judged(series);
    let last_jump = |(first, last)| match episode_shape(series, &rises, &changes, first, last) {
        // the run with the jump has both levels
        Shape::Step { run, cycle, .. } => Some(run + usize::from(cycle.is_some())),
        Shape::Drift { .. } => None,
    };
    let begin = episodes(&verdicts, &changes).into_iter().rev().find_map(last_jump).unwrap_or(0);
    let tests: Vec<Test> = friction
        .runs
        .iter()
        .filter(|of| of.run >= begin && !friction.is_learnt_from(of) && !series.is_level_explained(of.run))
        .map(|of| Test {
            at: series.starts[of.run],
            ratio: of.ratio,
            std_error: friction.variance(of).sqrt(),
        })
        .collect();
    let warning = limit.threshold(steady_variance(friction.spread));
    forecast(&tests, &Limits { warning, ..limit.limits() })
}

/// Forecast for a drift's message: empty without a trend away from the baseline, or if the critical limit is passed.
fn at_this_rate(outlook: &Forecast, is_above: bool) -> String {
    let away = if is_above { Trend::Rising } else { Trend::Falling };
    match outlook.critical_at.filter(|_| outlook.trend == away) {
        Some(crossing) => format!("; at this rate critical by {}", crossing.words()),
        None => String::new(),
    }
}

/// First and last run of each sequence of runs that are out to one side; one quiet run in between does not end it.
pub(in crate::detect::runs) fn episodes(verdicts: &[Verdict], changes: &[f64]) -> Vec<(usize, usize)> {
    let mut found: Vec<(usize, usize)> = Vec::new();
    let mut quiet = 2;
    for (run, verdict) in verdicts.iter().enumerate() {
        match verdict {
            Verdict::Unknown => {}
            Verdict::Quiet => quiet += 1,
            Verdict::Out { .. } => {
                let goes_on = |open: &&mut (usize, usize)| quiet < 2 && changes[open.0] * changes[run] > 0.0;
                match found.last_mut().filter(goes_on) {
                    Some(open) => open.1 = run,
                    None => found.push((run, run)),
                }
                quiet = 0;
            }
        }
    }
    found
}

/// The shape of an episode of [`judged`]: a drift if it began with a steady rise.
pub(super) fn episode_shape(
    series: &JointSeries<'_>,
    rises: &[Option<usize>],
    changes: &[f64],
    first: usize,
    last: usize,
) -> Shape {
    match rises[first] {
        Some(run) => Shape::Drift { run },
        None => shape(series.friction, series.causes, changes[first], first, last),
    }
}

/// Evaluation of the level of friction.
pub(in crate::detect::runs) struct Judged {
    /// Runs with friction away from the baseline, whatever the shape.
    pub(in crate::detect::runs) verdicts: Vec<Verdict>,
    /// The limit as it is after the latest run.
    pub(in crate::detect::runs) limit: LevelLimit,
    /// For each run that is out only by a steady rise, the place of its first run.
    pub(super) rises: Vec<Option<usize>>,
    /// Smoothed change of each run, as a fraction of the baseline; for a steady rise, the change since its beginning.
    /// Zero for runs that are not compared.
    pub(in crate::detect::runs) changes: Vec<f64>,
}

/// Evaluates the level of friction.
pub(in crate::detect::runs) fn judged(series: &JointSeries<'_>) -> Judged {
    let friction = series.friction;
    let mut limit = LevelLimit::new(series);
    let baseline = friction.baseline(friction.source).map_or(1.0, |baseline| baseline.torque);
    let mut chart = UnequalEwma::new(1.0, friction.spread);
    let mut verdicts = vec![Verdict::Unknown; series.runs.len()];
    // limit at the beginning of the present episode
    let mut opened: Option<f64> = None;
    // distance of the test before from the average, and whether it was beyond chance
    let mut before = (0.0, false);
    let mut rises = vec![None; series.runs.len()];
    let mut changes = vec![0.0; series.runs.len()];
    let mut rise: Option<Rise> = None;
    let mut compared: Vec<Observed> = Vec::new();
    for observed in &friction.runs {
        limit.before(friction, observed.run);
        if friction.is_learnt_from(observed) {
            limit.learn(observed);
            compared.push(*observed);
            verdicts[observed.run] = Verdict::Quiet;
            continue;
        }
        // a run with another explanation does not count for the level of friction
        if series.is_level_explained(observed.run) {
            continue;
        }
        compared.push(*observed);
        let average = chart.average();
        let mut change = chart.add(observed.ratio, friction.variance(observed)) - 1.0;
        let is_shifted = limit.is_shifted(observed);
        // an uncertain test moves the average little: two that agree on another level set it
        let own = friction.variance(observed).max(observed.uncertainty().powi(2));
        let chance = limit.limits().threshold((own + friction.baseline_variance).sqrt());
        let now = (observed.ratio - average, (observed.ratio - average).abs() >= chance);
        let last = std::mem::replace(&mut before, now);
        if (now.1 && last.1 || is_shifted) && now.0.signum() == last.0.signum() {
            let level = average + if now.0.abs() < last.0.abs() { now.0 } else { last.0 };
            if now.1 && last.1 || (level - 1.0).abs() > change.abs() {
                chart.restart(level, 0.5 * own);
                change = level - 1.0;
            }
        }
        changes[observed.run] = change;
        let of_average = if is_shifted { limit.limits().warning } else { limit.threshold(chart.variance()) };
        let opening =
            of_average.max(MAP_ERRORS * observed.uncertainty()).min(opened.unwrap_or(f64::INFINITY));
        let threshold = if opened.is_some() { CLOSING * opening } else { opening };
        let Some(severity) = limit.limits().severity(change.abs(), threshold) else {
            opened = None;
            rise = rising(friction, &compared, &limit, rise, 1.0 + change);
            match rise {
                Some(of) => {
                    limit.out();
                    rises[observed.run] = Some(of.run);
                    changes[observed.run] = of.size;
                    verdicts[observed.run] = of_rise(&of, observed, baseline, opening);
                }
                None => {
                    // scatter that is reported separately is not the usual one
                    if !series.is_scattered(observed.run) {
                        limit.quiet(observed);
                    }
                    verdicts[observed.run] = Verdict::Quiet;
                }
            }
            continue;
        };
        opened = Some(opening);
        limit.out();
        verdicts[observed.run] = Verdict::Out {
            // run-in and new grease lower friction
            severity: if change < 0.0 && severity < Severity::Critical { Severity::Info } else { severity },
            score: change.abs(),
            threshold: opening,
            value: observed.measured_ratio() * baseline,
            baseline,
            message: message(change, opening, observed, friction),
            why: Why::default(),
        };
    }
    Judged { verdicts, limit, rises, changes }
}

/// The rise that continues after the latest of the tests `compared`, whose smoothed friction is `average`: a new one,
/// or the one `before` until it is over.
fn rising(
    friction: &FrictionHistory,
    compared: &[Observed],
    limit: &LevelLimit,
    before: Option<Rise>,
    average: f64,
) -> Option<Rise> {
    let alpha = limit.alpha()?;
    let found = steady_rise(friction, compared, &limit.known_scatter(), alpha, limit.limits().warning);
    let goes_on = |of: Rise| Rise { size: average - of.level, tests: of.tests + 1, ..of };
    let going_on = before.map(goes_on).filter(|of| of.size >= CLOSING * of.least);
    match (found, going_on) {
        // the later estimate is more exact, but the earlier beginning is kept
        (Some(found), Some(known)) => Some(Rise { run: known.run.min(found.run), ..found }),
        (found, known) => found.or(known),
    }
}

/// The verdict of a steady rise; `limit` is the change that would be a warning without it.
fn of_rise(rise: &Rise, observed: &Observed, baseline: f64, limit: f64) -> Verdict {
    let [size, least] = apart(100.0 * rise.size, 100.0 * rise.least);
    Verdict::Out {
        severity: Severity::Warning,
        score: rise.size,
        threshold: rise.least,
        value: observed.measured_ratio() * baseline,
        baseline: rise.level * baseline,
        message: format!(
            "friction at equal speed and temperature has risen by {size} % (limit {least} %) over {} tests, {:.2} % a test, from \
             a friction index of {:.3}; the rise is steadier than chance, while a single change needs {:.1} % of the \
             baseline to be a warning; latest test: friction index {:.3}, standard error {:.3}{}; check lubrication, \
             gearbox and brake",
            rise.tests,
            100.0 * rise.rate,
            rise.level,
            100.0 * limit,
            observed.measured_ratio(),
            observed.std_error,
            observed.common_words(),
        ),
        why: Why::default(),
    }
}

/// Message with the smoothed change, which decides, followed by the result of this run alone.
fn message(change: f64, threshold: f64, observed: &Observed, friction: &FrictionHistory) -> String {
    let (side, advice) = if change > 0.0 {
        ("above", "check lubrication, gearbox and brake")
    } else {
        ("below", "a change of grease or a loose transmission lowers friction; check after maintenance")
    };
    let (what, why) = match (observed.source, friction.source) {
        (Source::Index, _) => ("friction at equal speed and temperature", ""),
        (Source::Warm, _) => ("warm friction", ", as measured since the run has no friction index"),
        (Source::Excitation, Source::Index) => {
            ("friction identified from the excitation", ", since the run has no friction index")
        }
        (Source::Excitation, _) => {
            ("friction identified from the excitation", ", since the recordings have no friction stage")
        }
    };
    let [percent, limit] = apart(100.0 * change.abs(), 100.0 * threshold);
    let alone = match (observed.ratio - 1.0) * change.signum() >= threshold {
        true => "",
        false => ", within the limit by itself",
    };
    let figure = match friction.baseline(observed.source) {
        Some(baseline) => format!(
            "{:.2} Nm against {:.2} Nm at {:.0} % speed",
            observed.torque,
            baseline.torque,
            100.0 * baseline.speed_fraction
        ),
        None => format!(
            "friction index {:.3}, standard error {:.3}{}",
            observed.measured_ratio(),
            observed.std_error,
            observed.common_words()
        ),
    };
    let until = match change.abs() < threshold {
        true => format!(", over below {:.1} %", 100.0 * CLOSING * threshold),
        false => String::new(),
    };
    format!(
        "{what}, smoothed over the tests, is {percent} % {side} the joint's baseline (limit {limit} %{until}); \
         latest test{alone}: {figure}{why}; {advice}"
    )
}

#[cfg(test)]
mod tests;
