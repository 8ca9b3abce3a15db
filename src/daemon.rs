//! The life of the daemon: look at the folders, take what grows and what has settled, stop when told.
//!
//! File events only say "look again"; the scan decides, and comparing it with the ledger makes
//! looking twice harmless. Files that grow are read at once, each on its own; files that have settled
//! are the backlog: a few at a time, those of one robot one after the other, so that its history grows in the
//! order of the names.

mod archive;
mod book;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::alert;
use crate::config::Config;
use crate::ingest::tail;
use crate::ingest::watch::{self, Complaints};
use crate::pipeline::follow::Followed;
use crate::pipeline::{Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::run::FileId;
use book::{Book, Closing, Due};

/// Hints that arrive within this time cause one scan: a copy of a large file makes thousands.
const HINT_PAUSE: Duration = Duration::from_millis(100);

/// Between two scans that hints cause, so many times what the last one took passes: files that grow
/// all day must not make the daemon look at thousands of others all day.
const SCAN_SHARE: u32 = 10;

/// Settled files, by what they ask of the machine. Each class has places of its own, so that no number of large
/// or slow files holds up small ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Class {
    /// Read within seconds.
    Small,
    /// Read within minutes or more.
    Large,
}

impl Class {
    const ALL: [Self; 2] = [Self::Small, Self::Large];

    fn of(bytes: u64, config: &Config) -> Self {
        if bytes < config.limits.large_file_bytes { Self::Small } else { Self::Large }
    }
}

/// Which way a file is taken.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Way {
    /// As it grows.
    Growing,
    /// As it has settled, in the turn of its robot.
    Settled(String, Class),
}

/// A file whose task has ended.
struct Closed {
    due: Due,
    way: Way,
    result: Result<Followed, PipelineError>,
}

/// Reads the configuration again; says why itself where it cannot be used.
pub type Reread<'r> = dyn Fn() -> Option<Config> + 'r;

/// The daemon at work.
struct Work<'r> {
    pipeline: Pipeline,
    reread: &'r Reread<'r>,
    stop: CancellationToken,
    book: Book,
    tasks: JoinSet<Closed>,
    growing: usize,
    /// Files that were to be read again at the last look.
    asked: HashSet<PathBuf>,
    /// Robots with a settled file being read.
    robots: HashSet<String>,
    /// Settled files being read, of each class.
    settled: [usize; Class::ALL.len()],
    /// A settled file of each class whose run has no number yet. One at a time, so that numbers follow names,
    /// and of two files with one content, which have one size, the first by name is taken.
    admitting: [Option<FileId>; Class::ALL.len()],
    begun: (mpsc::UnboundedSender<FileId>, mpsc::UnboundedReceiver<FileId>),
}

/// Watches the configured folders until `stop` is cancelled, then finishes the cycles in hand.
/// `reread` is asked for the configuration when quarantined exports are to be read again, because their
/// robot or layout may have been corrected; folders and times stay as they were. `report` hears the outcome
/// of every export.
///
/// # Errors
/// [`PipelineError`] where the daemon cannot go on: a full disk, or another daemon on the database.
pub async fn watch(
    pipeline: &Pipeline,
    stop: &CancellationToken,
    reread: &Reread<'_>,
    mut report: impl FnMut(&Path, &Outcome),
) -> Result<(), PipelineError> {
    let _claim = pipeline.store().claim().map_err(PipelineError::from)?;
    let mut work = Work::new(pipeline, reread, stop.child_token());
    let watched = work.go_on(&mut report).await;
    // after a failure the others finish their cycles too
    work.stop.cancel();
    while let Some(closed) = work.tasks.join_next().await {
        let ended = closed.map_err(PipelineError::from).and_then(|closed| work.close(closed, &mut report));
        if watched.is_ok() {
            ended?;
        }
    }
    watched
}

impl<'r> Work<'r> {
    fn new(pipeline: &Pipeline, reread: &'r Reread<'r>, stop: CancellationToken) -> Self {
        Self {
            pipeline: pipeline.clone(),
            reread,
            stop,
            book: Book::new(pipeline.config().watch.settle),
            tasks: JoinSet::new(),
            growing: 0,
            asked: HashSet::new(),
            robots: HashSet::new(),
            settled: [0; Class::ALL.len()],
            admitting: [None; Class::ALL.len()],
            begun: mpsc::unbounded_channel(),
        }
    }

