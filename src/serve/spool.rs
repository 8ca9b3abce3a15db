//! The folder that uploads go to. What is not whole yet lies in a hidden folder inside it, which no scan looks
//! into, under a name made of what tells uploads apart; it survives a restart, and is renamed in when whole.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};
use std::{fs, io};

use armwatch_ingest::bytes::fingerprint::{fingerprint, of_bytes};
use armwatch_model::run::ContentHash;

/// Folder of uploads that are not whole, inside the spool: hidden, and on the same file system.
const PARTIAL: &str = ".partial";

/// An upload that was not gone on with for so long is given up. A machine that was off over a week-end, or
/// a week of holidays, still finds its own.
const STALE: Duration = Duration::from_secs(10 * 24 * 3600);

/// An upload must also have stood still for so long before this process, whose clock does not jump: a machine without
/// a battery takes the right date from the network after its start.
const STALE_HERE: Duration = Duration::from_secs(24 * 3600);

/// Uploads that are not whole at most: clients that begin and never end must not fill a disk's tables.
pub const MOST_PARTIALS: usize = 1024;

/// The folder.
#[derive(Debug, Clone, Default)]
pub struct Spool {
    folder: PathBuf,
    active: Arc<Mutex<HashSet<PathBuf>>>,
    probes: Arc<AtomicU64>,
    /// Uploads that are not whole, as they were when they changed last.
    standing: Arc<Mutex<HashMap<PathBuf, Standing>>>,
}

/// Length and time of modification of an upload, and since when it has had them.
type Standing = (u64, SystemTime, Instant);

/// An upload that is not whole, claimed by one request until it is dropped.
#[derive(Debug)]
pub struct Claim {
    path: PathBuf,
    active: Arc<Mutex<HashSet<PathBuf>>>,
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.active.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.path);
    }
}

impl Spool {
    /// Makes the folder where it is not there, and sees that it can be written to.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn open(folder: &Path) -> io::Result<Self> {
        fs::create_dir_all(folder.join(PARTIAL))?;
        let spool = Self { folder: folder.to_owned(), ..Self::default() };
        spool.probe()?;
        Ok(spool)
    }

    /// Sees that the folder can be written to.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn probe(&self) -> io::Result<()> {
        // a name of its own: two that look at once must not take each other's file away
        let number = self.probes.fetch_add(1, Ordering::Relaxed);
        let probe = self.folder.join(PARTIAL).join(format!("probe-{}-{number}", std::process::id()));
        let written = File::create(&probe).and_then(|mut file| file.write_all(b"?"));
        let removed = fs::remove_file(&probe);
        written.and(removed)
    }

    /// Claims the upload of this name and, where the client said it, content; `None` while another request
    /// writes to it.
    #[must_use]
    pub fn claim(&self, name: &str, content: Option<&ContentHash>) -> Option<Claim> {
        let path = self.partial(name, content);
        let mut active = self.active.lock().unwrap_or_else(PoisonError::into_inner);
        active.insert(path.clone()).then(|| Claim { path, active: Arc::clone(&self.active) })
    }

    /// How many bytes of an upload are there, and whether it is whole; `None` where nothing is.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn offset(&self, name: &str, content: Option<&ContentHash>) -> io::Result<Option<(u64, bool)>> {
        if let Some(bytes) = length(&self.partial(name, content))? {
            return Ok(Some((bytes, false)));
        }
        Ok(length(&self.place(name))?.map(|bytes| (bytes, true)))
    }

    /// Where the upload of this name lies when it is whole.
    #[must_use]
    pub fn place(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The content under this name, where there is one.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn content(&self, name: &str) -> io::Result<Option<ContentHash>> {
        match fingerprint(&self.place(name)) {
            Ok((hash, _)) => Ok(Some(hash)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Puts a whole upload under its name, in the place of what is there. It lasts when this returns.
    ///
    /// # Errors
    /// Those of the file system; nothing is lost then.
    pub fn put(&self, claim: &Claim, name: &str) -> io::Result<()> {
        fs::rename(&claim.path, self.place(name))?;
        File::open(&self.folder)?.sync_all()
    }

    /// Number of uploads that are not whole.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn partials(&self) -> io::Result<usize> {
        Ok(fs::read_dir(self.folder.join(PARTIAL))?.count())
    }

    /// Gives up uploads that were not gone on with for days, as of `date` and, by a clock that does not jump, `now`.
    /// Returns how many.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn remove_stale(&self, date: SystemTime, now: Instant) -> io::Result<usize> {
        let mut removed = 0;
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        let before = std::mem::take(&mut *standing);
        for entry in fs::read_dir(self.folder.join(PARTIAL))? {
            let entry = entry?;
            let metadata = entry.metadata()?;
            let (bytes, modified) = (metadata.len(), metadata.modified()?);
            let known = before.get(&entry.path()).filter(|known| (known.0, known.1) == (bytes, modified));
            let since = known.map_or(now, |known| known.2);
            standing.insert(entry.path(), (bytes, modified, since));
            let is_old = date.duration_since(modified).is_ok_and(|age| age > STALE);
            let is_stale = is_old && now.duration_since(since) >= STALE_HERE;
            let active = self.active.lock().unwrap_or_else(PoisonError::into_inner);
            if is_stale && !active.contains(&entry.path()) {
                fs::remove_file(entry.path())?;
                removed += 1;
            }
        }
        Ok(removed)
    }

    fn partial(&self, name: &str, content: Option<&ContentHash>) -> PathBuf {
        // A hash: a name of 255 bytes leaves no room for an ending. Names hold no line feed.
        let content = content.map(ToString::to_string).unwrap_or_default();
        let key = of_bytes(format!("{name}\n{content}").as_bytes());
        self.folder.join(PARTIAL).join(key.to_string())
    }
}

impl Claim {
    /// Bytes that are there.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn length(&self) -> io::Result<u64> {
        Ok(length(&self.path)?.unwrap_or(0))
    }

    /// Opens the upload to be written from its start, or to be gone on with.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn open(&self, from_start: bool) -> io::Result<File> {
        let mut options = File::options();
        options.create(true);
        if from_start { options.write(true).truncate(true) } else { options.append(true) }.open(&self.path)
    }

    /// Content and length, read from disk.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn content(&self) -> io::Result<(ContentHash, u64)> {
        fingerprint(&self.path)
    }

    /// Gives the upload up.
    pub fn remove(&self) {
        if let Err(error) = fs::remove_file(&self.path) {
            // it goes as a stale one later
            tracing::debug!(%error, "an upload that is given up stays for now");
        }
    }
}

