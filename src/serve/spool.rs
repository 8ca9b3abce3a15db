//! The folder that receives uploads.
//!
//! An unfinished upload is in a hidden folder inside it, which scans skip. Its file name is derived from the key of the
//! upload, so that the upload survives a restart. A finished upload is renamed into the spool.

use std::collections::HashMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};
use std::{fs, io};

use tempfile::TempDir;

use super::reserve::Reserve;
use armwatch_ingest::bytes::fingerprint::{fingerprint, of_bytes};
use armwatch_ingest::find::durable::sync_names;
use armwatch_model::run::ContentHash;

/// Folder of unfinished uploads inside the spool: hidden, and on the same file system.
const PARTIAL: &str = ".partial";

/// Beginning of the names of files and folders for a check in [`PARTIAL`].
const PROBE: &str = "probe-";

/// An upload that its client has not continued for this time is deleted. A machine that was off over a weekend or a
/// week of holidays still finds its own uploads.
const STALE: Duration = Duration::from_secs(10 * 24 * 3600);

/// An upload must also have been unchanged for this time during this process. Its clock does not jump, but a machine
/// without a battery gets the correct date from the network only after its start.
const STALE_HERE: Duration = Duration::from_secs(24 * 3600);

/// While space is short, an upload that its client has not continued for this time is deleted. Its client must start
/// again. Without space, no client could upload anything.
const STALE_WHEN_SHORT: Duration = Duration::from_secs(3600);

/// Largest number of unfinished uploads. Clients that start uploads and never finish them must not fill the tables of a
/// disk.
const MOST_PARTIALS: usize = 1024;

/// Share of one client. A client that starts uploads and never finishes them loses only its own uploads.
const MOST_PARTIALS_OF_ONE: usize = MOST_PARTIALS / 4;

/// Bytes of a file that are written before the reserve is checked again.
const CHECK_INTERVAL_BYTES: usize = 4 << 20;

/// The folder of uploads.
#[derive(Debug, Clone)]
pub struct Spool {
    folder: PathBuf,
    reserve: Arc<Reserve>,
    /// Uploads that a request writes to, by key, with their clients.
    active: Arc<Mutex<HashMap<String, String>>>,
    /// Most uploads of one client that are written at once.
    most_of_one: usize,
    probes: Arc<AtomicU64>,
    /// State of each unfinished upload at its latest known change, by path.
    standing: Arc<Mutex<HashMap<PathBuf, UploadAge>>>,
}

/// Length and modification time of an upload, and the instant of their latest change.
type UploadAge = (u64, SystemTime, Instant);

/// An unfinished upload. Its file is named `KEY.TOTAL.CLIENT`, so that total and client survive a restart. Earlier
/// versions named it `KEY`.
#[derive(Debug)]
struct PartialUpload {
    path: PathBuf,
    /// The hash of name and content.
    key: String,
    /// Bytes of the whole export, if a request gave them.
    total: Option<u64>,
    /// The client that sent the latest part.
    client: String,
    /// Bytes that have arrived.
    bytes: u64,
    modified: SystemTime,
}

/// An unfinished upload, claimed by one request until it is dropped.
#[derive(Debug)]
pub struct Claim {
    spool: Spool,
    key: String,
    client: String,
    path: PathBuf,
    total: Option<u64>,
}

/// Reason why an upload cannot be claimed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Busy {
    /// Another request writes to it.
    Upload,
    /// Its client already writes to the largest allowed number of other uploads.
    Client,
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.spool.active().remove(&self.key);
    }
}

impl Spool {
    /// A folder on a disk with reserved free space. One client writes at most `most_of_one` uploads at once.
    pub fn new(folder: &Path, reserve: Reserve, most_of_one: usize) -> Self {
        Self {
            folder: folder.to_owned(),
            reserve: Arc::new(reserve),
            active: Arc::default(),
            most_of_one,
            probes: Arc::default(),
            standing: Arc::default(),
        }
    }

    /// Creates the folder if it is missing.
    pub fn prepare(&self) -> io::Result<()> {
        fs::create_dir_all(self.folder.join(PARTIAL))
    }

