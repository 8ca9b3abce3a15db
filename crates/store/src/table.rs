//! Rows of any statement, for people and programs that use SQL.

use std::collections::HashSet;

use serde_json::Value;
use sqlx::query::Query;
use sqlx::{AssertSqlSafe, Column, Executor, Row, SqlSafeStr, Statement, TypeInfo, ValueRef};

use super::error::StoreError;
use super::handle::Store;
use crate::engine::sqlstate::{self, ServerFault};
use crate::engine::{Dialect, Engine, EngineArguments, EngineRow, catalog, dialect};

/// Result of a statement.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ResultTable {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows, each with one value per column: null, a number or a text. Bytes are a text of hexadecimal digits.
    pub rows: Vec<Vec<Value>>,
}

impl ResultTable {
    /// The rows as JSON objects. A repeated column name becomes `name_2`, `name_3` and so on, since an object has each
    /// name only once.
    pub fn objects(&self) -> impl Iterator<Item = Value> {
        let keys = unique(&self.columns);
        let object =
            move |row: &Vec<Value>| Value::Object(keys.iter().cloned().zip(row.iter().cloned()).collect());
        self.rows.iter().map(object)
    }
}

/// Reason why a query in SQL has no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// There is no view of this name; the sentence lists the existing ones.
    #[error("{0}")]
    NoView(String),
    /// The statement cannot be executed.
    #[error("{0}")]
    Statement(String),
    /// The database failed.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Selection of rows of a view.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ViewRows {
    /// Columns with their required values; `null` selects NULL.
    pub filters: Vec<(String, String)>,
    /// The column that determines the order of rows, and true for descending order.
    pub order: Option<(String, bool)>,
    /// Most rows.
    pub limit: usize,
}

impl Store {
    /// Answers a statement of this program. [`Store::ask_one`] answers one of a person.
    ///
    /// # Errors
    /// [`AskError::Statement`] with the message of the engine.
    pub async fn ask(&self, statement: &str) -> Result<ResultTable, AskError> {
        self.answer(statement, |query| query).await
    }

    /// Views of the database by name, each with its columns in order.
    pub async fn views(&self) -> Result<Vec<(String, Vec<String>)>, StoreError> {
        let mut views: Vec<(String, Vec<String>)> = Vec::new();
        for (view, column) in self.checked(catalog::views(&self.readers).await)? {
            match views.last_mut().filter(|(last, _)| *last == view) {
                Some((_, columns)) => columns.push(column),
                None => views.push((view, vec![column])),
            }
        }
        Ok(views)
    }

    /// Rows of a view.
    ///
    /// # Errors
    /// [`AskError::NoView`], and [`AskError::Statement`] for an unknown column.
    pub async fn rows_of_view(&self, view: &str, wanted: &ViewRows) -> Result<ResultTable, AskError> {
        let columns = self.checked(catalog::columns_of_view(&self.readers, view).await)?;
        if columns.is_empty() {
            let views = self.views().await?;
            let names: Vec<&str> = views.iter().map(|(name, _)| name.as_str()).collect();
            return Err(AskError::NoView(format!("there is no view {view}; there are {}", names.join(", "))));
        }
        let asked = wanted.filters.iter().map(|(column, _)| column);
        for column in asked.chain(wanted.order.iter().map(|(column, _)| column)) {
            if !columns.contains(column) {
                return Err(AskError::Statement(format!(
                    "the view {view} has no column {column}; it has {}",
                    columns.join(", ")
                )));
            }
        }
        self.answer(&select(dialect(&self.readers), view, wanted), |mut query| {
            for (_, value) in wanted.filters.iter().filter(|(_, value)| value != NULL) {
                query = query.bind(value).bind(value.parse::<f64>().ok());
            }
            query
        })
        .await
    }

    /// Answers a statement of this program, with its values bound.
    pub(crate) async fn answer<'q>(
        &self,
        statement: &str,
        bound: impl FnOnce(Query<'q, Engine, EngineArguments>) -> Query<'q, Engine, EngineArguments>,
    ) -> Result<ResultTable, AskError> {
        let failed = |error: sqlx::Error| self.ask_error(&error);
        let mut connection = self.readers.acquire().await.map_err(failed)?;
        let text = || AssertSqlSafe(statement.to_owned()).into_sql_str();
        let rows = bound(sqlx::query(text())).fetch_all(&mut *connection).await.map_err(failed)?;
        let columns = match rows.first() {
            Some(row) => names(row.columns()),
            None => names(connection.prepare(text()).await.map_err(failed)?.columns()),
        };
        let rows = rows.iter().map(cells).collect::<Result<_, _>>().map_err(failed)?;
        Ok(ResultTable { columns, rows })
    }

