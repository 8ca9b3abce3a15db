//! JSON as a contract: keys and types of the output of commands, rows of commands compared with rows of views, units of
//! anomalies.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;

use serde_json::Value;

use crate::support::{Workshop, text};

/// Commands, and the keys and types of each with `--json`. A key whose lists are all empty has no type.
const SHAPES: &str = include_str!("../fixtures/json_shapes.txt");

/// Tests of an arm whose joint 3 wears, and an export that ends within a row.
fn exports(workshop: &Workshop) {
    let shape = ["--runs", "8", "--cycles", "2", "--name", "R01", "--seed", "11"];
    let fault = ["--fault", "wear:joint=3,from=5,rate=0.08"];
    let mut made = workshop.simulate("inbox", &[&shape[..], &fault].concat());
    made.sort();
    let whole = fs::read_to_string(&made[0]).expect("an export");
    let lines: Vec<&str> = whole.lines().collect();
    let broken = [&lines[..40], &["broken"], &lines[41..80]].concat().join("\n") + "\n";
    fs::write(workshop.inbox("R01_20270101_0600.csv"), broken).expect("an export");
}

/// Adds the types of all values of a line of JSON, by their path.
fn add(types: &mut BTreeMap<String, BTreeSet<&'static str>>, path: &str, value: &Value) {
    let name = match value {
        Value::Object(keys) => {
            for (key, value) in keys {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                add(types, &path, value);
            }
            return;
        }
        Value::Array(items) => {
            let path = format!("{path}[]");
            items.iter().for_each(|item| add(types, &path, item));
            if items.is_empty() {
                types.entry(path).or_default();
            }
            return;
        }
        Value::Null => "null",
        Value::Bool(_) => "bool",
        Value::Number(_) => "number",
        Value::String(_) => "text",
    };
    types.entry(path.to_owned()).or_default().insert(name);
}

#[test]
fn commands_print_the_keys_and_types_of_the_contract() {
    let workshop = Workshop::new();
    exports(&workshop);
    let mut found = String::new();
    for command in SHAPES.lines().filter_map(|line| line.strip_prefix("$ ")) {
        let words: Vec<&str> = command.split(' ').chain(["--json"]).collect();
        let output = workshop.run(&words);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert!(output.status.code().is_some_and(|code| code <= 1), "{command}\n{out}\n{err}");
        let mut types = BTreeMap::new();
        for line in out.lines() {
            let value =
                serde_json::from_str(line).unwrap_or_else(|error| panic!("{command}: {error}: {line}"));
            add(&mut types, "", &value);
        }
        writeln!(found, "$ {command}").expect("a text");
        for (path, types) in types {
            let types: Vec<&str> = types.into_iter().collect();
            writeln!(found, "{path}: {}", types.join("|")).expect("a text");
        }
        found.push('\n');
    }
    for (found, expected) in found.split("\n\n").zip(SHAPES.split("\n\n")) {
        assert_eq!(found, expected, "a change of this contract belongs into the change log");
    }
}

/// The output of a command has the values of the view.
#[test]
fn rows_of_commands_are_rows_of_views() {
    let workshop = Workshop::new();
    exports(&workshop);
    workshop.stdout(&["ingest", "inbox"], 1);
    let parsed = |out: String| -> Vec<Value> {
        out.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
    };
    let rows = |command: &[&str]| parsed(workshop.stdout(&[command, &["--json"]].concat(), 0));
    let view = |sql: &str| rows(&["sql", sql]);
    // the key of the command and the column of the view, if they differ; JSON in text is not compared
    for (command, sql, renamed, other) in [
        (
            &["alerts", "list", "--all"][..],
            "SELECT * FROM anomalies ORDER BY anomaly_id",
            [("", ""); 2],
            vec!["alternatives", "ended", "provisional"],
        ),
        (
            &["quarantine", "list", "--all"],
            "SELECT * FROM quarantine ORDER BY run_id",
            [("file", "source_path"), ("column", "column_name")],
            vec![],
        ),
    ] {
        let mut printed = rows(command);
        let key = if command[0] == "alerts" { "anomaly_id" } else { "run_id" };
        printed.sort_by_key(|row| row[key].as_i64());
        let stored = view(sql);
        assert_eq!(printed.len(), stored.len(), "{command:?}");
        assert!(!printed.is_empty(), "{command:?}");
        for (row, stored) in printed.iter().zip(&stored) {
            for (key, value) in row.as_object().expect("an object") {
                let column = renamed.iter().find(|(from, _)| from == key).map_or(key.as_str(), |of| of.1);
                if !other.contains(&column) {
                    assert_eq!(Some(value), stored.get(column), "{command:?}: {key}");
                }
            }
        }
    }
}

#[test]
fn each_quantity_of_a_torque_signal_has_one_unit() {
    let workshop = Workshop::new();
    let shape = ["--runs", "7", "--cycles", "6", "--rate-hz", "100", "--warming-s", "20"];
    for (name, fault) in [("Off", "offset:joint=2,from=6,nm=12"), ("Noi", "noise:joint=2,from=6,factor=5")] {
        workshop.simulate("inbox", &[&shape[..], &["--name", name, "--fault", fault]].concat());
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    let found = workshop.query(
        "SELECT robot, quantity, unit, round(value), baseline, round(peak_value), round(score) FROM anomalies
         WHERE severity <> 'info' ORDER BY robot",
    );
    assert_eq!(found, ["Noi|torque_noise_ratio|1|5|1|5|5", "Off|torque_offset_nm|Nm|12|0|12|12"]);
    let shown = workshop.stdout(&["alerts", "list", "--robot", "Off", "--json"], 0);
    let shown: Value = serde_json::from_str(shown.lines().next().expect("an alarm")).expect("JSON");
    assert_eq!((&shown["quantity"], &shown["unit"]), (&"torque_offset_nm".into(), &"Nm".into()));
    // the list of quantities has the same unit
    let listed = workshop.stdout(&["alerts", "quantities", "--json"], 0);
    let offset: Value = listed
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .find(|of: &Value| of["quantity"] == "torque_offset_nm")
        .expect("the quantity");
    assert_eq!((&offset["unit"], &offset["history"]), (&"Nm".into(), &"test".into()));
}
