//! The settled part of a robot's histories, of tests and of production logs, boundary by boundary, and the runs of
//! windows.

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, Row};

use super::conclude::ConclusionTransaction;
use super::figures::packed::{packed, unpacked};
use super::summaries;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run, begin_reading};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::log_summaries;
use armwatch_model::anomaly::quantity::Quantity;
use armwatch_model::anomaly::settled::{Moment, Settled};
use armwatch_model::anomaly::{ProductionSummary, RunSummary};
use armwatch_model::run::RunKind;

impl Store {
    /// The part of the robot's history of this kind that is settled at the latest boundary; at its beginning nothing is
    /// settled.
    pub async fn settled(&self, robot_id: i64, kind: RunKind) -> Result<Settled, StoreError> {
        Ok(self.checked(latest(&self.readers, robot_id, kind).await)?.unwrap_or_default())
    }

    /// Keys of the runs of a window, oldest first: those before the boundary, and at most `most` after it.
    pub async fn window_keys(
        &self,
        robot_id: i64,
        kind: RunKind,
        settled: &Settled,
        most: usize,
    ) -> Result<[Vec<i64>; 2], StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        self.checked(keys(&mut snapshot, robot_id, kind, settled, most).await)
    }

    /// The tests used for the robot's latest conclusion, and all later ones, oldest first.
    pub async fn latest_window(&self, robot_id: i64, method: u64) -> Result<Vec<RunSummary>, StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        let settled =
            self.checked(latest(&mut *snapshot, robot_id, RunKind::Test).await)?.unwrap_or_default();
        let keys = keys(&mut snapshot, robot_id, RunKind::Test, &settled, usize::MAX).await;
        let (keys, first) = (self.checked(keys)?.concat(), &settled.first_of_epochs);
        let window = summaries::window(&mut snapshot, robot_id, &keys, first, Some(method)).await;
        Ok(self.checked(window)?.tests)
    }

    /// Summaries of production logs, oldest first.
    pub async fn log_window(&self, run_ids: &[i64]) -> Result<Vec<ProductionSummary>, StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        self.checked(log_summaries::summaries(&mut snapshot, run_ids).await)
    }

    /// Opens the settled history of a robot, or of all robots, from this time on: the next conclusion evaluates the
    /// tests and logs from there again, with all that have arrived since. Returns the names of the robots.
    pub async fn reopen_history(
        &self,
        robot: Option<&str>,
        from: Timestamp,
    ) -> Result<Vec<String>, StoreError> {
        let mut transaction = self.begin().await?;
        let robots: sqlx::Result<Vec<String>> = sqlx::query_scalar(
            "UPDATE robot SET history = history + 1 WHERE $1 IS NULL OR name = $1 RETURNING name",
        )
        .bind(robot)
        .fetch_all(&mut *transaction)
        .await;
        let mut robots = self.checked(robots)?;
        for robot in &robots {
            let reopened = reopen(&mut *transaction, robot, from).await;
            self.checked(reopened)?;
        }
        self.commit(transaction).await?;
        robots.sort_unstable();
        Ok(robots)
    }

    /// Start of the first run that is not settled, if this run arrived too late to be evaluated: it began before the
    /// boundary and was stored after that was settled. `None` for runs that are evaluated.
    pub async fn arrived_too_late(&self, run_id: i64) -> Result<Option<Timestamp>, StoreError> {
        let boundary: Option<i64> = self.checked(
            sqlx::query_scalar(
                "SELECT max(settled_history.boundary_at)
                 FROM run JOIN settled_history ON settled_history.robot_id = run.robot_id AND settled_history.kind = run.kind
                 WHERE run.run_id = $1 AND run.status = 'complete' AND run.started_at < settled_history.boundary_at
                       AND run.run_id > settled_history.latest_run_id",
            )
            .bind(run_id)
            .fetch_one(&self.readers)
            .await,
        )?;
        Ok(boundary.and_then(|at| Timestamp::from_microsecond(at).ok()))
    }
}

impl Store {
    /// Start of the first run of this kind that is not settled, if it is later than this time: conclusions will not use
    /// an export that begins then.
    pub async fn settled_after(
        &self,
        robot: &str,
        kind: RunKind,
        started_at: Timestamp,
    ) -> Result<Option<Timestamp>, StoreError> {
        let boundary: Option<i64> = self.checked(
            sqlx::query_scalar(
                "SELECT max(boundary_at) FROM settled_history JOIN robot USING (robot_id)
                 WHERE robot.name = $1 AND kind = $2 AND boundary_at > $3",
            )
            .bind_all((robot, kind.name(), started_at.as_microsecond()))
            .fetch_one(&self.readers)
            .await,
        )?;
        Ok(boundary.and_then(|at| Timestamp::from_microsecond(at).ok()))
    }
}

impl ConclusionTransaction {
    /// Stores the settled part of a history and returns its key.
    pub(super) async fn keep_settled(&mut self, kind: RunKind, settled: &Settled) -> sqlx::Result<i64> {
        insert(&mut *self.transaction, self.robot_id, kind, settled).await
    }
}

/// Reopens the settled history from this time on. Call it when a person changes something of that time.
pub(super) async fn reopen(
    executor: impl EngineExecutor<'_>,
    robot: &str,
    from: Timestamp,
) -> sqlx::Result<()> {
    sqlx::query(
        "DELETE FROM settled_history
         WHERE robot_id = (SELECT robot_id FROM robot WHERE name = $1) AND follows_until >= $2",
    )
    .bind_all((robot, from.as_microsecond()))
    .run(executor)
    .await
}

