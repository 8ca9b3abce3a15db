//! An unfinished copy of a database: its name, its final place, and its removal if its writer was killed.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

use jiff::Timestamp;
use nix::unistd::geteuid;

/// End of a copy's name until the copy is complete.
const PARTIAL: &str = ".partial";

/// Ends of the names of files that SQLite writes next to a database.
const BESIDE: [&str; 3] = ["-journal", "-wal", "-shm"];

/// First bytes of each database of SQLite.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";

/// Age after which a copy is removed although its writer is unknown: one on another machine, or before a restart.
const ABANDONED: Duration = Duration::from_secs(86_400);

/// Time of this process's first use of a copy, ns since 1970.
static STARTED: LazyLock<i128> = LazyLock::new(|| Timestamp::now().as_nanosecond());

/// Identity of this machine since its start, and of the name space of its process numbers.
static MACHINE: LazyLock<String> = LazyLock::new(|| {
    let boot = std::fs::read("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let space = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
    let mut of = blake3::Hasher::new();
    of.update(&boot).update(space.as_os_str().as_encoded_bytes());
    let name = of.finalize().to_hex();
    name.get(..8).unwrap_or_default().to_owned()
});

/// An unfinished copy. It is removed when it is dropped, except after [`Partial::place`].
#[derive(Debug)]
pub(super) struct Partial {
    path: PathBuf,
    target: PathBuf,
}

impl Partial {
    /// A copy next to `target`. The folder is created if it is missing, and copies of killed writers in it are removed.
    /// Each writer has a separate file.
    pub(super) fn of(target: &Path) -> io::Result<Self> {
        std::fs::create_dir_all(folder_of(target))?;
        remove_left(target);
        let started = *STARTED;
        let now = Timestamp::now().as_nanosecond().max(started);
        let mut path = target.as_os_str().to_owned();
        path.push(format!(".{}-{}-{now}{PARTIAL}", *MACHINE, std::process::id()));
        Ok(Self { path: path.into(), target: target.to_owned() })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Gives the copy its final name, so that a reader sees either the earlier copy or this one. Returns its size,
    /// bytes.
    pub(super) fn place(self) -> io::Result<u64> {
        let file = File::open(&self.path)?;
        file.sync_all()?;
        let bytes = file.metadata()?.len();
        std::fs::rename(&self.path, &self.target)?;
        File::open(folder_of(&self.target))?.sync_all()?;
        Ok(bytes)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        remove_with_files_beside(&self.path);
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Ignores errors: a file may belong to another user, or be removed already.
fn remove_with_files_beside(partial: &Path) {
    let _ = std::fs::remove_file(partial);
    for end in BESIDE {
        let mut beside = partial.as_os_str().to_owned();
        beside.push(end);
        let _ = std::fs::remove_file(Path::new(&beside));
    }
}

/// Removes unfinished copies of any name in the folder of `target` if their writers have ended.
pub(super) fn remove_left(target: &Path) {
    let folder = folder_of(target);
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(partial) = partial_in(&name, target.file_name()) else { continue };
        // another process may have removed it
        let Ok(metadata) = entry.metadata() else { continue };
        let is_old = metadata.modified().is_ok_and(|at| at.elapsed().is_ok_and(|age| age > ABANDONED));
        // a service may not see the processes of other users
        let sees_writer = geteuid().is_root() || metadata.uid() == geteuid().as_raw();
        let is_left = match partial.writer {
            CopyWriter::Gone => sees_writer || is_old,
            CopyWriter::AtWork => false,
            CopyWriter::Unknown => is_old,
        };
        let partial = folder.join(partial.name);
        if is_left && metadata.is_file() && may_be_ours(&partial) {
            remove_with_files_beside(&partial);
        }
    }
}

/// A name that this program gives to unfinished copies.
struct Named<'n> {
    /// Without an end of [`BESIDE`].
    name: &'n str,
    writer: CopyWriter,
}

#[derive(Debug, PartialEq, Eq)]
enum CopyWriter {
    AtWork,
    Gone,
    Unknown,
}

/// The copy that a file belongs to; `None` for any other file.
fn partial_in<'n>(file: &'n OsStr, target: Option<&OsStr>) -> Option<Named<'n>> {
    let file = file.to_str()?;
    let name = BESIDE.iter().find_map(|end| file.strip_suffix(end)).unwrap_or(file);
    let rest = name.strip_suffix(PARTIAL)?;
    // name of the first version
    if Some(OsStr::new(rest)) == target {
        return Some(Named { name, writer: CopyWriter::Unknown });
    }
    let (copy, mark) = rest.rsplit_once('.')?;
    let marks: Vec<&str> = mark.split('-').collect();
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|of| of.is_ascii_digit());
    let writer = match marks[..] {
        [machine, process, at] if is_number(process) && is_number(at) && is_machine(machine) => {
            match machine == *MACHINE {
                true => writer_of(process, at.parse().ok()?),
                false => CopyWriter::Unknown,
            }
        }
        [process, at] if is_number(process) && is_number(at) => CopyWriter::Unknown,
        _ => return None,
    };
    (!copy.is_empty()).then_some(Named { name, writer })
}

