//! Rows, their columns, and statements that are read but not carried out.

use std::sync::OnceLock;

use sqlx::error::Error;
use sqlx::postgres::{PgColumn, PgQueryResult, PgRow, PgStatement};
use sqlx::sqlite::{SqliteColumn, SqliteQueryResult, SqliteRow, SqliteStatement};
use sqlx::{Column, ColumnIndex, Row, SqlStr, Statement};

use super::arguments::EitherArguments;
use super::name::Either;
use super::type_info::EitherTypeInfo;
use super::value::EitherValueRef;

/// A column of an answer.
#[derive(Debug, Clone)]
pub(crate) struct EitherColumn {
    place: usize,
    name: String,
    type_info: EitherTypeInfo,
}

impl Column for EitherColumn {
    type Database = Either;

    fn ordinal(&self) -> usize {
        self.place
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn type_info(&self) -> &EitherTypeInfo {
        &self.type_info
    }
}

impl From<&SqliteColumn> for EitherColumn {
    fn from(column: &SqliteColumn) -> Self {
        Self {
            place: column.ordinal(),
            name: column.name().to_owned(),
            type_info: EitherTypeInfo::Sqlite(column.type_info().clone()),
        }
    }
}

impl From<&PgColumn> for EitherColumn {
    fn from(column: &PgColumn) -> Self {
        Self {
            place: column.ordinal(),
            name: column.name().to_owned(),
            type_info: EitherTypeInfo::Postgres(column.type_info().clone()),
        }
    }
}

enum Of {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

/// A row. Its columns are described when they are asked for, which few do.
pub(crate) struct EitherRow {
    of: Of,
    columns: OnceLock<Vec<EitherColumn>>,
}

impl From<SqliteRow> for EitherRow {
    fn from(row: SqliteRow) -> Self {
        Self { of: Of::Sqlite(row), columns: OnceLock::new() }
    }
}

impl From<PgRow> for EitherRow {
    fn from(row: PgRow) -> Self {
        Self { of: Of::Postgres(row), columns: OnceLock::new() }
    }
}

impl Row for EitherRow {
    type Database = Either;

    fn len(&self) -> usize {
        match &self.of {
            Of::Sqlite(row) => row.len(),
            Of::Postgres(row) => row.len(),
        }
    }

    fn columns(&self) -> &[EitherColumn] {
        self.columns.get_or_init(|| match &self.of {
            Of::Sqlite(row) => row.columns().iter().map(EitherColumn::from).collect(),
            Of::Postgres(row) => row.columns().iter().map(EitherColumn::from).collect(),
        })
    }

    fn try_get_raw<I>(&self, index: I) -> Result<EitherValueRef<'_>, Error>
    where
        I: ColumnIndex<Self>,
    {
        let index = index.index(self)?;
        match &self.of {
            Of::Sqlite(row) => row.try_get_raw(index).map(EitherValueRef::Sqlite),
            Of::Postgres(row) => row.try_get_raw(index).map(EitherValueRef::Postgres),
        }
    }
}

impl ColumnIndex<EitherRow> for &'_ str {
    fn index(&self, row: &EitherRow) -> Result<usize, Error> {
        match &row.of {
            Of::Sqlite(row) => <&str as ColumnIndex<SqliteRow>>::index(self, row),
            Of::Postgres(row) => <&str as ColumnIndex<PgRow>>::index(self, row),
        }
    }
}

sqlx_core::impl_column_index_for_row!(EitherRow);

/// How many rows a statement has changed.
#[derive(Debug, Default)]
pub(crate) struct EitherQueryResult {
    rows_affected: u64,
}

impl EitherQueryResult {
    pub(crate) fn rows_affected(&self) -> u64 {
        self.rows_affected
    }
}

impl From<SqliteQueryResult> for EitherQueryResult {
    fn from(result: SqliteQueryResult) -> Self {
        Self { rows_affected: result.rows_affected() }
    }
}

impl From<PgQueryResult> for EitherQueryResult {
    fn from(result: PgQueryResult) -> Self {
        Self { rows_affected: result.rows_affected() }
    }
}

impl Extend<Self> for EitherQueryResult {
    fn extend<T: IntoIterator<Item = Self>>(&mut self, results: T) {
        self.rows_affected += results.into_iter().map(|result| result.rows_affected).sum::<u64>();
    }
}

/// A statement whose columns are known.
#[derive(Debug, Clone)]
pub(crate) struct EitherStatement {
    sql: SqlStr,
    columns: Vec<EitherColumn>,
    places: usize,
}

fn places<S: Statement>(statement: &S) -> usize {
    match statement.parameters() {
        Some(sqlx::Either::Left(types)) => types.len(),
        Some(sqlx::Either::Right(count)) => count,
        None => 0,
    }
}

impl From<SqliteStatement> for EitherStatement {
    fn from(statement: SqliteStatement) -> Self {
        let columns = statement.columns().iter().map(EitherColumn::from).collect();
        Self { columns, places: places(&statement), sql: statement.into_sql() }
    }
}

impl From<PgStatement> for EitherStatement {
    fn from(statement: PgStatement) -> Self {
        let columns = statement.columns().iter().map(EitherColumn::from).collect();
        Self { columns, places: places(&statement), sql: statement.into_sql() }
    }
}

impl Statement for EitherStatement {
    type Database = Either;

    fn into_sql(self) -> SqlStr {
        self.sql
    }

    fn sql(&self) -> &SqlStr {
        &self.sql
    }

    fn parameters(&self) -> Option<sqlx::Either<&[EitherTypeInfo], usize>> {
        Some(sqlx::Either::Right(self.places))
    }

    fn columns(&self) -> &[EitherColumn] {
        &self.columns
    }

    sqlx_core::impl_statement_query!(EitherArguments);
}
