//! The daemon's knowledge of each file between two scans, and the next files to read. It reads no clock: the time is an
//! argument.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use jiff::Timestamp;

use super::suspects::Suspects;
use armwatch_ingest::find::settle::{Observation, Settling};
use armwatch_ingest::find::watch::FoundFile;
use armwatch_model::run::FileId;

/// A file that grew again after it was complete has a slow writer: each time, the required time without change doubles,
/// up to this. Hashing the file again from its start would otherwise take more and more of the time.
const LONGEST_PATIENCE: Duration = Duration::from_secs(600);

/// Longest time between two attempts at a file that the system refuses to read.
const LONGEST_REST: Duration = Duration::from_secs(60);

/// A growing file that cannot be read further is tried again after this time, because its content may have been
/// corrected in place; the time doubles up to [`LONGEST_PATIENCE`].
const FIRST_LOOK_AGAIN: Duration = Duration::from_secs(60);
/// Age of the scan that found a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LookKind {
    /// The scan has just ended.
    Now,
    /// The scan was processed before: it has no news of the file.
    Before,
    /// The scan is old, and its folder has not answered since: reading the file would wait for it too.
    Unanswered,
}

/// A file, and the age of the scan that found it.
pub type Sighting<'f> = (&'f FoundFile, LookKind);

/// How a file that the database knows is treated when it is first seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KnownFile {
    /// It was read while it grew: reading continues at once.
    Growing,
    /// It had settled, with this size in bytes and this modification time in microseconds: if both are unchanged,
    /// reading continues at once.
    Settled(u64, i64),
    /// It has not changed since its treatment was decided: it is skipped until it changes.
    Taken,
}

/// A file to be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NextAttempt {
    /// Its path.
    pub path: PathBuf,
    /// Its latest observed state.
    pub seen: Observation,
    /// Its number.
    pub file: FileId,
    /// Time without change after which it is complete.
    pub patience: Duration,
}

/// The result of reading a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Closing {
    /// It was read after it had settled; it is skipped until it changes, or has changed in the meantime.
    Taken,
    /// It was read to its end while it grew, as far as this many bytes.
    Done(u64),
    /// It cannot be processed before it has settled.
    UntilSettled,
    /// It cannot be read further before it has settled or is corrected.
    Blocked,
    /// It must be processed again.
    Again,
    /// The system refuses to read it: it is tried again after a pause, which doubles each time.
    Unreadable,
    /// It gave its place to another growing file after this many of its bytes were read; later rows are read in its
    /// next turn.
    GaveWay(u64),
}

/// A file that was read and has not changed. A folder may contain a hundred thousand of them, so each entry is small.
#[derive(Debug)]
struct ReadFile {
    size: u64,
    modified: SystemTime,
    file: FileId,
    patience: Duration,
    /// It was complete once before.
    done: bool,
}

/// State of a file that is new or has changed since it was read.
#[derive(Debug)]
struct Entry {
    seen: Observation,
    file: FileId,
    settling: Settling,
    /// It grew since it was last read.
    grown: bool,
    /// It must settle before it is read.
    waits: bool,
    /// Or this time is reached, after repeated attempts without progress.
    looks_again_at: Option<Instant>,
    blocks: u32,
    /// It was complete once.
    done: bool,
    patience: Duration,
    /// It is skipped until then, after repeated refusals to read it.
    rests_until: Option<Instant>,
    refusals: u32,
    /// Its queue after it has settled, which is that of its robot.
    lane: String,
    /// Turn count when it was queued; `None` if it is not queued.
    queued: Option<u64>,
}

/// The order of files from different lanes: since when the file or its lane waits, since when the file waits, its
/// modification time, its path.
type TurnOrder<'e> = (u64, u64, SystemTime, Option<&'e OsStr>, &'e Path);

/// The files of the latest scan.
#[derive(Debug)]
pub struct FileSchedule {
    settle: Duration,
    entries: HashMap<PathBuf, Entry>,
    /// Files that are skipped until they change.
    read: HashMap<Box<Path>, ReadFile>,
    /// Files that the database knows and that were not seen yet.
    begun: HashMap<PathBuf, KnownFile>,
    /// Growing files that are not read yet.
    growing: BTreeSet<PathBuf>,
    /// Settled files that are not read yet: a queue for each lane, by name, which begins with robot and time.
    settled: BTreeMap<String, BTreeSet<(Option<OsString>, PathBuf)>>,
    /// Files being read. By number, so that a file with two names is read once.
    open: HashSet<FileId>,
    /// Number of scans and of opened files so far.
    count: u64,
    /// Counts when a file of each lane was last opened, so that robots take turns.
    turns: HashMap<String, u64>,
    /// Files that may have crashed the program.
    suspects: Suspects,
}

