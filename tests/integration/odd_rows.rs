//! Exports with unusual but understandable rows or times: the whole program gives the cycles of the undisturbed export,
//! and reports its corrections.

use std::f64::consts::{PI, TAU};
use std::fs;

use crate::support::Workshop;

/// Cells of an export, its header first.
type Cells = Vec<Vec<String>>;

fn cells(text: &str) -> Cells {
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn joined(cells: &Cells) -> String {
    cells.iter().map(|row| row.join(",") + "\n").collect()
}

/// The export with a changed number in each cell of a column; `change` gets the row's index and the number.
fn with_column(cells: &Cells, name: &str, change: impl Fn(usize, f64) -> String) -> Cells {
    let column = cells[0].iter().position(|of| of == name).expect(name);
    let mut changed = cells.clone();
    for (row, cells) in changed.iter_mut().skip(1).enumerate() {
        cells[column] = change(row, cells[column].parse().expect("a number"));
    }
    changed
}

/// Status of the cycles and remarks of an export, from `explain`.
fn explained(workshop: &Workshop, text: &[u8]) -> (Vec<bool>, String) {
    let file = workshop.path("R01_20260105_0847_x.csv");
    fs::write(&file, text).expect("written");
    let out = workshop.stdout(&["explain", &file.display().to_string(), "--json"], 0);
    let said: serde_json::Value = serde_json::from_str(out.trim()).expect("one object");
    let cycles = said["cycles"].as_array().expect("cycles");
    let identified = cycles.iter().map(|cycle| cycle["identified"] == true).collect();
    (identified, format!("{} {}", said["remarks"], said["problems"]))
}

#[test]
fn rows_and_times_that_are_not_as_they_should_be_give_the_same_cycles() {
    let workshop = Workshop::new();
    let options = ["--cycles", "2", "--name", "R01", "--warming-s", "5", "--seed", "11"];
    let text = fs::read_to_string(&workshop.simulate("made", &options)[0]).expect("an export");
    let sound = cells(&text);
    let times: Vec<f64> = sound[1..].iter().map(|row| row[0].parse().expect("a time")).collect();
    let mut twice = sound.clone();
    twice.insert(5000, sound[4999].clone());
    let fold = |from: f64| move |_, angle: f64| format!("{:.6}", (angle - from).rem_euclid(TAU) + from);
    let burst = |size: usize| {
        let times = &times;
        move |row: usize, _| {
            let last = (row / size * size + size - 1).min(times.len() - 1);
            format!("{:.4}", times[last] + 1e-4 * (row % size) as f64)
        }
    };
    let folded_without_velocity = {
        let mut cells = with_column(&sound, "pos_6", fold(-PI));
        let kept: Vec<usize> = (0..cells[0].len()).filter(|at| !cells[0][*at].starts_with("vel_")).collect();
        cells.iter_mut().for_each(|row| *row = kept.iter().map(|at| row[*at].clone()).collect());
        cells
    };
    let cases: Vec<(&str, Vec<u8>)> = vec![
        ("the row repeats the previous one in every cell", joined(&twice).into_bytes()),
        ("4096 NUL bytes after the last row", [text.as_bytes(), &[0; 4096]].concat()),
        ("joint 6: its angle is folded", joined(&with_column(&sound, "pos_6", fold(-PI))).into_bytes()),
        ("joint 6: its angle is folded", joined(&with_column(&sound, "pos_6", fold(0.0))).into_bytes()),
        ("joint 6: its angle is folded", joined(&folded_without_velocity).into_bytes()),
        ("times come in bursts of 3", joined(&with_column(&sound, "time", burst(3))).into_bytes()),
        ("times come in bursts of 10", joined(&with_column(&sound, "time", burst(10))).into_bytes()),
        ("", text.replace(",-", ",\u{2212}").into_bytes()),
    ];
    for (words, export) in cases {
        let (identified, remarks) = explained(&workshop, &export);
        assert_eq!(identified, [true, true], "{words}: {remarks}");
        assert!(remarks.contains(words), "{words}: {remarks}");
    }
}

#[test]
fn rows_that_are_left_out_are_remarks_of_their_cycle() {
    let workshop = Workshop::new();
    let options = ["--cycles", "2", "--name", "R01", "--warming-s", "5", "--seed", "11"];
    let text = fs::read_to_string(&workshop.simulate("made", &options)[0]).expect("an export");
    let mut twice = cells(&text);
    let cycle = twice[0].iter().position(|name| name == "cycle").expect("a cycle");
    for (number, rows) in [("2", 2), ("1", 1)] {
        let at = twice.iter().position(|row| row[cycle] == number).expect("a row") + 100;
        (0..rows).for_each(|_| twice.insert(at, twice[at].clone()));
    }
    let twice = joined(&twice);
    let ends: [(&str, Vec<u8>, &str); 2] = [
        (
            "R01_20260105_0847_x.csv",
            twice.as_bytes()[..twice.len() - 30].to_vec(),
            "the last line has too few fields",
        ),
        ("R01_20260106_0847_x.csv", [twice.as_bytes(), &[0; 64]].concat(), "64 NUL bytes after the last row"),
    ];
    for (name, export, _) in &ends {
        fs::write(workshop.inbox(name), export).expect("written");
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    for (name, _, words) in ends {
        let remarks = |cycle: u32| {
            let of_cycle = format!(
                "SELECT remarks FROM cycles JOIN runs USING (run_id) WHERE source_name = '{name}' AND cycle = {cycle}"
            );
            workshop.query(&of_cycle).concat()
        };
        let (first, second) = (remarks(1), remarks(2));
        assert!(first.contains("1 such row is skipped") && !first.contains(words), "{first}");
        assert!(second.contains("2 such rows are skipped") && second.contains(words), "{second}");
    }
}

#[test]
fn a_test_over_midnight_or_a_change_of_clocks_is_one_recording() {
    let workshop = Workshop::new();
    let options = ["--cycles", "1", "--name", "R01", "--warming-s", "5", "--seed", "12"];
    let sound = cells(&fs::read_to_string(&workshop.simulate("made", &options)[0]).expect("an export"));
    let shipped = format!("{}/config/exports/native.toml", env!("CARGO_MANIFEST_DIR"));
    let native = fs::read_to_string(&shipped).expect("a layout");
    let layout = workshop.path("times.toml");
    let config = workshop.path("armwatch.toml");
    let own = fs::read_to_string(&config).expect("the configuration").replace(&shipped, "times.toml");
    fs::write(&config, own).expect("a configuration");
    let clock = |seconds: f64| {
        let ms = (seconds * 1000.0).round() as u64;
        let of_day = ms / 1000 % 86_400;
        format!("{:02}:{:02}:{:02}.{:03}", of_day / 3600, of_day / 60 % 60, of_day % 60, ms % 1000)
    };
    // the jump of the clock is 30 s after the start
    let cases: [(&str, &str, &str, f64, f64); 3] = [
        ("", "starts again from zero, as at midnight", "format = \"%H:%M:%S.%f\"", 86_370.0, 0.0),
        ("2026-10-25 ", "set back by one hour", "unit = \"timestamp\"", 3.0 * 3600.0 - 30.0, -3600.0),
        (
            "29/03/2026 ",
            "set forward by one hour",
            "format = \"%d/%m/%Y %H:%M:%S\"",
            2.0 * 3600.0 - 30.0,
            3600.0,
        ),
    ];
    for (date, words, key, start, change) in cases {
        fs::write(&layout, native.replace("unit = \"s\"", key)).expect("written");
        let change = |time: f64| if time < 30.0 { 0.0 } else { change };
        let changed =
            with_column(&sound, "time", |_, time| format!("{date}{}", clock(start + time + change(time))));
        let (identified, remarks) = explained(&workshop, joined(&changed).as_bytes());
        assert_eq!(identified, [true], "{words}: {remarks}");
        assert!(remarks.contains(words) && !remarks.contains("gaps"), "{words}: {remarks}");
    }
}