/// Stores which part of the history has settled an anomaly.
pub(super) async fn settle_anomaly(
    executor: impl EngineExecutor<'_>,
    anomaly_id: i64,
    settled_by: Option<i64>,
) -> sqlx::Result<()> {
    if settled_by.is_some() {
        sqlx::query("UPDATE anomaly SET settled_history_id = $1 WHERE anomaly_id = $2")
            .bind_all((settled_by, anomaly_id))
            .execute(executor)
            .await?;
    }
    Ok(())
}

/// Marks withdrawn anomalies from before the window as settled.
pub(super) async fn settle_withdrawn(
    connection: &mut EngineConnection,
    robot_id: i64,
    kind: RunKind,
) -> sqlx::Result<()> {
    let Some((leads_from, _)) =
        latest(&mut *connection, robot_id, kind).await?.and_then(|settled| settled.leads_from)
    else {
        return Ok(());
    };
    let of_kind = Quantity::ALL.iter().filter(|of| of.history() == kind).map(|of| format!("'{of}'"));
    let quantities = of_kind.collect::<Vec<_>>().join(", ");
    sqlx::query(AssertSqlSafe(format!(
        "UPDATE anomaly
         SET settled_history_id = (SELECT settled_history_id FROM settled_history
                                   WHERE robot_id = $1 AND kind = $2 ORDER BY runs DESC LIMIT 1)
         WHERE robot_id = $1 AND settled_history_id IS NULL AND withdrawn AND last_seen_at < $3
               AND open_run_id IS NULL AND quantity IN ({quantities})"
    )))
    .bind_all((robot_id, kind.name(), leads_from.as_microsecond()))
    .run(connection)
    .await
}

/// Keys of the tests that distinguish the epochs of a robot's latest tests.
pub(super) async fn latest_keys(connection: &mut EngineConnection, robot_id: i64) -> sqlx::Result<Vec<i64>> {
    let settled = latest(&mut *connection, robot_id, RunKind::Test).await?.unwrap_or_default();
    let [before, behind] = keys(connection, robot_id, RunKind::Test, &settled, usize::MAX).await?;
    Ok([settled.first_of_epochs, before, behind].concat())
}

/// Keys of the runs of a window, oldest first, before its boundary and after it: tests with or without a result, and
/// logs that are compared with a test.
async fn keys(
    connection: &mut EngineConnection,
    robot_id: i64,
    kind: RunKind,
    settled: &Settled,
    most: usize,
) -> sqlx::Result<[Vec<i64>; 2]> {
    let Settled { read, leads_from, boundary, .. } = settled;
    let mut before = read.clone();
    if let (Some(from), Some(until)) = (leads_from, boundary) {
        before
            .extend(between(&mut *connection, robot_id, kind, Some(*from), Some(*until), usize::MAX).await?);
    }
    Ok([before, between(connection, robot_id, kind, *boundary, None, most).await?])
}

/// Keys of the first runs in a span of time, oldest first.
async fn between(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    from: Option<Moment>,
    until: Option<Moment>,
    most: usize,
) -> sqlx::Result<Vec<i64>> {
    let of = |at: Option<Moment>, without: i64| {
        at.map_or((without, without), |(at, run_id)| (at.as_microsecond(), run_id))
    };
    let (from, until) = (of(from, i64::MIN), of(until, i64::MAX));
    // each kind has a separate index
    let statement = match kind {
        RunKind::Test => {
            "SELECT run_id FROM run
             WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND (started_at, run_id) >= ($2, $3)
                   AND (started_at, run_id) < ($4, $5)
             ORDER BY started_at, run_id LIMIT $6"
        }
        RunKind::Production => {
            "SELECT run_id FROM run
             WHERE robot_id = $1 AND kind = 'production' AND status = 'complete' AND (started_at, run_id) >= ($2, $3)
                   AND (started_at, run_id) < ($4, $5)
                   AND EXISTS (SELECT 1 FROM production_summary AS summary WHERE summary.run_id = run.run_id)
             ORDER BY started_at, run_id LIMIT $6"
        }
    };
    sqlx::query_scalar(statement)
        .bind_all((robot_id, from.0, from.1, until.0, until.1, i64::try_from(most).unwrap_or(i64::MAX)))
        .fetch_all(executor)
        .await
}

pub(super) async fn latest(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
) -> sqlx::Result<Option<Settled>> {
    let numbers = sqlx::query(
        "SELECT numbers FROM settled_history WHERE robot_id = $1 AND kind = $2 ORDER BY runs DESC LIMIT 1",
    )
    .bind_all((robot_id, kind.name()))
    .try_map(|row: EngineRow| row.try_get::<Vec<u8>, _>("numbers"))
    .fetch_optional(executor)
    .await?;
    Ok(numbers.and_then(|numbers| unpacked(&numbers)))
}

async fn insert(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    kind: RunKind,
    settled: &Settled,
) -> sqlx::Result<i64> {
    let micros = |at: Option<Moment>| at.map_or(i64::MAX, |(at, _)| at.as_microsecond());
    sqlx::query_scalar(
        "INSERT INTO settled_history (robot_id, kind, runs, boundary_at, follows_until, latest_run_id, numbers)
         SELECT $1, $2, $3, $4, $5, max(run_id), $6 FROM run
         RETURNING settled_history_id",
    )
    .bind_all((robot_id, kind.name(), i64::try_from(settled.runs).unwrap_or(i64::MAX)))
    .bind_all((micros(settled.boundary), micros(settled.follows_until), packed(settled)?))
    .fetch_one(executor)
    .await
}