impl FileSchedule {
    /// Creates a schedule that knows only the files that were `begun` earlier; files settle in `settle`.
    pub fn new(settle: Duration, begun: HashMap<PathBuf, KnownFile>) -> Self {
        Self {
            settle,
            entries: HashMap::new(),
            read: HashMap::new(),
            begun,
            growing: BTreeSet::new(),
            settled: BTreeMap::new(),
            open: HashSet::new(),
            count: 0,
            turns: HashMap::new(),
            suspects: Suspects::new(Instant::now(), []),
        }
    }

    /// Takes over files that may have crashed the program in earlier processes.
    pub fn suspect(&mut self, suspects: Suspects) {
        self.suspects = suspects;
    }

    /// Sets the settle time of files; those with slow writers keep their longer time.
    pub fn settle_in(&mut self, settle: Duration) {
        let before = std::mem::replace(&mut self.settle, settle);
        let waiting = self.entries.values_mut().map(|entry| &mut entry.patience);
        let read = self.read.values_mut().map(|read| &mut read.patience);
        for patience in waiting.chain(read).filter(|patience| **patience <= before.max(settle)) {
            *patience = settle;
        }
    }

    /// Files of a scan that no earlier scan has found.
    pub fn unseen<'f>(&self, files: &[Sighting<'f>]) -> Vec<&'f FoundFile> {
        let is_known = |path: &Path| self.entries.contains_key(path) || self.read.contains_key(path);
        files.iter().map(|(file, _)| *file).filter(|file| !is_known(&file.path)).collect()
    }

    /// Marks files as unchanged since their treatment was decided. Must be called before [`note`](Self::note) for the
    /// scan that finds them.
    pub fn taken_before(&mut self, paths: impl Iterator<Item = PathBuf>) {
        self.begun.extend(paths.map(|path| (path, KnownFile::Taken)));
    }

    /// Processes the result of a scan of the folders at `now`. `lane_of` gives the queue of a file that has settled.
    pub fn note(&mut self, files: &[Sighting<'_>], now: Instant, lane_of: impl Fn(&Path) -> String) {
        let found: HashSet<&Path> = files.iter().map(|(file, _)| file.path.as_path()).collect();
        self.entries.retain(|path, _| found.contains(path.as_path()));
        self.read.retain(|path, _| found.contains(&**path));
        drop(found);
        self.growing.clear();
        self.settled.clear();
        self.count += 1;
        let mut longest_wait = self.count;
        let mut is_suspect_read = self
            .suspects
            .any(|path| self.entries.get(path).is_some_and(|entry| self.open.contains(&entry.file)));
        for (file, looked) in files {
            if *looked == LookKind::Now {
                let seen = Observation { size: file.size, modified: file.modified, at: now };
                self.look_at(file, seen, &lane_of);
            }
            let Some(entry) = self.entries.get_mut(&file.path) else { continue };
            let rests = entry.rests_until.is_some_and(|end| now < end)
                || *looked == LookKind::Unanswered
                || !self.suspects.admit(&file.path, is_suspect_read, now);
            if rests || self.open.contains(&entry.file) {
                entry.queued = None;
                continue;
            }
            if entry.settling.is_settled(entry.patience.max(file.wait)) || file.is_marked {
                let name = file.path.file_name().map(Into::into);
                self.settled.entry(entry.lane.clone()).or_default().insert((name, file.path.clone()));
            } else if entry.grown && (!entry.waits || entry.looks_again_at.is_some_and(|at| at <= now)) {
                self.growing.insert(file.path.clone());
            } else {
                entry.queued = None;
                continue;
            }
            is_suspect_read |= self.suspects.has(&file.path);
            longest_wait = longest_wait.min(*entry.queued.get_or_insert(self.count));
        }
        // turns from before the oldest waiting file was queued no longer affect the order
        self.turns.retain(|_, turn| *turn > longest_wait);
    }

    /// Updates a file from an observation.
    fn look_at(&mut self, file: &FoundFile, seen: Observation, lane_of: impl Fn(&Path) -> String) {
        let path = &file.path;
        if self.read.get(&**path).is_some_and(|read| read.is(file)) {
            return;
        }
        if let Some(read) = self.read.remove(&**path) {
            self.entries.insert(path.clone(), Entry::reopened(&read, seen.at, lane_of(path)));
        }
        if let Some(entry) = self.entries.get_mut(path) {
            return entry.see(seen, file.file);
        }
        let begun = self.begun.remove(path);
        let entry = Entry::new(seen, file.file, self.settle, lane_of(path));
        if begun == Some(KnownFile::Taken) {
            self.read.insert(path.clone().into(), entry.read());
        } else {
            self.entries.insert(path.clone(), entry.begun(begun));
        }
    }

    /// The next growing file that `may_be_opened`, of the robot that has waited longest; it is open from now on.
    pub fn next_growing(&mut self, may_be_opened: impl Fn(&Path) -> bool) -> Option<NextAttempt> {
        loop {
            let allowed = self.growing.iter().filter(|path| may_be_opened(path));
            let waiting = allowed.filter_map(|path| self.turn(path));
            let path = waiting.min()?.4.to_owned();
            self.growing.remove(&path);
            if let Some(due) = self.open(&path) {
                return Some(due);
            }
        }
    }

    /// Number of growing files that wait to be read.
    pub fn growing_waiting(&self) -> usize {
        self.growing.len()
    }

    /// Number of settled files that wait to be read and whose size in bytes is wanted.
    pub fn settled_waiting(&self, is_wanted: impl Fn(u64) -> bool) -> usize {
        let waiting = self.settled.values().flatten().filter_map(|(_, path)| self.entries.get(path));
        waiting.filter(|entry| is_wanted(entry.seen.size)).count()
    }

    /// The next settled file of a lane that is not busy, with its lane. In each lane, only the first file by name
    /// counts among those that `may_be_opened` and have a wanted size in bytes; the lane that has waited longest is
    /// chosen. The file is open from now on.
    pub fn next_settled(
        &mut self,
        busy: &HashSet<String>,
        may_be_opened: impl Fn(&Path) -> bool,
        is_wanted: impl Fn(u64) -> bool,
    ) -> Option<(NextAttempt, String)> {
        loop {
            let free = self.settled.iter().filter(|(lane, _)| !busy.contains(*lane));
            let first = free.filter_map(|(lane, queue)| {
                Some((queue.iter().map(|(_, path)| path).find(|path| may_be_opened(path))?, lane))
            });
            let wanted = first
                .filter(|(path, _)| self.entries.get(*path).is_some_and(|entry| is_wanted(entry.seen.size)));
            let (turn, lane) = wanted.filter_map(|(path, lane)| Some((self.turn(path)?, lane))).min()?;
            let (path, lane) = (turn.4.to_owned(), lane.clone());
            if let Some(queue) = self.settled.get_mut(&lane) {
                queue.remove(&(path.file_name().map(Into::into), path.clone()));
            }
            if let Some(due) = self.open(&path) {
                return Some((due, lane));
            }
        }
    }

    /// Returns true if settled files of a lane wait.
    pub fn has_settled(&self, lane: &str) -> bool {
        self.settled.get(lane).is_some_and(|queue| !queue.is_empty())
    }

    /// Position of a waiting file in the order.
    fn turn(&self, path: &Path) -> Option<TurnOrder<'_>> {
        let (path, entry) = self.entries.get_key_value(path)?;
        let queued = entry.queued.unwrap_or(self.count);
        let served = self.turns.get(&entry.lane).copied().unwrap_or(0);
        Some((served.max(queued), queued, entry.seen.modified, path.file_name(), path))
    }

    /// Number of files of the latest scan that are not read yet and are not skipped at `now`.
    pub fn waiting(&self, now: Instant) -> usize {
        let rests = |entry: &Entry| entry.rests_until.is_some_and(|end| now < end);
        self.entries.values().filter(|entry| !rests(entry)).count()
    }

    fn open(&mut self, path: &Path) -> Option<NextAttempt> {
        let entry = self.entries.get_mut(path)?;
        let (seen, file, patience) = (entry.seen, entry.file, entry.patience);
        entry.queued = None;
        entry.waits = false;
        if !self.open.insert(file) {
            return None;
        }
        self.count += 1;
        self.turns.insert(entry.lane.clone(), self.count);
        Some(NextAttempt { path: path.to_owned(), seen, file, patience })
    }

    /// Lets a file that was read be read again at the next scan; others are unchanged.
    pub fn again(&mut self, path: &Path, now: Instant, lane_of: impl Fn(&Path) -> String) {
        if let Some(read) = self.read.remove(path) {
            self.entries.insert(path.to_owned(), Entry::reopened(&read, now, lane_of(path)));
        }
    }

    /// Processes the result of reading a file that was open.
    pub fn close(&mut self, due: &NextAttempt, closing: Closing) {
        self.open.remove(&due.file);
        self.suspects.survived(&due.path);
        // scans while it was open have queued it again; the next scan knows better
        self.growing.remove(&due.path);
        let lane = self.entries.get(&due.path).map(|entry| &entry.lane);
        if let Some(queue) = lane.and_then(|lane| self.settled.get_mut(lane)) {
            queue.remove(&(due.path.file_name().map(Into::into), due.path.clone()));
        }
        let Some(entry) = self.entries.get_mut(&due.path) else { return };
        let unchanged = entry.seen.size == due.seen.size && entry.seen.modified == due.seen.modified;
        entry.grown &= closing == Closing::Taken && !unchanged;
        match closing {
            Closing::Taken if unchanged => {
                let read = entry.read();
                self.entries.remove(&due.path);
                self.read.insert(due.path.clone().into(), read);
            }
            Closing::Taken => {}
            // the part that was read is compared with the file when it has settled, unless it has grown since
            Closing::Done(read) => {
                entry.done = true;
                entry.grown = entry.file == due.file && entry.seen.size > read.max(due.seen.size);
            }
            Closing::UntilSettled => (entry.waits, entry.looks_again_at) = (true, None),
            Closing::Blocked => entry.block(),
            Closing::Again => entry.settling = Settling::first(entry.seen),
            Closing::Unreadable => entry.rest(),
            Closing::GaveWay(read) => entry.grown = entry.file == due.file && entry.seen.size > read,
        }
    }
}

