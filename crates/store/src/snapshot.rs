//! A copy of what is stored, in one file that nothing writes to: any user, mount or machine can read it, whatever the
//! daemon does.
//!
//! It leaves out what only going on with the work needs: the factors of cycles, which are most of a database, and where
//! reading goes on. Views say the same as those of the database at one moment.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode};
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::open::{APPLICATION_ID, SNAPSHOT};

/// Tables whose rows are left out.
const LEFT_OUT: [&str; 11] = [
    "torque_factor",
    "log_factor",
    "cycle_factor_layout",
    "resume_point",
    "source_file",
    "channel_response",
    "run_brief",
    "window_evidence",
    "log_evidence",
    "run_series",
    "run_friction_series",
];

/// What a user needs who reads the views on a server.
const READERS_GRANT: &str = "GRANT USAGE ON SCHEMA armwatch, GRANT SELECT ON ALL TABLES IN SCHEMA armwatch";

/// End of the name that a copy has until it is whole.
const PARTIAL: &str = ".partial";
/// A copy that nobody has written to for so long has lost its writer.
const ABANDONED: Duration = Duration::from_secs(86_400);

impl Store {
    /// Whether this is a copy for readers, which has no factors of cycles.
    #[must_use]
    pub fn is_snapshot(&self) -> bool {
        match self.dialect() {
            Dialect::Sqlite => {
                header_of(&self.path).is_ok_and(|found| found == Some(Some([SNAPSHOT, APPLICATION_ID])))
            }
            Dialect::Postgres => false,
        }
    }

    /// Refuses a copy for readers where the factors of cycles are needed; `without` says what cannot be done.
    ///
    /// # Errors
    /// [`StoreError::NoFactorsInSnapshot`].
    pub fn refuse_snapshot(&self, without: &'static str) -> Result<(), StoreError> {
        match self.is_snapshot() {
            true => Err(StoreError::NoFactorsInSnapshot { path: self.path.to_path_buf(), without }),
            false => Ok(()),
        }
    }

    /// Writes a copy of what is stored to `target`, in place of one that is there, and says how many bytes it has.
    ///
    /// # Errors
    /// [`StoreError::NotASnapshot`] where something else lies at `target`, such as the database itself; [`StoreError`] of
    /// the database or of the copy. What is there then stays.
    pub async fn snapshot(&self, target: &Path) -> Result<u64, StoreError> {
        if self.dialect() == Dialect::Postgres {
            let instead = format!("readers ask it there, as a user who may only read: {READERS_GRANT}");
            return Err(self.on_server("a snapshot", instead));
        }
        let partial = partial_of(target);
        let failed = |error: std::io::Error| StoreError::from_sqlx(target, &sqlx::Error::Io(error));
        if !is_free(target).map_err(failed)? {
            return Err(StoreError::NotASnapshot { path: target.to_owned() });
        }
        if let Some(folder) = target.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        remove_abandoned(target);
        let copied = copy(&self.path, &partial).await;
        if let Err(error) = copied {
            // what is half is of no use
            let _ = remove(&partial);
            return Err(copy_error(&self.path, target, &error));
        }
        let (partial, target) = (partial.clone(), target.to_owned());
        let placed = tokio::task::spawn_blocking(move || {
            // a copy that has no place is of no use either
            place(&partial, &target).inspect_err(|_| drop(remove(&partial)))
        })
        .await;
        placed.unwrap_or_else(|error| Err(std::io::Error::other(error))).map_err(failed)
    }
}

/// The error of copying from `source` to `target`: damage that is found while copying is that of the source, whatever the
/// name of the copy is by then.
pub(super) fn copy_error(source: &Path, target: &Path, error: &sqlx::Error) -> StoreError {
    match StoreError::from_sqlx(target, error) {
        StoreError::Corrupt { detail, .. }
        | StoreError::NotADatabase { detail, .. }
        // rows that break a rule of the schema which they were stored under
        | StoreError::Refused { detail, .. } => StoreError::Corrupt { path: source.to_owned(), detail },
        error => error,
    }
}

/// Name of a copy until it is whole, beside the target: each writer has its own, so that two at once do not take each other's for
/// theirs.
pub(super) fn partial_of(target: &Path) -> PathBuf {
    let mut partial = target.as_os_str().to_owned();
    partial.push(format!(".{}-{}{PARTIAL}", std::process::id(), Timestamp::now().as_nanosecond()));
    PathBuf::from(partial)
}

