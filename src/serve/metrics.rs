//! `GET /metrics`: metrics for Prometheus, from the process and from the database. Names and units follow its
//! conventions.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeGaugeValue, prometheus_text};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;

use super::answer::Refusal;
use super::shared::Shared;
use super::status::readiness;
use crate::metrics::{Disk, Metrics};
use armwatch_config::UNKNOWN_ROBOT;
use armwatch_model::text;
use armwatch_store::{
    BlockedFile, DatabaseSize, FleetHealthRow, HealthStatus, RouteCounts, Store, StoreError, StoredCounts,
};

/// States of an anomaly that is not closed.
const STATES: [&str; 4] = ["open", "acknowledged", "shelved", "maintenance"];

/// Time limit for reading the database. After it, the database counts as unreadable.
const READ_WITHIN: Duration = Duration::from_secs(8);

/// All metrics with their current values. Those of the process are available even if the database cannot be read.
pub async fn metrics(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Refusal> {
    shared.access.check(&headers)?;
    let reading = async {
        // the error is already logged
        let store = shared.looking().await.ok()?;
        StoredFigures::read(store)
            .await
            .inspect_err(|error| tracing::warn!(%error, "metrics without those of the database"))
            .ok()
    };
    // metrics of the process are available also while the disk of the database hangs
    let stored = match shared.metrics.answers(Disk::Database) {
        true => tokio::time::timeout(READ_WITHIN, reading).await.unwrap_or_default(),
        false => None,
    };
    let uploads = match shared.uploads {
        Some(_) => Some(readiness(&shared).await.obstacle.is_none()),
        None => None,
    };
    let text = written(&shared.metrics, MetricFigures { stored, uploads }).map_err(Refusal::internal)?;
    Ok(([(CONTENT_TYPE, prometheus_text::CONTENT_TYPE)], text).into_response())
}

/// Values from the database.
#[derive(Debug)]
struct StoredFigures {
    counts: StoredCounts,
    health: Vec<FleetHealthRow>,
    to_conclude: usize,
    /// By severity and state.
    anomalies: BTreeMap<(&'static str, &'static str), u64>,
    quarantined: Vec<(String, u64)>,
    blocked: Vec<BlockedFile>,
    routes: Vec<RouteCounts>,
    size: Option<DatabaseSize>,
}

impl StoredFigures {
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
            blocked: store.blocked_files().await?,
            routes: store.deliveries_by_route().await?,
            size: store.size().await,
        })
    }
}

fn written(process: &Metrics, figures: MetricFigures) -> Result<String, fmt::Error> {
    let mut text = String::new();
    process.write(&mut text)?;
    let mut registry = Registry::default();
    registry.register_collector(Box::new(figures));
    prometheus_text::encode(&mut text, &registry)?;
    Ok(text)
}

/// Values of the program, and those of the database unless it cannot be read.
#[derive(Debug)]
struct MetricFigures {
    stored: Option<StoredFigures>,
    /// True if uploads are accepted; `None` if they are off.
    uploads: Option<bool>,
}

impl Collector for MetricFigures {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let (to, stored) = (&mut encoder, self.stored.as_ref());
        let version = [("version", env!("CARGO_PKG_VERSION"))];
        gauges(to, "armwatch_build_info", "Version of the program.", [(version, 1)])?;
        let is_up = [([], u32::from(stored.is_some()))];
        gauges(to, "armwatch_database_up", "1 while the database can be read, 0 otherwise.", is_up)?;
        if let Some(are_taken) = self.uploads {
            let help = "1 while uploads are taken, 0 while the spool cannot be written or its disk is full.";
            gauges(to, "armwatch_uploads_up", help, [([], u32::from(are_taken))])?;
        }
        stored.map_or(Ok(()), |stored| {
            of_database(to, stored)?;
            of_joints(to, &stored.health)?;
            of_robots(to, stored)?;
            of_routes(to, &stored.routes)
        })
    }
}

