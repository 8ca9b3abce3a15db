//! Tests that gave no result, what is known of each joint since when, and when the next test is due.

use jiff::{SignedDuration, Timestamp};

use super::friction::{Compared, Drift};
use super::verdict::{DetectSettings, Verdict};
use crate::analysis::JointSummary;
use crate::analysis::refusal::{Channel, RefusalCause};
use crate::anomaly::{Anomaly, AnomalyKind, JointHealth, Knowledge, RunRefusal, RunSummary, Severity};
use crate::numerics::statistics::descriptive::median;
use crate::robot::JointIndex;

/// Intervals between tests that the usual one is taken from: the latest ones, so that a changed habit is learnt.
const INTERVALS: usize = 20;
/// Fewest intervals that are a habit.
const FEWEST_INTERVALS: usize = 3;

/// Episodes of tests without result, one for each cause that a channel and a joint have. An episode ends with the
/// first test that gives a result again.
pub(super) fn without_result(history: &[RunSummary]) -> Vec<Anomaly> {
    let mut found: Vec<Anomaly> = Vec::new();
    for run in history {
        if !run.is_without_result() {
            found.iter_mut().for_each(|anomaly| anomaly.ended = true);
            continue;
        }
        for shown in causes_of(run) {
            let now = shown.anomaly(run);
            let key = |of: &Anomaly| (of.joint, of.kind, of.quantity);
            match found.iter_mut().find(|of| !of.ended && key(of) == key(&now)) {
                Some(open) => open.go_on(now),
                None => found.push(now),
            }
        }
    }
    found
}

/// What an anomaly is to say of a test without result.
struct Shown {
    channel: Channel,
    joint: Option<JointIndex>,
    first_cycle: Option<u32>,
    words: String,
}

impl Shown {
    fn anomaly(self, run: &RunSummary) -> Anomaly {
        let (kind, quantity) = match self.channel {
            Channel::Position => (AnomalyKind::Sensor, "position_signal"),
            Channel::Velocity => (AnomalyKind::Sensor, "velocity_signal"),
            Channel::Torque => (AnomalyKind::Sensor, "torque_signal"),
            Channel::Time => (AnomalyKind::Sensor, "time_stamps"),
            Channel::Rows => (AnomalyKind::Sensor, "rows"),
            Channel::Motion => (AnomalyKind::Accuracy, "motion"),
            Channel::Model => (AnomalyKind::Accuracy, "model"),
        };
        Anomaly {
            joint: self.joint,
            kind,
            quantity,
            severity: Severity::Warning,
            // the share of cycles without result
            score: 1.0,
            threshold: 1.0,
            value: f64::NAN,
            baseline: f64::NAN,
            peak_value: f64::NAN,
            peak_score: 1.0,
            first_cycle: self.first_cycle,
            first_run_id: run.run_id,
            last_run_id: run.run_id,
            first_seen_at: run.started_at,
            last_seen_at: run.started_at,
            ended: false,
            message: format!("the test gave no result: {}", self.words),
        }
    }
}

/// Causes that refused at least half of a run's cycles, or the first one. A check that fails for most joints alike is
/// the whole arm's.
fn causes_of(run: &RunSummary) -> Vec<Shown> {
    let Some(first) = run.refusals.first() else {
        let words = format!("{}; check what the export holds", why(run));
        return vec![Shown { channel: Channel::Motion, joint: None, first_cycle: None, words }];
    };
    let most: Vec<&RunRefusal> =
        run.refusals.iter().filter(|of| 2 * of.cycles >= run.cycles.max(1)).collect();
    let most = if most.is_empty() { vec![first] } else { most };
    let mut shown: Vec<Shown> = Vec::new();
    for of in &most {
        let cause = &of.cause;
        let alike: Vec<&&RunRefusal> = most
            .iter()
            .filter(|other| is_alike(&other.cause, cause) && other.cause.joint.is_some())
            .collect();
        let joint = cause.joint.filter(|_| alike.len() < 2 || 2 * alike.len() <= run.joints.len());
        match shown.iter_mut().find(|known| known.channel == cause.channel && known.joint == joint) {
            // all of it is in the reason of each cycle
            Some(known) => known.first_cycle = known.first_cycle.min(Some(of.first_cycle)),
            None => {
                let words = match joint.is_none() && alike.len() > 1 {
                    true => format!("{} ({} joints alike)", cause.sentence, alike.len()),
                    false => cause.sentence.clone(),
                };
                shown.push(Shown { channel: cause.channel, joint, first_cycle: Some(of.first_cycle), words });
            }
        }
    }
    shown
}

fn is_alike(a: &RefusalCause, b: &RefusalCause) -> bool {
    a.finding == b.finding && a.channel == b.channel
}

