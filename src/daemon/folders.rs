//! The watched folders. A separate thread scans each of them, because a call to a dead file server never returns. The
//! other folders are scanned nevertheless, and the daemon knows the time of the last scan of each.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc as threads};
use std::thread;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use tokio::sync::mpsc;

use super::file_schedule::{LookKind, Sighting};
use crate::metrics::Metrics;
use armwatch_config::{Config, WatchSettings};
use armwatch_ingest::find::join::join_parts;
use armwatch_ingest::find::watch::{self, Complaints, Scan, Skipped};

/// A scan of a folder hangs if its file system has not answered a single call for this time. A scan of many files takes
/// longer, but each call returns.
const ANSWERS_WITHIN: Duration = Duration::from_secs(10);

/// Hints that arrive within this time cause one scan: a copy of a large file makes thousands.
const HINT_PAUSE: Duration = Duration::from_millis(100);

/// Pause between two scans that hints cause, as a multiple of the last scan's duration: files that grow all day must
/// not make the daemon scan thousands of others all day.
const LOOK_SHARE: u32 = 10;

/// Folders with a separate watch for file events, so that a hanging one delays no hint of another: a user has 128 such
/// watches. The others share one.
const OWN_WATCHES: usize = 64;

/// Results of the latest scans of all folders.
#[derive(Debug, Default)]
pub struct FolderLooks<'f> {
    /// Exports, by name and path, each once.
    pub files: Vec<Sighting<'f>>,
    /// The watched folders.
    pub folders: Vec<&'f Path>,
    /// Places with unknown content.
    pub hidden: Vec<&'f Path>,
    /// Places that scans skip.
    pub skipped: Vec<&'f Skipped>,
    /// Every folder that answers was scanned since the last whole look.
    pub is_whole: bool,
}

/// A scan that has ended.
struct Ended {
    folder: u64,
    scan: Scan,
    took: Duration,
}

/// A folder, and the thread that scans it.
struct ScannedFolder {
    number: u64,
    path: PathBuf,
    own_watch: bool,
    /// Requests a scan from the thread; dropping it ends the thread.
    wishes: threads::Sender<()>,
    /// Counts the scan's calls to the file system.
    calls: Arc<AtomicU64>,
    /// When the present scan began.
    began: Option<Instant>,
    /// When the next scan begins, and the earliest time after a hint.
    next: Instant,
    earliest: Instant,
    /// A hint arrived during the scan.
    is_hinted: bool,
    /// The last count of calls, and when it was first seen.
    seen: (u64, Instant),
    scan: Option<Scan>,
    /// Ended since the last scan of all folders together, and since the last whole one.
    is_new: bool,
    is_told: bool,
    looked_at: Option<Timestamp>,
    /// Its silence was logged.
    is_silent: bool,
    complaints: Complaints,
}

/// The watched folders.
pub(super) struct Folders {
    follow_links: bool,
    interval: Duration,
    folders: Vec<ScannedFolder>,
    count: u64,
    ended: (mpsc::UnboundedSender<Ended>, mpsc::UnboundedReceiver<Ended>),
    hints: (mpsc::Sender<()>, mpsc::Receiver<()>),
    /// Requests that the thread of the shared watch adds new folders.
    shared: Option<threads::Sender<()>>,
    /// Folders that did not answer and are no longer watched.
    dropped: Vec<PathBuf>,
    /// Identifies parts of recordings.
    config: Option<Arc<Config>>,
    metrics: Metrics,
}

/// A folder that stopped or began to answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Turned {
    pub(super) folder: PathBuf,
    /// When the last scan of it ended, since this process started.
    pub(super) looked_at: Option<Timestamp>,
    pub(super) answers: bool,
}

impl Folders {
    pub(super) fn new(settings: &WatchSettings, metrics: Metrics) -> Self {
        let mut folders = Self {
            follow_links: settings.follow_links,
            interval: settings.scan_interval,
            folders: Vec::new(),
            count: 0,
            ended: mpsc::unbounded_channel(),
            hints: watch::hints(),
            shared: None,
            dropped: Vec::new(),
            config: None,
            metrics,
        };
        folders.set(settings);
        folders
    }

