//! The order of reading files.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use super::{Closing, FileSchedule, KnownFile, LookKind, NextAttempt};
use crate::daemon::suspects::Suspects;
use armwatch_ingest::find::watch::FoundFile;
use armwatch_model::run::FileId;

const SETTLE: Duration = Duration::from_secs(3);

struct ScheduledFolder {
    schedule: FileSchedule,
    start: Instant,
    files: Vec<FoundFile>,
}

impl ScheduledFolder {
    fn new() -> Self {
        Self { schedule: FileSchedule::new(SETTLE, HashMap::new()), start: Instant::now(), files: Vec::new() }
    }

    /// Writes a file: its number is the first digit of its name.
    fn write(&mut self, name: &str, size: u64) {
        let inode = name.bytes().find(u8::is_ascii_digit).map_or(0, u64::from);
        let path = PathBuf::from(name);
        self.files.retain(|file| file.path != path);
        let file = FileId { device: 1, inode };
        let is_marked = name == "marked1";
        self.files.push(FoundFile {
            path,
            size,
            modified: SystemTime::UNIX_EPOCH,
            file,
            is_marked,
            wait: Duration::ZERO,
        });
    }

    fn look(&mut self, at_s: u64) {
        self.look_as(at_s, LookKind::Now);
    }

    fn look_as(&mut self, at_s: u64, seen: LookKind) {
        let now = self.start + Duration::from_secs(at_s);
        let files: Vec<_> = self.files.iter().map(|file| (file, seen)).collect();
        self.schedule.note(&files, now, lane);
    }

    fn unseen(&self) -> Vec<&FoundFile> {
        let files: Vec<_> = self.files.iter().map(|file| (file, LookKind::Now)).collect();
        self.schedule.unseen(&files)
    }

    fn growing(&mut self) -> Option<NextAttempt> {
        self.schedule.next_growing(|_| true)
    }

    fn settled(&mut self, busy: &[&str]) -> Option<NextAttempt> {
        let busy = busy.iter().map(|lane| (*lane).to_owned()).collect();
        self.schedule.next_settled(&busy, |_| true, |_| true).map(|(due, _)| due)
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
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    folder.write("b2", 10);
    folder.look(0);
    assert!(folder.growing().is_none() && folder.settled(&[]).is_none());
    folder.write("a1", 11);
    folder.look(1);
    let growing = folder.growing().expect("it grew");
    assert_eq!((name(Some(&growing)), growing.patience), (Some("a1"), SETTLE));
    assert!(folder.growing().is_none());
    folder.look(3);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("b2"));
    folder.look(9);
    assert!(folder.settled(&[]).is_none(), "both are open");
}

#[test]
fn a_mark_ends_the_wait() {
    let mut folder = ScheduledFolder::new();
    folder.write("marked1", 10);
    folder.look(0);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("marked1"));
}

#[test]
fn what_was_begun_before_is_taken_at_once_if_it_is_as_it_was() {
    let mut folder = ScheduledFolder::new();
    let settled = |size| KnownFile::Settled(size, 0);
    let begun = [("a1", KnownFile::Growing), ("b2", settled(10)), ("c3", settled(9))];
    folder.schedule = FileSchedule::new(SETTLE, begun.map(|(name, begun)| (name.into(), begun)).into());
    ["a1", "b2", "c3"].into_iter().for_each(|name| folder.write(name, 10));
    folder.look(0);
    assert_eq!(name(folder.growing().as_ref()), Some("a1"));
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("b2"));
    assert_eq!(name(folder.settled(&[]).as_ref()), None, "it has changed since");
    folder.look(3);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("c3"));
}

#[test]
fn what_was_decided_before_is_left_alone_until_it_changes() {
    let mut folder = ScheduledFolder::new();
    ["a1", "a2"].into_iter().for_each(|name| folder.write(name, 10));
    let unseen: Vec<&Path> = folder.unseen().iter().map(|file| file.path.as_path()).collect();
    assert_eq!(unseen, [Path::new("a1"), Path::new("a2")]);
    folder.schedule.taken_before(["a1".into()].into_iter());
    [0, 3].into_iter().for_each(|at| folder.look(at));
    assert_eq!(folder.unseen().len(), 0);
    assert_eq!(folder.schedule.waiting(folder.start), 1);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a2"));
    assert_eq!(name(folder.settled(&[]).as_ref()), None);
    folder.write("a1", 11);
    folder.look(4);
    assert_eq!(name(folder.growing().as_ref()), Some("a1"));
}

#[test]
fn a_file_that_cannot_be_read_is_tried_less_and_less_often_until_it_changes() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    let mut tries = Vec::new();
    for second in 0..200 {
        folder.look(second);
        if let Some(due) = folder.settled(&[]) {
            tries.push(second);
            folder.schedule.close(&due, Closing::Unreadable);
        }
    }
    assert_eq!(tries, [3, 6, 12, 24, 48, 96, 156]);
    folder.write("a1", 11);
    folder.look(200);
    assert_eq!(name(folder.growing().as_ref()), Some("a1"));
}

