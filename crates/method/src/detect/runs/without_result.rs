//! Tests without result: every cycle was refused or doubtful, or the test has no cycle.
//!
//! Such a test is a warning at once, without a limit. Its kind is `sensor` if a channel is at fault, and `accuracy` if
//! the motion or the model is. The causes are those that refused at least half of the cycles, otherwise the first one.
//! The first test with a result ends the episode.
//!
//! This is no [`Detector`](crate::detect::detector::Detector): it evaluates a run as a whole, its anomaly may be of the
//! whole arm, and it has no quantity with a baseline.

use armwatch_model::analysis::refusal::{Channel, NO_POSITIONS, RefusalCause};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset, RunRefusal, RunSummary, Severity};
use armwatch_model::robot::JointIndex;

/// Episodes of tests without result, one per cause that a channel and a joint have. An episode ends with the next test
/// that has a result.
pub(super) fn without_result(history: &[RunSummary]) -> Vec<Anomaly> {
    let mut found: Vec<Anomaly> = Vec::new();
    for run in history {
        // exports without positions are expected to have no result
        if run.refusals.iter().any(|of| of.cause.finding == NO_POSITIONS) {
            continue;
        }
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

/// Content of an anomaly for a test without result.
struct MissingResult {
    channel: Channel,
    joint: Option<JointIndex>,
    first_cycle: Option<u32>,
    words: String,
}

impl MissingResult {
    fn anomaly(self, run: &RunSummary) -> Anomaly {
        let (kind, quantity) = match self.channel {
            Channel::Position => (AnomalyKind::Sensor, Quantity::PositionSignal),
            Channel::Velocity => (AnomalyKind::Sensor, Quantity::VelocitySignal),
            Channel::Torque => (AnomalyKind::Sensor, Quantity::TorqueSignal),
            Channel::Time => (AnomalyKind::Sensor, Quantity::TimeStamps),
            Channel::Rows => (AnomalyKind::Sensor, Quantity::Rows),
            Channel::Motion => (AnomalyKind::Accuracy, Quantity::Motion),
            Channel::Model => (AnomalyKind::Accuracy, Quantity::Model),
        };
        Anomaly {
            joint: self.joint,
            kind,
            quantity,
            severity: Severity::Warning,
            // the fraction of cycles without result
            score: 1.0,
            threshold: 1.0,
            value: f64::NAN,
            baseline: f64::NAN,
            peak_value: f64::NAN,
            peak_score: 1.0,
            peak_severity: Severity::Warning,
            first_cycle: self.first_cycle,
            first_run_id: run.run_id,
            last_run_id: run.run_id,
            first_seen_at: run.started_at,
            last_seen_at: run.started_at,
            onset: Onset { run_id: run.run_id, cycle: self.first_cycle, at: run.started_at },
            odds: None,
            alternatives: Vec::new(),
            ended: false,
            message: format!("the test gave no result: {}", self.words),
        }
    }
}

/// Causes that refused at least half of a run's cycles, or the first one. A check that fails in the same way for most
/// joints is reported for the whole arm.
fn causes_of(run: &RunSummary) -> Vec<MissingResult> {
    let Some(first) = run.refusals.first() else {
        let words = format!("{}; check what the export holds", why(run));
        return vec![MissingResult { channel: Channel::Motion, joint: None, first_cycle: None, words }];
    };
    let most: Vec<&RunRefusal> =
        run.refusals.iter().filter(|of| 2 * of.cycles >= run.cycles.max(1)).collect();
    let most = if most.is_empty() { vec![first] } else { most };
    let mut shown: Vec<MissingResult> = Vec::new();
    for of in &most {
        let cause = &of.cause;
        let alike: Vec<&&RunRefusal> = most
            .iter()
            .filter(|other| is_alike(&other.cause, cause) && other.cause.joint.is_some())
            .collect();
        let joint = cause.joint.filter(|_| alike.len() < 2 || 2 * alike.len() <= run.joints.len());
        match shown.iter_mut().find(|known| known.channel == cause.channel && known.joint == joint) {
            // the reason of each cycle has the rest
            Some(known) => known.first_cycle = known.first_cycle.min(Some(of.first_cycle)),
            None => {
                let words = match joint.is_none() && alike.len() > 1 {
                    true => format!("{} ({} joints alike)", cause.sentence, alike.len()),
                    false => cause.sentence.clone(),
                };
                shown.push(MissingResult {
                    channel: cause.channel,
                    joint,
                    first_cycle: Some(of.first_cycle),
                    words,
                });
            }
        }
    }
    shown
}

fn is_alike(a: &RefusalCause, b: &RefusalCause) -> bool {
    a.finding == b.finding && a.channel == b.channel
}

/// The reason for a run without result, from the cause of most of its cycles.
pub(super) fn why(run: &RunSummary) -> String {
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

#[cfg(test)]
mod tests;
