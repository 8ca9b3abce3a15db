//! One bound on the rows of all cycles that are being read.
//!
//! A cycle is in memory until its last row is read, and a daemon reads many exports at once. Beyond the bound an export
//! waits, unless it has read most of its cycle of all that go on: that one comes to its end, or is refused for a
//! cycle that has none, and makes room for the next. So nothing waits for ever, and at most one cycle grows
//! beyond the bound.

use std::collections::HashMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

/// An export that has read nothing for so long keeps its rows, but nobody waits for it to go on.
const IDLE: Duration = Duration::from_secs(10);

/// How often those that wait look whether they may go on.
const LOOK: Duration = Duration::from_millis(100);

/// How often it is said that exports wait.
const SAY: Duration = Duration::from_secs(60);

/// Rows of the open cycles of all exports that are being read.
#[derive(Debug, Clone)]
pub struct OpenRows {
    idle: Duration,
    state: Arc<(Mutex<State>, Condvar)>,
}

impl Default for OpenRows {
    fn default() -> Self {
        Self { idle: IDLE, state: Arc::default() }
    }
}

#[derive(Debug, Default)]
struct State {
    next: u64,
    exports: HashMap<u64, Export>,
    said: Option<Instant>,
}

#[derive(Debug)]
struct Export {
    rows: usize,
    read_at: Instant,
}

impl State {
    fn rows(&self) -> usize {
        self.exports.values().map(|export| export.rows).sum()
    }

    /// Whether another export that goes on has read more of its cycle; of as many rows the one that came first.
    fn is_behind(&self, own: u64, rows: usize, idle: Duration) -> bool {
        self.exports.iter().any(|(id, other)| {
            let is_ahead = other.rows > rows || (other.rows == rows && *id < own);
            *id != own && is_ahead && other.read_at.elapsed() < idle
        })
    }

    fn is_to_be_said(&mut self) -> bool {
        let is_due = self.said.is_none_or(|said| said.elapsed() >= SAY);
        if is_due {
            self.said = Some(Instant::now());
        }
        is_due
    }
}

impl OpenRows {
    /// Another export, whose cycle has no row yet.
    #[must_use]
    pub fn enter(&self) -> OpenCycle {
        let mut state = self.lock();
        let id = state.next;
        state.next += 1;
        state.exports.insert(id, Export { rows: 0, read_at: Instant::now() });
        OpenCycle { all: self.clone(), id }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The open cycle of one export; its rows are forgotten when it is dropped.
#[derive(Debug)]
pub struct OpenCycle {
    all: OpenRows,
    id: u64,
}

impl OpenCycle {
    /// Notes how many rows the cycle has, and waits while all have more than `most` together and another one has read more
    /// of its cycle. A stop ends the wait.
    pub fn has(&self, rows: usize, most: usize, stop: &CancellationToken) {
        let mut state = self.all.lock();
        loop {
            let fewer = state.exports.get(&self.id).is_some_and(|own| rows < own.rows);
            state.exports.insert(self.id, Export { rows, read_at: Instant::now() });
            if fewer {
                self.all.state.1.notify_all();
            }
            let all = state.rows();
            if all <= most || stop.is_cancelled() || !state.is_behind(self.id, rows, self.all.idle) {
                return;
            }
            if state.is_to_be_said() {
                tracing::warn!(
                    rows = all,
                    "cycles that are being read have more rows together than limits.open_cycles_max_rows = {most}; \
                     exports wait for the one that has read most of its cycle"
                );
            }
            state =
                self.all.state.1.wait_timeout(state, LOOK).map_or_else(|e| e.into_inner().0, |woken| woken.0);
        }
    }
}

impl Drop for OpenCycle {
    fn drop(&mut self) {
        self.all.lock().exports.remove(&self.id);
        self.all.state.1.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;

    use super::*;

    const SOON: Duration = Duration::from_secs(20);
    const NOT_YET: Duration = Duration::from_millis(400);

    /// Lets a cycle have so many rows on a thread of its own; what is received says that it went on, and gives it back.
    fn grow(
        cycle: OpenCycle,
        rows: usize,
        most: usize,
        stop: &CancellationToken,
    ) -> mpsc::Receiver<OpenCycle> {
        let (went_on, seen) = mpsc::channel();
        let stop = stop.clone();
        thread::spawn(move || {
            cycle.has(rows, most, &stop);
            let _ = went_on.send(cycle);
        });
        seen
    }

    #[test]
    fn the_largest_cycle_goes_on_and_the_others_follow_when_it_ends() {
        let (all, stop) = (OpenRows::default(), CancellationToken::new());
        let large = grow(all.enter(), 700, 1000, &stop).recv_timeout(SOON).expect("room");
        let small = grow(all.enter(), 300, 1000, &stop).recv_timeout(SOON).expect("room");
        // the bound is passed: the smaller one waits, the larger one does not
        let waiting = grow(small, 400, 1000, &stop);
        let large = grow(large, 900, 1000, &stop).recv_timeout(SOON).expect("the largest goes on");
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        // its next cycle begins
        let large = grow(large, 10, 1000, &stop).recv_timeout(SOON).expect("room");
        let small = waiting.recv_timeout(SOON).expect("room again");
        // and it ends while the other waits
        let large = grow(large, 800, 1000, &stop).recv_timeout(SOON).expect("the largest");
        let waiting = grow(small, 450, 1000, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        drop(large);
        waiting.recv_timeout(SOON).expect("alone");
    }

    #[test]
    fn nobody_waits_for_an_export_that_does_not_go_on_and_a_stop_ends_every_wait() {
        let stop = CancellationToken::new();
        let all = OpenRows { idle: Duration::from_millis(50), ..OpenRows::default() };
        let _idle = grow(all.enter(), 2000, 1000, &stop).recv_timeout(SOON).expect("the largest");
        grow(all.enter(), 10, 1000, &stop).recv_timeout(SOON).expect("the largest of those that go on");

        let all = OpenRows::default();
        let _large = grow(all.enter(), 2000, 1000, &stop).recv_timeout(SOON).expect("the largest");
        let waiting = grow(all.enter(), 10, 1000, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        stop.cancel();
        waiting.recv_timeout(SOON).expect("stopped");
    }

    #[test]
    fn many_exports_come_to_their_ends_one_after_the_other() {
        let (all, stop) = (OpenRows::default(), CancellationToken::new());
        let exports: Vec<_> = (0..8)
            .map(|_| {
                let (cycle, stop) = (all.enter(), stop.clone());
                thread::spawn(move || {
                    for _ in 0..3 {
                        (0..=10).for_each(|block| cycle.has(100 * block, 1500, &stop));
                    }
                })
            })
            .collect();
        exports.into_iter().for_each(|export| export.join().expect("no panic"));
        assert_eq!(all.lock().exports.len(), 0);
    }
}
