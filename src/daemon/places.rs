//! The places of exports that are read while they grow: who holds one, and who gives it to another. Pure: the clock
//! is an argument.
//!
//! There are fewer places than robots that may write at once. A file that is read up to what is written gives its
//! place to one that waits; what it has read is not lost, since its next turn goes on behind its last stored cycle.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use armwatch_model::run::FileId;
use armwatch_model::text;

/// Growing files at once that are not read up to what is written. After a restart all of them have to be caught up
/// with; one after the other, the first is done before the last, and a daemon that is often killed gets on.
const CATCHING_UP: usize = 2;

/// A file is not asked for its place sooner. With shorter turns, files would be opened more often than they are read.
const SHORTEST_TURN: Duration = Duration::from_secs(1);

/// A file keeps its place at least so many times as long as it took to catch up with it: reading again what a turn
/// begins with (the hash of the stored cycles, the rows of the open one) takes a tenth of the time at most.
const TURN_PER_CATCHING_UP: u32 = 10;

/// A file that is never read up to what is written, because its writer is faster, is asked for its place after this
/// time; it gives it behind its next cycle.
const LONGEST_TURN: Duration = Duration::from_secs(60);

/// A read that takes longer hangs, such as one on a file server that is away. The file does not count as one that is
/// read, so that it holds up no other.
const HANGING: Duration = Duration::from_secs(10);

/// Most reads that may hang besides the places in use: each keeps a thread.
const MOST_HANGING: usize = 64;

/// What the reader of a growing file says of itself.
#[derive(Debug, Default)]
pub struct Sign {
    /// Since when it waits for the file system.
    reading_since: Mutex<Option<Instant>>,
    /// Bytes of the file that were read.
    bytes: AtomicU64,
}

impl Sign {
    /// A read begins.
    pub fn reads(&self, now: Instant) {
        *self.reading_since.lock().unwrap_or_else(PoisonError::into_inner) = Some(now);
    }

    /// A read has returned, after so many bytes of the file. Says whether these are more than before.
    pub fn has_read(&self, bytes: u64) -> bool {
        let before = self.bytes.swap(bytes, Ordering::Relaxed);
        self.waits_for_others();
        bytes > before
    }

    /// The reader waits for something else than the file.
    pub fn waits_for_others(&self) {
        *self.reading_since.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }

    fn hangs(&self, now: Instant) -> bool {
        let since = *self.reading_since.lock().unwrap_or_else(PoisonError::into_inner);
        since.is_some_and(|since| now.duration_since(since) > HANGING)
    }
}

/// A place, for the task that reads the file.
#[derive(Debug, Clone)]
pub struct Place {
    /// What the reader says of itself.
    pub sign: Arc<Sign>,
    /// Cancelled when the file is to give its place to another.
    pub give_way: CancellationToken,
}

#[derive(Debug)]
struct Holder {
    path: PathBuf,
    since: Instant,
    /// How long it took to catch up with what was written.
    caught_up_after: Option<Duration>,
    place: Place,
    /// Its hanging read was said.
    said: bool,
}

/// Growing files that are being read.
#[derive(Debug, Default)]
pub struct Places {
    holders: HashMap<FileId, Holder>,
    /// That places are short was said.
    said_short: Option<usize>,
}

impl Places {
    /// Whether one more file may be read, of `most`.
    #[must_use]
    pub fn has_free(&self, most: usize, now: Instant) -> bool {
        let catching_up = self.reading(now).filter(|holder| holder.caught_up_after.is_none()).count();
        let hanging = self.holders.len() - self.reading(now).count();
        !self.are_taken(most, now) && catching_up < CATCHING_UP && hanging <= MOST_HANGING
    }

    /// Files that have a place.
    #[must_use]
    pub fn count(&self) -> usize {
        self.holders.len()
    }