    /// Checks that uploads can be written and that the reserve is free. If it is not, deletes abandoned uploads as
    /// [`Spool::room_for`] does.
    ///
    /// # Errors
    /// Those of the file system; [`io::ErrorKind::StorageFull`] if the reserve is not free.
    pub fn check(&self) -> io::Result<()> {
        self.prepare()?;
        self.room_for(0, SystemTime::now())?;
        self.probe()
    }

    /// Checks that the folder can be written to.
    pub fn probe(&self) -> io::Result<()> {
        // a unique name, so that two checks at once do not delete each other's file
        let number = self.probes.fetch_add(1, Ordering::Relaxed);
        let probe = self.folder.join(PARTIAL).join(format!("{PROBE}{}-{number}", std::process::id()));
        let written = File::create(&probe).and_then(|mut file| file.write_all(b"?"));
        let removed = fs::remove_file(&probe);
        written.and(removed)
    }

    /// Checks that the reserve stays free after `bytes` more bytes. Otherwise deletes uploads that their clients have
    /// not continued for an hour as of `date`, the oldest first. For 0 bytes it deletes as many as there are, otherwise
    /// only if they free enough space.
    ///
    /// # Errors
    /// [`io::ErrorKind::StorageFull`] without space, otherwise those of the file system.
    pub fn room_for(&self, bytes: u64, date: SystemTime) -> io::Result<()> {
        let Some(short) = self.reserve.shortage(bytes)? else { return Ok(()) };
        let mut idle = self.partials()?;
        idle.retain(|partial| partial.age(date) > STALE_WHEN_SHORT);
        idle.sort_by_key(|partial| partial.modified);
        if idle.iter().map(|partial| partial.bytes).sum::<u64>() < short.bytes && bytes > 0 {
            return Err(short.into());
        }
        for partial in idle {
            if self.give_up(&partial)? {
                tracing::warn!(
                    "deleted an unfinished upload of more than an hour ago, because space is short"
                );
            }
            if self.reserve.shortage(bytes)?.is_none() {
                return Ok(());
            }
        }
        self.reserve.shortage(bytes)?.map_or(Ok(()), |short| Err(short.into()))
    }

    /// Claims the upload with this name and, if the client gave it, this content.
    ///
    /// # Errors
    /// [`Busy`] while another request writes to it, or its client writes to too many. In the outer result, those of the
    /// file system.
    pub fn claim(
        &self,
        name: &str,
        content: Option<&ContentHash>,
        client: &str,
    ) -> io::Result<Result<Claim, Busy>> {
        let key = key(name, content);
        let client = key_of(client).chars().take(16).collect::<String>();
        {
            let mut active = self.active();
            if active.contains_key(&key) {
                return Ok(Err(Busy::Upload));
            }
            if active.values().filter(|of| **of == client).count() >= self.most_of_one {
                return Ok(Err(Busy::Client));
            }
            active.insert(key.clone(), client.clone());
        }
        let path = self.folder.join(PARTIAL).join(&key);
        let mut claim = Claim { spool: self.clone(), key, client, path, total: None };
        if let Some(partial) = self.partial(&claim.key)? {
            (claim.path, claim.total) = (partial.path, partial.total);
        }
        Ok(Ok(claim))
    }

    /// Returns the bytes of an upload that have arrived, and true if it is complete. `None` if there is no such upload.
    pub fn offset(&self, name: &str, content: Option<&ContentHash>) -> io::Result<Option<(u64, bool)>> {
        if let Some(partial) = self.partial(&key(name, content))? {
            return Ok(Some((partial.bytes, false)));
        }
        Ok(length(&self.place(name))?.map(|bytes| (bytes, true)))
    }

