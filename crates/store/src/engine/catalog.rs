//! What an engine says of its own database: the views that there are, their columns, whether something was committed, how
//! large it is.

use super::{Dialect, EnginePool, dialect};

/// Views with their columns, by name and in order.
pub(crate) async fn views(readers: &EnginePool) -> Result<Vec<(String, String)>, sqlx::Error> {
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

/// Columns of one view, which the engine works out from its statement; none where there is no such view.
pub(crate) async fn columns_of_view(readers: &EnginePool, view: &str) -> Result<Vec<String>, sqlx::Error> {
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

/// A number that changes when another connection has committed. That of a server changes with every transaction there,
/// also of other databases.
pub(crate) async fn data_version(probe: &EnginePool) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar(match dialect(probe) {
        Dialect::Sqlite => "PRAGMA data_version",
        Dialect::Postgres => "SELECT CAST(CAST(pg_snapshot_xmax(pg_current_snapshot()) AS text) AS bigint)",
    })
    .fetch_one(probe)
    .await
}

/// Bytes that the database has on its server.
pub(crate) async fn bytes_on_server(readers: &EnginePool) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar("SELECT pg_database_size(current_database())").fetch_one(readers).await
}

/// Whether a column of a view equals what is bound to `$place` as a text or to the place after it as a number: a text
/// equals a text, and a number a number, whatever affinity the column has.
pub(crate) fn equals(dialect: Dialect, column: &str, place: usize) -> String {
    match dialect {
        Dialect::Sqlite => format!("(\"{column}\" = ${place} OR \"{column}\" = ${})", place + 1),
        Dialect::Postgres => format!("equals(\"{column}\", ${place}, ${})", place + 1),
    }
}