    /// Sets the watched folders. Those that stay keep their threads, so that a hanging folder gets no second one.
    pub(super) fn set(&mut self, settings: &WatchSettings) {
        let others =
            std::mem::replace(&mut self.follow_links, settings.follow_links) != settings.follow_links;
        self.interval = settings.scan_interval;
        let is_dropped = |folder: &mut ScannedFolder| others || !settings.folders.contains(&folder.path);
        let dropped = self.folders.extract_if(.., is_dropped).filter(|folder| folder.is_silent);
        self.dropped.extend(dropped.map(|folder| folder.path));
        let now = Instant::now();
        self.folders.iter_mut().for_each(|folder| folder.next = now);
        for (place, path) in settings.folders.iter().enumerate() {
            if !self.folders.iter().any(|folder| folder.path == *path) {
                self.add(path, place < OWN_WATCHES);
            }
        }
        let shared: Vec<PathBuf> = self
            .folders
            .iter()
            .filter(|folder| !folder.own_watch)
            .map(|folder| folder.path.clone())
            .collect();
        self.shared = (!shared.is_empty()).then(|| watch_together(shared, self.hints.0.clone()));
        let place = |folder: &ScannedFolder| settings.folders.iter().position(|path| *path == folder.path);
        self.folders.sort_by_key(place);
        self.metrics.keep_folders(&settings.folders, settings.scan_interval);
    }

    /// Sets the configuration that joins the parts of recordings.
    pub(super) fn join_by(&mut self, config: Arc<Config>) {
        self.config = Some(config);
    }

    fn add(&mut self, path: &Path, own_watch: bool) {
        self.count += 1;
        let calls = Arc::<AtomicU64>::default();
        let looking = Looking {
            number: self.count,
            path: path.to_owned(),
            follow_links: self.follow_links,
            calls: Arc::clone(&calls),
            ended: self.ended.0.clone(),
            hints: own_watch.then(|| self.hints.0.clone()),
        };
        let (wishes, wished) = threads::channel();
        let started =
            thread::Builder::new().name(format!("folder {}", self.count)).spawn(move || looking.run(&wished));
        if let Err(error) = started {
            tracing::error!(folder = %path.display(), %error, "no thread for a watched folder; it is not scanned");
        }
        let now = Instant::now();
        self.folders.push(ScannedFolder {
            number: self.count,
            path: path.to_owned(),
            own_watch,
            wishes,
            calls,
            began: None,
            next: now,
            earliest: now,
            is_hinted: false,
            seen: (0, now),
            scan: None,
            is_new: false,
            is_told: false,
            looked_at: None,
            is_silent: false,
            complaints: Complaints::default(),
        });
    }

    /// When the next scan begins, among folders without a running scan.
    pub(super) fn next_begin(&self) -> Option<Instant> {
        self.folders.iter().filter(|folder| folder.began.is_none()).map(|folder| folder.next).min()
    }

    /// Starts the scans that are due.
    pub(super) fn begin(&mut self, now: Instant) {
        for folder in self.folders.iter_mut().filter(|folder| folder.began.is_none() && folder.next <= now) {
            (folder.began, folder.is_hinted) = (Some(now), false);
            folder.seen = (folder.calls.load(Ordering::Relaxed), now);
            // if the thread is missing, the folder stays silent, which is reported
            let _ = folder.wishes.send(());
        }
        if let Some(shared) = &self.shared {
            let _ = shared.send(());
        }
    }

    /// Waits until a scan has ended, and processes all that have; or for a hint, which brings the next scans forward.
    /// Returns true if there are results to process. May be dropped before.
    pub(super) async fn happened(&mut self) -> bool {
        let takes_hint = self.folders.iter().any(ScannedFolder::takes_hint);
        let first = tokio::select! {
            Some(ended) = self.ended.1.recv() => ended,
            Some(()) = self.hints.1.recv(), if takes_hint => {
                self.folders.iter_mut().for_each(ScannedFolder::hint);
                return false;
            }
            else => std::future::pending().await,
        };
        let mut took = self.take_up(first);
        while let Ok(next) = self.ended.1.try_recv() {
            took = took.max(self.take_up(next));
        }
        let files =
            self.folders.iter().filter_map(|folder| folder.scan.as_ref()).map(|scan| scan.files.len());
        self.metrics.scanned(files.sum(), took);
        true
    }

    fn take_up(&mut self, Ended { folder, mut scan, took }: Ended) -> Duration {
        if let Some(config) = &self.config {
            scan.files = join_parts(std::mem::take(&mut scan.files), |name| config.part_of(name));
        }
        let Some(folder) = self.folders.iter_mut().find(|of| of.number == folder) else { return took };
        folder.complaints.warn(&scan);
        // a missing folder answered, but was not scanned
        if !scan.unreadable.iter().any(|place| place.path == folder.path) {
            folder.looked_at = Some(Timestamp::now());
        }
        self.metrics.folder_answers(&folder.path, folder.looked_at, took);
        (folder.scan, folder.began) = (Some(scan), None);
        (folder.is_new, folder.is_told) = (true, false);
        let now = Instant::now();
        folder.earliest = now + HINT_PAUSE.max(LOOK_SHARE * took);
        folder.next = if folder.is_hinted { folder.earliest } else { now + self.interval };
        took
    }

