//! `GET /metrics`: figures for Prometheus, from what is stored. Names and units follow its conventions.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;

use super::answer::Refusal;
use super::shared::Shared;
use crate::store::{Counts, FleetHealthRow, HealthStatus, Store};

/// Version of the text format.
const FORMAT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// States of an anomaly that is not settled.
const STATES: [&str; 4] = ["open", "acknowledged", "shelved", "maintenance"];

/// All figures, as they are now.
pub async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Refusal> {
    shared.access.check(&headers)?;
    let store = shared.looking().await?;
    let text = written(store).await.map_err(|error| Refusal::internal(&error))?;
    Ok(([(CONTENT_TYPE, FORMAT)], text).into_response())
}

async fn written(store: &Store) -> Result<String, crate::store::StoreError> {
    let Counts { streaming_runs, complete_runs, quarantined_runs, cycles, .. } = store.counts().await?;
    let health = store.fleet_health().await?;
    let mut out = Exposition::default();
    out.family("armwatch_build_info", "Version of the program.");
    out.sample(&[("version", env!("CARGO_PKG_VERSION"))], 1.0);
    out.family("armwatch_runs", "Runs in the database, by where they stand.");
    for (status, count) in
        [("complete", complete_runs), ("quarantined", quarantined_runs), ("streaming", streaming_runs)]
    {
        out.sample(&[("status", status)], count as f64);
    }
    out.family("armwatch_cycles", "Cycles in the database.");
    out.sample(&[], cycles as f64);
    out.family(
        "armwatch_robots_to_conclude",
        "Robots whose history has changed since conclusions were drawn.",
    );
    out.sample(&[], store.stale_robots().await?.len() as f64);
    of_joints(&mut out, &health);
    of_robots(&mut out, &health);
    of_anomalies(&mut out, store).await?;
    Ok(out.text)
}

/// Name and help of a family with a figure of each joint, and where the figure stands.
type Figure = (&'static str, &'static str, fn(&FleetHealthRow) -> Option<f64>);

fn of_joints(out: &mut Exposition, health: &[FleetHealthRow]) {
    out.family("armwatch_joint_status", "1 for the status that a joint has, 0 for the others.");
    for row in health {
        let joint = row.joint.to_string();
        for status in HealthStatus::ALL {
            let labels = [("robot", row.robot.as_str()), ("joint", &joint), ("status", status.name())];
            out.sample(&labels, f64::from(u8::from(row.status == status)));
        }
    }
    let figures: [Figure; 2] = [
        (
            "armwatch_joint_friction_index_ratio",
            "Friction of the latest test at equal speed and warmth against the joint's baseline, 1 is unchanged.",
            |row| row.friction_index,
        ),
        (
            "armwatch_joint_moving_rmsd_ratio",
            "RMSD of the latest test's excitation over the RMS of the measured torque, while the joint moves.",
            |row| row.moving_relative_rmsd,
        ),
    ];
    for (name, help, figure) in figures {
        out.family(name, help);
        for row in health {
            if let Some(value) = figure(row) {
                out.sample(&[("robot", &row.robot), ("joint", &row.joint.to_string())], value);
            }
        }
    }
}

fn of_robots(out: &mut Exposition, health: &[FleetHealthRow]) {
    let mut last: BTreeMap<&str, Timestamp> = BTreeMap::new();
    for row in health {
        if let Some(at) = row.last_result_at {
            let latest = last.entry(&row.robot).or_insert(at);
            *latest = at.max(*latest);
        }
    }
    out.family(
        "armwatch_robot_last_result_timestamp_seconds",
        "Start of the latest test that gave a result, seconds since 1970.",
    );
    for (robot, at) in last {
        out.sample(&[("robot", robot)], at.as_millisecond() as f64 / 1e3);
    }
}

async fn of_anomalies(out: &mut Exposition, store: &Store) -> Result<(), crate::store::StoreError> {
    let mut counts: BTreeMap<(&str, &str), u32> = BTreeMap::new();
    for severity in ["critical", "info", "warning"] {
        counts.extend(STATES.map(|state| ((severity, state), 0)));
    }
    let rows = store.anomalies_after(0).await?;
    for row in &rows {
        if let Some(count) = counts.get_mut(&(row.severity.name(), row.state.as_str())) {
            *count += 1;
        }
    }
    out.family("armwatch_anomalies", "Anomalies that are not settled, by severity and state.");
    for ((severity, state), count) in counts {
        out.sample(&[("severity", severity), ("state", state)], f64::from(count));
    }
    Ok(())
}

/// Text in the format that Prometheus reads.
#[derive(Debug, Default)]
struct Exposition {
    text: String,
    family: &'static str,
}

impl Exposition {
    /// Begins a family of gauges.
    fn family(&mut self, name: &'static str, help: &str) {
        self.family = name;
        // writing to a text does not fail
        let _ = write!(self.text, "# HELP {name} {help}\n# TYPE {name} gauge\n");
    }

    /// A sample of the family.
    fn sample(&mut self, labels: &[(&str, &str)], value: f64) {
        self.text.push_str(self.family);
        for (place, (name, value)) in labels.iter().enumerate() {
            let begin = if place == 0 { '{' } else { ',' };
            let _ = write!(self.text, "{begin}{name}=\"{}\"", escaped(value));
        }
        let end = if labels.is_empty() { "" } else { "}" };
        let _ = writeln!(self.text, "{end} {value}");
    }
}

/// The value of a label: backslash, quote and line end are written with a backslash.
fn escaped(value: &str) -> String {
    value.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped_and_a_family_has_one_head() {
        let mut out = Exposition::default();
        out.family("armwatch_x", "What it is.");
        out.sample(&[("robot", "a\"b\\c\nd"), ("joint", "1")], 0.5);
        out.sample(&[], 2.0);
        let expected = "# HELP armwatch_x What it is.\n# TYPE armwatch_x gauge\n\
                        armwatch_x{robot=\"a\\\"b\\\\c\\nd\",joint=\"1\"} 0.5\narmwatch_x 2\n";
        assert_eq!(out.text, expected);
    }
}
