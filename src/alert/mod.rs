//! Anomalies to people. Today the log; delivery to other places gets its files beside this one.

use crate::anomaly::Severity;
use crate::store::{AnomalyRow, OverdueRobot};

/// Logs an anomaly that a run opened.
pub fn log_opened(anomaly: &AnomalyRow) {
    let AnomalyRow { robot, kind, quantity, .. } = anomaly;
    // none where the cause is the whole arm's
    let joint = anomaly.joint_number();
    match anomaly.severity {
        Severity::Info => tracing::info!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Warning => tracing::warn!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Critical => tracing::error!(robot, joint, kind, quantity, "{}", anomaly.message),
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
