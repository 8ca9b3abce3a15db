//! One alarm of the arm in place of several that have one cause.

use armwatch_model::anomaly::Anomaly;

/// `like` as an alarm of the arm that lasts as long as all of these together, with the severity of the worst of them.
pub(super) fn one_of_arm(all: &[&Anomaly], like: &Anomaly) -> Anomaly {
    let first = all.iter().copied().min_by_key(|of| (of.first_seen_at, of.joint)).unwrap_or(like);
    let last = all.iter().copied().max_by_key(|of| of.last_seen_at).unwrap_or(like);
    Anomaly {
        joint: None,
        severity: all.iter().map(|of| of.severity).max().unwrap_or(like.severity),
        peak_severity: all.iter().map(|of| of.peak_severity).max().unwrap_or(like.peak_severity),
        first_run_id: first.first_run_id,
        first_seen_at: first.first_seen_at,
        first_cycle: first.first_cycle,
        onset: first.onset,
        last_run_id: last.last_run_id,
        last_seen_at: last.last_seen_at,
        ended: all.iter().all(|of| of.ended),
        ..like.clone()
    }
}

/// Joints of these alarms, each once, in order.
pub(super) fn joints_of(all: &[&Anomaly]) -> Vec<String> {
    let mut joints: Vec<_> = all.iter().filter_map(|of| of.joint).collect();
    joints.sort_unstable();
    joints.dedup();
    joints.iter().map(ToString::to_string).collect()
}
