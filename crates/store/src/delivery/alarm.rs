//! Content of a message about an anomaly.

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, Row};

use super::event::told;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::alarms::alarm_state::EventKind;
use crate::values::{named, time};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{AnomalyKind, Severity};

/// Most runs of a series: the latest runs decide a trend.
const SERIES_RUNS: i64 = 12;

/// An event of an anomaly, with the data of the anomaly that a message shows.
#[derive(Debug, Clone, PartialEq)]
pub struct AlarmEvent {
    /// Number of the event.
    pub event_id: i64,
    /// Number of the anomaly.
    pub anomaly_id: i64,
    /// Kind of the event.
    pub what: EventKind,
    /// Time of the event.
    pub at: Timestamp,
    /// The robot.
    pub robot: String,
    /// The joint as people count, from 1; `None` if the cause affects the whole arm.
    pub joint: Option<i64>,
    /// Kind of the anomaly.
    pub kind: AnomalyKind,
    /// The quantity that changed.
    pub quantity: Quantity,
    /// Severity at that time.
    pub severity: Severity,
    /// Message for a technician at that time.
    pub message: String,
    /// Deviation at that time, in the scale of `threshold`; smoothed if the detector smooths.
    pub score: Option<f64>,
    /// Least score of an anomaly.
    pub threshold: Option<f64>,
    /// Value of the latest run that had shown it at that time.
    pub value: Option<f64>,
    /// Expected value.
    pub baseline: Option<f64>,
    /// The value that deviated most.
    pub peak_value: Option<f64>,
    /// Its score.
    pub peak_score: Option<f64>,
    /// Most likely beginning of the change.
    pub onset_at: Option<Timestamp>,
    /// The run of that moment.
    pub onset_run_id: Option<i64>,
    /// The cycle of that run.
    pub onset_cycle: Option<i64>,
    /// Start of the first run that showed it.
    pub first_seen_at: Timestamp,
    /// Start of the latest run that showed it.
    pub last_seen_at: Timestamp,
    /// Odds of the named cause against all others together.
    pub odds: Option<f64>,
    /// State of the anomaly, such as `open`.
    pub state: String,
    /// Reason in a person's words.
    pub why: Option<String>,
    /// Values of the quantity in the latest runs with their starts, oldest first. Empty if runs have no such value.
    pub series: Vec<(Timestamp, f64)>,
    /// Other kinds and severities of the anomaly that the same receiver was sent before.
    pub told_before: Vec<(String, String)>,
}

/// Columns of an [`AlarmEvent`] without its series. Score and value belong to the quantity of the event. They are not
/// comparable with values of another quantity that the anomaly has now.
pub(super) const COLUMNS: &str = "
    anomaly_event.anomaly_event_id, anomaly_event.anomaly_id, anomaly_event.what, anomaly_event.at,
    robot.name AS robot, anomaly.robot_id, anomaly.joint, anomaly.kind, anomaly_event.severity,
    coalesce(anomaly_event.quantity, anomaly.quantity) AS quantity,
    anomaly_event.message, anomaly_event.score, anomaly_event.value,
    CASE WHEN coalesce(anomaly_event.quantity, anomaly.quantity) = anomaly.quantity THEN anomaly.threshold END AS threshold,
    CASE WHEN coalesce(anomaly_event.quantity, anomaly.quantity) = anomaly.quantity THEN anomaly.baseline END AS baseline,
    CASE WHEN coalesce(anomaly_event.quantity, anomaly.quantity) = anomaly.quantity THEN anomaly.peak_value END AS peak_value,
    CASE WHEN coalesce(anomaly_event.quantity, anomaly.quantity) = anomaly.quantity THEN anomaly.peak_score END AS peak_score,
    anomaly.onset_at, anomaly.onset_run_id, anomaly.onset_cycle,
    anomaly.first_seen_at, anomaly.last_seen_at, anomaly.odds, anomaly.state, anomaly_event.why";

