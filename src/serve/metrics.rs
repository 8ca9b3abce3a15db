//! `GET /metrics`: figures for Prometheus, those that the process keeps and those of what is stored. Names and units
//! follow its conventions.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use prometheus::{GaugeVec, Opts, Registry, TextEncoder};

use super::answer::Refusal;
use super::shared::Shared;
use crate::metrics::{Metrics, MetricsError};
use armwatch_store::{Counts, DatabaseSize, FleetHealthRow, HealthStatus, RouteCounts, Store, StoreError};

/// Version of the text format.
const FORMAT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// States of an anomaly that is not settled.
const STATES: [&str; 4] = ["open", "acknowledged", "shelved", "maintenance"];

/// All figures, as they are now. Those of the process are told also while the database cannot be read.
pub async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Refusal> {
    shared.access.check(&headers)?;
    let stored = match shared.looking().await {
        Ok(store) => match Stored::read(store).await {
            Ok(stored) => Some(stored),
            Err(error) => {
                tracing::warn!(%error, "metrics without those of the database");
                None
            }
        },
        // said where it was met
        Err(_) => None,
    };
    let text = written(&shared.metrics, stored.as_ref()).map_err(|error| Refusal::internal(&error))?;
    Ok(([(CONTENT_TYPE, FORMAT)], text).into_response())
}

/// What the database says.
#[derive(Debug)]
struct Stored {
    counts: Counts,
    health: Vec<FleetHealthRow>,
    to_conclude: usize,
    /// By severity and state.
    anomalies: BTreeMap<(&'static str, &'static str), u64>,
    quarantined: Vec<(String, u64)>,
    routes: Vec<RouteCounts>,
    size: Option<DatabaseSize>,
}

impl Stored {
    async fn read(store: &Store) -> Result<Self, StoreError> {
        let mut anomalies: BTreeMap<(&str, &str), u64> = BTreeMap::new();
        for severity in ["critical", "info", "warning"] {
            anomalies.extend(STATES.map(|state| ((severity, state), 0)));
        }
        for found in &store.unsettled_counts().await? {
            let state = STATES.iter().find(|state| **state == found.state);
            if let Some(count) = state.and_then(|state| anomalies.get_mut(&(found.severity.name(), *state))) {
                *count = found.anomalies;
            }
        }
        Ok(Self {
            counts: store.counts().await?,
            health: store.fleet_health().await?,
            to_conclude: store.stale_robots().await?.len(),
            anomalies,
            quarantined: store.quarantined_by_robot().await?,
            routes: store.deliveries_by_route().await?,
            size: store.size().await,
        })
    }
}

fn written(process: &Metrics, stored: Option<&Stored>) -> Result<String, MetricsError> {
    let figures = Figures::default();
    figures
        .one("armwatch_build_info", "Version of the program.", &["version"])?
        .set(&[env!("CARGO_PKG_VERSION")], 1.0);
    let is_up = f64::from(u8::from(stored.is_some()));
    figures
        .one("armwatch_database_up", "1 while the database can be read, 0 otherwise.", &[])?
        .set(&[], is_up);
    if let Some(stored) = stored {
        of_database(&figures, stored)?;
        of_joints(&figures, &stored.health)?;
        of_robots(&figures, stored)?;
        of_routes(&figures, &stored.routes)?;
    }
    let mut families = process.gather();
    families.extend(figures.0.gather());
    families.sort_by(|one, other| one.name().cmp(other.name()));
    TextEncoder::new().encode_to_string(&families)
}

fn of_database(figures: &Figures, stored: &Stored) -> Result<(), MetricsError> {
    let Counts { robots, streaming_runs, complete_runs, quarantined_runs, cycles, .. } = stored.counts;
    let runs = figures.one("armwatch_runs", "Runs in the database, by where they stand.", &["status"])?;
    for (status, count) in
        [("complete", complete_runs), ("quarantined", quarantined_runs), ("streaming", streaming_runs)]
    {
        runs.set(&[status], count as f64);
    }
    figures.one("armwatch_cycles", "Cycles in the database.", &[])?.set(&[], cycles as f64);
    figures.one("armwatch_robots", "Robots in the database.", &[])?.set(&[], robots as f64);
    figures
        .one(
            "armwatch_robots_to_conclude",
            "Robots whose history has changed since conclusions were drawn.",
            &[],
        )?
        .set(&[], stored.to_conclude as f64);
    if let Some(DatabaseSize { database, log }) = stored.size {
        let size =
            figures.one("armwatch_database_size_bytes", "Sizes of the files of the database.", &["file"])?;
        size.set(&["database"], database as f64);
        size.set(&["log"], log as f64);
    }
    let anomalies = figures.one(
        "armwatch_anomalies",
        "Anomalies that are not settled, by severity and state.",
        &["severity", "state"],
    )?;
    for ((severity, state), count) in &stored.anomalies {
        anomalies.set(&[severity, state], *count as f64);
    }
    Ok(())
}

/// Name and help of a family with a figure of each joint, and where the figure stands.
type Figure = (&'static str, &'static str, fn(&FleetHealthRow) -> Option<f64>);

