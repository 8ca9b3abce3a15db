//! Rules of ARCHITECTURE.md that neither Cargo nor Clippy can express, checked on manifests and sources.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use regex::Regex;

/// External crates that nouns and method may depend on: numerics, formats, dates and forms of text.
const PURE: [&str; 10] = [
    "faer",
    "jiff",
    "nalgebra",
    "postcard",
    "pulp",
    "serde",
    "statrs",
    "thiserror",
    "unicode-normalization",
    "varpro",
];

/// Drivers of databases.
const DRIVERS: [&str; 3] = ["rusqlite", "sqlx", "sqlx-core"];

/// Beginning of a statement in a string literal.
const STATEMENT: &str = concat!(
    r#"[^\\]"(\\\n)?\s*(ALTER|ATTACH|BEGIN IMMEDIATE|CREATE|DELETE FROM|DROP|INSERT INTO|"#,
    "PRAGMA|SELECT|UPDATE|VACUUM|WITH RECURSIVE) ",
);

/// Files of the root package with a standard stream: one prints, one gives the log its stream.
const OF_STREAMS: [&str; 2] = ["cli/shared/output.rs", "telemetry.rs"];

/// Source files by their path below a folder, with `/` between folders.
type Sources = BTreeMap<String, String>;

fn pattern(text: &str) -> Regex {
    Regex::new(text).expect("a pattern")
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn manifest(folder: &Path) -> toml::Table {
    fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest").parse().expect("TOML")
}

/// Folders of all packages of the workspace by name.
fn packages() -> BTreeMap<String, PathBuf> {
    let mut folders = vec![root().to_owned()];
    for member in manifest(root())["workspace"]["members"].as_array().expect("members") {
        match member.as_str().expect("a path").strip_suffix("/*") {
            Some(parent) => folders.extend(entries(&root().join(parent))),
            None => folders.push(root().join(member.as_str().expect("a path"))),
        }
    }
    folders.retain(|folder| folder.join("Cargo.toml").exists());
    let name = |folder: &Path| manifest(folder)["package"]["name"].as_str().expect("a name").to_owned();
    folders.into_iter().map(|folder| (name(&folder), folder)).collect()
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()).collect()
}

/// Dependencies of a package, without those of its tests.
fn dependencies(folder: &Path) -> BTreeSet<String> {
    manifest(folder)["dependencies"].as_table().expect("a table").keys().cloned().collect()
}

fn sources(folder: &Path) -> Sources {
    let mut found = Sources::new();
    let mut left = vec![folder.to_owned()];
    while let Some(path) = left.pop() {
        if path.is_dir() {
            left.extend(entries(&path));
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let name = path.strip_prefix(folder).expect("below it").to_string_lossy().replace('\\', "/");
            found.insert(name, fs::read_to_string(&path).expect("a readable source"));
        }
    }
    found
}

/// The module of a file: `a/b` for `a/b.rs` and `a/b/mod.rs`, empty for `lib.rs` and `main.rs`.
fn module(path: &str) -> &str {
    let path = path.trim_end_matches(".rs");
    if ["lib", "main"].contains(&path) { "" } else { path.trim_end_matches("/mod") }
}

/// Sources without comments and tests. Modules of tests are the last items of their files, as Clippy demands.
fn code(sources: &Sources) -> Sources {
    let of_tests = pattern(r"#\[cfg\(test\)\]\s+(?:pub(?:\([^)]*\))? )?mod (\w+)( \{|;)");
    let mut outside = Vec::new();
    let mut stripped = Sources::new();
    for (path, text) in sources {
        let mut end = text.len();
        for found in of_tests.captures_iter(text) {
            if &found[2] == ";" {
                outside.push(format!("{}/{}", module(path), &found[1]).trim_start_matches('/').to_owned());
            } else {
                end = end.min(found.get(0).map_or(end, |whole| whole.start()));
            }
        }
        let lines = text[..end].lines().filter(|line| !line.trim_start().starts_with("//"));
        stripped.insert(path.clone(), lines.collect::<Vec<_>>().join("\n"));
    }
    stripped.retain(|path, _| !outside.iter().any(|tests| Path::new(module(path)).starts_with(tests)));
    stripped
}

