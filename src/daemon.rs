//! The life of the daemon: look at the folders, take what grows and what has settled, stop when told.
//!
//! File events only say "look again"; the scan decides, and comparing it with the ledger makes
//! looking twice harmless. Files that grow are read at once, each on its own; files that have settled
//! are the backlog: a few at a time, those of one robot one after the other, so that its history grows in the
//! order of the names.

mod archive;
mod book;
mod vanished;

use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::alert;
use crate::config::Config;
use crate::ingest::tail;
use crate::ingest::watch::{self, Complaints, Scan};
use crate::pipeline::conclude::{Concluded, RUNS_AT_ONCE};
use crate::pipeline::follow::Followed;
use crate::pipeline::{Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::run::FileId;
use crate::store::UnfinishedSource;
use book::{Begun, Book, Closing, Due};
use vanished::Missing;

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

/// While settled files of a robot wait, conclusions from its history wait for the last of them, but no longer
/// than this: a backlog of a thousand runs is not judged a thousand times, nor only in the end.
const CONCLUDE_WITHIN: Duration = Duration::from_secs(10);

/// What the daemon has to say.
#[derive(Debug)]
pub enum Event<'a> {
    /// What became of an export.
    Export(&'a Path, &'a Outcome),
    /// What a robot's history says.
    Concluded(&'a Concluded),
}
/// Why a run ends whose file is gone.
const VANISHED: &str = "the file vanished before it was read to its end; put it back, or export it again";

/// Growing files at once that are not read up to what is written. After a restart all of them have to be caught up
/// with; one after the other, the first is done before the last, and a daemon that is often killed gets on.
const CATCHING_UP: usize = 2;

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

/// How far which file has come.
type Progressed = (FileId, Progress);

/// Reads the configuration again; says why itself where it cannot be used.
pub type Reread<'r> = dyn Fn() -> Option<Config> + 'r;

/// The daemon at work.
struct Work<'r> {
    pipeline: Pipeline,
    reread: &'r Reread<'r>,
    stop: CancellationToken,
    book: Book,
    missing: Missing,
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
    /// Robots whose history has changed: since when, and by how many runs.
    stale: BTreeMap<String, (Instant, usize)>,
    /// Conclusions being drawn, one robot at a time.
    concluding: JoinSet<(String, Result<Option<Concluded>, PipelineError>)>,
    /// Growing files that are not read up to what is written.
    catching_up: HashSet<FileId>,
    progress: (mpsc::UnboundedSender<Progressed>, mpsc::UnboundedReceiver<Progressed>),
}

