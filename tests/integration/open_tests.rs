//! Alarms of a test that is still being written, from the real daemon.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::support::{Daemon, Workshop, assert_alike};

const STEP: &str = "SELECT count(*) FROM anomalies WHERE kind = 'step' AND joint = 3 AND state = 'open'";

/// Three healthy tests and one with a jump of friction of joint 3 in cycle 4.
fn tests(workshop: &Workshop) -> Vec<PathBuf> {
    let shape = ["--runs", "4", "--cycles", "8", "--warming-s", "5", "--name", "R01", "--seed", "11"];
    let fault = ["--fault", "step:joint=3,from=4,cycle=4,size=0.3"];
    let mut exports = workshop.simulate("made", &[&shape[..], &fault].concat());
    exports.sort();
    exports
}

fn name(export: &Path) -> &str {
    export.file_name().expect("a name").to_str().expect("text")
}

/// Place after the last row of cycle `number`, plus that many bytes of the next row.
fn end_of_cycle(text: &str, number: u32) -> usize {
    let mut at = 0;
    for line in text.split_inclusive('\n') {
        let cycle = line.split(',').nth(20).and_then(|cell| cell.parse::<u32>().ok());
        if cycle.is_some_and(|cycle| cycle > number) {
            return at + line.len();
        }
        at += line.len();
    }
    at
}

fn append(path: &Path, text: &str) {
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    file.write_all(text.as_bytes()).expect("written");
}

fn stop(daemon: Daemon, signal: &str) {
    daemon.signal(signal);
    daemon.end();
}

#[test]
fn a_step_is_an_alarm_one_cycle_later_while_the_export_is_written() {
    let golden = Workshop::new();
    let exports = tests(&golden);
    for export in &exports {
        fs::copy(export, golden.inbox(name(export))).expect("a copy");
    }
    golden.stdout(&["ingest", "inbox"], 0);
    assert_eq!(golden.number(STEP), 1);

    let workshop = Workshop::new();
    let (growing, complete) = exports.split_last().expect("exports");
    for export in complete {
        fs::copy(export, workshop.inbox(name(export))).expect("a copy");
    }
    workshop.stdout(&["ingest", "inbox"], 0);
    workshop.set("settle_s", "60");
    let daemon = workshop.daemon();
    let text = fs::read_to_string(growing).expect("an export");
    let path = workshop.inbox(name(growing));
    let cuts: Vec<usize> = [1, 3, 4, 5].iter().map(|cycle| end_of_cycle(&text, *cycle)).collect();
    append(&path, &text[..cuts[0] / 2]);
    // it is read after it was seen growing
    workshop.wait_for_a_look();
    append(&path, &text[cuts[0] / 2..cuts[2]]);
    let cycles = "SELECT cycles FROM runs WHERE status = 'streaming'";
    workshop.wait_until(|| workshop.query(cycles) == ["4"]);
    workshop.wait_until(|| workshop.log().contains("cycles=4 found=0"));
    assert_eq!(workshop.number(STEP), 0, "one cycle is no level");

    append(&path, &text[cuts[2]..cuts[3]]);
    workshop.wait_for(STEP, 1);
    assert_eq!(workshop.query(cycles), ["5"], "long before the export is complete");
    let shown = "SELECT anomaly_id, run_id = (SELECT run_id FROM runs WHERE status = 'streaming'), cycle, onset_cycle,
                        severity, provisional, odds > 1000
                 FROM anomalies WHERE kind = 'step'";
    assert_eq!(workshop.query(shown), ["1|1|4|4|critical|1|1"]);
    // the outbox has it for the only route, the log
    workshop.wait_for("SELECT count(*) FROM deliveries WHERE what = 'opened' AND state = 'sent'", 1);
    stop(daemon, "KILL");

    let daemon = workshop.daemon();
    workshop.wait_until(|| workshop.log().matches("cycles=5").count() >= 2);
    append(&path, &text[cuts[3]..]);
    fs::write(workshop.inbox(&format!("{}.done", name(growing))), "").expect("a mark");
    workshop.wait_for("SELECT count(*) FROM runs WHERE status = 'complete'", 4);
    assert_alike(&workshop.dump(), &golden.dump(), "dump");
    let told = "SELECT what FROM anomaly_history WHERE anomaly_id = 1 ORDER BY anomaly_event_id";
    assert_eq!(workshop.query(told), ["opened"]);
    stop(daemon, "TERM");
}
