//! A layout is proposed for an export of another house, and the export then gives the same results.

use std::fs;

use crate::bad_input::decompressed;
use crate::support::{REFERENCE_NAME, Workshop, query, reference};

/// Degrees are written with twelve decimals; the identification multiplies their rounding by its condition
/// number.
const EQUAL: f64 = 1e-6;

/// The reference export as a German test stand would write it: another header, degrees, milliseconds, decimal
/// commas, a line above the header, UTF-16.
fn german() -> Vec<u8> {
    let native = decompressed();
    let mut text = String::from("Prüfstand 4\r\n");
    for (at, line) in native.lines().enumerate() {
        let cells = line.split(',').enumerate().map(|(column, cell)| match (at, column) {
            (0, 0) => "Zeit [ms]".to_owned(),
            (0, 1..=6) => format!("Achse {column} Istwert [°]"),
            (0, 7..=12) => format!("Achse {} Geschwindigkeit", column - 6),
            (0, 13..=18) => format!("A{}_Drehmoment", column - 12),
            (0, 19) => "Phase".to_owned(),
            (0, 20) => "Zyklus".to_owned(),
            (0, 21) => "Achse".to_owned(),
            (0, 22) => "Stufe".to_owned(),
            (_, 0) => format!("{:.6}", cell.parse::<f64>().expect("a time") * 1e3),
            (_, 1..=12) => format!("{:.12}", cell.parse::<f64>().expect("a number").to_degrees()),
            _ => cell.to_owned(),
        });
        let line = cells.collect::<Vec<_>>().join(";");
        text += &(if at == 0 { line } else { line.replace('.', ",") });
        text += "\r\n";
    }
    [0xFEFF].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect()
}

fn figures(workshop: &Workshop, database: &str) -> Vec<f64> {
    let sql = "SELECT rmsd_nm, moving_relative_rmsd FROM cycle_rmsd ORDER BY cycle, joint, stage";
    let rows = query(&workshop.path(database), sql);
    rows.iter()
        .flat_map(|row| row.split('|').filter_map(|cell| cell.parse().ok()).collect::<Vec<f64>>())
        .collect()
}

#[test]
fn an_export_of_another_house_gives_the_same_results_by_its_proposed_layout() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    workshop.stdout(&["ingest", "inbox", "--db", "native.db"], 0);
    fs::create_dir(workshop.path("german")).expect("a folder");
    fs::write(workshop.path("german/R00_20260105_0847.csv"), german()).expect("an export");

    let infer = ["layout", "infer", "german/R00_20260105_0847.csv", "--robot", "R00", "--name", "stand4"];
    let layout = workshop.stdout(&infer, 0);
    fs::write(workshop.path("stand4.toml"), &layout).expect("a layout");
    let config = fs::read_to_string(workshop.path("armwatch.toml")).expect("the configuration");
    let config: Vec<&str> = config
        .lines()
        .map(|line| if line.starts_with("layout") { "layout = \"stand4.toml\"" } else { line })
        .collect();
    fs::write(workshop.path("german.toml"), config.join("\n")).expect("a configuration");
    workshop.stdout(&["config", "check", "--config", "german.toml"], 0);
    workshop.stdout(&["ingest", "german", "--config", "german.toml", "--db", "german.db"], 0);

    let (native, german) = (figures(&workshop, "native.db"), figures(&workshop, "german.db"));
    assert!(native.len() > 50 && native.len() == german.len(), "{layout}");
    for (a, b) in native.iter().zip(&german) {
        assert!((a - b).abs() <= EQUAL * a.abs(), "{a} {b}\n{layout}");
    }
}

#[test]
fn proposals_for_what_is_shipped_load_and_ask_what_only_people_know() {
    let workshop = Workshop::new();
    let export = reference(REFERENCE_NAME);
    let export = export.to_str().expect("a path");
    let native = workshop.stdout(&["layout", "infer", export], 0);
    for key in
        ["column = \"pos_{joint}\"", "column = \"vel_{joint}\"", "column = \"trq_{joint}\"", "unit = \"rad\""]
    {
        assert!(native.contains(key), "{key}\n{native}");
    }
    let motors = reference("tx40/TX40_0000-4000ms_5kHz.csv.gz");
    let motors = motors.to_str().expect("a path");
    let asked = workshop.stdout(&["layout", "infer", motors], 1);
    assert!(asked.contains("# ? no column rises from row to row"), "{asked}");

    let empty = workshop.path("empty.csv");
    fs::write(&empty, "").expect("a file");
    let refused = workshop.run(&["layout", "infer", "empty.csv"]);
    assert_eq!(refused.status.code(), Some(1));
}
