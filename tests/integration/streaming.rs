//! Exports that grow, read by the real daemon. Cycles show while the file is written. The rows are those of the whole
//! file read once, whatever the writer and the daemon did before.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::canon::without;
use crate::support::{Workshop, assert_alike, pass};

const COMPLETE: &str = "SELECT COUNT(*) FROM runs WHERE status = 'complete'";
const CYCLES: &str = "SELECT COUNT(*) FROM cycles";

/// Longest time of a test's writer for a file: far longer than a scan of the daemon, and with pauses far shorter than
/// the time to settle.
const WRITING: Duration = Duration::from_millis(2500);

/// An export to be written slowly.
struct Export {
    name: String,
    text: Vec<u8>,
}

impl Export {
    fn new(robot: &str, cycles: u32, seed: u32) -> Self {
        let workshop = Workshop::new();
        let (cycles, seed) = (cycles.to_string(), seed.to_string());
        let arguments = ["--cycles", &cycles, "--warming-s", "5", "--name", robot, "--seed", &seed];
        let path = workshop.simulate("made", &arguments).remove(0);
        let name = path.file_name().expect("a name").to_str().expect("text").to_owned();
        Self { name, text: fs::read(path).expect("an export") }
    }

    fn golden(&self) -> String {
        golden(&[self])
    }

    /// Place after the last row of cycle `number`, plus that many bytes of the next row.
    fn end_of_cycle(&self, number: u32) -> usize {
        let text = std::str::from_utf8(&self.text).expect("text");
        let mut at = 0;
        for line in text.split_inclusive('\n') {
            let cycle = line.split(',').nth(20).and_then(|cell| cell.parse::<u32>().ok());
            if cycle.is_some_and(|cycle| cycle > number) {
                return at;
            }
            at += line.len();
        }
        at
    }
}

fn golden(exports: &[&Export]) -> String {
    let workshop = Workshop::new();
    for export in exports {
        fs::write(workshop.inbox(&export.name), &export.text).expect("written");
        workshop.stdout(&["ingest", "inbox"], 0);
    }
    workshop.dump()
}

fn started(workshop: &Workshop) -> crate::support::Daemon {
    let daemon = workshop.daemon();
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE run_id < 0", 0);
    daemon
}

fn append(path: &PathBuf, bytes: &[u8]) {
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    file.write_all(bytes).expect("written");
}

/// Cuts of `length` bytes into `pieces` pieces of random size.
fn pieces(random: &mut ChaCha8Rng, length: usize, pieces: usize) -> Vec<usize> {
    let mut cuts: Vec<usize> = (1..pieces).map(|_| random.random_range(0..=length)).collect();
    cuts.extend([0, length]);
    cuts.sort_unstable();
    cuts
}

/// Appends an export in pieces of random size within [`WRITING`].
fn write_slowly(path: &PathBuf, text: &[u8], random: &mut ChaCha8Rng, count: usize) {
    let mut file = OpenOptions::new().create(true).append(true).open(path).expect("an export");
    for cut in pieces(random, text.len(), count).windows(2) {
        file.write_all(&text[cut[0]..cut[1]]).expect("written");
        pass(WRITING / u32::try_from(count).expect("few"));
    }
}

fn stop(daemon: crate::support::Daemon) {
    daemon.stop();
}

fn assert_sound(workshop: &Workshop) {
    assert_eq!(workshop.query("PRAGMA integrity_check"), ["ok"]);
    assert_eq!(workshop.query("PRAGMA foreign_key_check"), [""; 0]);
}

#[test]
fn a_cycle_is_stored_while_its_file_is_still_written() {
    let export = Export::new("A", 4, 1);
    let workshop = Workshop::new();
    workshop.set("settle_s", "60");
    let daemon = started(&workshop);
    let path = workshop.inbox(&export.name);
    let first = export.end_of_cycle(1);
    append(&path, &export.text[..first / 2]);
    // it is read after it was seen growing
    workshop.wait_for_a_look();
    append(&path, &export.text[first / 2..first]);
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'streaming' AND content_hash IS NULL", 1);
    assert_eq!(workshop.number(CYCLES), 0, "a cycle ends where the next one begins");
    let mut from = first;
    for cycle in 1..4 {
        let to = export.end_of_cycle(cycle + 1);
        // all except the last row of the next cycle, so that it is not over
        append(&path, &export.text[from..to - 1]);
        let written = Instant::now();
        workshop.wait_for(CYCLES, i64::from(cycle));
        println!("cycle {cycle}: in the database {:?} after its last row", written.elapsed());
        assert_eq!(workshop.query("SELECT status, cycles FROM runs"), [format!("streaming|{cycle}")]);
        append(&path, &export.text[to - 1..to]);
        from = to;
    }
    // the last cycle ends with the file, and the marker shows its end
    fs::write(workshop.inbox(&format!("{}.done", export.name)), "").expect("a mark");
    workshop.wait_for(COMPLETE, 1);
    assert_alike(&workshop.dump(), &export.golden(), "dump");
    stop(daemon);
}

