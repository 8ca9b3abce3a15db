//! Runs, fleet health, anomalies and counts, read from the views that users read.

use jiff::Timestamp;
use jiff::civil::Date;
use serde::Serialize;
use sqlx::Row;

use super::ledger::runs;
use super::values::{joint, named, size};
use crate::engine::{EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::alarms::alarm_state::AlarmState;
use crate::values::{in_views, known_in_views, time_text};
use armwatch_model::anomaly::forecast::{Crossing, Forecast, Trend};
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::{Alternative, AnomalyKind, Severity};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::{RunKind, RunStatus};

/// A row of the view `runs`.
#[derive(Debug, Clone, PartialEq)]
pub struct RunRow {
    /// Database key.
    pub run_id: i64,
    /// The individual robot.
    pub robot: String,
    /// Start of the recording.
    pub started_at: Timestamp,
    /// File name of the export.
    pub source_name: String,
    /// Rows, once the run is complete.
    pub rows: Option<u64>,
    /// Cycles stored.
    pub cycles: u32,
    /// Status of the run.
    pub status: RunStatus,
    /// Its kind.
    pub kind: RunKind,
    /// Reason for its status, such as a quarantine.
    pub reason: Option<String>,
    /// Line of the export that the reason points at.
    pub reason_line: Option<u64>,
    /// Column of the export that the reason points at.
    pub reason_column: Option<String>,
}

/// A row of the view `fleet_health`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FleetHealthRow {
    /// The individual robot.
    #[serde(skip)]
    pub robot: String,
    /// The joint.
    pub joint: JointIndex,
    /// Start of the latest complete run.
    #[serde(serialize_with = "in_views")]
    pub last_run_at: Timestamp,
    /// Median moving relative RMSD of the latest complete run's excitation stages.
    pub moving_relative_rmsd: Option<f64>,
    /// Warm friction relative to the joint's own baseline, 1 = unchanged.
    pub friction_index: Option<f64>,
    /// Anomalies in the state open.
    pub open_anomalies: u32,
    /// Status of the joint.
    pub status: HealthStatus,
    /// Start of the latest complete run that gave a result for this joint.
    #[serde(serialize_with = "known_in_views")]
    pub last_result_at: Option<Timestamp>,
    /// Reason for the status, if there is one.
    pub reason: Option<String>,
    /// Latest time for the next test to begin.
    #[serde(serialize_with = "known_in_views")]
    pub expected_by: Option<Timestamp>,
    /// The quantity behind `friction_index`.
    #[serde(skip)]
    pub friction_quantity: Option<Quantity>,
    /// Forecast of friction reaching its limits.
    #[serde(skip)]
    pub forecast: Option<Forecast>,
}

armwatch_model::named_enum! {
    /// Status of a joint.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum HealthStatus {
        /// No alarm.
        Ok = "ok",
        /// The history is too short for a baseline.
        Learning = "learning",
        /// A check should be planned.
        Warning = "warning",
        /// Should be checked before the next shift.
        Critical = "critical",
        /// The latest test gives no status; the reason explains it.
        Unknown = "unknown",
        /// No test came for longer than usual.
        Overdue = "overdue",
    }
}

armwatch_model::serialize_by_name!(HealthStatus);

impl HealthStatus {
    /// Every status, the worst first: a robot has the status of its worst joint.
    pub const WORST_FIRST: [Self; 6] =
        [Self::Critical, Self::Warning, Self::Overdue, Self::Unknown, Self::Learning, Self::Ok];

    /// Its rank: 0 is the worst.
    pub fn rank(self) -> usize {
        Self::WORST_FIRST.iter().position(|status| *status == self).unwrap_or(Self::WORST_FIRST.len())
    }
}

