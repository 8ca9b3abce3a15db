//! Detectors: anomalies from a robot's stored history.
//!
//! Pure functions over the summaries of all complete runs, oldest first. The whole history is
//! judged anew each time, so a run that arrives late falls into its place, and the same history
//! always gives the same anomalies. Every joint is compared with its own baseline: two arms of one
//! model differ by half in friction when both are healthy.

use super::verdict::Verdict;
use crate::numerics::detect::verdict::DetectSettings;
use crate::numerics::detect::verdict::apart;
use jiff::Timestamp;

use super::friction::drift;
use super::results::{expected_by, health, without_result};
use crate::analysis::JointSummary;
use crate::anomaly::{Anomaly, AnomalyKind, Findings, RunSummary, Severity};
use crate::numerics::statistics::descriptive::median;
use crate::robot::JointIndex;

/// Swings of the relative RMSD below this are noise of a good fit, whatever their ratio: healthy
/// joints show 0.0012 to 0.003 (thesis 5.1.4).
const MIN_SWING: f64 = 0.004;

/// A relative RMSD beyond its limit that is within this factor of the joint's own baseline is how
/// the joint has always been: worth knowing, not worth a call.
const ACCURACY_AS_EVER: f64 = 1.3;

/// Runs without a sign that end an episode.
const QUIET_RUNS: usize = 2;

/// Looks at the complete runs of one robot, oldest first.
#[must_use]
pub fn detect(history: &[RunSummary], settings: &DetectSettings) -> Findings {
    let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
    let mut findings = Findings::default();
    let moments: Vec<(i64, Timestamp)> = history.iter().map(|run| (run.run_id, run.started_at)).collect();
    for joint in (0..joints).map(JointIndex::new) {
        let series: Vec<Option<&JointSummary>> =
            history.iter().map(|run| run.joints.iter().find(|summary| summary.joint == joint)).collect();
        let drift = drift(&series, settings);
        findings.health.push(health(history, &series, joint, &drift, settings));
        for (kind, quantity, verdicts) in [
            (AnomalyKind::Drift, drift.quantity, drift.verdicts),
            (AnomalyKind::Oscillation, "moving_relative_rmsd", oscillation(&series, settings)),
            (AnomalyKind::Accuracy, "moving_relative_rmsd", accuracy(&series, settings)),
        ] {
            findings.anomalies.extend(episodes(&moments, joint, kind, quantity, &verdicts));
        }
    }
    findings.anomalies.extend(without_result(history));
    findings.expected_by = expected_by(history, settings.overdue_factor);
    findings
}

/// Swing of the relative RMSD from cycle to cycle against the joint's usual swing.
fn oscillation(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Vec<Verdict> {
    let swings: Vec<Option<f64>> =
        series.iter().map(|summary| summary.and_then(|s| s.rmsd_swing).map(|swing| swing.value)).collect();
    let first: Vec<f64> = swings.iter().flatten().take(settings.baseline_runs).copied().collect();
    let Some(baseline) = median(&first).filter(|_| first.len() >= settings.baseline_runs.max(1)) else {
        return vec![Verdict::Unknown; series.len()];
    };
    let threshold = (settings.oscillation_ratio * baseline).max(MIN_SWING);
    swings
        .iter()
        .map(|swing| match swing {
            None => Verdict::Unknown,
            Some(swing) if *swing < threshold => Verdict::Quiet,
            Some(swing) => Verdict::Out {
                severity: if *swing >= 2.0 * threshold { Severity::Critical } else { Severity::Warning },
                score: *swing,
                threshold,
                value: *swing,
                baseline,
                message: format!(
                    "relative RMSD swings by {:.2} % of torque from cycle to cycle, usually {:.2} %; look for a \
                     loose bearing, belt or encoder coupling",
                    100.0 * swing,
                    100.0 * baseline
                ),
            },
        })
        .collect()
}

/// Relative RMSD against absolute limits; milder where the joint has always been so.
fn accuracy(series: &[Option<&JointSummary>], settings: &DetectSettings) -> Vec<Verdict> {
    let values: Vec<Option<f64>> = series.iter().map(|s| s.and_then(|s| s.relative_rmsd)).collect();
    let first: Vec<f64> = values.iter().flatten().take(settings.baseline_runs).copied().collect();
    let baseline = median(&first).filter(|_| first.len() >= settings.baseline_runs.max(1));
    values
        .iter()
        .map(|value| match value {
            None => Verdict::Unknown,
            Some(value) if *value <= settings.accuracy_warning => Verdict::Quiet,
            Some(value) => {
                let critical = *value > settings.accuracy_critical;
                let as_ever =
                    baseline.is_some_and(|b| b > settings.accuracy_warning && *value <= ACCURACY_AS_EVER * b);
                let threshold = if critical { settings.accuracy_critical } else { settings.accuracy_warning };
                let [percent, limit] = apart(100.0 * value, 100.0 * threshold);
                Verdict::Out {
                    severity: match (as_ever, critical) {
                        (true, _) => Severity::Info,
                        (false, true) => Severity::Critical,
                        (false, false) => Severity::Warning,
                    },
                    score: *value,
                    threshold,
                    value: *value,
                    baseline: baseline.unwrap_or(settings.accuracy_warning),
                    message: format!(
                        "the identified model misses {percent} % of this joint's torque, limit {limit} %{}; check \
                         torque signal, payload and the robot's description",
                        if as_ever { ", as in its baseline" } else { "" }
                    ),
                }
            }
        })
        .collect()
}

/// Joins the verdicts of successive runs, given by key and start, into episodes of a joint.
pub(super) fn episodes(
    runs: &[(i64, Timestamp)],
    joint: JointIndex,
    kind: AnomalyKind,
    quantity: &'static str,
    verdicts: &[Verdict],
) -> Vec<Anomaly> {
    let mut found: Vec<Anomaly> = Vec::new();
    let mut quiet = QUIET_RUNS;
    for (&(run_id, started_at), verdict) in runs.iter().zip(verdicts) {
        match verdict {
            Verdict::Unknown => {}
            Verdict::Quiet => {
                quiet += 1;
                if quiet >= QUIET_RUNS {
                    found.iter_mut().for_each(|anomaly| anomaly.ended = true);
                }
            }
            Verdict::Out { severity, score, threshold, value, baseline, message } => {
                let now = Anomaly {
                    joint: Some(joint),
                    kind,
                    quantity,
                    severity: *severity,
                    score: *score,
                    threshold: *threshold,
                    value: *value,
                    baseline: *baseline,
                    peak_value: *value,
                    peak_score: *score,
                    first_cycle: None,
                    first_run_id: run_id,
                    last_run_id: run_id,
                    first_seen_at: started_at,
                    last_seen_at: started_at,
                    ended: false,
                    message: format!("joint {joint}: {message}"),
                };
                match found.last_mut().filter(|anomaly| !anomaly.ended) {
                    Some(open) => open.go_on(now),
                    None => found.push(now),
                }
                quiet = 0;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests;
