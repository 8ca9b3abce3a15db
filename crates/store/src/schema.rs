//! Brings the schema of a database up to date, and says how far it is where that takes long.

use std::path::Path;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{SqlSafeStr, SqliteConnection};

use super::engine::{EnginePool, as_sqlite, begin_writing};
use super::error::StoreError;
use super::{new_schema, verified_copy, write_ahead_log};

/// A database of this size is said to take its time, bytes.
const LARGE_BYTES: u64 = 1 << 30;

/// How often a step that takes long is said to go on.
const STILL_AT_IT: Duration = Duration::from_secs(10);

/// The files of `migrations/`: version, description and statements.
const MIGRATIONS: &[(i64, &str, &str)] = &include!(concat!(env!("OUT_DIR"), "/migrations.rs"));

pub(super) static MIGRATOR: LazyLock<Migrator> = LazyLock::new(|| {
    let migration = |&(version, description, sql): &(i64, &'static str, &'static str)| {
        Migration::new(version, description.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator { migrations: MIGRATIONS.iter().map(migration).collect(), ..Migrator::DEFAULT }
});

/// Schema of a database that is up to date.
pub(super) fn latest_schema() -> i64 {
    MIGRATOR.iter().map(|migration| migration.version).max().unwrap_or(0)
}

/// Brings the schema up to date: all of it or nothing, and one process at a time. Whoever ends the process meanwhile has
/// the database as it was.
pub(super) async fn migrate(path: &Path, writer: &EnginePool) -> Result<(), StoreError> {
    let broken = |error: sqlx::Error| StoreError::from_sqlx(path, &error);
    let mut transaction = begin_writing(writer).await.map_err(broken)?;
    let connection = as_sqlite(&mut transaction).map_err(broken)?;
    new_schema::make(connection, &MIGRATOR).await.map_err(broken)?;
    // only now, for another process may have done it while this one waited
    let found = schema_of(connection).await.map_err(broken)?;
    let missing: Vec<i64> =
        MIGRATOR.iter().map(|migration| migration.version).filter(|version| *version > found).collect();
    if found > 0 && !missing.is_empty() {
        // nobody else can change it meanwhile
        verified_copy::before_migration(path, found).await?;
        say_beginning(path, found);
    }
    for (step, version) in missing.iter().enumerate() {
        let run = MIGRATOR.run_direct(Some(*version), &mut *connection, false);
        let progress = Progress { path, step: step + 1, steps: missing.len(), version: *version };
        progress.during(run, found > 0).await.map_err(|error| StoreError::from_migrate(path, &error))?;
    }
    // checks that migrations which ran before are those of this program
    let all = MIGRATOR.run_direct(None, &mut *connection, false).await;
    all.map_err(|error| StoreError::from_migrate(path, &error))?;
    transaction.commit().await.map_err(broken)
}

/// The latest migration that the database has had; 0 for none.
async fn schema_of(connection: &mut SqliteConnection) -> Result<i64, sqlx::Error> {
    let exists: bool =
        sqlx::query_scalar("SELECT count(*) FROM sqlite_schema WHERE name = '_sqlx_migrations'")
            .fetch_one(&mut *connection)
            .await?;
    if !exists {
        return Ok(0);
    }
    let latest: Option<i64> =
        sqlx::query_scalar("SELECT max(version) FROM _sqlx_migrations").fetch_one(connection).await?;
    Ok(latest.unwrap_or(0))
}

/// Says that the schema is brought up to date, and what that may take.
fn say_beginning(path: &Path, found: i64) {
    let bytes = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let (path, megabytes, known) = (path.display(), bytes >> 20, latest_schema());
    if bytes < LARGE_BYTES {
        tracing::info!(%path, megabytes, "bringing the schema of the database from {found} to {known}");
    } else {
        tracing::warn!(
            %path, megabytes, "bringing the schema of the database from {found} to {known}, which may take minutes and \
             as much free space as the file has; whoever stops the program before the end has the database as it was"
        );
    }
}

/// Where a change of the schema is.
struct Progress<'a> {
    path: &'a Path,
    step: usize,
    steps: usize,
    version: i64,
}

impl Progress<'_> {
    /// Awaits a step; if it takes long, says again and again that it goes on.
    async fn during<T>(&self, work: impl Future<Output = T>, is_said: bool) -> T {
        let began = Instant::now();
        let mut work = std::pin::pin!(work);
        loop {
            match tokio::time::timeout(STILL_AT_IT, &mut work).await {
                Ok(done) => return done,
                Err(_) if is_said => self.say(began.elapsed()),
                Err(_) => {}
            }
        }
    }

    fn say(&self, since: Duration) {
        let bytes = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        tracing::info!(
            path = %self.path.display(),
            seconds = since.as_secs(),
            written_mb = bytes(&write_ahead_log::path_of(self.path)) >> 20,
            database_mb = bytes(self.path) >> 20,
            "the schema of the database is being brought to {}, step {} of {}",
            self.version, self.step, self.steps
        );
    }
}
