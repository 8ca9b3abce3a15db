//! Copies of a database that are verified before use, and the marks in a file's header that identify them.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::Connection;
use rusqlite::backup::{Backup as PageCopy, StepResult};
use rusqlite::types::ValueRef;

use super::error::StoreError;
use super::partial::Partial;
use super::small_blocks::free_bytes_beside;
use super::{question, write_ahead_log};

/// Set in the header of the file by the first migration.
pub(super) const APPLICATION_ID: i64 = 0x4177_6462;

/// `PRAGMA user_version` of a snapshot. A snapshot has no triggers, so nothing may write to it; and only a snapshot is
/// replaced by another one.
pub(super) const SNAPSHOT: i64 = 0x736e_6170;

/// Pause before a locked page is tried again.
const LOCK_RETRY: Duration = Duration::from_millis(20);

/// Free space that a change of all tables needs for its log and for the new tables, in addition to the copy, as a
/// multiple of the database.
const ROOM_OF_MIGRATION: u64 = 2;

/// Content of a verified backup.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backup {
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Rows of each table, by name. Their content is that of the database.
    pub rows: Vec<(String, u64)>,
}

/// Copies a database into its folder before its schema `schema` is changed, if there is room for the copy and the
/// change.
///
/// # Errors
/// [`StoreError::Corrupt`] for a damaged database, which must not be changed. Any other reason for having no copy is
/// logged.
pub(super) async fn before_migration(database: &Path, schema: i64) -> Result<(), StoreError> {
    let name_of = |schema: i64| {
        let mut name = database.as_os_str().to_owned();
        name.push(format!(".schema-{schema}"));
        PathBuf::from(name)
    };
    let target = name_of(schema);
    let bytes = [database, &write_ahead_log::path_of(database)]
        .map(|file| std::fs::metadata(file).map_or(0, |metadata| metadata.len()))
        .iter()
        .sum::<u64>();
    let needed = bytes.saturating_mul(1 + ROOM_OF_MIGRATION);
    let free = free_bytes_beside(database).unwrap_or(u64::MAX);
    if free < needed {
        tracing::warn!(
            path = %database.display(), free_mb = free >> 20, needed_mb = needed >> 20,
            "no space for a copy of the database before the change of its schema; changing it without a copy"
        );
        return Ok(());
    }
    // a file of a user stays
    let written = match is_ours(&target) {
        Ok(None | Some(true)) => write_beside(database, &target).await,
        _ => Err(StoreError::NotABackup {
            path: target.clone(),
            detail: "it is not an armwatch database".into(),
        }),
    };
    match written {
        Ok(_) => {
            tracing::info!(
                copy = %target.display(),
                "the database was copied before the change of its schema; delete the copy when you no longer need it"
            );
            for earlier in
                (1..schema).map(name_of).filter(|copy| is_ours(copy).is_ok_and(|is| is == Some(true)))
            {
                let _ = std::fs::remove_file(earlier);
            }
            Ok(())
        }
        Err(error @ StoreError::Corrupt { .. }) => Err(error),
        Err(error) => {
            tracing::warn!(%error, "the database was not copied before the change of its schema; changing \
                it without a copy");
            Ok(())
        }
    }
}

pub(super) fn is_same_file(one: &Path, other: &Path) -> bool {
    let id = |path: &Path| std::fs::metadata(path).ok().map(|of| (of.dev(), of.ino()));
    id(one).is_some_and(|one| id(other) == Some(one))
}

pub(super) fn not_written(target: &Path, error: std::io::Error) -> StoreError {
    StoreError::from_sqlx(target, &sqlx::Error::Io(error))
}

pub(super) async fn write_beside(source: &Path, target: &Path) -> Result<Backup, StoreError> {
    let (from, to) = (source.to_owned(), target.to_owned());
    let written = tokio::task::spawn_blocking(move || write(&from, &to)).await;
    written.unwrap_or_else(|error| Err(not_written(target, std::io::Error::other(error))))
}

fn write(source: &Path, target: &Path) -> Result<Backup, StoreError> {
    let partial = Partial::of(target).map_err(|error| not_written(target, error))?;
    let of_source = copy(source, partial.path(), target)?;
    let copied = check(partial.path());
    let copied = copied.map_err(|error| copy_error(source, StoreError::from_rusqlite(target, &error)))?;
    let fault = copied.fault.or_else(|| {
        let differing = of_source.iter().find(|table| !copied.tables.contains(table));
        differing.map(|table| format!("the table {} differs from the one in the database", table.name))
    });
    if let Some(fault) = fault {
        let detail = format!("its copy: {fault}");
        return Err(StoreError::Corrupt { path: source.to_owned(), detail });
    }
    let bytes = partial.place().map_err(|error| not_written(target, error))?;
    let rows = copied.tables.into_iter().map(|table| (table.name, table.rows)).collect();
    Ok(Backup { bytes, rows })
}

/// A table as it is compared.
#[derive(Debug, PartialEq, Eq)]
struct TableContent {
    name: String,
    rows: u64,
    /// Hash of all values.
    hash: blake3::Hash,
}

