//! Which run takes the place of which.

use crate::engine::{EngineConnection, EngineExecutor};

pub(crate) async fn set_replaced(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    old: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query("UPDATE run SET replaces_run_id = $1 WHERE run_id = $2")
        .bind(old)
        .bind(run_id)
        .execute(executor)
        .await?;
    Ok(())
}

/// Run that this one takes the place of when it is complete.
pub(crate) async fn replaced_by(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> Result<Option<i64>, sqlx::Error> {
    let found: Option<Option<i64>> = sqlx::query_scalar("SELECT replaces_run_id FROM run WHERE run_id = $1")
        .bind(run_id)
        .fetch_optional(executor)
        .await?;
    Ok(found.flatten())
}

async fn is_as_long_or_here(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    old: i64,
) -> Result<bool, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT new.kind = old.kind AND (new.source_path = old.source_path OR new.cycles_stored >= old.cycles_stored)
         FROM run AS new, run AS old
         WHERE new.run_id = $1 AND old.run_id = $2",
    )
    .bind(run_id)
    .bind(old)
    .fetch_one(executor)
    .await
}

/// Marks `old` as superseded by `run_id`. Its rows stay.
pub(crate) async fn supersede(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    old: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE run
         SET status = 'quarantined', reason = 'superseded by run ' || $1 || ': the recording was exported again',
             reason_line = NULL, reason_column = NULL, retry_asked_at = NULL, superseded_by_run_id = $1
         WHERE run_id = $2 AND superseded_by_run_id IS NULL",
    )
    .bind(run_id)
    .bind(old)
    .execute(executor)
    .await?;
    Ok(())
}

/// Lets `other` be the successor of what `run_id` has superseded.
pub(crate) async fn hand_on(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    other: i64,
) -> Result<(), sqlx::Error> {
    sqlx::query(
        "UPDATE run
         SET reason = 'superseded by run ' || $1 || substr(reason, instr(reason, ':')), superseded_by_run_id = $1
         WHERE superseded_by_run_id = $2",
    )
    .bind(other)
    .bind(run_id)
    .execute(executor)
    .await?;
    Ok(())
}

/// Marks `old` as superseded by `run_id`, which is read to its end; not if that is of another path and has
/// fewer cycles, since a part of a copy is no correction, nor if it is a recording of another kind. Returns whether it
/// was done.
pub(crate) async fn supersede_shorter(
    connection: &mut EngineConnection,
    run_id: i64,
    old: i64,
) -> Result<bool, sqlx::Error> {
    let is_in_its_place = is_as_long_or_here(&mut *connection, run_id, old).await?;
    if is_in_its_place {
        supersede(connection, run_id, old).await?;
    }
    Ok(is_in_its_place)
}
