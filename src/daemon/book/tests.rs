//! The order in which files are taken.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::{Begun, Closing, FileSchedule, NextAttempt};
use crate::ingest::find::watch::FoundFile;
use crate::run::FileId;

const SETTLE: Duration = Duration::from_secs(3);

struct Desk {
    book: FileSchedule,
    start: Instant,
    files: Vec<FoundFile>,
}

impl Desk {
    fn new() -> Self {
        Self { book: FileSchedule::new(SETTLE, HashMap::new()), start: Instant::now(), files: Vec::new() }
    }

    /// Writes a file: its number is the first digit of its name.
    fn write(&mut self, name: &str, size: u64) {
        let inode = name.bytes().find(u8::is_ascii_digit).map_or(0, u64::from);
        let path = PathBuf::from(name);
        self.files.retain(|file| file.path != path);
        let file = FileId { device: 1, inode };
        self.files.push(FoundFile { path, size, modified: SystemTime::UNIX_EPOCH, file });
    }

    fn look(&mut self, at_s: u64) {
        let now = self.start + Duration::from_secs(at_s);
        self.book.note(&self.files, now, |path| path.ends_with("marked1"), lane);
    }

    fn growing(&mut self) -> Option<NextAttempt> {
        self.book.next_growing()
    }

    fn settled(&mut self, busy: &[&str]) -> Option<NextAttempt> {
        let busy = busy.iter().map(|lane| (*lane).to_owned()).collect();
        self.book.next_settled(&busy, |_| true).map(|(due, _)| due)
    }
}

fn lane(path: &Path) -> String {
    path.display().to_string()[..1].to_owned()
}

fn name(due: Option<&NextAttempt>) -> Option<&str> {
    due.and_then(|due| due.path.to_str())
}

#[test]
fn a_file_that_was_seen_to_grow_is_read_at_once_and_one_that_stands_when_it_has_settled() {
    let mut desk = Desk::new();
    desk.write("a1", 10);
    desk.write("b2", 10);
    desk.look(0);
    assert!(desk.growing().is_none() && desk.settled(&[]).is_none());
    desk.write("a1", 11);
    desk.look(1);
    let growing = desk.growing().expect("it grew");
    assert_eq!((name(Some(&growing)), growing.patience), (Some("a1"), SETTLE));
    assert!(desk.growing().is_none());
    desk.look(3);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("b2"));
    desk.look(9);
    assert!(desk.settled(&[]).is_none(), "both are open");
}

#[test]
fn a_mark_ends_the_wait() {
    let mut desk = Desk::new();
    desk.write("marked1", 10);
    desk.look(0);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("marked1"));
}

#[test]
fn what_was_begun_before_is_taken_at_once_if_it_is_as_it_was() {
    let mut desk = Desk::new();
    let settled = |size| Begun::Settled(size, 0);
    let begun = [("a1", Begun::Growing), ("b2", settled(10)), ("c3", settled(9))];
    desk.book = FileSchedule::new(SETTLE, begun.map(|(name, begun)| (name.into(), begun)).into());
    ["a1", "b2", "c3"].into_iter().for_each(|name| desk.write(name, 10));
    desk.look(0);
    assert_eq!(name(desk.growing().as_ref()), Some("a1"));
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("b2"));
    assert_eq!(name(desk.settled(&[]).as_ref()), None, "it has changed since");
    desk.look(3);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("c3"));
}

#[test]
fn what_was_decided_before_is_left_alone_until_it_changes() {
    let mut desk = Desk::new();
    ["a1", "a2"].into_iter().for_each(|name| desk.write(name, 10));
    let unseen: Vec<&Path> = desk.book.unseen(&desk.files).map(|file| file.path.as_path()).collect();
    assert_eq!(unseen, [Path::new("a1"), Path::new("a2")]);
    desk.book.taken_before(["a1".into()].into_iter());
    [0, 3].into_iter().for_each(|at| desk.look(at));
    assert_eq!(desk.book.unseen(&desk.files).count(), 0);
    assert_eq!(desk.book.waiting(desk.start), 1);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("a2"));
    assert_eq!(name(desk.settled(&[]).as_ref()), None);
    desk.write("a1", 11);
    desk.look(4);
    assert_eq!(name(desk.growing().as_ref()), Some("a1"));
}

