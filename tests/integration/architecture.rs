//! The map of ARCHITECTURE.md, held against the sources.

use std::fs;
use std::path::{Path, PathBuf};

/// A room, the rooms it may name, and the outside crates that live behind its door.
struct Room {
    name: &'static str,
    may_name: &'static [&'static str],
    door_to: &'static [&'static str],
}

const NOUNS: [&str; 4] = ["robot", "run", "analysis", "anomaly"];

const ROOMS: &[Room] = &[
    Room { name: "robot", may_name: &[], door_to: &["nalgebra"] },
    Room { name: "run", may_name: &["robot"], door_to: &[] },
    Room { name: "analysis", may_name: &["robot", "run", "numerics"], door_to: &[] },
    Room { name: "anomaly", may_name: &["robot", "analysis"], door_to: &[] },
    Room {
        name: "numerics",
        may_name: &["robot", "run", "analysis", "anomaly"],
        door_to: &["nalgebra", "faer", "sci_rs", "varpro"],
    },
    Room {
        name: "config",
        may_name: &["robot", "run", "analysis", "numerics"],
        door_to: &["nalgebra", "toml", "regex", "urdf_rs"],
    },
    Room { name: "telemetry", may_name: &[], door_to: &["tracing_subscriber"] },
    Room {
        name: "ingest",
        may_name: &["robot", "run", "config", "telemetry"],
        door_to: &["polars", "notify", "flate2", "zstd", "blake3", "encoding_rs"],
    },
    Room {
        name: "store",
        may_name: &["robot", "run", "analysis", "anomaly", "numerics", "config", "telemetry"],
        door_to: &["sqlx", "blake3"],
    },
    Room {
        name: "pipeline",
        may_name: &[
            "robot",
            "run",
            "analysis",
            "anomaly",
            "numerics",
            "config",
            "ingest",
            "store",
            "telemetry",
        ],
        door_to: &[],
    },
    Room { name: "alert", may_name: &["anomaly", "store", "config", "telemetry"], door_to: &[] },
    Room { name: "report", may_name: &["robot", "run", "analysis", "numerics"], door_to: &[] },
    Room {
        name: "simulate",
        may_name: &["robot", "run"],
        door_to: &["nalgebra", "rand", "rand_chacha", "rand_distr", "flate2"],
    },
    Room {
        name: "serve",
        may_name: &["run", "config", "ingest", "store", "telemetry"],
        door_to: &["axum", "hyper", "hyper_util"],
    },
    Room {
        name: "daemon",
        may_name: &["run", "alert", "config", "ingest", "pipeline", "serve", "store", "telemetry"],
        door_to: &[],
    },
    Room {
        name: "cli",
        may_name: &[
            "robot",
            "run",
            "analysis",
            "anomaly",
            "numerics",
            "config",
            "telemetry",
            "ingest",
            "store",
            "pipeline",
            "alert",
            "report",
            "simulate",
            "serve",
            "daemon",
        ],
        door_to: &["clap", "indicatif", "tempfile", "nalgebra"],
    },
];

/// Crates that belong to one room or a few.
fn guarded_crates() -> Vec<&'static str> {
    let mut crates: Vec<&str> = ROOMS.iter().flat_map(|room| room.door_to.iter().copied()).collect();
    crates.sort_unstable();
    crates.dedup();
    crates
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Files that are compiled for tests only: `#[cfg(test)] mod name;` stands in the file above them.
fn test_files(files: &[PathBuf]) -> Vec<String> {
    let mut names = Vec::new();
    for path in files {
        let text = fs::read_to_string(path).expect("a readable source");
        let lines: Vec<&str> = text.lines().map(str::trim).collect();
        for pair in lines.windows(2).filter(|pair| pair[0].starts_with("#[cfg(test)]")) {
            let declared = pair[1].split("mod ").nth(1).and_then(|rest| rest.strip_suffix(';'));
            names.extend(declared.map(|name| format!("{name}.rs")));
        }
    }
    names
}

/// Each source with the room it stands in and its text without comments and tests.
fn rooms_and_texts() -> Vec<(&'static Room, PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut found = Vec::new();
    sources(&root, &mut found);
    let for_tests = test_files(&found);
    let mut judged = Vec::new();
    for path in found {
        let inside = path.strip_prefix(&root).expect("under src");
        let first = inside.components().next().expect("a name").as_os_str().to_string_lossy().into_owned();
        let name = first.trim_end_matches(".rs").to_owned();
        let for_tests = for_tests.iter().any(|file| inside.ends_with(file));
        if ["lib", "main"].contains(&name.as_str()) || for_tests {
            continue;
        }
        let room = ROOMS.iter().find(|room| room.name == name);
        let room =
            room.unwrap_or_else(|| panic!("src/{first} is in no row of the map; decide where it belongs"));
        let text = fs::read_to_string(&path).expect("a readable source");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
        judged.push((room, path.clone(), lines.collect::<Vec<_>>().join("\n")));
    }
    judged
}

fn names(text: &str, path: &str) -> bool {
    text.match_indices(path).any(|(at, _)| {
        let before = text[..at].chars().next_back();
        let after = text[at + path.len()..].chars().next();
        let boundary = |c: Option<char>| !c.is_some_and(|c| c.is_alphanumeric() || c == '_');
        boundary(before) && boundary(after)
    })
}

#[test]
fn rooms_name_only_the_rooms_they_may() {
    let mut broken = Vec::new();
    for (room, path, text) in rooms_and_texts() {
        for other in
            ROOMS.iter().filter(|other| other.name != room.name && !room.may_name.contains(&other.name))
        {
            if names(&text, &format!("crate::{}", other.name)) {
                broken.push(format!("{} names crate::{}", path.display(), other.name));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn each_dependency_has_one_door() {
    let mut broken = Vec::new();
    for (room, path, text) in rooms_and_texts() {
        for guarded in guarded_crates().into_iter().filter(|guarded| !room.door_to.contains(guarded)) {
            if names(&text, &format!("{guarded}::")) || names(&text, &format!("use {guarded}")) {
                broken.push(format!("{} names {guarded}", path.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn numerics_and_nouns_touch_no_world() {
    let forbidden = [
        "async",
        "tokio",
        "std::fs",
        "std::io",
        "SystemTime",
        "Instant",
        "tracing",
        "rand",
        "println",
        "eprintln",
    ];
    let mut broken = Vec::new();
    for (room, path, text) in rooms_and_texts() {
        if room.name == "numerics" || NOUNS.contains(&room.name) {
            broken.extend(
                forbidden
                    .iter()
                    .filter(|word| names(&text, word))
                    .map(|word| format!("{} names {word}", path.display())),
            );
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn only_the_border_prints_and_nothing_panics_on_purpose() {
    let mut broken = Vec::new();
    for (_, path, text) in rooms_and_texts() {
        for word in [
            "println!",
            "eprintln!",
            "print!(",
            "dbg!",
            ".unwrap()",
            ".expect(\"",
            "panic!(",
            "todo!(",
            "unimplemented!(",
        ] {
            if text.contains(word) {
                broken.push(format!("{} has {word}", path.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}
