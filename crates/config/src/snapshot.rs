//! `[snapshot]`: a copy of the database that any user and machine can read.

use std::path::{Component, Path, PathBuf};
use std::time::Duration;

use super::toml::range::Limits;
use super::toml::table::{Table, Value};

const DEFAULT_INTERVAL_MIN: f64 = 15.0;

/// Time and path of copies that the daemon writes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SnapshotSettings {
    /// The file, which is replaced each time.
    pub file: PathBuf,
    /// Least time between two copies.
    pub interval: Duration,
}

/// Reads `[snapshot]`, with `database` if that is known; outer `None` after a problem, inner without the section.
pub(super) fn read_snapshot(
    table: Option<&Table<'_>>,
    database: Option<&str>,
) -> Option<Option<SnapshotSettings>> {
    let Some(table) = table else { return Some(None) };
    let file = table.required("file").and_then(|value| read_file(&value, database));
    let interval = Limits::between(0.1, 10_080.0, "min");
    let interval = table.number_or("interval_min", &interval, DEFAULT_INTERVAL_MIN);
    Some(Some(SnapshotSettings {
        file: file?,
        interval: Duration::try_from_secs_f64(60.0 * interval?).ok()?,
    }))
}

/// The file of the copy, which must not be the database: no copy is ever written over that.
fn read_file(value: &Value<'_>, database: Option<&str>) -> Option<PathBuf> {
    let file = PathBuf::from(value.text()?);
    if database.is_some_and(|database| resolved(&file) == resolved(Path::new(database))) {
        let hint = "name another file, such as \"snapshot/armwatch.db\"".to_owned();
        value.refuse("is the database itself".into(), Some(hint));
        return None;
    }
    Some(file)
}

/// The unique path of all that name a file, resolved even if the file or its folder is reached over a link, or does not
/// exist yet.
fn resolved(path: &Path) -> PathBuf {
    real(&std::path::absolute(path).unwrap_or_else(|_| path.to_owned()))
}

fn real(path: &Path) -> PathBuf {
    if let Ok(real) = path.canonicalize() {
        return real;
    }
    let mut components = path.components();
    match components.next_back() {
        Some(Component::Normal(name)) => real(components.as_path()).join(name),
        Some(Component::ParentDir) => {
            let mut folder = real(components.as_path());
            folder.pop();
            folder
        }
        _ => path.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_has_one_path_however_it_is_spelt() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("data")).unwrap();
        std::fs::write(at("data/fleet.db"), "").unwrap();
        std::os::unix::fs::symlink(at("data"), at("link")).unwrap();
        std::os::unix::fs::symlink(at("data/fleet.db"), at("fleet.db")).unwrap();
        let database = resolved(&at("data/fleet.db"));
        for spelt in ["data/./fleet.db", "data/../data/fleet.db", "link/fleet.db", "fleet.db"] {
            assert_eq!(resolved(&at(spelt)), database, "{spelt}");
        }
        assert_ne!(resolved(&at("data/copy.db")), database);
        // before the file or even its folder exists
        let new = resolved(&at("data/new.db"));
        for spelt in ["link/new.db", "none/../data/new.db"] {
            assert_eq!(resolved(&at(spelt)), new, "{spelt}");
        }
        assert_eq!(resolved(Path::new("a/b.db")), resolved(Path::new("./a/./b.db")));
        assert_ne!(resolved(Path::new("a/b.db")), resolved(Path::new("b.db")));
    }
}
