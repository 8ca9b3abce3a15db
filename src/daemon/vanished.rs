//! Runs whose file is gone. It reads no clock: the time is an argument.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};

use super::folders::FolderLooks;
use armwatch_store::UnfinishedSource;

/// A file that is missing for this many settle times is gone: that is longer than a rename, or a copy between folders,
/// stays unseen.
const SETTLES: u32 = 20;

/// Returns true if a file is missing from folders that were read.
pub fn is_missing(path: &Path, look: &FolderLooks<'_>) -> bool {
    let is_below = |places: &[&Path]| places.iter().any(|place| path.starts_with(place));
    // comparing whole texts is far faster than comparing paths part by part
    let is_found = || look.files.iter().any(|(file, _)| file.path.as_os_str() == path.as_os_str());
    is_below(&look.folders) && !is_below(&look.hidden) && !is_found()
}

/// Unfinished runs whose files are all missing, and since when.
#[derive(Debug, Default)]
pub struct Missing(HashMap<i64, Instant>);

impl Missing {
    /// Processes the result of a scan of the folders at `now` and returns the runs whose files are gone. A file is
    /// missing only from a readable folder, so that an unavailable share ends no run; the state of a file outside the
    /// folders is unknown.
    pub fn note(
        &mut self,
        unfinished: &[UnfinishedSource],
        look: &FolderLooks<'_>,
        settle: Duration,
        now: Instant,
    ) -> Vec<i64> {
        let is_missing = |source: &UnfinishedSource| is_missing(&source.path, look);
        let there: HashSet<i64> =
            unfinished.iter().filter(|source| !is_missing(source)).map(|source| source.run_id).collect();
        let missing: HashSet<i64> = unfinished.iter().map(|source| source.run_id).collect();
        self.0.retain(|run_id, _| missing.contains(run_id) && !there.contains(run_id));
        let gone = missing
            .difference(&there)
            .copied()
            .filter(|run_id| now.duration_since(*self.0.entry(*run_id).or_insert(now)) >= SETTLES * settle);
        gone.collect()
    }
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use jiff::Timestamp;

    use super::super::file_schedule::LookKind;
    use super::*;
    use armwatch_ingest::find::watch::FoundFile;
    use armwatch_model::run::FileId;

    const SETTLE: Duration = Duration::from_secs(5);

    fn unfinished(run_id: i64, path: &str) -> UnfinishedSource {
        let modified = Timestamp::UNIX_EPOCH;
        UnfinishedSource { run_id, path: path.into(), bytes: 1, modified, growing: true }
    }

    fn found(path: &str) -> FoundFile {
        let file = FileId { device: 1, inode: 1 };
        FoundFile {
            path: path.into(),
            size: 1,
            modified: SystemTime::UNIX_EPOCH,
            file,
            is_marked: false,
            wait: Duration::ZERO,
        }
    }

    #[test]
    fn a_file_that_stays_away_is_gone_and_one_that_nobody_can_see_is_not() {
        let runs = [
            unfinished(1, "/in/a.csv"),
            unfinished(2, "/in/b.csv"),
            unfinished(2, "/in/moved.csv"),
            unfinished(3, "/elsewhere/c.csv"),
            unfinished(4, "/share/d.csv"),
        ];
        let moved = found("/in/moved.csv");
        let look = FolderLooks {
            files: vec![(&moved, LookKind::Now)],
            folders: ["/in", "/share"].map(Path::new).into(),
            hidden: vec![Path::new("/share")],
            ..FolderLooks::default()
        };
        let start = Instant::now();
        let mut missing = Missing::default();
        let mut gone = |at: u64| missing.note(&runs, &look, SETTLE, start + Duration::from_secs(at));
        assert_eq!(gone(0), [0; 0]);
        assert_eq!(gone(99), [0; 0]);
        assert_eq!(gone(100), [1]);
    }

    #[test]
    fn a_file_that_comes_back_in_time_is_waited_for_anew() {
        let runs = [unfinished(1, "/in/a.csv")];
        let file = found("/in/a.csv");
        let look = |files| FolderLooks { files, folders: vec![Path::new("/in")], ..FolderLooks::default() };
        let (here, away) = (look(vec![(&file, LookKind::Now)]), look(Vec::new()));
        let start = Instant::now();
        let mut missing = Missing::default();
        for (at, look, is_gone) in [
            (0, &away, false),
            (90, &away, false),
            (95, &here, false),
            (110, &away, false),
            (210, &away, true),
        ] {
            let gone = missing.note(&runs, look, SETTLE, start + Duration::from_secs(at));
            assert_eq!(!gone.is_empty(), is_gone, "{at}");
        }
    }
}