    /// Scans and takes files until a stop is asked for.
    async fn go_on(&mut self, report: &mut impl FnMut(&Path, &Outcome)) -> Result<(), PipelineError> {
        let settings = self.pipeline.config().watch.clone();
        let (mut watcher, mut hints) = watch::watch_folders(&settings.folders);
        let mut complaints = Complaints::default();
        let mut next_scan = Instant::now();
        let mut earliest = next_scan;
        while !self.stop.is_cancelled() {
            self.take_what_is_due();
            tokio::select! {
                () = self.stop.cancelled() => {}
                Some(closed) = self.tasks.join_next() => self.close(closed?, report)?,
                Some(file) = self.begun.1.recv() => self.admitted(file),
                Some(()) = hints.recv(), if next_scan > earliest => next_scan = earliest,
                () = tokio::time::sleep_until(next_scan.into()) => {
                    watcher.watch_missing();
                    let started = Instant::now();
                    self.scan(&settings.folders, &mut complaints).await?;
                    let ended = Instant::now();
                    next_scan = ended + settings.scan_interval;
                    earliest = ended + HINT_PAUSE.max(SCAN_SHARE * (ended - started));
                }
            }
        }
        Ok(())
    }

    async fn scan(&mut self, folders: &[PathBuf], complaints: &mut Complaints) -> Result<(), PipelineError> {
        let folders = folders.to_vec();
        let scan = tokio::task::spawn_blocking(move || watch::scan(&folders)).await?;
        complaints.warn(&scan);
        self.note_retries().await?;
        let lane_of = |path: &Path| robot_of(self.pipeline.config(), path);
        self.book.note(&scan.files, Instant::now(), tail::is_marked, lane_of);
        Ok(())
    }

    /// Lets exports be taken again that a person asked for, by the configuration as it is now.
    async fn note_retries(&mut self) -> Result<(), PipelineError> {
        let asked = self.pipeline.store().paths_to_retry().await?;
        let asked: HashSet<PathBuf> = asked.into_iter().collect();
        if !asked.is_subset(&self.asked) {
            if let Some(config) = (self.reread)() {
                tracing::info!("configuration read again");
                self.pipeline = self.pipeline.with_config(config.into());
            }
            asked.iter().for_each(|path| self.book.again(path));
        }
        self.asked = asked;
        Ok(())
    }

    /// Starts as many tasks as there may be, for growing files first.
    fn take_what_is_due(&mut self) {
        while self.growing < self.pipeline.config().watch.live_files
            && let Some(due) = self.book.next_growing()
        {
            self.growing += 1;
            self.start(due, Way::Growing);
        }
        let config = self.pipeline.config();
        let most = config.limits.backlog_files;
        let mut starting = Vec::new();
        for class in Class::ALL {
            let place = class as usize;
            if self.settled[place] < most
                && self.admitting[place].is_none()
                && let Some((due, robot)) =
                    self.book.next_settled(&self.robots, |bytes| Class::of(bytes, config) == class)
            {
                self.robots.insert(robot.clone());
                self.settled[place] += 1;
                self.admitting[place] = Some(due.file);
                starting.push((due, Way::Settled(robot, class)));
            }
        }
        starting.into_iter().for_each(|(due, way)| self.start(due, way));
    }

    /// Notes that the run of a file has its number, or that the file is closed.
    fn admitted(&mut self, file: FileId) {
        for place in &mut self.admitting {
            place.take_if(|admitting| *admitting == file);
        }
    }

