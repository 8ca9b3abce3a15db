//! SQLite's write-ahead log, in which commits stand before a checkpoint moves them into the database.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::StoreError;

/// The log of a database: a file beside it.
pub(super) fn path_of(database: &Path) -> PathBuf {
    let mut log = database.as_os_str().to_owned();
    log.push("-wal");
    log.into()
}

/// Whether commits may stand in the log.
pub(super) fn has_commits(database: &Path) -> bool {
    std::fs::metadata(path_of(database)).is_ok_and(|metadata| metadata.len() > 0)
}

/// Syncs the log, and the folder that names it. Commits that are not in it any more were moved into the
/// database by a checkpoint, which syncs.
pub(super) async fn sync(path: &Arc<Path>) -> Result<(), StoreError> {
    let database = Arc::clone(path);
    let synced = tokio::task::spawn_blocking(move || {
        match File::open(path_of(&database)) {
            Ok(log) => log.sync_all()?,
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        database.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())
    });
    let synced = synced.await.unwrap_or_else(|error| Err(std::io::Error::other(error)));
    synced.map_err(|error| StoreError::not_writable(path, &error))
}
