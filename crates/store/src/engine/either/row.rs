//! Rows, their columns, and statements that are prepared but not executed.

use std::sync::OnceLock;

use sqlx::error::Error;
use sqlx::postgres::{PgColumn, PgQueryResult, PgRow, PgStatement};
use sqlx::sqlite::{SqliteColumn, SqliteQueryResult, SqliteRow, SqliteStatement};
use sqlx::{Column, ColumnIndex, Row, SqlStr, Statement};

use super::arguments::EngineArguments;
use super::name::Engine;
use super::type_info::EngineTypeInfo;
use super::value::EngineValueRef;

/// A column of a result.
#[derive(Debug, Clone)]
pub(crate) struct EngineColumn {
    place: usize,
    name: String,
    type_info: EngineTypeInfo,
}

impl Column for EngineColumn {
    type Database = Engine;

    fn ordinal(&self) -> usize {
        self.place
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn type_info(&self) -> &EngineTypeInfo {
        &self.type_info
    }
}

impl From<&SqliteColumn> for EngineColumn {
    fn from(column: &SqliteColumn) -> Self {
        Self {
            place: column.ordinal(),
            name: column.name().to_owned(),
            type_info: EngineTypeInfo::Sqlite(column.type_info().clone()),
        }
    }
}

impl From<&PgColumn> for EngineColumn {
    fn from(column: &PgColumn) -> Self {
        Self {
            place: column.ordinal(),
            name: column.name().to_owned(),
            type_info: EngineTypeInfo::Postgres(column.type_info().clone()),
        }
    }
}

enum Of {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

/// A row. Its columns are only described on request, which is rare.
pub(crate) struct EngineRow {
    of: Of,
    columns: OnceLock<Vec<EngineColumn>>,
}

impl From<SqliteRow> for EngineRow {
    fn from(row: SqliteRow) -> Self {
        Self { of: Of::Sqlite(row), columns: OnceLock::new() }
    }
}

impl From<PgRow> for EngineRow {
    fn from(row: PgRow) -> Self {
        Self { of: Of::Postgres(row), columns: OnceLock::new() }
    }
}

impl Row for EngineRow {
    type Database = Engine;

    fn len(&self) -> usize {
        match &self.of {
            Of::Sqlite(row) => row.len(),
            Of::Postgres(row) => row.len(),
        }
    }

    fn columns(&self) -> &[EngineColumn] {
        self.columns.get_or_init(|| match &self.of {
            Of::Sqlite(row) => row.columns().iter().map(EngineColumn::from).collect(),
            Of::Postgres(row) => row.columns().iter().map(EngineColumn::from).collect(),
        })
    }

    fn try_get_raw<I>(&self, index: I) -> Result<EngineValueRef<'_>, Error>
    where
        I: ColumnIndex<Self>,
    {
        let index = index.index(self)?;
        match &self.of {
            Of::Sqlite(row) => row.try_get_raw(index).map(EngineValueRef::Sqlite),
            Of::Postgres(row) => row.try_get_raw(index).map(EngineValueRef::Postgres),
        }
    }
}

impl ColumnIndex<EngineRow> for &'_ str {
    fn index(&self, row: &EngineRow) -> Result<usize, Error> {
        match &row.of {
            Of::Sqlite(row) => <&str as ColumnIndex<SqliteRow>>::index(self, row),
            Of::Postgres(row) => <&str as ColumnIndex<PgRow>>::index(self, row),
        }
    }
}

sqlx_core::impl_column_index_for_row!(EngineRow);

/// Number of rows that a statement has changed.
#[derive(Debug, Default)]
pub(crate) struct EngineQueryResult {
    rows_affected: u64,
}

impl EngineQueryResult {
    pub(crate) fn rows_affected(&self) -> u64 {
        self.rows_affected
    }
}

impl From<SqliteQueryResult> for EngineQueryResult {
    fn from(result: SqliteQueryResult) -> Self {
        Self { rows_affected: result.rows_affected() }
    }
}

impl From<PgQueryResult> for EngineQueryResult {
    fn from(result: PgQueryResult) -> Self {
        Self { rows_affected: result.rows_affected() }
    }
}

impl Extend<Self> for EngineQueryResult {
    fn extend<T: IntoIterator<Item = Self>>(&mut self, results: T) {
        self.rows_affected += results.into_iter().map(|result| result.rows_affected).sum::<u64>();
    }
}

/// A statement whose columns are known.
#[derive(Debug, Clone)]
pub(crate) struct EngineStatement {
    sql: SqlStr,
    columns: Vec<EngineColumn>,
    places: usize,
}

fn places<S: Statement>(statement: &S) -> usize {
    match statement.parameters() {
        Some(sqlx::Either::Left(types)) => types.len(),
        Some(sqlx::Either::Right(count)) => count,
        None => 0,
    }
}

impl From<SqliteStatement> for EngineStatement {
    fn from(statement: SqliteStatement) -> Self {
        let columns = statement.columns().iter().map(EngineColumn::from).collect();
        Self { columns, places: places(&statement), sql: statement.into_sql() }
    }
}

impl From<PgStatement> for EngineStatement {
    fn from(statement: PgStatement) -> Self {
        let columns = statement.columns().iter().map(EngineColumn::from).collect();
        Self { columns, places: places(&statement), sql: statement.into_sql() }
    }
}

impl Statement for EngineStatement {
    type Database = Engine;

    fn into_sql(self) -> SqlStr {
        self.sql
    }

    fn sql(&self) -> &SqlStr {
        &self.sql
    }

    fn parameters(&self) -> Option<sqlx::Either<&[EngineTypeInfo], usize>> {
        Some(sqlx::Either::Right(self.places))
    }

    fn columns(&self) -> &[EngineColumn] {
        &self.columns
    }

    sqlx_core::impl_statement_query!(EngineArguments);
}
