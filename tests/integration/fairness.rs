//! Many robots of one daemon: each is read in turn, whatever its name and the number of the others.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::PathBuf;

use crate::support::{Daemon, Workshop, assert_alike};

/// An export that a robot of this fleet writes.
struct Export {
    path: PathBuf,
    text: Vec<u8>,
    written: usize,
}

impl Export {
    /// Writes up to this byte.
    fn grow_to(&mut self, end: usize) {
        let end = end.min(self.text.len());
        if end > self.written {
            let file = OpenOptions::new().create(true).append(true).open(&self.path);
            file.expect("an export").write_all(&self.text[self.written..end]).expect("written");
            self.written = end;
        }
    }

    fn done(&self) {
        let mut mark = self.path.clone().into_os_string();
        mark.push(".done");
        fs::write(mark, "").expect("a mark");
    }
}

/// Exports of `robots` robots, equal except for the last digit of one cell.
fn exports(workshop: &Workshop, robots: u8, cycles: u32) -> Vec<Export> {
    let arguments = ["--cycles", &cycles.to_string(), "--warming-s", "5", "--name", "R00"];
    let made = workshop.simulate("made", &arguments).remove(0);
    let name = made.file_name().expect("a name").to_str().expect("text").to_owned();
    let text = fs::read_to_string(made).expect("an export");
    let (header, rows) = text.split_once('\n').expect("rows");
    let (first, others) = rows.split_once('\n').expect("rows");
    let of_robot = |number: u8| {
        let mut cells: Vec<String> = first.split(',').map(str::to_owned).collect();
        cells[1].push_str(&format!("{number:02}"));
        let text = format!("{header}\n{}\n{others}", cells.join(",")).into_bytes();
        Export { path: workshop.inbox(&name.replacen("R00", &format!("R{number:02}"), 1)), text, written: 0 }
    };
    (1..=robots).map(of_robot).collect()
}

/// Place after the first rows of cycle `number`, which end the one before it.
fn into_cycle(text: &[u8], number: u32) -> usize {
    let text = std::str::from_utf8(text).expect("text");
    let mut at = 0;
    for line in text.split_inclusive('\n') {
        let cycle = line.split(',').nth(20).and_then(|cell| cell.parse::<u32>().ok());
        at += line.len();
        if cycle.is_some_and(|cycle| cycle >= number) {
            break;
        }
    }
    at
}

fn stop(daemon: Daemon) {
    daemon.stop();
}

#[test]
fn twenty_robots_that_write_at_once_are_all_read_while_they_write() {
    let workshop = Workshop::new();
    workshop.set("settle_s", "600");
    workshop.set("live_files", "6");
    let mut exports = exports(&workshop, 20, 3);
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs", 0);
    // seen first, then seen growing
    let start = exports[0].text.len() / 10;
    exports.iter_mut().for_each(|export| export.grow_to(start));
    workshop.wait_until(|| workshop.number("SELECT COUNT(*) FROM runs") >= 0);
    for cycle in 1..3 {
        let end = into_cycle(&exports[0].text, cycle + 1);
        let mut rows = 0;
        workshop.wait_until(|| {
            // every file continues to grow while others are read
            rows += 1;
            exports.iter_mut().for_each(|export| export.grow_to(end + 300 * rows));
            workshop.number(&format!("SELECT COUNT(*) FROM runs WHERE cycles >= {cycle}")) == 20
        });
        assert_eq!(workshop.number("SELECT COUNT(*) FROM runs WHERE status = 'streaming'"), 20);
    }
    for export in &mut exports {
        export.grow_to(usize::MAX);
        export.done();
    }
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete'", 20);
    workshop.wait_for_conclusions();
    stop(daemon);
    let log = workshop.log();
    let short: Vec<&str> = log.lines().filter(|line| line.contains("watch.live_files = 6")).collect();
    assert!(short.len() == 1 && short[0].contains("WARN"), "{log}");
    let calm = Workshop::new();
    for export in &exports {
        fs::copy(&export.path, calm.inbox(export.path.file_name().expect("a name").to_str().expect("text")))
            .expect("copied");
    }
    calm.stdout(&["ingest", "inbox"], 0);
    assert_alike(&workshop.canonical_dump(), &calm.canonical_dump(), "dump");
}