/// A row of the view `anomalies`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AnomalyRow {
    /// Database key.
    pub anomaly_id: i64,
    /// The individual robot.
    pub robot: String,
    /// Run with which the episode began; `None` if it was deleted and there is no new conclusion yet.
    pub run_id: Option<i64>,
    /// Cycle of that run with which it began, if it began in a cycle.
    pub cycle: Option<u32>,
    /// The joint; `None` if the cause affects the whole arm.
    pub joint: Option<JointIndex>,
    /// Kind of change.
    pub kind: AnomalyKind,
    /// The quantity that changed.
    pub quantity: Quantity,
    /// Unit of `value`, `baseline` and `peak_value`; `None` if the quantity has no values.
    pub unit: Option<&'static str>,
    /// Severity: how soon a person should look.
    pub severity: Severity,
    /// Deviation of the value, in the scale of `threshold`.
    pub score: Option<f64>,
    /// Least score of an anomaly.
    pub threshold: Option<f64>,
    /// Value in the latest run that showed it.
    pub value: Option<f64>,
    /// Expected value.
    pub baseline: Option<f64>,
    /// Start of the first run.
    #[serde(serialize_with = "in_views")]
    pub first_seen_at: Timestamp,
    /// Start of the latest run.
    #[serde(serialize_with = "in_views")]
    pub last_seen_at: Timestamp,
    /// State of the anomaly.
    pub state: AlarmState,
    /// Message for a technician.
    pub message: String,
    /// Latest run that showed it.
    pub last_run_id: Option<i64>,
    /// The value that deviated most.
    pub peak_value: Option<f64>,
    /// The score that deviated most.
    pub peak_score: Option<f64>,
    /// Most likely beginning of the change.
    #[serde(serialize_with = "known_in_views")]
    pub onset_at: Option<Timestamp>,
    /// Run of the onset.
    pub onset_run_id: Option<i64>,
    /// Cycle of the onset in that run, if known.
    pub onset_cycle: Option<u32>,
    /// Odds of the named cause against all others together, if causes were compared.
    pub odds: Option<f64>,
    /// Rejected causes, the likeliest first; unknown odds are NaN.
    pub alternatives: Vec<Alternative>,
    /// End of its shelving, or of a planned maintenance window.
    #[serde(serialize_with = "known_in_views")]
    pub shelved_until: Option<Timestamp>,
    /// True if later runs no longer show it, whatever a person entered about it.
    pub ended: bool,
    /// True if the test that shows it is still being written.
    pub provisional: bool,
    /// Person who deals with it.
    pub assignee: Option<String>,
}

impl AnomalyRow {
    /// Number of the joint as people read it, from 1; `None` if the cause affects the whole arm.
    pub fn joint_number(&self) -> Option<usize> {
        self.joint.map(JointIndex::number)
    }
}

/// Counts of stored rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StoredCounts {
    /// Robots with a run of any status.
    pub robots: u64,
    /// Runs that are being stored.
    pub streaming_runs: u64,
    /// Complete runs.
    pub complete_runs: u64,
    /// Quarantined exports.
    pub quarantined_runs: u64,
    /// Cycles stored.
    pub cycles: u64,
    /// Anomalies in the state open.
    pub open_anomalies: u64,
}

impl Store {
    /// All runs, by robot and start.
    pub async fn runs(&self) -> Result<Vec<RunRow>, StoreError> {
        self.checked(runs(&self.readers).await)
    }

    /// Health of every joint of every robot with a complete run.
    pub async fn fleet_health(&self) -> Result<Vec<FleetHealthRow>, StoreError> {
        self.checked(fleet_health(&self.readers).await)
    }

    /// Anomalies found after the one with key `after` (0 for all), oldest finding first.
    pub async fn anomalies_after(&self, after: i64) -> Result<Vec<AnomalyRow>, StoreError> {
        self.checked(anomalies_after(&self.readers, after).await)
    }

    /// Counts of stored rows.
    pub async fn counts(&self) -> Result<StoredCounts, StoreError> {
        self.checked(counts(&self.readers).await)
    }
}

