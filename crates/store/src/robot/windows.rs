//! Planned maintenance windows: during a window, alarms of its place are in maintenance, and no one is notified.

use jiff::Timestamp;
use sqlx::Row;

use super::alarms::alarm_life::{maintain_until, open_again};
use super::alarms::anomalies::{AnomalyEvent, Person};
use super::maintenance::SOMEBODY;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{joint_number, time};
use armwatch_model::robot::JointIndex;

/// A maintenance window to be planned.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewWindow {
    /// The robot.
    pub robot: String,
    /// The joint; `None` for the whole arm.
    pub joint: Option<JointIndex>,
    /// Start, by the machine's clock.
    pub from: Timestamp,
    /// End.
    pub until: Timestamp,
    /// Planned work.
    pub what: String,
    /// Person who plans it.
    pub who: String,
}

impl Store {
    /// Plans a window and returns its key; `None` if no robot has this name. If the window has begun, open alarms of
    /// its place are put into maintenance.
    pub async fn plan_window(&self, of: &NewWindow, clock: Timestamp) -> Result<Option<i64>, StoreError> {
        let mut transaction = self.begin().await?;
        let planned = plan(&mut transaction, of, clock).await;
        let planned = self.checked(planned)?;
        self.commit(transaction).await?;
        Ok(planned)
    }

    /// Deletes a window; returns false if none has this key. Alarms that only this window holds become open.
    pub async fn cancel_window(&self, window_id: i64, clock: Timestamp) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let cancelled = cancel(&mut transaction, window_id, clock).await;
        let cancelled = self.checked(cancelled)?;
        self.commit(transaction).await?;
        Ok(cancelled)
    }
}

async fn plan(
    connection: &mut EngineConnection,
    of: &NewWindow,
    clock: Timestamp,
) -> sqlx::Result<Option<i64>> {
    let planned = sqlx::query_scalar(
        "INSERT INTO maintenance_window (robot_id, joint, from_at, until_at, what, who)
         SELECT robot_id, $2, $3, $4, $5, $6 FROM robot WHERE name = $1
         RETURNING maintenance_window_id",
    )
    .bind_all((&of.robot, of.joint.map(joint_number), of.from.as_microsecond(), of.until.as_microsecond()))
    .bind_all((&of.what, &of.who))
    .fetch_optional(&mut *connection)
    .await?;
    hold(connection, clock).await?;
    Ok(planned)
}

async fn cancel(connection: &mut EngineConnection, window_id: i64, clock: Timestamp) -> sqlx::Result<bool> {
    let held: Vec<i64> = sqlx::query_scalar(
        "SELECT anomaly.anomaly_id
         FROM maintenance_window AS planned JOIN anomaly USING (robot_id)
         WHERE planned.maintenance_window_id = $1 AND (planned.joint IS NULL OR planned.joint = anomaly.joint)
               AND anomaly.state = 'maintenance' AND anomaly.shelved_until IS NOT NULL
         ORDER BY anomaly.anomaly_id",
    )
    .bind(window_id)
    .fetch_all(&mut *connection)
    .await?;
    let deleted = sqlx::query("DELETE FROM maintenance_window WHERE maintenance_window_id = $1")
        .bind(window_id)
        .execute(&mut *connection)
        .await?;
    for anomaly_id in held {
        open_again(&mut *connection, anomaly_id).await?;
    }
    // another window may hold some of them
    hold(connection, clock).await?;
    Ok(deleted.rows_affected() > 0)
}

/// Puts open alarms whose place has a window now into maintenance, until the last of these windows ends.
pub(in crate::robot) async fn hold(
    connection: &mut EngineConnection,
    clock: Timestamp,
) -> sqlx::Result<Vec<AnomalyEvent>> {
    let mut events = Vec::new();
    for held in waiting(&mut *connection, clock).await? {
        let by = Person { who: held.who.as_deref().unwrap_or(SOMEBODY), why: Some(&held.what) };
        events.push(maintain_until(&mut *connection, held.anomaly_id, held.until, by).await?);
    }
    Ok(events)
}

/// An open alarm with the window of its place that ends last.
pub(in crate::robot) struct HeldAlarm {
    anomaly_id: i64,
    until: Timestamp,
    what: String,
    who: Option<String>,
}

/// Open alarms whose place has a window at this time.
pub(in crate::robot) async fn waiting(
    executor: impl EngineExecutor<'_>,
    clock: Timestamp,
) -> sqlx::Result<Vec<HeldAlarm>> {
    let mut held = sqlx::query(
        "SELECT anomaly.anomaly_id, planned.until_at, planned.what, planned.who
         FROM maintenance_window AS planned JOIN anomaly USING (robot_id)
         WHERE planned.from_at <= $1 AND planned.until_at > $1
               AND (planned.joint IS NULL OR planned.joint = anomaly.joint)
               AND anomaly.state = 'open' AND NOT anomaly.ended AND NOT anomaly.withdrawn
         ORDER BY anomaly.anomaly_id, planned.until_at DESC, planned.maintenance_window_id",
    )
    .bind(clock.as_microsecond())
    .try_map(|row: EngineRow| {
        Ok(HeldAlarm {
            anomaly_id: row.try_get("anomaly_id")?,
            until: time(&row, "until_at")?,
            what: row.try_get("what")?,
            who: row.try_get("who")?,
        })
    })
    .fetch_all(executor)
    .await?;
    held.dedup_by_key(|of| of.anomaly_id);
    Ok(held)
}

/// Alarms in maintenance whose window has ended.
pub(in crate::robot) async fn over(
    executor: impl EngineExecutor<'_>,
    clock: Timestamp,
) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT anomaly_id FROM anomaly
         WHERE state = 'maintenance' AND shelved_until <= $1 AND NOT ended AND NOT withdrawn
         ORDER BY anomaly_id",
    )
    .bind(clock.as_microsecond())
    .fetch_all(executor)
    .await
}
