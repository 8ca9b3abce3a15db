//! Exports that were in progress when the program was killed. They are read one at a time, so that the harmless ones
//! are cleared. It reads no clock: the time is an argument.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use armwatch_store::{Attempt, QUIET_START};

/// Longest wait of other exports for the last attempt at one: until it can be made, and the same time again.
const HELD: Duration = QUIET_START.saturating_mul(2);

/// Suspects from earlier processes.
#[derive(Debug)]
pub struct Suspects {
    /// When this process started.
    since: Instant,
    /// Each file and the next attempt at it.
    waiting: HashMap<PathBuf, Attempt>,
}

impl Suspects {
    /// Creates suspects from files with the attempts that crashed the program.
    pub fn new(since: Instant, failed: impl IntoIterator<Item = (PathBuf, u32)>) -> Self {
        let next = |(path, attempts): (PathBuf, u32)| (path, Attempt { number: attempts.saturating_add(1) });
        Self { since, waiting: failed.into_iter().map(next).collect() }
    }

    /// Returns true if a file may be read now. `is_one_read` is true while another suspect is being read.
    ///
    /// The last attempt is made only when this process is older than processes that are repeatedly ended from outside.
    /// No other export starts before it, so the cause is certain if the program ends then.
    pub fn admit(&self, path: &Path, is_one_read: bool, now: Instant) -> bool {
        let age = now.duration_since(self.since);
        let last_comes = self.waiting.values().any(|next| next.is_last()) && age < HELD;
        match self.waiting.get(path) {
            // it is quarantined unread
            Some(next) if next.is_spent() => true,
            Some(next) if next.is_last() => !is_one_read && age >= QUIET_START,
            Some(_) => !is_one_read && !last_comes,
            None => !last_comes,
        }
    }

    /// Returns true if `is` holds for any suspect.
    pub fn any(&self, is: impl Fn(&Path) -> bool) -> bool {
        self.waiting.keys().any(|path| is(path))
    }

    /// Returns true if a file is a suspect.
    pub fn has(&self, path: &Path) -> bool {
        self.waiting.contains_key(path)
    }

    /// Notes that an attempt at a file has ended without crashing the program.
    pub fn survived(&mut self, path: &Path) {
        self.waiting.remove(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suspects_are_read_one_at_a_time_and_the_last_attempt_is_made_alone_and_late() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let path = |name: &str| PathBuf::from(name);
        let mut suspects = Suspects::new(start, [(path("a"), 1), (path("b"), 1), (path("c"), 3)]);
        let admits = |of: &Suspects, name: &str, one: bool, second| of.admit(&path(name), one, at(second));
        assert!(admits(&suspects, "a", false, 0) && !admits(&suspects, "a", true, 0));
        assert!(admits(&suspects, "other", true, 0) && admits(&suspects, "c", true, 0));
        suspects.survived(&path("a"));
        assert!(!suspects.has(&path("a")) && admits(&suspects, "a", true, 0));

        let mut suspects = Suspects::new(start, [(path("a"), 2), (path("b"), 1)]);
        for name in ["a", "b", "other"] {
            assert!(!admits(&suspects, name, false, 9), "{name}");
        }
        assert!(admits(&suspects, "a", false, 10));
        assert!(!admits(&suspects, "other", true, 19), "it may end the program yet");
        assert!(admits(&suspects, "other", true, 20), "a long file does not hold up the others");
        suspects.survived(&path("a"));
        assert!(admits(&suspects, "other", false, 11) && admits(&suspects, "b", false, 11));
    }
}
