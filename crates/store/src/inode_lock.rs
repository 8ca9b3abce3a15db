//! A lock on the file of a database itself, for all names of the file: symbolic links, hard links and other mounts.
//!
//! It is a write lock on one byte that SQLite does not lock. It belongs to the descriptor and not to the process, so
//! SQLite's own locks stay. A user who may only read the file can hold a read lock on that byte; it is distinguished
//! from the lock of a daemon and ignored.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;

use super::descriptor;

/// Position of the byte, after those that SQLite locks from 2^30 on.
const BYTE: i64 = (1 << 30) + 1024;

/// Released when it is dropped; the descriptor stays open.
#[derive(Debug)]
pub(super) struct InodeLock(Arc<File>);

/// Result of taking the lock.
#[derive(Debug)]
pub(super) enum LockOutcome {
    Held(InodeLock),
    /// A daemon has it.
    ByDaemon,
    /// It is unavailable: a reader blocks it, or the file system has no such locks.
    Unavailable,
}

impl InodeLock {
    pub(super) fn take(database: &Path) -> LockOutcome {
        let Ok(file) = descriptor::of(database) else { return LockOutcome::Unavailable };
        match fcntl(&*file, FcntlArg::F_OFD_SETLK(&byte(libc::F_WRLCK))) {
            Ok(_) => LockOutcome::Held(Self(file)),
            Err(Errno::EAGAIN | Errno::EACCES) if is_write_locked(&file) => LockOutcome::ByDaemon,
            Err(_) => LockOutcome::Unavailable,
        }
    }

    /// True if a daemon in another process holds it.
    pub(super) fn is_of_daemon(database: &Path) -> bool {
        descriptor::of(database).is_ok_and(|file| is_write_locked(&file))
    }
}

impl Drop for InodeLock {
    fn drop(&mut self) {
        if let Err(error) = fcntl(&*self.0, FcntlArg::F_OFD_SETLK(&byte(libc::F_UNLCK))) {
            tracing::debug!(%error, "the lock on the database ends with the process");
        }
    }
}

fn is_write_locked(file: &File) -> bool {
    let mut asked = byte(libc::F_WRLCK);
    fcntl(file, FcntlArg::F_OFD_GETLK(&mut asked)).is_ok() && i32::from(asked.l_type) == libc::F_WRLCK
}

fn byte(kind: i32) -> libc::flock {
    libc::flock {
        l_type: i16::try_from(kind).unwrap_or_default(),
        l_whence: i16::try_from(libc::SEEK_SET).unwrap_or_default(),
        l_start: BYTE,
        l_len: 1,
        l_pid: 0,
    }
}