    /// Folders that have stopped or begun to answer since the last call; each is logged.
    pub(super) fn turned(&mut self, now: Instant) -> Vec<Turned> {
        let forgotten = |folder| Turned { folder, looked_at: None, answers: true };
        let mut turned: Vec<Turned> = self.dropped.drain(..).map(forgotten).collect();
        for folder in &mut self.folders {
            let calls = folder.calls.load(Ordering::Relaxed);
            if calls != folder.seen.0 {
                folder.seen = (calls, now);
            }
            let is_silent =
                folder.began.is_some() && now.saturating_duration_since(folder.seen.1) >= ANSWERS_WITHIN;
            if std::mem::replace(&mut folder.is_silent, is_silent) == is_silent {
                continue;
            }
            let (path, looked_at) = (&folder.path, folder.looked_at);
            if is_silent {
                tracing::warn!(
                    folder = %path.display(), "not scanned since {}: no answer for {} s; other folders are \
                        still scanned; check its disk or file server",
                    looked_at.map_or_else(|| "the start".to_owned(), |at| format!("{at:.0}")),
                    ANSWERS_WITHIN.as_secs()
                );
                self.metrics.folder_is_silent(path);
            } else {
                tracing::info!(folder = %path.display(), "answers again");
            }
            turned.push(Turned { folder: path.clone(), looked_at, answers: !is_silent });
        }
        turned
    }

    /// When the running scan begins to hang, if nothing happens until then.
    pub(super) fn next_turn(&self) -> Option<Instant> {
        let looking = self.folders.iter().filter(|folder| folder.began.is_some() && !folder.is_silent);
        looking.map(|folder| folder.seen.1 + ANSWERS_WITHIN).min()
    }

    /// Results of the latest scans of all folders. Each counts as new once.
    pub(super) fn look(&mut self) -> FolderLooks<'_> {
        let new: HashSet<u64> = self
            .folders
            .iter_mut()
            .filter_map(|folder| std::mem::take(&mut folder.is_new).then_some(folder.number))
            .collect();
        let is_whole =
            self.folders.iter().all(|folder| folder.is_silent || folder.scan.is_some() && !folder.is_told);
        if is_whole {
            self.folders.iter_mut().for_each(|folder| folder.is_told = true);
        }
        let mut look = FolderLooks {
            is_whole,
            folders: self.folders.iter().map(|folder| &*folder.path).collect(),
            ..FolderLooks::default()
        };
        // a folder within another one, or with two names, belongs to the first
        let mut reached: HashMap<&Path, &Path> = HashMap::new();
        for folder in &self.folders {
            let Some(scan) = &folder.scan else {
                look.hidden.push(&folder.path);
                continue;
            };
            look.hidden.extend(scan.unreadable.iter().map(|place| &*place.path));
            look.skipped.extend(&scan.skipped);
            if folder.is_silent {
                look.hidden.push(&folder.path);
            }
            let seen = match (folder.is_silent, new.contains(&folder.number)) {
                (true, _) => LookKind::Unanswered,
                (false, true) => LookKind::Now,
                (false, false) => LookKind::Before,
            };
            let mut again: HashSet<&Path> = HashSet::new();
            for (as_given, real) in &scan.folders {
                if *reached.entry(real).or_insert(as_given) != as_given.as_path() {
                    again.insert(as_given);
                }
            }
            let is_first =
                |path: &Path| again.is_empty() || path.parent().is_none_or(|around| !again.contains(around));
            look.files.extend(scan.files.iter().filter(|file| is_first(&file.path)).map(|file| (file, seen)));
        }
        look.files.sort_by(|(a, _), (b, _)| a.order().cmp(&b.order()));
        look.files.dedup_by(|(a, _), (b, _)| a.path == b.path);
        look
    }
}

impl ScannedFolder {
    fn takes_hint(&self) -> bool {
        if self.began.is_some() { !self.is_hinted } else { self.next > self.earliest }
    }

    fn hint(&mut self) {
        if self.began.is_some() {
            self.is_hinted = true;
        } else {
            self.next = self.next.min(self.earliest);
        }
    }
}

/// Data of the thread of a folder.
struct Looking {
    number: u64,
    path: PathBuf,
    follow_links: bool,
    calls: Arc<AtomicU64>,
    ended: mpsc::UnboundedSender<Ended>,
    /// Receiver of hints, if the folder has a separate watch.
    hints: Option<mpsc::Sender<()>>,
}

/// Watches folders for file events on one thread, until the sender is dropped.
fn watch_together(folders: Vec<PathBuf>, hints: mpsc::Sender<()>) -> threads::Sender<()> {
    let (wishes, wished) = threads::channel();
    let watching = move || {
        let mut watcher = watch::watch_folders(&folders, hints);
        while wished.recv().is_ok() {
            // requests that arrived in the meantime are served together
            while wished.try_recv().is_ok() {}
            watcher.watch_missing();
        }
    };
    if let Err(error) = thread::Builder::new().name("folders".into()).spawn(watching) {
        tracing::error!(%error, "no thread for file events; the periodic scan finds new exports");
    }
    wishes
}

