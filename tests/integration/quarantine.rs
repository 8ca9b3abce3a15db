//! `armwatch quarantine`: unreadable exports are reported, and read again after the cause is removed.

use std::fs;
use std::path::PathBuf;

use serde_json::{Value, json};

use crate::api::Served;
use crate::bad_input::decompressed;
use crate::small::export;
use crate::support::Workshop;

const NAME: &str = "R00_20260105_0847.csv";
const OPEN: &str = "SELECT count(*) FROM quarantine WHERE state = 'open'";

/// Three cycles of the reference export; in the third, a cell of `trq_3` is not a number.
fn faulty_export() -> (String, u64) {
    let text = decompressed();
    let mut lines: Vec<String> = text.lines().take(1 + 3 * 8509).map(str::to_owned).collect();
    let column = lines[0].split(',').position(|name| name == "trq_3").expect("the column");
    let line = 2 * 8509 + 1200;
    let mut cells: Vec<&str> = lines[line - 1].split(',').collect();
    cells[column] = "#NV";
    lines[line - 1] = cells.join(",");
    (lines.join("\n") + "\n", line as u64)
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Makes the test's configuration read exports by a separate layout file, broken or corrected.
fn write_layout(workshop: &Workshop, stage_column: &str) {
    let shipped = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/exports/native.toml"));
    let shipped = shipped.expect("the layout");
    assert!(shipped.contains("\"stage\""), "{shipped}");
    fs::write(workshop.path("layout.toml"), shipped.replace("\"stage\"", &format!("\"{stage_column}\"")))
        .expect("written");
    workshop.use_file("layout", "layout.toml");
}

#[test]
fn nothing_quarantined_is_said_so() {
    let workshop = Workshop::new();
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.stdout(&["quarantine", "list"], 0), "nothing is quarantined\n");
    assert_eq!(workshop.stdout(&["quarantine", "list", "--json"], 0), "");
    assert_eq!(workshop.stdout(&["quarantine", "retry", "--all"], 0), "nothing is quarantined\n");
    let unknown = workshop.stderr(&["quarantine", "explain", "7"], 2);
    assert!(unknown.contains("quarantine list --all"), "{unknown}");
}

#[test]
fn a_fault_is_told_with_its_place_and_a_corrected_export_settles_it() {
    let workshop = Workshop::new();
    let (export, line) = faulty_export();
    fs::write(workshop.inbox(NAME), &export).expect("an export");
    workshop.stdout(&["ingest", "inbox"], 1);

    let listed = workshop.stdout(&["quarantine", "list"], 0);
    assert!(listed.contains(NAME) && listed.contains(&format!("line {line}, column trq_3")), "{listed}");
    let told = json(&workshop.stdout(&["quarantine", "explain", NAME, "--json"], 0));
    let byte = usize::try_from(told["byte"].as_u64().expect("a byte")).expect("small");
    assert!(export[byte..].starts_with("#NV,"), "{told}");
    assert_eq!((told["line"].as_u64(), told["value"].as_str()), (Some(line), Some("#NV")));
    assert_eq!((told["content"].as_str(), told["cycles_stored"].as_u64()), (Some("unchanged"), Some(2)));
    let shown = workshop.stdout(&["quarantine", "explain", "1"], 0);
    let lines: Vec<&str> = shown.lines().collect();
    let mark = lines.iter().position(|line| line.contains("^^^")).expect("a mark");
    let under = lines[mark].find('^').expect("a mark");
    assert_eq!(lines[mark - 1].get(under..under + 3), Some("#NV"), "{shown}");
    assert!(shown.contains("the 2 stored cycles are replaced"), "{shown}");

    // a failed retry is counted, but not reported again
    let again = workshop.stdout(&["quarantine", "retry", "1"], 1);
    assert!(again.starts_with("quarantined"), "{again}");
    assert_eq!(workshop.query("SELECT tries, state, cycles_stored FROM quarantine"), ["2|open|2"]);

    fs::write(workshop.inbox(NAME), export.replace("#NV", "0.5")).expect("a corrected export");
    let explained = workshop.stdout(&["quarantine", "explain", "1"], 0);
    assert!(explained.contains("now has other content") && !explained.contains('^'), "{explained}");
    workshop.stdout(&["ingest", "inbox"], 0);
    assert_eq!(workshop.stdout(&["quarantine", "list"], 0), "nothing is quarantined\n");
    assert_eq!(
        workshop.query("SELECT status, reason, superseded_by_run_id FROM runs ORDER BY run_id"),
        ["superseded|superseded by run 2: the export was corrected|2", "complete||"]
    );
    assert_eq!(workshop.query("SELECT state, value FROM quarantine"), ["superseded|#NV"]);
    let settled = workshop.stderr(&["quarantine", "retry", "1"], 2);
    assert!(settled.contains("superseded by run 2"), "{settled}");
}