/// Reads a row of [`COLUMNS`]; `None` for an event that is never announced.
pub(super) fn from_row(row: &EngineRow) -> sqlx::Result<Option<AlarmEvent>> {
    let Some(what) = told(row.try_get("what")?) else { return Ok(None) };
    let onset_at = match row.try_get::<Option<i64>, _>("onset_at")? {
        Some(_) => Some(time(row, "onset_at")?),
        None => None,
    };
    Ok(Some(AlarmEvent {
        event_id: row.try_get("anomaly_event_id")?,
        anomaly_id: row.try_get("anomaly_id")?,
        what,
        at: time(row, "at")?,
        robot: row.try_get("robot")?,
        joint: row.try_get("joint")?,
        kind: named(row, "kind", &AnomalyKind::ALL, AnomalyKind::name)?,
        quantity: named(row, "quantity", &Quantity::ALL, Quantity::name)?,
        severity: named(row, "severity", &Severity::ALL, Severity::name)?,
        message: row.try_get("message")?,
        score: row.try_get("score")?,
        threshold: row.try_get("threshold")?,
        value: row.try_get("value")?,
        baseline: row.try_get("baseline")?,
        peak_value: row.try_get("peak_value")?,
        peak_score: row.try_get("peak_score")?,
        onset_at,
        onset_run_id: row.try_get("onset_run_id")?,
        onset_cycle: row.try_get("onset_cycle")?,
        first_seen_at: time(row, "first_seen_at")?,
        last_seen_at: time(row, "last_seen_at")?,
        odds: row.try_get("odds")?,
        state: row.try_get("state")?,
        why: row.try_get("why")?,
        series: Vec::new(),
        told_before: Vec::new(),
    }))
}

/// Adds the values of the quantity in the latest runs, and the earlier announcements on the route.
pub(super) async fn complete(
    connection: &mut EngineConnection,
    route_id: i64,
    event: &mut AlarmEvent,
) -> sqlx::Result<()> {
    event.series = series(&mut *connection, event).await?;
    event.told_before = told_before(connection, route_id, event).await?;
    Ok(())
}

async fn series(
    executor: impl EngineExecutor<'_>,
    event: &AlarmEvent,
) -> sqlx::Result<Vec<(Timestamp, f64)>> {
    // an RMSD's swing has no value per test
    if event.kind == AnomalyKind::Oscillation {
        return Ok(Vec::new());
    }
    let (table, column) = match event.quantity {
        Quantity::FrictionIndex => ("run_friction_index", "friction_index"),
        Quantity::WarmFriction => ("run_joint_summary", "warm_friction_nm"),
        Quantity::ExcitationFriction => ("run_joint_summary", "excitation_friction_nm"),
        Quantity::MovingRelativeRmsd => ("run_joint_summary", "relative_rmsd"),
        _ => return Ok(Vec::new()),
    };
    let statement = format!(
        "SELECT started_at, value FROM (
             SELECT run.run_id, run.started_at, figure.{column} AS value
             FROM run
             JOIN robot USING (robot_id)
             JOIN {table} AS figure USING (run_id)
             WHERE robot.name = $1 AND figure.joint = $2 AND run.status = 'complete' AND run.kind = 'test'
                   AND run.superseded_by_run_id IS NULL AND figure.{column} IS NOT NULL
             ORDER BY run.started_at DESC, run.run_id DESC
             LIMIT $3
         ) AS latest
         ORDER BY started_at, run_id"
    );
    sqlx::query(AssertSqlSafe(statement))
        .bind_all((&event.robot, event.joint, SERIES_RUNS))
        .try_map(|row: EngineRow| Ok((time(&row, "started_at")?, row.try_get("value")?)))
        .fetch_all(executor)
        .await
}

