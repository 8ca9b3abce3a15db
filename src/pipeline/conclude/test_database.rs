//! A database for tests of conclusions, with a separate connection to change its rows, and a check of kept summaries.

use std::ops::Deref;

use sqlx::{AssertSqlSafe, Row, SqlitePool};
use tempfile::TempDir;

use super::method::METHOD;
use armwatch_store::Store;

/// A store, and rows behind it.
pub(super) struct Database {
    store: Store,
    /// Connections in addition to those of the store.
    pub(super) rows: SqlitePool,
}

impl Deref for Database {
    type Target = Store;

    fn deref(&self) -> &Store {
        &self.store
    }
}

/// A fresh database; the folder lives as long as the first value.
pub(super) async fn fresh() -> (TempDir, Database) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("fleet.db");
    let store = Store::open(&path).await.expect("a store");
    let rows = SqlitePool::connect(&path.display().to_string()).await.expect("connections");
    (folder, Database { store, rows })
}

/// Checks that stored summaries of all robots equal the tables.
pub(in crate::pipeline) async fn assert_summaries_hold(store: &Store) {
    for (robot_id, robot) in store.tested_robots().await.expect("robots") {
        let kept = store.latest_window(robot_id, METHOD).await.expect("a window");
        let of_tables = store.run_summaries(robot_id).await.expect("summaries");
        assert_eq!(format!("{kept:?}"), format!("{of_tables:?}"), "{robot}");
    }
}

/// Runs a statement that changes rows; returns their number.
pub(super) async fn change(database: &Database, statement: &str) -> u64 {
    let done = sqlx::query(AssertSqlSafe(statement.to_owned())).execute(&database.rows).await;
    done.unwrap_or_else(|error| panic!("{statement}: {error}")).rows_affected()
}

/// The number that a query returns.
pub(super) async fn count(database: &Database, statement: &'static str) -> i64 {
    sqlx::query_scalar(statement).fetch_one(&database.rows).await.expect("a count")
}

/// Checks that the database is intact and has no dangling references.
pub(super) async fn assert_sound(database: &Database) {
    let dangling = sqlx::query("PRAGMA foreign_key_check").fetch_all(&database.rows).await.expect("a check");
    assert!(dangling.is_empty(), "{} rows refer to nothing", dangling.len());
    let integrity = sqlx::query("PRAGMA integrity_check").fetch_one(&database.rows).await.expect("a check");
    assert_eq!(integrity.get::<String, _>(0), "ok");
}
