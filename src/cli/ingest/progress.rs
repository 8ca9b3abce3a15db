//! Progress over all exports: one line with the file, its cycles and the remaining time.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressFinish, ProgressStyle};

use super::export_texts::lasting;
use crate::pipeline::context::{Outcome, Progress};
use armwatch_model::text;

/// Cycles of an export that are read and not stored yet: one is read, two are analysed, one waits.
const IN_FLIGHT: u32 = 4;

/// Progress of all exports in bytes, which are known before an export is read.
#[derive(Debug, Default, Clone, PartialEq)]
struct IngestWork {
    /// Bytes of exports that are stored or quarantined, and of those to come.
    done: u64,
    ahead: u64,
    /// Bytes of one cycle of the last stored export.
    of_cycle: Option<f64>,
    /// The current export: its bytes, those read, and its stored cycles.
    size: u64,
    read: u64,
    cycles: u32,
    /// Its number, from 1, and its file name.
    at: usize,
    name: String,
}

impl IngestWork {
    fn begin(&mut self, size: u64) {
        self.ahead = self.ahead.saturating_sub(size);
        (self.size, self.read, self.cycles) = (size, 0, 0);
    }

    /// Bytes of the cycles of this export that are stored. Reading is ahead of them by the cycles in flight.
    fn of_this(&self) -> f64 {
        let cycles = f64::from(self.cycles);
        let estimate = match self.of_cycle {
            Some(bytes) => bytes * cycles,
            None => self.read as f64 * cycles / (cycles + f64::from(IN_FLIGHT)),
        };
        estimate.min(self.size as f64)
    }

    fn end(&mut self, outcome: &Outcome) {
        match outcome {
            Outcome::Stored(run) => {
                self.of_cycle = (run.cycles > 0).then(|| self.size as f64 / f64::from(run.cycles));
                self.done += self.size;
            }
            Outcome::Quarantined { known: false, .. } => self.done += self.size,
            // took no time, which is no evidence for the others
            _ => {}
        }
        (self.size, self.read, self.cycles) = (0, 0, 0);
    }

    fn fraction(&self) -> f64 {
        let total = (self.done + self.size + self.ahead) as f64;
        if total > 0.0 { (self.done as f64 + self.of_this()) / total } else { 0.0 }
    }

    /// Remaining time after `elapsed`, once there is evidence.
    fn left(&self, elapsed: Duration) -> Option<Duration> {
        let fraction = self.fraction();
        (fraction > 0.0).then(|| elapsed.mul_f64((1.0 - fraction) / fraction))
    }
}

/// One line over all exports, hidden without a terminal; cleared when it is dropped.
#[derive(Debug, Clone)]
pub(super) struct ProgressLine {
    bar: ProgressBar,
    work: Arc<Mutex<IngestWork>>,
    begun: Instant,
    files: usize,
}

/// Steps of the bar.
const STEPS: u64 = 1000;

impl ProgressLine {
    pub(super) fn new(exports: &[PathBuf]) -> Self {
        let bar =
            if std::io::stderr().is_terminal() { ProgressBar::new(STEPS) } else { ProgressBar::hidden() };
        // the message is cut at the terminal's width
        if let Ok(style) = ProgressStyle::with_template("{prefix} [{bar:20}] {percent:>3} % {wide_msg}") {
            bar.set_style(style.progress_chars("=> "));
        }
        let work =
            IngestWork { ahead: exports.iter().map(|path| bytes_of(path)).sum(), ..IngestWork::default() };
        Self {
            bar: bar.with_finish(ProgressFinish::AndClear),
            work: Arc::new(Mutex::new(work)),
            begun: Instant::now(),
            files: exports.len(),
        }
    }

    fn work(&self) -> MutexGuard<'_, IngestWork> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn begin(&self, path: &Path) {
        let mut work = self.work();
        work.begin(bytes_of(path));
        work.at += 1;
        // a terminal would interpret its control characters
        work.name = text::shown(&text::of_file_name(path)).into_owned();
        self.bar.set_prefix(format!("file {}/{}", work.at, self.files));
        self.show(&work);
    }

    pub(super) fn note(&self, progress: Progress) {
        let mut work = self.work();
        match progress {
            Progress::Begun | Progress::CaughtUp | Progress::Grown(_) => return,
            Progress::Read(bytes) => work.read = bytes,
            Progress::Cycle(cycle) => work.cycles = cycle,
        }
        self.show(&work);
    }

    pub(super) fn end(&self, outcome: &Outcome) {
        self.work().end(outcome);
    }

    fn show(&self, work: &IngestWork) {
        let left = work.left(self.begun.elapsed()).map(|left| format!(", {} left", lasting(left)));
        self.bar.set_position((work.fraction() * STEPS as f64) as u64);
        self.bar.set_message(format!("cycle {}{}, {}", work.cycles, left.unwrap_or_default(), work.name));
    }

    /// Prints something while the line is hidden.
    pub(super) fn pause(&self, print: impl FnOnce()) {
        self.bar.suspend(print);
    }

    /// Removes the line; returns the total time.
    pub(super) fn clear(&self) -> Duration {
        self.bar.finish_and_clear();
        self.begun.elapsed()
    }
}

fn bytes_of(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |metadata| metadata.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::context::StoredRun;

    fn stored(cycles: u32) -> Outcome {
        Outcome::Stored(StoredRun { run_id: 1, robot: "R".into(), cycles, refused: Vec::new(), rows: 1 })
    }

    #[test]
    fn work_is_counted_in_cycles_that_are_stored_and_not_in_bytes_that_are_read() {
        let mut work = IngestWork { ahead: 2000, ..IngestWork::default() };
        work.begin(1000);
        work.read = 1000;
        assert_eq!((work.fraction(), work.left(Duration::from_secs(5))), (0.0, None), "nothing is stored");
        work.cycles = 4;
        // four cycles are stored and four in flight: half of the part that is read
        assert_eq!(work.fraction(), 0.25);
        assert_eq!(work.left(Duration::from_secs(5)), Some(Duration::from_secs(15)));
        work.end(&stored(8));
        assert_eq!(work.fraction(), 0.5);
        work.begin(1000);
        (work.read, work.cycles) = (1000, 6);
        assert_eq!(work.fraction(), 0.875, "a cycle has 125 bytes, as in the export before");
        work.end(&stored(8));
        assert_eq!(work.left(Duration::from_secs(5)), Some(Duration::ZERO));
    }

    #[test]
    fn an_export_that_is_known_says_nothing_of_the_time_that_others_take() {
        let mut work = IngestWork { ahead: 2000, ..IngestWork::default() };
        work.begin(1000);
        work.end(&Outcome::AlreadyStored { run_id: 1 });
        work.begin(1000);
        assert_eq!((work.fraction(), work.left(Duration::from_secs(1))), (0.0, None));
    }
}
