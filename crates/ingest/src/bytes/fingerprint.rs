//! Content identity: the same export is one run, whatever its name.

use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use super::access::{GuardedFile, asking, refuse_outside};
use super::parts;
use super::trace::companions;
use armwatch_model::run::{ContentHash, ContentPrefix, FileId};

/// BLAKE3 hash and number of bytes of the file as it is on disk (compressed or not), including its companion files. For
/// several parts it is the hash of their hashes.
///
/// Reads in pieces; memory does not grow with the file.
///
/// # Errors
/// Those of opening or reading; [`io::ErrorKind::InvalidInput`] for anything except a regular file, since a pipe would
/// block for ever.
pub fn fingerprint(path: &Path) -> io::Result<(ContentHash, u64)> {
    let of_file = |file: &PathBuf| hash_up_to(file, u64::MAX);
    Ok(joined(&parts::files(path).iter().map(of_file).collect::<io::Result<Vec<_>>>()?))
}

fn hash_up_to(path: &Path, bytes: u64) -> io::Result<(ContentHash, u64)> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(GuardedFile(regular_file(path)?).take(bytes))?;
    // an export of several files is always read completely
    if bytes == u64::MAX {
        for companion in companions(path) {
            hasher.update_reader(GuardedFile(regular_file(&companion)?))?;
        }
    }
    Ok(identity(&hasher))
}

/// The bytes of a file and their identity; `None` if there are more than `most`.
pub fn content(path: &Path, most: u64) -> io::Result<Option<(Vec<u8>, ContentHash)>> {
    let mut bytes = Vec::new();
    let file = GuardedFile(regular_file(path)?);
    let length = file.take(most.saturating_add(1)).read_to_end(&mut bytes)? as u64;
    let hash = of_bytes(&bytes);
    Ok((length <= most).then_some((bytes, hash)))
}

/// The identity of parts that follow each other. Those without bytes count for nothing, so that a prefix of the parts has
/// the identity that it had when it was all there was.
fn joined(parts: &[(ContentHash, u64)]) -> (ContentHash, u64) {
    let mut some = parts.iter().filter(|(_, bytes)| *bytes > 0);
    let bytes = parts.iter().map(|(_, bytes)| bytes).sum();
    let hash = match (some.next(), some.next()) {
        (None, _) => of_bytes(b""),
        (Some((only, _)), None) => *only,
        _ => {
            let mut hasher = blake3::Hasher::new();
            parts.iter().filter(|(_, bytes)| *bytes > 0).for_each(|(hash, _)| {
                hasher.update(&hash.0);
            });
            identity(&hasher).0
        }
    };
    (hash, bytes)
}

/// The first `bytes` bytes of a file; `None` if it has fewer.
///
/// # Errors
/// Those of [`fingerprint`].
pub fn prefix(path: &Path, bytes: u64) -> io::Result<Option<ContentPrefix>> {
    let (mut found, mut left) = (Vec::new(), bytes);
    for file in parts::files(path) {
        let part = hash_up_to(&file, left)?;
        left -= part.1;
        found.push(part);
        if left == 0 {
            break;
        }
    }
    let (hash, read) = joined(&found);
    Ok((read == bytes).then_some(ContentPrefix { bytes, hash }))
}

/// The empty prefix, with which every file begins.
pub fn nothing() -> ContentPrefix {
    ContentPrefix { bytes: 0, hash: of_bytes(b"") }
}

/// Number of the file of `metadata`.
pub fn id_of(metadata: &std::fs::Metadata) -> FileId {
    FileId { device: metadata.dev(), inode: metadata.ino() }
}

/// A time that differs after each write to a file and each other change of it. It is the change time, which only the
/// file system sets. Copies and people may set a later modification time; that is added as a fraction of a second, so
/// that neither time hides the other and a wrong date does no harm. On a file system without these times, only the size
/// shows a change.
pub fn changed_at(metadata: &std::fs::Metadata) -> SystemTime {
    let modified = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
    let (Ok(seconds), Ok(nanoseconds)) = (metadata.ctime().try_into(), metadata.ctime_nsec().try_into())
    else {
        return modified;
    };
    let changed = SystemTime::UNIX_EPOCH + Duration::new(seconds, nanoseconds);
    if modified <= changed {
        return changed;
    }
    // a database stores microseconds
    let chosen = i128::from(metadata.mtime()) * 7_919 + i128::from(metadata.mtime_nsec() / 1000);
    changed + Duration::from_micros(u64::try_from(chosen.rem_euclid(1_000_000)).unwrap_or_default() + 1)
}