    fn start(&mut self, due: Due, way: Way) {
        let (pipeline, stop) = (self.pipeline.clone(), self.stop.clone());
        let (begun, file) = (self.begun.0.clone(), due.file);
        let progress = move |progress| {
            if progress == Progress::Begun {
                // nobody listens any more when the daemon ends
                let _ = begun.send(file);
            }
        };
        self.tasks.spawn(async move {
            let result = match &way {
                Way::Growing => pipeline.follow(&due.path, due.patience, &stop, progress).await,
                Way::Settled(..) => {
                    pipeline.process(&due.path, Retry::Never, &stop, progress).await.map(Followed::Outcome)
                }
            };
            if let (Way::Settled(..), Ok(Followed::Outcome(outcome))) = (&way, &result) {
                archive::after(&pipeline, &due.path, outcome).await;
            }
            Closed { due, way, result }
        });
    }

    /// Notes, logs and reports what became of a file.
    fn close(
        &mut self,
        closed: Closed,
        report: &mut impl FnMut(&Path, &Outcome),
    ) -> Result<(), PipelineError> {
        let Closed { due, way, result } = closed;
        self.admitted(due.file);
        self.asked.remove(&due.path);
        match &way {
            Way::Growing => self.growing -= 1,
            Way::Settled(robot, class) => {
                self.robots.remove(robot);
                self.settled[*class as usize] -= 1;
            }
        }
        let followed = match result {
            Err(PipelineError::Store(error)) if !error.is_fatal() => {
                tracing::warn!(file = %due.path.display(), %error, "not stored now; trying again");
                self.book.close(&due, Closing::Again);
                return Ok(());
            }
            result => result?,
        };
        self.book.close(&due, closing(&followed, &way));
        if let Followed::Outcome(outcome) = &followed {
            log_outcome(&due.path, outcome);
            report(&due.path, outcome);
        }
        Ok(())
    }
}

fn closing(followed: &Followed, way: &Way) -> Closing {
    match (followed, way) {
        (Followed::UntilSettled, _) => Closing::UntilSettled,
        (Followed::NotYet, _) => Closing::Again,
        (Followed::Outcome(Outcome::Changed | Outcome::InWork { .. } | Outcome::Interrupted), _) => {
            Closing::Again
        }
        (Followed::Outcome(_), Way::Growing) => Closing::Done,
        (Followed::Outcome(_), Way::Settled(..)) => Closing::Taken,
    }
}

/// The robot that an export's name says, or the path of one that says none: such files do not wait for each
/// other.
fn robot_of(config: &Config, path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match config.recognition.recognise(&name) {
        Ok(recognised) => recognised.robot,
        Err(_) => path.display().to_string(),
    }
}

/// Logs what became of an export, by consequence.
fn log_outcome(path: &Path, outcome: &Outcome) {
    let file = path.display();
    match outcome {
        Outcome::Stored(run) => {
            tracing::info!(%file, robot = %run.robot, run_id = run.run_id, cycles = run.cycles, rows = run.rows, "stored");
            for (cycle, reason) in &run.refused {
                tracing::warn!(%file, cycle, "no parameters: {reason}");
            }
            for anomaly in &run.new_anomalies {
                alert::log_opened(anomaly);
            }
        }
        Outcome::AlreadyStored { run_id } => tracing::debug!(%file, run_id, "already stored"),
        Outcome::Quarantined { rejection, .. } => tracing::warn!("quarantined: {rejection}"),
        Outcome::Interrupted => {
            tracing::info!(%file, "stopped at a cycle; the rest follows at the next start")
        }
        Outcome::Changed => tracing::info!(%file, "changed while being read; looking again"),
        Outcome::InWork { run_id } => {
            tracing::debug!(%file, run_id, "the same content is being read under another name");
        }
    }
}

/// A token that SIGINT and SIGTERM cancel. A second signal ends the process at once, which is safe:
/// what is done is committed.
///
/// # Errors
/// If the handlers cannot be installed.
pub fn stop_on_signal() -> std::io::Result<CancellationToken> {
    let stop = CancellationToken::new();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let token = stop.clone();
    tokio::spawn(async move {
        for first in [true, false] {
            let name = tokio::select! {
                _ = terminate.recv() => "SIGTERM",
                _ = interrupt.recv() => "SIGINT",
            };
            if first {
                tracing::info!("{name}: finishing the cycle in hand; send it again to stop at once");
                token.cancel();
            } else {
                std::process::exit(130);
            }
        }
    });
    Ok(stop)
}
