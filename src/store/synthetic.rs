//! A history that nobody recorded: what the time of questions about a long one is measured on.

use std::path::Path;

use sqlx::AssertSqlSafe;

use super::error::StoreError;
use super::handle::Store;

const STATEMENTS: &str = include_str!("synthetic.sql");

/// Size of each file that a synthetic history names, bytes; it was last written a microsecond after 1970 began.
pub const SYNTHETIC_FILE_BYTES: u64 = 1000;

/// Cycles that are entered in one transaction, some 300 MB: the write-ahead log holds it until its end.
const CYCLES_AT_ONCE: u32 = 24_000;

/// How long a synthetic history is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SyntheticSize {
    /// Robots, with the keys from 1 on.
    pub robots: u32,
    /// Tests of each.
    pub runs: u32,
    /// Cycles of each test.
    pub cycles: u32,
}

impl SyntheticSize {
    /// Names of its files, by run.
    pub fn file_names(self) -> impl Iterator<Item = String> {
        (0..self.robots * self.runs).map(move |run| {
            let (robot, number) = (run % self.robots + 1, run / self.robots);
            format!("S{robot:03}_{number:06}.csv")
        })
    }
}

impl Store {
    /// Fills a database without runs with a history of this size, whose files lie in `inbox`.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a database with runs; others of the database.
    pub async fn fill_synthetic(&self, size: SyntheticSize, inbox: &Path) -> Result<(), StoreError> {
        let runs = size.robots * size.runs;
        let at_once = (CYCLES_AT_ONCE / size.cycles).max(1);
        for first in (0..runs).step_by(at_once as usize) {
            let statements = STATEMENTS
                .replace(":robots", &size.robots.to_string())
                .replace(":cycles", &size.cycles.to_string())
                .replace(":first", &first.to_string())
                .replace(":last", &(first + at_once).min(runs).to_string())
                .replace(":inbox", &inbox.display().to_string().replace('\'', "''"));
            let mut transaction = self.begin().await?;
            let filled = sqlx::raw_sql(AssertSqlSafe(statements)).execute(&mut *transaction).await;
            self.checked(filled)?;
            self.commit(transaction).await?;
        }
        Ok(())
    }

    /// Tells a database of [`Self::fill_synthetic`] when its files were changed, by path, in microseconds since 1970.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn change_synthetic_files(&self, changed: &[(String, i64)]) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        for some in changed.chunks(CYCLES_AT_ONCE as usize) {
            let told = sqlx::query(
                "UPDATE source_file SET modified = told.value ->> 1 FROM json_each($1) AS told
                 WHERE source_file.path = told.value ->> 0",
            )
            .bind(serde_json::json!(some).to_string())
            .execute(&mut *transaction)
            .await;
            self.checked(told)?;
        }
        self.commit(transaction).await
    }
}
