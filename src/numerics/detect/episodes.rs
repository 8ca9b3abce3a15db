//! Joins the verdicts of successive runs into anomalies.

use jiff::Timestamp;

use super::detector::Detector;
use super::verdict::Verdict;
use crate::anomaly::{Anomaly, AnomalyKind, Onset};
use crate::robot::JointIndex;

/// Quiet runs that end an episode. This hysteresis makes one episode of a joint that stays about its limit.
const QUIET_RUNS: usize = 2;

/// Anomalies of one joint, detector by detector. `runs` has key and start of each entry of the history.
pub(super) fn anomalies<Series>(
    detectors: &[&dyn Detector<Series>],
    series: &Series,
    joint: JointIndex,
    runs: &[(i64, Timestamp)],
) -> Vec<Anomaly> {
    let of_detector = |detector: &&dyn Detector<Series>| {
        episodes(runs, Some(joint), detector.kind(), detector.quantity(series), detector.judge(series))
    };
    detectors.iter().flat_map(of_detector).collect()
}

/// Joins the verdicts of successive runs into episodes; `joint` is `None` for the whole arm.
pub(super) fn episodes(
    runs: &[(i64, Timestamp)],
    joint: Option<JointIndex>,
    kind: AnomalyKind,
    quantity: &'static str,
    verdicts: Vec<Verdict>,
) -> Vec<Anomaly> {
    let mut found: Vec<Anomaly> = Vec::new();
    let mut quiet = QUIET_RUNS;
    for (place, (&(run_id, started_at), verdict)) in runs.iter().zip(verdicts).enumerate() {
        match verdict {
            Verdict::Unknown => {}
            Verdict::Quiet => {
                quiet += 1;
                if quiet >= QUIET_RUNS {
                    found.iter_mut().for_each(|anomaly| anomaly.ended = true);
                }
            }
            Verdict::Out { severity, score, threshold, value, baseline, message, why } => {
                let (began, cycle) = why.onset.unwrap_or((place, None));
                let (onset_id, onset_at) = runs[began];
                let now = Anomaly {
                    joint,
                    kind,
                    quantity,
                    severity,
                    score,
                    threshold,
                    value,
                    baseline,
                    peak_value: value,
                    peak_score: score,
                    first_cycle: cycle.filter(|_| began == place),
                    first_run_id: run_id,
                    last_run_id: run_id,
                    first_seen_at: started_at,
                    last_seen_at: started_at,
                    onset: Onset { run_id: onset_id, cycle, at: onset_at },
                    odds: why.odds,
                    alternatives: why.alternatives,
                    ended: false,
                    message: joint.map_or(message.clone(), |joint| format!("joint {joint}: {message}")),
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
