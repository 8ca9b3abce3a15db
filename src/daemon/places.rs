//! The places of exports that are read while they grow: which file holds one, and which gives it to another. It reads
//! no clock: the time is an argument.
//!
//! There are fewer places than robots that may write at once. A file that is read up to its end gives its place to a
//! waiting one; its progress is not lost, since its next turn continues after its last stored cycle.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use armwatch_ingest::bytes::access::FileAccess;
use armwatch_model::run::FileId;
use armwatch_model::text;

/// Most growing files at once that are not read up to their end. After a restart all files have a backlog; if they are
/// read one after the other, the first is finished before the last, and a daemon that is often killed makes progress.
const CATCHING_UP: usize = 2;

/// Shortest turn of a file before it must give its place. If turns were shorter, files would be opened more often than
/// they are read.
const SHORTEST_TURN: Duration = Duration::from_secs(1);

/// A file keeps its place at least this many times as long as reading its backlog took: the repeated reading at the
/// start of a turn (the hash of the stored cycles, the rows of the open one) then takes a tenth of the time at most.
const TURN_PER_CATCHING_UP: u32 = 10;

/// Longest turn of a file that is never read up to its end, because its writer is faster; it gives its place after its
/// next cycle.
const LONGEST_TURN: Duration = Duration::from_secs(60);

/// A call to the file system that lasts longer hangs, for example a call to an unreachable file server. The file then
/// does not count as being read, so that it delays no other.
pub(super) const HANGING: Duration = Duration::from_secs(1);

/// A hanging call is logged after this time.
pub(super) const SAID_AFTER: Duration = Duration::from_secs(10);

/// Returns true if a call through `access` has not returned for `time`.
pub(super) fn hangs_for(access: &FileAccess, time: Duration, now: Instant) -> bool {
    access.asks_since().is_some_and(|since| now.saturating_duration_since(since) > time)
}

/// Progress of the reader of a growing file.
#[derive(Debug, Default)]
pub struct Sign {
    /// The access that opens the file.
    pub access: FileAccess,
    /// Bytes of the file that were read.
    bytes: AtomicU64,
}

impl Sign {
    /// Notes that a read has returned, after `bytes` bytes of the file. Returns true if these are more than before.
    pub fn has_read(&self, bytes: u64) -> bool {
        self.bytes.swap(bytes, Ordering::Relaxed) < bytes
    }
}

/// A place, for the task that reads the file.
#[derive(Debug, Clone)]
pub struct Place {
    /// Progress of the reader.
    pub sign: Arc<Sign>,
    /// Cancelled when the file must give its place to another.
    pub give_way: CancellationToken,
}

#[derive(Debug)]
struct Holder {
    path: PathBuf,
    since: Instant,
    /// Time that reading the backlog took.
    caught_up_after: Option<Duration>,
    place: Place,
    /// The hanging read was logged.
    said: bool,
}

/// Growing files that are being read.
#[derive(Debug, Default)]
pub struct FilePlaces {
    holders: HashMap<FileId, Holder>,
    /// The shortage of places was logged.
    said_short: Option<usize>,
}

impl FilePlaces {
    /// Returns true if another file may be read, of `most`.
    pub fn has_free(&self, most: usize, now: Instant) -> bool {
        let catching_up = self.reading(now).filter(|holder| holder.caught_up_after.is_none()).count();
        !self.are_taken(most, now) && catching_up < CATCHING_UP
    }

    /// Files with a call to the file system that has not returned for `time`.
    pub fn hanging_for(&self, time: Duration, now: Instant) -> impl Iterator<Item = &Path> {
        let hanging = self.holders.values().filter(move |of| hangs_for(&of.place.sign.access, time, now));
        hanging.map(|holder| &*holder.path)
    }

    /// Files that have a place.
    pub fn count(&self) -> usize {
        self.holders.len()
    }

    /// Returns true if all of `most` places are taken.
    pub fn are_taken(&self, most: usize, now: Instant) -> bool {
        self.reading(now).count() >= most
    }

