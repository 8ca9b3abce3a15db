//! Finds exports. Events only trigger a scan; the scan finds the files.
//!
//! Events get lost: queues overflow, and file servers report no changes by others. A periodic scan sees everything, and
//! repeated scans are harmless.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use std::{fmt, fs, io};

use notify::event::{AccessKind, AccessMode};
use notify::{EventKind, RecommendedWatcher, RecursiveMode, Watcher};
use tokio::sync::mpsc;

use super::tail::{DONE_MARK, is_marked, mark_of};
use crate::bytes::access::{LEADS_OUT, LEADS_OUT_REMEDY};
use crate::bytes::fingerprint::{extent, id_of};
use crate::bytes::source::is_export;
use crate::bytes::trace::is_trace;
use armwatch_model::run::FileId;
use armwatch_model::text;

/// Deepest folder below a watched one. Exports are a few folders deep; a mount inside itself would never end.
const MAX_DEPTH: usize = 32;

/// Why a folder with more folders around it is not looked into.
const TOO_DEEP: &str = "a folder more than 32 levels below the watched one";

/// An export that a scan found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundFile {
    /// Path, below the folder as given.
    pub path: PathBuf,
    /// Size, bytes.
    pub size: u64,
    /// Time of the last change, see [`extent`].
    pub modified: SystemTime,
    /// Number of the file in its file system.
    pub file: FileId,
    /// True if its writer has marked it as complete, see [`is_marked`].
    pub is_marked: bool,
    /// Time that it waits for missing parts of its recording.
    pub wait: Duration,
}

/// Result of a scan.
#[derive(Debug, Default)]
pub struct Scan {
    /// Exports, sorted by file name and then by path, so that every scan gives the same order.
    pub files: Vec<FoundFile>,
    /// Unreadable folders and files.
    pub unreadable: Vec<UnreadablePlace>,
    /// Skipped places, which may contain exports.
    pub skipped: Vec<Skipped>,
    /// Folders that were read: each with its path from the given folder, and its path without links.
    pub folders: Vec<(PathBuf, PathBuf)>,
}

/// An unreadable place.
#[derive(Debug, thiserror::Error)]
#[error("{}: {error}; check that it exists and that this user may read it", text::of_path(path))]
pub struct UnreadablePlace {
    /// The place.
    pub path: PathBuf,
    /// Why.
    pub error: io::Error,
}

/// A skipped place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Skipped {
    /// A link.
    LeadsOut {
        /// The link.
        path: PathBuf,
        /// Its final target.
        target: PathBuf,
    },
    /// A folder at too great a depth.
    TooDeep {
        /// The folder.
        path: PathBuf,
    },
}

impl Skipped {
    /// The place.
    pub fn path(&self) -> &Path {
        match self {
            Self::LeadsOut { path, .. } | Self::TooDeep { path } => path,
        }
    }

    /// The place and the reason.
    pub fn reason(&self) -> String {
        match self {
            Self::LeadsOut { path, target } => {
                format!("{} is {LEADS_OUT}, to {}", path.display(), target.display())
            }
            Self::TooDeep { path } => format!("{} is {TOO_DEEP}", path.display()),
        }
    }

    /// The reason alone. It does not name the target of a link, which not all readers may know.
    pub fn problem(&self) -> &'static str {
        match self {
            Self::LeadsOut { .. } => LEADS_OUT,
            Self::TooDeep { .. } => TOO_DEEP,
        }
    }

    /// The remedy.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::LeadsOut { .. } => LEADS_OUT_REMEDY,
            Self::TooDeep { .. } => "move it further up, or add it to watch.folders",
        }
    }
}

impl fmt::Display for Skipped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}; {}", self.reason(), self.remedy())
    }
}

/// Scans `folders` and their subfolders for exports, see [`is_export`].
///
/// Hidden subfolders are skipped. Links are followed if `follow_links`; otherwise a link to an export inside the same
/// folder counts as the export, and links that lead out of it are [`Skipped`]. Each folder is read once, which ends a
/// loop of links. A path in `folders` that is a file is accepted with any name, because a person named it; so is a
/// folder that is a link. A file below two of the folders is returned once.
pub fn scan(folders: &[PathBuf], follow_links: bool) -> Scan {
    scan_saying(folders, follow_links, &|| ())
}