/// All names that can be reached from each name over one or more arrows.
fn reached(arrows: &BTreeMap<String, BTreeSet<String>>) -> BTreeMap<&String, BTreeSet<&String>> {
    let from = |name| {
        let (mut found, mut left) = (BTreeSet::new(), vec![name]);
        while let Some(name) = left.pop() {
            left.extend(arrows.get(name).into_iter().flatten().filter(|to| found.insert(*to)));
        }
        (name, found)
    };
    arrows.keys().map(from).collect()
}

/// Modules directly below the root of a crate that depend on themselves through others. `pub use` in `lib.rs` only
/// re-exports names; elsewhere it is no dependency.
fn circles(sources: &Sources) -> Vec<String> {
    let handed_on = pattern(r"pub use (?:self::|crate::)?(\w+)::([^;]+);");
    let named = pattern(r"(?:pub )?(?:use )?\bcrate::(?:(\w+)|\{([^;]*?)\})");
    let word = pattern(r"\w+");
    let mut owners = BTreeMap::new();
    for found in handed_on.captures_iter(sources.get("lib.rs").map_or("", String::as_str)) {
        let (_, [owner, items]) = found.extract();
        owners.extend(word.find_iter(items).map(|item| (item.as_str(), owner)));
    }
    let tops: BTreeSet<&str> = sources.keys().filter_map(|path| module(path).split('/').next()).collect();
    let mut arrows: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (path, text) in sources.iter().filter(|(path, _)| !module(path).is_empty()) {
        let (top, depth) =
            (module(path).split('/').next().unwrap_or_default(), module(path).split('/').count());
        let text = text.replace(&"super::".repeat(depth), "crate::");
        for found in named.captures_iter(&text).filter(|found| !found[0].starts_with("pub use")) {
            let names = found.get(1).or(found.get(2)).map_or("", |names| names.as_str());
            for name in word.find_iter(names).map(|name| name.as_str()) {
                let to = owners.get(name).copied().unwrap_or(name);
                if tops.contains(to) && to != top {
                    arrows.entry(top.to_owned()).or_default().insert(to.to_owned());
                }
            }
        }
    }
    let reached = reached(&arrows);
    let in_circle = arrows.iter().filter(|(from, _)| reached[from].contains(from));
    in_circle.map(|(from, to)| format!("{from}: {to:?}")).collect()
}

/// Invented sources, from pairs of path and text.
fn planted<const N: usize>(files: [(&str, &str); N]) -> Sources {
    files.map(|(path, text)| (path.to_owned(), text.to_owned())).into()
}

#[test]
fn every_package_has_the_settings_of_the_workspace() {
    for (name, folder) in packages() {
        let manifest = manifest(&folder);
        let package = manifest["package"].as_table().expect("a table");
        let of_package = ["version", "edition", "rust-version", "license"].map(|key| (key, package.get(key)));
        for (key, value) in of_package.into_iter().chain([("lints", manifest.get("lints"))]) {
            let inherits = value.and_then(|value| value.get("workspace"));
            assert_eq!(inherits, Some(&true.into()), "{name}: {key}");
        }
    }
}

#[test]
fn every_dependency_is_named_by_a_source() {
    for (name, folder) in packages() {
        let sources = sources(&folder.join("src"));
        let is_named = |text: &str| sources.values().any(|source| source.contains(&format!("{text}::")));
        let mut unused = dependencies(&folder);
        unused.retain(|dependency| !is_named(&dependency.replace('-', "_")));
        assert!(unused.is_empty(), "{name} names none of {unused:?}");
    }
}

/// The simulator is independent of the method that it tests. Settings and the store know its results only.
#[test]
fn simulator_settings_and_store_do_not_reach_the_method() {
    let arrows = packages().into_iter().map(|(name, folder)| (name, dependencies(&folder))).collect();
    let reached = reached(&arrows);
    let reaches_method = |name: &str| reached[&name.to_owned()].iter().any(|to| *to == "armwatch-method");
    assert!(reaches_method("armwatch"), "the program reaches the method");
    for name in ["simulate", "config", "ingest", "store"] {
        assert!(!reaches_method(&format!("armwatch-{name}")), "{name} reaches the method");
    }
}