#[test]
fn lanes_go_side_by_side_each_in_the_order_of_names() {
    let mut folder = ScheduledFolder::new();
    for name in ["b4", "a3", "a2", "b5"] {
        folder.write(name, 10);
    }
    [0, 3].into_iter().for_each(|at| folder.look(at));
    assert_eq!(name(folder.settled(&["a"]).as_ref()), Some("b4"));
    assert_eq!(name(folder.settled(&["b"]).as_ref()), Some("a2"));
    assert_eq!(name(folder.settled(&["a", "b"]).as_ref()), None);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("b5"), "b was served before a");
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a3"));
}

#[test]
fn robots_are_served_in_turn_and_not_by_their_place_in_the_alphabet() {
    let mut folder = ScheduledFolder::new();
    ["a1", "a2", "a3", "z4"].into_iter().for_each(|name| folder.write(name, 10));
    [0, 3].into_iter().for_each(|at| folder.look(at));
    let mut taken = Vec::new();
    for at in (4..).step_by(3) {
        let Some(due) = folder.settled(&[]) else { break };
        taken.push(due.path.display().to_string());
        folder.schedule.close(&due, Closing::Taken);
        // files that arrive later wait after the waiting ones
        if at == 4 {
            folder.write("b5", 10);
        }
        folder.look(at);
    }
    assert_eq!(taken, ["a1", "z4", "a2", "b5", "a3"]);
}

#[test]
fn growing_files_of_robots_are_read_in_turn() {
    let mut folder = ScheduledFolder::new();
    let names = ["a1", "a2", "b3", "c4"];
    let grow = |folder: &mut ScheduledFolder, at: u64| {
        names.into_iter().for_each(|name| folder.write(name, 10 + at));
        folder.look(at);
    };
    (0..2).for_each(|at| grow(&mut folder, at));
    let mut read = Vec::new();
    for at in 2..10 {
        let due = folder.growing().expect("all grow");
        read.push(due.path.display().to_string());
        grow(&mut folder, at);
        assert_eq!(folder.schedule.growing_waiting(), 3, "what is open does not wait");
        folder.schedule.close(&due, Closing::GaveWay(due.seen.size));
        grow(&mut folder, at);
    }
    assert_eq!(read, ["a1", "b3", "c4", "a2", "b3", "c4", "a1", "b3"]);
}

#[test]
fn a_file_that_gave_its_place_is_read_again_only_if_there_is_more_of_it() {
    for (read, again) in [(12, None), (11, Some("a1"))] {
        let mut folder = ScheduledFolder::new();
        folder.write("a1", 10);
        folder.look(0);
        folder.write("a1", 11);
        folder.look(1);
        let due = folder.growing().expect("it grew");
        folder.write("a1", 12);
        folder.look(2);
        folder.schedule.close(&due, Closing::GaveWay(read));
        folder.look(3);
        assert_eq!(name(folder.growing().as_ref()), again);
        if again.is_none() {
            folder.look(5);
            assert_eq!(name(folder.settled(&[]).as_ref()), Some("a1"), "it ends as a settled file");
        }
    }
}

#[test]
fn small_files_go_past_large_ones_of_other_robots() {
    let mut folder = ScheduledFolder::new();
    for (name, bytes) in [("a1", 1000), ("a2", 10), ("b3", 10)] {
        folder.write(name, bytes);
    }
    [0, 3].into_iter().for_each(|at| folder.look(at));
    let small = |folder: &mut ScheduledFolder, busy: &[&str]| {
        let busy = busy.iter().map(|lane| (*lane).to_owned()).collect();
        folder.schedule.next_settled(&busy, |_| true, |bytes| bytes < 100).map(|(due, _)| due)
    };
    assert_eq!(name(small(&mut folder, &[]).as_ref()), Some("b3"), "a2 waits for a1");
    assert_eq!(name(small(&mut folder, &["b"]).as_ref()), None);
    assert_eq!(name(folder.settled(&["b"]).as_ref()), Some("a1"));
}

#[test]
fn a_file_taken_is_left_alone_until_it_changes_even_while_it_was_read() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    [0, 3].into_iter().for_each(|at| folder.look(at));
    let due = folder.settled(&[]).expect("settled");
    folder.look(4);
    folder.schedule.close(&due, Closing::Taken);
    assert!(folder.settled(&[]).is_none(), "queued while it was open");
    folder.look(9);
    assert!(folder.settled(&[]).is_none() && folder.growing().is_none());
    folder.write("a1", 12);
    folder.look(10);
    assert_eq!(name(folder.growing().as_ref()), Some("a1"));

    folder.write("b2", 10);
    [20, 23].into_iter().for_each(|at| folder.look(at));
    let due = folder.settled(&["a"]).expect("settled");
    folder.write("b2", 11);
    folder.look(24);
    folder.schedule.close(&due, Closing::Taken);
    folder.look(25);
    assert_eq!(name(folder.growing().as_ref()), Some("b2"), "it changed while it was read");
}

