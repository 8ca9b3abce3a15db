//! Cycles of a run that stay when its export is read again.

use crate::engine::{EngineExecutor, Run};
use crate::values::count;

/// True if the stored cycles of a run were read from exactly the first `bytes` of its content.
pub(super) async fn are_of_first(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    bytes: u64,
) -> sqlx::Result<bool> {
    let read: Option<i64> = sqlx::query_scalar("SELECT prefix_bytes FROM run WHERE run_id = $1")
        .bind(run_id)
        .fetch_one(executor)
        .await?;
    Ok(read == Some(count(bytes)))
}

/// Deletes cycles that the end of the file has cut. Returns true if there were any.
pub(super) async fn delete_cut_by_end(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    let done = sqlx::query("DELETE FROM cycle WHERE run_id = $1 AND cut_by_end = TRUE")
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(done.rows_affected() > 0)
}

/// Sets the progress to the number of stored cycles.
pub(super) async fn count_again(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run SET cycles_stored = (SELECT count(*) FROM cycle WHERE cycle.run_id = run.run_id)
         WHERE run_id = $1",
    )
    .bind(run_id)
    .run(executor)
    .await
}

/// Deletes the last cycle of a complete run that was stored by a version that did not mark cycles cut by the end.
pub(super) async fn delete_last(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "DELETE FROM cycle
         WHERE run_id = $1 AND number = (SELECT max(last.number) FROM cycle AS last WHERE last.run_id = $1)",
    )
    .bind(run_id)
    .run(executor)
    .await
}

/// Deletes all cycles of a run.
pub(super) async fn delete_all(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM cycle WHERE run_id = $1").bind(run_id).run(executor).await
}