fn of_database(to: &mut DescriptorEncoder<'_>, stored: &StoredFigures) -> fmt::Result {
    let StoredCounts { robots, streaming_runs, complete_runs, quarantined_runs, cycles, .. } = stored.counts;
    let runs =
        [("complete", complete_runs), ("quarantined", quarantined_runs), ("streaming", streaming_runs)];
    let runs = runs.map(|(status, count)| ([("status", status)], count));
    gauges(to, "armwatch_runs", "Runs in the database, by where they stand.", runs)?;
    gauges(to, "armwatch_cycles", "Cycles in the database.", [([], cycles)])?;
    gauges(to, "armwatch_robots", "Robots in the database.", [([], robots)])?;
    gauges(
        to,
        "armwatch_robots_to_conclude",
        "Robots whose history has changed since conclusions were drawn.",
        [([], stored.to_conclude)],
    )?;
    let sizes = stored.size.map(|DatabaseSize { database, log }| [("database", database), ("log", log)]);
    gauges(
        to,
        "armwatch_database_size_bytes",
        "Sizes of the files of the database.",
        sizes.into_iter().flatten().map(|(file, size)| ([("file", file)], size)),
    )?;
    gauges(
        to,
        "armwatch_anomalies",
        "Anomalies that are not settled, by severity and state.",
        stored
            .anomalies
            .iter()
            .map(|((severity, state), count)| ([("severity", *severity), ("state", *state)], *count)),
    )
}

/// Name and help of a metric per joint, and the function that returns its value.
type JointFigure = (&'static str, &'static str, fn(&FleetHealthRow) -> Option<f64>);

fn of_joints(to: &mut DescriptorEncoder<'_>, health: &[FleetHealthRow]) -> fmt::Result {
    let joints: Vec<String> = health.iter().map(|row| row.joint.to_string()).collect();
    let joints =
        || health.iter().zip(&joints).map(|(row, joint)| (row, ("joint", &**joint), ("robot", &*row.robot)));
    gauges(
        to,
        "armwatch_joint_status",
        "1 for the status that a joint has, 0 for the others.",
        joints().flat_map(|(row, joint, robot)| {
            HealthStatus::ALL
                .map(|status| ([joint, robot, ("status", status.name())], u32::from(row.status == status)))
        }),
    )?;
    let of_joints: [JointFigure; 2] = [
        (
            "armwatch_joint_friction_index_ratio",
            "Friction of the latest test at equal speed and temperature against the joint's baseline, 1 is unchanged.",
            |row| row.friction_index,
        ),
        (
            "armwatch_joint_moving_rmsd_ratio",
            "RMSD of the latest test's excitation over the RMS of the measured torque, while the joint moves.",
            |row| row.moving_relative_rmsd,
        ),
    ];
    for (name, help, figure) in of_joints {
        let values = joints().filter_map(|(row, joint, robot)| Some(([joint, robot], figure(row)?)));
        gauges(to, name, help, values)?;
    }
    Ok(())
}

fn of_robots(to: &mut DescriptorEncoder<'_>, stored: &StoredFigures) -> fmt::Result {
    let mut last: BTreeMap<&str, Timestamp> = BTreeMap::new();
    for row in &stored.health {
        if let Some(at) = row.last_result_at {
            let latest = last.entry(&row.robot).or_insert(at);
            *latest = at.max(*latest);
        }
    }
    gauges(
        to,
        "armwatch_robot_last_result_timestamp_seconds",
        "Start of the latest test that gave a result, seconds since 1970.",
        last.into_iter().map(|(robot, at)| ([("robot", robot)], seconds(at))),
    )?;
    gauges(
        to,
        "armwatch_robot_quarantined_exports",
        "Exports in quarantine that somebody has to look at, by the robot of their names.",
        stored.quarantined.iter().map(|(robot, exports)| ([("robot", &**robot)], *exports)),
    )?;
    // 0 for each robot with a result, so that a rule sees when the last file is no longer blocked
    let mut blocked: BTreeMap<&str, u64> = stored.health.iter().map(|row| (&*row.robot, 0)).collect();
    for file in &stored.blocked {
        *blocked.entry(file.robot.as_deref().unwrap_or(UNKNOWN_ROBOT)).or_default() += 1;
    }
    gauges(
        to,
        "armwatch_robot_blocked_files",
        "Growing files that cannot be read on before they are corrected or have settled, by the robot of their names.",
        blocked.into_iter().map(|(robot, files)| ([("robot", robot)], files)),
    )
}

