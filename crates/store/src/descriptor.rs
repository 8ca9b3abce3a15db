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

/// Descriptors by device and inode. The first descriptor of each file is used.
type Descriptors = BTreeMap<(u64, u64), Vec<Arc<File>>>;

static KEPT: Mutex<Descriptors> = Mutex::new(Descriptors::new());

/// Device and inode of the file that `metadata` describes.
pub(super) fn id_of(metadata: &Metadata) -> FileId {
    FileId { device: metadata.dev(), inode: metadata.ino() }
}

/// The file at `path`, opened for writing if this user may write to it. A known file is not opened again.
pub(super) fn of(path: &Path) -> io::Result<Arc<File>> {
    let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
    let key = |metadata: &Metadata| (metadata.dev(), metadata.ino());
    if let Some(known) = kept.get(&key(&std::fs::metadata(path)?)).and_then(|files| files.first()) {
        return Ok(Arc::clone(known));
    }
    let opened = File::options().read(true).write(true).open(path).or_else(|_| File::open(path))?;
    let files = kept.entry(key(&opened.metadata()?)).or_default();
    // the file may still be known, if the path led elsewhere a moment ago; this descriptor stays open, too
    files.push(Arc::new(opened));
    Ok(Arc::clone(&files[0]))
}
