//! Conditions under which a thread opens files, and its calls that the file system has not answered.
//!
//! A call to a dead file server does not return, and the thread that made it cannot report this. So [`asking`] notes
//! each call of this package, and other threads see how long it has lasted.

use std::cell::RefCell;
use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, ThreadId};
use std::time::Instant;

use super::fingerprint::id_of;
use crate::rejection::Unreadable;

/// Conditions under which files are opened, and the calls of the threads that work under them. Clones share the calls.
#[derive(Debug, Clone, Default)]
pub struct FileAccess {
    within: Option<Arc<[PathBuf]>>,
    calls: Arc<Mutex<Vec<(ThreadId, Instant)>>>,
}

thread_local! {
    static CURRENT: RefCell<FileAccess> = RefCell::default();
}

impl FileAccess {
    /// Access that refuses a file whose path begins with one of `folders` and that is elsewhere because of a link.
    pub fn within(folders: impl IntoIterator<Item = PathBuf>) -> Self {
        Self { within: Some(folders.into_iter().collect()), ..Self::default() }
    }

    /// The same conditions with a separate list of calls.
    pub fn apart(&self) -> Self {
        Self { within: self.within.clone(), ..Self::default() }
    }

    /// Runs `work` on this thread under these conditions.
    pub fn during<T>(&self, work: impl FnOnce() -> T) -> T {
        let _restored = AccessGuard(CURRENT.replace(self.clone()));
        work()
    }

    /// Start of the oldest call that has not returned.
    pub fn asks_since(&self) -> Option<Instant> {
        let calls = self.calls.lock().unwrap_or_else(PoisonError::into_inner);
        calls.iter().map(|(_, since)| *since).min()
    }
}

/// Restores the access of a thread, also after a panic.
struct AccessGuard(FileAccess);

impl Drop for AccessGuard {
    fn drop(&mut self) {
        CURRENT.replace(std::mem::take(&mut self.0));
    }
}

/// A call that lasts until this is dropped.
struct Call(FileAccess);

impl Drop for Call {
    fn drop(&mut self) {
        let this = thread::current().id();
        let mut calls = self.0.calls.lock().unwrap_or_else(PoisonError::into_inner);
        // the latest of this thread: a call may be part of another
        if let Some(at) = calls.iter().rposition(|(thread, _)| *thread == this) {
            calls.remove(at);
        }
    }
}

/// Makes a call to the file system, which may never return.
pub fn asking<T>(call: impl FnOnce() -> T) -> T {
    let access = CURRENT.with_borrow(Clone::clone);
    access
        .calls
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push((thread::current().id(), Instant::now()));
    let _call = Call(access);
    call()
}

/// Like [`std::fs::metadata`].
pub fn metadata(path: &Path) -> io::Result<Metadata> {
    asking(|| std::fs::metadata(path))
}

/// A file whose reads are calls of [`asking`].
#[derive(Debug)]
pub(crate) struct GuardedFile<R>(pub(crate) R);

impl<R: Read> Read for GuardedFile<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        asking(|| self.0.read(buffer))
    }
}

/// Refuses an open file whose path is in a folder of the current access although the file is not. It checks the open
/// file, because its path may have become a link in the meantime.
pub(crate) fn refuse_outside(file: &File, path: &Path) -> io::Result<()> {
    let Some(within) = CURRENT.with_borrow(|access| access.within.clone()) else { return Ok(()) };
    let path = std::path::absolute(path)?;
    let mut around = within.iter().filter(|folder| path.starts_with(folder)).peekable();
    if around.peek().is_none() {
        return Ok(());
    }
    let real = real_path(file, &path)?;
    // a watched folder may itself be reached by a link
    if around.any(|folder| std::fs::canonicalize(folder).is_ok_and(|folder| real.starts_with(folder))) {
        return Ok(());
    }
    Err(io::Error::other(Unreadable { reason: LEADS_OUT.into(), remedy: LEADS_OUT_REMEDY.into() }))
}

/// Why a link is not followed.
pub(crate) const LEADS_OUT: &str = "a link to a place outside the watched folder";

/// Remedy of [`LEADS_OUT`].
pub(crate) const LEADS_OUT_REMEDY: &str =
    "copy its target into the folder, or set follow_links = true under [watch]";

/// Path of an open file, without links.
fn real_path(file: &File, path: &Path) -> io::Result<PathBuf> {
    #[cfg(target_os = "linux")]
    {
        use std::os::fd::AsRawFd;
        if let Ok(real) = std::fs::read_link(format!("/proc/self/fd/{}", file.as_raw_fd())) {
            return Ok(real);
        }
    }
    let real = std::fs::canonicalize(path)?;
    match id_of(&std::fs::symlink_metadata(&real)?) == id_of(&file.metadata()?) {
        true => Ok(real),
        false => Err(io::Error::new(io::ErrorKind::NotFound, "another file has its name")),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;
    use std::sync::mpsc;

    use super::super::fingerprint::regular_file;
    use super::*;

    #[test]
    fn a_file_that_a_link_reaches_outside_is_refused_once_it_is_open() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir_all(path("real/sub")).unwrap();
        std::fs::create_dir_all(path("secret")).unwrap();
        std::fs::write(path("real/sub/a.csv"), "in").unwrap();
        std::fs::write(path("secret/a.csv"), "out").unwrap();
        symlink(path("real"), path("inbox")).unwrap();
        symlink(path("secret/a.csv"), path("real/link.csv")).unwrap();
        symlink(path("real/link.csv"), path("real/chain.csv")).unwrap();
        symlink(path("real/sub/a.csv"), path("real/inside.csv")).unwrap();
        symlink("../secret", path("real/folder")).unwrap();
        let access = FileAccess::within([path("inbox")]);
        let opens = |name: &str| access.during(|| regular_file(&path(name)).is_ok());
        for name in ["inbox/sub/a.csv", "inbox/inside.csv", "secret/a.csv"] {
            assert!(opens(name), "{name}");
        }
        for name in ["inbox/link.csv", "inbox/chain.csv", "inbox/folder/a.csv"] {
            let error = access.during(|| regular_file(&path(name))).unwrap_err();
            assert!(error.to_string().contains("to a place outside the watched folder"), "{name}: {error}");
            assert!(regular_file(&path(name)).is_ok(), "{name}, which a person named");
        }
        // the folder becomes a link after the scan that found its file
        std::fs::rename(path("real/sub"), path("real/before")).unwrap();
        symlink(path("secret"), path("real/sub")).unwrap();
        assert!(!opens("inbox/sub/a.csv"));
    }

    #[test]
    fn a_call_that_does_not_return_is_known() {
        let access = FileAccess::default();
        let (entered, is_in) = mpsc::channel();
        let (release, released) = mpsc::channel::<()>();
        let other = access.clone();
        let thread = thread::spawn(move || {
            other.during(|| {
                asking(|| {
                    asking(|| ());
                    entered.send(()).unwrap();
                    released.recv().unwrap();
                });
            });
        });
        is_in.recv().unwrap();
        assert!(access.asks_since().is_some_and(|since| since <= Instant::now()));
        assert!(access.apart().asks_since().is_none());
        release.send(()).unwrap();
        thread.join().unwrap();
        assert_eq!(access.asks_since(), None);
    }
}