fn of_routes(to: &mut DescriptorEncoder<'_>, routes: &[RouteCounts]) -> fmt::Result {
    let routes = || routes.iter().map(|of| (of, ("route", &*of.route)));
    gauges(
        to,
        "armwatch_deliveries",
        "Messages about alarms, by route and where they stand.",
        routes().flat_map(|(of, route)| {
            [("failed", of.failed), ("pending", of.pending), ("sent", of.sent), ("suppressed", of.suppressed)]
                .map(|(state, count)| ([route, ("state", state)], count))
        }),
    )?;
    gauges(
        to,
        "armwatch_delivery_route_failures",
        "Attempts in a row that did not reach the receiver of a route.",
        routes().map(|(of, route)| ([route], of.failures)),
    )?;
    gauges(
        to,
        "armwatch_delivery_oldest_due_timestamp_seconds",
        "Since when the oldest waiting message of a route could have been sent, seconds since 1970.",
        routes().filter_map(|(of, route)| Some(([route], seconds(of.oldest_due_at?)))),
    )
}

/// Seconds since 1970.
fn seconds(at: Timestamp) -> f64 {
    at.as_millisecond() as f64 / 1e3
}

/// Writes a family of gauges, each with its labels and value. Omits a family without gauges.
fn gauges<'a, const N: usize, V: EncodeGaugeValue>(
    to: &mut DescriptorEncoder<'_>,
    name: &str,
    help: &str,
    samples: impl IntoIterator<Item = ([(&'a str, &'a str); N], V)>,
) -> fmt::Result {
    let mut samples = samples.into_iter().peekable();
    if samples.peek().is_some() {
        let mut family = to.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for (labels, value) in samples {
            let labels = labels.map(|(name, value)| (name, text::distinct(value).into_owned()));
            family.encode_family(&labels)?.encode_gauge(&value)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped_and_no_family_is_there_twice() {
        let process = Metrics::counting();
        process.cycle_stored(None);
        let stored = StoredFigures {
            counts: StoredCounts { robots: 1, complete_runs: 2, ..StoredCounts::default() },
            health: Vec::new(),
            to_conclude: 0,
            anomalies: BTreeMap::new(),
            quarantined: vec![("a\"b\\c".into(), 3), ("d\n\u{1b}[2J\u{202e}".into(), 4)],
            blocked: vec![BlockedFile {
                robot: None,
                source_name: "log.csv".into(),
                source_path: "/data/log.csv".into(),
                run_id: None,
                line: Some(12),
                remedy: "correct the row".into(),
                blocked_at: Timestamp::UNIX_EPOCH,
                message: "cannot be read".into(),
            }],
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
        let text = written(&process, MetricFigures { stored: Some(stored), uploads: Some(true) }).unwrap();
        for line in [
            "armwatch_robot_quarantined_exports{robot=\"a\\\"b\\\\c\"} 3",
            "armwatch_robot_quarantined_exports{robot=\"d\\\\u{a}\\\\u{1b}[2J\\\\u{202e}\"} 4",
            "armwatch_robot_blocked_files{robot=\"unknown\"} 1",
            "armwatch_deliveries{route=\"shift\",state=\"failed\"} 1",
            "armwatch_delivery_route_failures{route=\"shift\"} 4",
            "armwatch_delivery_oldest_due_timestamp_seconds{route=\"shift\"} 1767602820.0",
            "armwatch_database_size_bytes{file=\"database\"} 4096",
            "armwatch_database_up 1",
            "armwatch_cycles_stored_total 1",
            "armwatch_runs{status=\"complete\"} 2",
        ] {
            assert!(text.lines().any(|one| one == line), "{line} is not in\n{text}");
        }
        let mut families: Vec<&str> = text.lines().filter_map(|line| line.strip_prefix("# TYPE ")).collect();
        families.sort_unstable();
        assert!(families.is_sorted_by(|one, other| one < other), "{families:?}");
    }

    #[test]
    fn without_the_database_the_process_still_tells_of_itself() {
        let text =
            written(&Metrics::counting(), MetricFigures { stored: None, uploads: Some(false) }).unwrap();
        assert!(text.contains("\narmwatch_database_up 0\n"), "{text}");
        assert!(text.contains("armwatch_cycles_stored_total 0") && !text.contains("armwatch_runs"), "{text}");
    }
}
