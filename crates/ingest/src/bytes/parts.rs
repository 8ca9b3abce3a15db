//! Recordings in several files. The path of such a recording names its parts, so that no other data is needed for them:
//! `R01_0800_{pos|trq}.csv` has two parts by name, and `R01_0800_part{0+}.csv` has part 0 and those that follow it.

use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::access::metadata;
use super::fingerprint::{extent, id_of};
use armwatch_config::PartName;
use armwatch_model::run::FileId;

/// Most parts of a recording: a year of one-hour parts.
const MOST_PARTS: u64 = 10_000;

/// The files of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingParts {
    folder: PathBuf,
    before: String,
    after: String,
    which: Which,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Which {
    Named(Vec<String>),
    /// This number, with at least so many digits, and those that follow it.
    From(u64, usize),
}

/// Size, latest change and number of an export; for several files their sum, the latest, and that of the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileState {
    /// Bytes.
    pub bytes: u64,
    /// Latest change of content or metadata, see [`changed_at`](super::fingerprint::changed_at).
    pub changed: SystemTime,
    /// Latest modification.
    pub modified: SystemTime,
    /// Number.
    pub file: FileId,
}

impl RecordingParts {
    /// The parts that a path names; `None` for a path of one file.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?;
        let (before, rest) = name.split_once('{')?;
        let (inner, after) = rest.split_once('}')?;
        let which = match inner.strip_suffix('+') {
            Some(digits) => Which::From(digits.parse().ok()?, digits.len()),
            None if inner.contains('|') => Which::Named(inner.split('|').map(str::to_owned).collect()),
            None => return None,
        };
        let folder = path.parent()?.to_owned();
        Some(Self { folder, before: before.to_owned(), after: after.to_owned(), which })
    }

    /// The recording that contains the file at `path`. If the parts are numbered, it begins with the first in the
    /// unbroken sequence up to this one. `None` if only the name contains a number and the first number is missing: the
    /// number may have another meaning.
    pub fn containing(path: &Path, part: &PartName, is_there: impl Fn(&Path) -> bool) -> Option<Self> {
        let PartName { before, part, after, names, is_told, .. } = part;
        let mut found = Self {
            folder: path.parent()?.to_owned(),
            before: before.clone(),
            after: after.clone(),
            which: Which::Named(names.clone()),
        };
        if names.is_empty() {
            let mut number: u64 = part.parse().ok()?;
            // numbers without leading zeros become longer
            let mut width = if part.starts_with('0') { part.len() } else { 1 };
            let has = |number: u64, width: usize| is_there(&found.file(&padded(number, width)));
            if !is_told && !(0..=1).any(|first| has(first, width) || has(first, part.len())) {
                return None;
            }
            while number > 0 {
                width = match [width, part.len()].into_iter().find(|width| has(number - 1, *width)) {
                    Some(width) => width,
                    None => break,
                };
                number -= 1;
            }
            found.which = Which::From(number, padded(number, width).len());
        }
        Some(found)
    }

    fn file(&self, part: &str) -> PathBuf {
        self.folder.join(format!("{}{part}{}", self.before, self.after))
    }

    /// The path that represents all parts.
    pub fn path(&self) -> PathBuf {
        self.file(&match &self.which {
            Which::Named(names) => format!("{{{}}}", names.join("|")),
            Which::From(number, width) => format!("{{{}+}}", padded(*number, *width)),
        })
    }

    /// The file whose name identifies the recording: that of the first part.
    pub fn first(&self) -> PathBuf {
        self.file(&match &self.which {
            Which::Named(names) => names.first().cloned().unwrap_or_default(),
            Which::From(number, width) => padded(*number, *width),
        })
    }

    /// The files, with the names of the parts: all named ones, and the existing numbered ones.
    pub fn files(&self) -> Vec<(String, PathBuf)> {
        let with_file = |part: String| (part.clone(), self.file(&part));
        match &self.which {
            Which::Named(names) => names.iter().cloned().map(with_file).collect(),
            Which::From(first, width) => (*first..first.saturating_add(MOST_PARTS))
                .map(|number| with_file(padded(number, *width)))
                .enumerate()
                .take_while(|(at, (_, file))| *at == 0 || metadata(file).is_ok())
                .map(|(_, file)| file)
                .collect(),
        }
    }

    /// The paths that represented the numbered parts from the third on while an earlier one was missing.
    pub fn later(&self) -> Vec<PathBuf> {
        let Which::From(first, width) = self.which else { return Vec::new() };
        let numbers = (first..).skip(2).take(self.files().len().saturating_sub(2));
        let from = |number| Self { which: Which::From(number, padded(number, width).len()), ..self.clone() };
        numbers.map(|number| from(number).path()).collect()
    }

    /// The first file that is missing.
    pub fn missing(&self) -> Option<PathBuf> {
        self.missing_among(|file| metadata(file).is_ok())
    }

    /// The first file that does not exist, by `is_there`. Numbers begin with 0 or 1.
    pub fn missing_among(&self, is_there: impl Fn(&Path) -> bool) -> Option<PathBuf> {
        match &self.which {
            Which::From(number, width) if *number > 1 => Some(self.file(&padded(number - 1, *width))),
            Which::From(..) => Some(self.first()).filter(|file| !is_there(file)),
            Which::Named(names) => names.iter().map(|name| self.file(name)).find(|file| !is_there(file)),
        }
    }
}