fn of_joints(figures: &Figures, health: &[FleetHealthRow]) -> Result<(), MetricsError> {
    let states = figures.one(
        "armwatch_joint_status",
        "1 for the status that a joint has, 0 for the others.",
        &["robot", "joint", "status"],
    )?;
    for row in health {
        let joint = row.joint.to_string();
        for status in HealthStatus::ALL {
            let has = f64::from(u8::from(row.status == status));
            states.set(&[&row.robot, &joint, status.name()], has);
        }
    }
    let of_joints: [Figure; 2] = [
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
    for (name, help, figure) in of_joints {
        let family = figures.one(name, help, &["robot", "joint"])?;
        for row in health {
            if let Some(value) = figure(row) {
                family.set(&[&row.robot, &row.joint.to_string()], value);
            }
        }
    }
    Ok(())
}

fn of_robots(figures: &Figures, stored: &Stored) -> Result<(), MetricsError> {
    let mut last: BTreeMap<&str, Timestamp> = BTreeMap::new();
    for row in &stored.health {
        if let Some(at) = row.last_result_at {
            let latest = last.entry(&row.robot).or_insert(at);
            *latest = at.max(*latest);
        }
    }
    let results = figures.one(
        "armwatch_robot_last_result_timestamp_seconds",
        "Start of the latest test that gave a result, seconds since 1970.",
        &["robot"],
    )?;
    for (robot, at) in last {
        results.set(&[robot], seconds(at));
    }
    let quarantined = figures.one(
        "armwatch_robot_quarantined_exports",
        "Exports in quarantine that somebody has to look at, by the robot of their names.",
        &["robot"],
    )?;
    for (robot, exports) in &stored.quarantined {
        quarantined.set(&[robot], *exports as f64);
    }
    Ok(())
}

fn of_routes(figures: &Figures, routes: &[RouteCounts]) -> Result<(), MetricsError> {
    let messages = figures.one(
        "armwatch_deliveries",
        "Messages about alarms, by route and where they stand.",
        &["route", "state"],
    )?;
    let failures = figures.one(
        "armwatch_delivery_route_failures",
        "Attempts in a row that did not reach the receiver of a route.",
        &["route"],
    )?;
    let oldest = figures.one(
        "armwatch_delivery_oldest_due_timestamp_seconds",
        "Since when the oldest waiting message of a route could have been sent, seconds since 1970.",
        &["route"],
    )?;
    for of in routes {
        let states = [
            ("pending", of.pending),
            ("sent", of.sent),
            ("failed", of.failed),
            ("suppressed", of.suppressed),
        ];
        for (state, count) in states {
            messages.set(&[&of.route, state], count as f64);
        }
        failures.set(&[&of.route], of.failures as f64);
        if let Some(at) = of.oldest_due_at {
            oldest.set(&[&of.route], seconds(at));
        }
    }
    Ok(())
}

/// Seconds since 1970.
fn seconds(at: Timestamp) -> f64 {
    at.as_millisecond() as f64 / 1e3
}

/// Gauges of one answer.
#[derive(Debug, Default)]
struct Figures(Registry);

impl Figures {
    /// Begins a family of gauges.
    fn one(&self, name: &str, help: &str, labels: &[&str]) -> Result<Family, MetricsError> {
        let family = GaugeVec::new(Opts::new(name, help), labels)?;
        self.0.register(Box::new(family.clone()))?;
        Ok(Family(family))
    }
}

/// A family of gauges.
#[derive(Debug)]
struct Family(GaugeVec);

impl Family {
    /// Sets the sample with the values of the family's labels.
    fn set(&self, labels: &[&str], value: f64) {
        // there is an error for a wrong number of labels only
        if let Ok(gauge) = self.0.get_metric_with_label_values(labels) {
            gauge.set(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped_and_figures_of_the_process_stand_among_those_of_the_database() {
        let process = Metrics::counting().unwrap();
        process.cycle_stored(None);
        let stored = Stored {
            counts: Counts { robots: 1, complete_runs: 2, ..Counts::default() },
            health: Vec::new(),
            to_conclude: 0,
            anomalies: BTreeMap::new(),
            quarantined: vec![("a\"b\\c\nd".into(), 3)],
            routes: vec![RouteCounts {
                route: "shift".into(),
                pending: 2,
                sent: 5,
                failed: 1,
                suppressed: 0,
                failures: 4,
                oldest_due_at: Timestamp::from_second(1_767_602_820).ok(),
            }],
            size: Some(DatabaseSize { database: 4096, log: 0 }),
        };
        let text = written(&process, Some(&stored)).unwrap();
        for line in [
            "armwatch_robot_quarantined_exports{robot=\"a\\\"b\\\\c\\nd\"} 3",
            "armwatch_deliveries{route=\"shift\",state=\"failed\"} 1",
            "armwatch_delivery_route_failures{route=\"shift\"} 4",
            "armwatch_delivery_oldest_due_timestamp_seconds{route=\"shift\"} 1767602820",
            "armwatch_database_size_bytes{file=\"database\"} 4096",
            "armwatch_database_up 1",
            "armwatch_cycles_stored_total 1",
            "armwatch_runs{status=\"complete\"} 2",
        ] {
            assert!(text.lines().any(|one| one == line), "{line} is not in\n{text}");
        }
        let names: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")).collect();
        assert!(names.is_sorted(), "{names:?}");
    }

    #[test]
    fn without_the_database_the_process_still_tells_of_itself() {
        let text = written(&Metrics::counting().unwrap(), None).unwrap();
        assert!(text.contains("\narmwatch_database_up 0\n"), "{text}");
        assert!(text.contains("armwatch_cycles_stored_total 0") && !text.contains("armwatch_runs"), "{text}");
    }
}
