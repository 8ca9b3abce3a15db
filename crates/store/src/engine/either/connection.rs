//! Connections to either engine, and their options.

use std::str::FromStr;
use std::time::Duration;

use futures_util::future::{BoxFuture, FutureExt, TryFutureExt, ready};
use futures_util::stream::{self, BoxStream, StreamExt, TryStreamExt};
use log::LevelFilter;
use sqlx::error::{BoxDynError, Error};
use sqlx::postgres::{PgConnectOptions, PgConnection, Postgres};
use sqlx::sqlite::{Sqlite, SqliteArguments, SqliteConnectOptions, SqliteConnection};
use sqlx::{
    Arguments, AssertSqlSafe, ConnectOptions, Connection, Database, Execute, Executor, SqlSafeStr, SqlStr,
    Transaction,
};
use sqlx_core::Url;
use sqlx_core::transaction::TransactionManager;

use super::arguments::EngineArguments;
use super::name::Engine;
use super::row::{EngineQueryResult, EngineRow, EngineStatement};
use super::type_info::EngineTypeInfo;

/// Options of a connection, which also determine the engine.
#[derive(Debug, Clone)]
pub(crate) enum EngineConnectOptions {
    Sqlite(SqliteConnectOptions),
    Postgres(PgConnectOptions),
}

impl FromStr for EngineConnectOptions {
    type Err = Error;

    fn from_str(address: &str) -> Result<Self, Error> {
        match address.split_once("://") {
            Some(("postgres" | "postgresql", _)) => address.parse().map(Self::Postgres),
            _ => address.parse().map(Self::Sqlite),
        }
    }
}

impl ConnectOptions for EngineConnectOptions {
    type Connection = EngineConnection;

    fn from_url(url: &Url) -> Result<Self, Error> {
        url.as_str().parse()
    }

    fn to_url_lossy(&self) -> Url {
        match self {
            Self::Sqlite(options) => options.to_url_lossy(),
            Self::Postgres(options) => options.to_url_lossy(),
        }
    }

    async fn connect(&self) -> Result<EngineConnection, Error> {
        match self {
            Self::Sqlite(options) => options.connect().await.map(EngineConnection::Sqlite),
            Self::Postgres(options) => options.connect().await.map(EngineConnection::Postgres),
        }
    }

    fn log_statements(self, level: LevelFilter) -> Self {
        match self {
            Self::Sqlite(options) => Self::Sqlite(options.log_statements(level)),
            Self::Postgres(options) => Self::Postgres(options.log_statements(level)),
        }
    }

    fn log_slow_statements(self, level: LevelFilter, duration: Duration) -> Self {
        match self {
            Self::Sqlite(options) => Self::Sqlite(options.log_slow_statements(level, duration)),
            Self::Postgres(options) => Self::Postgres(options.log_slow_statements(level, duration)),
        }
    }
}

/// A connection.
#[derive(Debug)]
pub(crate) enum EngineConnection {
    Sqlite(SqliteConnection),
    Postgres(PgConnection),
}

impl Connection for EngineConnection {
    type Database = Engine;
    type Options = EngineConnectOptions;

    async fn close(self) -> Result<(), Error> {
        match self {
            Self::Sqlite(connection) => connection.close().await,
            Self::Postgres(connection) => connection.close().await,
        }
    }

    async fn close_hard(self) -> Result<(), Error> {
        match self {
            Self::Sqlite(connection) => connection.close_hard().await,
            Self::Postgres(connection) => connection.close_hard().await,
        }
    }

    async fn ping(&mut self) -> Result<(), Error> {
        match self {
            Self::Sqlite(connection) => connection.ping().await,
            Self::Postgres(connection) => connection.ping().await,
        }
    }

    fn begin(&mut self) -> impl Future<Output = Result<Transaction<'_, Engine>, Error>> + Send + '_ {
        Transaction::begin(self, None)
    }

    fn begin_with(
        &mut self,
        statement: impl SqlSafeStr,
    ) -> impl Future<Output = Result<Transaction<'_, Engine>, Error>> + Send + '_ {
        Transaction::begin(self, Some(statement.into_sql_str()))
    }

