//! Checks of a database's integrity, for administrators.

use jiff::Timestamp;

use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::values::time;

/// Most faults that are listed.
const MOST_FAULTS: usize = 5;

impl Store {
    /// Faults that SQLite finds in the pages of the database, at most some sentences; empty for a sound one. Reads
    /// every page.
    ///
    /// # Errors
    /// [`StoreError`] of the database, also if it is too damaged to be checked.
    pub async fn damages(&self) -> Result<Vec<String>, StoreError> {
        // a server checks its own pages
        if self.dialect() == Dialect::Postgres {
            return Ok(Vec::new());
        }
        let check = format!("PRAGMA quick_check({MOST_FAULTS})");
        let found = sqlx::query_scalar(sqlx::AssertSqlSafe(check)).fetch_all(&self.readers).await;
        let found: Vec<String> = self.checked(found)?;
        Ok(found.into_iter().filter(|line| line != "ok").collect())
    }

    /// Tables with rows that refer to missing rows, each once.
    pub async fn broken_references(&self) -> Result<Vec<String>, StoreError> {
        // a server refuses such rows
        if self.dialect() == Dialect::Postgres {
            return Ok(Vec::new());
        }
        let found = sqlx::query_scalar("SELECT DISTINCT \"table\" FROM pragma_foreign_key_check");
        self.checked(found.fetch_all(&self.readers).await)
    }

    /// Time of the latest run's entry, by the clock of the machine that entered it.
    pub async fn last_entered_at(&self) -> Result<Option<Timestamp>, StoreError> {
        let latest = sqlx::query("SELECT ingested_at FROM run ORDER BY run_id DESC LIMIT 1");
        let row = self.checked(latest.fetch_optional(&self.readers).await)?;
        self.checked(row.map(|row| time(&row, "ingested_at")).transpose())
    }
}