    /// Whether all of `most` places are taken.
    #[must_use]
    pub fn are_taken(&self, most: usize, now: Instant) -> bool {
        self.reading(now).count() >= most
    }

    fn reading(&self, now: Instant) -> impl Iterator<Item = &Holder> {
        self.holders.values().filter(move |holder| !holder.place.sign.hangs(now))
    }

    /// Gives a place to a file.
    pub fn give(&mut self, file: FileId, path: &Path, stop: &CancellationToken, now: Instant) -> Place {
        let place = Place { sign: Arc::default(), give_way: stop.child_token() };
        place.sign.reads(now);
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

    /// Notes that a file is read up to what is written.
    pub fn caught_up(&mut self, file: FileId, now: Instant) {
        if let Some(holder) = self.holders.get_mut(&file) {
            holder.caught_up_after.get_or_insert(now.duration_since(holder.since));
        }
    }

    /// Takes the place of a file back. Returns how many of its bytes were read.
    pub fn take_back(&mut self, file: FileId) -> u64 {
        let holder = self.holders.remove(&file);
        holder.map_or(0, |holder| holder.place.sign.bytes.load(Ordering::Relaxed))
    }

    /// Asks files for their places, those first that have had them longest, so that `waiting` others get one.
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

    /// When something is due here though nothing happens: the end of a turn, or a read that begins to hang.
    #[must_use]
    pub fn next_look(&self, waiting: bool, now: Instant) -> Option<Instant> {
        let turns = self.holders.values().map(Holder::turn_ends).filter(|end| waiting && *end > now);
        let readings = self.holders.values().filter_map(|holder| {
            let since = *holder.place.sign.reading_since.lock().unwrap_or_else(PoisonError::into_inner);
            Some(since? + HANGING)
        });
        turns.chain(readings.filter(|end| *end > now)).min()
    }

    /// Says in the log, once each, which reads hang.
    pub fn say_hanging(&mut self, now: Instant) {
        for holder in self.holders.values_mut().filter(|holder| !holder.said && holder.place.sign.hangs(now))
        {
            holder.said = true;
            let file = text::of_path(&holder.path);
            tracing::warn!(
                %file, "a read has not returned for {} s: the disk or file server does not answer; other exports \
                 are read meanwhile", HANGING.as_secs()
            );
        }
    }

    /// Says in the log, once for each value of the setting, that `waiting` files find no place.
    pub fn say_short(&mut self, waiting: usize, most: usize) {
        if self.said_short == Some(most) {
            return;
        }
        self.said_short = Some(most);
        tracing::warn!(
            growing = self.holders.len() + waiting,
            "more exports grow at once than watch.live_files = {most} lets be read: they take turns, and their cycles \
             are stored later; raise watch.live_files (each takes the memory of about three cycles)"
        );
    }
}

impl Holder {
    /// From when on it may be asked for its place.
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
    use super::*;

    struct Room {
        places: Places,
        start: Instant,
        stop: CancellationToken,
    }

    impl Room {
        fn new() -> Self {
            Self { places: Places::default(), start: Instant::now(), stop: CancellationToken::new() }
        }

        fn at(&self, seconds: f64) -> Instant {
            self.start + Duration::from_secs_f64(seconds)
        }

        fn give(&mut self, inode: u64, at: f64) -> Place {
            let path = PathBuf::from(format!("{inode}.csv"));
            self.places.give(file(inode), &path, &self.stop, self.at(at))
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
            let place = room.give(inode, 0.0);
            place.sign.waits_for_others();
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
        assert!(!room.places.has_free(2, room.at(10.0)));
        assert_eq!(room.places.next_look(false, room.at(1.0)), Some(room.at(10.0)));
        assert!(room.places.has_free(2, room.at(10.1)), "both hang");
        // one that waits for an analysis does not
        hanging[0].sign.has_read(7);
        room.give(3, 11.0);
        assert!(!room.places.has_free(2, room.at(15.0)));
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
