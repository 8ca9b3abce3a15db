//! One daemon a database: two would analyse every export twice.

use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::Path;

use super::engine::Dialect;
#[cfg(feature = "postgres")]
use super::engine::{EnginePool, daemon_lock::DaemonLock};
use super::error::StoreError;
use crate::store::handle::Store;

/// A daemon's claim on a database. The operating system releases it with the process, however that
/// ends; the file beside the database, which holds the number of the process, stays. A server releases it with the
/// connection.
#[derive(Debug)]
pub struct DaemonClaim {
    _held: Held,
}

#[derive(Debug)]
enum Held {
    File {
        _locked: File,
    },
    #[cfg(feature = "postgres")]
    Server(DaemonLock, EnginePool),
}

#[cfg(feature = "postgres")]
impl Drop for Held {
    fn drop(&mut self) {
        if let Self::Server(lock, writer) = self {
            lock.leave(writer);
        }
    }
}

impl Store {
    /// Claims the database for one daemon, until the claim is dropped or the process ends.
    ///
    /// # Errors
    /// [`StoreError::Claimed`] while another process holds the claim.
    pub async fn claim(&self) -> Result<DaemonClaim, StoreError> {
        match self.dialect() {
            Dialect::Sqlite => claim(&self.path),
            #[cfg(feature = "postgres")]
            Dialect::Postgres => {
                if !self.checked(self.daemon.claim(&self.writer).await)? {
                    return Err(StoreError::Claimed { path: self.path.to_path_buf(), process: None });
                }
                Ok(DaemonClaim { _held: Held::Server(self.daemon.clone(), self.writer.clone()) })
            }
        }
    }
}

pub(super) fn claim(database: &Path) -> Result<DaemonClaim, StoreError> {
    let mut name = database.as_os_str().to_owned();
    name.push(".daemon");
    let not_writable =
        |error: std::io::Error| StoreError::NotWritable { path: database.into(), detail: error.to_string() };
    let file = File::options().create(true).truncate(false).write(true).open(&name).map_err(not_writable)?;
    match file.try_lock() {
        Ok(()) => {
            leave_number(&file);
            Ok(DaemonClaim { _held: Held::File { _locked: file } })
        }
        Err(TryLockError::WouldBlock) => {
            let said = std::fs::read_to_string(&name).unwrap_or_default();
            Err(StoreError::Claimed { path: database.into(), process: said.trim().parse().ok() })
        }
        // a file system without locks, such as some network shares, cannot tell two daemons apart
        Err(TryLockError::Error(error)) => Err(not_writable(error)),
    }
}

/// Writes down which process holds the claim. Only for people: a full disk must not keep the daemon from
/// saying so in its own words.
fn leave_number(mut file: &File) {
    let number = std::process::id();
    if let Err(error) = file.set_len(0).and_then(|()| writeln!(file, "{number}")) {
        tracing::debug!(%error, "the number of this process is not beside the database");
    }
}
