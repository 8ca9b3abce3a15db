//! One daemon a database in a file, and one a host on a server: two would analyse every export twice.

use std::fs::{File, TryLockError};
use std::io::Write;
use std::path::Path;

use super::engine::host_lock::HostLock;
use super::engine::{Dialect, EnginePool};
use super::error::StoreError;
use crate::handle::Store;

/// A daemon's claim on a database. The operating system releases it with the process, however that
/// ends; the file beside the database, which holds the number of the process, stays. A server releases it with the
/// connection.
#[derive(Debug)]
pub struct DaemonClaim {
    _held: Held,
}

#[derive(Debug)]
enum Held {
    File { _locked: File },
    Server(HostLock, EnginePool),
}

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
            Dialect::Postgres => {
                let lock = self.own_host.lock();
                if !self.checked(lock.claim(&self.writer).await)? {
                    let host = self.own_host.place().host().to_owned();
                    return Err(StoreError::HostAtWork { path: self.path.to_path_buf(), host });
                }
                Ok(DaemonClaim { _held: Held::Server(lock.clone(), self.writer.clone()) })
            }
        }
    }
}

impl Store {
    /// Whether a daemon works on the database, which draws conclusions itself. On a server, one that has not said that it
    /// ends counts until its lease is over.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn has_daemon(&self) -> Result<bool, StoreError> {
        match self.dialect() {
            Dialect::Sqlite => match claim(&self.path) {
                Err(StoreError::Claimed { .. }) => Ok(true),
                Err(error) => Err(error),
                // not kept: a daemon that starts now takes over
                Ok(_) => Ok(false),
            },
            Dialect::Postgres => {
                let daemon = "SELECT EXISTS (SELECT 1 FROM host_session
                                             WHERE kind = 'daemon' AND ended_at IS NULL AND alive_until > clock_us())";
                self.checked(sqlx::query_scalar(daemon).fetch_one(&self.readers).await)
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
