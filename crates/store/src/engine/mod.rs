//! The interface to the database engine: the store names the types of connections, statements and rows only here.
//!
//! The engine is SQLite or PostgreSQL, by the connection. Statements number their places, `$1`, and use the part of SQL
//! that both understand: `coalesce`, `CASE`, `IS NOT DISTINCT FROM`, `ON CONFLICT ... DO`, a name for every subquery,
//! columns that are grouped by or aggregated, `TRUE` and `FALSE` for flags. Code for one engine only is in files of
//! this folder.

pub(crate) mod catalog;
pub(crate) mod host_lock;
mod either;
mod places;
pub(crate) mod sqlstate;

pub(crate) use self::either::{Engine, EngineArguments, EngineConnectOptions, EngineConnection, EngineRow};
pub(crate) use self::places::{Bind, Run, row_of};

/// A pool of connections.
pub(crate) type EnginePool = sqlx::Pool<Engine>;

/// Options of a pool.
pub(crate) type EnginePoolOptions = sqlx::pool::PoolOptions<Engine>;

/// A transaction with a separate connection.
pub(crate) type EngineTransaction = sqlx::Transaction<'static, Engine>;

/// Any target of a statement: a connection, or a pool of them.
pub(crate) trait EngineExecutor<'c>: sqlx::Executor<'c, Database = Engine> {}

impl<'c, T: sqlx::Executor<'c, Database = Engine>> EngineExecutor<'c> for T {}

/// Engine of a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Dialect {
    Sqlite,
    Postgres,
}

/// The engine of a pool's connections.
pub(crate) fn dialect(pool: &EnginePool) -> Dialect {
    match *pool.connect_options() {
        EngineConnectOptions::Sqlite(_) => Dialect::Sqlite,
        EngineConnectOptions::Postgres(_) => Dialect::Postgres,
    }
}

/// A transaction that has the write lock. A deferred one that reads first and writes later would fail at once where
/// this one waits.
pub(crate) async fn begin_writing(writer: &EnginePool) -> sqlx::Result<EngineTransaction> {
    match dialect(writer) {
        Dialect::Sqlite => writer.begin_with("BEGIN IMMEDIATE").await,
        // the lock is the same for all transactions that write, in all programs; it ends with the transaction
        Dialect::Postgres => {
            let mut transaction = writer.begin().await?;
            let locked = sqlx::query("SELECT pg_catalog.pg_advisory_xact_lock(1098343522, 1)");
            locked.execute(&mut *transaction).await?;
            Ok(transaction)
        }
    }
}

/// A transaction that sees the database at the moment of its first read.
pub(crate) async fn begin_reading(readers: &EnginePool) -> sqlx::Result<EngineTransaction> {
    match dialect(readers) {
        Dialect::Sqlite => readers.begin().await,
        Dialect::Postgres => readers.begin_with("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY").await,
    }
}
