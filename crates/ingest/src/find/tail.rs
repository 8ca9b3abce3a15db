//! Exports that still grow: reading the written part, and detecting their end.
//!
//! An export is complete when a file of its name with the suffix `.done` exists next to it, or when its size and
//! modification time have not changed for the settle time. Closing or renaming is no evidence: many writers open and
//! close a file for every row. To decide if the part that was read is still on disk, it is read again; sizes and times
//! are not enough.

use std::fs::{File, Metadata};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

use super::settle::{Observation, Settling};
use crate::bytes::access::{asking, metadata};
use crate::bytes::fingerprint::{HashingReader, RunningHash, changed_at, id_of, regular_file};
use crate::bytes::source::{MAGIC_BYTES, is_plain};
use crate::rejection::Rejection;
use armwatch_model::run::{ContentPrefix, FileId};

/// Suffix of the file that marks an export as complete.
pub const DONE_MARK: &str = ".done";

/// Bytes per read when a content is read again for its hash.
const REREAD_BYTES: usize = 1 << 20;

/// The bytes of a file that may still grow. At their end [`Read`] returns [`ErrorKind::WouldBlock`] until the file is
/// known to be complete.
#[derive(Debug)]
pub struct Tail {
    file: Arc<File>,
    done: Arc<AtomicBool>,
}

impl Read for Tail {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.file.read(buffer)? {
            0 if !buffer.is_empty() && !self.done.load(Ordering::Acquire) => {
                Err(ErrorKind::WouldBlock.into())
            }
            count => Ok(count),
        }
    }
}

/// Result of a look at a growing file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// More may come.
    Growing,
    /// It is complete; its reader ends at the end of the file.
    Done,
    /// It has become shorter than the part that was read, or another file has replaced it.
    Rewritten,
}

/// Observes a growing file in parallel with its reader.
#[derive(Debug)]
pub struct Growth {
    path: PathBuf,
    file: Arc<File>,
    done: Arc<AtomicBool>,
    hash: RunningHash,
    settling: Option<Settling>,
}

/// A growing file, opened.
#[derive(Debug)]
pub struct Growing {
    /// Its bytes, hashed as they are read.
    pub reader: HashingReader<Tail>,
    /// Observer of its growth.
    pub growth: Growth,
}

/// Opens a file that may still grow; `None` for a compressed one, because no part of it is reliable.
///
/// # Errors
/// A rejection for a path that is not a regular file or cannot be opened.
pub fn open(path: &Path) -> Result<Option<Growing>, Rejection> {
    let file = regular_file(path).map_err(|error| Rejection::from_io(path, &error))?;
    let mut head = Vec::new();
    asking(|| (&file).take(MAGIC_BYTES).read_to_end(&mut head))
        .map_err(|error| Rejection::from_io(path, &error))?;
    if !is_plain(&head) {
        return Ok(None);
    }
    (&file).rewind().map_err(|error| Rejection::from_io(path, &error))?;
    let (file, done) = (Arc::new(file), Arc::new(AtomicBool::new(false)));
    let (reader, hash) = HashingReader::new(Tail { file: Arc::clone(&file), done: Arc::clone(&done) });
    let growth = Growth { path: path.to_owned(), file, done, hash, settling: None };
    Ok(Some(Growing { reader, growth }))
}

impl Growth {
    /// Hash of the part read so far.
    pub fn hash(&self) -> &RunningHash {
        &self.hash
    }

    /// Number of the file, its size in bytes and the time of its last change, see [`changed_at`].
    pub fn state(&self) -> io::Result<(FileId, u64, SystemTime)> {
        let metadata = asking(|| self.file.metadata())?;
        Ok((id_of(&metadata), metadata.len(), changed_at(&metadata)))
    }

    /// When the file was last written.
    pub fn written_at(&self) -> io::Result<SystemTime> {
        asking(|| self.file.metadata())?.modified()
    }

