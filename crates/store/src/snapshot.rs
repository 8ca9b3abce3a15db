//! A read-only copy of the stored results in one file: any user, mount or machine can read it, whatever the daemon
//! does.
//!
//! It omits data that only further processing needs: the factors of cycles, which are most of a database, and the
//! places for resuming the reading. Its views show the same as those of the database at one moment.

use std::path::Path;

use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::partial::Partial;
use super::question;
use super::verified_copy::{
    APPLICATION_ID, SNAPSHOT, copy_error, first_fault, header_of, is_same_file, not_written,
};

/// Tables whose rows are omitted.
const LEFT_OUT: [&str; 10] = [
    "torque_factor",
    "log_factor",
    "cycle_factor_layout",
    "resume_point",
    "source_file",
    "channel_response",
    "window_evidence",
    "log_evidence",
    "run_summary",
    "run_friction_series",
];

/// Rights of a user who reads the views on a server.
const READERS_GRANT: &str = "GRANT USAGE ON SCHEMA armwatch, GRANT SELECT ON ALL TABLES IN SCHEMA armwatch";

impl Store {
    /// True if this is a snapshot, which has no factors of cycles.
    pub fn is_snapshot(&self) -> bool {
        self.is_snapshot
    }

    /// Refuses a snapshot if the factors of cycles are needed; `without` names the impossible operation.
    ///
    /// # Errors
    /// [`StoreError::NoFactorsInSnapshot`].
    pub fn refuse_snapshot(&self, without: &'static str) -> Result<(), StoreError> {
        match self.is_snapshot() {
            true => Err(StoreError::NoFactorsInSnapshot { path: self.path.to_path_buf(), without }),
            false => Ok(()),
        }
    }

    /// Writes a snapshot to `target`, replacing an earlier one, and returns its size in bytes. The pages of the
    /// snapshot are checked before it gets its name. Those of the database are not, since most of them are omitted.
    ///
    /// # Errors
    /// [`StoreError::NotASnapshot`] if something else is at `target`, such as the database itself; [`StoreError`] of
    /// the database or of the copy. The existing file then stays.
    pub async fn snapshot(&self, target: &Path) -> Result<u64, StoreError> {
        if self.dialect() == Dialect::Postgres {
            let instead = format!("readers query it there, as a user with read access only: {READERS_GRANT}");
            return Err(self.on_server("a snapshot", instead));
        }
        self.check_files()?;
        let failed = |error: std::io::Error| not_written(target, error);
        if is_same_file(target, &self.path) || !is_free(target).map_err(failed)? {
            return Err(StoreError::NotASnapshot { path: target.to_owned() });
        }
        let partial = Partial::of(target).map_err(failed)?;
        let copied = copy(&self.path, partial.path()).await;
        copied.map_err(|error| copy_error(&self.path, StoreError::from_sqlx(target, &error)))?;
        let (source, named) = (self.path.clone(), target.to_owned());
        let placed = tokio::task::spawn_blocking(move || {
            let fault = question::connect(partial.path()).and_then(|copy| first_fault(&copy, "quick_check"));
            let fault =
                fault.map_err(|error| copy_error(&source, StoreError::from_rusqlite(&named, &error)))?;
            if let Some(fault) = fault {
                let detail = format!("its copy: {fault}");
                return Err(StoreError::Corrupt { path: source.to_path_buf(), detail });
            }
            partial.place().map_err(|error| not_written(&named, error))
        })
        .await;
        placed.unwrap_or_else(|error| Err(failed(std::io::Error::other(error))))
    }
}

/// True if there is no file at `target`, or an earlier snapshot.
fn is_free(target: &Path) -> std::io::Result<bool> {
    let found = header_of(target)?;
    Ok(found.is_none_or(|found| found == Some([SNAPSHOT, APPLICATION_ID])))
}

async fn copy(source: &Path, partial: &Path) -> sqlx::Result<()> {
    let mut connection = SqliteConnectOptions::new()
        .filename(partial)
        .create_if_missing(true)
        .foreign_keys(false)
        // the file is synced as a whole before it gets its name
        .journal_mode(SqliteJournalMode::Off)
        .pragma("synchronous", "OFF")
        .disable_statement_logging()
        .connect()
        .await?;
    let copied = copy_into(&mut connection, source).await;
    connection.close().await.and(copied)
}

async fn copy_into(connection: &mut SqliteConnection, source: &Path) -> sqlx::Result<()> {
    sqlx::query("ATTACH ? AS source").bind(source.to_string_lossy()).execute(&mut *connection).await?;
    run(connection, &format!("PRAGMA main.application_id = {APPLICATION_ID}")).await?;
    run(connection, &format!("PRAGMA main.user_version = {SNAPSHOT}")).await?;
    // one moment of the database, despite concurrent writes
    run(connection, "BEGIN").await?;
    for (kind, name, statement) in schema(connection, "'table'").await? {
        run(connection, &statement).await?;
        if kind == "table" && !LEFT_OUT.contains(&name.as_str()) {
            run(connection, &format!("INSERT INTO main.\"{name}\" SELECT * FROM source.\"{name}\"")).await?;
        }
    }
    for (_, _, statement) in schema(connection, "'index', 'view'").await? {
        run(connection, &statement).await?;
    }
    run(connection, "COMMIT").await
}

/// Kind, name and statement of the objects of the database, in the order of their creation. SQLite creates its own
/// tables automatically.
async fn schema(
    connection: &mut SqliteConnection,
    kinds: &str,
) -> sqlx::Result<Vec<(String, String, String)>> {
    let statement = format!(
        "SELECT type, name, sql FROM source.sqlite_schema
         WHERE type IN ({kinds}) AND sql IS NOT NULL AND name NOT LIKE 'sqlite~_%' ESCAPE '~'
         ORDER BY rowid"
    );
    sqlx::query_as(AssertSqlSafe(statement)).fetch_all(connection).await
}

async fn run(connection: &mut SqliteConnection, statement: &str) -> sqlx::Result<()> {
    sqlx::raw_sql(AssertSqlSafe(statement.to_owned())).execute(connection).await.map(|_| ())
}
