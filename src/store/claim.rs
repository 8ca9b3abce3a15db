//! One daemon a database: two would analyse every export twice.

use std::fs::{File, TryLockError};
use std::path::Path;

use super::StoreError;

/// A daemon's claim on a database. The operating system releases it with the process, however that
/// ends; the empty file beside the database stays.
#[derive(Debug)]
pub struct DaemonClaim {
    _locked: File,
}

pub(super) fn claim(database: &Path) -> Result<DaemonClaim, StoreError> {
    let mut name = database.as_os_str().to_owned();
    name.push(".daemon");
    let not_writable =
        |error: std::io::Error| StoreError::NotWritable { path: database.into(), detail: error.to_string() };
    let file = File::options().create(true).truncate(false).write(true).open(&name).map_err(not_writable)?;
    match file.try_lock() {
        Ok(()) => Ok(DaemonClaim { _locked: file }),
        Err(TryLockError::WouldBlock) => Err(StoreError::Claimed { path: database.into() }),
        // a file system without locks, such as some network shares, cannot tell two daemons apart
        Err(TryLockError::Error(error)) => Err(not_writable(error)),
    }
}