/// Like [`scan`]; calls `goes_on` before each call to the file system, since any of them can hang.
pub fn scan_saying(folders: &[PathBuf], follow_links: bool, goes_on: &dyn Fn()) -> Scan {
    let mut scan = Scan::default();
    let mut walk = Walk { root: None, follow_links, seen: HashSet::new(), goes_on };
    for folder in folders {
        goes_on();
        match fs::metadata(folder) {
            Ok(metadata) if metadata.is_dir() => {
                walk.root = fs::canonicalize(folder).ok();
                scan.folder(folder, 0, &mut walk);
            }
            Ok(metadata) => scan.file(folder.clone(), &metadata, is_marked(folder)),
            Err(error) => scan.unreadable.push(UnreadablePlace { path: folder.clone(), error }),
        }
    }
    scan.files.sort_by(|a, b| a.order().cmp(&b.order()));
    scan.files.dedup_by(|a, b| a.path == b.path);
    scan
}

impl FoundFile {
    /// Sort key of files: name, path.
    pub fn order(&self) -> (Option<&OsStr>, &Path) {
        (self.path.file_name(), &self.path)
    }
}

/// A walk through folders.
struct Walk<'w> {
    /// Path of the given folder without links; `None` if it is unknown.
    root: Option<PathBuf>,
    follow_links: bool,
    /// Paths without links of the folders that were read.
    seen: HashSet<PathBuf>,
    goes_on: &'w dyn Fn(),
}

impl Scan {
    fn folder(&mut self, folder: &Path, depth: usize, walk: &mut Walk<'_>) {
        (walk.goes_on)();
        // Overlapping watch folders, and the same folder with two spellings, are read once.
        if let Ok(real) = fs::canonicalize(folder) {
            if !walk.seen.insert(real.clone()) {
                return;
            }
            self.folders.push((folder.to_owned(), real));
        }
        if depth > MAX_DEPTH {
            return self.skipped.push(Skipped::TooDeep { path: folder.to_owned() });
        }
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) => return self.unreadable.push(UnreadablePlace { path: folder.to_owned(), error }),
        };
        let mut found = Vec::new();
        let mut marks = HashSet::new();
        for entry in entries {
            (walk.goes_on)();
            match entry.and_then(|entry| Ok((entry.path(), entry.file_type()?))) {
                Ok((path, _)) if path.as_os_str().as_encoded_bytes().ends_with(DONE_MARK.as_bytes()) => {
                    marks.insert(path);
                }
                Ok(entry) => found.push(entry),
                Err(error) => self.unreadable.push(UnreadablePlace { path: folder.to_owned(), error }),
            }
        }
        for (path, kind) in found {
            let is_marked = || marks.contains(&mark_of(&path)) && is_marked(&path);
            if kind.is_symlink() {
                self.link(path, depth, walk, &marks);
            } else if kind.is_dir() {
                if !is_hidden(&path) {
                    self.folder(&path, depth + 1, walk);
                }
            } else if is_export(&path) || is_trace(&path) {
                (walk.goes_on)();
                match fs::metadata(&path) {
                    Ok(metadata) => {
                        let is_marked = is_marked();
                        self.file(path, &metadata, is_marked);
                    }
                    // Deleted since the folder was listed: that is not an error.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    Err(error) => self.unreadable.push(UnreadablePlace { path, error }),
                }
            }
        }
    }

    /// Processes a link in a folder.
    fn link(&mut self, path: PathBuf, depth: usize, walk: &mut Walk<'_>, marks: &HashSet<PathBuf>) {
        (walk.goes_on)();
        let is_named = is_export(&path) || is_trace(&path);
        let looked = fs::canonicalize(&path).and_then(|target| Ok((fs::metadata(&target)?, target)));
        let (metadata, target) = match looked {
            Ok(looked) => looked,
            // A dangling link: that is not an error.
            Err(error) if !is_named || error.kind() == io::ErrorKind::NotFound => return,
            Err(error) => return self.unreadable.push(UnreadablePlace { path, error }),
        };
        let is_inside = walk.root.as_ref().is_some_and(|root| target.starts_with(root));
        // the scan finds a folder inside by its own path
        if metadata.is_dir() && (is_inside || is_hidden(&path)) || !metadata.is_dir() && !is_named {
            return;
        }
        if !is_inside && !walk.follow_links {
            self.skipped.push(Skipped::LeadsOut { path, target });
        } else if metadata.is_dir() {
            self.folder(&path, depth + 1, walk);
        } else {
            let is_marked = marks.contains(&mark_of(&path)) && is_marked(&path);
            self.file(path, &metadata, is_marked);
        }
    }

    fn file(&mut self, path: PathBuf, metadata: &Metadata, is_marked: bool) {
        if !metadata.is_file() {
            return;
        }
        let ((size, modified), file) = (extent(&path, metadata), id_of(metadata));
        self.files.push(FoundFile { path, size, modified, file, is_marked, wait: Duration::ZERO });
    }
}

