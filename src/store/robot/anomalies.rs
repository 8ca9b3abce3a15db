//! Anomalies and health of a robot: what is stored is made to agree with what its history says.

use std::collections::HashMap;

use jiff::Timestamp;
use sqlx::sqlite::{SqliteExecutor, SqliteRow};
use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};

use crate::anomaly::{Alternative, Anomaly, Findings, JointHealth};
use crate::store::values::{finite, joint_number};

/// What reconciling changed, by key of the anomaly.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Reconciled {
    /// Became open: new, or seen again after it was resolved.
    pub opened: Vec<i64>,
    /// Became resolved: ended, or withdrawn because the findings have it no longer.
    pub resolved: Vec<i64>,
}

/// What makes an anomaly the same one in two findings: joint, kind, quantity, first run.
type Key = (Option<i64>, String, String, i64);

struct Stored {
    anomaly_id: i64,
    state: String,
}

/// Makes the stored anomalies and health of a robot agree with `findings`, the outcome of its whole
/// history. Known anomalies keep their number and a person's acknowledgement; one that was resolved
/// and shows again is open again; one that more of the history has taken back is withdrawn: what is shown
/// depends on the history alone, not on how much of it was known when. Call in a transaction.
pub(in crate::store) async fn reconcile(
    connection: &mut SqliteConnection,
    robot_id: i64,
    findings: &Findings,
) -> Result<Reconciled, sqlx::Error> {
    let mut stored = stored_anomalies(&mut *connection, robot_id).await?;
    let mut outcome = Reconciled::default();
    for anomaly in &findings.anomalies {
        match stored.remove(&key(anomaly)) {
            None => {
                let state = if anomaly.ended { "resolved" } else { "open" };
                let id = insert_anomaly(&mut *connection, robot_id, anomaly, state).await?;
                if !anomaly.ended {
                    outcome.opened.push(id);
                }
            }
            Some(known) => {
                let state = state_after(&known.state, anomaly.ended);
                update_anomaly(&mut *connection, known.anomaly_id, anomaly, state).await?;
                if state != known.state {
                    let changed = if state == "open" { &mut outcome.opened } else { &mut outcome.resolved };
                    changed.push(known.anomaly_id);
                }
            }
        }
    }
    let mut vanished: Vec<Stored> = stored.into_values().collect();
    vanished.sort_unstable_by_key(|anomaly| anomaly.anomaly_id);
    for anomaly in vanished {
        withdraw_anomaly(&mut *connection, anomaly.anomaly_id).await?;
        if anomaly.state != "resolved" {
            outcome.resolved.push(anomaly.anomaly_id);
        }
    }
    replace_health(&mut *connection, robot_id, &findings.health).await?;
    set_expected_by(connection, robot_id, findings.expected_by).await?;
    Ok(outcome)
}

fn key(anomaly: &Anomaly) -> Key {
    (
        anomaly.joint.map(joint_number),
        anomaly.kind.name().to_owned(),
        anomaly.quantity.to_owned(),
        anomaly.first_run_id,
    )
}

fn state_after(state: &str, ended: bool) -> &'static str {
    match (ended, state) {
        (true, _) => "resolved",
        (false, "acknowledged") => "acknowledged",
        (false, _) => "open",
    }
}

async fn stored_anomalies(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
) -> Result<HashMap<Key, Stored>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT anomaly_id, joint, kind, quantity, first_run_id, state FROM anomaly WHERE robot_id = ?",
    )
    .bind(robot_id)
    .try_map(|row: SqliteRow| {
        let key: Key = (
            row.try_get("joint")?,
            row.try_get("kind")?,
            row.try_get("quantity")?,
            row.try_get("first_run_id")?,
        );
        Ok((key, Stored { anomaly_id: row.try_get("anomaly_id")?, state: row.try_get("state")? }))
    })
    .fetch_all(executor)
    .await?;
    Ok(rows.into_iter().collect())
}

