//! Files as they were last seen.

use jiff::Timestamp;
use sqlx::sqlite::SqliteExecutor;

use super::ledger::{KnownRun, known_run};
use super::values::count;

/// A file as the file system describes it, without a look into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SourceState {
    /// Size, bytes.
    pub bytes: u64,
    /// Time of the last modification.
    pub modified: Timestamp,
}

pub(super) async fn find(
    executor: impl SqliteExecutor<'_>,
    path: &str,
    state: SourceState,
) -> Result<Option<KnownRun>, sqlx::Error> {
    sqlx::query(
        "SELECT run.run_id, run.status, run.reason, run.cycles_stored
         FROM source_file JOIN run USING (run_id)
         WHERE source_file.path = ? AND source_file.bytes = ? AND source_file.modified = ?",
    )
    .bind(path)
    .bind(count(state.bytes))
    .bind(state.modified.as_microsecond())
    .try_map(|row| known_run(&row))
    .fetch_optional(executor)
    .await
}

pub(super) async fn remember(
    executor: impl SqliteExecutor<'_>,
    path: &str,
    state: SourceState,
    run_id: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO source_file (path, bytes, modified, run_id) VALUES (?, ?, ?, ?)
         ON CONFLICT (path) DO UPDATE
         SET bytes = excluded.bytes, modified = excluded.modified, run_id = excluded.run_id",
    )
    .bind(path)
    .bind(count(state.bytes))
    .bind(state.modified.as_microsecond())
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}