/// Remembers the reported places, so that a folder that stays unreadable is reported once instead of at every scan.
#[derive(Debug, Default)]
pub struct Complaints {
    unreadable: HashSet<PathBuf>,
    skipped: HashSet<PathBuf>,
}

impl Complaints {
    /// The new ones among a scan's unreadable places; forgets places that have recovered.
    pub fn fresh<'s>(&mut self, scan: &'s Scan) -> Vec<&'s UnreadablePlace> {
        let fresh = scan.unreadable.iter().filter(|place| !self.unreadable.contains(&place.path)).collect();
        self.unreadable = scan.unreadable.iter().map(|place| place.path.clone()).collect();
        fresh
    }

    /// Like [`Complaints::fresh`], for skipped places.
    pub fn newly_skipped<'s>(&mut self, scan: &'s Scan) -> Vec<&'s Skipped> {
        let fresh = scan.skipped.iter().filter(|place| !self.skipped.contains(place.path())).collect();
        self.skipped = scan.skipped.iter().map(|place| place.path().to_owned()).collect();
        fresh
    }

    /// Logs the new ones as warnings.
    pub fn warn(&mut self, scan: &Scan) {
        for place in self.fresh(scan) {
            tracing::warn!("cannot read a watched place: {place}; every scan tries again");
        }
        for place in self.newly_skipped(scan) {
            tracing::warn!("skipped: {place}");
        }
    }
}

/// Keeps the watch alive; dropping it ends the hints.
///
/// The guard keeps the sender of the hints, even if nothing is watched: then no hint arrives and only the periodic scan
/// finds files.
#[derive(Debug)]
pub struct FolderWatch {
    watcher: Option<RecommendedWatcher>,
    folders: Vec<PathBuf>,
    watched: HashSet<PathBuf>,
    failed: HashSet<PathBuf>,
    _sender: mpsc::Sender<()>,
}

/// Sender and receiver of hints. A hint that arrives while one is waiting merges with it.
pub fn hints() -> (mpsc::Sender<()>, mpsc::Receiver<()>) {
    // One slot: a second hint adds no information.
    mpsc::channel(1)
}

/// Watches `folders` with their subfolders. A hint means: scan again.
///
/// This never fails: if the system offers no watch, it logs a warning, and the periodic scan continues. A missing
/// folder is not created, since that would hide a misspelt path or an absent mount; [`FolderWatch::watch_missing`] adds
/// it once it exists. A folder that does not answer blocks the caller and the hints of the other folders.
pub fn watch_folders(folders: &[PathBuf], sender: mpsc::Sender<()>) -> FolderWatch {
    let hints = sender.clone();
    let handler = move |event: notify::Result<notify::Event>| {
        // An error may be a full queue: a scan is right then too.
        if event.as_ref().map_or(true, is_change) {
            // A full channel already contains the hint; with a closed one, no scanner is left.
            let _ = hints.try_send(());
        }
    };
    let config = notify::Config::default().with_follow_symlinks(false);
    let watcher = RecommendedWatcher::new(handler, config)
        .inspect_err(|error| {
            tracing::warn!(%error, "no file events on this system; the periodic scan finds new exports");
        })
        .ok();
    let mut watch = FolderWatch {
        watcher,
        folders: folders.to_vec(),
        watched: HashSet::new(),
        failed: HashSet::new(),
        _sender: sender,
    };
    watch.watch_missing();
    watch
}

impl FolderWatch {
    /// Tries again to watch the folders that could not be watched so far; must be called at each periodic scan. Warns
    /// of each folder once.
    pub fn watch_missing(&mut self) {
        let Some(watcher) = &mut self.watcher else { return };
        // A deleted folder has lost its watch.
        self.watched.retain(|folder| folder.is_dir());
        for folder in &self.folders {
            // the scan reports a missing folder, and the remedy
            if self.watched.contains(folder) || !folder.exists() {
                continue;
            }
            match watcher.watch(folder, RecursiveMode::Recursive) {
                Ok(()) => {
                    self.watched.insert(folder.clone());
                    self.failed.remove(folder);
                }
                Err(error) => {
                    if self.failed.insert(folder.clone()) {
                        tracing::warn!(
                            path = %text::of_path(folder), %error,
                            "cannot watch the folder; the periodic scan finds new exports in it"
                        );
                    }
                }
            }
        }
    }

