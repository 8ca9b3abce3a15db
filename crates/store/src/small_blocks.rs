//! Disks with blocks that are smaller than a page of memory, as ext4 creates them on disks below 512 MB.
//!
//! SQLite maps the index of its log into memory and allocates space for it by writing one byte into each page of
//! memory. With smaller blocks the rest of the page is a hole. If the disk is full, the first access to the hole ends
//! the program by a signal. The program therefore checks for space before, and reserves space when the index exists.

use std::path::Path;

use nix::fcntl::{FallocateFlags, fallocate};
use nix::sys::statvfs::{Statvfs, statvfs};

use super::error::StoreError;
use super::{descriptor, write_ahead_log};

/// A page of memory that SQLite assumes, bytes.
const PAGE_BYTES: u64 = 4096;

/// Size reserved for the index, bytes: enough for a log of 512 MB.
const RESERVED_BYTES: i64 = 1 << 20;

/// Least free space on such a disk to open a database for reading, bytes: a small index.
pub(super) const LEAST_TO_READ_BYTES: u64 = 256 << 10;

/// Least free space on such a disk to open a database for writing, bytes: the reserved index, and a log of the first
/// commits.
pub(super) const LEAST_TO_WRITE_BYTES: u64 = 2 << 20;

/// Refuses a database on a disk with small blocks if less than `least_bytes` are free.
///
/// # Errors
/// [`StoreError::Full`].
pub(super) fn refuse_full(database: &Path, least_bytes: u64) -> Result<(), StoreError> {
    let Some(disk) = with_small_blocks(database) else { return Ok(()) };
    // ext4 reserves some free blocks that not even root can use
    let free = disk.blocks_available().saturating_mul(disk.fragment_size());
    if free >= least_bytes {
        return Ok(());
    }
    let detail = format!(
        "{free} bytes are free, and a disk with blocks of {} bytes needs {least_bytes}",
        disk.fragment_size()
    );
    Err(StoreError::Full { path: database.to_path_buf(), detail })
}

/// Reserves space for the index of the log of an open database on a disk with small blocks.
///
/// # Errors
/// [`StoreError::Full`].
pub(super) fn reserve(database: &Path) -> Result<(), StoreError> {
    if with_small_blocks(database).is_none() {
        return Ok(());
    }
    let full = |detail: String| StoreError::Full { path: database.to_path_buf(), detail };
    let index = descriptor::of(&write_ahead_log::index_path_of(database));
    let index = index.map_err(|error| full(error.to_string()))?;
    // beyond the end of the file, whose length SQLite reads
    fallocate(&*index, FallocateFlags::FALLOC_FL_KEEP_SIZE, 0, RESERVED_BYTES)
        .map_err(|error| full(error.to_string()))
}

/// The disk of a database, if its blocks are smaller than a page of memory.
fn with_small_blocks(database: &Path) -> Option<Statvfs> {
    let folder = database.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    statvfs(folder).ok().filter(|disk| disk.fragment_size() < PAGE_BYTES)
}

/// Free bytes on the disk of a file for this user; `None` if the system does not report them.
pub(super) fn free_bytes_beside(file: &Path) -> Option<u64> {
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let disk = statvfs(folder).ok()?;
    Some(disk.blocks_available().saturating_mul(disk.fragment_size()))
}