impl Looking {
    /// Scans the folder on each request, until the requester is dropped.
    fn run(self, wished: &threads::Receiver<()>) {
        let folders = [self.path];
        let goes_on = || {
            self.calls.fetch_add(1, Ordering::Relaxed);
        };
        let mut watcher = None;
        while wished.recv().is_ok() {
            let began = Instant::now();
            // before the scan: later changes give a hint
            if let Some(hints) = &self.hints {
                watcher.get_or_insert_with(|| watch::watch_folders(&folders, hints.clone())).watch_missing();
            }
            let scan = watch::scan_saying(&folders, self.follow_links, &goes_on);
            let ended = Ended { folder: self.number, scan, took: began.elapsed() };
            if self.ended.send(ended).is_err() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(folders: &[PathBuf]) -> WatchSettings {
        WatchSettings { folders: folders.to_vec(), ..Config::shipped().unwrap().watch }
    }

    async fn looked(folders: &mut Folders) {
        folders.begin(Instant::now());
        while folders.folders.iter().any(|folder| folder.scan.is_none()) {
            tokio::time::timeout(Duration::from_secs(60), folders.happened()).await.expect("an answer");
        }
    }

    #[tokio::test]
    async fn files_of_all_folders_come_together_and_each_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["a/in/R02.csv", "a/R03.csv", "b/R01.csv"] {
            std::fs::create_dir_all(path(name).parent().unwrap()).unwrap();
            std::fs::write(path(name), "time\n").unwrap();
        }
        std::os::unix::fs::symlink(path("a"), path("also_a")).unwrap();
        let watched = ["a", "a/in", "also_a", "b", "none"].map(path);
        let mut folders = Folders::new(&settings(&watched), Metrics::default());
        assert_eq!(folders.look().hidden.len(), watched.len(), "nothing is known yet");
        looked(&mut folders).await;
        let look = folders.look();
        let names: Vec<&Path> = look.files.iter().map(|(file, _)| &*file.path).collect();
        assert_eq!(names, ["b/R01.csv", "a/in/R02.csv", "a/R03.csv"].map(path));
        assert!(look.files.iter().all(|(_, seen)| *seen == LookKind::Now), "{:?}", look.files);
        assert_eq!(look.hidden, [path("none")]);
        assert!(folders.look().files.iter().all(|(_, seen)| *seen == LookKind::Before));
        folders.set(&settings(&watched[3..]));
        assert_eq!(folders.look().files.len(), 1, "b keeps its thread and what it saw");
        assert_eq!(folders.folders[0].number, 4);
    }

    #[tokio::test]
    async fn a_folder_without_an_answer_is_silent_until_it_answers() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["a", "b"].map(|name| folder.path().join(name));
        paths.iter().for_each(|path| std::fs::create_dir(path).unwrap());
        std::fs::write(paths[0].join("R01.csv"), "time\n").unwrap();
        let mut folders = Folders::new(&settings(&paths), Metrics::counting());
        looked(&mut folders).await;
        let looked_at = folders.folders[0].looked_at;
        // its thread never gets the request
        let (nobody, _kept) = threads::channel();
        folders.folders[0].wishes = nobody;
        let now = Instant::now() + folders.interval;
        folders.begin(now);
        let looks_at_b = async { while !folders.happened().await {} };
        assert!(tokio::time::timeout(Duration::from_secs(60), looks_at_b).await.is_ok());
        assert!(folders.folders[1].began.is_none(), "b answers");
        assert!(folders.turned(now + ANSWERS_WITHIN / 2).is_empty());
        assert_eq!(folders.next_turn(), Some(now + ANSWERS_WITHIN));
        let turned = folders.turned(now + ANSWERS_WITHIN);
        assert_eq!(turned, [Turned { folder: paths[0].clone(), looked_at, answers: false }]);
        assert!(folders.turned(now + 2 * ANSWERS_WITHIN).is_empty(), "it was said");
        let look = folders.look();
        assert_eq!((look.files[0].1, &look.hidden), (LookKind::Unanswered, &vec![&*paths[0]]));
        assert!(
            folders
                .metrics
                .folders()
                .iter()
                .any(|of| !of.answers && of.folder == paths[0].display().to_string())
        );
        let ended = Ended { folder: folders.folders[0].number, scan: Scan::default(), took: Duration::ZERO };
        folders.ended.0.send(ended).unwrap();
        while !folders.happened().await {}
        assert!(folders.turned(now + 3 * ANSWERS_WITHIN)[0].answers);
        assert!(folders.metrics.folders().iter().all(|of| of.answers));
    }
}