/// Watches the configured folders until `stop` is cancelled, then finishes the cycles in hand.
/// `reread` is asked for the configuration when quarantined exports are to be read again, because their
/// robot or layout may have been corrected; folders and times stay as they were. `report` hears the outcome
/// of every export and what each robot's history says.
///
/// # Errors
/// [`PipelineError`] where the daemon cannot go on: a full disk, or another daemon on the database.
pub async fn watch(
    pipeline: &Pipeline,
    stop: &CancellationToken,
    reread: &Reread<'_>,
    mut report: impl FnMut(Event<'_>),
) -> Result<(), PipelineError> {
    let _claim = pipeline.store().claim().map_err(PipelineError::from)?;
    let quarantined = pipeline.store().counts().await?.quarantined_runs;
    if quarantined > 0 {
        tracing::info!(quarantined, "exports in quarantine; `armwatch quarantine list` shows them");
    }
    let begun = begun_before(&pipeline.store().unfinished_sources().await?);
    let mut work = Work::new(pipeline, reread, stop.child_token(), begun);
    let missed = tokio::spawn(archive::take_missed(pipeline.clone(), work.stop.clone()));
    let watched = work.go_on(&mut report).await;
    // after a failure the others finish their cycles too
    work.stop.cancel();
    missed.await?;
    while let Some(closed) = work.tasks.join_next().await {
        let ended = closed.map_err(PipelineError::from).and_then(|closed| work.close(closed, &mut report));
        if watched.is_ok() {
            ended?;
        }
    }
    while let Some(concluded) = work.concluding.join_next().await {
        let ended = concluded.map_err(PipelineError::from).and_then(|done| work.concluded(done, &mut report));
        if watched.is_ok() {
            ended?;
        }
    }
    watched?;
    // what is not concluded when a second signal comes is concluded when the daemon starts again
    for concluded in pipeline.conclude().await? {
        announce(&concluded, &mut report);
    }
    Ok(())
}

/// Logs and reports what a robot's history says.
fn announce(concluded: &Concluded, report: &mut impl FnMut(Event<'_>)) {
    concluded.new_anomalies.iter().for_each(alert::log_opened);
    report(Event::Concluded(concluded));
}

impl<'r> Work<'r> {
    fn new(
        pipeline: &Pipeline,
        reread: &'r Reread<'r>,
        stop: CancellationToken,
        begun: HashMap<PathBuf, Begun>,
    ) -> Self {
        Self {
            pipeline: pipeline.clone(),
            reread,
            stop,
            book: Book::new(pipeline.config().watch.settle, begun),
            missing: Missing::default(),
            tasks: JoinSet::new(),
            growing: 0,
            asked: HashSet::new(),
            robots: HashSet::new(),
            settled: [0; Class::ALL.len()],
            admitting: [None; Class::ALL.len()],
            stale: BTreeMap::new(),
            concluding: JoinSet::new(),
            catching_up: HashSet::new(),
            progress: mpsc::unbounded_channel(),
        }
    }

    /// Scans and takes files until a stop is asked for.
    async fn go_on(&mut self, report: &mut impl FnMut(Event<'_>)) -> Result<(), PipelineError> {
        let mut settings = self.pipeline.config().watch.clone();
        // as paths are stored
        settings.folders.iter_mut().for_each(|folder| *folder = archive::from_root(folder));
        let (mut watcher, mut hints) = watch::watch_folders(&settings.folders);
        let mut complaints = Complaints::default();
        let mut next_scan = Instant::now();
        let mut earliest = next_scan;
        for robot in self.pipeline.store().stale_robots().await? {
            self.stale.insert(robot.name, (Instant::now(), 0));
        }
        while !self.stop.is_cancelled() {
            self.take_what_is_due();
            self.conclude_what_is_due();
            tokio::select! {
                () = self.stop.cancelled() => {}
                Some(closed) = self.tasks.join_next() => self.close(closed?, report)?,
                Some(concluded) = self.concluding.join_next() => self.concluded(concluded?, report)?,
                Some((file, progress)) = self.progress.1.recv() => self.progressed(file, progress),
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
        let owned = folders.to_vec();
        let scan = tokio::task::spawn_blocking(move || watch::scan(&owned)).await?;
        complaints.warn(&scan);
        self.note_retries().await?;
        let lane_of = |path: &Path| robot_of(self.pipeline.config(), path);
        self.book.note(&scan.files, Instant::now(), tail::is_marked, lane_of);
        self.give_up_vanished(folders, &scan).await
    }

    /// Ends unfinished runs whose files are gone.
    async fn give_up_vanished(&mut self, folders: &[PathBuf], scan: &Scan) -> Result<(), PipelineError> {
        let store = self.pipeline.store();
        let mut unfinished = store.unfinished_sources().await?;
        // what is open is read to its end, also when its name is gone
        unfinished.retain(|source| !self.pipeline.is_open(source.run_id));
        let settle = self.pipeline.config().watch.settle;
        for run_id in self.missing.note(&unfinished, folders, scan, settle, Instant::now()) {
            match store.give_up_run(run_id, VANISHED).await {
                Ok(_) => tracing::warn!(run_id, "{VANISHED}"),
                Err(error) if !error.is_fatal() => {
                    tracing::debug!(run_id, %error, "given up at the next look")
                }
                Err(error) => return Err(error.into()),
            }
        }
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
            && self.catching_up.len() < CATCHING_UP
            && let Some(due) = self.book.next_growing()
        {
            self.growing += 1;
            self.catching_up.insert(due.file);
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

    fn progressed(&mut self, file: FileId, progress: Progress) {
        match progress {
            Progress::Begun => self.admitted(file),
            Progress::CaughtUp => {
                self.catching_up.remove(&file);
            }
            Progress::Read(_) | Progress::Cycle(_) => {}
        }
    }

    /// Notes that the run of a file has its number, or that the file is closed.
    fn admitted(&mut self, file: FileId) {
        for place in &mut self.admitting {
            place.take_if(|admitting| *admitting == file);
        }
    }

    fn start(&mut self, due: Due, way: Way) {
        let (pipeline, stop) = (self.pipeline.clone(), self.stop.clone());
        let (sender, file) = (self.progress.0.clone(), due.file);
        let progress = move |progress| {
            if matches!(progress, Progress::Begun | Progress::CaughtUp) {
                // nobody listens any more when the daemon ends
                let _ = sender.send((file, progress));
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

    /// Begins conclusions for the first robot that is through with its backlog, or has waited long enough.
    fn conclude_what_is_due(&mut self) {
        if !self.concluding.is_empty() {
            return;
        }
        let is_through = |robot: &String| !self.robots.contains(robot) && !self.book.has_settled(robot);
        let due = |(robot, (since, runs)): (&String, &(Instant, usize))| {
            is_through(robot) || since.elapsed() > CONCLUDE_WITHIN || *runs >= RUNS_AT_ONCE
        };
        let Some(robot) = self.stale.iter().find(|entry| due(*entry)).map(|(robot, _)| robot.clone()) else {
            return;
        };
        self.stale.remove(&robot);
        let pipeline = self.pipeline.clone();
        self.concluding.spawn(async move {
            let concluded = pipeline.conclude_named(&robot).await;
            (robot, concluded)
        });
    }

    /// Announces conclusions, or notes that they are still to be drawn.
    fn concluded(
        &mut self,
        (robot, result): (String, Result<Option<Concluded>, PipelineError>),
        report: &mut impl FnMut(Event<'_>),
    ) -> Result<(), PipelineError> {
        let concluded = match result {
            Err(PipelineError::Store(error)) if !error.is_fatal() => {
                tracing::warn!(robot, %error, "conclusions not stored now; trying again");
                self.stale.entry(robot).or_insert_with(|| (Instant::now(), 0));
                return Ok(());
            }
            result => result?,
        };
        if let Some(concluded) = concluded {
            announce(&concluded, report);
        }
        Ok(())
    }

    /// Notes, logs and reports what became of a file.
    fn close(&mut self, closed: Closed, report: &mut impl FnMut(Event<'_>)) -> Result<(), PipelineError> {
        let Closed { due, way, result } = closed;
        self.admitted(due.file);
        self.catching_up.remove(&due.file);
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
            if let Outcome::Stored(run) = outcome {
                self.stale.entry(run.robot.clone()).or_insert_with(|| (Instant::now(), 0)).1 += 1;
            }
            report(Event::Export(&due.path, outcome));
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
        (Followed::Outcome(Outcome::Unreadable { .. }), _) => Closing::Unreadable,
        (Followed::Outcome(_), Way::Growing) => Closing::Done,
        (Followed::Outcome(_), Way::Settled(..)) => Closing::Taken,
    }
}

/// How files whose runs are not complete are taken up again.
fn begun_before(unfinished: &[UnfinishedSource]) -> HashMap<PathBuf, Begun> {
    let begun = |source: &UnfinishedSource| {
        if source.growing {
            return Begun::Growing;
        }
        Begun::Settled(source.bytes, source.modified.as_microsecond())
    };
    unfinished.iter().map(|source| (PathBuf::from(&source.path), begun(source))).collect()
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
        }
        Outcome::AlreadyStored { run_id } => tracing::debug!(%file, run_id, "already stored"),
        // said once, when it was read
        Outcome::Quarantined { rejection, known: true, .. } => {
            tracing::debug!("quarantined before: {rejection}");
        }
        Outcome::Quarantined { rejection, .. } => tracing::warn!("quarantined: {rejection}"),
        Outcome::Interrupted => {
            tracing::info!(%file, "stopped at a cycle; the rest follows at the next start")
        }
        Outcome::Unreadable { rejection } => tracing::warn!("cannot be read now, trying again: {rejection}"),
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
