//! Rows of views one after the other, all from one moment of the database, however many there are.

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

/// Which rows of views are wanted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RowFilter {
    /// Only of these robots; of all where there are none. Views without robots are not filtered.
    pub robots: Vec<String>,
    /// Only from this moment on; see [`ViewReader::rows`].
    pub since: Option<Timestamp>,
    /// Only before this moment.
    pub until: Option<Timestamp>,
}

/// A reader that sees the database as it was when it was made, whatever is written meanwhile. The write-ahead log grows
/// until it is dropped.
#[derive(Debug)]
pub struct ViewReader {
    transaction: EngineTransaction,
    path: Arc<Path>,
}

impl Store {
    /// Begins to read the database as it is now.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn read_views(&self) -> Result<ViewReader, StoreError> {
        let mut transaction = self.checked(begin_reading(&self.readers).await)?;
        // the moment is that of the first read
        let read = sqlx::query("SELECT count(*) FROM (SELECT 1 FROM robot LIMIT 1) AS first")
            .execute(&mut *transaction)
            .await;
        self.checked(read)?;
        Ok(ViewReader { transaction, path: Arc::clone(&self.path) })
    }
}

impl ViewReader {
    /// As [`Self::rows`], in the order of robot and month, with the month (`2026-01`) as a last value: that of the column
    /// `at` where the view has one, else that of the start of the run; NULL for rows of no run. Rows of a month have an order
    /// that depends on themselves alone.
    ///
    /// # Errors
    /// As [`Self::rows`].
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
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn robots(&mut self) -> Result<Vec<String>, StoreError> {
        sqlx::query_scalar("SELECT DISTINCT robot FROM runs ORDER BY robot")
            .fetch_all(&mut *self.transaction)
            .await
            .map_err(|error| StoreError::from_sqlx(&self.path, &error))
    }

    /// Hands the rows of a view to `take`, in the order in which the database has them, and says how many there were. A
    /// row has a value a column, in the order of the columns.
    ///
    /// Times filter the rows of a view with a column `at` by that, and those of a view with `run_id` by the start of the
    /// run: a run belongs to one side of a moment with all that was made of it. Rows that belong to no run, and views
    /// with neither column, are not filtered.
    ///
    /// # Errors
    /// [`StoreError`] of the database, and what `take` fails with, which ends the reading.
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

/// The same with the month as a last column, in an order that does not depend on how SQLite gets at the rows.
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

/// What follows FROM, with the values of its parameters.
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
