//! Gives the program hashes of the sources that decide its results. Results that an older program has kept are computed again where
//! the hash differs.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Sources of the findings of detectors, and of friction indices. All indices of a robot are computed again when the second hash
/// changes, which reads its whole history, so it covers no more than these.
const HASHED: [(&str, &[&str]); 2] = [
    ("METHOD", &["Cargo.lock", "crates/method/src", "crates/model/src", "crates/store/src/robot"]),
    (
        "INDEX_METHOD",
        &["crates/method/src/friction", "crates/method/src/statistics", "crates/store/src/robot/indices"],
    ),
];

fn main() -> io::Result<()> {
    for (name, sources) in HASHED {
        let mut hasher = DefaultHasher::new();
        for source in sources {
            println!("cargo::rerun-if-changed={source}");
            add(Path::new(source), &mut hasher)?;
        }
        println!("cargo::rustc-env=ARMWATCH_{name}={}", hasher.finish());
    }
    Ok(())
}

/// Adds a file, or all files of a folder by name.
fn add(path: &Path, hasher: &mut DefaultHasher) -> io::Result<()> {
    if !path.is_dir() {
        (path.to_string_lossy(), fs::read(path)?).hash(hasher);
        return Ok(());
    }
    let entries = fs::read_dir(path)?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<PathBuf>>>();
    let mut entries = entries?;
    entries.sort();
    entries.iter().try_for_each(|entry| add(entry, hasher))
}