#[test]
fn nouns_and_method_depend_on_pure_crates() {
    for name in ["armwatch-model", "armwatch-method"] {
        let mut impure = dependencies(&packages()[name]);
        impure.retain(|name| !PURE.contains(&name.as_str()) && name != "armwatch-model");
        assert!(impure.is_empty(), "{name} depends on {impure:?}");
    }
}

#[test]
fn only_the_store_holds_sql() {
    let statement = pattern(STATEMENT);
    for text in ["query(\"SELECT 1\")", "(\"\\\n    DELETE FROM run\")"] {
        assert!(statement.is_match(text), "{text}");
    }
    for (name, folder) in packages().into_iter().filter(|(name, _)| name != "armwatch-store") {
        assert!(dependencies(&folder).iter().all(|name| !DRIVERS.contains(&name.as_str())), "{name}");
        for (path, text) in code(&sources(&folder.join("src"))) {
            let found = statement.find(&text).map(|found| found.as_str());
            assert_eq!(found, None, "{name}, {path}");
        }
    }
}

#[test]
fn modules_depend_on_each_other_in_no_circle() {
    let circle = planted([
        ("lib.rs", "pub use c::{Other, Row};"),
        ("a/mod.rs", "use super::b::B;\n#[cfg(test)]\nmod tests {\nuse crate::d; }"),
        ("b.rs", "use crate::Row;"),
        ("c/deep.rs", "use super::super::{a, d};"),
        ("d.rs", "pub use crate::a::A;\n    // crate::b"),
    ]);
    let found = circles(&code(&circle));
    assert_eq!(found.iter().map(|told| &told[..1]).collect::<String>(), "abc", "{found:?}");
    for (name, folder) in packages() {
        let found = circles(&code(&sources(&folder.join("src"))));
        assert!(found.is_empty(), "{name}: modules that depend on themselves through others: {found:?}");
    }
}

#[test]
fn one_file_prints() {
    let is_stream = |line: &str| {
        (line.contains("io::stdout") || line.contains("io::stderr")) && !line.contains("is_terminal")
    };
    let mut code = code(&sources(&root().join("src")));
    code.retain(|_, text| text.lines().any(is_stream));
    assert_eq!(code.into_keys().collect::<Vec<_>>(), OF_STREAMS);
}

/// Long tests of `a.rs` are in `a/tests.rs` or `a/TOPIC_tests.rs`.
#[test]
fn files_of_tests_are_in_the_folder_of_their_subject() {
    for (name, folder) in packages() {
        let sources = sources(&folder.join("src"));
        let modules: BTreeSet<&str> = sources.keys().map(|path| module(path)).collect();
        for path in modules.iter().filter(|path| path.ends_with("tests") && path.contains('/')) {
            let owner = path.rsplit_once('/').map_or("", |(owner, _)| owner);
            assert!(modules.contains(owner), "{name}: {path} belongs to no file");
            let next_to_it = path.strip_suffix("_tests").filter(|subject| modules.contains(subject));
            assert_eq!(next_to_it, None, "{name}: {path} is next to its subject");
        }
    }
}

/// Tests wait for an event with a deadline: one file sleeps.
#[test]
fn tests_wait_for_events() {
    let sources = sources(&root().join("tests/integration"));
    let sleeping = sources.iter().filter(|(_, text)| text.contains(concat!("sle", "ep(")));
    assert_eq!(sleeping.map(|(path, _)| path.as_str()).collect::<Vec<_>>(), ["support.rs"]);
}

/// Clippy sees `#[allow]` before items only.
#[test]
fn no_file_silences_lints_without_a_reason() {
    for (name, folder) in packages() {
        for (path, text) in ["src", "tests", "benches"].iter().flat_map(|part| sources(&folder.join(part))) {
            assert!(!text.contains(concat!("#![al", "low(")), "{name}, {path}");
        }
    }
}
