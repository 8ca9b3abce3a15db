//! Finding exports. Events only say "look again"; the scan is what finds.
//!
//! Events get lost: queues overflow, and file servers report nothing that others write. A scan at
//! start and every so often sees everything, and looking twice is harmless.

use std::collections::HashSet;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use std::{fs, io};

use notify::event::{AccessKind, AccessMode};
use notify::{EventKind, RecommendedWatcher, RecursiveMode, Watcher};
use tokio::sync::mpsc;

use crate::bytes::fingerprint::{changed_at, id_of};
use crate::bytes::source::is_export;
use armwatch_model::run::FileId;
use armwatch_model::text;

/// Deepest folder below a watched one. Exports lie a few folders deep; a mount inside itself would
/// go on for ever.
const MAX_DEPTH: usize = 32;

/// An export that a scan found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoundFile {
    /// Path, below the folder as it was given.
    pub path: PathBuf,
    /// Size, bytes.
    pub size: u64,
    /// Time of the last change, see [`changed_at`].
    pub modified: SystemTime,
    /// Number of the file in its file system.
    pub file: FileId,
}

/// What a scan saw.
#[derive(Debug, Default)]
pub struct Scan {
    /// Exports, by file name and then by path, so that every scan gives the same order.
    pub files: Vec<FoundFile>,
    /// Folders and files that could not be looked at.
    pub unreadable: Vec<Unreadable>,
}

/// A place that could not be looked at.
#[derive(Debug, thiserror::Error)]
#[error("{}: {error}; check that it exists and that this user may read it", text::of_path(path))]
pub struct Unreadable {
    /// The place.
    pub path: PathBuf,
    /// Why.
    pub error: io::Error,
}

/// Looks through `folders` and their subfolders for exports, see [`is_export`].
///
/// Hidden subfolders are skipped and links to folders not followed, so a loop of links ends here; a
/// link to an export counts as the export. A path in `folders` that is a file is taken as it is,
/// whatever its name, because a person named it. A file below two of the folders comes once.
#[must_use]
pub fn scan(folders: &[PathBuf]) -> Scan {
    let mut scan = Scan::default();
    let mut seen = HashSet::new();
    for folder in folders {
        match fs::metadata(folder) {
            Ok(metadata) if metadata.is_dir() => scan.folder(folder, 0, &mut seen),
            Ok(metadata) => scan.file(folder.clone(), &metadata),
            Err(error) => scan.unreadable.push(Unreadable { path: folder.clone(), error }),
        }
    }
    scan.files.sort_by(|a, b| (a.path.file_name(), &a.path).cmp(&(b.path.file_name(), &b.path)));
    scan.files.dedup_by(|a, b| a.path == b.path);
    scan
}

impl Scan {
    fn folder(&mut self, folder: &Path, depth: usize, seen: &mut HashSet<PathBuf>) {
        // Overlapping watch folders, and the same folder by two spellings, are looked at once.
        let first = fs::canonicalize(folder).map_or(true, |real| seen.insert(real));
        if !first || depth > MAX_DEPTH {
            return;
        }
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(error) => return self.unreadable.push(Unreadable { path: folder.to_owned(), error }),
        };
        for entry in entries {
            match entry.and_then(|entry| Ok((entry.path(), entry.file_type()?))) {
                Ok((path, kind)) if kind.is_dir() => {
                    if !is_hidden(&path) {
                        self.folder(&path, depth + 1, seen);
                    }
                }
                Ok((path, _)) if is_export(&path) => match fs::metadata(&path) {
                    Ok(metadata) => self.file(path, &metadata),
                    // Gone since the folder was listed, or a link to nothing: not there is not wrong.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                    Err(error) => self.unreadable.push(Unreadable { path, error }),
                },
                Ok(_) => {}
                Err(error) => self.unreadable.push(Unreadable { path: folder.to_owned(), error }),
            }
        }
    }

    fn file(&mut self, path: PathBuf, metadata: &Metadata) {
        if !metadata.is_file() {
            return;
        }
        let modified = changed_at(metadata);
        self.files.push(FoundFile { path, size: metadata.len(), modified, file: id_of(metadata) });
    }
}

/// Remembers which places were complained about, so that a folder that stays unreadable is warned
/// of once and not at every scan.
#[derive(Debug, Default)]
pub struct Complaints(HashSet<PathBuf>);

impl Complaints {
    /// Those of a scan's unreadable places that are new; places that have recovered are forgotten.
    pub fn fresh<'s>(&mut self, scan: &'s Scan) -> Vec<&'s Unreadable> {
        let fresh = scan.unreadable.iter().filter(|place| !self.0.contains(&place.path)).collect();
        self.0 = scan.unreadable.iter().map(|place| place.path.clone()).collect();
        fresh
    }

    /// Logs the new ones as warnings.
    pub fn warn(&mut self, scan: &Scan) {
        for place in self.fresh(scan) {
            tracing::warn!(
                "cannot look into a watched place: {place}; it is looked at again with every scan"
            );
        }
    }
}

/// Keeps the watch alive; dropping it ends the hints.
///
/// The receiver stays open as long as the guard lives, also without any watch: then no hint comes
/// and the periodic scan alone finds files.
#[derive(Debug)]
pub struct FolderWatch {
    watcher: Option<RecommendedWatcher>,
    folders: Vec<PathBuf>,
    watched: HashSet<PathBuf>,
    failed: HashSet<PathBuf>,
    _sender: mpsc::Sender<()>,
}

