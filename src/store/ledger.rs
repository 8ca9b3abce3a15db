//! The ledger: one row an export, whatever became of it.

use sqlx::sqlite::{SqliteExecutor, SqliteRow};
use sqlx::{Row, SqliteConnection};

use super::values::{count, finite, named, size};
use crate::run::{ContentHash, RunHeader, RunStatus};

const STATUSES: [RunStatus; 3] = [RunStatus::Streaming, RunStatus::Complete, RunStatus::Quarantined];

/// What the ledger knows of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownRun {
    /// Database key of the run.
    pub run_id: i64,
    /// Where it stands.
    pub status: RunStatus,
    /// Why it was quarantined.
    pub reason: Option<String>,
    /// Cycles stored so far; reading goes on after them.
    pub cycles_stored: u32,
}

/// Figures of a run that are known once its last row is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunTotals {
    /// Rows of the export.
    pub rows: usize,
    /// Sample rate, Hz.
    pub sample_rate: f64,
    /// Cycles of the export; all of them must be stored.
    pub cycles: u32,
}

/// Why an export was not understood, and where.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Quarantine<'a> {
    pub(super) reason: &'a str,
    pub(super) line: Option<u64>,
    pub(super) column: Option<&'a str>,
}

pub(super) fn status(row: &SqliteRow, column: &str) -> Result<RunStatus, sqlx::Error> {
    named(row, column, &STATUSES, RunStatus::name)
}

/// Begins a run, goes on with one that was begun, or begins a quarantined one afresh.
pub(super) async fn begin_run(
    connection: &mut SqliteConnection,
    header: &RunHeader,
) -> Result<KnownRun, sqlx::Error> {
    let known = find_run(&mut *connection, &header.content_hash).await?;
    let run_id = match known {
        Some(run) if run.status != RunStatus::Quarantined => return Ok(run),
        // What was stored before may rest on a layout or robot that has been corrected since.
        Some(run) => {
            delete_cycles(&mut *connection, run.run_id).await?;
            let robot_id = robot_id(&mut *connection, &header.robot).await?;
            reopen_run(&mut *connection, run.run_id, robot_id, header).await?;
            run.run_id
        }
        None => {
            let robot_id = robot_id(&mut *connection, &header.robot).await?;
            insert_run(&mut *connection, robot_id, header).await?
        }
    };
    Ok(KnownRun { run_id, status: RunStatus::Streaming, reason: None, cycles_stored: 0 })
}

/// Writes down that an export was not understood. Cycles already stored stay; a complete run stays
/// complete.
pub(super) async fn quarantine(
    connection: &mut SqliteConnection,
    header: &RunHeader,
    quarantine: Quarantine<'_>,
) -> Result<i64, sqlx::Error> {
    let run_id = match find_run(&mut *connection, &header.content_hash).await? {
        Some(run) if run.status == RunStatus::Complete => return Ok(run.run_id),
        Some(run) => run.run_id,
        None => {
            let robot_id = robot_id(&mut *connection, &header.robot).await?;
            insert_run(&mut *connection, robot_id, header).await?
        }
    };
    mark_quarantined(connection, run_id, quarantine).await?;
    Ok(run_id)
}

pub(super) async fn find_run(
    executor: impl SqliteExecutor<'_>,
    hash: &ContentHash,
) -> Result<Option<KnownRun>, sqlx::Error> {
    sqlx::query("SELECT run_id, status, reason, cycles_stored FROM run WHERE content_hash = ?")
        .bind(&hash.0[..])
        .try_map(|row| known_run(&row))
        .fetch_optional(executor)
        .await
}

/// Reads run_id, status, reason and cycles_stored.
pub(super) fn known_run(row: &SqliteRow) -> Result<KnownRun, sqlx::Error> {
    Ok(KnownRun {
        run_id: row.try_get("run_id")?,
        status: status(row, "status")?,
        reason: row.try_get("reason")?,
        cycles_stored: size(row, "cycles_stored")?,
    })
}

/// Key of a robot, which is entered on its first run.
async fn robot_id(connection: &mut SqliteConnection, name: &str) -> Result<i64, sqlx::Error> {
    sqlx::query("INSERT INTO robot (name) VALUES (?) ON CONFLICT (name) DO NOTHING")
        .bind(name)
        .execute(&mut *connection)
        .await?;
    sqlx::query_scalar("SELECT robot_id FROM robot WHERE name = ?").bind(name).fetch_one(connection).await
}

async fn insert_run(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
    header: &RunHeader,
) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar(
        "INSERT INTO run (robot_id, model, started_at, source_name, source_path, source_bytes, content_hash, status)
         VALUES (?, ?, ?, ?, ?, ?, ?, 'streaming')
         RETURNING run_id",
    )
    .bind(robot_id)
    .bind(&header.model)
    .bind(header.started_at.as_microsecond())
    .bind(&header.source_name)
    .bind(&header.source_path)
    .bind(count(header.source_bytes))
    .bind(&header.content_hash.0[..])
    .fetch_one(executor)
    .await
}

async fn reopen_run(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    robot_id: i64,
    header: &RunHeader,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE run
         SET robot_id = ?, model = ?, started_at = ?, source_name = ?, source_path = ?, source_bytes = ?,
             cycles_stored = 0, status = 'streaming', reason = NULL, reason_line = NULL, reason_column = NULL
         WHERE run_id = ?",
    )
    .bind(robot_id)
    .bind(&header.model)
    .bind(header.started_at.as_microsecond())
    .bind(&header.source_name)
    .bind(&header.source_path)
    .bind(count(header.source_bytes))
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}

async fn delete_cycles(executor: impl SqliteExecutor<'_>, run_id: i64) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM cycle WHERE run_id = ?").bind(run_id).execute(executor).await?;
    Ok(())
}

async fn mark_quarantined(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    quarantine: Quarantine<'_>,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE run SET status = 'quarantined', reason = ?, reason_line = ?, reason_column = ? WHERE run_id = ?",
    )
    .bind(quarantine.reason)
    .bind(quarantine.line.map(count))
    .bind(quarantine.column)
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// Start of a run that takes cycles, in microseconds; `None` if it takes none.
pub(super) async fn open_run_start(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar("SELECT started_at FROM run WHERE run_id = ? AND status = 'streaming'")
        .bind(run_id)
        .fetch_optional(executor)
        .await
}

/// Robot of a run that is not quarantined.
pub(super) async fn robot_of_run(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar("SELECT robot_id FROM run WHERE run_id = ? AND status <> 'quarantined'")
        .bind(run_id)
        .fetch_optional(executor)
        .await
}

/// Moves the mark of progress by one cycle.
pub(super) async fn advance(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    robot_model_id: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query("UPDATE run SET cycles_stored = cycles_stored + 1, robot_model_id = ? WHERE run_id = ?")
        .bind(robot_model_id)
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(())
}

pub(super) async fn mark_complete(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    totals: RunTotals,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE run SET status = 'complete', rows = ?, sample_rate_hz = ?, cycles_total = ? WHERE run_id = ?",
    )
    .bind(count(totals.rows))
    .bind(finite(totals.sample_rate))
    .bind(totals.cycles)
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// Takes away a run that is not complete, with its cycles. Returns whether there was one.
pub(super) async fn discard(executor: impl SqliteExecutor<'_>, run_id: i64) -> Result<bool, sqlx::Error> {
    let done = sqlx::query("DELETE FROM run WHERE run_id = ? AND status <> 'complete'")
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(done.rows_affected() > 0)
}
