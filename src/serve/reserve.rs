//! Space that uploads leave free, so that the database can still be written.

use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::statvfs;

/// Default reserve: the disk's size divided by this number ...
const DEFAULT_SHARE: u64 = 20;

/// ... but at most this many bytes. A write-ahead log takes some hundred megabytes after a burst.
const DEFAULT_MOST_BYTES: u64 = 1 << 30;

/// Free space on the disks of some folders.
#[derive(Debug)]
pub struct Reserve {
    /// Name of each folder in messages, and its path.
    folders: Vec<(&'static str, PathBuf)>,
    bytes: Option<u64>,
}

/// Missing space.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shortage {
    /// Bytes that are missing.
    pub bytes: u64,
    what: &'static str,
    free: u64,
    reserved: u64,
}

impl Reserve {
    /// The reserve on the disks of the spool and of the database, unless the database is on a server. `bytes` applies
    /// to each disk; by default it is 5 % of the disk and at most 1 GiB.
    pub fn new(spool: &Path, database: Option<&Path>, bytes: Option<u64>) -> Self {
        let mut folders = vec![("the spool", spool.to_owned())];
        if let Some(database) = database {
            let folder = database.parent().filter(|folder| !folder.as_os_str().is_empty());
            folders.push(("the database", folder.unwrap_or(Path::new(".")).to_owned()));
        }
        Self { folders, bytes }
    }

    /// Space that is missing to write this many bytes and leave the reserve free; `None` if there is enough.
    pub fn shortage(&self, bytes: u64) -> io::Result<Option<Shortage>> {
        for (what, folder) in &self.folders {
            let disk = statvfs(folder)?;
            let free = disk.f_bavail.saturating_mul(disk.f_frsize);
            let size = disk.f_blocks.saturating_mul(disk.f_frsize);
            let reserved = self.bytes.unwrap_or((size / DEFAULT_SHARE).min(DEFAULT_MOST_BYTES));
            let missing = reserved.saturating_add(bytes).saturating_sub(free);
            if missing > 0 {
                return Ok(Some(Shortage { bytes: missing, what, free, reserved }));
            }
        }
        Ok(None)
    }
}

impl std::fmt::Display for Shortage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mb = |bytes: u64| bytes as f64 / 1e6;
        write!(
            f,
            "{:.1} MB are free on the disk of {}, {:.1} MB of them are reserved, and {:.1} MB are missing",
            mb(self.free),
            self.what,
            mb(self.reserved),
            mb(self.bytes)
        )
    }
}

impl From<Shortage> for io::Error {
    fn from(short: Shortage) -> Self {
        Self::new(io::ErrorKind::StorageFull, short.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reserve_that_is_not_free_is_told_with_its_disk() {
        let folder = tempfile::tempdir().unwrap();
        let of = |bytes| Reserve::new(folder.path(), None, Some(bytes));
        assert_eq!(of(0).shortage(1).unwrap(), None);
        let short = of(1 << 60).shortage(0).unwrap().unwrap();
        assert!(short.bytes > 1 << 59 && short.to_string().contains("disk of the spool"), "{short}");
        assert!(of(0).shortage(u64::MAX).unwrap().is_some(), "more than any disk has");
        assert_eq!(io::Error::from(short).kind(), io::ErrorKind::StorageFull);
        assert!(Reserve::new(&folder.path().join("gone"), None, None).shortage(0).is_err());
    }
}