    pub(crate) fn ask_error(&self, error: &sqlx::Error) -> AskError {
        const READ_ONLY: &str = "8";
        match (sqlstate::fault_of(error), error) {
            (
                Some(
                    ServerFault::Statement
                    | ServerFault::Refused
                    | ServerFault::Cancelled
                    | ServerFault::ReadOnly
                    | ServerFault::Rights,
                ),
                sqlx::Error::Database(of),
            ) => return AskError::Statement(of.message().to_owned()),
            (None, sqlx::Error::ColumnDecode { source, .. }) if self.dialect() == Dialect::Postgres => {
                return AskError::Statement(source.to_string());
            }
            _ => {}
        }
        match error {
            sqlx::Error::Database(of) if of.code().as_deref() == Some(READ_ONLY) => AskError::Statement(
                "the database is open for reading only; use the commands of armwatch to change it".into(),
            ),
            // SQLite's message about a statement, such as an unknown name
            sqlx::Error::Database(of) if of.code().as_deref() == Some("1") => {
                AskError::Statement(of.message().to_owned())
            }
            error => AskError::Store(StoreError::from_sqlx(&self.path, error)),
        }
    }
}

pub(crate) fn names(columns: &[impl Column]) -> Vec<String> {
    columns.iter().map(|column| column.name().to_owned()).collect()
}

/// The names, each once: repeated ones get the next number that no other name has.
fn unique(columns: &[String]) -> Vec<String> {
    let mut taken: HashSet<String> = columns.iter().cloned().collect();
    let mut seen: HashSet<&str> = HashSet::new();
    let mut keys = Vec::with_capacity(columns.len());
    for column in columns {
        let mut key = column.clone();
        if !seen.insert(column) {
            let mut number = 2;
            key = format!("{column}_{number}");
            while !taken.insert(key.clone()) {
                number += 1;
                key = format!("{column}_{number}");
            }
        }
        keys.push(key);
    }
    keys
}

/// The value of a filter for NULL.
const NULL: &str = "null";

fn select(dialect: Dialect, view: &str, wanted: &ViewRows) -> String {
    let mut place = 1;
    let mut conditions = Vec::new();
    for (column, value) in &wanted.filters {
        if value == NULL {
            conditions.push(format!("\"{column}\" IS NULL"));
        } else {
            // the value is bound as a text, and also as a number if it is one
            conditions.push(catalog::equals(dialect, column, place));
            place += 2;
        }
    }
    let filter =
        if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
    let order = wanted.order.as_ref().map_or_else(String::new, |(column, falling)| {
        format!(" ORDER BY \"{column}\" {}", if *falling { "DESC NULLS LAST" } else { "NULLS FIRST" })
    });
    format!("SELECT * FROM \"{view}\"{filter}{order} LIMIT {}", wanted.limit)
}

pub(crate) fn cells(row: &EngineRow) -> sqlx::Result<Vec<Value>> {
    (0..row.len()).map(|column| cell(row, column)).collect()
}

fn cell(row: &EngineRow, column: usize) -> sqlx::Result<Value> {
    let value = row.try_get_raw(column)?;
    if value.is_null() {
        return Ok(Value::Null);
    }
    Ok(match value.type_info().name() {
        "INTEGER" | "BOOLEAN" => Value::from(row.try_get_unchecked::<i64, _>(column)?),
        "REAL" => Value::from(row.try_get_unchecked::<f64, _>(column)?),
        "BLOB" => Value::from(hexadecimal(&row.try_get_unchecked::<Vec<u8>, _>(column)?)),
        _ => Value::from(row.try_get_unchecked::<String, _>(column)?),
    })
}

/// Bytes as two hexadecimal digits each.
pub(super) fn hexadecimal(bytes: &[u8]) -> String {
    use std::fmt::Write;
    let mut text = String::with_capacity(2 * bytes.len());
    for byte in bytes {
        // writing to a text does not fail
        let _ = write!(text, "{byte:02x}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_of_one_name_are_all_in_the_object() {
        let columns = ["x", "x", "x_2", "y", "x"].map(str::to_owned).to_vec();
        let table = ResultTable { columns, rows: vec![(1..=5).map(Value::from).collect()] };
        let object = table.objects().next().expect("a row");
        assert_eq!(object, serde_json::json!({"x": 1, "x_3": 2, "x_2": 3, "y": 4, "x_4": 5}));
    }
}