pub(crate) async fn runs(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<RunRow>> {
    sqlx::query(
        "SELECT run_id, robot, started_at, source_name, rows, cycles, status, kind, reason, reason_line, reason_column
         FROM runs
         ORDER BY robot, started_at, run_id",
    )
    .try_map(|row: EngineRow| {
        Ok(RunRow {
            run_id: row.try_get("run_id")?,
            robot: row.try_get("robot")?,
            started_at: time_text(&row, "started_at")?,
            source_name: row.try_get("source_name")?,
            rows: row.try_get("rows")?,
            cycles: size(&row, "cycles")?,
            status: runs::status(&row, "status")?,
            kind: named(&row, "kind", &[RunKind::Test, RunKind::Production], RunKind::name)?,
            reason: row.try_get("reason")?,
            reason_line: row.try_get("reason_line")?,
            reason_column: row.try_get("reason_column")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Every joint of every robot with a complete run, by robot and joint.
pub(crate) async fn fleet_health(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<FleetHealthRow>> {
    sqlx::query(
        "SELECT robot, joint, last_run_at, moving_relative_rmsd, friction_index, open_anomalies, status,
                last_result_at, reason, expected_by, friction_quantity, trend, warning_by, warning_by_lower,
                warning_by_upper, critical_by, critical_by_lower, critical_by_upper
         FROM fleet_health
         ORDER BY robot, joint",
    )
    .try_map(|row: EngineRow| {
        Ok(FleetHealthRow {
            robot: row.try_get("robot")?,
            joint: joint(&row, "joint")?,
            last_run_at: time_text(&row, "last_run_at")?,
            moving_relative_rmsd: row.try_get("moving_relative_rmsd")?,
            friction_index: row.try_get("friction_index")?,
            open_anomalies: size(&row, "open_anomalies")?,
            status: named(&row, "status", &HealthStatus::ALL, HealthStatus::name)?,
            last_result_at: optional_time(&row, "last_result_at")?,
            reason: row.try_get("reason")?,
            expected_by: optional_time(&row, "expected_by")?,
            friction_quantity: match row.try_get::<Option<&str>, _>("friction_quantity")? {
                Some(_) => Some(named(&row, "friction_quantity", &Quantity::ALL, Quantity::name)?),
                None => None,
            },
            forecast: forecast(&row)?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Anomalies with a key above `after`, oldest finding first.
pub(crate) async fn anomalies_after(
    executor: impl EngineExecutor<'_>,
    after: i64,
) -> sqlx::Result<Vec<AnomalyRow>> {
    sqlx::query(
        "SELECT anomaly_id, robot, run_id, cycle, joint, kind, quantity, severity, score, threshold, value, baseline,
                first_seen_at, last_seen_at, state, message, last_run_id, peak_value, peak_score, onset_at, onset_run_id,
                onset_cycle, odds, alternatives, shelved_until, ended, provisional,
                assignee
         FROM anomalies
         WHERE anomaly_id > $1
         ORDER BY anomaly_id",
    )
    .bind(after)
    .try_map(|row: EngineRow| {
        let quantity = named(&row, "quantity", &Quantity::ALL, Quantity::name)?;
        Ok(AnomalyRow {
            anomaly_id: row.try_get("anomaly_id")?,
            robot: row.try_get("robot")?,
            run_id: row.try_get("run_id")?,
            cycle: row.try_get("cycle")?,
            joint: match row.try_get::<Option<i64>, _>("joint")? {
                Some(_) => Some(joint(&row, "joint")?),
                None => None,
            },
            kind: named(&row, "kind", &AnomalyKind::ALL, AnomalyKind::name)?,
            quantity,
            unit: quantity.unit(),
            severity: named(&row, "severity", &Severity::ALL, Severity::name)?,
            score: row.try_get("score")?,
            threshold: row.try_get("threshold")?,
            value: row.try_get("value")?,
            baseline: row.try_get("baseline")?,
            first_seen_at: time_text(&row, "first_seen_at")?,
            last_seen_at: time_text(&row, "last_seen_at")?,
            state: named(&row, "state", &AlarmState::ALL, AlarmState::name)?,
            message: row.try_get("message")?,
            last_run_id: row.try_get("last_run_id")?,
            peak_value: row.try_get("peak_value")?,
            peak_score: row.try_get("peak_score")?,
            onset_at: optional_time(&row, "onset_at")?,
            onset_run_id: row.try_get("onset_run_id")?,
            onset_cycle: row.try_get("onset_cycle")?,
            odds: row.try_get("odds")?,
            alternatives: alternatives(row.try_get("alternatives")?)?,
            shelved_until: optional_time(&row, "shelved_until")?,
            ended: row.try_get("ended")?,
            provisional: row.try_get("provisional")?,
            assignee: row.try_get("assignee")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Rejected causes from their JSON array.
fn alternatives(text: &str) -> sqlx::Result<Vec<Alternative>> {
    let rejected: Vec<serde_json::Value> = serde_json::from_str(text)
        .map_err(|error| sqlx::Error::Decode(format!("column alternatives holds {text}: {error}").into()))?;
    let one = |of: &serde_json::Value| Alternative {
        cause: of["cause"].as_str().unwrap_or_default().to_owned(),
        odds: of["odds"].as_f64().unwrap_or(f64::NAN),
    };
    Ok(rejected.iter().map(one).collect())
}

pub(crate) async fn counts(executor: impl EngineExecutor<'_>) -> sqlx::Result<StoredCounts> {
    sqlx::query(
        "SELECT (SELECT count(DISTINCT robot_id) FROM run) AS robots,
                (SELECT count(*) FROM run WHERE status = 'streaming') AS streaming_runs,
                (SELECT count(*) FROM run WHERE status = 'complete') AS complete_runs,
                (SELECT count(*) FROM run WHERE status = 'quarantined' AND superseded_by_run_id IS NULL
                     AND run_id NOT IN (SELECT run_id FROM quarantine WHERE state = 'dismissed'))
                    AS quarantined_runs,
                (SELECT count(*) FROM cycle) AS cycles,
                (SELECT count(*) FROM anomaly WHERE state = 'open' AND NOT withdrawn) AS open_anomalies",
    )
    .try_map(|row: EngineRow| {
        Ok(StoredCounts {
            robots: size(&row, "robots")?,
            streaming_runs: size(&row, "streaming_runs")?,
            complete_runs: size(&row, "complete_runs")?,
            quarantined_runs: size(&row, "quarantined_runs")?,
            cycles: size(&row, "cycles")?,
            open_anomalies: size(&row, "open_anomalies")?,
        })
    })
    .fetch_one(executor)
    .await
}

fn optional_time(row: &EngineRow, column: &str) -> sqlx::Result<Option<Timestamp>> {
    match row.try_get::<Option<&str>, _>(column)? {
        Some(_) => time_text(row, column).map(Some),
        None => Ok(None),
    }
}

fn forecast(row: &EngineRow) -> sqlx::Result<Option<Forecast>> {
    if row.try_get::<Option<&str>, _>("trend")?.is_none() {
        return Ok(None);
    }
    let crossing = |by, lower, upper| -> sqlx::Result<Option<Crossing>> {
        let (days, upper) =
            (optional_day(row, by)?.zip(optional_day(row, lower)?), optional_day(row, upper)?);
        Ok(days.map(|(by, lower)| Crossing { by, lower, upper }))
    };
    Ok(Some(Forecast {
        trend: named(row, "trend", &Trend::ALL, Trend::name)?,
        warning_at: crossing("warning_by", "warning_by_lower", "warning_by_upper")?,
        critical_at: crossing("critical_by", "critical_by_lower", "critical_by_upper")?,
    }))
}

fn optional_day(row: &EngineRow, column: &str) -> sqlx::Result<Option<Date>> {
    let text: Option<&str> = row.try_get(column)?;
    let day = text.map(str::parse).transpose();
    day.map_err(|error: jiff::Error| sqlx::Error::Decode(error.to_string().into()))
}
