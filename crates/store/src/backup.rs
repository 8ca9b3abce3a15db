//! A copy of the whole database for the day when it is lost, made while everything goes on.

use std::path::{Path, PathBuf};

use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, Connection, SqliteConnection};

use super::engine::Dialect;
use super::error::StoreError;
use super::handle::Store;
use super::snapshot::{copy_error, is_ours, partial_of, place, remove, remove_abandoned};

/// What a backup holds, after it was looked through.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backup {
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Rows of each table, by name.
    pub rows: Vec<(String, u64)>,
    /// Whether these are the numbers of the database too. They are compared if nothing was written to it meanwhile.
    pub is_compared: bool,
}

impl Store {
    /// Writes a copy of everything that is stored to `target`, as of one moment, in place of an earlier one. It is written
    /// beside it, looked through (integrity, references, rows of every table) and renamed, so that what is there stays
    /// until the new one is known to be whole.
    ///
    /// # Errors
    /// [`StoreError::NotABackup`] where something else lies at `target`, or a database that is in use;
    /// [`StoreError::NoFactorsInSnapshot`] for a copy for readers; [`StoreError::Corrupt`] where the database or the copy is
    /// damaged; [`StoreError`] of the database or of the copy.
    pub async fn backup(&self, target: &Path) -> Result<Backup, StoreError> {
        if self.dialect() == Dialect::Postgres {
            let (file, address) = (target.display(), self.path.display());
            let instead =
                format!("write it with `pg_dump --schema armwatch --format custom --file {file} {address}`");
            return Err(self.on_server("a backup", instead));
        }
        let failed = |error: std::io::Error| StoreError::from_sqlx(target, &sqlx::Error::Io(error));
        self.refuse_snapshot("a backup of it would not be whole")?;
        self.refuse_target(target)?;
        if let Some(folder) = target.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        let partial = partial_of(target);
        remove_abandoned(target);
        let found = self.written_and_checked(&partial, target).await;
        if found.is_err() {
            // what is half is of no use
            let _ = remove(&partial);
        }
        let (rows, is_compared) = found?;
        let target = target.to_owned();
        let placed = tokio::task::spawn_blocking(move || {
            // a copy that has no place is of no use either
            place(&partial, &target).inspect_err(|_| drop(remove(&partial)))
        })
        .await;
        let bytes = placed.unwrap_or_else(|error| Err(std::io::Error::other(error))).map_err(failed)?;
        Ok(Backup { bytes, rows, is_compared })
    }

    fn refuse_target(&self, target: &Path) -> Result<(), StoreError> {
        let refused =
            |detail: &str| StoreError::NotABackup { path: target.to_owned(), detail: detail.into() };
        if target.canonicalize().is_ok_and(|path| self.path.canonicalize().is_ok_and(|own| own == path)) {
            return Err(refused("it is the database itself"));
        }
        let mut log: PathBuf = target.to_owned();
        log.as_mut_os_string().push("-wal");
        match is_ours(target) {
            Ok(None) => Ok(()),
            Ok(Some(true)) if log.exists() => Err(refused("it is a database that is in use")),
            Ok(Some(true)) => Ok(()),
            Ok(Some(false)) => Err(refused("it is no armwatch database")),
            Err(error) => Err(StoreError::from_sqlx(target, &sqlx::Error::Io(error))),
        }
    }

    async fn written_and_checked(
        &self,
        partial: &Path,
        target: &Path,
    ) -> Result<(Vec<(String, u64)>, bool), StoreError> {
        let (broken, of_copy) =
            (|e: sqlx::Error| StoreError::from_sqlx(&self.path, &e), |e| StoreError::from_sqlx(target, &e));
        // one connection of its own, so that it can tell whether others write
        let reading = SqliteConnectOptions::new().filename(&self.path).read_only(true);
        let mut source = reading.disable_statement_logging().connect().await.map_err(broken)?;
        let version = data_version(&mut source).await.map_err(broken)?;
        sqlx::query("VACUUM INTO ?")
            .bind(partial.to_string_lossy())
            .execute(&mut source)
            .await
            .map_err(|error| copy_error(&self.path, target, &error))?;
        let of_source = rows(&mut source).await.map_err(broken)?;
        let is_compared = data_version(&mut source).await.map_err(broken)? == version;
        source.close().await.map_err(broken)?;

        let reading = SqliteConnectOptions::new().filename(partial).read_only(true);
        let mut copy = reading.disable_statement_logging().connect().await.map_err(of_copy)?;
        let damaged = |error: sqlx::Error| copy_error(&self.path, target, &error);
        let fault = fault_of(&mut copy).await.map_err(damaged)?;
        let rows = rows(&mut copy).await.map_err(damaged)?;
        copy.close().await.map_err(of_copy)?;
        let fault = fault.or_else(|| {
            let differs = is_compared && rows != of_source;
            differs.then(|| "its tables have other numbers of rows than the database".to_owned())
        });
        match fault {
            None => Ok((rows, is_compared)),
            Some(detail) => Err(StoreError::Corrupt {
                path: self.path.to_path_buf(),
                detail: format!("its copy: {detail}"),
            }),
        }
    }
}

async fn data_version(connection: &mut SqliteConnection) -> Result<i64, sqlx::Error> {
    sqlx::query_scalar("PRAGMA data_version").fetch_one(connection).await
}

/// What is wrong with a database, if anything is.
async fn fault_of(connection: &mut SqliteConnection) -> Result<Option<String>, sqlx::Error> {
    let integrity: String =
        sqlx::query_scalar("PRAGMA integrity_check(1)").fetch_one(&mut *connection).await?;
    if integrity != "ok" {
        return Ok(Some(integrity));
    }
    let dangling = sqlx::query("PRAGMA foreign_key_check").fetch_optional(connection).await?;
    Ok(dangling.map(|_| "rows refer to rows that are not there".to_owned()))
}

/// Rows of each table, by name.
async fn rows(connection: &mut SqliteConnection) -> Result<Vec<(String, u64)>, sqlx::Error> {
    let names: Vec<String> = sqlx::query_scalar(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite~_%' ESCAPE '~' ORDER BY name",
    )
    .fetch_all(&mut *connection)
    .await?;
    let mut counts = Vec::with_capacity(names.len());
    for name in names {
        let sql = AssertSqlSafe(format!("SELECT count(*) FROM \"{name}\""));
        let count: i64 = sqlx::query_scalar(sql).fetch_one(&mut *connection).await?;
        counts.push((name, u64::try_from(count).unwrap_or(0)));
    }
    Ok(counts)
}
