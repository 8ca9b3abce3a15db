//! Descriptors of database files, which stay open until the process ends.
//!
//! POSIX drops all locks of a process on a file, SQLite's too, when the process closes any descriptor of that file.

use std::collections::BTreeMap;
use std::fs::{File, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use armwatch_model::run::FileId;

static KEPT: Mutex<BTreeMap<(u64, u64), Arc<File>>> = Mutex::new(BTreeMap::new());

/// Device and inode of the file that `metadata` describes.
pub(super) fn id_of(metadata: &Metadata) -> FileId {
    FileId { device: metadata.dev(), inode: metadata.ino() }
}

/// The file at `path`, opened for writing if this user may write to it. Each file is opened once.
pub(super) fn of(path: &Path) -> io::Result<Arc<File>> {
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let key = |metadata: &Metadata| (metadata.dev(), metadata.ino());
    if let Some(known) = kept.get(&key(&std::fs::metadata(path)?)) {
        return Ok(Arc::clone(known));
    }
    let opened = File::options().read(true).write(true).open(path).or_else(|_| File::open(path))?;
    let key = key(&opened.metadata()?);
    let opened = Arc::new(opened);
    match kept.get(&key) {
        // the path led elsewhere a moment ago; this descriptor must not be closed either
        Some(known) => {
            std::mem::forget(opened);
            Ok(Arc::clone(known))
        }
        None => Ok(Arc::clone(kept.entry(key).or_insert(opened))),
    }
}