    /// Number of folders watched by the system.
    #[cfg(test)]
    fn watched_count(&self) -> usize {
        self.watched.len()
    }
}

/// Returns true if an event may mean a new or changed file. Opening and reading do not count: the scan itself opens
/// folders and would trigger itself for ever.
fn is_change(event: &notify::Event) -> bool {
    match event.kind {
        EventKind::Access(kind) => kind == AccessKind::Close(AccessMode::Write) || event.need_rescan(),
        _ => true,
    }
}

fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Longest wait of a test for an expected event; inotify takes milliseconds.
    const DEADLINE: Duration = Duration::from_secs(20);

    struct WatchedTree(tempfile::TempDir);

    impl WatchedTree {
        fn new(files: &[&str]) -> Self {
            let tree = Self(tempfile::tempdir().unwrap());
            files.iter().for_each(|name| tree.write(name));
            tree
        }

        fn path(&self, name: &str) -> PathBuf {
            self.0.path().join(name)
        }

        fn write(&self, name: &str) {
            fs::create_dir_all(self.path(name).parent().unwrap()).unwrap();
            fs::write(self.path(name), "time\n").unwrap();
        }

        fn found(&self, folders: &[&str]) -> Vec<String> {
            let folders: Vec<PathBuf> = folders.iter().map(|name| self.path(name)).collect();
            let relative =
                |file: FoundFile| file.path.strip_prefix(self.0.path()).unwrap().display().to_string();
            scan(&folders, false).files.into_iter().map(relative).collect()
        }
    }

    #[test]
    fn finds_exports_by_name_then_path_and_nothing_else() {
        let tree = WatchedTree::new(&[
            "b/R02.csv",
            "a/R02.csv",
            "z/R01.csv.gz",
            "a/deep/er/R00.csv.zst",
            "a/R03.csv.part",
            "a/R03.truth.json",
            "a/.R04.csv",
            ".hidden/R05.csv",
            "a/notes.txt",
        ]);
        fs::create_dir(tree.path("folder.csv")).unwrap();
        let expected = ["a/deep/er/R00.csv.zst", "z/R01.csv.gz", "a/R02.csv", "b/R02.csv"];
        assert_eq!(tree.found(&[""]), expected);
        assert_eq!(scan(&[tree.path("z")], false).files[0].size, 5);
    }

    #[test]
    fn overlapping_folders_give_a_file_once_and_a_named_file_is_taken() {
        let tree = WatchedTree::new(&["a/b/R01.csv", "a/notes.txt"]);
        assert_eq!(tree.found(&["a", "a/b", "a", "a/../a"]), ["a/b/R01.csv"]);
        assert_eq!(tree.found(&["a/notes.txt", "a/notes.txt"]), ["a/notes.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_inside_count_and_links_that_lead_out_are_left_out_with_their_reason() {
        use std::os::unix::fs::symlink;
        let tree =
            WatchedTree::new(&["a/R01.csv", "a/sub/plain", "secret/token", "secret/R09.csv", "ab/R08.csv"]);
        let link = |target: &str, name: &str| symlink(tree.path(target), tree.path(name)).unwrap();
        link("a", "a/loop");
        link("a/sub/plain", "a/R02.csv");
        link("nothing", "a/R03.csv");
        link("secret/token", "a/R04.csv");
        link("a/R04.csv", "a/R05.csv");
        link("secret", "a/folder");
        link("ab", "a/sub/folder");
        link("secret/token", "a/notes.txt");
        link("secret", "a/.hidden");
        symlink("../../secret/R09.csv", tree.path("a/sub/R06.csv")).unwrap();
        let at = |follow_links| {
            let found = scan(&[tree.path("a")], follow_links);
            assert!(found.unreadable.is_empty(), "{found:?}");
            let relative = |path: &Path| path.strip_prefix(tree.path("a")).unwrap().display().to_string();
            let mut skipped: Vec<String> = found.skipped.iter().map(|of| relative(of.path())).collect();
            skipped.sort();
            (found.files.iter().map(|file| relative(&file.path)).collect::<Vec<_>>(), skipped)
        };
        let (files, skipped) = at(false);
        assert_eq!(files, ["R01.csv", "R02.csv"]);
        assert_eq!(skipped, ["R04.csv", "R05.csv", "folder", "sub/R06.csv", "sub/folder"]);
        let said = Skipped::LeadsOut { path: "R04.csv".into(), target: "/etc/token".into() }.to_string();
        assert!(
            said.contains("to a place outside the watched folder, to /etc/token; ")
                && said.contains("follow_links")
        );
        let (files, skipped) = at(true);
        assert_eq!(
            files,
            [
                "R01.csv",
                "R02.csv",
                "R04.csv",
                "R05.csv",
                "sub/R06.csv",
                "sub/folder/R08.csv",
                "folder/R09.csv"
            ]
        );
        assert_eq!(skipped, [""; 0]);
        link("a", "watched");
        assert_eq!(tree.found(&["watched"]), ["watched/R01.csv", "watched/R02.csv"]);
    }

    #[test]
    fn what_lies_too_deep_is_named_once() {
        let deep = |depth: usize| format!("a{}/R01.csv", "/d".repeat(depth));
        let tree = WatchedTree::new(&[&deep(MAX_DEPTH), &deep(MAX_DEPTH + 1)]);
        let scan = scan(&[tree.path("a")], false);
        assert_eq!((scan.files.len(), scan.skipped.len()), (1, 1));
        let mut complaints = Complaints::default();
        let said = complaints.newly_skipped(&scan)[0].to_string();
        assert!(said.contains("more than 32 levels below the watched one"), "{said}");
        assert!(complaints.newly_skipped(&scan).is_empty());
    }

    #[test]
    fn a_mark_beside_a_file_is_seen() {
        let tree = WatchedTree::new(&["a/R01.csv", "a/R02.csv"]);
        tree.write("a/R02.csv.done");
        let files = scan(&[tree.path("a")], false).files;
        assert_eq!(files.iter().map(|file| file.is_marked).collect::<Vec<_>>(), [false, true]);
    }

    #[test]
    fn a_missing_folder_is_complained_of_once_until_it_recovers() {
        let tree = WatchedTree::new(&["a/R01.csv"]);
        let folders = [tree.path("a"), tree.path("b")];
        let mut complaints = Complaints::default();
        let first = scan(&folders, false);
        assert_eq!(first.files.len(), 1);
        let fresh = complaints.fresh(&first);
        assert_eq!((fresh.len(), &fresh[0].path), (1, &folders[1]));
        assert!(complaints.fresh(&scan(&folders, false)).is_empty());
        tree.write("b/R02.csv");
        assert!(complaints.fresh(&scan(&folders, false)).is_empty());
        fs::remove_dir_all(tree.path("b")).unwrap();
        assert_eq!(complaints.fresh(&scan(&folders, false)).len(), 1);
    }

    #[tokio::test]
    async fn a_new_file_gives_a_hint_also_in_a_new_subfolder() {
        let tree = WatchedTree::new(&["a/R01.csv"]);
        let (sender, mut hints) = hints();
        let watch = watch_folders(&[tree.path("a")], sender);
        assert_eq!(watch.watched_count(), 1);
        tree.write("a/R02.csv");
        tokio::time::timeout(DEADLINE, hints.recv()).await.expect("a hint").expect("open");
        tree.write("a/new/R03.csv");
        tokio::time::timeout(DEADLINE, hints.recv()).await.expect("a hint").expect("open");
    }

    #[tokio::test]
    async fn a_missing_folder_is_watched_once_it_is_there_and_not_created() {
        let tree = WatchedTree::new(&[]);
        let folder = tree.path("later");
        let (sender, mut hints) = hints();
        let mut watch = watch_folders(std::slice::from_ref(&folder), sender);
        assert_eq!(watch.watched_count(), 0);
        assert!(!folder.exists());
        fs::create_dir(&folder).unwrap();
        watch.watch_missing();
        assert_eq!(watch.watched_count(), 1);
        tree.write("later/R01.csv");
        tokio::time::timeout(DEADLINE, hints.recv()).await.expect("a hint").expect("open");
        drop(watch);
        while let Some(()) = tokio::time::timeout(DEADLINE, hints.recv()).await.expect("the end") {}
    }

    #[test]
    fn looking_is_no_change() {
        use notify::event::{CreateKind, Flag};
        let event = |kind| notify::Event::new(kind);
        let open = EventKind::Access(AccessKind::Open(AccessMode::Any));
        assert!(!is_change(&event(open)));
        assert!(!is_change(&event(EventKind::Access(AccessKind::Close(AccessMode::Read)))));
        assert!(is_change(&event(EventKind::Access(AccessKind::Close(AccessMode::Write)))));
        assert!(is_change(&event(EventKind::Create(CreateKind::File))));
        assert!(is_change(&event(EventKind::Other).set_flag(Flag::Rescan)));
    }
}
