//! Claims of sessions. A claim is one row: the session that inserts it has it, no other session waits for it, and it
//! ends with its session. It is only inserted while the session is alive; a lock on the session's row prevents its end
//! during that time.

use std::collections::HashSet;

use super::kinds::ClaimKind;
use crate::engine::{Bind, EngineExecutor, Run};

/// The session that has claimed a subject.
pub(crate) async fn holder(
    executor: impl EngineExecutor<'_>,
    kind: ClaimKind,
    subject: &str,
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar("SELECT host_session_id FROM claim WHERE kind = $1 AND subject = $2")
        .bind_all((kind.name(), subject))
        .fetch_optional(executor)
        .await
}

/// Claims a subject; `false` if another session has it, or this one has ended.
pub(crate) async fn claim(
    executor: impl EngineExecutor<'_>,
    kind: ClaimKind,
    subject: &str,
    session: i64,
) -> sqlx::Result<bool> {
    let done = sqlx::query(
        "INSERT INTO claim (kind, subject, host_session_id, claimed_at)
         SELECT $1, $2, host_session_id, clock_us() FROM host_session
         WHERE host_session_id = $3 AND ended_at IS NULL
         FOR SHARE
         ON CONFLICT (kind, subject) DO UPDATE SET claimed_at = excluded.claimed_at
         WHERE claim.host_session_id = excluded.host_session_id",
    )
    .bind_all((kind.name(), subject, session))
    .execute(executor)
    .await?;
    Ok(done.rows_affected() > 0)
}

pub(crate) async fn release(
    executor: impl EngineExecutor<'_>,
    kind: ClaimKind,
    subject: &str,
    session: i64,
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM claim WHERE kind = $1 AND subject = $2 AND host_session_id = $3")
        .bind_all((kind.name(), subject, session))
        .run(executor)
        .await
}

/// Runs that other sessions have claimed.
pub(crate) async fn runs_of_others(
    executor: impl EngineExecutor<'_>,
    session: i64,
) -> sqlx::Result<HashSet<i64>> {
    let runs: Vec<i64> = sqlx::query_scalar(
        "SELECT CAST(subject AS bigint) FROM claim WHERE kind = 'run' AND host_session_id <> $1",
    )
    .bind(session)
    .fetch_all(executor)
    .await?;
    Ok(runs.into_iter().collect())
}

/// True if another session has claimed a run.
pub(crate) async fn is_of_another(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    session: i64,
) -> sqlx::Result<bool> {
    sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM claim WHERE kind = 'run' AND subject = CAST($1 AS text) AND host_session_id <> $2)",
    )
    .bind_all((run_id, session))
    .fetch_one(executor)
    .await
}
