//! Anomalies to people. Today the log; delivery to other places gets its files beside this one.

use crate::anomaly::{Anomaly, Severity};

/// Logs an anomaly that a run of `robot` opened.
pub fn log_opened(robot: &str, anomaly: &Anomaly) {
    let (kind, joint, quantity) = (anomaly.kind.name(), anomaly.joint.number(), anomaly.quantity);
    match anomaly.severity {
        Severity::Info => tracing::info!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Warning => tracing::warn!(robot, joint, kind, quantity, "{}", anomaly.message),
        Severity::Critical => tracing::error!(robot, joint, kind, quantity, "{}", anomaly.message),
    }
}
