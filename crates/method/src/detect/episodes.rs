//! Joins the verdicts of successive runs into anomalies.

use jiff::Timestamp;

use super::detector::Detector;
use super::verdict::Verdict;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Anomaly, AnomalyKind, Onset};
use armwatch_model::robot::JointIndex;

/// Quiet runs that end an episode.
const QUIET_RUNS: usize = 2;
/// Factor on the number of quiet runs if an episode came back. Otherwise a value near its limit would open and end
/// episodes again and again (a chattering alarm, EEMUA 191).
const AGAIN: usize = 4;
/// Most quiet runs that an episode needs to end. After that many, the next anomaly is a new episode, which two quiet
/// runs end.
const MOST_QUIET_RUNS: usize = 32;

/// Returns true for events as opposed to states: each recurrence of an event is a new episode.
fn is_event(kind: AnomalyKind, quantity: Quantity) -> bool {
    kind == AnomalyKind::Payload || quantity == Quantity::Contact
}

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

/// Joins the verdicts of successive runs into episodes; `joint` is `None` for the whole arm. An anomaly that soon comes
/// back needs more quiet runs to end, except if it is an event.
pub(super) fn episodes(
    runs: &[(i64, Timestamp)],
    joint: Option<JointIndex>,
    kind: AnomalyKind,
    quantity: Quantity,
    verdicts: Vec<Verdict>,
) -> Vec<Anomaly> {
    let again = if is_event(kind, quantity) { 1 } else { AGAIN };
    let mut found: Vec<Anomaly> = Vec::new();
    let (mut quiet, mut needed) = (0, QUIET_RUNS);
    for (place, (&(run_id, started_at), verdict)) in runs.iter().zip(verdicts).enumerate() {
        match verdict {
            Verdict::Unknown => {}
            Verdict::Quiet => {
                quiet += 1;
                if quiet >= needed {
                    found.iter_mut().for_each(|anomaly| anomaly.ended = true);
                }
            }
            Verdict::Out { severity, score, threshold, value, baseline, message, why } => {
                let (began, cycle) = why.onset.unwrap_or((place, None));
                let (onset_id, onset_at) = runs[began];
                let now = Anomaly {
                    joint,
                    kind,
                    quantity: why.quantity.unwrap_or(quantity),
                    severity,
                    score,
                    threshold,
                    value,
                    baseline,
                    peak_value: value,
                    peak_score: score,
                    peak_severity: severity,
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
                let goes_on =
                    |of: &Anomaly| !of.ended && (quiet < QUIET_RUNS || severity <= of.peak_severity);
                if found.last().is_some_and(|last| !goes_on(last)) {
                    found.iter_mut().for_each(|anomaly| anomaly.ended = true);
                }
                match found.last_mut().filter(|anomaly| !anomaly.ended) {
                    Some(open) => open.go_on(now),
                    None => {
                        let came_back = !found.is_empty() && quiet < MOST_QUIET_RUNS;
                        needed = if came_back { (again * needed).min(MOST_QUIET_RUNS) } else { QUIET_RUNS };
                        found.push(now);
                    }
                }
                quiet = 0;
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::verdict::Why;
    use armwatch_model::anomaly::Severity;

    fn found(out: impl Fn(usize) -> bool, count: usize) -> Vec<(i64, i64, bool)> {
        joined(|run| out(run).then_some(Severity::Warning), count, AnomalyKind::Oscillation)
    }

    fn joined(
        out: impl Fn(usize) -> Option<Severity>,
        count: usize,
        kind: AnomalyKind,
    ) -> Vec<(i64, i64, bool)> {
        let runs: Vec<(i64, Timestamp)> = (0..count as i64)
            .map(|run| (run, Timestamp::from_second(86_400 * run).expect("a time")))
            .collect();
        let verdict = |run| match out(run) {
            None => Verdict::Quiet,
            Some(severity) => Verdict::Out {
                severity,
                score: 1.0,
                threshold: 1.0,
                value: 1.0,
                baseline: 1.0,
                message: String::new(),
                why: Why::default(),
            },
        };
        let verdicts = (0..count).map(verdict).collect();
        let all = episodes(&runs, None, kind, Quantity::FrictionSwing, verdicts);
        all.iter().map(|of| (of.first_run_id, of.last_run_id, of.ended)).collect()
    }

    #[test]
    fn two_quiet_runs_end_an_episode() {
        assert_eq!(found(|run| run == 3 || run == 5, 8), [(3, 5, true)]);
        assert_eq!(found(|run| run == 3 || run == 5, 7), [(3, 5, false)]);
    }

    #[test]
    fn what_comes_back_again_and_again_becomes_one_episode() {
        // once in seven runs: the second episode needs eight quiet runs to end
        assert_eq!(found(|run| run % 7 == 6, 365), [(6, 6, true), (13, 363, false)]);
        assert_eq!(found(|run| run % 7 == 6 && run < 100, 365), [(6, 6, true), (13, 97, true)]);
    }

    #[test]
    fn a_torque_signal_whose_noise_becomes_an_offset_has_the_peak_of_the_offset() {
        use Quantity::{TorqueGainRatio, TorqueNoiseRatio, TorqueOffset};
        let runs = [0, 1, 2].map(|run| (run, Timestamp::from_second(86_400 * run).expect("a time")));
        let out = |quantity, score, threshold, value, baseline| Verdict::Out {
            severity: Severity::Warning,
            score,
            threshold,
            value,
            baseline,
            message: String::new(),
            why: Why { quantity: Some(quantity), ..Why::default() },
        };
        let peak = |verdicts| {
            let found = episodes(&runs, None, AnomalyKind::Sensor, TorqueOffset, verdicts);
            found.iter().map(|of| (of.quantity, of.peak_value, of.peak_score)).collect::<Vec<_>>()
        };
        // four times the usual noise, then -0.5 and -0.3 Nm
        assert_eq!(
            peak(vec![
                out(TorqueNoiseRatio, 4.0, 1.5, 4.0, 1.0),
                out(TorqueOffset, 0.5, 0.0, -0.5, 0.0),
                out(TorqueOffset, 0.3, 0.0, -0.3, 0.0)
            ]),
            [(TorqueOffset, -0.5, 0.5)]
        );
        // gains of -8 % and +5 %
        let gains =
            vec![out(TorqueGainRatio, 0.08, 0.03, 0.92, 1.0), out(TorqueGainRatio, 0.05, 0.03, 1.05, 1.0)];
        assert_eq!(peak(gains), [(TorqueGainRatio, 0.92, 0.08)]);
    }

    #[test]
    fn something_worse_is_another_episode() {
        let severity = |run: usize| match run {
            3 | 7 => Some(Severity::Info),
            // two quiet runs before the warning, none before the critical one
            12 => Some(Severity::Warning),
            13 => Some(Severity::Critical),
            _ => None,
        };
        let found = joined(severity, 20, AnomalyKind::Oscillation);
        assert_eq!(found, [(3, 3, true), (7, 7, true), (12, 13, false)]);
    }

    #[test]
    fn events_that_come_back_stay_events() {
        let often = joined(|run| (run % 7 == 6).then_some(Severity::Warning), 28, AnomalyKind::Payload);
        assert_eq!(often, [(6, 6, true), (13, 13, true), (20, 20, true), (27, 27, false)]);
    }

    #[test]
    fn what_comes_back_after_long_is_another_episode() {
        let late = |run: usize| [3, 40, 80].contains(&run);
        assert_eq!(found(late, 83), [(3, 3, true), (40, 40, true), (80, 80, true)]);
    }
}