#[test]
fn a_file_that_cannot_be_read_is_tried_less_and_less_often_until_it_changes() {
    let mut desk = Desk::new();
    desk.write("a1", 10);
    let mut tries = Vec::new();
    for second in 0..200 {
        desk.look(second);
        if let Some(due) = desk.settled(&[]) {
            tries.push(second);
            desk.book.close(&due, Closing::Unreadable);
        }
    }
    assert_eq!(tries, [3, 6, 12, 24, 48, 96, 156]);
    desk.write("a1", 11);
    desk.look(200);
    assert_eq!(name(desk.growing().as_ref()), Some("a1"));
}

#[test]
fn lanes_go_side_by_side_each_in_the_order_of_names() {
    let mut desk = Desk::new();
    for name in ["b4", "a3", "a2", "b5"] {
        desk.write(name, 10);
    }
    [0, 3].into_iter().for_each(|at| desk.look(at));
    assert_eq!(name(desk.settled(&["a"]).as_ref()), Some("b4"));
    assert_eq!(name(desk.settled(&["b"]).as_ref()), Some("a2"));
    assert_eq!(name(desk.settled(&["a", "b"]).as_ref()), None);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("b5"), "b was served before a");
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("a3"));
}

#[test]
fn robots_are_served_in_turn_and_not_by_their_place_in_the_alphabet() {
    let mut desk = Desk::new();
    ["a1", "a2", "a3", "z4"].into_iter().for_each(|name| desk.write(name, 10));
    [0, 3].into_iter().for_each(|at| desk.look(at));
    let mut taken = Vec::new();
    for at in (4..).step_by(3) {
        let Some(due) = desk.settled(&[]) else { break };
        taken.push(due.path.display().to_string());
        desk.book.close(&due, Closing::Taken);
        // what comes later waits behind those that wait
        if at == 4 {
            desk.write("b5", 10);
        }
        desk.look(at);
    }
    assert_eq!(taken, ["a1", "z4", "a2", "b5", "a3"]);
}

#[test]
fn growing_files_of_robots_are_read_in_turn() {
    let mut desk = Desk::new();
    let names = ["a1", "a2", "b3", "c4"];
    let grow = |desk: &mut Desk, at: u64| {
        names.into_iter().for_each(|name| desk.write(name, 10 + at));
        desk.look(at);
    };
    (0..2).for_each(|at| grow(&mut desk, at));
    let mut read = Vec::new();
    for at in 2..10 {
        let due = desk.growing().expect("all grow");
        read.push(due.path.display().to_string());
        grow(&mut desk, at);
        assert_eq!(desk.book.growing_waiting(), 3, "what is open does not wait");
        desk.book.close(&due, Closing::GaveWay(due.seen.size));
        grow(&mut desk, at);
    }
    assert_eq!(read, ["a1", "b3", "c4", "a2", "b3", "c4", "a1", "b3"]);
}

#[test]
fn a_file_that_gave_its_place_is_read_again_only_if_there_is_more_of_it() {
    for (read, again) in [(12, None), (11, Some("a1"))] {
        let mut desk = Desk::new();
        desk.write("a1", 10);
        desk.look(0);
        desk.write("a1", 11);
        desk.look(1);
        let due = desk.growing().expect("it grew");
        desk.write("a1", 12);
        desk.look(2);
        desk.book.close(&due, Closing::GaveWay(read));
        desk.look(3);
        assert_eq!(name(desk.growing().as_ref()), again);
        if again.is_none() {
            desk.look(5);
            assert_eq!(name(desk.settled(&[]).as_ref()), Some("a1"), "it ends as a settled file");
        }
    }
}