/// Bytes of an export and the time of its last change, see [`changed_at`], with those of the files that belong to it.
pub fn extent(path: &Path, metadata: &std::fs::Metadata) -> (u64, SystemTime) {
    let files = companions(path).into_iter().filter_map(|companion| std::fs::metadata(companion).ok());
    files.fold((metadata.len(), changed_at(metadata)), |(bytes, changed), of| {
        (bytes + of.len(), changed.max(changed_at(&of)))
    })
}

/// Identity of a few bytes that represent a file with unreadable content.
pub fn of_bytes(bytes: &[u8]) -> ContentHash {
    ContentHash(*blake3::hash(bytes).as_bytes())
}

/// Opens `path` for reading if it is a regular file or a symbolic link to one that the current
/// [`FileAccess`](super::access::FileAccess) permits.
///
/// # Errors
/// Those of [`fingerprint`].
pub(crate) fn regular_file(path: &Path) -> io::Result<File> {
    // Checked before opening, since opening a pipe waits for its writer; and after, since another file may have taken
    // the name in between.
    asking(|| {
        refuse_special(&std::fs::metadata(path)?)?;
        let file = File::open(path)?;
        refuse_special(&file.metadata()?)?;
        refuse_outside(&file, path)?;
        Ok(file)
    })
}

/// Hashes bytes on their way, so that the read that parses a file also hashes it.
#[derive(Debug)]
pub struct HashingReader<R> {
    inner: R,
    hash: Arc<Mutex<blake3::Hasher>>,
}

impl<R: Read> HashingReader<R> {
    /// Wraps `inner`; the second value gives the hash of the bytes read so far.
    pub fn new(inner: R) -> (Self, RunningHash) {
        let hash = Arc::<Mutex<blake3::Hasher>>::default();
        (Self { inner, hash: Arc::clone(&hash) }, RunningHash(Arc::new(Mutex::new(vec![hash]))))
    }
}

impl<R: Read> Read for HashingReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = asking(|| self.inner.read(buffer))?;
        if let Some(read) = buffer.get(..count) {
            self.hash.lock().unwrap_or_else(PoisonError::into_inner).update(read);
        }
        Ok(count)
    }
}

/// Hash of the bytes that a [`HashingReader`], or one for each part, has read so far. Equal to [`fingerprint`] once the
/// readers are at their ends, unless a file changed in the meantime.
#[derive(Debug, Clone)]
pub struct RunningHash(Arc<Mutex<Vec<Arc<Mutex<blake3::Hasher>>>>>);

impl RunningHash {
    /// Hash and number of bytes so far.
    pub fn so_far(&self) -> (ContentHash, u64) {
        let readers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let of_part =
            |of: &Arc<Mutex<blake3::Hasher>>| identity(&of.lock().unwrap_or_else(PoisonError::into_inner));
        joined(&readers.iter().map(of_part).collect::<Vec<_>>())
    }

    /// The bytes read so far, as the beginning of a content.
    pub fn prefix(&self) -> ContentPrefix {
        let (hash, bytes) = self.so_far();
        ContentPrefix { bytes, hash }
    }

    /// Number of bytes so far.
    pub fn bytes(&self) -> u64 {
        let readers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        readers.iter().map(|of| of.lock().unwrap_or_else(PoisonError::into_inner).count()).sum()
    }

    /// Includes the bytes of the next part's reader too.
    pub(crate) fn follow_with(&self, next: &Self) {
        let next = next.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(next);
    }
}

fn identity(hasher: &blake3::Hasher) -> (ContentHash, u64) {
    (ContentHash(*hasher.finalize().as_bytes()), hasher.count())
}

