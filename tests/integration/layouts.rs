//! A layout is proposed for an export from another site, and the export then gives the same results.

use std::fs;

use crate::bad_input::decompressed;
use crate::support::{REFERENCE_NAME, Workshop, query, reference};

/// Degrees are written with twelve decimals; the identification multiplies their rounding by its condition
/// number.
const EQUAL: f64 = 1e-6;

/// The reference export in the form of a German test stand: another header, degrees, milliseconds, decimal commas, a
/// line above the header, UTF-16.
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
fn a_proposal_is_tried_on_its_own_file_before_it_is_written() {
    let workshop = Workshop::new();
    let native = decompressed();
    fs::write(workshop.path("R00_20260105_0847.csv"), &native).expect("an export");
    let rows = native.lines().count() - 1;
    let infer = ["layout", "infer", "R00_20260105_0847.csv", "--robot", "R00"];
    let layout = workshop.stdout(&infer, 0);
    let head =
        format!("# Tried on R00_20260105_0847.csv: {rows} rows read, 50 Hz, 5 cycles, 5 excitation stages");
    assert!(layout.starts_with(&head), "{layout}");
    let json = workshop.stdout(&[&infer[..], &["--json"]].concat(), 0);
    let value: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let trial = &value["trial"];
    assert_eq!((&trial["sound"], &trial["rows"]), (&true.into(), &rows.into()), "{json}");
    assert_eq!((&trial["cycles"], &trial["identified"]), (&5.into(), &true.into()), "{json}");
    // without a description, the file is read and no parameters are identified
    let read = workshop.stdout(&["layout", "infer", "R00_20260105_0847.csv"], 0);
    assert!(
        read.contains("# Not identified: this needs a description") && read.contains(&rows.to_string()),
        "{read}"
    );

    // a cell far down is not a number: the layout is written, with a note about the failure
    let broken: Vec<String> = native
        .lines()
        .enumerate()
        .map(|(at, line)| if at == rows - 10 { line.replacen('.', "x", 3) } else { line.to_owned() })
        .collect();
    fs::write(workshop.path("R00_20260106_0847.csv"), broken.join("\n") + "\n").expect("an export");
    let output = ["layout", "infer", "R00_20260106_0847.csv", "--robot", "R00", "-o", "broken.toml"];
    workshop.stdout(&output, 1);
    let layout = fs::read_to_string(workshop.path("broken.toml")).expect("a layout");
    let first: String = layout.lines().take(3).collect::<Vec<_>>().join(" ").replace("\n#", "");
    assert!(first.starts_with("# THE TRIAL FAILED: this layout does not read its own file: "), "{layout}");
    assert!(first.contains(&format!("line {}", rows - 9)), "{layout}");

    // another arm: every cycle is refused, and the header has the reason
    let turned: Vec<String> = native
        .lines()
        .enumerate()
        .map(|(at, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if at > 0 {
                cells[14] = format!("{}", -cells[14].parse::<f64>().expect("a torque"));
            }
            cells.join(",")
        })
        .collect();
    fs::write(workshop.path("R00_20260107_0847.csv"), turned.join("\n") + "\n").expect("an export");
    let layout = workshop.stdout(&["layout", "infer", "R00_20260107_0847.csv", "--robot", "R00"], 1);
    assert!(layout.starts_with("# THE TRIAL FAILED: every cycle of its own file is refused"), "{layout}");
    assert!(layout.contains("no parameters: joint 2: its torque has the wrong sign"), "{layout}");
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
    assert!(asked.contains("# ? no column increases from row to row"), "{asked}");

    let empty = workshop.path("empty.csv");
    fs::write(&empty, "").expect("a file");
    fs::write(workshop.path("binary.csv"), [0, 1, 2, 0xff]).expect("a file");
    for (file, said) in
        [("empty.csv", "empty.csv"), ("binary.csv", "binary.csv"), ("none.csv", "there is no such file")]
    {
        let refused = workshop.stderr(&["layout", "infer", file], 2);
        assert!(refused.contains(said), "{refused}");
    }
}