#[test]
fn a_file_that_is_asked_for_is_taken_again() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    [0, 3].into_iter().for_each(|at| folder.look(at));
    let due = folder.settled(&[]).expect("settled");
    folder.schedule.close(&due, Closing::Taken);
    for path in [&*due.path, Path::new("unknown")] {
        folder.schedule.again(path, folder.start, lane);
    }
    assert!(folder.settled(&[]).is_none(), "the next look queues it");
    folder.look(4);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a1"));
}

#[test]
fn a_writer_that_pauses_longer_is_waited_for_longer() {
    let mut folder = ScheduledFolder::new();
    let mut waits = Vec::new();
    for round in 0..12 {
        folder.write("a1", 10 + round);
        folder.look(10_000 * round);
        if let Some(due) = folder.growing() {
            waits.push(due.patience.as_secs());
            folder.schedule.close(&due, Closing::Done(10 + round));
        }
    }
    assert_eq!(waits, [3, 6, 12, 24, 48, 96, 192, 384, 600, 600, 600]);
}

#[test]
fn a_file_that_grows_between_its_end_and_the_end_of_its_task_is_read_on() {
    // bytes that were read, and the size at the scan after that
    for (read, size, goes_on) in [(20, 20, false), (20, 30, true), (30, 30, false), (0, 20, false)] {
        let mut folder = ScheduledFolder::new();
        folder.write("a1", 10);
        folder.look(0);
        folder.write("a1", 20);
        folder.look(1);
        let due = folder.growing().expect("it grew");
        folder.write("a1", size);
        folder.look(2);
        folder.schedule.close(&due, Closing::Done(read));
        folder.look(3);
        assert_eq!(folder.growing().is_some(), goes_on, "{read} of {size} bytes");
    }
}

#[test]
fn a_file_to_be_judged_when_settled_is_not_followed_again_unless_it_is_another() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    folder.look(0);
    folder.write("a1", 20);
    folder.look(1);
    let due = folder.growing().expect("it grew");
    folder.schedule.close(&due, Closing::UntilSettled);
    folder.write("a1", 30);
    folder.look(2);
    assert!(folder.growing().is_none());
    folder.write("a1", 5);
    folder.look(3);
    assert!(folder.growing().is_none());
    folder.write("a1", 6);
    folder.look(4);
    assert_eq!(name(folder.growing().as_ref()), Some("a1"), "it was rewritten");
}

#[test]
fn a_growing_file_that_cannot_be_read_on_is_tried_again_ever_later() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    folder.look(0);
    let mut tries = Vec::new();
    for second in 1..=2_000 {
        folder.write("a1", 10 + second);
        folder.look(second);
        if let Some(due) = folder.growing() {
            tries.push(second);
            folder.schedule.close(&due, Closing::Blocked);
        }
    }
    assert_eq!(tries, [1, 61, 181, 421, 901, 1501]);
    folder.look(2_010);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a1"), "it is judged when it has settled");
}

#[test]
fn files_that_the_program_may_not_have_survived_are_opened_one_at_a_time() {
    let mut folder = ScheduledFolder::new();
    let start = folder.start;
    folder.schedule.suspect(Suspects::new(start, ["a1", "b2"].map(|name| (PathBuf::from(name), 1))));
    for name in ["a1", "b2", "c3"] {
        folder.write(name, 10);
    }
    folder.look(0);
    folder.look(4);
    let first = folder.settled(&[]).expect("a suspect or another");
    let second = folder.settled(&[]).expect("a suspect or another");
    assert!(folder.settled(&[]).is_none(), "the other suspect waits");
    let suspect = if first.path == Path::new("a1") { first } else { second };
    assert_eq!(name(Some(&suspect)), Some("a1"));
    folder.look(5);
    assert!(folder.settled(&[]).is_none());
    folder.schedule.close(&suspect, Closing::Taken);
    folder.look(6);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("b2"));
}

#[test]
fn a_file_does_not_settle_by_a_look_that_is_told_again() {
    let mut folder = ScheduledFolder::new();
    folder.write("a1", 10);
    folder.look(0);
    folder.look_as(60, LookKind::Before);
    assert!(folder.settled(&[]).is_none(), "nobody has looked since");
    folder.look(61);
    folder.look_as(62, LookKind::Unanswered);
    assert!(folder.settled(&[]).is_none(), "it would not be read either");
    folder.look_as(63, LookKind::Before);
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a1"));
}

#[test]
fn a_file_that_may_not_be_opened_holds_up_no_other() {
    let mut folder = ScheduledFolder::new();
    for file in ["a1", "a2", "b3"] {
        folder.write(file, 10);
    }
    folder.look(0);
    folder.look(3);
    let next = |folder: &mut ScheduledFolder| {
        let may = |path: &Path| !path.ends_with("a1");
        folder.schedule.next_settled(&Default::default(), may, |_| true).map(|(due, _)| due)
    };
    let names: Vec<_> = std::iter::from_fn(|| next(&mut folder)).map(|due| due.path).collect();
    assert_eq!(names, ["a2", "b3"].map(PathBuf::from));
    assert_eq!(name(folder.settled(&[]).as_ref()), Some("a1"));
}
