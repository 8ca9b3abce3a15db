//! `GET /v1/fleet`: the fleet at a glance.

use std::cmp::Reverse;
use std::collections::HashMap;
use std::sync::Arc;

use axum::Extension;
use axum::extract::{Query, State};
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::row::{ViewRow, language};
use crate::language::finding;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_store::{ResultTable, Store, StoredCounts, ViewRows, time_in_views};

/// Number of tests in a joint's history.
const TESTS: u32 = 30;

/// Most anomalies in an answer.
const ANOMALIES: usize = 200;

/// Most rows of one kind that are read for an answer.
const MOST: u32 = 100_000;

/// The fleet at a glance
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct Fleet {
    /// Time of the daemon's machine to the full minute, UTC, so that the same rows give the same answer
    #[schema(format = DateTime)]
    now: String,
    /// Numbers of robots, exports, runs, cycles and anomalies
    counts: FleetCounts,
    /// Smallest changes of friction that put a joint in alarm
    limits: FleetLimits,
    /// Robots by name
    robots: Vec<FleetRobot>,
    /// Anomalies that are not settled, the worst first, 200 at most: rows of the view anomalies
    anomalies: Vec<ViewRow>,
    /// Exports that are being read
    live: Vec<LiveExport>,
    /// Folders that the daemon searches for new exports, as the configuration names them
    watched: Vec<String>,
}

/// Numbers of robots, exports, runs, cycles and anomalies
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FleetCounts {
    /// Robots
    robots: usize,
    /// Exports that are being read
    streaming_runs: u64,
    /// Complete runs
    complete_runs: u64,
    /// Exports in quarantine
    quarantined_runs: u64,
    /// Cycles
    cycles: u64,
    /// Open anomalies of all severities, info included
    open_anomalies: u64,
    /// Open alarms: anomalies of severity warning or critical
    open_alarms: u64,
    /// Open anomalies of severity info, which are worth knowing
    open_infos: u64,
}

/// Smallest changes of friction that put a joint in alarm
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FleetLimits {
    /// Limit of a warning, as a fraction
    drift_warning_fraction: f64,
    /// Limit of a critical alarm, as a fraction
    drift_critical_fraction: f64,
}

/// State of a robot
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FleetRobot {
    /// Its name
    robot: String,
    /// Its model
    model: Option<String>,
    /// The worst state of its joints: critical, warning, overdue, unknown, learning or ok
    status: String,
    /// Start of its latest test, UTC
    last_run_at: Option<String>,
    /// Start of its latest test with a result, UTC
    last_result_at: Option<String>,
    /// When the next test is overdue, UTC
    expected_by: Option<String>,
    /// Open anomalies of all severities, info included
    open_anomalies: u64,
    /// Open alarms: anomalies of severity warning or critical
    open_alarms: u64,
    /// Open anomalies of severity info, which are worth knowing
    open_infos: u64,
    /// Its joints
    joints: Vec<FleetJoint>,
}

/// State of a joint, from the view fleet_health
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct FleetJoint {
    /// Its number, from 1
    joint: i64,
    /// Its state: critical, warning, overdue, unknown, learning or ok
    status: String,
    /// Why it is unknown or overdue
    reason: Option<String>,
    /// Friction relative to the joint's first tests; 1 is unchanged
    friction_index: Option<f64>,
    /// RMSD over the RMS of the measured torque while the joint moves
    moving_relative_rmsd: Option<f64>,
    /// Trend of friction: rising, falling or none
    trend: Option<String>,
    /// Day when friction is expected to reach the limit of a warning
    warning_by: Option<String>,
    /// Day when friction is expected to reach the limit of a critical alarm
    critical_by: Option<String>,
    /// Open anomalies of the joint and of the whole arm, of all severities
    open_anomalies: u64,
    /// Open alarms: anomalies of severity warning or critical
    open_alarms: u64,
    /// Open anomalies of severity info, which are worth knowing
    open_infos: u64,
    /// Friction indices of its latest 30 tests, the oldest first
    history: Vec<Option<f64>>,
}