fn length(path: &Path) -> io::Result<Option<u64>> {
    match fs::metadata(path) {
        Ok(metadata) => Ok(Some(metadata.len())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upload_is_gone_on_with_and_renamed_in() {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::open(&folder.path().join("spool")).unwrap();
        assert_eq!(spool.offset("A.csv", None).unwrap(), None);
        let claim = spool.claim("A.csv", None).unwrap();
        assert!(spool.claim("A.csv", None).is_none(), "one at a time");
        assert!(spool.claim("B.csv", None).is_some());
        claim.open(true).unwrap().write_all(b"time,").unwrap();
        drop(claim);
        // after a restart
        let spool = Spool::open(&folder.path().join("spool")).unwrap();
        assert_eq!(spool.offset("A.csv", None).unwrap(), Some((5, false)));
        assert_eq!(spool.offset("A.csv", Some(&of_bytes(b"x"))).unwrap(), None, "another content");
        let claim = spool.claim("A.csv", None).unwrap();
        claim.open(false).unwrap().write_all(b"pos_1\n").unwrap();
        assert_eq!(claim.content().unwrap(), (of_bytes(b"time,pos_1\n"), 11));
        spool.put(&claim, "A.csv").unwrap();
        assert_eq!(fs::read(spool.place("A.csv")).unwrap(), b"time,pos_1\n");
        assert_eq!(spool.offset("A.csv", None).unwrap(), Some((11, true)));
        assert_eq!(spool.partials().unwrap(), 0);
    }

    #[test]
    fn what_nobody_went_on_with_is_given_up_and_what_is_written_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::open(folder.path()).unwrap();
        drop(spool.claim("A.csv", None).unwrap().open(true).unwrap());
        let active = spool.claim("B.csv", None).unwrap();
        drop(active.open(true).unwrap());
        let (date, now) = (SystemTime::now(), Instant::now());
        assert_eq!(spool.remove_stale(date, now).unwrap(), 0);
        assert_eq!(spool.remove_stale(date + 2 * STALE, now + STALE_HERE / 2).unwrap(), 0, "the date jumped");
        assert_eq!(spool.remove_stale(date + 2 * STALE, now + STALE_HERE).unwrap(), 1);
        assert_eq!(spool.offset("B.csv", None).unwrap(), Some((0, false)));
    }

    #[test]
    fn an_upload_that_is_gone_on_with_now_and_then_is_kept_whatever_the_date() {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::open(folder.path()).unwrap();
        let (date, now) = (SystemTime::now() + 2 * STALE, Instant::now());
        for day in 0..5 {
            let mut file = spool.claim("A.csv", None).unwrap().open(false).unwrap();
            file.write_all(b"1\n").unwrap();
            assert_eq!(spool.remove_stale(date, now + day * STALE_HERE).unwrap(), 0, "{day}");
        }
    }

    #[test]
    fn looks_at_the_same_time_do_not_fail_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let spool = Spool::open(folder.path()).unwrap();
        let look = || (0..300).try_for_each(|_| spool.probe());
        std::thread::scope(|scope| {
            let looks: Vec<_> = (0..4).map(|_| scope.spawn(look)).collect();
            looks.into_iter().for_each(|look| look.join().unwrap().unwrap());
        });
        assert_eq!(spool.partials().unwrap(), 0);
    }
}