/// Where a joint stands after the latest test of the history, which is not empty.
pub(super) fn health(
    history: &[RunSummary],
    series: &[Option<&JointSummary>],
    joint: JointIndex,
    drift: &Drift,
    settings: &DetectSettings,
) -> JointHealth {
    let has_result = |run: &usize| series[*run].is_some_and(JointSummary::has_result);
    let last_result = (0..series.len()).rev().find(has_result);
    let last = series.len() - 1;
    let of_latest = drift.latest.filter(|compared| compared.observed.run == last);
    let (knowledge, reason) = judged(history, drift, last_result, settings);
    JointHealth {
        joint,
        friction_index: of_latest.map(|compared| compared.observed.ratio),
        friction_quantity: of_latest.map(|compared| compared.observed.source.quantity()),
        knowledge,
        reason,
        last_result_run_id: last_result.map(|run| history[run].run_id),
    }
}

fn judged(
    history: &[RunSummary],
    drift: &Drift,
    last_result: Option<usize>,
    settings: &DetectSettings,
) -> (Knowledge, Option<String>) {
    let last = history.len() - 1;
    let latest = &history[last];
    let known = || known_before(history, drift.latest, last_result);
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
    if drift.learning {
        let words =
            format!("{} of {} tests of the baseline", drift.learnt_runs, settings.baseline_runs.max(1));
        return (Knowledge::Learning, Some(words));
    }
    match drift.latest.filter(|compared| compared.observed.run == last) {
        None => {
            let words = format!(
                "friction of the latest test does not compare with the baseline: no stage of it was as warm as in the \
                 baseline{}; {}",
                of_refused(latest),
                known()
            );
            (Knowledge::Unsettled, Some(words))
        }
        Some(compared) if is_odd(compared) && matches!(drift.verdicts[last], Verdict::Quiet) => {
            let change = compared.observed.ratio - 1.0;
            let words = format!(
                "one test {:.0} % {} the joint's baseline, more than the {:.0} % that chance explains; to be confirmed \
                 by the next test",
                100.0 * change.abs(),
                if change > 0.0 { "above" } else { "below" },
                100.0 * compared.bound
            );
            (Knowledge::Unsettled, Some(words))
        }
        Some(_) => (Knowledge::Compared, refused_part(latest)),
    }
}

fn is_odd(compared: Compared) -> bool {
    (compared.observed.ratio - 1.0).abs() >= compared.bound
}

/// Why a run has no result, by the cause of most of its cycles.
fn why(run: &RunSummary) -> String {
    let cycles = match (run.cycles, run.refused_cycles) {
        (0, _) => return "it holds no whole cycle".into(),
        (1, 0) => return "its only cycle is doubtful, as its remarks say".into(),
        (all, 0) => return format!("all {all} cycles are doubtful, as their remarks say"),
        (1, 1) => "its only cycle was refused".into(),
        (all, refused) if all == refused => format!("all {all} cycles were refused"),
        (all, refused) => format!("{refused} of {all} cycles were refused"),
    };
    match run.refusals.first() {
        Some(refusal) => format!("{cycles}: {}", refusal.cause.sentence),
        None => cycles,
    }
}

fn of_refused(run: &RunSummary) -> String {
    refused_part(run).map_or_else(String::new, |words| format!(" ({words})"))
}

/// What to say of a run with some cycles refused.
fn refused_part(run: &RunSummary) -> Option<String> {
    (run.refused_cycles > 0).then(|| {
        let cause = run.refusals.first().map_or("no reason is stored", |of| &of.cause.sentence);
        format!("{} of {} cycles of the latest test were refused: {cause}", run.refused_cycles, run.cycles)
    })
}

/// What the joint's latest results say, and since when.
fn known_before(history: &[RunSummary], latest: Option<Compared>, last_result: Option<usize>) -> String {
    let day = |run: usize| history[run].started_at.strftime("%Y-%m-%d %H:%M").to_string();
    match (latest, last_result) {
        (Some(compared), _) => {
            let Compared { observed, .. } = compared;
            format!("known last: friction index {:.3} of {} UTC", observed.ratio, day(observed.run))
        }
        (None, Some(run)) => format!("the latest result is of {} UTC", day(run)),
        (None, None) => "no test gave a result yet".into(),
    }
}

/// When the next test should have begun at the latest: `factor` times the robot's usual interval, the median of the
/// latest ones, after its latest test. `None` with too few tests.
pub(super) fn expected_by(history: &[RunSummary], factor: f64) -> Option<Timestamp> {
    let intervals: Vec<f64> = history
        .windows(2)
        .rev()
        .map(|pair| pair[1].started_at.duration_since(pair[0].started_at).as_secs_f64())
        .filter(|seconds| *seconds > 0.0)
        .take(INTERVALS)
        .collect();
    let usual = median(&intervals).filter(|_| intervals.len() >= FEWEST_INTERVALS)?;
    let wait = SignedDuration::try_from_secs_f64(factor * usual).ok()?;
    history.last()?.started_at.checked_add(wait).ok()
}

#[cfg(test)]
mod tests;
