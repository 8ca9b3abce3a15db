//! ARCHITECTURE.md, held against the sources: which room names which, and inside a room which place names which;
//! which outside crates stand behind which door; and the invariants that can be seen in a name. All code is read but
//! what is compiled for tests only.

mod arrows;
mod places;
mod planted;
mod rules;
mod source;
mod table;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use self::source::{Code, Sources};
use self::table::Rules;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn text() -> String {
    fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md")
}

fn document() -> Rules {
    Rules::read(&text()).unwrap_or_else(|problem| panic!("{problem}"))
}

/// Crates that the program is built with, with `_` for `-`.
fn dependencies() -> BTreeSet<String> {
    let text = fs::read_to_string(root().join("Cargo.toml")).expect("Cargo.toml");
    let manifest: toml::Table = text.parse().expect("TOML");
    let tables = manifest.iter().filter(|(key, _)| *key == "dependencies");
    let names = tables.filter_map(|(_, table)| table.as_table()).flat_map(|table| table.keys());
    names.map(|name| name.replace('-', "_")).collect()
}

fn sources() -> Sources {
    let mut found = Sources::new();
    let src = root().join("src");
    let mut folders = vec![src.clone()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of sources") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let name = path.strip_prefix(&src).expect("under src").to_string_lossy().replace('\\', "/");
                found.insert(name, fs::read_to_string(&path).expect("a readable source"));
            }
        }
    }
    found
}

/// The sources, parsed once for all tests.
fn program() -> &'static [Code] {
    static PROGRAM: OnceLock<Vec<Code>> = OnceLock::new();
    let parsed = || source::program(&sources());
    PROGRAM.get_or_init(|| parsed().unwrap_or_else(|problems| panic!("{}", problems.join("\n"))))
}

#[test]
fn the_sources_keep_the_rules_of_the_map() {
    let broken = rules::violations(program(), &document(), &dependencies());
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn the_files_of_a_room_name_each_other_in_no_circle() {
    let circles = arrows::circles(program());
    assert!(circles.is_empty(), "{}", circles.join("\n"));
}

/// To give a room a table, write its heading into ARCHITECTURE.md: this test then prints the rows.
#[test]
fn the_places_of_a_room_keep_the_rules_of_its_table() {
    let tables = places::read(&text()).unwrap_or_else(|problem| panic!("{problem}"));
    let broken = places::violations(program(), &tables);
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_row_of_the_map_is_a_room() {
    let rooms: BTreeSet<String> = program().iter().map(|code| code.room().to_owned()).collect();
    let gone: Vec<String> = document().rooms.into_iter().map(|room| room.name).collect();
    let gone: Vec<&String> = gone.iter().filter(|name| !rooms.contains(*name)).collect();
    assert!(gone.is_empty(), "rooms of ARCHITECTURE.md without a source: {gone:?}");
}

#[test]
fn every_dependency_stands_behind_a_door_of_the_map() {
    let (dependencies, named) = (dependencies(), document().crates());
    let without: Vec<&String> = dependencies.difference(&named).collect();
    assert!(without.is_empty(), "crates in Cargo.toml and in no table of ARCHITECTURE.md: {without:?}");
    let gone: Vec<&String> = named.difference(&dependencies).collect();
    assert!(gone.is_empty(), "crates in ARCHITECTURE.md and not in Cargo.toml: {gone:?}");
}

#[test]
fn every_dependency_is_named_by_a_source() {
    let sources = sources();
    let named = |name: &String| sources.values().any(|text| text.contains(&format!("{name}::")));
    let unused: Vec<String> = dependencies().into_iter().filter(|name| !named(name)).collect();
    assert!(unused.is_empty(), "crates in Cargo.toml that no source names: {unused:?}");
}

/// What a test finds is waited for with a deadline, not slept for: one function sleeps.
#[test]
fn tests_wait_for_events() {
    let mut folders = vec![root().join("tests/integration")];
    let mut sleeping = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of tests") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let text = fs::read_to_string(&path).expect("a readable source");
                let count = text.matches(concat!("sle", "ep(")).count();
                sleeping.extend(
                    (count > 0).then(|| (path.strip_prefix(root()).expect("under it").to_owned(), count)),
                );
            }
        }
    }
    assert_eq!(sleeping, [(Path::new("tests/integration/support.rs").to_owned(), 1)]);
}

/// Files of tests that lie beside their subject, or in a folder that belongs to no file.
fn misplaced_tests(paths: &[&str]) -> Vec<String> {
    let there = |path: String| paths.contains(&path.as_str());
    let misplaced = |path: &&&str| {
        let (folder, name) = path.rsplit_once('/').unwrap_or(("", path));
        let Some(topic) = name.strip_suffix("tests.rs") else {
            return name.starts_with("tests_");
        };
        let has_owner = there(format!("{folder}.rs")) || there(format!("{folder}/mod.rs"));
        let beside = there(format!("{folder}/{}.rs", topic.trim_end_matches('_')));
        !has_owner || beside
    };
    paths.iter().filter(misplaced).map(ToString::to_string).collect()
}

#[test]
fn long_tests_lie_in_the_folder_of_what_they_test() {
    let sources = sources();
    let paths: Vec<&str> = sources.keys().map(String::as_str).collect();
    let misplaced = misplaced_tests(&paths);
    assert!(misplaced.is_empty(), "see \"Inside the rooms\" in ARCHITECTURE.md: {misplaced:?}");
    let planted = [
        "a/b.rs",
        "a/b/tests.rs",
        "a/b/odd_tests.rs",
        "a/mod.rs",
        "a/b_tests.rs",
        "a/c/tests.rs",
        "a/tests_b.rs",
    ];
    assert_eq!(misplaced_tests(&planted), ["a/b_tests.rs", "a/c/tests.rs", "a/tests_b.rs"]);
}

#[test]
fn the_simulator_is_a_second_road_to_the_truth() {
    let reached = document().reach("simulate");
    assert!(!reached.contains("numerics"), "by the map, simulate comes to numerics: {reached:?}");
    let settings = document().reach("robot");
    assert!(settings.is_empty(), "the first noun names {settings:?}");
}
