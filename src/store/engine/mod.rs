//! The door to the database engine: what statements are run on and rows are read from has its names here, and nowhere
//! else in the store.
//!
//! SQLite is the engine, and these names stand for the types of its driver. Statements number their places, `$1`, and
//! are written in the part of SQL that SQLite and PostgreSQL understand alike: `coalesce`, `CASE`,
//! `IS NOT DISTINCT FROM`, `ON CONFLICT ... DO`, a name for every subquery, columns that are grouped by or aggregated,
//! `TRUE` and `FALSE` for flags. What only one engine has is a file of this folder.

use sqlx::Database;

pub(in crate::store) mod catalog;

/// The engine.
pub(in crate::store) type Engine = sqlx::Sqlite;

/// A connection.
pub(in crate::store) type EngineConnection = <Engine as Database>::Connection;

/// Values bound to the places of a statement.
pub(in crate::store) type EngineArguments = <Engine as Database>::Arguments;

/// A row of an answer.
pub(in crate::store) type EngineRow = <Engine as Database>::Row;

/// Connections that take turns.
pub(in crate::store) type EnginePool = sqlx::Pool<Engine>;

/// A transaction with a connection of its own.
pub(in crate::store) type EngineTransaction = sqlx::Transaction<'static, Engine>;

/// Whatever a statement can be run on: a connection, or a pool of them.
pub(in crate::store) trait EngineExecutor<'c>:
    sqlx::Executor<'c, Database = Engine>
{
}

impl<'c, T: sqlx::Executor<'c, Database = Engine>> EngineExecutor<'c> for T {}

/// A transaction that has the write lock. A deferred one that reads first and writes later would fail at once where
/// this one waits.
pub(in crate::store) async fn begin_writing(writer: &EnginePool) -> Result<EngineTransaction, sqlx::Error> {
    writer.begin_with("BEGIN IMMEDIATE").await
}

/// A transaction that sees one moment of the database, that of its first read.
pub(in crate::store) async fn begin_reading(readers: &EnginePool) -> Result<EngineTransaction, sqlx::Error> {
    readers.begin().await
}