/// Watches `folders` with their subfolders. A hint on the receiver means: scan again. Hints that
/// come while one is waiting merge with it.
///
/// Nothing fails: where the system's watch is not to be had, a warning says so and the periodic scan
/// goes on. A folder that is missing is not created, since a misspelt path or an absent mount would
/// go unnoticed; [`FolderWatch::watch_missing`] takes it up once it is there.
#[must_use]
pub fn watch_folders(folders: &[PathBuf]) -> (FolderWatch, mpsc::Receiver<()>) {
    // One place: a second hint says nothing that the first does not.
    let (sender, receiver) = mpsc::channel(1);
    let hints = sender.clone();
    let handler = move |event: notify::Result<notify::Event>| {
        // An error may be a full queue: looking again is right then too.
        if event.as_ref().map_or(true, is_change) {
            // A full channel already holds the hint; a closed one has nobody left to look.
            let _ = hints.try_send(());
        }
    };
    let config = notify::Config::default().with_follow_symlinks(false);
    let watcher = RecommendedWatcher::new(handler, config)
        .inspect_err(|error| {
            tracing::warn!(%error, "no file events on this system; new exports are found by the periodic scan");
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
    (watch, receiver)
}

impl FolderWatch {
    /// Tries again to watch folders that could not be watched so far; to be called at each periodic
    /// scan. Each folder is warned of once.
    pub fn watch_missing(&mut self) {
        let Some(watcher) = &mut self.watcher else { return };
        // A folder that was removed has lost its watch with it.
        self.watched.retain(|folder| folder.is_dir());
        for folder in &self.folders {
            // the scan says that a folder is not there, and what to do
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
                            "cannot watch the folder; new exports in it are found by the periodic scan"
                        );
                    }
                }
            }
        }
    }

    /// Number of folders watched by the system.
    #[must_use]
    #[cfg(test)]
    fn watched_count(&self) -> usize {
        self.watched.len()
    }
}

/// Whether an event may mean a new or changed file. Opening and reading do not: the scan itself
/// opens folders and would wake itself for ever.
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

    /// How long a test waits for an event that must come; inotify takes milliseconds.
    const DEADLINE: Duration = Duration::from_secs(20);

    struct Tree(tempfile::TempDir);

    impl Tree {
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
            scan(&folders).files.into_iter().map(relative).collect()
        }
    }

    #[test]
    fn finds_exports_by_name_then_path_and_nothing_else() {
        let tree = Tree::new(&[
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
        assert_eq!(scan(&[tree.path("z")]).files[0].size, 5);
    }

    #[test]
    fn overlapping_folders_give_a_file_once_and_a_named_file_is_taken() {
        let tree = Tree::new(&["a/b/R01.csv", "a/notes.txt"]);
        assert_eq!(tree.found(&["a", "a/b", "a", "a/../a"]), ["a/b/R01.csv"]);
        assert_eq!(tree.found(&["a/notes.txt", "a/notes.txt"]), ["a/notes.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_to_files_count_and_loops_of_links_end() {
        use std::os::unix::fs::symlink;
        let tree = Tree::new(&["a/R01.csv", "elsewhere/R02"]);
        symlink(tree.path("a"), tree.path("a/loop")).unwrap();
        symlink(tree.path("elsewhere/R02"), tree.path("a/R02.csv")).unwrap();
        symlink(tree.path("nothing"), tree.path("a/R03.csv")).unwrap();
        assert_eq!(tree.found(&["a"]), ["a/R01.csv", "a/R02.csv"]);
        assert!(scan(&[tree.path("a")]).unreadable.is_empty());
        symlink(tree.path("a"), tree.path("watched")).unwrap();
        assert_eq!(tree.found(&["watched"]), ["watched/R01.csv", "watched/R02.csv"]);
    }

    #[test]
    fn a_missing_folder_is_complained_of_once_until_it_recovers() {
        let tree = Tree::new(&["a/R01.csv"]);
        let folders = [tree.path("a"), tree.path("b")];
        let mut complaints = Complaints::default();
        let first = scan(&folders);
        assert_eq!(first.files.len(), 1);
        let fresh = complaints.fresh(&first);
        assert_eq!((fresh.len(), &fresh[0].path), (1, &folders[1]));
        assert!(complaints.fresh(&scan(&folders)).is_empty());
        tree.write("b/R02.csv");
        assert!(complaints.fresh(&scan(&folders)).is_empty());
        fs::remove_dir_all(tree.path("b")).unwrap();
        assert_eq!(complaints.fresh(&scan(&folders)).len(), 1);
    }

    #[tokio::test]
    async fn a_new_file_gives_a_hint_also_in_a_new_subfolder() {
        let tree = Tree::new(&["a/R01.csv"]);
        let (watch, mut hints) = watch_folders(&[tree.path("a")]);
        assert_eq!(watch.watched_count(), 1);
        tree.write("a/R02.csv");
        tokio::time::timeout(DEADLINE, hints.recv()).await.expect("a hint").expect("open");
        tree.write("a/new/R03.csv");
        tokio::time::timeout(DEADLINE, hints.recv()).await.expect("a hint").expect("open");
    }

    #[tokio::test]
    async fn a_missing_folder_is_watched_once_it_is_there_and_not_created() {
        let tree = Tree::new(&[]);
        let folder = tree.path("later");
        let (mut watch, mut hints) = watch_folders(std::slice::from_ref(&folder));
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
