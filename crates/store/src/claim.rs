//! One daemon per database in a file, and one per host on a server: two would analyse every export twice.

use std::fs::{File, Permissions, TryLockError};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt, fchown};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use jiff::Timestamp;
use nix::fcntl::OFlag;

use super::engine::host_lock::HostLock;
use super::engine::{Dialect, EnginePool};
use super::error::StoreError;
use super::inode_lock::{InodeLock, LockOutcome};
use super::partial;
use crate::handle::Store;

/// Mode of the lock file: a user who can open it can keep the daemon from starting.
const PRIVATE: u32 = 0o600;

/// Time without a sign of life after which a daemon counts as silent.
const SILENT_AFTER: Duration = Duration::from_secs(120);

/// The daemon of a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DaemonState {
    /// It works.
    AtWork,
    /// Its process exists and has shown no sign of life since this time.
    SilentSince(Timestamp),
    /// There is none.
    Absent,
}

impl DaemonState {
    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::AtWork => "at_work",
            Self::SilentSince(_) => "silent",
            Self::Absent => "absent",
        }
    }
}

/// A daemon's claim on a database. The operating system releases it when the process ends for any reason. The file next
/// to the database with the number of the process stays. A server releases the claim with the connection.
#[derive(Debug)]
pub struct DaemonClaim {
    held: HeldClaim,
}

impl DaemonClaim {
    /// Interval of the signs of life, which are written to the time of the lock file.
    pub const BEAT: Duration = Duration::from_secs(30);

    /// Shows that the daemon works. On a server, its lease does.
    pub fn beat(&self) {
        if let HeldClaim::File { locked, .. } = &self.held
            && let Err(error) = locked.set_modified(SystemTime::now())
        {
            tracing::debug!(%error, "the time of the lock file could not be set");
        }
    }
}

#[derive(Debug)]
enum HeldClaim {
    File { locked: File, _inode: Option<InodeLock> },
    Server(HostLock, EnginePool),
}

impl Drop for HeldClaim {
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
    /// [`StoreError::Claimed`] while another process holds the claim, [`StoreError::LockFile`].
    pub async fn claim(&self) -> Result<DaemonClaim, StoreError> {
        match self.dialect() {
            Dialect::Sqlite => {
                let claim = claim(&self.path)?;
                // an earlier daemon may have been killed while it copied the database
                partial::remove_left(&self.path);
                Ok(claim)
            }
            Dialect::Postgres => {
                let lock = self.own_host.lock();
                if !self.checked(lock.claim(&self.writer).await)? {
                    let host = self.own_host.place().host().to_owned();
                    return Err(StoreError::HostAtWork { path: self.path.to_path_buf(), host });
                }
                Ok(DaemonClaim { held: HeldClaim::Server(lock.clone(), self.writer.clone()) })
            }
        }
    }
}

impl Store {
    /// Returns true if a daemon works on the database and therefore draws the conclusions. On a server, a daemon that
    /// ended without notice counts until its lease ends.
    pub async fn has_daemon(&self) -> Result<bool, StoreError> {
        match self.dialect() {
            Dialect::Sqlite => Ok(is_claimed(&self.path)),
            Dialect::Postgres => {
                let daemon = "SELECT EXISTS (SELECT 1 FROM host_session
                                             WHERE kind = 'daemon' AND ended_at IS NULL AND alive_until > clock_us())";
                self.checked(sqlx::query_scalar(daemon).fetch_one(&self.readers).await)
            }
        }
    }

    /// The daemon of this database, with its last sign of life.
    pub async fn daemon(&self) -> Result<DaemonState, StoreError> {
        if !self.has_daemon().await? {
            return Ok(DaemonState::Absent);
        }
        let beaten = std::fs::metadata(lock_file_of(&self.path)).and_then(|lock| lock.modified());
        let Ok(beaten) = beaten else { return Ok(DaemonState::AtWork) };
        let is_silent = beaten.elapsed().is_ok_and(|age| age > SILENT_AFTER);
        Ok(match Timestamp::try_from(beaten) {
            Ok(since) if is_silent && self.dialect() == Dialect::Sqlite => DaemonState::SilentSince(since),
            _ => DaemonState::AtWork,
        })
    }
}

/// The lock file of a daemon, next to the database file that links lead to.
pub fn lock_file_of(database: &Path) -> PathBuf {
    let real = database.canonicalize().unwrap_or_else(|_| database.to_path_buf());
    let mut name = real.into_os_string();
    name.push(".daemon");
    name.into()
}

pub(super) fn claim(database: &Path) -> Result<DaemonClaim, StoreError> {
    let lock = lock_file_of(database);
    let failed = |error: std::io::Error| StoreError::LockFile {
        path: database.into(),
        lock: lock.clone(),
        detail: error.to_string(),
    };
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .mode(PRIVATE)
        // a link of another user must not lead a daemon of root to a file of the system
        .custom_flags(OFlag::O_NOFOLLOW.bits())
        .open(&lock)
        .map_err(failed)?;
    make_private(&file, database);
    let claimed = || {
        let said = std::fs::read_to_string(&lock).unwrap_or_default();
        Err(StoreError::Claimed { path: database.into(), process: said.trim().parse().ok() })
    };
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return claimed(),
        // a file system without locks, such as some network shares, cannot distinguish two daemons
        Err(TryLockError::Error(error)) => return Err(failed(error)),
    }
    let inode = match InodeLock::take(database) {
        LockOutcome::Held(lock) => Some(lock),
        // it opened the file by another name
        LockOutcome::ByDaemon => return Err(StoreError::Claimed { path: database.into(), process: None }),
        LockOutcome::Unavailable => {
            tracing::warn!(
                database = %database.display(),
                "the database file cannot be locked; a second daemon under another name of the file would \
                not be noticed"
            );
            None
        }
    };
    leave_number(&file);
    let claim = DaemonClaim { held: HeldClaim::File { locked: file, _inode: inode } };
    claim.beat();
    Ok(claim)
}

/// True if a daemon in another process has claimed the database.
fn is_claimed(database: &Path) -> bool {
    if InodeLock::is_of_daemon(database) {
        return true;
    }
    let lock =
        File::options().write(true).custom_flags(OFlag::O_NOFOLLOW.bits()).open(lock_file_of(database));
    match lock.map(|lock| lock.try_lock()) {
        Ok(tried) => matches!(tried, Err(TryLockError::WouldBlock)),
        Err(error) => {
            if error.kind() != ErrorKind::NotFound {
                tracing::debug!(%error, "the lock file of the daemon belongs to another user");
            }
            false
        }
    }
}

/// Makes the lock file private. If root creates it, it belongs to the owner of the database, as SQLite's files do.
fn make_private(file: &File, database: &Path) {
    let set = || {
        let own = file.metadata()?;
        if own.mode() & 0o777 != PRIVATE {
            file.set_permissions(Permissions::from_mode(PRIVATE))?;
        }
        let of = std::fs::metadata(database)?;
        match nix::unistd::geteuid().is_root() && own.uid() != of.uid() {
            true => fchown(file, Some(of.uid()), Some(of.gid())),
            false => Ok(()),
        }
    };
    if let Err(error) = set() {
        tracing::warn!(lock = %lock_file_of(database).display(), %error, "other users can hold the lock of the daemon");
    }
}

/// Stores the number of the process that holds the claim. It only informs people, so a full disk must not prevent the
/// daemon's own error message.
fn leave_number(mut file: &File) {
    let number = std::process::id();
    if let Err(error) = file.set_len(0).and_then(|()| writeln!(file, "{number}")) {
        tracing::debug!(%error, "the process number could not be written next to the database");
    }
}
