//! What an engine says of its own database: the views that there are, their columns, and whether something was committed.

use super::{EngineExecutor, EnginePool};

/// Views with their columns, by name and in order.
pub(in crate::store) async fn views(readers: &EnginePool) -> Result<Vec<(String, String)>, sqlx::Error> {
    sqlx::query_as(
        "SELECT view.name, of.name
         FROM sqlite_schema AS view JOIN pragma_table_info(view.name) AS of
         WHERE view.type = 'view'
         ORDER BY view.name, of.cid",
    )
    .fetch_all(readers)
    .await
}

/// Columns of one view, which SQLite works out from its statement; none where there is no such view.
pub(in crate::store) async fn columns_of_view(
    readers: &EnginePool,
    view: &str,
) -> Result<Vec<String>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT of.name
         FROM sqlite_schema AS view JOIN pragma_table_info(view.name) AS of
         WHERE view.type = 'view' AND view.name = $1
         ORDER BY of.cid",
    )
    .bind(view)
    .fetch_all(readers)
    .await
}

/// A number that changes when another connection has committed.
pub(in crate::store) async fn data_version(executor: impl EngineExecutor<'_>) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar("PRAGMA data_version").fetch_one(executor).await
}

/// Whether a column of a view equals what is bound to `$place` as a text or to the place after it as a number: a text
/// equals a text, and a number a number, whatever affinity the column has.
pub(in crate::store) fn equals(column: &str, place: usize) -> String {
    format!("(\"{column}\" = ${place} OR \"{column}\" = ${})", place + 1)
}