fn padded(number: u64, width: usize) -> String {
    format!("{number:0width$}")
}

/// The files at `path`, in their order: itself, or the parts that it names.
pub fn files(path: &Path) -> Vec<PathBuf> {
    RecordingParts::of(path).map_or_else(
        || vec![path.to_owned()],
        |parts| parts.files().into_iter().map(|(_, file)| file).collect(),
    )
}

/// The file whose name identifies the recording at `path`.
pub fn named_by(path: &Path) -> PathBuf {
    RecordingParts::of(path).map_or_else(|| path.to_owned(), |parts| parts.first())
}

/// The state of the recording at `path`.
///
/// # Errors
/// Those of the file system, for the first file that has one.
pub fn state(path: &Path) -> io::Result<FileState> {
    let of_file = |file: &PathBuf| {
        let metadata = metadata(file)?;
        let modified = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        let (bytes, changed) = extent(file, &metadata);
        Ok(FileState { bytes, changed, modified, file: id_of(&metadata) })
    };
    let states: Vec<FileState> = files(path).iter().map(of_file).collect::<io::Result<_>>()?;
    joined(states).ok_or_else(|| io::ErrorKind::NotFound.into())
}

/// The combined state of several files.
pub(crate) fn joined(states: impl IntoIterator<Item = FileState>) -> Option<FileState> {
    states.into_iter().reduce(|all, of| FileState {
        bytes: all.bytes.saturating_add(of.bytes),
        changed: all.changed.max(of.changed),
        modified: all.modified.max(of.modified),
        file: all.file,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(before: &str, part: &str, names: &[&str]) -> PartName {
        PartName {
            before: before.into(),
            part: part.into(),
            after: ".csv".into(),
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            wait: std::time::Duration::ZERO,
            is_told: true,
        }
    }

    #[test]
    fn a_path_names_its_parts_and_the_first_that_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in
            ["a_9.csv", "a_10.csv", "a_11.csv", "a_13.csv", "b_08.csv", "b_09.csv", "b_10.csv", "c_q.csv"]
        {
            std::fs::write(path(name), name).unwrap();
        }
        let names = |parts: &RecordingParts| -> Vec<String> {
            let files = parts.files().into_iter();
            files.map(|(_, file)| file.file_name().unwrap().to_string_lossy().into_owned()).collect()
        };
        let a = RecordingParts::containing(&path("a_11.csv"), &part("a_", "11", &[]), |path| path.exists())
            .unwrap();
        assert_eq!(
            (a.path(), names(&a)),
            (path("a_{9+}.csv"), vec!["a_9.csv".into(), "a_10.csv".into(), "a_11.csv".into()])
        );
        assert_eq!(a.missing(), Some(path("a_8.csv")));
        let b = RecordingParts::containing(&path("b_09.csv"), &part("b_", "09", &[]), |path| path.exists())
            .unwrap();
        assert_eq!((b.path(), names(&b).len()), (path("b_{08+}.csv"), 3));
        assert_eq!(
            RecordingParts::containing(&path("b_10.csv"), &part("b_", "10", &[]), |path| path.exists()),
            Some(b.clone())
        );
        let late =
            RecordingParts::containing(&path("a_13.csv"), &part("a_", "13", &[]), |path| path.exists())
                .unwrap();
        assert_eq!(late.missing(), Some(path("a_12.csv")));
        let c = RecordingParts::containing(&path("c_q.csv"), &part("c_", "q", &["q", "tau"]), |path| {
            path.exists()
        })
        .unwrap();
        assert_eq!((c.path(), c.missing()), (path("c_{q|tau}.csv"), Some(path("c_tau.csv"))));
        // a number that is not in the layout
        let unexplained = PartName { is_told: false, ..part("a_", "11", &[]) };
        assert_eq!(RecordingParts::containing(&path("a_11.csv"), &unexplained, |path| path.exists()), None);
        for parts in [a, b, c] {
            assert_eq!(RecordingParts::of(&parts.path()), Some(parts));
        }
        for name in ["a.csv", "a_{x}.csv", "a_{1.csv"] {
            assert_eq!(RecordingParts::of(&path(name)), None, "{name}");
        }
    }
}
