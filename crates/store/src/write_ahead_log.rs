//! SQLite's write-ahead log, which contains commits until a checkpoint moves them into the database.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::descriptor;
use super::error::StoreError;

/// The log of a database: a file next to it.
pub(super) fn path_of(database: &Path) -> PathBuf {
    let mut log = database.as_os_str().to_owned();
    log.push("-wal");
    log.into()
}

/// The index of the log, which all programs map into memory: a file next to it.
pub(super) fn index_path_of(database: &Path) -> PathBuf {
    let mut index = database.as_os_str().to_owned();
    index.push("-shm");
    index.into()
}

/// True if the log may contain commits.
pub(super) fn has_commits(database: &Path) -> bool {
    std::fs::metadata(path_of(database)).is_ok_and(|metadata| metadata.len() > 0)
}

/// Syncs the log and its folder. Commits that are no longer in the log were moved into the database by a checkpoint,
/// which syncs.
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

/// Size of the header of a log, and of the header of each page in it, bytes (SQLite, "WAL-mode File Format").
const LOG_HEADER: usize = 32;
const FRAME_HEADER: usize = 24;

/// Frames that are searched for the first page of the database, some 10 ms.
const MOST_FRAMES: usize = 4096;

/// Attempts to read a database and its log between two writes of another program.
const LOOKS: usize = 3;

/// Refuses a database with the log of another one, as after a restore that left the old log. SQLite would move the
/// commits of that log into the database and damage it.
///
/// # Errors
/// [`StoreError::ForeignLog`], [`StoreError::NotReadable`].
pub(super) fn refuse_foreign(database: &Path) -> Result<(), StoreError> {
    match is_foreign(database) {
        Ok(false) => Ok(()),
        Ok(true) => Err(StoreError::ForeignLog { path: database.to_path_buf(), log: path_of(database) }),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        Err(error) => {
            Err(StoreError::NotReadable { path: database.to_path_buf(), detail: error.to_string() })
        }
    }
}

fn is_foreign(database: &Path) -> io::Result<bool> {
    if !has_commits(database) {
        return Ok(false);
    }
    let file = descriptor::of(database)?;
    for _ in 0..LOOKS {
        let before = DatabaseHeader::read(&file)?;
        let log = FirstCommits::read(&path_of(database))?;
        let after = DatabaseHeader::read(&file)?;
        if before == after && FirstCommits::read(&path_of(database))? == log {
            return Ok(before.zip(log).is_some_and(|(header, log)| log.is_foreign_to(&header)));
        }
    }
    // another program works with both, so they belong together
    Ok(false)
}

/// Header of a database (SQLite, "Database File Format").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct DatabaseHeader {
    page_size: u32,
    /// True if it is written through a log.
    has_log: bool,
    /// Counts changes of the first page.
    changes: u32,
}

impl DatabaseHeader {
    fn read(file: &File) -> io::Result<Option<Self>> {
        const HEADER: usize = 100;
        let mut bytes = [0; HEADER];
        match file.read_exact_at(&mut bytes, 0) {
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(None),
            read => read?,
        }
        let page_size = match u16::from_be_bytes([bytes[16], bytes[17]]) {
            1 => 1 << 16,
            size => u32::from(size),
        };
        Ok(Some(Self { page_size, has_log: bytes[18] == 2, changes: number(&bytes[24..]) }))
    }
}

/// The first commits of a log, up to the one that changes the first page of the database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FirstCommits {
    salts: [u32; 2],
    page_size: u32,
    /// Number of changes of the first page, in its first version in the log.
    changes: Option<u32>,
}

impl FirstCommits {
    /// `None` for a log without a commit, which SQLite ignores.
    fn read(log: &Path) -> io::Result<Option<Self>> {
        let mut reader = io::BufReader::with_capacity(1 << 16, File::open(log)?);
        let mut header = [0; LOG_HEADER];
        if !is_filled(&mut reader, &mut header)? {
            return Ok(None);
        }
        let [magic, page_size] = [number(&header), number(&header[8..])];
        let salts = [number(&header[16..]), number(&header[20..])];
        let is_big_endian = match magic {
            0x377f_0682 => false,
            0x377f_0683 => true,
            _ => return Ok(None),
        };
        let mut sum = Checksum { of: [0; 2], is_big_endian };
        sum.add(&header[..24]);
        if sum.of != [number(&header[24..]), number(&header[28..])] || !(512..=1 << 16).contains(&page_size) {
            return Ok(None);
        }
        let (mut frame, mut page) = ([0; FRAME_HEADER], vec![0; page_size as usize]);
        let (mut changes, mut committed) = (None, None);
        for _ in 0..MOST_FRAMES {
            if !is_filled(&mut reader, &mut frame)? || !is_filled(&mut reader, &mut page)? {
                break;
            }
            sum.add(&frame[..8]);
            sum.add(&page);
            let is_valid = [number(&frame[8..]), number(&frame[12..])] == salts
                && sum.of == [number(&frame[16..]), number(&frame[20..])];
            if !is_valid {
                break;
            }
            let [number_of_page, pages_at_commit] = [number(&frame), number(&frame[4..])];
            if number_of_page == 1 && changes.is_none() {
                changes = Some(number(&page[24..]));
            }
            if pages_at_commit > 0 {
                committed = Some(Self { salts, page_size, changes });
                if changes.is_some() {
                    break;
                }
            }
        }
        Ok(committed)
    }

    /// True if the log belongs to another database. A log begins when the one before it is in the database. Its first
    /// version of the first page is therefore at most one change ahead.
    fn is_foreign_to(&self, header: &DatabaseHeader) -> bool {
        let is_ahead = |changes: u32| changes.wrapping_sub(header.changes).cast_signed() > 1;
        !header.has_log || self.page_size != header.page_size || self.changes.is_some_and(is_ahead)
    }
}

/// Running checksum over a log (SQLite, "WAL-mode File Format", Checksum Algorithm).
struct Checksum {
    of: [u32; 2],
    is_big_endian: bool,
}

impl Checksum {
    fn add(&mut self, bytes: &[u8]) {
        let [mut first, mut second] = self.of;
        for pair in bytes.chunks_exact(8) {
            let [x, y] = [&pair[..4], &pair[4..]].map(|four| match self.is_big_endian {
                true => number(four),
                false => number(four).swap_bytes(),
            });
            first = first.wrapping_add(x).wrapping_add(second);
            second = second.wrapping_add(y).wrapping_add(first);
        }
        self.of = [first, second];
    }
}

/// The big-endian number in the first four bytes; 0 if there are fewer.
fn number(bytes: &[u8]) -> u32 {
    bytes.first_chunk().map_or(0, |four| u32::from_be_bytes(*four))
}

/// Fills `bytes`; false if the file ends before.
fn is_filled(reader: &mut impl Read, bytes: &mut [u8]) -> io::Result<bool> {
    match reader.read_exact(bytes) {
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        read => read.map(|()| true),
    }
}