/// Removes copies for `target` whose writers ended before they were whole; those stay that this user may not remove.
pub(super) fn remove_abandoned(target: &Path) {
    let Some(name) = target.file_name() else { return };
    let name = name.to_string_lossy();
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let other = entry.file_name();
        let other = other.to_string_lossy();
        let rest = other.strip_prefix(&*name).and_then(|rest| rest.strip_suffix(PARTIAL));
        let is_partial = rest.is_some_and(|rest| {
            rest.is_empty()
                || rest.starts_with('.') && rest[1..].bytes().all(|of| of.is_ascii_digit() || of == b'-')
        });
        // one that goes meanwhile is as good as removed
        let Ok(metadata) = entry.metadata() else { continue };
        let is_old = metadata.modified().is_ok_and(|at| at.elapsed().is_ok_and(|age| age > ABANDONED));
        if is_partial && is_old && metadata.is_file() {
            let _ = remove(&entry.path());
        }
    }
}

/// Whether nothing lies at `target` but an earlier copy.
fn is_free(target: &Path) -> std::io::Result<bool> {
    let found = header_of(target)?;
    Ok(found.is_none_or(|found| found == Some([SNAPSHOT, APPLICATION_ID])))
}

/// Whether the file at `target` is a database of this program; `None` if there is none.
pub(super) fn is_ours(target: &Path) -> std::io::Result<Option<bool>> {
    let found = header_of(target)?;
    Ok(found.map(|found| found.is_some_and(|[_, application_id]| application_id == APPLICATION_ID)))
}

/// The numbers that tell what a database is, of its user and of its application, by the header of the file (SQLite,
/// "Database File Format"); inner `None` of what is too short or no file, outer of nothing.
fn header_of(target: &Path) -> std::io::Result<Option<Option<[i64; 2]>>> {
    const HEADER: usize = 72;
    let mut file = match std::fs::File::open(target) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        file => file?,
    };
    if !file.metadata()?.is_file() {
        return Ok(Some(None));
    }
    let mut header = Vec::new();
    std::io::Read::read_to_end(&mut std::io::Read::take(&mut file, HEADER as u64), &mut header)?;
    let number = |at: usize| {
        let bytes = header.get(at..at + 4)?.try_into().ok()?;
        Some(i64::from(u32::from_be_bytes(bytes)))
    };
    Ok(Some(number(60).zip(number(68)).map(|(user, application)| [user, application])))
}

pub(super) fn remove(path: &Path) -> std::io::Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Gives a whole copy its name, so that a reader sees the earlier one or this one.
pub(super) fn place(partial: &Path, target: &Path) -> std::io::Result<u64> {
    let file = std::fs::File::open(partial)?;
    file.sync_all()?;
    let bytes = file.metadata()?.len();
    std::fs::rename(partial, target)?;
    let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::File::open(folder)?.sync_all()?;
    Ok(bytes)
}

async fn copy(source: &Arc<Path>, partial: &Path) -> Result<(), sqlx::Error> {
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

async fn copy_into(connection: &mut SqliteConnection, source: &Path) -> Result<(), sqlx::Error> {
    sqlx::query("ATTACH ? AS source").bind(source.to_string_lossy()).execute(&mut *connection).await?;
    run(connection, &format!("PRAGMA main.application_id = {APPLICATION_ID}")).await?;
    run(connection, &format!("PRAGMA main.user_version = {SNAPSHOT}")).await?;
    // one moment of the database, whatever is written to it meanwhile
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

/// Kind, name and statement of what the database consists of, in the order in which it was made. Tables of SQLite itself
/// come by themselves.
async fn schema(
    connection: &mut SqliteConnection,
    kinds: &str,
) -> Result<Vec<(String, String, String)>, sqlx::Error> {
    let statement = format!(
        "SELECT type, name, sql FROM source.sqlite_schema
         WHERE type IN ({kinds}) AND sql IS NOT NULL AND name NOT LIKE 'sqlite~_%' ESCAPE '~'
         ORDER BY rowid"
    );
    sqlx::query_as(AssertSqlSafe(statement)).fetch_all(connection).await
}

async fn run(connection: &mut SqliteConnection, statement: &str) -> Result<(), sqlx::Error> {
    sqlx::raw_sql(AssertSqlSafe(statement.to_owned())).execute(connection).await.map(|_| ())
}
