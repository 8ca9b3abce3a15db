//! Moves a stored export to another folder: it is copied, synced and read again before its source is removed.
//!
//! Only this module removes a source. An interruption at any point is harmless: a copy with a temporary name is
//! deleted, and a copy with its final name is found when the source is processed again.

use std::borrow::Cow;
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::{fs, io};

use super::durable::sync_names;
use super::tail::mark_of;
use crate::bytes::fingerprint::{HashingReader, fingerprint, id_of, regular_file};
use armwatch_model::run::ContentHash;
use armwatch_model::text;

/// Folder of incomplete copies, inside the archive.
const PARTIAL: &str = ".partial";

/// Names tried for exports with the same name and other content.
const MOST_NAMES: usize = 3;

/// Digits of the hash that distinguish exports with the same name, times the number of the attempt.
const DIGITS: usize = 8;

/// The result for a source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Archived {
    /// It is now only at this path.
    At(PathBuf),
    /// Its content differs from the stored one, or it changed in the meantime: it stays.
    Changed,
}

/// Moves the export at `source`, which has the content `content`, to `archive`, below the sub-folder `below`. A file
/// with this name and another content is unchanged: the export's name then contains the beginning of its hash.
///
/// # Errors
/// Those of the file system; the source still exists then.
pub fn archive(source: &Path, content: &ContentHash, archive: &Path, below: &Path) -> io::Result<Archived> {
    let before = regular_file(source)?.metadata()?;
    // absolute, or the folder around the archive could have no name
    let archive = &std::path::absolute(archive)?;
    let folder = archive.join(below);
    fs::create_dir_all(&folder)?;
    let name = source.file_name().unwrap_or_default();
    let Some(target) = place(&folder, name, content, |partial| copy(source, partial, content), archive)?
    else {
        return Ok(Archived::Changed);
    };
    // data written to the source since it was read must not be lost
    let now = fs::metadata(source)?;
    let is_same = id_of(&now) == id_of(&before)
        && now.len() == before.len()
        && now.modified().ok() == before.modified().ok()
        && fingerprint(source)?.0 == *content;
    if !is_same {
        return Ok(Archived::Changed);
    }
    fs::remove_file(source)?;
    remove_mark(source)?;
    if let Some(parent) = source.parent() {
        File::open(parent)?.sync_all()?;
    }
    Ok(Archived::At(target))
}

/// Finds or makes the copy in `folder`; `None` if `copy` reports that the source has another content.
fn place(
    folder: &Path,
    name: &OsStr,
    content: &ContentHash,
    copy: impl Fn(&Path) -> io::Result<bool>,
    archive: &Path,
) -> io::Result<Option<PathBuf>> {
    for attempt in 0..MOST_NAMES {
        let target = folder.join(name_of(name, content, attempt));
        match fingerprint(&target) {
            // left by an attempt that was interrupted before the source was removed, or by a copy of it
            Ok((found, _)) if found == *content => {
                File::open(&target)?.sync_all()?;
                // the attempt may have been interrupted before it synced the name
                sync_names(folder)?;
                return Ok(Some(target));
            }
            Ok(_) => continue,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        fs::create_dir_all(archive.join(PARTIAL))?;
        let partial = archive.join(PARTIAL).join(content.to_string());
        if !copy(&partial)? {
            fs::remove_file(&partial)?;
            return Ok(None);
        }
        fs::rename(&partial, &target)?;
        sync_names(folder)?;
        return Ok(Some(target));
    }
    let taken = format!("{} has other contents under every name tried", text::of_path(folder));
    Err(io::Error::new(io::ErrorKind::AlreadyExists, taken))
}

/// Copies and syncs, and reads the copy again; returns true if it has the content.
fn copy(source: &Path, partial: &Path, content: &ContentHash) -> io::Result<bool> {
    let original = regular_file(source)?;
    let modified = original.metadata()?.modified();
    let (mut reader, hash) = HashingReader::new(original);
    let mut file = File::create(partial)?;
    io::copy(&mut reader, &mut file)?;
    if let Ok(modified) = modified {
        // the start of a recording may depend on it
        file.set_modified(modified)?;
    }
    file.sync_all()?;
    drop(file);
    Ok(hash.so_far().0 == *content && fingerprint(partial)?.0 == *content)
}

/// The name unchanged, then with more and more of the hash before its endings.
fn name_of(name: &OsStr, content: &ContentHash, attempt: usize) -> OsString {
    if attempt == 0 {
        return name.to_owned();
    }
    let name = text::of_bytes(name.as_bytes());
    let stem_end = name.to_ascii_lowercase().rfind(".csv").unwrap_or(name.len());
    let (stem, endings) = name.split_at(stem_end);
    let hash: String = content.to_string().chars().take(DIGITS * attempt).collect();
    OsString::from_vec(text::to_bytes(&format!("{stem}~{hash}{endings}")))
}

/// The name of an export without the additions of [`archive`].
pub fn original_name(name: &str) -> Cow<'_, str> {
    let stem_end = name.to_ascii_lowercase().rfind(".csv").unwrap_or(name.len());
    let (stem, endings) = name.split_at(stem_end);
    let is_hash = |text: &str| {
        (1..MOST_NAMES).any(|attempt| text.len() == DIGITS * attempt)
            && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
    };
    match stem.rsplit_once('~') {
        Some((original, hash)) if is_hash(hash) => Cow::Owned(format!("{original}{endings}")),
        _ => Cow::Borrowed(name),
    }
}