impl ReadFile {
    /// Returns true if the file has not changed since it was read.
    fn is(&self, found: &FoundFile) -> bool {
        (self.size, self.modified, self.file) == (found.size, found.modified, found.file)
    }
}

impl Entry {
    fn new(seen: Observation, file: FileId, patience: Duration, lane: String) -> Self {
        Self {
            seen,
            file,
            settling: Settling::first(seen),
            grown: false,
            waits: false,
            looks_again_at: None,
            blocks: 0,
            done: false,
            patience,
            rests_until: None,
            refusals: 0,
            lane,
            queued: None,
        }
    }

    /// The same for a file that may have been started earlier.
    fn begun(mut self, begun: Option<KnownFile>) -> Self {
        match begun {
            Some(KnownFile::Growing) => self.grown = true,
            Some(KnownFile::Settled(size, modified)) => {
                let seen = Timestamp::try_from(self.seen.modified).map(Timestamp::as_microsecond);
                if size == self.seen.size && seen.is_ok_and(|seen| seen == modified) {
                    self.settling = Settling::settled_before(self.seen);
                }
            }
            Some(KnownFile::Taken) | None => {}
        }
        self
    }

    /// An entry for a file that was read and must be processed again: it counts as settled unless it has changed when
    /// it is seen.
    fn reopened(read: &ReadFile, now: Instant, lane: String) -> Self {
        let seen = Observation { size: read.size, modified: read.modified, at: now };
        let settling = Settling::settled_before(seen);
        Self { settling, done: read.done, ..Self::new(seen, read.file, read.patience, lane) }
    }

