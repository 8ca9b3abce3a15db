//! Information of an engine about its database: views, their columns, commits and size.

use super::{Dialect, EnginePool, dialect};

/// Views with their columns, by name and in order.
pub(crate) async fn views(readers: &EnginePool) -> sqlx::Result<Vec<(String, String)>> {
    sqlx::query_as(match dialect(readers) {
        Dialect::Sqlite => {
            "SELECT view.name, of.name
             FROM sqlite_schema AS view JOIN pragma_table_info(view.name) AS of
             WHERE view.type = 'view'
             ORDER BY view.name, of.cid"
        }
        Dialect::Postgres => {
            "SELECT CAST(listed.relname AS text), CAST(described.attname AS text)
             FROM pg_class AS listed JOIN pg_attribute AS described ON described.attrelid = listed.oid
             WHERE listed.relkind = 'v' AND listed.relnamespace = CAST('armwatch' AS regnamespace)
             ORDER BY listed.relname, described.attnum"
        }
    })
    .fetch_all(readers)
    .await
}

/// Columns of one view, which the engine derives from its statement; empty if there is no such view.
pub(crate) async fn columns_of_view(readers: &EnginePool, view: &str) -> sqlx::Result<Vec<String>> {
    sqlx::query_scalar(match dialect(readers) {
        Dialect::Sqlite => {
            "SELECT of.name
             FROM sqlite_schema AS view JOIN pragma_table_info(view.name) AS of
             WHERE view.type = 'view' AND view.name = $1
             ORDER BY of.cid"
        }
        Dialect::Postgres => {
            "SELECT CAST(described.attname AS text)
             FROM pg_class AS listed JOIN pg_attribute AS described ON described.attrelid = listed.oid
             WHERE listed.relkind = 'v' AND listed.relnamespace = CAST('armwatch' AS regnamespace)
                   AND listed.relname = $1
             ORDER BY described.attnum"
        }
    })
    .bind(view)
    .fetch_all(readers)
    .await
}

/// A number that changes when another connection has committed. On a server it changes with every transaction, also in
/// other databases.
pub(crate) async fn data_version(probe: &EnginePool) -> sqlx::Result<i64> {
    sqlx::query_scalar(match dialect(probe) {
        Dialect::Sqlite => "PRAGMA data_version",
        Dialect::Postgres => "SELECT CAST(CAST(pg_snapshot_xmax(pg_current_snapshot()) AS text) AS bigint)",
    })
    .fetch_one(probe)
    .await
}

/// Size of the database on its server, bytes.
pub(crate) async fn bytes_on_server(readers: &EnginePool) -> sqlx::Result<i64> {
    sqlx::query_scalar("SELECT pg_database_size(current_database())").fetch_one(readers).await
}

/// Condition that a column of a view equals the text bound to `$place` or the number bound to the next place. A text
/// only equals a text, and a number only a number, whatever the affinity of the column.
pub(crate) fn equals(dialect: Dialect, column: &str, place: usize) -> String {
    match dialect {
        Dialect::Sqlite => format!("(\"{column}\" = ${place} OR \"{column}\" = ${})", place + 1),
        Dialect::Postgres => format!("equals(\"{column}\", ${place}, ${})", place + 1),
    }
}
