//! `armwatch explain`: its output matches the later result, and it writes nothing.

use std::fs;

use crate::support::Workshop;

fn explained(workshop: &Workshop, file: &str, code: i32) -> serde_json::Value {
    let out = workshop.stdout(&["explain", file, "--json"], code);
    serde_json::from_str(out.trim()).expect("one object")
}

#[test]
fn an_export_is_explained_as_it_is_then_stored() {
    let workshop = Workshop::new();
    let export = workshop.simulate("inbox", &["--cycles", "2", "--name", "R07"])[0].clone();
    let file = export.display().to_string();
    let before = explained(&workshop, &file, 0);
    assert_eq!((before["next"].as_str(), before["run_id"].as_i64()), (Some("store"), None));
    assert_eq!((before["robot"].as_str(), before["layout"].as_str()), (Some("R07"), Some("native")));
    assert!(before["ledger"].as_str().is_some_and(|text| text.contains("no database")), "{before}");
    assert!(!workshop.path("armwatch.db").exists(), "looking makes no database");
    let text = workshop.stdout(&["explain", &file], 0);
    for words in ["robot       R07, by recognition", "(rad/s)", "next        ", "excitation"] {
        assert!(text.contains(words), "{words}\n{text}");
    }

    workshop.stdout(&["ingest", &file], 0);
    let stored = workshop.query("SELECT cycle, rows, status FROM cycles ORDER BY cycle");
    let said: Vec<String> = before["cycles"]
        .as_array()
        .expect("cycles")
        .iter()
        .map(|of| {
            let status = if of["identified"] == true { "complete" } else { "refused" };
            format!("{}|{}|{status}", of["cycle"], of["rows"])
        })
        .collect();
    assert_eq!(said, stored);
    assert_eq!(
        before["problems"],
        serde_json::json!([]),
        "a remark on a sound cycle is no problem: {before}"
    );
    assert!(before["remarks"][0].as_str().is_some_and(|text| text.starts_with("cycle 1")), "{before}");
    assert!(text.contains("  problems    none\n  remark "), "{text}");
    let remarks = workshop.query("SELECT remarks FROM cycles WHERE cycle = 1");
    let said: Vec<&str> = before["cycles"][0]["remarks"]
        .as_array()
        .expect("remarks")
        .iter()
        .filter_map(|of| of.as_str())
        .collect();
    assert_eq!(said.join("\n"), remarks[0]);
    let levels = before["friction_levels"].as_array().expect("levels");
    assert_eq!(levels.len(), 6);

    let after = explained(&workshop, &file, 0);
    assert_eq!((after["next"].as_str(), after["run_id"].as_i64()), (Some("nothing"), Some(1)));
    assert_eq!(workshop.number("SELECT count(*) FROM runs"), 1);
}

#[test]
fn a_fault_is_said_with_line_and_column_and_a_rewritten_file_with_the_run_it_supersedes() {
    let workshop = Workshop::new();
    let export = workshop.simulate("inbox", &["--cycles", "1", "--warming-s", "5"])[0].clone();
    let file = export.display().to_string();
    workshop.stdout(&["ingest", &file], 0);
    let text = fs::read_to_string(&export).expect("the export");
    let mut lines: Vec<&str> = text.lines().collect();
    lines.truncate(lines.len() - 10);
    fs::write(&export, lines.join("\n") + "\n").expect("a shorter export");
    let shorter = explained(&workshop, &file, 0);
    assert_eq!((shorter["next"].as_str(), shorter["supersedes_run_id"].as_i64()), (Some("store"), Some(1)));

    let broken = lines[2000].replacen(',', ",x", 1);
    lines[2000] = &broken;
    fs::write(&export, lines.join("\n") + "\n").expect("a broken export");
    let faulty = explained(&workshop, &file, 1);
    assert_eq!(faulty["next"], "quarantine");
    assert_eq!(
        (faulty["rejection"]["line"].as_i64(), faulty["rejection"]["column"].as_str()),
        (Some(2001), Some("pos_1"))
    );
    assert_eq!(faulty["rows"], 1999, "rows before the fault are read");
    assert_eq!(workshop.number("SELECT count(*) FROM runs"), 1, "nothing is stored");

    fs::write(workshop.path("20260105.csv"), &text[..text.len() / 2]).expect("a file of nobody");
    let unknown = explained(&workshop, "20260105.csv", 1);
    assert!(unknown["problems"][0].as_str().is_some_and(|text| text.contains("recognition")), "{unknown}");
}
