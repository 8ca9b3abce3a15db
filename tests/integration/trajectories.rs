//! `armwatch trajectory`: the walk of `docs/trajectories.md`, from a description to parameters, and broken limits.

use std::fs;
use std::path::Path;

use armwatch::config::read_robot;
use armwatch::numerics::model::base_parameters::base_parameters;
use armwatch::numerics::pooled::nominal_prior::nominal_base;

use crate::support::{Workshop, text};

fn page() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/trajectories.md")).expect("the page")
}

/// Blocks of a language in the section of the walk.
fn blocks(language: &str) -> Vec<String> {
    let page = page();
    let walk = page.split("## A walk from nothing").nth(1).expect("the walk");
    let mut found = Vec::new();
    for block in walk.split(&format!("```{language}\n")).skip(1) {
        found.push(block.split("```").next().expect("an end").to_owned());
    }
    found
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).expect("JSON")
}

#[test]
fn the_walk_leads_from_a_description_to_true_parameters() {
    let workshop = Workshop::new();
    let files = blocks("toml");
    fs::write(workshop.path("mine.toml"), &files[0]).expect("written");
    fs::write(workshop.path("mine-armwatch.toml"), &files[1]).expect("written");
    let commands: Vec<String> = blocks("console").iter().flat_map(|block| lines(block)).collect();
    assert!(commands.len() >= 10, "{commands:?}");
    for command in &commands {
        let words: Vec<&str> = command.split_whitespace().skip(2).collect();
        workshop.stdout(&words, 0);
    }
    assert!(fs::read_to_string(workshop.path("mine.svg")).expect("a picture").contains("</svg>"));

    // what ingest identified holds the description's base parameters
    let robot = read_robot(&workshop.path("mine.toml")).expect("the description");
    let base = base_parameters(&robot).expect("base parameters");
    let identified = crate::support::query(
        &workshop.path("mine.db"),
        "SELECT 'J' || joint || '_' || parameter || ' ' || value || ' ' || std_error FROM cycle_parameters",
    );
    let mut off = Vec::new();
    for row in &identified {
        let cells: Vec<&str> = row.split(' ').collect();
        let number = |k: usize| cells[k].parse::<f64>().expect("a number");
        let place = base.kept.iter().position(|id| id.to_string() == cells[0]).expect("a base parameter");
        // an offset of the torque signal is not described: the simulator has none
        let truth = nominal_base(&robot, &base)[place].unwrap_or(0.0);
        off.push((number(1) - truth).abs() / number(2));
    }
    assert_eq!(off.len(), 2 * base.kept.len());
    off.sort_by(f64::total_cmp);
    // half of all errors are within 0.67 standard errors; one of 28 that is beyond five is no chance
    assert!(off[off.len() / 2] < 1.2 && off[off.len() - 1] < 5.0, "{off:?}\n{identified:?}");

    the_test_has_its_stages(&workshop);
    the_same_seed_gives_the_same_file(&workshop);
    broken_limits_are_named_and_not_written(&workshop);
}

fn lines(block: &str) -> Vec<String> {
    block.lines().filter(|line| line.starts_with("$ armwatch ")).map(str::to_owned).collect()
}