/// Checks the pages of the database and copies one moment of it; returns the content of its tables at that moment.
fn copy(source: &Path, partial: &Path, target: &Path) -> Result<Vec<TableContent>, StoreError> {
    let broken = |error: rusqlite::Error| StoreError::from_rusqlite(source, &error);
    let connection = question::connect(source).map_err(broken)?;
    connection.execute_batch("BEGIN").map_err(broken)?;
    if let Some(detail) = first_fault(&connection, "quick_check").map_err(broken)? {
        return Err(StoreError::Corrupt { path: source.to_owned(), detail });
    }
    copy_pages(&connection, partial)
        .map_err(|error| copy_error(source, StoreError::from_rusqlite(target, &error)))?;
    tables(&connection).map_err(broken)
}

fn copy_pages(source: &Connection, partial: &Path) -> Result<(), rusqlite::Error> {
    let mut copy = Connection::open(partial)?;
    // the file is synced as a whole before it gets its name
    copy.execute_batch(
        "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; PRAGMA locking_mode = EXCLUSIVE",
    )?;
    let pages = PageCopy::new(source, &mut copy)?;
    loop {
        match pages.step(-1)? {
            StepResult::Done => break,
            _ => std::thread::sleep(LOCK_RETRY),
        }
    }
    drop(pages);
    drop(copy);
    // readers of the copy then need no log
    let copy = Connection::open(partial)?;
    copy.execute_batch(
        "PRAGMA locking_mode = EXCLUSIVE; PRAGMA synchronous = OFF; PRAGMA journal_mode = DELETE",
    )
}

/// Result of checking a copy.
struct Checked {
    fault: Option<String>,
    tables: Vec<TableContent>,
}

fn check(copy: &Path) -> Result<Checked, rusqlite::Error> {
    let copy = question::connect(copy)?;
    let fault = match first_fault(&copy, "integrity_check")? {
        None => {
            let is_dangling = copy.prepare("PRAGMA foreign_key_check")?.exists([])?;
            is_dangling.then(|| "rows refer to missing rows".to_owned())
        }
        fault => fault,
    };
    Ok(Checked { fault, tables: tables(&copy)? })
}

/// First finding of SQLite's `check`, such as `quick_check`.
pub(super) fn first_fault(connection: &Connection, check: &str) -> Result<Option<String>, rusqlite::Error> {
    let found: String = connection.query_row(&format!("PRAGMA {check}(1)"), [], |row| row.get(0))?;
    Ok((found != "ok").then(|| found.trim().to_owned()))
}

/// Content of all tables, by name.
fn tables(connection: &Connection) -> Result<Vec<TableContent>, rusqlite::Error> {
    let mut listed = connection.prepare(
        "SELECT name FROM sqlite_schema WHERE type = 'table' AND name NOT LIKE 'sqlite~_%' ESCAPE '~' ORDER BY name",
    )?;
    let names: Vec<String> = listed.query_map([], |row| row.get(0))?.collect::<Result<_, _>>()?;
    names.into_iter().map(|name| content(connection, name)).collect()
}

fn content(connection: &Connection, name: String) -> Result<TableContent, rusqlite::Error> {
    let mut statement = connection.prepare(&format!("SELECT * FROM \"{name}\""))?;
    let columns = statement.column_count();
    let (mut hash, mut count) = (blake3::Hasher::new(), 0);
    let mut rows = statement.query([])?;
    while let Some(row) = rows.next()? {
        count += 1;
        for column in 0..columns {
            let mut add = |kind: u8, bytes: &[u8]| {
                hash.update(&[kind]).update(&(bytes.len() as u64).to_le_bytes()).update(bytes);
            };
            match row.get_ref(column)? {
                ValueRef::Null => add(0, &[]),
                ValueRef::Integer(number) => add(1, &number.to_le_bytes()),
                ValueRef::Real(number) => add(2, &number.to_le_bytes()),
                ValueRef::Text(text) => add(3, text),
                ValueRef::Blob(bytes) => add(4, bytes),
            }
        }
    }
    Ok(TableContent { name, rows: count, hash: hash.finalize() })
}

/// The error of copying from `source`. Damage found while copying is that of the source, even if the error names the
/// copy.
pub(super) fn copy_error(source: &Path, error: StoreError) -> StoreError {
    match error {
        StoreError::Corrupt { detail, .. }
        | StoreError::NotADatabase { detail, .. }
        // rows that violate a rule of the schema
        | StoreError::Refused { detail, .. } => StoreError::Corrupt { path: source.to_owned(), detail },
        error => error,
    }
}

/// True if the file at `target` is a database of this program; `None` if there is no file.
pub(super) fn is_ours(target: &Path) -> std::io::Result<Option<bool>> {
    let found = header_of(target)?;
    Ok(found.map(|found| found.is_some_and(|[_, application_id]| application_id == APPLICATION_ID)))
}

/// Identifying numbers of a database, those of the user and of the application, from the header of the file (SQLite,
/// "Database File Format"). The inner `None` is for a file that is too short or no regular file, the outer for no file.
pub(super) fn header_of(target: &Path) -> std::io::Result<Option<Option<[i64; 2]>>> {
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