    fn shrink_buffers(&mut self) {
        match self {
            Self::Sqlite(connection) => connection.shrink_buffers(),
            Self::Postgres(connection) => connection.shrink_buffers(),
        }
    }

    async fn flush(&mut self) -> Result<(), Error> {
        match self {
            Self::Sqlite(connection) => connection.flush().await,
            Self::Postgres(connection) => connection.flush().await,
        }
    }

    fn should_flush(&self) -> bool {
        match self {
            Self::Sqlite(connection) => connection.should_flush(),
            Self::Postgres(connection) => connection.should_flush(),
        }
    }
}

/// Begins and ends transactions as the engine of the connection does.
pub(crate) struct EngineTransactionManager;

type OfSqlite = <Sqlite as Database>::TransactionManager;
type OfPostgres = <Postgres as Database>::TransactionManager;

impl TransactionManager for EngineTransactionManager {
    type Database = Engine;

    async fn begin(connection: &mut EngineConnection, statement: Option<SqlStr>) -> Result<(), Error> {
        match connection {
            EngineConnection::Sqlite(connection) => OfSqlite::begin(connection, statement).await,
            EngineConnection::Postgres(connection) => OfPostgres::begin(connection, statement).await,
        }
    }

    async fn commit(connection: &mut EngineConnection) -> Result<(), Error> {
        match connection {
            EngineConnection::Sqlite(connection) => OfSqlite::commit(connection).await,
            EngineConnection::Postgres(connection) => OfPostgres::commit(connection).await,
        }
    }

    async fn rollback(connection: &mut EngineConnection) -> Result<(), Error> {
        match connection {
            EngineConnection::Sqlite(connection) => OfSqlite::rollback(connection).await,
            EngineConnection::Postgres(connection) => OfPostgres::rollback(connection).await,
        }
    }

    fn start_rollback(connection: &mut EngineConnection) {
        match connection {
            EngineConnection::Sqlite(connection) => OfSqlite::start_rollback(connection),
            EngineConnection::Postgres(connection) => OfPostgres::start_rollback(connection),
        }
    }

    fn get_transaction_depth(connection: &EngineConnection) -> usize {
        match connection {
            EngineConnection::Sqlite(connection) => OfSqlite::get_transaction_depth(connection),
            EngineConnection::Postgres(connection) => OfPostgres::get_transaction_depth(connection),
        }
    }
}

/// A statement in the form of one engine.
struct EngineQuery<A> {
    sql: SqlStr,
    arguments: Option<A>,
    persistent: bool,
}

/// The statement of a query with its values. No values are bound if several statements are sent as one text.
fn asked<'q, E: Execute<'q, Engine>, A>(
    mut query: E,
    convert: impl FnOnce(EngineArguments) -> Result<A, BoxDynError>,
) -> Result<EngineQuery<A>, Error> {
    let arguments = query.take_arguments().map_err(Error::Encode)?;
    let persistent = query.persistent();
    let arguments = arguments.map(convert).transpose().map_err(Error::Encode)?;
    Ok(EngineQuery { sql: query.sql(), arguments, persistent })
}

/// Converts a query for SQLite.
fn asked_of_sqlite<'q, E: Execute<'q, Engine>>(query: E) -> Result<EngineQuery<SqliteArguments>, Error> {
    let mut places = 0;
    let mut asked = asked(query, |arguments| {
        places = arguments.len();
        arguments.into_sqlite()
    })?;
    if places >= MANY_PLACES
        && let Some(sql) = without_numbers(asked.sql.as_str(), places)
    {
        asked.sql = AssertSqlSafe(sql).into_sql_str();
    }
    Ok(asked)
}

/// Least number of places whose numbers cost SQLite noticeable time. It looks each number up in a list of all others,
/// once when it prepares the statement and once when the value is bound.
const MANY_PLACES: usize = 32;

/// The statement with `?` for each of `$1` to `$places`, if these are all its places and in this order.
fn without_numbers(sql: &str, places: usize) -> Option<String> {
    let mut pieces = sql.split('$');
    let mut result = String::with_capacity(sql.len());
    result.push_str(pieces.next()?);
    for place in 1..=places {
        let piece = pieces.next()?;
        let end = piece.find(|c: char| !c.is_ascii_digit()).unwrap_or(piece.len());
        let (number, rest) = piece.split_at(end);
        if number.parse() != Ok(place) {
            return None;
        }
        result.push('?');
        result.push_str(rest);
    }
    pieces.next().is_none().then_some(result)
}

