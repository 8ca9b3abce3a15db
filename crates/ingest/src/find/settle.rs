//! Decides that a writer has finished, from observations of a file; the time is an argument.

use std::time::{Duration, Instant, SystemTime};

/// One observation of a file by a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Observation {
    /// Size, bytes.
    pub size: u64,
    /// Modification time from the file system. Only compared for equality: clocks of file servers differ from ours.
    pub modified: SystemTime,
    /// Time of the observation.
    pub at: Instant,
}

/// Result of successive scans of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settling {
    size: u64,
    modified: SystemTime,
    unchanged_since: Instant,
    last_seen: Instant,
    /// Number of equal observations in a row.
    agreeing: u32,
    settled_before: bool,
}

impl Settling {
    /// A file seen for the first time.
    pub fn first(seen: Observation) -> Self {
        Self {
            size: seen.size,
            modified: seen.modified,
            unchanged_since: seen.at,
            last_seen: seen.at,
            agreeing: 1,
            settled_before: false,
        }
    }

    /// A file that had settled before this program started, seen for the first time by it.
    pub fn settled_before(seen: Observation) -> Self {
        Self { settled_before: true, ..Self::first(seen) }
    }

    /// Adds another observation of the same file. Any change of size or modification time, forwards or backwards,
    /// restarts the wait.
    #[must_use]
    pub fn again(self, seen: Observation) -> Self {
        if seen.size != self.size || seen.modified != self.modified {
            return Self::first(seen);
        }
        Self { last_seen: seen.at, agreeing: self.agreeing.saturating_add(1), ..self }
    }

    /// Returns true if the file was unchanged over at least two observations that are `settle` or more apart, or since
    /// it had settled before.
    pub fn is_settled(self, settle: Duration) -> bool {
        self.settled_before
            || self.agreeing >= 2 && self.last_seen.saturating_duration_since(self.unchanged_since) >= settle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTLE: Duration = Duration::from_secs(5);

    /// Observations of a file at seconds from a common start.
    struct FileScene {
        start: Instant,
        written: SystemTime,
    }

    impl FileScene {
        fn seen(&self, at_s: u64, size: u64, modified_s: u64) -> Observation {
            Observation {
                size,
                modified: self.written + Duration::from_secs(modified_s),
                at: self.start + Duration::from_secs(at_s),
            }
        }
    }

    fn scene() -> FileScene {
        FileScene { start: Instant::now(), written: SystemTime::UNIX_EPOCH + Duration::from_secs(1_000_000) }
    }

    #[test]
    fn one_look_never_settles_even_without_a_wait() {
        let scene = scene();
        let file = Settling::first(scene.seen(0, 10, 0));
        assert!(!file.is_settled(Duration::ZERO));
        assert!(file.again(scene.seen(0, 10, 0)).is_settled(Duration::ZERO));
    }

    #[test]
    fn settles_when_it_stood_still_long_enough() {
        let scene = scene();
        let file = Settling::first(scene.seen(0, 10, 0)).again(scene.seen(4, 10, 0));
        assert!(!file.is_settled(SETTLE));
        assert!(file.again(scene.seen(5, 10, 0)).is_settled(SETTLE));
    }

    #[test]
    fn growth_starts_the_wait_anew() {
        let scene = scene();
        let file = Settling::first(scene.seen(0, 10, 0)).again(scene.seen(100, 11, 100));
        assert!(!file.is_settled(SETTLE));
        let file = file.again(scene.seen(104, 11, 100));
        assert!(!file.is_settled(SETTLE));
        assert!(file.again(scene.seen(105, 11, 100)).is_settled(SETTLE));
    }

    #[test]
    fn rewriting_in_place_and_a_clock_set_back_are_changes() {
        let scene = scene();
        let file = Settling::first(scene.seen(0, 10, 50));
        assert!(!file.again(scene.seen(60, 10, 51)).is_settled(SETTLE));
        assert!(!file.again(scene.seen(60, 10, 49)).is_settled(SETTLE));
        assert!(!file.again(scene.seen(60, 9, 50)).is_settled(SETTLE));
    }
}