async fn insert_anomaly(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
    anomaly: &Anomaly,
    state: &str,
) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar(
        "INSERT INTO anomaly (robot_id, joint, kind, quantity, first_run_id, severity, score, threshold, value,
                              baseline, peak_value, peak_score, first_cycle, last_run_id, first_seen_at, last_seen_at,
                              onset_run_id, onset_cycle, onset_at, odds, alternatives, state, message)
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
         RETURNING anomaly_id",
    )
    .bind(robot_id)
    .bind(anomaly.joint.map(joint_number))
    .bind(anomaly.kind.name())
    .bind(anomaly.quantity)
    .bind(anomaly.first_run_id)
    .bind(anomaly.severity.name())
    .bind(finite(anomaly.score))
    .bind(finite(anomaly.threshold))
    .bind(finite(anomaly.value))
    .bind(finite(anomaly.baseline))
    .bind(finite(anomaly.peak_value))
    .bind(finite(anomaly.peak_score))
    .bind(anomaly.first_cycle)
    .bind(anomaly.last_run_id)
    .bind(anomaly.first_seen_at.as_microsecond())
    .bind(anomaly.last_seen_at.as_microsecond())
    .bind(anomaly.onset.run_id)
    .bind(anomaly.onset.cycle)
    .bind(anomaly.onset.at.as_microsecond())
    .bind(anomaly.odds.and_then(finite))
    .bind(alternatives(&anomaly.alternatives))
    .bind(state)
    .bind(&anomaly.message)
    .fetch_one(executor)
    .await
}

async fn update_anomaly(
    executor: impl SqliteExecutor<'_>,
    anomaly_id: i64,
    anomaly: &Anomaly,
    state: &str,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE anomaly
         SET severity = ?, score = ?, threshold = ?, value = ?, baseline = ?, peak_value = ?, peak_score = ?,
             first_cycle = ?, last_run_id = ?, first_seen_at = ?, last_seen_at = ?, onset_run_id = ?, onset_cycle = ?,
             onset_at = ?, odds = ?, alternatives = ?, state = ?, message = ?, withdrawn = 0
         WHERE anomaly_id = ?",
    )
    .bind(anomaly.severity.name())
    .bind(finite(anomaly.score))
    .bind(finite(anomaly.threshold))
    .bind(finite(anomaly.value))
    .bind(finite(anomaly.baseline))
    .bind(finite(anomaly.peak_value))
    .bind(finite(anomaly.peak_score))
    .bind(anomaly.first_cycle)
    .bind(anomaly.last_run_id)
    .bind(anomaly.first_seen_at.as_microsecond())
    .bind(anomaly.last_seen_at.as_microsecond())
    .bind(anomaly.onset.run_id)
    .bind(anomaly.onset.cycle)
    .bind(anomaly.onset.at.as_microsecond())
    .bind(anomaly.odds.and_then(finite))
    .bind(alternatives(&anomaly.alternatives))
    .bind(state)
    .bind(&anomaly.message)
    .bind(anomaly_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// Rejected causes as a JSON array.
fn alternatives(rejected: &[Alternative]) -> String {
    let one = |of: &Alternative| serde_json::json!({ "cause": of.cause, "odds": finite(of.odds) });
    serde_json::Value::from_iter(rejected.iter().map(one)).to_string()
}

async fn withdraw_anomaly(executor: impl SqliteExecutor<'_>, anomaly_id: i64) -> Result<(), sqlx::Error> {
    sqlx::query("UPDATE anomaly SET state = 'resolved', withdrawn = 1 WHERE anomaly_id = ?")
        .bind(anomaly_id)
        .execute(executor)
        .await?;
    Ok(())
}

async fn replace_health(
    connection: &mut SqliteConnection,
    robot_id: i64,
    health: &[JointHealth],
) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM joint_health WHERE robot_id = ?")
        .bind(robot_id)
        .execute(&mut *connection)
        .await?;
    if health.is_empty() {
        return Ok(());
    }
    QueryBuilder::<Sqlite>::new(
        "INSERT INTO joint_health (robot_id, joint, friction_index, friction_quantity, knowledge, reason,
                                  last_result_run_id) ",
    )
    .push_values(health, |mut row, joint| {
        row.push_bind(robot_id)
            .push_bind(joint_number(joint.joint))
            .push_bind(joint.friction_index.and_then(finite))
            .push_bind(joint.friction_quantity)
            .push_bind(joint.knowledge.name())
            .push_bind(joint.reason.as_deref())
            .push_bind(joint.last_result_run_id);
    })
    .build()
    .execute(connection)
    .await?;
    Ok(())
}

/// Another expectation than before, as a new test brings it, ends that a robot is overdue.
async fn set_expected_by(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
    expected_by: Option<Timestamp>,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE robot SET expected_by = ?1, overdue = overdue AND expected_by IS ?1 WHERE robot_id = ?2",
    )
    .bind(expected_by.map(as_text))
    .bind(robot_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// A time as views show it, always with milliseconds, so that text order is time order.
pub(in crate::store) fn as_text(time: Timestamp) -> String {
    time.strftime("%Y-%m-%dT%H:%M:%S.%3fZ").to_string()
}
