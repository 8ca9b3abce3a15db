//! State of each joint after the latest test, and the knowledge about it.

use super::history::friction_history::{FrictionHistory, Observed, Source};
use super::joint_detectors::friction_drift;
use super::series::JointSeries;
use super::without_result::why;
use crate::statistics::descriptive::{median, robust_deviation};
use armwatch_model::analysis::JointSummary;
use armwatch_model::anomaly::epoch::not_compared;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, JointHealth, Knowledge, RunSummary};

/// Largest standard deviation of friction from test to test, as a fraction of the baseline, for a change to be reported
/// as a fraction. Healthy joints have 0.01 to 0.05. Above this limit friction is small against measurement noise.
const MOST_SCATTER: f64 = 0.1;

/// Largest difference between a healthy joint and the median of the arm in the change of friction by temperature,
/// logarithms: a constant, and a share of the median. At 5 to 35 °C ambient, healthy joints reach half of it.
const MOST_OWN: f64 = 0.12;
const MOST_OWN_SHARE: f64 = 0.6;
/// Fewest joints for the comparison of one with the others.
const FEWEST_JOINTS: usize = 4;
/// Speeds compare within this fraction of the largest.
pub(super) const SAME_SPEED: f64 = 1e-3;

/// State of a joint after the latest test of the history, which is not empty. `found` are the joint's anomalies.
pub(super) fn health(history: &[RunSummary], series: &JointSeries<'_>, found: &[Anomaly]) -> JointHealth {
    let has_result = |summary: &Option<&JointSummary>| summary.is_some_and(JointSummary::has_result);
    let last_result = series.runs.iter().rposition(has_result);
    let friction = friction_of_latest(series).filter(|observed| deviation(series, observed) <= MOST_SCATTER);
    let (knowledge, reason) = knowledge(history, series, found, last_result);
    JointHealth {
        joint: series.joint,
        friction_index: friction.map(Observed::measured_ratio),
        friction_quantity: friction.map(|observed| observed.source.quantity()),
        knowledge,
        reason,
        last_result_run_id: last_result.map(|run| history[run].run_id),
        forecast: friction_drift::outlook(series),
    }
}

/// Friction of the latest run, if it compares with the baseline.
fn friction_of_latest<'a>(series: &'a JointSeries<'_>) -> Option<&'a Observed> {
    let last = series.runs.len() - 1;
    series.friction.runs.last().filter(|observed| observed.run == last)
}

fn knowledge(
    history: &[RunSummary],
    series: &JointSeries<'_>,
    found: &[Anomaly],
    last_result: Option<usize>,
) -> (Knowledge, Option<String>) {
    let last = history.len() - 1;
    let latest = &history[last];
    let friction = series.friction;
    let known = || known_before(history, friction.runs.last(), last_result);
    if latest.is_without_result() {
        return (
            Knowledge::NoResult,
            Some(format!("the latest test gave no result: {}; {}", why(latest), known())),
        );
    }
    if last_result != Some(last) {
        let words =
            format!("the latest test gave no result of this joint{}; {}", of_refused(latest), known());
        return (Knowledge::Unsettled, Some(words));
    }
    if friction.is_learning() {
        let needed = series.settings.baseline_runs.max(1);
        let words = format!("{} of {needed} tests of the baseline", friction.learnt_runs);
        return (Knowledge::Learning, Some(words));
    }
    let Some(observed) = friction_of_latest(series) else {
        let since =
            not_compared(history, series.joint).map_or_else(String::new, |words| format!("{words}: "));
        let words = format!(
            "{since}friction of the latest test does not compare with the baseline: no stage of it was as warm \
             as in the baseline, at the same speed{}; {}",
            of_refused(latest),
            known()
        );
        return (Knowledge::Unsettled, Some(words));
    };
    let change = observed.ratio - 1.0;
    let limit = single_run_limit(series, observed);
    if change.abs() >= limit && !shows_change(found, friction, latest) {
        let words = format!(
            "one test {:.0} % {} the joint's baseline, more than the {:.0} % that chance explains; to be \
             confirmed by the next test",
            100.0 * change.abs(),
            if change > 0.0 { "above" } else { "below" },
            100.0 * limit
        );
        return (Knowledge::Unsettled, Some(words));
    }
    if let Some(words) = taken_for_temperature(history, series) {
        return (Knowledge::Unsettled, Some(words));
    }
    let words = [refused_part(latest), not_watched(observed), not_told(series, observed)];
    let words: Vec<String> = words.into_iter().flatten().collect();
    (Knowledge::Compared, Some(words.join("; ")).filter(|words| !words.is_empty()))
}

