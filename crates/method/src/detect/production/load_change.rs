//! Another load in production: a part of the torque appears that neither the test nor friction explains. Only for logs
//! that were stored before causes were compared ([`causes`](super::causes)); for later logs, a load is one of the
//! causes.
//!
//! The quantity is the relative RMSD of a log that friction does not explain, a fraction of the torque. The baseline is
//! the median of the first [`LEARNING_LOGS`] logs after the last test. A log is out from 1.5 times the baseline on
//! ([`LOAD_RATIO`]), and from 0.02 above the baseline at least ([`LOAD_CHANGE`]). Its severity is always `info`, since
//! another tool or program has the same effect. Section "Causes in production logs" of docs/evidence/method.md counts
//! the loads that were found with these limits.

use super::causes::LogCauses;
use super::series::{JointLogs, LEARNING_LOGS, unexplained};
use crate::detect::detector::Detector;
use crate::detect::verdict::{Verdict, Why};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Limits of the deviation that friction does not explain: ratio to the baseline, and least difference as a part of the
/// torque, since a good fit varies by less than that.
const LOAD_RATIO: f64 = 1.5;
const LOAD_CHANGE: f64 = 0.02;

pub(super) struct LoadChange;

impl Detector<JointLogs<'_>> for LoadChange {
    fn kind(&self) -> AnomalyKind {
        AnomalyKind::Payload
    }

    fn quantity(&self, _: &JointLogs<'_>) -> Quantity {
        Quantity::ProductionRelativeRmsd
    }

    fn judge(&self, series: &JointLogs<'_>) -> Vec<Verdict> {
        // if causes are known, a load is one of them
        let known = |of: &Option<LogCauses>| if of.is_some() { Verdict::Quiet } else { Verdict::Unknown };
        let mut verdicts: Vec<Verdict> = series.causes.iter().map(known).collect();
        let part = |log: usize| series.of(log).filter(|_| series.causes[log].is_none()).map(unexplained);
        for since_test in series.by_test(part) {
            let level = since_test.level;
            let threshold = (LOAD_RATIO * level).max(level + LOAD_CHANGE);
            for (place, (log, part)) in since_test.values.into_iter().enumerate() {
                verdicts[log] = if place < LEARNING_LOGS || part < threshold {
                    Verdict::Quiet
                } else {
                    Verdict::Out {
                        severity: Severity::Info,
                        score: part,
                        threshold,
                        value: part,
                        baseline: level,
                        message: message(part, level),
                        why: Why::default(),
                    }
                };
            }
        }
        verdicts
    }
}

fn message(part: f64, level: f64) -> String {
    format!(
        "in production {:.1} % of the torque is neither predicted by the last test nor \
         friction, {:.1} % in the first logs since; nothing is wrong if the tool, the load or the \
         program changed, otherwise look for a contact or a torque signal that is off",
        100.0 * part,
        100.0 * level
    )
}

/// For each log, true if it has another load than the first logs after its test; its friction is meaningless then.
pub(super) fn with_other_load(series: &JointLogs<'_>) -> Vec<bool> {
    LoadChange.judge(series).iter().map(|verdict| matches!(verdict, Verdict::Out { .. })).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::production::fixtures::{USUAL, detected, history, wobble};

    #[test]
    fn another_load_is_no_wear() {
        let load = |i: usize, j: usize| if i >= 16 && j < 3 { 0.12 } else { USUAL };
        let found =
            detected(&history(20, |i, j| (wobble(i, j) + if i >= 16 { 0.2 } else { 0.0 }, load(i, j))));
        let kinds: Vec<_> = found
            .iter()
            .map(|of| (of.joint.expect("one").number(), of.kind, of.severity, of.first_run_id))
            .collect();
        let payload = |joint| (joint, AnomalyKind::Payload, Severity::Info, 17);
        assert_eq!(kinds, [payload(1), payload(2), payload(3)]);
    }
}