#[test]
fn a_retry_after_the_layout_was_mended_keeps_the_number_and_the_history() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    write_layout(&workshop, "phase");
    workshop.stdout(&["ingest", "inbox"], 1);
    write_layout(&workshop, "Stage");
    assert_eq!(workshop.number(OPEN), 1);
    workshop.stdout(&["quarantine", "retry", "--all"], 1);
    write_layout(&workshop, "stage");
    let done = workshop.stdout(&["quarantine", "retry", "--all"], 0);
    assert!(done.starts_with("stored"), "{done}");
    assert_eq!(workshop.query("SELECT run_id, status, cycles FROM runs"), ["1|complete|5"]);
    assert_eq!(
        workshop.query("SELECT state, column_name FROM quarantine ORDER BY last_at"),
        ["stored|phase", "stored|Stage"]
    );
    let all = workshop.stdout(&["quarantine", "list", "--all", "--json"], 0);
    assert_eq!(all.lines().count(), 2, "{all}");
}

#[test]
fn a_running_daemon_reads_its_configuration_and_the_export_again() {
    let workshop = Workshop::new();
    workshop.add_reference("inbox");
    write_layout(&workshop, "phase");
    let daemon = workshop.daemon();
    workshop.wait_for(OPEN, 1);
    let tried = workshop.stdout(&["quarantine", "retry", "1"], 1);
    assert!(tried.starts_with("quarantined") && tried.contains("phase"), "{tried}");
    write_layout(&workshop, "stage");
    let done = workshop.stdout(&["quarantine", "retry", "1"], 0);
    assert!(done.starts_with("stored") && done.contains("run 1, 5 cycles"), "{done}");
    // later exports are also read by the corrected layout
    let cycle: Vec<String> = decompressed().lines().take(1 + 8509).map(str::to_owned).collect();
    fs::write(workshop.inbox("R01_20260106_0847.csv"), cycle.join("\n") + "\n").expect("an export");
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 2);
    // a file outside the watched folders is read by the command itself
    let elsewhere: PathBuf = workshop.path("R02_20260106_0847.csv");
    fs::write(&elsewhere, "time,pos_1\n0,1\n").expect("an export");
    workshop.stdout(&["ingest", "R02_20260106_0847.csv"], 1);
    let own = workshop.stdout(&["quarantine", "retry", "R02_20260106_0847.csv"], 1);
    assert!(own.starts_with("quarantined"), "{own}");
    fs::remove_file(&elsewhere).expect("removed");
    let gone = workshop.stdout(&["quarantine", "retry", "--all"], 1);
    assert!(gone.starts_with("gone") && gone.contains("export it again"), "{gone}");
    daemon.stop();
}

#[test]
fn a_quarantine_is_logged_when_it_is_new_and_not_at_each_start() {
    let workshop = Workshop::new();
    fs::write(workshop.inbox(NAME), "time,pos_1\n0,1\n").expect("an export");
    let logged = || workshop.log().matches("quarantined: ").count();
    for name in ["R01_20260106_0847.csv", "R02_20260107_0847.csv"] {
        // after the first by name, so that both are scanned in each life
        fs::write(workshop.inbox(name), format!("time,{name}\n0,1\n")).expect("an export");
        let daemon = workshop.daemon();
        workshop.wait_for(&format!("SELECT count(*) FROM quarantine WHERE source_name = '{name}'"), 1);
        daemon.stop();
        fs::remove_file(workshop.inbox(name)).expect("removed");
    }
    assert_eq!(logged(), 3, "{}", workshop.log());
    assert!(workshop.log().contains("exports in quarantine"), "{}", workshop.log());
}

