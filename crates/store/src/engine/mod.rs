//! The door to the database engine: what statements are run on and rows are read from has its names here, and nowhere
//! else in the store.
//!
//! The engine is SQLite or PostgreSQL, by the connection. Statements number their places, `$1`, and are written in the part of
//! SQL that both understand: `coalesce`, `CASE`, `IS NOT DISTINCT FROM`, `ON CONFLICT ... DO`, a name for every subquery,
//! columns that are grouped by or aggregated, `TRUE` and `FALSE` for flags. What only one engine has is a file of this
//! folder.

pub(crate) mod catalog;
pub(crate) mod host_lock;
mod either;
pub(crate) mod sqlstate;

pub(crate) use self::either::{Engine, EngineArguments, EngineConnectOptions, EngineConnection, EngineRow};

/// Connections that take turns.
pub(crate) type EnginePool = sqlx::Pool<Engine>;

/// How connections take turns.
pub(crate) type EnginePoolOptions = sqlx::pool::PoolOptions<Engine>;

/// A transaction with a connection of its own.
pub(crate) type EngineTransaction = sqlx::Transaction<'static, Engine>;

/// Whatever a statement can be run on: a connection, or a pool of them.
pub(crate) trait EngineExecutor<'c>: sqlx::Executor<'c, Database = Engine> {}

impl<'c, T: sqlx::Executor<'c, Database = Engine>> EngineExecutor<'c> for T {}

/// Which engine a database has.
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
pub(crate) async fn begin_writing(writer: &EnginePool) -> Result<EngineTransaction, sqlx::Error> {
    match dialect(writer) {
        Dialect::Sqlite => writer.begin_with("BEGIN IMMEDIATE").await,
        // the lock is the same for all transactions that write, whatever program they are of; it goes with the transaction
        Dialect::Postgres => {
            let mut transaction = writer.begin().await?;
            let locked = sqlx::query("SELECT pg_catalog.pg_advisory_xact_lock(1098343522, 1)");
            locked.execute(&mut *transaction).await?;
            Ok(transaction)
        }
    }
}

/// A transaction that sees one moment of the database, that of its first read.
pub(crate) async fn begin_reading(readers: &EnginePool) -> Result<EngineTransaction, sqlx::Error> {
    match dialect(readers) {
        Dialect::Sqlite => readers.begin().await,
        Dialect::Postgres => readers.begin_with("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY").await,
    }
}
