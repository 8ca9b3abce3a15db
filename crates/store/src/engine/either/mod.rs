//! One engine that is SQLite or PostgreSQL, by the connection: sqlx's traits over an enum of both drivers.
//!
//! Values are bound before the engine is known. They are therefore kept in the store's own types: truth values,
//! integers, real numbers, texts and bytes. Rows are those of the driver, read directly.

mod arguments;
mod connection;
mod name;
mod row;
mod type_info;
mod types;
mod value;

use sqlx::Database;
use sqlx::database::HasStatementCache;

pub(crate) use self::arguments::EngineArguments;
pub(crate) use self::connection::{EngineConnectOptions, EngineConnection};
pub(crate) use self::name::Engine;
pub(crate) use self::row::EngineRow;

impl Database for Engine {
    type Connection = EngineConnection;
    type TransactionManager = connection::EngineTransactionManager;
    type Row = EngineRow;
    type QueryResult = row::EngineQueryResult;
    type Column = row::EngineColumn;
    type TypeInfo = type_info::EngineTypeInfo;
    type Value = value::EngineValue;
    type ValueRef<'r> = value::EngineValueRef<'r>;
    type Arguments = EngineArguments;
    type ArgumentBuffer = Vec<arguments::Argument>;
    type Statement = row::EngineStatement;

    const NAME: &'static str = "SQLite or PostgreSQL";
    const URL_SCHEMES: &'static [&'static str] = &["sqlite", "postgres", "postgresql"];
}

impl HasStatementCache for Engine {}