#[test]
fn a_layout_is_written_whole_and_needs_none_that_exists() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    let export = format!("inbox/{REFERENCE_NAME}");
    // the configured layout does not exist yet
    workshop.use_file("layout", "cell4.toml");
    let infer = ["layout", "infer", &export, "--robot", "R00", "-o", "cell4.toml"];
    assert_eq!(workshop.stdout(&infer, 0), "");
    workshop.stdout(&["config", "check"], 0);
    let first = fs::read_to_string(workshop.path("cell4.toml")).expect("a layout");
    assert!(first.contains("name = \"cell4\"") && first.ends_with('\n'), "{first}");

    fs::write(workshop.path("cell4.toml"), "# by hand\n").expect("a layout");
    let refused = workshop.run(&infer);
    assert_eq!(refused.status.code(), Some(2));
    assert_eq!(fs::read_to_string(workshop.path("cell4.toml")).expect("as it was"), "# by hand\n");
    let bad = ["layout", "infer", "armwatch.toml", "-o", "cell4.toml", "--force"];
    assert_eq!(workshop.run(&bad).status.code(), Some(2));
    assert_eq!(fs::read_to_string(workshop.path("cell4.toml")).expect("as it was"), "# by hand\n");
    // the export and a database are never overwritten, whatever the options
    let before = fs::read(workshop.path(&export)).expect("the export");
    fs::write(workshop.path("own.db"), "SQLite format 3\0").expect("a database");
    workshop.stdout(&[&infer[..], &["--force"]].concat(), 0);
    for (target, said) in [(export.as_str(), "not written to"), ("own.db", "not replaced")] {
        let refused = workshop.stderr(&["layout", "infer", &export, "-o", target, "--force"], 2);
        assert!(refused.contains(said), "{refused}");
    }
    assert_eq!(fs::read(workshop.path(&export)).expect("the export"), before);
    assert_eq!(fs::read_to_string(workshop.path("cell4.toml")).expect("a layout"), first);
    let entries: Vec<_> =
        fs::read_dir(workshop.path("")).expect("the folder").flatten().map(|e| e.file_name()).collect();
    assert!(entries.iter().all(|name| !name.to_string_lossy().ends_with(".tmp")), "{entries:?}");

    let unknown = workshop.run(&["layout", "infer", &export, "--config", "armwatch.toml", "--robot", "R00"]);
    assert_eq!(unknown.status.code(), Some(0));
    let root = env!("CARGO_MANIFEST_DIR");
    let description = format!("{root}/config/robots/er3a.toml");
    fs::write(workshop.path("armwatch.toml"), "[watch\n").expect("a broken configuration");
    workshop.stdout(&["layout", "infer", &export, "--description", &description], 0);
    workshop.stdout(&["layout", "infer", &export], 0);
}

#[test]
fn dates_in_any_form_and_the_start_from_a_column_of_the_export() {
    let workshop = Workshop::new();
    let native = decompressed();
    let lines: Vec<&str> = native.lines().take(1 + 8509).collect();
    fs::write(workshop.inbox("left-26_01_05-08h47.csv"), lines.join("\n") + "\n").expect("an export");
    let dated: Vec<String> = (lines.iter().enumerate())
        .map(|(at, line)| match at {
            0 => format!("{line},Date"),
            at => format!("{line},06/01/26 10:{:02}:07.5", at / 1000),
        })
        .collect();
    fs::write(workshop.inbox("right.csv"), dated.join("\n") + "\n").expect("an export");

    let root = env!("CARGO_MANIFEST_DIR");
    let layout = fs::read_to_string(format!("{root}/config/exports/native.toml")).expect("a layout");
    let start = "\n[start]\ncolumn = \"Date\"\nformat = \"%d/%m/%y %H:%M:%S%.f\"\n";
    fs::write(workshop.path("dated.toml"), layout + start).expect("a layout");
    let config = format!(
        "[watch]\nfolders = [\"inbox\"]\n\n[recognition]\n\
         file_name = '^(?<robot>[a-z]+)(?:-(?<date>\\d\\d_\\d\\d_\\d\\d)-(?<time>\\d\\dh\\d\\d))?$'\n\
         date_format = \"%y_%m_%d\"\ntime_format = \"%Hh%M\"\ntime_zone = \"UTC\"\n\n\
         [[robot]]\nname = \"*\"\nfiles = [\"none*\", \"right*\"]\ndescription = \"{root}/config/robots/er3a.toml\"\n\
         layout = \"dated.toml\"\n\n[[robot]]\nname = \"*\"\ndescription = \"{root}/config/robots/er3a.toml\"\n\
         layout = \"{root}/config/exports/native.toml\"\n"
    );
    fs::write(workshop.path("armwatch.toml"), config).expect("a configuration");
    let summary = workshop.stdout(&["config", "check"], 0);
    assert!(summary.contains("robot *, files none* or right* er3a with 6 joints"), "{summary}");
    assert!(summary.contains("date (%y_%m_%d) and time (%Hh%M)"), "{summary}");
    let said = workshop.stdout(&["explain", "--quick", "inbox/right.csv"], 0);
    assert!(said.contains("2026-01-06T10:00:07.5Z, from column Date of its first row"), "{said}");
    workshop.stdout(&["ingest", "inbox"], 0);
    let starts = workshop.query("SELECT robot, started_at FROM runs ORDER BY robot");
    assert_eq!(starts, ["left|2026-01-05T08:47:00.000Z", "right|2026-01-06T10:00:07.500Z"]);

    workshop.configure(|config| config.replace("%y_%m_%d", "YY_MM_DD"));
    let refused = workshop.run(&["config", "check"]);
    let said =
        String::from_utf8_lossy(&refused.stderr).into_owned() + &String::from_utf8_lossy(&refused.stdout);
    assert!(said.contains("recognition.date_format") && said.contains("%y_%m_%d for 26_01_05"), "{said}");
}