fn refuse_special(metadata: &std::fs::Metadata) -> io::Result<()> {
    if metadata.is_file() {
        return Ok(());
    }
    let what = if metadata.is_dir() { "a folder" } else { "a special file (pipe, socket or device)" };
    Err(io::Error::new(io::ErrorKind::InvalidInput, format!("{what}, not a regular file")))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BLAKE3 of the empty input, from the algorithm's published test vectors.
    const EMPTY: &str = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";

    #[test]
    fn names_do_not_matter_and_bytes_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::write(path("a.csv"), "time\n1\n").unwrap();
        std::fs::write(path("b.csv"), "time\n1\n").unwrap();
        std::fs::write(path("c.csv"), "time\n2\n").unwrap();
        std::fs::write(path("empty.csv"), "").unwrap();
        let print = |name: &str| fingerprint(&path(name)).unwrap();
        assert_eq!(print("a.csv"), print("b.csv"));
        assert_ne!(print("a.csv").0, print("c.csv").0);
        assert_eq!(print("a.csv").1, 7);
        assert_eq!((print("empty.csv").0.to_string(), print("empty.csv").1), (EMPTY.to_owned(), 0));
    }

    #[test]
    fn hash_on_the_side_is_the_hash_of_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "0123456789".repeat(100_000)).unwrap();
        let (mut reader, hash) = HashingReader::new(File::open(&path).unwrap());
        std::io::copy(&mut reader.by_ref().take(77), &mut std::io::sink()).unwrap();
        assert_ne!(hash.so_far(), fingerprint(&path).unwrap());
        std::io::copy(&mut reader, &mut std::io::sink()).unwrap();
        assert_eq!(hash.so_far(), fingerprint(&path).unwrap());
    }

    #[test]
    fn a_prefix_is_the_file_that_was_shorter() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "time\n1\n").unwrap();
        let (hash, bytes) = fingerprint(&path).unwrap();
        let shorter = ContentPrefix { bytes, hash };
        std::fs::write(&path, "time\n1\n2\n").unwrap();
        assert_eq!(prefix(&path, 7).unwrap(), Some(shorter));
        assert_ne!(prefix(&path, 8).unwrap().map(|p| p.hash), Some(hash));
        assert_eq!(prefix(&path, 10).unwrap(), None);
        assert_eq!(prefix(&path, 0).unwrap(), Some(nothing()));
    }

    /// Imitates `cp -p` and `rsync -t`.
    #[test]
    fn a_file_that_takes_the_time_of_another_has_changed_all_the_same() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let long_ago = SystemTime::UNIX_EPOCH + Duration::from_secs(1_700_000_000);
        let written = |text: &str| {
            std::fs::write(&path, text).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(long_ago).unwrap();
            let metadata = std::fs::metadata(&path).unwrap();
            assert_eq!(metadata.modified().unwrap(), long_ago);
            changed_at(&metadata)
        };
        let first = written("1");
        // the clock of a file system has a resolution of milliseconds
        let patience = SystemTime::now() + Duration::from_secs(10);
        while written("2") == first {
            assert!(SystemTime::now() < patience, "its time of change stands still");
        }
    }

    /// Modification times are set by copies, wrong clocks, and people.
    #[test]
    fn a_file_with_any_time_of_modification_changes_when_it_is_written_and_when_it_is_touched() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "1").unwrap();
        let at = |seconds: i64| {
            let far = Duration::from_secs(seconds.unsigned_abs());
            if seconds < 0 { SystemTime::UNIX_EPOCH - far } else { SystemTime::UNIX_EPOCH + far }
        };
        // 1901, 1970, 2030, 2030 and a second, 2446
        for seconds in [-2_147_483_648, 0, 1_893_456_000, 1_893_456_001, 15_032_385_535] {
            let written = |text: &str, modified: SystemTime| {
                std::fs::write(&path, text).unwrap();
                File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
                changed_at(&std::fs::metadata(&path).unwrap())
            };
            let first = written("1", at(seconds));
            let near = SystemTime::now() + Duration::from_secs(5);
            assert!(first < near, "{seconds} moves it to {first:?}");
            let patience = SystemTime::now() + Duration::from_secs(10);
            while written("2", at(seconds)) == first {
                assert!(SystemTime::now() < patience, "{seconds}: a corrected file is not seen");
            }
            let second = changed_at(&std::fs::metadata(&path).unwrap());
            while written("2", at(seconds + 1)) == second {
                assert!(SystemTime::now() < patience, "{seconds}: another time is not seen");
            }
        }
    }

    #[test]
    fn a_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = fingerprint(folder.path()).unwrap_err();
        assert_eq!(error.to_string(), "a folder, not a regular file");
        assert!(fingerprint(&folder.path().join("none")).is_err());
    }
}