/// Removes the mark of the source's completion.
fn remove_mark(source: &Path) -> io::Result<()> {
    match fs::remove_file(mark_of(source)) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bytes::fingerprint::of_bytes;

    const NAME: &str = "R00_20260105_0847.csv.gz";

    struct ArchiveFolders(tempfile::TempDir);

    impl ArchiveFolders {
        fn new() -> Self {
            let folders = Self(tempfile::tempdir().unwrap());
            fs::create_dir_all(folders.path("inbox")).unwrap();
            folders
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.path().join(name)
        }

        fn source(&self, bytes: &[u8]) -> PathBuf {
            let path = self.path("inbox").join(NAME);
            fs::write(&path, bytes).unwrap();
            path
        }

        fn archive(&self, source: &Path, content: &[u8]) -> io::Result<Archived> {
            archive(source, &of_bytes(content), &self.path("archive"), Path::new("line 1"))
        }

        fn target(&self) -> PathBuf {
            self.path("archive/line 1").join(NAME)
        }
    }

    #[test]
    fn a_source_is_moved_with_its_time_and_its_mark_goes() {
        let folders = ArchiveFolders::new();
        let source = folders.source(b"one");
        let modified = fs::metadata(&source).unwrap().modified().unwrap();
        fs::write(folders.path(&format!("inbox/{NAME}.done")), "").unwrap();
        assert_eq!(folders.archive(&source, b"one").unwrap(), Archived::At(folders.target()));
        assert_eq!(fs::read(folders.target()).unwrap(), b"one");
        assert_eq!(fs::metadata(folders.target()).unwrap().modified().unwrap(), modified);
        assert_eq!(fs::read_dir(folders.path("inbox")).unwrap().count(), 0);
        assert_eq!(fs::read_dir(folders.path("archive/.partial")).unwrap().count(), 0);
    }

    #[test]
    fn cut_short_anywhere_it_is_begun_again() {
        let folders = ArchiveFolders::new();
        // during the copy
        fs::create_dir_all(folders.path("archive/.partial")).unwrap();
        let half = folders.path("archive/.partial").join(of_bytes(b"one").to_string());
        fs::write(&half, b"on").unwrap();
        let source = folders.source(b"one");
        assert_eq!(folders.archive(&source, b"one").unwrap(), Archived::At(folders.target()));
        assert!(!half.exists());
        // between copy and removal
        let source = folders.source(b"one");
        assert_eq!(folders.archive(&source, b"one").unwrap(), Archived::At(folders.target()));
        assert!(!source.exists());
        assert_eq!(fs::read_dir(folders.path("archive/line 1")).unwrap().count(), 1);
    }

    #[test]
    fn another_content_of_the_name_is_left_alone() {
        let folders = ArchiveFolders::new();
        folders.archive(&folders.source(b"one"), b"one").unwrap();
        let Archived::At(second) = folders.archive(&folders.source(b"two"), b"two").unwrap() else {
            panic!("it was not moved")
        };
        assert_eq!(original_name(&second.file_name().unwrap().to_string_lossy()), NAME);
        for name in [NAME, "R00~left_20260105_0847.csv", "R00~1a2b3c4.csv", "R00~1A2B3C4D.csv", "~"] {
            assert_eq!(original_name(name), name);
        }
        let begin = &of_bytes(b"two").to_string()[..8];
        assert_eq!(second, folders.path(&format!("archive/line 1/R00_20260105_0847~{begin}.csv.gz")));
        assert_eq!(
            (fs::read(folders.target()).unwrap(), fs::read(second).unwrap()),
            (b"one".into(), b"two".into())
        );
    }

    #[test]
    fn a_source_that_is_not_what_was_stored_stays() {
        let folders = ArchiveFolders::new();
        let source = folders.source(b"one and more");
        assert_eq!(folders.archive(&source, b"one").unwrap(), Archived::Changed);
        assert_eq!(fs::read(&source).unwrap(), b"one and more");
        assert!(!folders.target().exists());
        // the copy exists from before; the source has grown since
        folders.archive(&folders.source(b"one"), b"one").unwrap();
        let source = folders.source(b"one and more");
        assert_eq!(folders.archive(&source, b"one").unwrap(), Archived::Changed);
        assert!(source.exists());
    }

    #[test]
    fn other_file_systems_and_folders_that_cannot_be_written_are_no_danger() {
        let folders = ArchiveFolders::new();
        let source = folders.source(b"one");
        fs::write(folders.path("archive"), "a file").unwrap();
        assert!(folders.archive(&source, b"one").is_err());
        assert!(source.exists());
        // memory, on most machines another file system
        let Ok(elsewhere) = tempfile::tempdir_in("/dev/shm") else { return };
        let moved = archive(&source, &of_bytes(b"one"), elsewhere.path(), Path::new("")).unwrap();
        assert_eq!(moved, Archived::At(elsewhere.path().join(NAME)));
        assert!(!source.exists());
    }
}