#[test]
fn pieces_of_any_size_give_the_same_rows() {
    let export = Export::new("A", 3, 2);
    let golden = export.golden();
    for seed in 0..4 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let workshop = Workshop::new();
        workshop.set("settle_s", "0.6");
        let daemon = started(&workshop);
        let count = [7, 20, 60, 150][usize::try_from(seed).expect("few")];
        write_slowly(&workshop.inbox(&export.name), &export.text, &mut random, count);
        workshop.wait_for(COMPLETE, 1);
        assert_alike(&workshop.dump(), &golden, &format!("seed {seed}"));
        stop(daemon);
    }
}

#[test]
fn a_daemon_killed_while_a_file_grows_ends_with_the_same_rows() {
    let export = Export::new("A", 4, 3);
    let golden = export.golden();
    let mut kills = 0;
    for seed in 10..13 {
        let workshop = Workshop::new();
        workshop.set("settle_s", "0.4");
        let path = workshop.inbox(&export.name);
        let text = export.text.clone();
        let writer = std::thread::spawn(move || {
            write_slowly(&path, &text, &mut ChaCha8Rng::seed_from_u64(seed), 50);
        });
        let mut random = ChaCha8Rng::seed_from_u64(100 + seed);
        while !writer.is_finished() {
            let daemon = workshop.daemon();
            pass(Duration::from_millis(random.random_range(50..900)));
            daemon.signal("KILL");
            assert_eq!(daemon.end(), None);
            kills += 1;
        }
        writer.join().expect("the writer");
        let daemon = workshop.daemon();
        workshop.wait_for(COMPLETE, 1);
        assert_alike(&workshop.dump(), &golden, &format!("seed {seed}"));
        assert_sound(&workshop);
        stop(daemon);
    }
    println!("{kills} kills");
    assert!(kills >= 6, "{kills}");
}

#[test]
fn two_files_grow_at_once() {
    let (a, b) = (Export::new("A", 3, 4), Export::new("B", 3, 5));
    let workshop = Workshop::new();
    workshop.set("settle_s", "0.6");
    let daemon = started(&workshop);
    let write = |export: &Export, seed| {
        let (path, text) = (workshop.inbox(&export.name), export.text.clone());
        std::thread::spawn(move || write_slowly(&path, &text, &mut ChaCha8Rng::seed_from_u64(seed), 40))
    };
    let first = write(&a, 20);
    // numbers of runs follow the order of arrival
    workshop.wait_for("SELECT COUNT(*) FROM runs", 1);
    let second = write(&b, 21);
    workshop.wait_for(COMPLETE, 2);
    for writer in [first, second] {
        writer.join().expect("the writer");
    }
    assert_alike(&workshop.dump(), &golden(&[&a, &b]), "dump");
    stop(daemon);
}

