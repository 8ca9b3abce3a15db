//! The schema of a file: its version and its upgrade.

use std::path::Path;
use std::time::{Duration, Instant};

use super::{OLDEST, Schema, latest_schema};
use crate::engine::{Dialect, EngineConnection, EnginePool, begin_writing};
use crate::error::StoreError;
use crate::{verified_copy, write_ahead_log};

/// Least size of a large database, bytes: a warning reports that its change may take minutes.
const LARGE_BYTES: u64 = 1 << 30;

/// Interval of messages during a long change.
const STILL_AT_IT: Duration = Duration::from_secs(10);

/// Creates or upgrades the schema in one transaction. One process at a time does so. If the process ends before the
/// commit, the database is unchanged.
pub(crate) async fn migrate(path: &Path, writer: &EnginePool) -> Result<(), StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    let mut transaction = begin_writing(writer).await.map_err(broken)?;
    // read after the lock is taken: another process may have changed the schema before
    let found = version(&mut transaction).await.map_err(broken)?;
    let schema = Schema::of(Dialect::Sqlite);
    if schema.is_applied(&mut transaction, found).await.map_err(broken)? {
        return Ok(());
    }
    if let Some(found) = found.filter(|found| *found != latest_schema()) {
        refuse_too_old(path, found)?;
        // this process has the write lock
        verified_copy::before_migration(path, found).await?;
        say_beginning(path, found);
    }
    during(path, schema.apply(&mut transaction, found)).await.map_err(broken)?;
    transaction.commit().await.map_err(broken)
}

/// Refuses a version that cannot be upgraded.
///
/// # Errors
/// [`StoreError::TooOld`].
pub(crate) fn refuse_too_old(path: &Path, found: i64) -> Result<(), StoreError> {
    match found < OLDEST {
        true => Err(StoreError::TooOld { path: path.to_path_buf(), found, oldest: OLDEST }),
        false => Ok(()),
    }
}

/// The version of a file's schema; `None` for a file without tables.
///
/// # Errors
/// Those of the database.
pub(crate) async fn version(connection: &mut EngineConnection) -> sqlx::Result<Option<i64>> {
    // before version 51, the version was in a table with a row per migration
    for (table, column) in [("schema_version", "version"), ("_sqlx_migrations", "version")] {
        let exists = "SELECT count(*) > 0 FROM sqlite_schema WHERE name = $1";
        if sqlx::query_scalar(exists).bind(table).fetch_one(&mut *connection).await? {
            let latest = sqlx::AssertSqlSafe(format!("SELECT coalesce(max({column}), 0) FROM {table}"));
            return sqlx::query_scalar(latest).fetch_one(connection).await.map(Some);
        }
    }
    Ok(None)
}

/// Logs the start of the upgrade, with a warning if the database is large.
fn say_beginning(path: &Path, found: i64) {
    let bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let (path, megabytes, known) = (path.display(), bytes >> 20, latest_schema());
    if bytes < LARGE_BYTES {
        tracing::info!(%path, megabytes, "upgrading the schema of the database from {found} to {known}");
    } else {
        tracing::warn!(
            %path, megabytes, "upgrading the schema of the database from {found} to {known}; this may take \
                minutes and as much free space as the size of the file; if the program is stopped before \
                the end, the database stays unchanged"
        );
    }
}

/// Awaits a change of the schema, and logs its progress at intervals.
async fn during<T>(path: &Path, work: impl Future<Output = T>) -> T {
    let began = Instant::now();
    let mut work = std::pin::pin!(work);
    loop {
        if let Ok(done) = tokio::time::timeout(STILL_AT_IT, &mut work).await {
            return done;
        }
        let bytes = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        tracing::info!(
            path = %path.display(),
            seconds = began.elapsed().as_secs(),
            written_mb = bytes(&write_ahead_log::path_of(path)) >> 20,
            database_mb = bytes(path) >> 20,
            "the schema of the database is being upgraded to {}", latest_schema()
        );
    }
}
