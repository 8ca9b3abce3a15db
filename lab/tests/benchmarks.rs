//! Benchmarks measure the armwatch that `cargo test` has built next to the lab.

#![expect(clippy::expect_used, reason = "helper functions of tests")]

use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

/// The program that is measured.
fn armwatch() -> PathBuf {
    let program = PathBuf::from(env!("CARGO_BIN_EXE_armwatch-lab")).with_file_name("armwatch");
    assert!(program.is_file(), "there is no {}; run `cargo build` first", program.display());
    program
}

/// Standard output of a command that must end with the status `code`.
fn run(command: &mut Command, code: i32) -> String {
    let output = command.env_remove("ARMWATCH_CONFIG").output().expect("the program starts");
    let [out, err] = [output.stdout, output.stderr].map(|of| String::from_utf8_lossy(&of).into_owned());
    assert_eq!(output.status.code(), Some(code), "{command:?}\n{out}\n{err}");
    out
}

fn stdout(folder: &TempDir, arguments: &[&str], code: i32) -> String {
    armwatch();
    run(Command::new(env!("CARGO_BIN_EXE_armwatch-lab")).args(arguments).current_dir(folder), code)
}

/// The values depend on the machine, so only their relations are tested.
#[test]
fn the_ingest_benchmark_measures_two_programs_on_the_same_rows() {
    let folder = tempfile::tempdir().expect("a folder");
    let simulated = ["simulate", "-o", "made", "--cycles", "1", "--warming-s", "0"];
    let out = run(Command::new(armwatch()).args(simulated).current_dir(&folder), 0);
    let export = &folder.path().join(out.split(" (").next().expect("a path"));
    let rows = std::fs::read_to_string(export).expect("an export").lines().count() - 1;
    let file = export.to_str().expect("a plain path");
    let out = stdout(&folder, &["benchmark", "ingest", "--file", file, "--rounds", "1", "--json"], 0);
    let value: serde_json::Value = serde_json::from_str(&out).expect("one object");
    assert_eq!(value["rows"], rows, "{out}");
    let figure = |of: &str, what: &str| value[of][what].as_f64().expect("a figure");
    assert!(figure("ingest", "wall_s") > 0.0 && figure("polars", "wall_s") > 0.0, "{out}");
    let ratio = figure("ingest", "wall_s") / figure("polars", "wall_s");
    assert!((value["ratio"].as_f64().expect("a ratio") / ratio - 1.0).abs() < 1e-9, "{out}");
    #[cfg(target_os = "linux")]
    assert!(figure("ingest", "peak_mb") > 1.0, "{out}");

    let simulated = ["benchmark", "ingest", "--cycles", "1", "--rate-hz", "20", "--rounds", "1", "--json"];
    assert!(stdout(&folder, &simulated, 0).contains("\"ratio\""));

    let out = stdout(&folder, &["benchmark", "ingest", "--small-files", "8", "--json"], 0);
    let value: serde_json::Value = serde_json::from_str(&out).expect("one object");
    let counts: Vec<&serde_json::Value> =
        value["series"].as_array().expect("a series").iter().map(|entry| &entry["files"]).collect();
    assert_eq!(counts, [2, 8], "{out}");
    stdout(&folder, &["benchmark", "ingest", "--file", "not-there.csv"], 74);
}

#[test]
fn a_start_knows_the_files_that_it_left() {
    let folder = tempfile::tempdir().expect("a folder");
    let size = ["--files", "40", "--robots", "4", "--rounds", "1", "--json"];
    let out = stdout(&folder, &[&["benchmark", "start"][..], &size].concat(), 0);
    let known: serde_json::Value = serde_json::from_str(&out).expect("one object");
    assert_eq!(known["files"], 40);
    assert!(known["rounds"][0]["known_s"].as_f64() > known["rounds"][0]["watches_s"].as_f64(), "{out}");
}

/// Every stage has the same kinds of values.
#[test]
fn the_stages_of_a_cycle_are_measured_one_by_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = stdout(&folder, &["benchmark", "stages", "--rate-hz", "20", "--rounds", "1", "--json"], 0);
    let value: serde_json::Value = serde_json::from_str(&out).expect("one object");
    // 20 Hz over the five minutes of a cycle
    assert!((4000..8000).contains(&value["rows"].as_u64().expect("rows")), "{out}");
    let stages = value["stages"].as_array().expect("stages");
    assert!(stages.iter().all(|of| of["cpu_s"].as_f64().is_some_and(|cpu_s| cpu_s > 0.0)), "{out}");
    for of in stages.iter().filter(|of| !of["mflop"].is_null()) {
        let figure = |what: &str| of[what].as_f64().expect("a figure");
        let rate = figure("mflop") / 1e3 / figure("cpu_s");
        assert!((figure("gflop_per_s") / rate - 1.0).abs() < 1e-9, "{out}");
    }
    let names: Vec<&str> = stages.iter().filter_map(|of| of["stage"].as_str()).collect();
    assert!(names.contains(&"triangular factors, with the regressor"), "{out}");
    assert!(stages.iter().filter(|of| !of["reference_cpu_s"].is_null()).count() >= 3, "{out}");
}