#[test]
fn a_file_that_grows_after_it_was_complete_is_continued() {
    let export = Export::new("A", 4, 6);
    let golden = export.golden();
    let rows = export.text.iter().filter(|byte| **byte == b'\n').count() - 1;
    let inside = (export.end_of_cycle(2) + export.end_of_cycle(3)) / 2;
    let behind_a_row =
        inside + export.text[inside..].iter().position(|byte| *byte == b'\n').expect("a row") + 1;
    // a row that is cut at the end of a file is skipped until more bytes follow
    for (cut, before) in [(behind_a_row, "complete|3"), (behind_a_row - 30, "complete|3")] {
        let workshop = Workshop::new();
        let daemon = started(&workshop);
        let path = workshop.inbox(&export.name);
        append(&path, &export.text[..cut]);
        workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status <> 'streaming'", 1);
        assert_eq!(workshop.query("SELECT status, cycles FROM runs"), [before]);
        append(&path, &export.text[cut..]);
        // until the last row: a busy machine may write so slowly that the file settles before
        workshop
            .wait_for(&format!("SELECT COUNT(*) FROM runs WHERE status = 'complete' AND rows = {rows}"), 1);
        // earlier findings about the file stay only in the history of faults
        let but_faults = |dump: &str| without(dump, "quarantine");
        assert_alike(&but_faults(&workshop.dump()), &but_faults(&golden), before);
        let faults = "SELECT state, problem, cycles_stored FROM quarantine";
        let found = workshop.query(faults);
        assert_eq!(found.len(), usize::from(before.starts_with("quarantined")), "{found:?}");
        assert!(found.iter().all(|fault| fault == "stored|last line is cut|2"), "{found:?}");
        stop(daemon);
        // the same without a daemon, by the one-shot command
        let other = Workshop::new();
        append(&other.inbox(&export.name), &export.text[..cut]);
        other.run(&["ingest", "inbox"]);
        append(&other.inbox(&export.name), &export.text[cut..]);
        other.stdout(&["ingest", "inbox"], 0);
        assert_alike(&but_faults(&other.dump()), &but_faults(&golden), before);
        assert_eq!(other.query(faults), found);
    }
}

#[test]
fn a_file_of_which_one_recording_after_the_other_is_written_gives_a_run_each() {
    let (first, second) = (Export::new("A", 2, 15), Export::new("A", 3, 16));
    let workshop = Workshop::new();
    workshop.set("settle_s", "0.6");
    let daemon = started(&workshop);
    let (current, moved) = (workshop.inbox("A.csv"), workshop.inbox(&first.name));
    write_slowly(&current, &first.text, &mut ChaCha8Rng::seed_from_u64(60), 20);
    // moved away while its run may still be open
    fs::rename(&current, &moved).expect("renamed");
    write_slowly(&current, &second.text, &mut ChaCha8Rng::seed_from_u64(61), 20);
    workshop.wait_for(COMPLETE, 2);
    assert_eq!(
        workshop.query("SELECT status, cycles FROM runs ORDER BY run_id"),
        ["complete|2", "complete|3"]
    );
    stop(daemon);
}

#[test]
fn a_file_written_over_is_superseded_and_kept() {
    let (old, new) = (Export::new("A", 2, 7), Export::new("A", 3, 8));
    let workshop = Workshop::new();
    let daemon = started(&workshop);
    let path = workshop.inbox(&old.name);
    append(&path, &old.text);
    workshop.wait_for(COMPLETE, 1);
    let mut file = File::create(&path).expect("truncated");
    file.write_all(&new.text).expect("written");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'superseded'", 1);
    let runs = "SELECT run_id, status, cycles, superseded_by_run_id FROM runs ORDER BY run_id";
    assert_eq!(workshop.query(runs), ["1|superseded|2|2", "2|complete|3|"]);
    let reason = workshop.query("SELECT reason FROM runs WHERE run_id = 1");
    assert_eq!(reason, ["superseded by run 2: the recording was exported again"]);
    workshop.wait_for_conclusions();
    let fits = workshop.query("SELECT SUM(samples) FROM warmup_fits WHERE run_id IS NULL");
    let alone =
        workshop.query("SELECT SUM(samples) FROM warmup_fits WHERE run_id = 2 AND speed_fraction = 0.6");
    assert_eq!(fits, alone, "the superseded run takes part in the fits over all runs");

    // the first content is written again
    fs::write(&path, &old.text).expect("written");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'complete' AND cycles = 2", 1);
    assert_eq!(
        workshop.query("SELECT status, cycles FROM runs ORDER BY cycles"),
        ["complete|2", "superseded|3"]
    );
    assert_sound(&workshop);
    stop(daemon);
}

#[test]
fn both_stand_where_the_configuration_says_so() {
    let (old, new) = (Export::new("A", 2, 7), Export::new("A", 3, 8));
    let workshop = Workshop::new();
    workshop.set("on_rewrite", "\"keep_both\"");
    for export in [&old, &new] {
        fs::write(workshop.inbox(&old.name), &export.text).expect("written");
        workshop.stdout(&["ingest", "inbox"], 0);
    }
    assert_eq!(
        workshop.query("SELECT status, cycles FROM runs ORDER BY run_id"),
        ["complete|2", "complete|3"]
    );
}