    /// The short entry for it after it was read in the observed state.
    fn read(&self) -> ReadFile {
        let Self { seen, file, patience, done, .. } = *self;
        ReadFile { size: seen.size, modified: seen.modified, file, patience, done }
    }

    fn rest(&mut self) {
        let rest = self.patience.saturating_mul(1 << self.refusals.min(16)).min(LONGEST_REST);
        self.refusals += 1;
        self.rests_until = Some(self.seen.at + rest);
    }

    fn block(&mut self) {
        let rest = FIRST_LOOK_AGAIN.saturating_mul(1 << self.blocks.min(16)).min(LONGEST_PATIENCE);
        self.blocks += 1;
        (self.waits, self.looks_again_at) = (true, Some(self.seen.at + rest));
    }

    fn see(&mut self, seen: Observation, file: FileId) {
        let before = std::mem::replace(&mut self.seen, seen);
        let same_file = std::mem::replace(&mut self.file, file) == file;
        self.settling = self.settling.again(seen);
        if same_file && before.size == seen.size && before.modified == seen.modified {
            return;
        }
        if std::mem::take(&mut self.done) {
            self.patience = (2 * self.patience).min(LONGEST_PATIENCE.max(self.patience));
        }
        (self.rests_until, self.refusals) = (None, 0);
        // a touched file has not grown, and a file that was cut has not grown yet
        self.grown = same_file && seen.size > before.size;
        if !same_file || seen.size < before.size {
            (self.waits, self.blocks) = (false, 0);
        }
    }
}

#[cfg(test)]
mod tests;
