//! Supersession of runs.

use sqlx::Row;

use crate::engine::{Bind, EngineConnection, EngineExecutor, Run};

pub(crate) async fn set_replaced(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    old: i64,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE run SET replaces_run_id = $1 WHERE run_id = $2")
        .bind_all((old, run_id))
        .run(executor)
        .await
}

/// Run that this one supersedes when it is complete.
pub(crate) async fn replaced_by(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Option<i64>> {
    let found: Option<Option<i64>> = sqlx::query_scalar("SELECT replaces_run_id FROM run WHERE run_id = $1")
        .bind(run_id)
        .fetch_optional(executor)
        .await?;
    Ok(found.flatten())
}

/// The outcome for two runs of one recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Contest {
    /// The new run supersedes the old one.
    New,
    /// The old run stays in force, because the new one has no result.
    Old,
    /// Both stay in force: they are recordings of two kinds, or the new one is part of a copy.
    Both,
}

/// Compares two runs of a recording by their cycles with a result. If the file was overwritten, its old content is
/// gone, so one result is enough. A file under another path must have as many results, since a part of a copy is no
/// correction.
async fn contest(executor: impl EngineExecutor<'_>, run_id: i64, old: i64) -> sqlx::Result<Contest> {
    let row = sqlx::query(
        "SELECT new.kind = old.kind AS same_kind, new.source_path = old.source_path AS same_path,
                new.cycles_stored AS new_cycles, old.cycles_stored AS old_cycles,
                (SELECT count(*) FROM cycle WHERE cycle.run_id = $1 AND cycle.status <> 'refused') AS new_good,
                (SELECT count(*) FROM cycle WHERE cycle.run_id = $2 AND cycle.status <> 'refused') AS old_good
         FROM run AS new, run AS old
         WHERE new.run_id = $1 AND old.run_id = $2",
    )
    .bind_all((run_id, old))
    .fetch_one(executor)
    .await?;
    let (new_good, old_good): (i64, i64) = (row.try_get("new_good")?, row.try_get("old_good")?);
    let (same_kind, same_path): (bool, bool) = (row.try_get("same_kind")?, row.try_get("same_path")?);
    let (new_cycles, old_cycles): (i64, i64) = (row.try_get("new_cycles")?, row.try_get("old_cycles")?);
    Ok(match (same_kind, new_good) {
        (false, _) => Contest::Both,
        (true, 0) if old_good > 0 => Contest::Old,
        (true, _) if same_path || (new_good, new_cycles) >= (old_good, old_cycles) => Contest::New,
        (true, _) => Contest::Both,
    })
}

/// Marks `old` as superseded by `run_id`. Its rows stay.
pub(crate) async fn supersede(executor: impl EngineExecutor<'_>, run_id: i64, old: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET status = 'quarantined', reason = 'superseded by run ' || $1 || ': the recording was exported again',
             reason_line = NULL, reason_column = NULL, retry_asked_at = NULL, superseded_by_run_id = $1
         WHERE run_id = $2 AND superseded_by_run_id IS NULL",
    )
    .bind_all((run_id, old))
    .run(executor)
    .await
}

/// Makes `other` the successor of the runs that `run_id` has superseded.
pub(crate) async fn hand_on(executor: impl EngineExecutor<'_>, run_id: i64, other: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET reason = 'superseded by run ' || $1 || substr(reason, instr(reason, ':')), superseded_by_run_id = $1
         WHERE superseded_by_run_id = $2",
    )
    .bind_all((other, run_id))
    .run(executor)
    .await
}

/// Lets `run_id`, which is read to its end, supersede `old` if it wins the [contest](Contest). Returns the outcome.
pub(crate) async fn supersede_worse(
    connection: &mut EngineConnection,
    run_id: i64,
    old: i64,
) -> sqlx::Result<Contest> {
    let contest = contest(&mut *connection, run_id, old).await?;
    if contest == Contest::New {
        supersede(connection, run_id, old).await?;
    }
    Ok(contest)
}

/// Sets aside a complete run without a result, since `old` is the same recording and has results. Its rows stay.
pub(crate) async fn set_aside(executor: impl EngineExecutor<'_>, run_id: i64, old: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET status = 'quarantined', superseded_by_run_id = $1,
             reason = 'does not replace run ' || $1 || ', which is the same recording: no cycle has a result'
         WHERE run_id = $2",
    )
    .bind_all((old, run_id))
    .run(executor)
    .await
}
