//! The shipped files work unchanged.

use std::fs;
use std::path::Path;

use crate::support::Workshop;

#[test]
fn every_shipped_robot_passes_its_check() {
    let workshop = Workshop::new();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robots");
    let mut robots = 0;
    for entry in fs::read_dir(folder).expect("robots") {
        let path = entry.expect("an entry").path();
        let out = workshop.stdout(&["robot", "check", path.to_str().expect("a path")], 0);
        assert!(out.lines().count() > 30, "{out}");
        robots += 1;
    }
    assert!(robots >= 2, "{robots}");
}

#[test]
fn the_shipped_configuration_has_no_problems() {
    let workshop = Workshop::new();
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/armwatch.toml");
    let out = workshop.stdout(&["config", "check", "--config", config.to_str().expect("a path")], 0);
    assert!(out.contains("no problems") && out.contains("er3a"), "{out}");
    // the binary alone, in an empty folder, has it too
    fs::remove_file(workshop.path("armwatch.toml")).expect("removed");
    let out = workshop.stdout(&["config", "check"], 0);
    assert!(out.contains("shipped configuration"), "{out}");
}

#[test]
fn the_readme_names_the_two_commands_and_the_page_of_the_views() {
    let readme =
        fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md")).expect("a README");
    for said in ["cargo run --release -- demo", "cargo test", "(docs/schema.md)"] {
        assert!(readme.contains(said), "{said}");
    }
}
