//! Writes what is known of complete tests in brief, from their series.

use super::cycle_friction_rows;
use super::figures::{cycle_friction, run_brief, run_series};
use crate::engine::{EngineConnection, EngineExecutor};
use crate::values::json_list;

/// Makes the rows of those of these tests that have none, which have changed since conclusions were drawn. Their series and
/// friction by cycle are made, too. Call in a transaction.
pub(super) async fn complete(connection: &mut EngineConnection, keys: &[i64]) -> Result<(), sqlx::Error> {
    let without = without(&mut *connection, keys).await?;
    if without.is_empty() {
        return Ok(());
    }
    let inertial = cycle_friction::inertial(&mut *connection).await?;
    for run_id in without {
        cycle_friction_rows::complete(&mut *connection, run_id).await?;
        let series = run_series::make(&mut *connection, run_id).await?;
        let known = run_brief::of_series(series, run_id, &inertial);
        run_brief::insert(&mut *connection, run_id, &known).await?;
    }
    Ok(())
}

async fn without(executor: impl EngineExecutor<'_>, keys: &[i64]) -> Result<Vec<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)) AND kind = 'test' AND status = 'complete'
               AND NOT EXISTS (SELECT 1 FROM run_brief WHERE run_brief.run_id = run.run_id)
         ORDER BY started_at, run_id",
    )
    .bind(json_list(keys))
    .fetch_all(executor)
    .await
}
