//! One engine that is SQLite or PostgreSQL, by the connection: sqlx's traits over an enum of both drivers.
//!
//! Values are bound before it is known which engine takes them, and so are kept as what the store has: truth values, whole
//! numbers, real ones, texts and bytes. Rows are those of the driver, read where they are.

mod arguments;
mod connection;
mod name;
mod row;
mod type_info;
mod types;
mod value;

use sqlx::Database;
use sqlx::database::HasStatementCache;

pub(crate) use self::name::Either;

impl Database for Either {
    type Connection = connection::EitherConnection;
    type TransactionManager = connection::EitherTransactionManager;
    type Row = row::EitherRow;
    type QueryResult = row::EitherQueryResult;
    type Column = row::EitherColumn;
    type TypeInfo = type_info::EitherTypeInfo;
    type Value = value::EitherValue;
    type ValueRef<'r> = value::EitherValueRef<'r>;
    type Arguments = arguments::EitherArguments;
    type ArgumentBuffer = Vec<arguments::Argument>;
    type Statement = row::EitherStatement;

    const NAME: &'static str = "SQLite or PostgreSQL";
    const URL_SCHEMES: &'static [&'static str] = &["sqlite", "postgres", "postgresql"];
}

impl HasStatementCache for Either {}
