//! The handle of an open database.

use std::path::Path;
use std::sync::Arc;

use super::error::StoreError;
use super::open_files::OpenFiles;
use super::own_host::OwnHost;
use crate::engine::{Dialect, EnginePool, EngineTransaction, begin_writing, dialect};

/// An open database. Clones share it.
///
/// Every method that reads or writes can fail with the [`StoreError`] of the database; `# Errors` of a method lists only
/// further ones.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) path: Arc<Path>,
    pub(super) writer: EnginePool,
    pub(super) readers: EnginePool,
    /// A reader for queries about the database's health, separate from the others so that it never waits for them.
    pub(super) probe: EnginePool,
    /// True if it was opened for reading only.
    pub(super) is_read_only: bool,
    /// True if it is a snapshot.
    pub(super) is_snapshot: bool,
    /// The files of a database that this program writes to.
    pub(super) files: Option<Arc<OpenFiles>>,
    /// The host of this program.
    pub(super) own_host: OwnHost,
}

impl Store {
    /// Checks that the open database is still the file at its path. Rows written to a deleted or replaced file are lost
    /// when the program ends.
    ///
    /// # Errors
    /// [`StoreError::Displaced`], after which nothing more is stored.
    pub fn check_files(&self) -> Result<(), StoreError> {
        self.files.as_ref().map_or(Ok(()), |files| files.check(&self.path))
    }

    /// Moves the write-ahead log into the database file and closes it, for all clones.
    ///
    /// # Errors
    /// [`StoreError`] of the last checkpoint; commits are safe even then, except with [`StoreError::Displaced`].
    pub async fn close(self) -> Result<(), StoreError> {
        let in_place = self.check_files();
        // Readers first: a checkpoint cannot empty the log while they read from it.
        self.probe.close().await;
        self.readers.close().await;
        if self.is_read_only {
            return Ok(());
        }
        match self.dialect() {
            Dialect::Sqlite => {
                let checkpoint = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&self.writer).await;
                self.writer.close().await;
                in_place.and(self.checked(checkpoint).map(|_| ()))
            }
            Dialect::Postgres => {
                self.control().close().await;
                self.writer.close().await;
                Ok(())
            }
        }
    }

    /// A separate connection for leases and claims, which must not wait for the writer.
    pub(crate) fn control(&self) -> EnginePool {
        self.own_host.control(&self.writer)
    }

    pub(crate) fn dialect(&self) -> Dialect {
        dialect(&self.readers)
    }

    /// Error for an operation that the programs of a server do instead, with the way to do it there.
    pub(crate) fn on_server(&self, what: &'static str, instead: String) -> StoreError {
        StoreError::OnServer { path: self.path.to_path_buf(), what, instead }
    }

    /// A transaction that has the write lock.
    ///
    /// # Errors
    /// [`StoreError::Displaced`]; [`StoreError::LeaseEnded`] if other daemons have claimed this program's work; others
    /// of the database.
    pub(crate) async fn begin(&self) -> Result<EngineTransaction, StoreError> {
        self.check_files()?;
        let mut transaction = self.checked(begin_writing(&self.writer).await)?;
        if self.checked(self.own_host.is_alive(&mut *transaction).await)? {
            Ok(transaction)
        } else {
            Err(StoreError::LeaseEnded { path: self.path.to_path_buf() })
        }
    }

    pub(crate) async fn commit(&self, transaction: EngineTransaction) -> Result<(), StoreError> {
        self.checked(transaction.commit().await)
    }

    pub(crate) fn run_not_open(&self, run_id: i64) -> StoreError {
        StoreError::RunNotOpen { path: self.path.to_path_buf(), run_id }
    }

    pub(crate) fn checked<T>(&self, result: sqlx::Result<T>) -> Result<T, StoreError> {
        result.map_err(|error| StoreError::from_sqlx(&self.path, &error))
    }
}