#[test]
fn what_is_no_export_is_dismissed_with_a_reason_and_a_retry_brings_it_back() {
    let workshop = Workshop::new();
    fs::write(workshop.inbox("notes.csv"), "part;number\nscrew;12\n").expect("a list");
    workshop.stdout(&["ingest", "inbox"], 1);
    let missing = workshop.run(&["quarantine", "dismiss", "notes.csv"]);
    assert_eq!(missing.status.code(), Some(2), "a reason is asked for");
    let dismiss = ["quarantine", "dismiss", "notes.csv", "--reason", "a list of parts", "--by", "mueller"];
    let said = workshop.stdout(&dismiss, 0);
    assert!(said.starts_with("dismissed") && said.contains("retry 1"), "{said}");
    let states = "SELECT state, dismissed_by, dismissal_reason, dismissed_at LIKE '20__-%Z' FROM quarantine";
    assert_eq!(workshop.query(states), ["dismissed|mueller|a list of parts|1"]);
    assert_eq!(workshop.stdout(&["quarantine", "list"], 0), "nothing is quarantined\n");
    assert_eq!(workshop.stdout(&["quarantine", "retry", "--all"], 0), "nothing is quarantined\n");
    let listed = json(&workshop.stdout(&["quarantine", "list", "--all", "--json"], 0));
    assert_eq!(
        (listed["state"].as_str(), listed["dismissed_by"].as_str()),
        (Some("dismissed"), Some("mueller"))
    );
    let twice = workshop.stderr(&dismiss, 2);
    assert!(twice.contains("by mueller: a list of parts"), "{twice}");

    // neither the daemon nor the overview of the fleet counts it
    let daemon = workshop.daemon();
    workshop.wait_until(|| workshop.log().contains("watching"));
    daemon.stop();
    assert!(!workshop.log().contains("exports in quarantine"), "{}", workshop.log());

    // if it is read again by accident, it stays dismissed; if it is named, it is open again
    workshop.stdout(&["ingest", "inbox"], 1);
    assert_eq!(workshop.number(OPEN), 0);
    workshop.stdout(&["quarantine", "retry", "notes.csv"], 1);
    assert_eq!(workshop.number(OPEN), 1);
    assert_eq!(workshop.number("SELECT count(*) FROM dismissal WHERE withdrawn_at > dismissed_at"), 1);
    workshop.stdout(&dismiss, 0);
    assert_eq!(workshop.number(OPEN), 0);
}

#[test]
fn a_person_who_may_act_sees_the_fault_in_the_export_and_no_file_that_is_none() {
    let screen = "[[serve.token]]\nname = \"screen\"\nfile = \"screen\"\nscopes = [\"read\"]\n";
    let served = Served::with(true, screen);
    let faulty = export("B", 2, 6);
    let rows: Vec<&str> = std::str::from_utf8(&faulty.bytes).expect("text").lines().collect();
    let mut cells: Vec<&str> = rows[6].split(',').collect();
    cells[1] = "x7";
    let wrong = cells.join(",");
    let text: Vec<&str> =
        rows.iter().enumerate().map(|(at, row)| if at == 6 { &*wrong } else { *row }).collect();
    let bytes = text.join("\n") + "\n";
    fs::write(served.workshop.inbox(&faulty.name), &bytes).expect("written");
    fs::write(served.workshop.inbox("passwords.csv"), "user,password\nlena,secret\notto,hidden\n")
        .expect("written");
    let number = |name: &str| {
        served.workshop.number(&format!("SELECT run_id FROM quarantine WHERE source_name LIKE '{name}%'"))
    };
    served.workshop.wait_until(|| number("passwords") > 0 && number(&faulty.name) > 0);
    let run = number(&faulty.name);

    let found = served.get(&format!("/v1/quarantine/{run}/excerpt"));
    assert_eq!(found.status, 200, "{}", found.body);
    let found = found.json();
    assert_eq!((&found["line"], &found["first_line"]), (&json!(7), &json!(5)));
    assert_eq!(found["lines"], json!([rows[4], rows[5], wrong, rows[7], rows[8]]));
    let cell = |name: &str| found[name].as_u64().and_then(|at| usize::try_from(at).ok()).expect("a cell");
    assert_eq!(&wrong[cell("cell_begin")..cell("cell_end")], "x7");
    let file = served.get(&format!("/v1/quarantine/{run}/file"));
    assert_eq!((file.status, file.body.as_str()), (200, bytes.as_str()));
    assert!(file.header("content-disposition").is_some_and(|name| name.contains(&faulty.name)));

    for what in ["excerpt", "file"] {
        let secret = served.get(&format!("/v1/quarantine/{}/{what}", number("passwords")));
        assert_eq!(secret.status, 404, "{}", secret.body);
        assert!(!secret.body.contains("lena") && secret.body.contains("may be no export"), "{}", secret.body);
        let header = "Authorization: Bearer token-of-a-screen-0123\r\n";
        let refused = served.ask(&format!("GET /v1/quarantine/{run}/{what}"), header, b"");
        assert_eq!(refused.status, 403, "{}", refused.body);
    }
    // of other bytes, the lines say nothing
    fs::write(served.workshop.inbox(&faulty.name), "time\n1\n").expect("written");
    assert_eq!(served.get(&format!("/v1/quarantine/{run}/file")).status, 410);
    served.end();
}