    /// Checks if the file is complete; must be called when all of it was read. The file is complete once it has not
    /// changed for `settle` over at least two looks, or has the mark.
    pub fn look(&mut self, settle: Duration, now: Instant) -> io::Result<Fate> {
        // read before the size: a writer creates it after the last row
        let marked = is_marked(&self.path);
        let metadata = asking(|| self.file.metadata())?;
        if metadata.len() < self.hash.bytes() || self.is_replaced(&metadata) {
            return Ok(Fate::Rewritten);
        }
        let seen = Observation { size: metadata.len(), modified: changed_at(&metadata), at: now };
        let settling = self.settling.map_or_else(|| Settling::first(seen), |settling| settling.again(seen));
        self.settling = Some(settling);
        let whole = metadata.len() == self.hash.bytes();
        if !whole || !(marked || settling.is_settled(settle)) {
            return Ok(Fate::Growing);
        }
        self.done.store(true, Ordering::Release);
        Ok(Fate::Done)
    }

    /// Reads the part of the file that was read before, and returns true if it is unchanged.
    ///
    /// # Errors
    /// Those of reading. The reader of this file must not be used afterwards.
    pub fn is_as_read(&self) -> io::Result<bool> {
        let read = self.read_so_far();
        (&*self.file).seek(SeekFrom::Start(0))?;
        let (mut again, hash) = HashingReader::new((&*self.file).take(read.bytes));
        let mut buffer = vec![0; REREAD_BYTES];
        while again.read(&mut buffer)? > 0 {}
        Ok(hash.prefix() == read)
    }

    /// The part read so far.
    fn read_so_far(&self) -> ContentPrefix {
        self.hash.prefix()
    }

    /// Returns true if this file is gone and another one has its name: it was replaced by a rename.
    fn is_replaced(&self, ours: &Metadata) -> bool {
        ours.nlink() == 0 && metadata(&self.path).is_ok_and(|there| id_of(&there) != id_of(ours))
    }
}

/// Path of the file with which the writer of an export marks it as done.
pub(crate) fn mark_of(path: &Path) -> PathBuf {
    let mut mark = path.as_os_str().to_owned();
    mark.push(DONE_MARK);
    mark.into()
}