    /// Path of the finished upload with this name.
    pub fn place(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Content of the finished upload with this name, if there is one.
    pub fn content(&self, name: &str) -> io::Result<Option<ContentHash>> {
        match fingerprint(&self.place(name)) {
            Ok((hash, _)) => Ok(Some(hash)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Gives a finished upload its name and replaces a file that has it. The result is durable when this returns.
    ///
    /// # Errors
    /// Those of the file system. Nothing is lost then.
    pub fn put(&self, claim: &Claim, name: &str) -> io::Result<()> {
        fs::rename(&claim.path, self.place(name))?;
        sync_names(&self.folder)
    }

    /// Deletes uploads that their clients have not continued for days, as of `date` and of `now`, a clock that does not
    /// jump. Returns their number.
    pub fn remove_stale(&self, date: SystemTime, now: Instant) -> io::Result<usize> {
        let mut removed = 0;
        let mut standing = self.standing.lock().unwrap_or_else(PoisonError::into_inner);
        let before = std::mem::take(&mut *standing);
        for partial in self.partials()? {
            let (bytes, modified) = (partial.bytes, partial.modified);
            let known = before.get(&partial.path).filter(|known| (known.0, known.1) == (bytes, modified));
            let since = known.map_or(now, |known| known.2);
            standing.insert(partial.path.clone(), (bytes, modified, since));
            if partial.age(date) > STALE
                && now.duration_since(since) >= STALE_HERE
                && self.give_up(&partial)?
            {
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Deletes idle uploads until `client` may start another one: its own oldest if it has used up its share, otherwise
    /// the oldest of the client with most uploads.
    fn make_room(&self, client: &str) -> io::Result<()> {
        loop {
            let mut partials = self.partials()?;
            let mut counts: HashMap<&str, usize> = HashMap::new();
            for partial in &partials {
                *counts.entry(&partial.client).or_default() += 1;
            }
            let crowded = if counts.get(client).is_some_and(|own| *own >= MOST_PARTIALS_OF_ONE) {
                Some(client)
            } else if partials.len() >= MOST_PARTIALS {
                counts.iter().max_by_key(|(_, count)| **count).map(|(client, _)| *client)
            } else {
                None
            };
            let Some(crowded) = crowded.map(str::to_owned) else { return Ok(()) };
            partials.retain(|partial| partial.client == crowded);
            partials.sort_by_key(|partial| partial.modified);
            let mut removed = false;
            for partial in partials {
                removed = self.give_up(&partial)?;
                if removed {
                    tracing::warn!("deleted the oldest of too many unfinished uploads");
                    break;
                }
            }
            if !removed {
                // requests still write to all of them
                return Ok(());
            }
        }
    }

    /// Deletes an upload unless a request writes to it. Returns true if no file is left.
    fn give_up(&self, partial: &PartialUpload) -> io::Result<bool> {
        // locked, so that no request claims it during the deletion
        let active = self.active();
        if active.contains_key(&partial.key) {
            return Ok(false);
        }
        match fs::remove_file(&partial.path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(true),
        }
    }

    /// Unfinished uploads.
    fn partials(&self) -> io::Result<Vec<PartialUpload>> {
        let entries = match fs::read_dir(self.folder.join(PARTIAL)) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(error),
        };
        let mut partials = Vec::new();
        for entry in entries {
            let entry = entry?;
            match entry.metadata() {
                Ok(metadata) => match PartialUpload::of(entry.path(), &metadata) {
                    Some(partial) => partials.push(partial),
                    // left by a process that was killed
                    None if is_old(&metadata) && metadata.is_dir() => drop(fs::remove_dir_all(entry.path())),
                    None if is_old(&metadata) => drop(fs::remove_file(entry.path())),
                    None => {}
                },
                // deleted or finished since the listing
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(partials)
    }

    fn partial(&self, key: &str) -> io::Result<Option<PartialUpload>> {
        Ok(self.partials()?.into_iter().find(|partial| partial.key == key))
    }

    fn active(&self) -> std::sync::MutexGuard<'_, HashMap<String, String>> {
        self.active.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns true if a probe is no longer in use.
fn is_old(probe: &fs::Metadata) -> bool {
    let age = probe.modified().ok().and_then(|modified| modified.elapsed().ok());
    age.is_some_and(|age| age > STALE_WHEN_SHORT)
}

impl PartialUpload {
    /// Parses the name of a file. Returns `None` for a probe.
    fn of(path: PathBuf, metadata: &fs::Metadata) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let mut words = name.split('.');
        let key = words.next().filter(|key| !key.starts_with(PROBE))?.to_owned();
        let total = words.next().and_then(|total| total.parse().ok());
        let client = words.next().unwrap_or_default().to_owned();
        Some(Self { path, key, total, client, bytes: metadata.len(), modified: metadata.modified().ok()? })
    }

    /// Time since the latest part as of `date`.
    fn age(&self, date: SystemTime) -> Duration {
        date.duration_since(self.modified).unwrap_or_default()
    }
}

/// Key of an upload: a hash of its name and content, because a name of 255 bytes leaves no room for an ending. Names
/// contain no line feed.
fn key(name: &str, content: Option<&ContentHash>) -> String {
    let content = content.map(ToString::to_string).unwrap_or_default();
    key_of(&format!("{name}\n{content}"))
}

fn key_of(text: &str) -> String {
    of_bytes(text.as_bytes()).to_string()
}

impl Claim {
    /// Bytes that have arrived.
    pub fn length(&self) -> io::Result<u64> {
        Ok(length(&self.path)?.unwrap_or(0))
    }

    /// Bytes of the whole export, if an earlier request gave them.
    pub fn total(&self) -> Option<u64> {
        self.total
    }

    /// Starts the upload, or continues an earlier one. `total` is the number of bytes of the whole export, if the
    /// client gives it. A continued upload keeps its earlier total.
    pub fn begin(&mut self, from_start: bool, total: Option<u64>) -> io::Result<()> {
        let is_there = length(&self.path)?.is_some();
        if !is_there {
            self.spool.make_room(&self.client)?;
        }
        self.total = if from_start { total } else { self.total.or(total) };
        let total = self.total.map_or_else(|| "-".to_owned(), |total| total.to_string());
        let name = format!("{}.{total}.{}", self.key, self.client);
        let path = self.spool.folder.join(PARTIAL).join(name);
        if is_there {
            fs::rename(&self.path, &path)?;
        }
        self.path = path;
        Ok(())
    }

    /// Opens the upload to write it from the start or to continue it.
    pub fn open(&self, from_start: bool) -> io::Result<PartialFile> {
        let mut options = File::options();
        options.create(true);
        let file = if from_start { options.write(true).truncate(true) } else { options.append(true) }
            .open(&self.path)?;
        Ok(PartialFile { file, reserve: Arc::clone(&self.spool.reserve), unchecked: 0 })
    }

    /// Moves the upload under the name of its export into a hidden folder, which is deleted when it is dropped.
    pub fn named(&self, name: &str) -> io::Result<(TempDir, PathBuf)> {
        let folder = tempfile::Builder::new().prefix(PROBE).tempdir_in(self.spool.folder.join(PARTIAL))?;
        let path = folder.path().join(name);
        fs::rename(&self.path, &path)?;
        Ok((folder, path))
    }

    /// Hash and length of the content, read from disk.
    pub fn content(&self) -> io::Result<(ContentHash, u64)> {
        fingerprint(&self.path)
    }

    /// Deletes the upload.
    pub fn remove(&self) {
        if let Err(error) = fs::remove_file(&self.path) {
            // it is deleted later as a stale one
            tracing::debug!(%error, "an upload that is given up stays for now");
        }
    }
}

/// File of an upload, which grows only while the reserve is free.
#[derive(Debug)]
pub struct PartialFile {
    file: File,
    reserve: Arc<Reserve>,
    /// Bytes since the reserve was checked.
    unchecked: usize,
}

impl PartialFile {
    /// Appends bytes.
    ///
    /// # Errors
    /// [`io::ErrorKind::StorageFull`] without space beyond the reserve, otherwise those of the file system.
    pub fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.unchecked += bytes.len();
        if self.unchecked >= CHECK_INTERVAL_BYTES {
            self.unchecked = 0;
            if let Some(short) = self.reserve.shortage(bytes.len() as u64)? {
                return Err(short.into());
            }
        }
        self.file.write_all(bytes)
    }

    /// Waits until all bytes are on disk.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
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
mod tests;