type Steps<'e> = BoxStream<'e, Result<sqlx::Either<EngineQueryResult, EngineRow>, Error>>;

/// Executes a statement on a connection of one engine.
macro_rules! steps {
    ($connection:expr, $asked:expr, $database:ty) => {
        match $asked {
            Err(error) => stream::once(ready(Err(error))).boxed(),
            Ok(EngineQuery { sql, arguments: None, .. }) => {
                $connection.fetch_many(sql).map_ok(either).boxed()
            }
            Ok(EngineQuery { sql, arguments: Some(arguments), persistent }) => {
                let query = sqlx::query_with::<$database, _>(sql, arguments).persistent(persistent);
                $connection.fetch_many(query).map_ok(either).boxed()
            }
        }
    };
}

/// The first row of a statement on a connection of one engine.
macro_rules! first {
    ($connection:expr, $asked:expr, $database:ty) => {
        match $asked {
            Err(error) => ready(Err(error)).boxed(),
            Ok(EngineQuery { sql, arguments: None, .. }) => {
                $connection.fetch_optional(sql).map_ok(|row| row.map(EngineRow::from)).boxed()
            }
            Ok(EngineQuery { sql, arguments: Some(arguments), persistent }) => {
                let query = sqlx::query_with::<$database, _>(sql, arguments).persistent(persistent);
                $connection.fetch_optional(query).map_ok(|row| row.map(EngineRow::from)).boxed()
            }
        }
    };
}

fn either<Q: Into<EngineQueryResult>, R: Into<EngineRow>>(
    step: sqlx::Either<Q, R>,
) -> sqlx::Either<EngineQueryResult, EngineRow> {
    step.map_either(Q::into, R::into)
}

impl<'c> Executor<'c> for &'c mut EngineConnection {
    type Database = Engine;

    fn fetch_many<'e, 'q: 'e, E>(self, query: E) -> Steps<'e>
    where
        'c: 'e,
        E: 'q + Execute<'q, Engine>,
    {
        match self {
            EngineConnection::Sqlite(connection) => {
                steps!(connection, asked_of_sqlite(query), Sqlite)
            }
            EngineConnection::Postgres(connection) => {
                steps!(connection, asked(query, EngineArguments::into_postgres), Postgres)
            }
        }
    }

    fn fetch_optional<'e, 'q: 'e, E>(self, query: E) -> BoxFuture<'e, Result<Option<EngineRow>, Error>>
    where
        'c: 'e,
        E: 'q + Execute<'q, Engine>,
    {
        match self {
            EngineConnection::Sqlite(connection) => {
                first!(connection, asked_of_sqlite(query), Sqlite)
            }
            EngineConnection::Postgres(connection) => {
                first!(connection, asked(query, EngineArguments::into_postgres), Postgres)
            }
        }
    }

    fn prepare_with<'e>(
        self,
        sql: SqlStr,
        _parameters: &'e [EngineTypeInfo],
    ) -> BoxFuture<'e, Result<EngineStatement, Error>>
    where
        'c: 'e,
    {
        async move {
            match self {
                EngineConnection::Sqlite(connection) => connection.prepare(sql).await.map(Into::into),
                EngineConnection::Postgres(connection) => connection.prepare(sql).await.map(Into::into),
            }
        }
        .boxed()
    }
}

#[cfg(test)]
mod tests {
    use super::without_numbers;

    #[test]
    fn places_lose_their_numbers_only_in_order() {
        assert_eq!(without_numbers("VALUES ($1, $2), ($3,$4)", 4).as_deref(), Some("VALUES (?, ?), (?,?)"));
        assert_eq!(without_numbers("a = $1", 1).as_deref(), Some("a = ?"));
        for other in [
            "VALUES ($2, $1)",
            "VALUES ($1, $1)",
            "VALUES ($1, $2, $3)",
            "VALUES ($1)",
            "VALUES ('$1', $1, $2)",
            "$1 $",
        ] {
            assert_eq!(without_numbers(other, 2), None, "{other}");
        }
    }
}
