//! Rows of views, read one by one from one moment of the database; memory does not grow with their number.

use std::future::poll_fn;
use std::path::Path;
use std::sync::Arc;

use jiff::Timestamp;
use serde_json::Value;
use sqlx::AssertSqlSafe;

use super::error::StoreError;
use super::handle::Store;
use super::table::cells;
use super::view_columns::PublicView;
use crate::engine::{Engine, EngineTransaction, begin_reading};

/// Selection of rows of views.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RowFilter {
    /// Only of these robots; an empty list selects all. Views without robots are not filtered.
    pub robots: Vec<String>,
    /// Only from this time on; see [`ViewReader::rows`].
    pub since: Option<Timestamp>,
    /// Only before this time.
    pub until: Option<Timestamp>,
}

/// A reader that sees the database as it was when the reader was made, despite later writes. The write-ahead log grows
/// until it is dropped.
#[derive(Debug)]
pub struct ViewReader {
    transaction: EngineTransaction,
    path: Arc<Path>,
}

impl Store {
    /// Begins to read the present state of the database.
    pub async fn read_views(&self) -> Result<ViewReader, StoreError> {
        let mut transaction = self.checked(begin_reading(&self.readers).await)?;
        // the first read determines the moment
        let read = sqlx::query("SELECT count(*) FROM (SELECT 1 FROM robot LIMIT 1) AS first")
            .execute(&mut *transaction)
            .await;
        self.checked(read)?;
        Ok(ViewReader { transaction, path: Arc::clone(&self.path) })
    }
}

impl ViewReader {
    /// Like [`Self::rows`], in the order of robot and month, with the month (`2026-01`) as a last value. The month is
    /// that of the column `at` if the view has one, otherwise that of the start of the run; NULL for rows without a
    /// run. The order of rows of a month depends only on their content.
    ///
    /// # Errors
    /// Those of [`Self::rows`].
    pub async fn rows_by_month<E: From<StoreError>>(
        &mut self,
        view: &PublicView,
        filter: &RowFilter,
        take: impl FnMut(&[Value]) -> Result<(), E>,
    ) -> Result<u64, E> {
        let (statement, values) = select_by_month(view, filter);
        self.stream(statement, &values, take).await
    }

    /// Robots with a run, by name.
    pub async fn robots(&mut self) -> Result<Vec<String>, StoreError> {
        sqlx::query_scalar("SELECT DISTINCT robot FROM runs ORDER BY robot")
            .fetch_all(&mut *self.transaction)
            .await
            .map_err(|error| StoreError::from_sqlx(&self.path, &error))
    }

    /// Passes the rows of a view to `take`, in the order of the database, and returns their number. A row has one value
    /// per column, in the order of the columns.
    ///
    /// Times filter the rows of a view with a column `at` by that column, and those of a view with `run_id` by the
    /// start of the run: all rows of a run are on the same side of a limit. Rows without a run, and views with neither
    /// column, are not filtered.
    ///
    /// # Errors
    /// [`StoreError`] of the database, and any error of `take`, which ends the reading.
    pub async fn rows<E: From<StoreError>>(
        &mut self,
        view: &PublicView,
        filter: &RowFilter,
        take: impl FnMut(&[Value]) -> Result<(), E>,
    ) -> Result<u64, E> {
        let (statement, values) = select(view, filter);
        self.stream(statement, &values, take).await
    }

    async fn stream<E: From<StoreError>>(
        &mut self,
        statement: String,
        values: &[String],
        mut take: impl FnMut(&[Value]) -> Result<(), E>,
    ) -> Result<u64, E> {
        let failed = |error: &sqlx::Error| E::from(StoreError::from_sqlx(&self.path, error));
        let mut query = sqlx::query::<Engine>(AssertSqlSafe(statement));
        for value in values {
            query = query.bind(value);
        }
        let mut rows = query.fetch(&mut *self.transaction);
        let mut count = 0;
        while let Some(row) = poll_fn(|context| rows.as_mut().poll_next(context)).await {
            let row = row.and_then(|row| cells(&row)).map_err(|error| failed(&error))?;
            take(&row)?;
            count += 1;
        }
        Ok(count)
    }
}

/// The statement with the values of its parameters.
fn select(view: &PublicView, filter: &RowFilter) -> (String, Vec<String>) {
    let (condition, values) = condition(view, filter);
    (format!("SELECT {} FROM \"{}\"{condition}", columns(view).join(", "), view.name), values)
}

