//! Anomalies to people. Today the log; delivery to other places gets its files beside this one.

use crate::anomaly::Severity;
use crate::robot::JointIndex;
use crate::store::{AnomalyHistoryRow, OverdueRobot};

/// Logs what happened to an anomaly: what calls for a look by its severity, the rest as information.
pub fn log_event(event: &AnomalyHistoryRow) {
    let AnomalyHistoryRow { robot, kind, anomaly_id, message, .. } = event;
    // none where the cause is the whole arm's
    let joint = event.joint.map(JointIndex::number);
    let what = event.what.name();
    match event.severity {
        _ if !event.what.calls() => {
            tracing::info!(robot, joint, kind, anomaly_id, event = what, "{what}: {message}");
        }
        Severity::Info => tracing::info!(robot, joint, kind, anomaly_id, event = what, "{message}"),
        Severity::Warning => tracing::warn!(robot, joint, kind, anomaly_id, event = what, "{message}"),
        Severity::Critical => tracing::error!(robot, joint, kind, anomaly_id, event = what, "{message}"),
    }
}

/// Logs that the next test of a robot should have come.
pub fn log_overdue(overdue: &OverdueRobot) {
    let OverdueRobot { robot, expected_by } = overdue;
    tracing::warn!(
        robot,
        expected_by,
        "overdue: no test of this robot came by {expected_by}; check that it runs and that its exports arrive"
    );
}