fn is_machine(text: &str) -> bool {
    text.len() == MACHINE.len() && text.bytes().all(|of| of.is_ascii_hexdigit())
}

fn writer_of(process: &str, at: i128) -> CopyWriter {
    if process == std::process::id().to_string() {
        // an earlier process had the same number
        return if at < *STARTED { CopyWriter::Gone } else { CopyWriter::AtWork };
    }
    match Path::new("/proc/self").exists() {
        true if Path::new("/proc").join(process).exists() => CopyWriter::Unknown,
        true => CopyWriter::Gone,
        false => CopyWriter::Unknown,
    }
}

/// True if a file begins as a database, or has no content yet.
fn may_be_ours(file: &Path) -> bool {
    let mut begin = Vec::new();
    match File::open(file).and_then(|opened| opened.take(MAGIC.len() as u64).read_to_end(&mut begin)) {
        Ok(_) => begin == MAGIC || begin.iter().all(|byte| *byte == 0),
        // only files next to it are left
        Err(error) => error.kind() == ErrorKind::NotFound,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_are_told_from_files_of_users_and_by_their_writers() {
        let _ = *STARTED;
        let (machine, own) = (&*MACHINE, std::process::id());
        let later = *STARTED + 1;
        // no process has a number above the highest that Linux assigns
        let gone = 1 << 30;
        let target = Some(OsStr::new("copy.db"));
        for (name, writer) in [
            (format!("other.db.{machine}-{own}-{later}.partial"), Some(CopyWriter::AtWork)),
            (format!("other.db.{machine}-{own}-7.partial-journal"), Some(CopyWriter::Gone)),
            (format!("other.db.{machine}-{gone}-{later}.partial-wal"), Some(CopyWriter::Gone)),
            (format!("other.db.{machine}-1-{later}.partial"), Some(CopyWriter::Unknown)),
            (format!("other.db.0badcafe-{gone}-{later}.partial"), Some(CopyWriter::Unknown)),
            ("other.db.7-1789.partial".into(), Some(CopyWriter::Unknown)),
            ("copy.db.partial".into(), Some(CopyWriter::Unknown)),
            ("other.db.partial".into(), None),
            ("film.mp4.partial".into(), None),
            ("notes.2026-11.txt".into(), None),
            ("copy.db.notes.partial".into(), None),
        ] {
            let found = partial_in(OsStr::new(&name), target).map(|named| named.writer);
            assert_eq!(found, writer, "{name}");
        }
    }

    #[test]
    fn what_killed_writers_left_goes_and_what_others_write_stays() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let gone = 1 << 30;
        let of = |machine: &str, name: &str| format!("{name}.{machine}-{gone}-7.partial");
        let left = of(&MACHINE, "snapshot.db");
        std::fs::write(at(&left), MAGIC).unwrap();
        std::fs::write(at(&format!("{left}-journal")), "rollback").unwrap();
        std::fs::write(at(&format!("{}-journal", of(&MACHINE, "alone.db"))), "rollback").unwrap();
        std::fs::write(at(&of("0badcafe", "snapshot.db")), MAGIC).unwrap();
        std::fs::write(at(&of(&MACHINE, "thesis.txt")), "of a user").unwrap();
        let mine = Partial::of(&at("backup.db")).unwrap();
        std::fs::write(mine.path(), MAGIC).unwrap();
        // another copy begins while this one is being written
        drop(Partial::of(&at("other.db")).unwrap());
        let mut names: Vec<_> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        let mine = mine.path().file_name().unwrap().to_str().unwrap().to_owned();
        let mut stay = vec![mine, of("0badcafe", "snapshot.db"), of(&MACHINE, "thesis.txt")];
        stay.sort();
        assert_eq!(names, stay);
    }
}