    fn reading(&self, now: Instant) -> impl Iterator<Item = &Holder> {
        self.holders.values().filter(move |of| !hangs_for(&of.place.sign.access, HANGING, now))
    }

    /// Gives a place to a file.
    pub fn give(
        &mut self,
        file: FileId,
        path: &Path,
        access: FileAccess,
        stop: &CancellationToken,
        now: Instant,
    ) -> Place {
        let sign = Arc::new(Sign { access, ..Sign::default() });
        let place = Place { sign, give_way: stop.child_token() };
        let holder = Holder {
            path: path.to_owned(),
            since: now,
            caught_up_after: None,
            place: place.clone(),
            said: false,
        };
        self.holders.insert(file, holder);
        place
    }

    /// Notes that a file is read up to its end.
    pub fn caught_up(&mut self, file: FileId, now: Instant) {
        if let Some(holder) = self.holders.get_mut(&file) {
            holder.caught_up_after.get_or_insert(now.duration_since(holder.since));
        }
    }

    /// Removes a file from its place. Returns how many of its bytes were read.
    pub fn take_back(&mut self, file: FileId) -> u64 {
        let holder = self.holders.remove(&file);
        holder.map_or(0, |holder| holder.place.sign.bytes.load(Ordering::Relaxed))
    }

    /// Asks files for their places, those with the longest turns first, so that `waiting` others get one.
    pub fn ask(&mut self, waiting: usize, now: Instant) {
        let is_asked = |holder: &Holder| holder.place.give_way.is_cancelled();
        let asked = self.holders.values().filter(|holder| is_asked(holder)).count();
        let mut may_be_asked: Vec<&Holder> =
            self.holders.values().filter(|holder| !is_asked(holder) && holder.turn_ends() <= now).collect();
        may_be_asked.sort_by_key(|holder| holder.since);
        for holder in may_be_asked.into_iter().take(waiting.saturating_sub(asked)) {
            holder.place.give_way.cancel();
        }
    }

    /// Time of the next change without an event: the end of a turn, or a read that begins to hang.
    pub fn next_look(&self, waiting: bool, now: Instant) -> Option<Instant> {
        let turns = self.holders.values().map(Holder::turn_ends).filter(|end| waiting && *end > now);
        let readings = self.holders.values().filter_map(|holder| {
            let since = holder.place.sign.access.asks_since()?;
            Some([since + HANGING, since + SAID_AFTER])
        });
        turns.chain(readings.flatten().filter(|end| *end > now)).min()
    }

    /// Logs each hanging read once.
    pub fn say_hanging(&mut self, now: Instant) {
        let hanging = |holder: &&mut Holder| hangs_for(&holder.place.sign.access, SAID_AFTER, now);
        for holder in self.holders.values_mut().filter(|holder| !holder.said).filter(hanging) {
            holder.said = true;
            say_hanging(&holder.path);
        }
    }

    /// Logs that `waiting` files find no place, once for each value of the setting.
    pub fn say_short(&mut self, waiting: usize, most: usize) {
        if self.said_short == Some(most) {
            return;
        }
        self.said_short = Some(most);
        tracing::warn!(
            growing = self.holders.len() + waiting,
            "more exports grow at the same time than watch.live_files = {most} permits: they take turns, \
            and their cycles are stored later; raise watch.live_files (each takes the memory of about three \
            cycles)"
        );
    }
}

/// Logs that a read hangs.
pub(super) fn say_hanging(path: &Path) {
    tracing::warn!(
        file = %text::of_path(path), "a read has not returned for {} s: the disk or file server does not \
            answer; other exports are still read", SAID_AFTER.as_secs()
    );
}