#[test]
fn a_file_truncated_while_it_grows_is_begun_anew_and_its_cycles_are_kept() {
    let (old, new) = (Export::new("A", 3, 9), Export::new("A", 3, 10));
    let workshop = Workshop::new();
    workshop.set("settle_s", "60");
    let daemon = started(&workshop);
    let path = workshop.inbox(&old.name);
    let start = old.end_of_cycle(1);
    append(&path, &old.text[..start]);
    workshop.wait_for_a_look();
    append(&path, &old.text[start..old.end_of_cycle(2)]);
    workshop.wait_for("SELECT COUNT(*) FROM cycles WHERE run_id = 1", 1);
    File::create(&path).expect("truncated");
    write_slowly(&path, &new.text, &mut ChaCha8Rng::seed_from_u64(30), 30);
    fs::write(workshop.inbox(&format!("{}.done", new.name)), "").expect("a mark");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE run_id = 2 AND status = 'complete'", 1);
    let runs =
        workshop.query("SELECT run_id, status, cycles, content_hash IS NULL FROM runs ORDER BY run_id");
    // the first run ended with the rows read so far, and the new recording of the same test supersedes it
    assert_eq!(runs, ["1|superseded|2|0", "2|complete|3|0"]);
    let parameters = |workshop: &Workshop, run: u32| {
        workshop.query(&format!(
            "SELECT cycle, joint, parameter, value FROM cycle_parameters WHERE run_id = {run} ORDER BY 1, 2, 3"
        ))
    };
    let calm = Workshop::new();
    fs::write(calm.inbox(&new.name), &new.text).expect("written");
    calm.stdout(&["ingest", "inbox"], 0);
    assert_eq!(parameters(&workshop, 2), parameters(&calm, 1));
    stop(daemon);
}

/// A tool copies the file and truncates it (`copytruncate`), and its writer continues in the middle of a row.
#[test]
fn rows_without_a_header_behind_a_cut_are_read_by_the_header_before() {
    let export = Export::new("A", 3, 9);
    let workshop = Workshop::new();
    workshop.set("settle_s", "60");
    let daemon = started(&workshop);
    let path = workshop.inbox(&export.name);
    let [first, second] = [1, 2].map(|cycle| export.end_of_cycle(cycle));
    append(&path, &export.text[..first]);
    workshop.wait_for_a_look();
    append(&path, &export.text[first..second]);
    workshop.wait_for("SELECT COUNT(*) FROM cycles WHERE run_id = 1", 1);
    daemon.wait_until_read(&path);
    File::create(&path).expect("truncated");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE run_id = 1 AND status = 'complete'", 1);
    let middle = second + (export.text.len() - second) / 2;
    append(&path, &export.text[second - 8..middle]);
    workshop.wait_for("SELECT COUNT(*) FROM runs", 2);
    // a daemon that starts now knows the header as well
    daemon.signal("KILL");
    assert_eq!(daemon.end(), None);
    let daemon = started(&workshop);
    append(&path, &export.text[middle..]);
    fs::write(workshop.inbox(&format!("{}.done", export.name)), "").expect("a mark");
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE run_id = 2 AND status = 'complete'", 1);
    // the rest does not replace the earlier run
    assert_eq!(
        workshop.query("SELECT run_id, status, cycles FROM runs ORDER BY run_id"),
        ["1|complete|2", "2|complete|1"]
    );
    assert!(workshop.log().contains("the file was truncated and its rows continue without a header"));
    let parameters = |workshop: &Workshop| {
        workshop.query(
            "SELECT joint, parameter, ROUND(value, 6) FROM cycle_parameters WHERE cycle = 3 ORDER BY 1, 2",
        )
    };
    let whole = Workshop::new();
    fs::write(whole.inbox(&export.name), &export.text).expect("written");
    whole.stdout(&["ingest", "inbox"], 0);
    assert!(!parameters(&whole).is_empty());
    assert_eq!(parameters(&workshop), parameters(&whole));
    stop(daemon);
}