/// Returns true if the writer of an export has marked it as complete, and has not written to it since: a mark of an
/// earlier export with the same name does not count.
pub fn is_marked(path: &Path) -> bool {
    // the mark is read first: a write after that makes the file newer than the mark
    let Ok(marked) = metadata(&mark_of(path)) else { return false };
    match (marked.modified(), metadata(path).and_then(|file| file.modified())) {
        (Ok(marked), Ok(written)) => written <= marked,
        // no times to compare, or a file that is renamed during reading
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;
    use crate::bytes::fingerprint::fingerprint;

    const SETTLE: Duration = Duration::from_secs(5);

    struct Scene {
        folder: tempfile::TempDir,
        writer: File,
        start: Instant,
    }

    impl Scene {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let writer = File::create(folder.path().join("a.csv")).unwrap();
            Self { folder, writer, start: Instant::now() }
        }

        fn path(&self) -> PathBuf {
            self.folder.path().join("a.csv")
        }

        fn write(&mut self, text: &str) {
            self.writer.write_all(text.as_bytes()).unwrap();
        }

        fn at(&self, seconds: u64) -> Instant {
            self.start + Duration::from_secs(seconds)
        }
    }

    fn read(growing: &mut Growing) -> (Vec<u8>, Option<ErrorKind>) {
        let mut bytes = Vec::new();
        let end = growing.reader.read_to_end(&mut bytes).err().map(|error| error.kind());
        (bytes, end)
    }

    #[test]
    fn the_end_comes_only_when_the_file_stood_still() {
        let mut scene = Scene::new();
        scene.write("time\n1");
        let mut growing = open(&scene.path()).unwrap().unwrap();
        assert_eq!(read(&mut growing), (b"time\n1".to_vec(), Some(ErrorKind::WouldBlock)));
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Growing);
        scene.write("2\n");
        assert_eq!(growing.growth.look(SETTLE, scene.at(6)).unwrap(), Fate::Growing, "it grew");
        assert_eq!(read(&mut growing), (b"2\n".to_vec(), Some(ErrorKind::WouldBlock)));
        assert_eq!(growing.growth.look(SETTLE, scene.at(11)).unwrap(), Fate::Done);
        assert_eq!(read(&mut growing), (vec![], None));
        assert!(growing.growth.is_as_read().unwrap());
        let (hash, bytes) = fingerprint(&scene.path()).unwrap();
        assert_eq!(growing.growth.read_so_far(), ContentPrefix { bytes, hash });
    }

    #[test]
    fn what_was_not_read_yet_is_not_done() {
        let mut scene = Scene::new();
        scene.write("time\n");
        let mut growing = open(&scene.path()).unwrap().unwrap();
        for at in [0, 100] {
            assert_eq!(growing.growth.look(SETTLE, scene.at(at)).unwrap(), Fate::Growing);
        }
        read(&mut growing);
        assert_eq!(growing.growth.look(SETTLE, scene.at(101)).unwrap(), Fate::Done);
    }

    #[test]
    fn a_mark_beside_it_ends_it_at_once() {
        let mut scene = Scene::new();
        scene.write("time\n");
        let mut growing = open(&scene.path()).unwrap().unwrap();
        read(&mut growing);
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Growing);
        std::fs::write(scene.folder.path().join("a.csv.done"), "").unwrap();
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Done);
    }

    #[test]
    fn a_mark_that_was_left_says_nothing_of_what_was_written_since() {
        let mut scene = Scene::new();
        let mark = scene.folder.path().join("a.csv.done");
        std::fs::write(&mark, "").unwrap();
        let earlier = SystemTime::now() - Duration::from_secs(60);
        File::options().write(true).open(&mark).unwrap().set_modified(earlier).unwrap();
        scene.write("time\n");
        assert!(!is_marked(&scene.path()));
        let mut growing = open(&scene.path()).unwrap().unwrap();
        read(&mut growing);
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Growing);
        std::fs::write(&mark, "again").unwrap();
        assert!(is_marked(&scene.path()));
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Done);
    }

    #[test]
    fn shorter_and_renamed_over_are_rewritten_and_renamed_away_is_not() {
        let mut scene = Scene::new();
        scene.write("time\n1\n");
        let mut growing = open(&scene.path()).unwrap().unwrap();
        read(&mut growing);
        let moved = scene.folder.path().join("b.csv");
        std::fs::rename(scene.path(), &moved).unwrap();
        assert_eq!(growing.growth.look(SETTLE, scene.at(0)).unwrap(), Fate::Growing);
        std::fs::rename(&moved, scene.path()).unwrap();
        scene.writer.set_len(5).unwrap();
        assert_eq!(growing.growth.look(SETTLE, scene.at(1)).unwrap(), Fate::Rewritten);
        scene.writer.set_len(7).unwrap();
        std::fs::write(&moved, "time\n1\n2\n").unwrap();
        std::fs::rename(&moved, scene.path()).unwrap();
        assert_eq!(growing.growth.look(SETTLE, scene.at(2)).unwrap(), Fate::Rewritten);
    }

    #[test]
    fn a_change_of_what_was_read_is_noticed_by_reading_again() {
        let mut scene = Scene::new();
        scene.write("time\n1\n");
        let mut growing = open(&scene.path()).unwrap().unwrap();
        read(&mut growing);
        std::fs::write(scene.path(), "time\n2\n").unwrap();
        assert!(!growing.growth.is_as_read().unwrap());
    }

    #[test]
    fn a_compressed_file_is_left_until_it_is_done() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv.gz");
        std::fs::write(&path, [0x1F, 0x8B, 8, 0]).unwrap();
        assert!(open(&path).unwrap().is_none());
        assert!(open(folder.path()).is_err());
    }
}