/// The file of a test shows every stage for as long as is said, every level of every joint, and no jump.
fn the_test_has_its_stages(workshop: &Workshop) {
    let shape =
        ["trajectory", "test", "--robot", "mine.toml", "--trajectory", "mine.json", "--levels", "2,3"];
    let more = ["--warming-s", "12", "--cycles", "2", "--rate-hz", "1000", "-o", "test.csv", "--json"];
    let said = json(&workshop.stdout(&[&shape[..], &more].concat(), 0));
    let mut reader = csv::Reader::from_path(workshop.path("test.csv")).expect("the file");
    let names: Vec<String> = reader.headers().expect("a header").iter().map(str::to_owned).collect();
    let column =
        |name: &str| names.iter().position(|of| of == name).unwrap_or_else(|| panic!("{name}: {names:?}"));
    let rows: Vec<Vec<f64>> = reader
        .records()
        .map(|row| row.expect("a row").iter().map(|cell| cell.parse().expect("a number")).collect())
        .collect();
    let cycle = said["cycle_s"].as_f64().expect("a duration");
    assert!((rows.len() as f64 - 2000.0 * cycle).abs() <= 2.0, "{} rows, {cycle} s", rows.len());
    let of = |name: &'static str| {
        let at = column(name);
        rows.iter().map(move |row| row[at])
    };
    for (stage, number) in [("excitation", 1.0), ("friction", 2.0), ("warming", 3.0)] {
        let found = of("stage").filter(|value| *value == number).count() as f64 / 2000.0;
        let stages = said["stages"].as_array().expect("stages");
        let lasts =
            stages.iter().find(|of| of["stage"] == stage).expect(stage)["lasts_s"].as_f64().expect("s");
        assert!((found - lasts).abs() < 0.1, "{stage}: {found} s of {lasts}");
    }
    let mut signals: Vec<[u8; 3]> = of("cycle")
        .zip(of("joint"))
        .zip(of("level"))
        .filter(|((_, joint), _)| *joint > 0.0)
        .map(|((cycle, joint), level)| [cycle as u8, joint as u8, level as u8])
        .collect();
    signals.dedup();
    assert_eq!(signals.len(), 8, "{signals:?}");
    assert_eq!((signals[0], signals[7]), ([1, 1, 2], [2, 2, 3]));
    // velocities and accelerations are those of the positions: central differences over 2 ms
    for (q, qd) in [("pos_1_rad", "vel_1_rad_s"), ("vel_2_rad_s", "acc_2_rad_s2")] {
        let (q, qd): (Vec<f64>, Vec<f64>) = (of(q).collect(), of(qd).collect());
        let largest = qd.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let error = (1..q.len() - 1).map(|k| (500.0 * (q[k + 1] - q[k - 1]) - qd[k]).abs());
        assert!(error.fold(0.0, f64::max) < 0.1 * largest, "{largest}");
    }
    let refused = workshop.run(&[&shape[..7], &["9"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("no speed level 9"), "{}", text(&refused.stderr));
}

fn the_same_seed_gives_the_same_file(workshop: &Workshop) {
    let shape = ["trajectory", "design", "--robot", "mine.toml", "--harmonics", "2", "--seconds", "6"];
    let run = |more: &[&str]| json(&workshop.stdout(&[&shape[..], more, &["--json"]].concat(), 0));
    let one = run(&["--starts", "2", "--threads", "1", "-o", "one.json"]);
    run(&["--starts", "2", "--threads", "2", "-o", "two.json"]);
    let read = |name: &str| fs::read_to_string(workshop.path(name)).expect("a programme");
    assert_eq!(read("one.json"), read("two.json"));
    assert_eq!(one["search"]["starts"], 2);
    assert!(one["parameters"].as_array().is_some_and(|of| of.len() > 8), "{one}");
    assert!(one["smallest_changes"]["load_kg"].as_f64().is_some_and(|load| load > 0.0), "{one}");
    // by time: at least one start, and the file says how many
    let timed = run(&["--budget-s", "0", "-o", "timed.json"]);
    assert_eq!(timed["search"]["starts"], 1);
    run(&["--starts", "1", "-o", "again.json"]);
    assert_eq!(read("timed.json"), read("again.json"));
}

fn broken_limits_are_named_and_not_written(workshop: &Workshop) {
    let slow = fs::read_to_string(workshop.path("mine.toml")).expect("a description");
    let slow = slow.replacen("velocity_max_deg_s = 180", "velocity_max_deg_s = 20", 1);
    fs::write(workshop.path("slow.toml"), slow).expect("written");
    for file in ["mine.json", "mine.csv"] {
        let found =
            json(&workshop.stdout(&["trajectory", "check", file, "--robot", "slow.toml", "--json"], 1));
        let broken = found["broken"].as_array().expect("a list");
        assert_eq!(broken.len(), 1, "{found}");
        assert_eq!((&broken[0]["joint"], &broken[0]["quantity"]), (&1.into(), &"speed".into()));
        let limit = 20.0_f64.to_radians();
        assert!((broken[0]["limit"].as_f64().expect("a limit").abs() - limit).abs() < 1e-9, "{found}");
        let (value, excess) = (broken[0]["value"].as_f64(), broken[0]["excess"].as_f64());
        assert!((value.expect("a value").abs() - limit - excess.expect("an excess")).abs() < 1e-9);
        let shown = workshop.stdout(&["trajectory", "check", file, "--robot", "slow.toml"], 1);
        assert!(shown.contains("BROKEN joint 1: speed") && shown.contains("rad/s"), "{shown}");
    }
    let export = ["trajectory", "export", "mine.json", "--robot", "slow.toml", "-o", "slow.csv"];
    let refused = workshop.run(&export);
    assert_eq!(refused.status.code(), Some(1));
    assert!(text(&refused.stderr).contains("--despite-broken-limits"), "{}", text(&refused.stderr));
    assert!(!workshop.path("slow.csv").exists());
    workshop.stdout(&[&export[..], &["--despite-broken-limits", "--waypoints"]].concat(), 0);
    let written = fs::read_to_string(workshop.path("slow.csv")).expect("a file");
    assert!(written.starts_with("time_s,pos_1_rad,vel_1_rad_s,pos_2_rad,vel_2_rad_s\n"), "{written}");
    // another arm, and a name that only the pattern of every robot fits
    for (arguments, said) in [
        (["trajectory", "check", "mine.json", "--robot", "er3a"], "has 6 joints"),
        (["trajectory", "check", "mine.json", "--robot", "er3b"], "neither a robot nor a model"),
        (["trajectory", "check", "nothing.json", "--robot", "er3a"], "cannot read"),
    ] {
        let output = workshop.run(&arguments);
        assert!(text(&output.stderr).contains(said), "{}", text(&output.stderr));
        assert_ne!(output.status.code(), Some(0));
    }
}