/// An export that is being read
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct LiveExport {
    /// Its run
    run_id: i64,
    /// The robot
    robot: String,
    /// Name of the file
    source_name: String,
    /// Start of the recording, UTC
    started_at: Option<String>,
    /// Cycles stored so far
    cycles: u64,
}

/// Parameters of a request.
#[derive(Debug, Deserialize)]
pub struct FleetQuery {
    language: Option<String>,
}

/// The latest answer, and the version of the database that it describes.
#[derive(Debug, Default)]
pub struct FleetCache(tokio::sync::Mutex<Option<(i64, Fleet)>>);

/// The fleet at a glance
///
/// Every robot with its joints, alarms that are not settled, and exports that are being read.
#[utoipa::path(
    get, path = "/v1/fleet", tag = "Rows", operation_id = "fleet",
    params(("language" = Option<String>, Query, description = "en, it, de or zh: language of messages and reasons; English where it is not given")),
    responses(
        (status = 200, description = "The fleet", body = Fleet),
        (status = 400, description = "No such language", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn fleet(
    State(shared): State<Arc<Shared>>,
    Extension(kept): Extension<Arc<FleetCache>>,
    Query(asked): Query<FleetQuery>,
    headers: HeaderMap,
) -> Result<Json<Fleet>, Refusal> {
    shared.access.check(&headers)?;
    let spoken = asked.language.as_deref().map(language).transpose()?.unwrap_or_default();
    let store = shared.looking().await?;
    // concurrent requests wait for this answer, and share it until the database changes
    let mut kept = kept.0.lock().await;
    let version = store.data_version().await.map_err(Refusal::internal)?;
    let mut fleet = match kept.as_ref().filter(|(of, _)| *of == version) {
        Some((_, fleet)) => fleet.clone(),
        None => kept.insert((version, of_store(store).await?)).1.clone(),
    };
    drop(kept);
    let config = Arc::clone(&shared.config.borrow());
    fleet.limits = FleetLimits {
        drift_warning_fraction: config.detect.drift_warning,
        drift_critical_fraction: config.detect.drift_critical,
    };
    fleet.watched = config.watch.folders.iter().map(|folder| folder.display().to_string()).collect();
    fleet.anomalies = fleet.anomalies.into_iter().map(|row| row.in_language(spoken)).collect();
    for joint in fleet.robots.iter_mut().flat_map(|robot| &mut robot.joints) {
        joint.reason = joint.reason.take().map(|reason| finding(spoken, &reason).into_owned());
    }
    fleet.now = time_in_views(full_minute(Timestamp::now()));
    Ok(Json(fleet))
}

fn full_minute(time: Timestamp) -> Timestamp {
    Timestamp::from_second(time.as_second().div_euclid(60) * 60).unwrap_or(time)
}

/// The stored fleet, without values of the configuration and the clock.
async fn of_store(store: &Store) -> Result<Fleet, Refusal> {
    let counts = async { store.counts().await.map_err(Refusal::internal) };
    let (counts, read, mut anomalies, live) =
        tokio::try_join!(counts, robot_rows(store), anomalies(store), live(store))?;
    // counted before the list is cut, so that all counts use the same rows
    let open = OpenByPlace::of(&anomalies);
    anomalies.truncate(ANOMALIES);
    let robots = robots_with_joints(read, &open);
    let sum = |of: fn(&FleetRobot) -> u64| -> u64 { robots.iter().map(of).sum() };
    let StoredCounts { streaming_runs, complete_runs, quarantined_runs, cycles, .. } = counts;
    let counts = FleetCounts {
        robots: robots.len(),
        streaming_runs,
        complete_runs,
        quarantined_runs,
        cycles,
        open_anomalies: sum(|robot| robot.open_anomalies),
        open_alarms: sum(|robot| robot.open_alarms),
        open_infos: sum(|robot| robot.open_infos),
    };
    let limits = FleetLimits { drift_warning_fraction: 0.0, drift_critical_fraction: 0.0 };
    Ok(Fleet { now: String::new(), counts, limits, robots, anomalies, live, watched: Vec::new() })
}

/// Open anomalies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct OpenCounts {
    /// Anomalies of severity warning or critical.
    alarms: u64,
    /// Anomalies of severity info.
    infos: u64,
}

impl OpenCounts {
    fn all(self) -> u64 {
        self.alarms + self.infos
    }

    fn and(self, other: Self) -> Self {
        Self { alarms: self.alarms + other.alarms, infos: self.infos + other.infos }
    }
}

/// Open anomalies by robot and joint; those of the whole arm have no joint.
#[derive(Debug, Default)]
struct OpenByPlace(HashMap<String, HashMap<Option<i64>, OpenCounts>>);

impl OpenByPlace {
    fn of(anomalies: &[ViewRow]) -> Self {
        let mut found = Self::default();
        for row in anomalies.iter().filter(|row| row.text("state") == "open") {
            let joint = row.number("joint").map(|_| row.whole("joint"));
            let of_robot = found.0.entry(row.text("robot").to_owned()).or_default();
            let open = of_robot.entry(joint).or_default();
            match row.text("severity") {
                "info" => open.infos += 1,
                _ => open.alarms += 1,
            }
        }
        found
    }

    fn robot(&self, robot: &str) -> OpenCounts {
        let of_robot = self.0.get(robot).into_iter().flat_map(HashMap::values);
        of_robot.fold(OpenCounts::default(), |all, open| all.and(*open))
    }

    /// Counts of the joint and of the whole arm, as in the view `fleet_health`.
    fn joint(&self, robot: &str, joint: i64) -> OpenCounts {
        let of = |joint: Option<i64>| self.0.get(robot).and_then(|of| of.get(&joint)).copied();
        of(Some(joint)).unwrap_or_default().and(of(None).unwrap_or_default())
    }
}

/// Rows on robots: their friction indices, the rows of the view `fleet_health`, and their list.
struct RobotRows {
    indices: ResultTable,
    health: Vec<ViewRow>,
    listed: ResultTable,
}

async fn robot_rows(store: &Store) -> Result<RobotRows, Refusal> {
    let indices = async { store.recent_indices(TESTS).await.map_err(Refusal::unanswered) };
    let listed = async { store.robot_list().await.map_err(Refusal::unanswered) };
    let (indices, health, listed) =
        tokio::try_join!(indices, rows(store, "fleet_health", &[], Some("joint")), listed)?;
    Ok(RobotRows { indices, health, listed })
}

fn robots_with_joints(read: RobotRows, open: &OpenByPlace) -> Vec<FleetRobot> {
    let RobotRows { indices, health, listed } = read;
    let mut histories = histories(&indices);
    let mut joints: HashMap<String, Vec<ViewRow>> = HashMap::new();
    for row in health {
        joints.entry(row.text("robot").to_owned()).or_default().push(row);
    }
    let robot = |row: ViewRow| {
        let name = row.text("robot").to_owned();
        let joints = joints.remove(&name).unwrap_or_default();
        let latest = |column: &str| {
            let found = joints.iter().map(|of| of.text(column)).filter(|of| !of.is_empty()).max();
            found.map(str::to_owned)
        };
        let of_joint = |row: &ViewRow| {
            let joint = row.whole("joint");
            let open = open.joint(&name, joint);
            FleetJoint {
                joint,
                status: row.text("status").to_owned(),
                reason: row.maybe("reason"),
                friction_index: row.number("friction_index"),
                moving_relative_rmsd: row.number("moving_relative_rmsd"),
                trend: row.maybe("trend"),
                warning_by: row.maybe("warning_by"),
                critical_by: row.maybe("critical_by"),
                open_anomalies: open.all(),
                open_alarms: open.alarms,
                open_infos: open.infos,
                history: histories.remove(&(name.clone(), joint)).unwrap_or_default(),
            }
        };
        let of_robot = open.robot(&name);
        FleetRobot {
            model: row.maybe("model"),
            status: row.text("status").to_owned(),
            last_run_at: latest("last_run_at"),
            last_result_at: latest("last_result_at"),
            expected_by: latest("expected_by"),
            open_anomalies: of_robot.all(),
            open_alarms: of_robot.alarms,
            open_infos: of_robot.infos,
            joints: joints.iter().map(of_joint).collect(),
            robot: name,
        }
    };
    listed.objects().filter_map(ViewRow::of).map(robot).collect()
}

/// Friction indices by robot and joint, the oldest first.
fn histories(table: &ResultTable) -> HashMap<(String, i64), Vec<Option<f64>>> {
    let mut histories: HashMap<(String, i64), Vec<Option<f64>>> = HashMap::new();
    for row in table.objects().filter_map(ViewRow::of) {
        let of = (row.text("robot").to_owned(), row.whole("joint"));
        histories.entry(of).or_default().push(row.number("friction_index").map(shown));
    }
    histories
}

/// Rounds a value of a history to the digits that are visible in a small chart.
fn shown(index: f64) -> f64 {
    (index * 1e4).round() / 1e4
}

/// All anomalies that are not settled, the worst first, then the newest.
async fn anomalies(store: &Store) -> Result<Vec<ViewRow>, Refusal> {
    let severity = |row: &ViewRow| {
        ["critical", "warning"].iter().position(|of| row.text("severity") == *of).unwrap_or(2)
    };
    let table = store.unsettled_anomalies(MOST).await.map_err(Refusal::unanswered)?;
    let mut found: Vec<ViewRow> = table.objects().filter_map(ViewRow::of).collect();
    found.sort_by_key(|row| {
        (severity(row), Reverse(row.text("last_seen_at").to_owned()), row.whole("anomaly_id"))
    });
    Ok(found)
}

/// Exports whose cycles are being stored.
async fn live(store: &Store) -> Result<Vec<LiveExport>, Refusal> {
    let found = rows(store, "runs", &[("status", "streaming")], Some("started_at")).await?;
    let of = |row: ViewRow| LiveExport {
        run_id: row.whole("run_id"),
        robot: row.text("robot").to_owned(),
        source_name: row.text("source_name").to_owned(),
        started_at: row.maybe("started_at"),
        cycles: row.whole("cycles").unsigned_abs(),
    };
    Ok(found.into_iter().map(of).collect())
}

async fn rows(
    store: &Store,
    view: &str,
    filters: &[(&str, &str)],
    order: Option<&str>,
) -> Result<Vec<ViewRow>, Refusal> {
    let wanted = ViewRows {
        filters: filters.iter().map(|(column, value)| ((*column).to_owned(), (*value).to_owned())).collect(),
        order: order.map(|column| (column.to_owned(), false)),
        limit: MOST as usize,
    };
    let table = store.rows_of_view(view, &wanted).await.map_err(Refusal::unanswered)?;
    Ok(table.objects().filter_map(ViewRow::of).collect())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn alarms_and_what_is_worth_knowing_are_counted_apart_and_sum_up() {
        let rows = [
            json!({"robot": "A", "joint": 1, "severity": "critical", "state": "open"}),
            json!({"robot": "A", "joint": 1, "severity": "info", "state": "open"}),
            json!({"robot": "A", "joint": null, "severity": "warning", "state": "open"}),
            json!({"robot": "A", "joint": 2, "severity": "warning", "state": "maintenance"}),
            json!({"robot": "B", "joint": 2, "severity": "info", "state": "open"}),
        ];
        let rows: Vec<ViewRow> = rows.into_iter().filter_map(ViewRow::of).collect();
        let open = OpenByPlace::of(&rows);
        assert_eq!(open.robot("A"), OpenCounts { alarms: 2, infos: 1 });
        assert_eq!(open.joint("A", 1), OpenCounts { alarms: 2, infos: 1 });
        assert_eq!(open.joint("A", 2), OpenCounts { alarms: 1, infos: 0 }, "that of the whole arm");
        assert_eq!((open.robot("B"), open.robot("B").all()), (OpenCounts { alarms: 0, infos: 1 }, 1));
        assert_eq!(open.robot("C"), OpenCounts::default());
    }
}