/// The reason for doubting an index that differs from measured friction in this joint alone.
///
/// The index attributes the rest of the change of warm friction to temperature,
/// `t_j = ln(measured_j / usual_j) - ln(index_j)`. Joints of one arm share it, as far as healthy joints do:
/// `|t_j - m| <= MOST_OWN + MOST_OWN_SHARE |m|` with the median `m` of all joints.
fn taken_for_temperature(history: &[RunSummary], series: &JointSeries<'_>) -> Option<String> {
    let count = series.settings.baseline_runs.max(1);
    let latest = history.last()?;
    let of_joint = |of: &JointSummary| {
        let (now, index) = (of.warm_friction?, of.friction_index?);
        let usual: Vec<f64> = history
            .iter()
            .filter_map(|run| run.joints.iter().find(|other| other.joint == of.joint)?.warm_friction)
            .filter(|usual| (usual.speed_fraction - now.speed_fraction).abs() < SAME_SPEED)
            .map(|usual| usual.torque)
            .take(count)
            .collect();
        let measured = now.torque / median(&usual).filter(|_| usual.len() == count)?;
        let taken = (measured / index.value).ln();
        taken.is_finite().then_some((of.joint, measured, index.value, taken))
    };
    let joints: Vec<_> = latest.joints.iter().filter_map(of_joint).collect();
    let (_, measured, index, own) = *joints.iter().find(|(joint, ..)| *joint == series.joint)?;
    let common = median(&joints.iter().map(|(.., taken)| *taken).collect::<Vec<f64>>())?;
    let is_odd =
        joints.len() >= FEWEST_JOINTS && (own - common).abs() > MOST_OWN + MOST_OWN_SHARE * common.abs();
    is_odd.then(|| {
        format!(
            "measured friction is {:+.0} % against the baseline and the friction index {index:.3}: the difference counts as \
             temperature, which no other joint of the arm shows so; check this joint",
            100.0 * (measured - 1.0)
        )
    })
}

/// The reason for the missing checks of a test without a friction stage.
fn not_watched(latest: &Observed) -> Option<String> {
    (latest.source == Source::Excitation).then(|| {
        "the latest test has no friction stage: jumps of friction inside a test, friction that varies from cycle to cycle and \
         another warm-up are not looked for"
            .to_owned()
    })
}

/// The reason for reporting no change of a joint with hardly any friction.
fn not_told(series: &JointSeries<'_>, latest: &Observed) -> Option<String> {
    let scatter = deviation(series, latest);
    (scatter > MOST_SCATTER).then(|| {
        format!(
            "friction is too small for a change in per cent: it scatters from test to test by {:.0} % of itself",
            100.0 * scatter
        )
    })
}

/// Least change of friction that makes the latest run alone odd, as a fraction of the baseline: more than chance in one
/// healthy run (Shewhart chart). A single run moves the EWMA of [`friction_drift`] by its weight only, so it needs a
/// separate limit. Infinite within the baseline.
fn single_run_limit(series: &JointSeries<'_>, latest: &Observed) -> f64 {
    if series.friction.is_learnt_from(latest) {
        return f64::INFINITY;
    }
    friction_drift::judged(series).limit.limits().threshold(deviation(series, latest))
}

/// Standard deviation of the latest run's friction against the baseline, as a fraction of the baseline.
fn deviation(series: &JointSeries<'_>, latest: &Observed) -> f64 {
    let friction = &series.friction;
    // a baseline of a few runs may scatter less than healthy runs do
    let before: Vec<f64> = friction.runs.iter().rev().skip(1).map(|observed| observed.ratio).collect();
    let usual_scatter = robust_deviation(&before).unwrap_or(0.0).max(friction.spread);
    let own = friction.variance(latest).max(latest.uncertainty().powi(2));
    (own.max(usual_scatter * usual_scatter) + friction.baseline_variance).sqrt()
}

/// Returns true if the latest run shows a drift or step of friction. Such an anomaly needs no confirmation.
fn shows_change(found: &[Anomaly], friction: &FrictionHistory, latest: &RunSummary) -> bool {
    let of_friction = |anomaly: &Anomaly| {
        matches!(anomaly.kind, AnomalyKind::Drift | AnomalyKind::Step)
            && anomaly.quantity.is_of_one_cause(friction.source.quantity())
    };
    found.iter().any(|anomaly| of_friction(anomaly) && anomaly.last_run_id == latest.run_id)
}

fn of_refused(run: &RunSummary) -> String {
    refused_part(run).map_or_else(String::new, |words| format!(" ({words})"))
}

/// The reason for a run with some refused cycles.
fn refused_part(run: &RunSummary) -> Option<String> {
    (run.refused_cycles > 0).then(|| {
        let cause = run.refusals.first().map_or("no reason is stored", |of| &of.cause.sentence);
        format!("{} of {} cycles of the latest test were refused: {cause}", run.refused_cycles, run.cycles)
    })
}

/// The joint's latest results, with their time.
fn known_before(history: &[RunSummary], latest: Option<&Observed>, last_result: Option<usize>) -> String {
    let day = |run: usize| history[run].started_at.strftime("%Y-%m-%d %H:%M").to_string();
    match (latest, last_result) {
        (Some(observed), _) => {
            let what = match observed.source {
                Source::Index | Source::Warm => "friction index",
                Source::Excitation => "friction of the excitation over that of the baseline",
            };
            format!("known last: {what} {:.3} of {} UTC", observed.measured_ratio(), day(observed.run))
        }
        (None, Some(run)) => format!("the latest result is of {} UTC", day(run)),
        (None, None) => "no test gave a result yet".into(),
    }
}

#[cfg(test)]
mod tests;
