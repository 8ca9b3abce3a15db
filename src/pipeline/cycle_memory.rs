//! One bound on the memory of all cycles that are being read and analysed.
//!
//! A cycle is in memory until its last row is read and its analysis has ended, and a daemon reads many exports at once.
//! Beyond the bound, an export pauses unless it has read most of its cycle among all active exports. That export
//! continues until its cycle ends, or is refused if the cycle does not end, and then frees memory for the next. Cut
//! cycles are analysed one at a time in this state. So no export waits for ever. A cycle whose analysis alone takes
//! more than the bound is refused, see [`most_rows`].

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use armwatch_model::analysis::CycleAnalysis;
use armwatch_model::run::Cycle;

/// An export that has read nothing for this time keeps its rows, and the others no longer wait for it.
const IDLE: Duration = Duration::from_secs(10);

/// Time between two checks of waiting exports that they can continue.
const LOOK: Duration = Duration::from_millis(100);

/// Interval of the log message that exports wait.
const SAY: Duration = Duration::from_secs(60);

/// Bytes of a cycle besides its rows, however short it is: its channels, each with its own allocation, and its place in
/// the file.
const CYCLE_BYTES: usize = 4 << 10;

/// Halves of its rows' memory that a cycle under analysis takes: filtered channels are in memory next to the recorded
/// ones.
const HALVES_IN_ANALYSIS: usize = 5;

/// Rows of the longest cycle whose analysis stays within `most` bytes, if a row takes `row_bytes`.
pub fn most_rows(most: usize, row_bytes: usize) -> usize {
    most / (row_bytes.max(1) * HALVES_IN_ANALYSIS) * 2
}

/// Bytes that the analysis of a cycle of `rows` rows takes.
pub fn bytes_of_rows(rows: usize, row_bytes: usize) -> usize {
    rows * row_bytes / 2 * HALVES_IN_ANALYSIS
}

/// Memory of the cycles of all exports that are being read and analysed.
#[derive(Debug, Clone)]
pub struct CycleMemory {
    /// The bound, bytes.
    most: usize,
    idle: Duration,
    shared: Arc<CycleMemoryShare>,
}

#[derive(Debug, Default)]
struct CycleMemoryShare {
    state: Mutex<SharedCycles>,
    /// Signals that fewer bytes are in use.
    freed: Condvar,
    /// The same signal, for waiting analyses.
    may_analyse: Notify,
}

#[derive(Debug, Default)]
struct SharedCycles {
    next: u64,
    exports: HashMap<u64, ExportMemory>,
    /// Bytes of cut cycles, and of their analyses that are not recorded yet.
    cut: usize,
    in_analysis: usize,
    said: Option<Instant>,
}

#[derive(Debug)]
struct ExportMemory {
    bytes: usize,
    read_at: Instant,
    turn: RecordingTurn,
}

/// True if the analyses of an export are recorded as they end. Those of an export that is read ahead wait for earlier
/// exports, so that the earlier ones must not wait for it.
#[derive(Debug, Clone, Default)]
pub struct RecordingTurn(Arc<AtomicBool>);

impl RecordingTurn {
    /// The turn of an export that is recorded during reading.
    pub fn come() -> Self {
        Self(Arc::new(AtomicBool::new(true)))
    }