async fn told_before(
    executor: impl EngineExecutor<'_>,
    route_id: i64,
    event: &AlarmEvent,
) -> sqlx::Result<Vec<(String, String)>> {
    sqlx::query_as(
        "SELECT DISTINCT told_kind, told_severity
         FROM delivery
         JOIN anomaly_event USING (anomaly_event_id)
         WHERE delivery_route_id = $1 AND anomaly_id = $2 AND attempts > 0 AND told_kind IS NOT NULL
               AND (told_kind <> $3 OR told_severity <> $4)
         ORDER BY told_kind, told_severity",
    )
    .bind_all((route_id, event.anomaly_id, event.kind.name(), event.severity.name()))
    .fetch_all(executor)
    .await
}

impl Store {
    /// Identity of this database, which distinguishes it from others at a common receiver.
    pub async fn identity(&self) -> Result<String, StoreError> {
        let identity = sqlx::query_scalar("SELECT identity FROM database_identity").fetch_one(&self.readers);
        self.checked(identity.await)
    }

    /// Open alarms, lowest number first: for each the latest event that calls for attention.
    pub async fn open_alarms(&self) -> Result<Vec<AlarmEvent>, StoreError> {
        self.checked(open_alarms(&self.readers).await)
    }

    /// Alarms that are open for the receiver of a route: for each anomaly that is not closed, the latest event sent to
    /// the receiver. Omits one that was closed while the receiver could not be reached.
    pub async fn told_alarms(&self, route_id: i64) -> Result<Vec<AlarmEvent>, StoreError> {
        self.checked(told_alarms(&self.readers, route_id).await)
    }
}

pub(super) async fn open_alarms(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<AlarmEvent>> {
    let statement = format!(
        "SELECT {COLUMNS}
         FROM anomaly
         JOIN robot USING (robot_id)
         JOIN anomaly_event ON anomaly_event.anomaly_event_id = (
             SELECT max(latest.anomaly_event_id) FROM anomaly_event AS latest
             WHERE latest.anomaly_id = anomaly.anomaly_id AND latest.what IN {}
         )
         WHERE anomaly.state = 'open' AND NOT anomaly.withdrawn
         ORDER BY anomaly.anomaly_id",
        super::event::SPEAKING
    );
    let rows =
        sqlx::query(AssertSqlSafe(statement)).try_map(|row| from_row(&row)).fetch_all(executor).await?;
    Ok(rows.into_iter().flatten().collect())
}

async fn told_alarms(executor: impl EngineExecutor<'_>, route_id: i64) -> sqlx::Result<Vec<AlarmEvent>> {
    let statement = format!(
        "SELECT {COLUMNS}, told_kind
         FROM delivery
         JOIN anomaly_event USING (anomaly_event_id)
         JOIN anomaly USING (anomaly_id)
         JOIN robot USING (robot_id)
         WHERE delivery.delivery_route_id = $1 AND delivery.state = 'sent' AND anomaly_event.what IN {}
               AND NOT anomaly.ended AND NOT anomaly.withdrawn AND anomaly.state NOT IN ('resolved', 'false_alarm')
               AND NOT EXISTS (
                   SELECT 1 FROM delivery AS later
                   JOIN anomaly_event AS event ON event.anomaly_event_id = later.anomaly_event_id
                   WHERE later.delivery_route_id = $1 AND later.state = 'sent'
                         AND event.anomaly_id = anomaly_event.anomaly_id
                         AND event.anomaly_event_id > anomaly_event.anomaly_event_id
               )
         ORDER BY anomaly_event.anomaly_id",
        super::event::SPEAKING
    );
    let read = |row: EngineRow| {
        let event = from_row(&row)?;
        let told = row.try_get::<Option<&str>, _>("told_kind")?;
        let told = AnomalyKind::ALL.into_iter().find(|kind| told == Some(kind.name()));
        // with the labels that were sent
        Ok(event.map(|event| AlarmEvent { kind: told.unwrap_or(event.kind), ..event }))
    };
    let rows = sqlx::query(AssertSqlSafe(statement)).bind(route_id).try_map(read).fetch_all(executor).await?;
    Ok(rows.into_iter().flatten().collect())
}