/// The statement with the month as a last column, in an order that does not depend on how SQLite accesses the rows.
fn select_by_month(view: &PublicView, filter: &RowFilter) -> (String, Vec<String>) {
    let (condition, values) = condition(view, filter);
    let columns = columns(view);
    let month = match has(view, "at") {
        true => "substr(\"at\", 1, 7)".to_owned(),
        false => {
            format!(
                "(SELECT substr(part.started_at, 1, 7) FROM runs AS part WHERE part.run_id = \"{}\".run_id)",
                view.name
            )
        }
    };
    let order: Vec<String> = (1..=columns.len()).map(|place| format!("{place} NULLS FIRST")).collect();
    let statement = format!(
        "SELECT {}, {month} FROM \"{}\"{condition} ORDER BY robot, {} NULLS FIRST, {}",
        columns.join(", "),
        view.name,
        columns.len() + 1,
        order.join(", ")
    );
    (statement, values)
}

fn has(view: &PublicView, name: &str) -> bool {
    view.columns.iter().any(|column| column.name == name)
}

fn columns(view: &PublicView) -> Vec<String> {
    view.columns.iter().map(|column| format!("\"{}\"", column.name)).collect()
}

/// The part after FROM, with the values of its parameters.
fn condition(view: &PublicView, filter: &RowFilter) -> (String, Vec<String>) {
    let has = |name: &str| has(view, name);
    let mut conditions = Vec::new();
    let mut values = Vec::new();
    if !filter.robots.is_empty() && has("robot") {
        let places: Vec<String> = (1..=filter.robots.len()).map(|place| format!("${place}")).collect();
        conditions.push(format!("robot IN ({})", places.join(", ")));
        values.extend(filter.robots.iter().cloned());
    }
    let times = [(filter.since, ">="), (filter.until, "<")];
    let times = times.iter().filter_map(|(time, relation)| Some(((*time)?, relation)));
    for (time, relation) in times {
        let place = values.len() + 1;
        if has("at") {
            conditions.push(format!("\"at\" {relation} ${place}"));
        } else if has("run_id") {
            conditions.push(format!(
                "(run_id IS NULL OR run_id IN (SELECT run_id FROM runs WHERE started_at {relation} ${place}))"
            ));
        } else {
            continue;
        }
        values.push(format!("{time:.3}"));
    }
    let condition =
        if conditions.is_empty() { String::new() } else { format!(" WHERE {}", conditions.join(" AND ")) };
    (condition, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view_columns::public_views;

    fn statement(view: &str, filter: &RowFilter) -> (String, Vec<String>) {
        let view = public_views().iter().find(|of| of.name == view).expect("a view");
        let (statement, values) = select(view, filter);
        (statement.split_once(" WHERE ").map_or(String::new(), |(_, rest)| rest.to_owned()), values)
    }

    #[test]
    fn rows_are_filtered_by_their_robot_and_by_the_start_of_their_run() {
        let filter = RowFilter {
            robots: vec!["R01".into(), "R02".into()],
            since: Some("2026-01-01T00:00:00Z".parse().expect("a time")),
            until: Some("2026-02-01T00:00:00Z".parse().expect("a time")),
        };
        let of_runs = "(run_id IS NULL OR run_id IN (SELECT run_id FROM runs WHERE started_at";
        let times = ["2026-01-01T00:00:00.000Z", "2026-02-01T00:00:00.000Z"];
        let all = ["R01", "R02", times[0], times[1]].map(str::to_owned);
        assert_eq!(
            statement("cycle_rmsd", &filter),
            (format!("robot IN ($1, $2) AND {of_runs} >= $3)) AND {of_runs} < $4))"), all.to_vec())
        );
        assert_eq!(
            statement("maintenance_log", &filter),
            ("robot IN ($1, $2) AND \"at\" >= $3 AND \"at\" < $4".into(), all.to_vec())
        );
        assert_eq!(statement("friction_map", &filter), ("robot IN ($1, $2)".into(), all[..2].to_vec()));
        assert_eq!(statement("view_columns", &filter), (String::new(), Vec::new()));
        assert_eq!(statement("runs", &RowFilter::default()), (String::new(), Vec::new()));
    }
}