impl Holder {
    /// Time when the file may have to give its place.
    fn turn_ends(&self) -> Instant {
        let turn = match self.caught_up_after {
            Some(took) => SHORTEST_TURN.max(TURN_PER_CATCHING_UP * took),
            None => LONGEST_TURN,
        };
        self.since + turn
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;

    use super::*;
    use armwatch_ingest::bytes::access::asking;

    struct Room {
        places: FilePlaces,
        start: Instant,
        stop: CancellationToken,
    }

    impl Room {
        fn new() -> Self {
            Self { places: FilePlaces::default(), start: Instant::now(), stop: CancellationToken::new() }
        }

        fn at(&self, seconds: f64) -> Instant {
            self.start + Duration::from_secs_f64(seconds)
        }

        fn give(&mut self, inode: u64, at: f64) -> Place {
            let path = PathBuf::from(format!("{inode}.csv"));
            self.places.give(file(inode), &path, FileAccess::default(), &self.stop, self.at(at))
        }

        fn caught_up(&mut self, inode: u64, at: f64) {
            self.places.caught_up(file(inode), self.at(at));
        }
    }

    fn file(inode: u64) -> FileId {
        FileId { device: 1, inode }
    }

    #[test]
    fn places_are_bounded_and_two_are_caught_up_with_at_once() {
        let mut room = Room::new();
        for inode in 1..=4 {
            assert!(room.places.has_free(4, room.at(0.0)), "{inode}");
            room.give(inode, 0.0);
            if inode > 1 {
                assert!(!room.places.has_free(4, room.at(0.0)), "two are caught up with");
                room.caught_up(inode, 0.1);
            }
        }
        room.caught_up(1, 0.2);
        assert!(!room.places.has_free(4, room.at(0.3)));
        assert!(room.places.are_taken(4, room.at(0.3)) && room.places.has_free(5, room.at(0.3)));
        room.places.take_back(file(2));
        assert!(room.places.has_free(4, room.at(0.3)));
    }

    #[test]
    fn reads_that_hang_hold_up_nobody() {
        let mut room = Room::new();
        let hanging = [room.give(1, 0.0), room.give(2, 0.0)];
        assert_eq!(room.places.next_look(false, room.at(0.0)), None, "neither waits for the file system");
        let (release, hangs) = mpsc::channel::<()>();
        let access = hanging[0].sign.access.clone();
        let reader = thread::spawn(move || access.during(|| asking(|| hangs.recv().is_err())));
        while hanging[0].sign.access.asks_since().is_none() {
            thread::yield_now();
        }
        assert!(!room.places.has_free(2, Instant::now()), "it has just begun");
        let later = Instant::now() + 2 * HANGING;
        assert!(room.places.next_look(false, Instant::now()).is_some_and(|at| at < later));
        assert!(room.places.has_free(2, later));
        assert_eq!(room.places.hanging_for(HANGING, later).collect::<Vec<_>>(), [Path::new("1.csv")]);
        drop(release);
        reader.join().unwrap();
        assert!(!room.places.has_free(2, later), "it has returned");
    }

    #[test]
    fn who_has_caught_up_longest_ago_gives_way() {
        let mut room = Room::new();
        let places: Vec<Place> =
            [0.0, 0.2, 0.4].into_iter().zip(1..).map(|(at, n)| room.give(n, at)).collect();
        let asked = || places.iter().map(|place| place.give_way.is_cancelled()).collect::<Vec<_>>();
        room.caught_up(1, 0.5);
        room.caught_up(2, 0.25);
        room.caught_up(3, 0.45);
        room.places.ask(2, room.at(1.3));
        assert_eq!(asked(), [false, true, false], "the first took half a second, the third has its turn");
        room.places.ask(2, room.at(5.0));
        assert_eq!(asked(), [true, true, false], "one was asked before");
        places[1].sign.has_read(12);
        assert_eq!(room.places.take_back(file(2)), 12);
        assert_eq!(room.places.next_look(true, room.at(1.0)), Some(room.at(1.4)));
    }

    #[test]
    fn a_writer_that_is_never_caught_up_with_gives_way_in_the_end() {
        let mut room = Room::new();
        let place = room.give(1, 0.0);
        room.places.ask(1, room.at(59.0));
        assert!(!place.give_way.is_cancelled());
        room.places.ask(1, room.at(60.0));
        assert!(place.give_way.is_cancelled());
    }
}