    /// Starts the recording of analyses.
    pub fn comes(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn has_come(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl SharedCycles {
    fn bytes(&self) -> usize {
        self.cut + self.exports.values().map(|export| export.bytes).sum::<usize>()
    }

    /// Returns true if another active export comes first: one whose analyses are recorded, then the one that has read
    /// more of its cycle, then the one that began first.
    fn is_behind(&self, own: u64, idle: Duration) -> bool {
        let place = |id: u64, export: &ExportMemory| (export.turn.has_come(), export.bytes, u64::MAX - id);
        let Some(mine) = self.exports.get(&own).map(|export| place(own, export)) else { return false };
        self.exports.iter().any(|(id, other)| place(*id, other) > mine && other.read_at.elapsed() < idle)
    }

    fn is_to_be_said(&mut self) -> bool {
        let is_due = self.said.is_none_or(|said| said.elapsed() >= SAY);
        if is_due {
            self.said = Some(Instant::now());
        }
        is_due
    }
}

impl CycleMemory {
    /// Creates a memory with a bound of `most` bytes.
    pub fn new(most: usize) -> Self {
        Self { most, idle: IDLE, shared: Arc::default() }
    }

    /// The same memory with another bound, for exports from now on.
    pub fn up_to(&self, most: usize) -> Self {
        Self { most, ..self.clone() }
    }

    /// Adds an export, whose cycle has no row yet.
    pub fn enter(&self, turn: RecordingTurn) -> OpenCycle {
        let mut state = self.lock();
        let id = state.next;
        state.next += 1;
        state.exports.insert(id, ExportMemory { bytes: 0, read_at: Instant::now(), turn });
        OpenCycle { all: self.clone(), id }
    }

    /// Adds a cut cycle.
    pub fn hold(&self, cycle: &Cycle) -> HeldCycle {
        let bytes = CYCLE_BYTES + cycle.samples.rows() * cycle.samples.row_bytes();
        self.lock().cut += bytes;
        HeldCycle { all: self.clone(), bytes, is_in_analysis: false }
    }

    fn lock(&self) -> MutexGuard<'_, SharedCycles> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn say_that_it_is_free(&self) {
        self.shared.freed.notify_all();
        self.shared.may_analyse.notify_waiters();
    }
}

/// The open cycle of one export; dropping it releases its rows.
#[derive(Debug)]
pub struct OpenCycle {
    all: CycleMemory,
    id: u64,
}

impl OpenCycle {
    /// Sets the bytes that the rows of the cycle take, and waits while all cycles together exceed the bound and another
    /// export comes first. A stop ends the wait.
    pub fn has(&self, bytes: usize, stop: &CancellationToken) {
        let CycleMemory { most, idle, shared } = &self.all;
        let mut state = self.all.lock();
        loop {
            let Some(own) = state.exports.get_mut(&self.id) else { return };
            let fewer = bytes < own.bytes;
            (own.bytes, own.read_at) = (bytes, Instant::now());
            if fewer {
                self.all.say_that_it_is_free();
            }
            let all = state.bytes();
            if all <= *most || stop.is_cancelled() || !state.is_behind(self.id, *idle) {
                return;
            }
            if state.is_to_be_said() {
                tracing::warn!(
                    bytes = all,
                    "cycles that are being read and analysed take more memory than limits.cycles_max_bytes \
                    = {most}; exports wait for the one that has read the most of its cycle"
                );
            }
            state = shared.freed.wait_timeout(state, LOOK).map_or_else(|e| e.into_inner().0, |woken| woken.0);
        }
    }
}

impl Drop for OpenCycle {
    fn drop(&mut self) {
        self.all.lock().exports.remove(&self.id);
        self.all.say_that_it_is_free();
    }
}

/// The memory of a cut cycle, then of its analysis, until it is recorded.
#[derive(Debug)]
pub struct HeldCycle {
    all: CycleMemory,
    bytes: usize,
    is_in_analysis: bool,
}

/// Always equal: it is not part of the cycle's value.
impl PartialEq for HeldCycle {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl HeldCycle {
    /// Waits until there is memory for the analysis, or until all other analyses have ended.
    pub async fn may_be_analysed(&mut self) {
        let bytes = self.bytes / 2 * HALVES_IN_ANALYSIS;
        let shared = Arc::clone(&self.all.shared);
        loop {
            let freed = shared.may_analyse.notified();
            {
                let mut state = self.all.lock();
                let all = state.bytes() - self.bytes + bytes;
                if all <= self.all.most || state.in_analysis == 0 {
                    state.in_analysis += 1;
                    state.cut = state.cut - self.bytes + bytes;
                    (self.bytes, self.is_in_analysis) = (bytes, true);
                    return;
                }
            }
            freed.await;
        }
    }

    /// Replaces the memory of the rows by that of their analysis.
    pub fn is_analysed(&mut self, analysis: &CycleAnalysis) {
        self.change(CYCLE_BYTES + bytes_of(analysis));
    }

    fn change(&mut self, bytes: usize) {
        let mut state = self.all.lock();
        state.cut = state.cut - self.bytes + bytes;
        state.in_analysis -= usize::from(self.is_in_analysis);
        (self.bytes, self.is_in_analysis) = (bytes, false);
        drop(state);
        self.all.say_that_it_is_free();
    }
}

impl Drop for HeldCycle {
    fn drop(&mut self) {
        self.change(0);
    }
}

/// Most of the memory of an analysis: its factors and its friction points.
fn bytes_of(analysis: &CycleAnalysis) -> usize {
    let factors: usize = analysis.factors.factors.iter().map(|factor| size_of_val(&factor.upper[..])).sum();
    factors + size_of_val(&analysis.friction_points[..])
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;

    use super::*;

    const SOON: Duration = Duration::from_secs(20);
    const NOT_YET: Duration = Duration::from_millis(400);

    /// Lets a cycle grow to `bytes` on a separate thread, which returns the cycle when it can continue.
    fn grow(cycle: OpenCycle, bytes: usize, stop: &CancellationToken) -> mpsc::Receiver<OpenCycle> {
        let (went_on, seen) = mpsc::channel();
        let stop = stop.clone();
        thread::spawn(move || {
            cycle.has(bytes, &stop);
            let _ = went_on.send(cycle);
        });
        seen
    }

    #[test]
    fn the_largest_cycle_goes_on_and_the_others_follow_when_it_ends() {
        let (all, stop) = (CycleMemory::new(1000), CancellationToken::new());
        let large = grow(all.enter(RecordingTurn::come()), 700, &stop).recv_timeout(SOON).expect("room");
        let small = grow(all.enter(RecordingTurn::come()), 300, &stop).recv_timeout(SOON).expect("room");
        // the bound is exceeded: the smaller one waits, the larger one does not
        let waiting = grow(small, 400, &stop);
        let large = grow(large, 900, &stop).recv_timeout(SOON).expect("the largest goes on");
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        // its next cycle begins
        let large = grow(large, 10, &stop).recv_timeout(SOON).expect("room");
        let small = waiting.recv_timeout(SOON).expect("room again");
        // its end lets the other continue
        let large = grow(large, 800, &stop).recv_timeout(SOON).expect("the largest");
        let waiting = grow(small, 450, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        drop(large);
        waiting.recv_timeout(SOON).expect("alone");
    }

    #[test]
    fn nobody_waits_for_an_export_that_does_not_go_on_and_a_stop_ends_every_wait() {
        let stop = CancellationToken::new();
        let all = CycleMemory { idle: Duration::from_millis(50), ..CycleMemory::new(1000) };
        let _idle =
            grow(all.enter(RecordingTurn::come()), 2000, &stop).recv_timeout(SOON).expect("the largest");
        grow(all.enter(RecordingTurn::come()), 10, &stop)
            .recv_timeout(SOON)
            .expect("the largest of those that go on");

        let all = CycleMemory::new(1000);
        let _large =
            grow(all.enter(RecordingTurn::come()), 2000, &stop).recv_timeout(SOON).expect("the largest");
        let waiting = grow(all.enter(RecordingTurn::come()), 10, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        stop.cancel();
        waiting.recv_timeout(SOON).expect("stopped");
    }

    #[test]
    fn many_exports_come_to_their_ends_one_after_the_other() {
        let (all, stop) = (CycleMemory::new(1500), CancellationToken::new());
        let exports: Vec<_> = (0..8)
            .map(|_| {
                let (cycle, stop) = (all.enter(RecordingTurn::come()), stop.clone());
                thread::spawn(move || {
                    for _ in 0..3 {
                        (0..=10).for_each(|block| cycle.has(100 * block, &stop));
                    }
                })
            })
            .collect();
        exports.into_iter().for_each(|export| export.join().expect("no panic"));
        assert_eq!(all.lock().bytes(), 0);
    }

    #[test]
    fn an_export_that_is_read_ahead_waits_for_one_in_its_turn_however_little_that_has_read() {
        let (all, stop) = (CycleMemory::new(1000), CancellationToken::new());
        let turn = RecordingTurn::default();
        let ahead = grow(all.enter(turn.clone()), 2000, &stop).recv_timeout(SOON).expect("alone");
        let recorded =
            grow(all.enter(RecordingTurn::come()), 10, &stop).recv_timeout(SOON).expect("in its turn");
        let waiting = grow(ahead, 2100, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        turn.comes();
        waiting.recv_timeout(SOON).expect("in its turn, and larger");
        drop(recorded);
    }

    fn cycle(rows: usize) -> Cycle {
        let time: Vec<f64> = (0..rows).map(|row| row as f64).collect();
        Cycle { number: 1, samples: armwatch_model::run::Samples { time, ..Default::default() } }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn beyond_the_bound_one_cycle_is_analysed_at_a_time() {
        let all = CycleMemory::new(10 * CYCLE_BYTES);
        let cycle = cycle(CYCLE_BYTES);
        let mut first = all.hold(&cycle);
        let mut second = all.hold(&cycle);
        assert!(all.lock().bytes() > 10 * CYCLE_BYTES);
        first.may_be_analysed().await;
        let next = tokio::spawn(async move {
            second.may_be_analysed().await;
            second
        });
        tokio::time::sleep(NOT_YET).await;
        assert!(!next.is_finished());
        drop(first);
        let second = tokio::time::timeout(SOON, next).await.expect("its turn").expect("no panic");
        drop(second);
        let state = all.lock();
        assert_eq!((state.bytes(), state.in_analysis), (0, 0));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn cycles_that_are_cut_hold_up_reading_until_they_are_recorded() {
        let (all, stop) = (CycleMemory::new(10 * CYCLE_BYTES), CancellationToken::new());
        let large = grow(all.enter(RecordingTurn::come()), 100, &stop).recv_timeout(SOON).expect("room");
        let mut held = all.hold(&cycle(CYCLE_BYTES));
        held.may_be_analysed().await;
        let waiting = grow(all.enter(RecordingTurn::come()), 10, &stop);
        assert!(waiting.recv_timeout(NOT_YET).is_err());
        drop(held);
        waiting.recv_timeout(SOON).expect("room again");
        drop(large);
    }
}
