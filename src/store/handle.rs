//! The handle of an open database.

use std::path::Path;
use std::sync::Arc;

use super::error::StoreError;
#[cfg(feature = "postgres")]
use crate::store::engine::daemon_lock::DaemonLock;
use crate::store::engine::{Dialect, EnginePool, EngineTransaction, begin_writing, dialect};

/// An open database. Clones share it.
#[derive(Debug, Clone)]
pub struct Store {
    pub(super) path: Arc<Path>,
    pub(super) writer: EnginePool,
    pub(super) readers: EnginePool,
    /// A reader for questions about the database's health: it takes no turn of the others.
    pub(super) probe: EnginePool,
    /// Whether it was opened to look into it.
    pub(super) is_read_only: bool,
    /// Whether the connection that writes is the one daemon's.
    #[cfg(feature = "postgres")]
    pub(super) daemon: DaemonLock,
}

impl Store {
    /// Moves the write-ahead log into the database file and closes it, for all clones.
    ///
    /// # Errors
    /// [`StoreError`] of the last checkpoint; what was committed is safe all the same.
    pub async fn close(self) -> Result<(), StoreError> {
        // Readers first: a checkpoint cannot empty the log while they look at it.
        self.probe.close().await;
        self.readers.close().await;
        if self.is_read_only {
            return Ok(());
        }
        match self.dialect() {
            Dialect::Sqlite => {
                let checkpoint = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&self.writer).await;
                self.writer.close().await;
                self.checked(checkpoint).map(|_| ())
            }
            #[cfg(feature = "postgres")]
            Dialect::Postgres => {
                self.writer.close().await;
                Ok(())
            }
        }
    }

    pub(in crate::store) fn dialect(&self) -> Dialect {
        dialect(&self.readers)
    }

    /// What a database on a server leaves to the programs of the server, said with how they do it.
    #[cfg(feature = "postgres")]
    pub(in crate::store) fn on_server(&self, what: &'static str, instead: String) -> StoreError {
        StoreError::OnServer { path: self.path.to_path_buf(), what, instead }
    }

    /// A transaction that has the write lock.
    pub(in crate::store) async fn begin(&self) -> Result<EngineTransaction, StoreError> {
        self.checked(begin_writing(&self.writer).await)
    }

    pub(in crate::store) async fn commit(&self, transaction: EngineTransaction) -> Result<(), StoreError> {
        self.checked(transaction.commit().await)
    }

    pub(in crate::store) fn run_not_open(&self, run_id: i64) -> StoreError {
        StoreError::RunNotOpen { path: self.path.to_path_buf(), run_id }
    }

    pub(in crate::store) fn checked<T>(&self, result: Result<T, sqlx::Error>) -> Result<T, StoreError> {
        result.map_err(|error| StoreError::from_sqlx(&self.path, &error))
    }
}
