//! A history that nobody recorded: what the time of questions about a long one is measured on.

use sqlx::AssertSqlSafe;

use super::error::StoreError;
use super::handle::Store;

const STATEMENTS: &str = include_str!("synthetic.sql");

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

impl Store {
    /// Fills a database without runs with a history of this size.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a database with runs; others of the database.
    pub async fn fill_synthetic(&self, size: SyntheticSize) -> Result<(), StoreError> {
        let statements = STATEMENTS
            .replace(":robots", &size.robots.to_string())
            .replace(":runs", &size.runs.to_string())
            .replace(":cycles", &size.cycles.to_string());
        let mut transaction = self.begin().await?;
        let filled = sqlx::raw_sql(AssertSqlSafe(statements)).execute(&mut *transaction).await;
        self.checked(filled)?;
        self.commit(transaction).await
    }
}