#[test]
fn small_files_go_past_large_ones_of_other_robots() {
    let mut desk = Desk::new();
    for (name, bytes) in [("a1", 1000), ("a2", 10), ("b3", 10)] {
        desk.write(name, bytes);
    }
    [0, 3].into_iter().for_each(|at| desk.look(at));
    let small = |desk: &mut Desk, busy: &[&str]| {
        let busy = busy.iter().map(|lane| (*lane).to_owned()).collect();
        desk.book.next_settled(&busy, |bytes| bytes < 100).map(|(due, _)| due)
    };
    assert_eq!(name(small(&mut desk, &[]).as_ref()), Some("b3"), "a2 waits for a1");
    assert_eq!(name(small(&mut desk, &["b"]).as_ref()), None);
    assert_eq!(name(desk.settled(&["b"]).as_ref()), Some("a1"));
}

#[test]
fn a_file_taken_is_left_alone_until_it_changes_even_while_it_was_read() {
    let mut desk = Desk::new();
    desk.write("a1", 10);
    [0, 3].into_iter().for_each(|at| desk.look(at));
    let due = desk.settled(&[]).expect("settled");
    desk.look(4);
    desk.book.close(&due, Closing::Taken);
    assert!(desk.settled(&[]).is_none(), "queued while it was open");
    desk.look(9);
    assert!(desk.settled(&[]).is_none() && desk.growing().is_none());
    desk.write("a1", 12);
    desk.look(10);
    assert_eq!(name(desk.growing().as_ref()), Some("a1"));

    desk.write("b2", 10);
    [20, 23].into_iter().for_each(|at| desk.look(at));
    let due = desk.settled(&["a"]).expect("settled");
    desk.write("b2", 11);
    desk.look(24);
    desk.book.close(&due, Closing::Taken);
    desk.look(25);
    assert_eq!(name(desk.growing().as_ref()), Some("b2"), "it changed while it was read");
}

#[test]
fn a_file_that_is_asked_for_is_taken_again() {
    let mut desk = Desk::new();
    desk.write("a1", 10);
    [0, 3].into_iter().for_each(|at| desk.look(at));
    let due = desk.settled(&[]).expect("settled");
    desk.book.close(&due, Closing::Taken);
    for path in [&*due.path, Path::new("unknown")] {
        desk.book.again(path, desk.start, lane);
    }
    assert!(desk.settled(&[]).is_none(), "the next look queues it");
    desk.look(4);
    assert_eq!(name(desk.settled(&[]).as_ref()), Some("a1"));
}

#[test]
fn a_writer_that_pauses_longer_is_waited_for_longer() {
    let mut desk = Desk::new();
    let mut waits = Vec::new();
    for round in 0..12 {
        desk.write("a1", 10 + round);
        desk.look(10_000 * round);
        if let Some(due) = desk.growing() {
            waits.push(due.patience.as_secs());
            desk.book.close(&due, Closing::Done);
        }
    }
    assert_eq!(waits, [3, 6, 12, 24, 48, 96, 192, 384, 600, 600, 600]);
}

#[test]
fn a_file_to_be_judged_when_settled_is_not_followed_again_unless_it_is_another() {
    let mut desk = Desk::new();
    desk.write("a1", 10);
    desk.look(0);
    desk.write("a1", 20);
    desk.look(1);
    let due = desk.growing().expect("it grew");
    desk.book.close(&due, Closing::UntilSettled);
    desk.write("a1", 30);
    desk.look(2);
    assert!(desk.growing().is_none());
    desk.write("a1", 5);
    desk.look(3);
    assert!(desk.growing().is_none());
    desk.write("a1", 6);
    desk.look(4);
    assert_eq!(name(desk.growing().as_ref()), Some("a1"), "it was rewritten");
}
