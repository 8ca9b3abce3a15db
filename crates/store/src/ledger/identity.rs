//! Identity of recordings, and the inputs of a run's stored cycles.

use jiff::Timestamp;
use sqlx::Row;

use super::runs::{KnownRun, known_run};
use crate::engine::{Bind, EngineConnection, EngineExecutor, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::time_in_views;
use armwatch_model::run::ContentHash;

impl Store {
    /// The runs of an export with this content, each with its robot and the name of its file. One export may have the
    /// columns of several robots.
    pub async fn runs_of_content(
        &self,
        hash: &ContentHash,
    ) -> Result<Vec<(KnownRun, String, String)>, StoreError> {
        let runs = sqlx::query(
            "SELECT run_id, CASE WHEN superseded_by_run_id IS NULL THEN status WHEN superseded_by_run_id = run.run_id
                         THEN 'set_aside' ELSE 'superseded' END AS status, reason,
                    cycles_stored, retry_asked_at IS NOT NULL AS retry_asked, robot.name AS robot, source_name
             FROM run
             JOIN robot USING (robot_id)
             WHERE content_hash = $1
             ORDER BY run_id",
        )
        .bind(&hash.0[..])
        .try_map(|row| Ok((known_run(&row)?, row.try_get("robot")?, row.try_get("source_name")?)))
        .fetch_all(&self.readers)
        .await;
        self.checked(runs)
    }
}

/// True if a run that could continue has cycles that were made with something else. A quarantined or superseded run
/// begins from its first row in any case.
pub(crate) async fn is_made_otherwise(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    made_with: &ContentHash,
) -> sqlx::Result<bool> {
    sqlx::query_scalar(
        "SELECT EXISTS (
             SELECT 1 FROM run
             WHERE run_id = $1 AND cycles_stored > 0 AND status <> 'quarantined' AND made_with IS DISTINCT FROM $2
         )",
    )
    .bind_all((run_id, &made_with.0[..]))
    .fetch_one(executor)
    .await
}

pub(crate) async fn set_made_with(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    made_with: &ContentHash,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET made_with = $1 WHERE run_id = $2")
        .bind_all((&made_with.0[..], run_id))
        .run(executor)
        .await
}

/// Moves the start of a run to the time in its export, and those of its cycles by the same amount. Keeps a start that a
/// person has corrected.
pub(crate) async fn set_start(
    connection: &mut EngineConnection,
    run_id: i64,
    started_at: Timestamp,
) -> sqlx::Result<()> {
    let recorded = "UPDATE run SET recorded_start = $2, recorded_start_text = $3
                    WHERE run_id = $1 AND recorded_start IS NOT NULL";
    let noted = sqlx::query(recorded)
        .bind_all((run_id, started_at.as_microsecond(), time_in_views(started_at)))
        .execute(&mut *connection)
        .await?;
    match noted.rows_affected() {
        0 => move_start(connection, run_id, started_at).await,
        _ => Ok(()),
    }
}

/// Moves the start of a run, and those of its cycles by the same amount.
pub(crate) async fn move_start(
    connection: &mut EngineConnection,
    run_id: i64,
    started_at: Timestamp,
) -> sqlx::Result<()> {
    for sql in [
        "UPDATE cycle
         SET started_at = started_at + $2 - (SELECT run.started_at FROM run WHERE run.run_id = $1)
         WHERE run_id = $1",
        "UPDATE run SET started_at = $2 WHERE run_id = $1",
    ] {
        sqlx::query(sql).bind(run_id).bind(started_at.as_microsecond()).execute(&mut *connection).await?;
    }
    Ok(())
}

/// Stores the hash of a run's first rows.
pub(crate) async fn set_first_rows(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    first_rows: &ContentHash,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET first_rows = $1 WHERE run_id = $2")
        .bind_all((&first_rows.0[..], run_id))
        .run(executor)
        .await
}

/// True if two runs certainly have different first rows.
pub(crate) async fn begin_otherwise(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    old: i64,
) -> sqlx::Result<bool> {
    sqlx::query_scalar(
        "SELECT coalesce(new.first_rows <> old.first_rows, FALSE) FROM run AS new, run AS old
         WHERE new.run_id = $1 AND old.run_id = $2",
    )
    .bind_all((run_id, old))
    .fetch_one(executor)
    .await
}
