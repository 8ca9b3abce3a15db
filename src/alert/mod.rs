//! Anomalies to people. Today the log; delivery to other places gets its files beside this one.

use crate::anomaly::Severity;
use crate::store::AnomalyRow;

/// Logs an anomaly that a run opened.
pub fn log_opened(anomaly: &AnomalyRow) {
    let AnomalyRow { robot, kind, quantity, .. } = anomaly;
    let joint = anomaly.joint.number();
    match anomaly.severity {
        Severity::Info => tracing::info!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Warning => tracing::warn!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Critical => tracing::error!(robot, joint, kind, quantity, "{}", anomaly.message),
    }
}
