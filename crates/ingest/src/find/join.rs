//! Joins parts of recordings among the files of a scan: they count as one file.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};

use super::watch::FoundFile;
use crate::bytes::access::metadata;
use crate::bytes::parts::RecordingParts;
use armwatch_config::PartName;
use armwatch_model::text;

/// Replaces the paths of a recording's parts by the path of the recording, for files from a scan. `part_of` returns the
/// part in a file name.
///
/// Sizes are added, and the latest change counts. A recording that lacks a part waits for it ([`FoundFile::wait`]).
pub fn join_parts(files: Vec<FoundFile>, part_of: impl Fn(&str) -> Option<PartName>) -> Vec<FoundFile> {
    let named: Vec<Option<PartName>> =
        files.iter().map(|file| part_of(&text::of_file_name(&file.path))).collect();
    if named.iter().all(Option::is_none) {
        return files;
    }
    let there: HashSet<PathBuf> = files.iter().map(|file| file.path.clone()).collect();
    let mut recordings: BTreeMap<PathBuf, (RecordingParts, Vec<FoundFile>, PartName)> = BTreeMap::new();
    let mut joined = Vec::new();
    for (file, part) in files.into_iter().zip(named) {
        let parts = part.and_then(|part| {
            Some((RecordingParts::containing(&file.path, &part, |path| there.contains(path))?, part))
        });
        match parts {
            None => joined.push(file),
            Some((parts, part)) => {
                recordings.entry(parts.path()).or_insert_with(|| (parts, Vec::new(), part)).1.push(file);
            }
        }
    }
    for (path, (parts, mut files, part)) in recordings {
        let first = parts.first();
        files.sort_by_key(|file| file.path != first);
        let is_whole = parts.missing_among(|path| there.contains(path)).is_none();
        let count = files.len();
        let together = files.into_iter().reduce(|all, of| FoundFile {
            size: all.size.saturating_add(of.size),
            modified: all.modified.max(of.modified),
            is_marked: all.is_marked && of.is_marked,
            ..all
        });
        joined.extend(together.map(|file| match (is_whole, count) {
            // it may still grow, and no other follows it yet
            (true, 1) => file,
            (true, _) => FoundFile { path, ..file },
            (false, _) => FoundFile { path, wait: part.wait, is_marked: false, ..file },
        }));
    }
    joined.sort_by(|a, b| a.order().cmp(&b.order()));
    joined
}

/// Like [`join_parts`], for paths that a person named or a command found; parts next to them belong to them.
pub fn join_paths(paths: Vec<PathBuf>, part_of: impl Fn(&str) -> Option<PartName>) -> Vec<PathBuf> {
    let is_there = |path: &Path| metadata(path).is_ok();
    let mut seen = HashSet::new();
    let whole = |path: PathBuf| {
        let part = part_of(&text::of_file_name(&path));
        let parts = part.and_then(|part| RecordingParts::containing(&path, &part, is_there));
        match parts.filter(|parts| parts.missing_among(is_there).is_some() || parts.files().len() > 1) {
            // once, although each part represents it
            Some(parts) => Some(parts.path()).filter(|whole| seen.insert(whole.clone())),
            None => Some(path),
        }
    };
    paths.into_iter().filter_map(whole).collect()
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;
    use armwatch_model::run::FileId;

    fn found(name: &str, inode: u64) -> FoundFile {
        let file = FileId { device: 1, inode };
        let path = PathBuf::from("/in").join(name);
        FoundFile {
            path,
            size: inode,
            modified: SystemTime::UNIX_EPOCH,
            file,
            is_marked: false,
            wait: Duration::ZERO,
        }
    }

    /// Names such as `a_pos.csv` and `b_7.csv`.
    fn part_of(name: &str) -> Option<PartName> {
        let (stem, rest) = name.split_once('_')?;
        let part = rest.strip_suffix(".csv")?;
        let is_number = part.parse::<u64>().is_ok();
        let names = if is_number { Vec::new() } else { vec!["pos".into(), "trq".into()] };
        let wait = Duration::from_secs(9);
        Some(PartName {
            before: format!("{stem}_"),
            part: part.into(),
            after: ".csv".into(),
            names,
            wait,
            is_told: true,
        })
    }

    #[test]
    fn parts_count_as_one_file_and_a_missing_one_is_waited_for() {
        let names =
            ["a_trq.csv", "a_pos.csv", "b_trq.csv", "c_0.csv", "d_0.csv", "d_1.csv", "d_3.csv", "e.csv"];
        let files = (1..).zip(names).map(|(inode, name)| found(name, inode)).collect();
        let joined = join_parts(files, part_of);
        let seen: Vec<(String, u64, u64, bool)> = joined
            .iter()
            .map(|of| (text::of_file_name(&of.path), of.size, of.file.inode, of.wait > Duration::ZERO))
            .collect();
        let expected = [
            ("a_{pos|trq}.csv", 3, 2, false),
            ("b_{pos|trq}.csv", 3, 3, true),
            ("c_0.csv", 4, 4, false),
            ("d_{0+}.csv", 11, 5, false),
            ("d_{3+}.csv", 7, 7, true),
            ("e.csv", 8, 8, false),
        ];
        assert_eq!(seen, expected.map(|(name, size, inode, waits)| (name.to_owned(), size, inode, waits)));
    }

    #[test]
    fn a_part_that_a_person_names_stands_for_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["a_trq.csv", "d_0.csv", "d_1.csv", "e.csv"] {
            std::fs::write(path(name), name).unwrap();
        }
        let named = ["d_1.csv", "e.csv", "d_0.csv", "a_trq.csv"].map(path).to_vec();
        assert_eq!(join_paths(named, part_of), ["d_{0+}.csv", "e.csv", "a_{pos|trq}.csv"].map(path));
    }
}