#[test]
fn a_file_renamed_while_it_grows_stays_one_run() {
    let export = Export::new("A", 3, 11);
    let golden = export.golden();
    let workshop = Workshop::new();
    workshop.set("settle_s", "60");
    let (path, moved) = (workshop.inbox(&export.name), workshop.inbox("A_20260201_0000_moved.csv"));
    let moved_again = workshop.inbox("A_20260201_0000_again.csv");
    let daemon = started(&workshop);
    let (first, second) = (export.end_of_cycle(1) + 1000, export.end_of_cycle(2) + 1000);
    append(&path, &export.text[..100]);
    workshop.wait_for_a_look();
    append(&path, &export.text[100..first]);
    workshop.wait_for(CYCLES, 1);
    fs::rename(&path, &moved).expect("renamed");
    append(&moved, &export.text[first..second]);
    workshop.wait_for(CYCLES, 2);
    // and again without a running daemon
    daemon.signal("KILL");
    assert_eq!(daemon.end(), None);
    fs::rename(&moved, &moved_again).expect("renamed");
    let daemon = started(&workshop);
    append(&moved_again, &export.text[second..second + 10]);
    workshop.wait_for_a_look();
    append(&moved_again, &export.text[second + 10..]);
    fs::write(workshop.inbox("A_20260201_0000_again.csv.done"), "").expect("a mark");
    workshop.wait_for(COMPLETE, 1);
    assert_alike(&workshop.dump(), &golden, "dump");
    stop(daemon);
}

#[test]
fn a_copy_of_the_whole_content_makes_no_second_run() {
    let export = Export::new("A", 3, 12);
    let golden = export.golden();
    // the copy is stored before the growing file is finished, or after it
    for copy_first in [true, false] {
        let workshop = Workshop::new();
        workshop.set("settle_s", "0.6");
        let daemon = started(&workshop);
        let copy = workshop.inbox("copy.csv");
        if copy_first {
            fs::write(workshop.path("whole.csv"), &export.text).expect("written");
            fs::create_dir(workshop.inbox("sub")).expect("a folder");
            fs::rename(workshop.path("whole.csv"), workshop.inbox("sub").join(&export.name))
                .expect("moved in");
            workshop.wait_for(COMPLETE, 1);
        }
        write_slowly(&workshop.inbox(&export.name), &export.text, &mut ChaCha8Rng::seed_from_u64(40), 30);
        if !copy_first {
            workshop.wait_for(COMPLETE, 1);
            fs::copy(workshop.inbox(&export.name), copy).expect("copied");
        }
        workshop.wait_until_idle();
        assert_eq!(workshop.number("SELECT COUNT(*) FROM source_file"), 2);
        assert_alike(&workshop.dump(), &golden, &format!("copy first: {copy_first}"));
        stop(daemon);
    }
}

#[test]
fn a_growing_file_with_a_fault_is_quarantined_at_its_end_and_holds_up_nobody() {
    let (bad, good) = (Export::new("A", 3, 13), Export::new("B", 2, 14));
    let mut spoiled = bad.text.clone();
    let at = bad.end_of_cycle(2) + 200;
    let comma = at + spoiled[at..].iter().position(|byte| *byte == b',').expect("a comma");
    spoiled[comma + 1] = b'x';
    let workshop = Workshop::new();
    workshop.set("settle_s", "0.8");
    let daemon = started(&workshop);
    let path = workshop.inbox(&bad.name);
    let writer = std::thread::spawn({
        let (path, text) = (path.clone(), spoiled.clone());
        move || write_slowly(&path, &text, &mut ChaCha8Rng::seed_from_u64(50), 40)
    });
    workshop.wait_for("SELECT COUNT(*) FROM runs", 1);
    fs::write(workshop.inbox(&good.name), &good.text).expect("written");
    workshop.wait_for(COMPLETE, 1);
    workshop.wait_for("SELECT COUNT(*) FROM runs WHERE status = 'quarantined'", 1);
    writer.join().expect("the writer");
    workshop
        .wait_for("SELECT COUNT(*) FROM runs WHERE status = 'quarantined' AND content_hash IS NOT NULL", 1);
    let of_bad = "SELECT source_name, content_hash, cycles, reason, reason_line FROM runs WHERE robot = 'A'";
    let calm = Workshop::new();
    fs::write(calm.inbox(&bad.name), &spoiled).expect("written");
    calm.stdout(&["ingest", "inbox"], 1);
    assert_eq!(workshop.query(of_bad), calm.query(of_bad));
    stop(daemon);
}
