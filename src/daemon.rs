//! The life of the daemon: look at the folders, take what grows and what has settled, stop when told.
//!
//! File events only say "look again"; the scan decides, and comparing it with the ledger makes
//! looking twice harmless. Files that grow are read at once, each on its own; files that have settled
//! are the backlog: a few at a time, those of one robot one after the other, so that its history grows in the
//! order of the names.

mod archive;
mod book;
mod judging;
mod outcome_log;
pub mod overdue;
#[cfg(test)]
mod tests;
mod places;
pub mod preflight;
pub mod retention;
mod service;
mod signals;
pub mod snapshots;
mod stale;
mod start;
mod turn;
mod vanished;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use book::{Begun, Closing, FileSchedule, NextAttempt};
use places::{Place, Places};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::config::{Config, WatchSettings};
use crate::ingest::find::watch::{Complaints, FoundFile, Scan};
use crate::ingest::find::{tail, watch};
use crate::metrics::{ExportEnd, LiveFile, Queue, Stage};
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::pipeline::take::follow::{Ends, Followed};
use crate::run::FileId;
use crate::store::{ConclusionFault, Counts, DaemonClaim, StaleRobot};
use judging::OpenTests;
use outcome_log::log_outcome;
use service::ServiceManager;
pub use signals::{reload_on_hangup, stop_on_signal};
use stale::Stale;
use start::{begun_before, patiently, reweight};
use turn::{Class, ReadMode, named_robot, robot_of};
use vanished::Missing;

/// Hints that arrive within this time cause one scan: a copy of a large file makes thousands.
const HINT_PAUSE: Duration = Duration::from_millis(100);

/// Between two scans that hints cause, so many times what the last one took passes: files that grow
/// all day must not make the daemon look at thousands of others all day.
const SCAN_SHARE: u32 = 10;

/// Conclusions that still wait when the daemon is to stop are drawn for this long, the others at the next start: a
/// fleet's backlog takes minutes, and who stops a service waits for seconds.
const CONCLUDE_AT_STOP: Duration = Duration::from_secs(5);

/// Files about which the database is asked in one statement.
const FILES_ASKED_AT_ONCE: usize = 500;

/// Counting the files that wait may take at most one part in so many of the daemon's time.
const COUNTING_SHARE: u32 = 100;

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

/// A file whose task has ended.
struct Closed {
    due: NextAttempt,
    way: ReadMode,
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
    book: FileSchedule,
    missing: Missing,
    tasks: JoinSet<Closed>,
    /// Growing files being read.
    places: Places,
    /// The configuration was read again, and what watches the folders does not know it yet.
    is_reloaded: bool,
    /// Files that were to be read again at the last look.
    asked: HashSet<PathBuf>,
    /// When the files that wait are counted again at the earliest.
    next_count: Instant,
    /// Robots with a settled file being read.
    robots: HashSet<String>,
    /// Settled files being read, of each class.
    settled: [usize; Class::ALL.len()],
    /// A settled file of each class whose run has no number yet. One at a time, so that numbers follow names,
    /// and of two files with one content, which have one size, the first by name is taken.
    admitting: [Option<FileId>; Class::ALL.len()],
    /// Robots that wait for conclusions.
    stale: Stale,
    /// Conclusions being drawn, one robot at a time.
    concluding: JoinSet<(String, Result<Conclusion, PipelineError>)>,
    /// The robot that they are of.
    concluded_robot: Option<String>,
    /// Tests that are judged while they are written.
    open_tests: OpenTests,
    progress: (mpsc::UnboundedSender<Progressed>, mpsc::UnboundedReceiver<Progressed>),
}

/// What a daemon works with besides its pipeline.
pub struct Control<'r> {
    /// The database is this daemon's.
    pub claim: DaemonClaim,
    /// Ends it.
    pub stop: CancellationToken,
    /// Asks it to read its configuration again; see [`reload_on_hangup`].
    pub reload: mpsc::Receiver<()>,
    /// Reads the configuration, when asked to and when quarantined exports are to be read again, because their
    /// robot or layout may have been corrected.
    pub reread: &'r Reread<'r>,
}

/// Watches the configured folders until a stop is asked for, then finishes the cycles in hand. `report` hears the
/// outcome of every export and what each robot's history says.
///
/// # Errors
/// [`PipelineError`] where the daemon cannot go on, such as a full disk.
pub async fn watch(
    pipeline: &Pipeline,
    control: Control<'_>,
    mut report: impl FnMut(Event<'_>),
) -> Result<(), PipelineError> {
    let Control { claim: _claim, stop, reload, reread } = control;
    let counts = patiently(&stop, async || Ok(pipeline.store().counts().await?)).await?;
    let Some(Counts { quarantined_runs, open_anomalies, .. }) = counts else { return Ok(()) };
    if quarantined_runs > 0 {
        tracing::info!(
            quarantined = quarantined_runs,
            "exports in quarantine; `armwatch quarantine list` shows them"
        );
    }
    if open_anomalies > 0 {
        tracing::info!(open_anomalies, "anomalies are open; `armwatch alerts list` shows them");
    }
    if patiently(&stop, async || reweight(pipeline, &stop).await).await? != Some(true) {
        return Ok(());
    }
    let unfinished = patiently(&stop, async || Ok(pipeline.store().unfinished_sources().await?)).await?;
    let Some(unfinished) = unfinished else { return Ok(()) };
    let begun = begun_before(&unfinished);
    let mut work = Work::new(pipeline, reread, stop.child_token(), begun);
    let missed = tokio::spawn(archive::take_missed(pipeline.clone(), work.stop.clone()));
    let watched = work.run_loop(reload, &mut report).await;
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
    // what is not concluded then is concluded when the daemon starts again
    let end = Instant::now() + CONCLUDE_AT_STOP;
    while Instant::now() < end
        && let Some(robot) = work.stale.next(Instant::now(), |_| true)
    {
        let concluded = work.pipeline.conclude_isolated(&robot).await;
        work.concluded((robot, concluded), &mut report)?;
    }
    Ok(())
}

/// Reports what a robot's history says.
fn announce(concluded: &Concluded, report: &mut impl FnMut(Event<'_>)) {
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
            book: FileSchedule::new(pipeline.config().watch.settle, begun),
            missing: Missing::default(),
            tasks: JoinSet::new(),
            places: Places::default(),
            is_reloaded: false,
            asked: HashSet::new(),
            next_count: Instant::now(),
            robots: HashSet::new(),
            settled: [0; Class::ALL.len()],
            admitting: [None; Class::ALL.len()],
            stale: Stale::default(),
            concluding: JoinSet::new(),
            concluded_robot: None,
            open_tests: OpenTests::default(),
            progress: mpsc::unbounded_channel(),
        }
    }

    /// The settings in force, folders from the root on, as paths are stored.
    fn watch_settings(&self) -> WatchSettings {
        let mut settings = self.pipeline.config().watch.clone();
        settings.folders.iter_mut().for_each(|folder| *folder = archive::from_root(folder));
        settings
    }

    /// Scans and takes files until a stop is asked for.
    async fn run_loop(
        &mut self,
        mut reload: mpsc::Receiver<()>,
        report: &mut impl FnMut(Event<'_>),
    ) -> Result<(), PipelineError> {
        let mut settings = self.watch_settings();
        let (mut watcher, mut hints) = watch::watch_folders(&settings.folders);
        let mut complaints = Complaints::default();
        let mut next_scan = Instant::now();
        let mut earliest = next_scan;
        let stop = self.stop.clone();
        let pipeline = self.pipeline.clone();
        let stale = patiently(&stop, async || Ok(pipeline.store().stale_robots().await?)).await?;
        let faults = patiently(&stop, async || Ok(pipeline.store().conclusion_faults().await?)).await?;
        self.take_over_stale(&stale.unwrap_or_default(), &faults.unwrap_or_default());
        let mut manager = ServiceManager::ready(Instant::now());
        while !self.stop.is_cancelled() {
            if std::mem::take(&mut self.is_reloaded) {
                let new = self.watch_settings();
                if new.folders != settings.folders {
                    (watcher, hints) = watch::watch_folders(&new.folders);
                }
                (next_scan, settings) = (Instant::now(), new);
                earliest = next_scan;
            }
            self.take_what_is_due();
            self.conclude_what_is_due();
            self.count_queues();
            self.open_tests.begin(&self.pipeline);
            let next_look = self.next_look();
            tokio::select! {
                () = self.stop.cancelled() => {}
                Some(closed) = self.tasks.join_next() => self.close(closed?, report)?,
                Some(concluded) = self.concluding.join_next() => self.concluded(concluded?, report)?,
                Some(judged) = self.open_tests.next() => if let Some(of) = judged? { announce(&of, report) },
                Some((file, progress)) = self.progress.1.recv() => self.progressed(file, progress),
                Some(()) = hints.recv(), if next_scan > earliest => next_scan = earliest,
                Some(()) = reload.recv() => self.reload(),
                () = until(next_look) => {}
                () = until(manager.next_beat()) => manager.beat(Instant::now()),
                () = tokio::time::sleep_until(next_scan.into()) => {
                    watcher.watch_missing();
                    let started = Instant::now();
                    match self.scan(&settings.folders, &mut complaints).await {
                        Err(PipelineError::Store(error)) if !error.is_fatal() => {
                            tracing::warn!(%error, "not all was looked at; looking again");
                        }
                        scanned => scanned?,
                    }
                    manager.status(self.at_work());
                    let ended = Instant::now();
                    next_scan = ended + settings.scan_interval;
                    earliest = ended + HINT_PAUSE.max(SCAN_SHARE * (ended - started));
                }
            }
        }
        manager.stopping();
        Ok(())
    }

    /// What the daemon is at, for people who ask the service manager.
    fn at_work(&self) -> String {
        format!(
            "{} exports being read, {} wait, {} robots to conclude",
            self.tasks.len(),
            self.book.waiting(Instant::now()).saturating_sub(self.tasks.len()),
            self.stale.count() + self.concluding.len()
        )
    }

    async fn scan(&mut self, folders: &[PathBuf], complaints: &mut Complaints) -> Result<(), PipelineError> {
        let (owned, began) = (folders.to_vec(), Instant::now());
        let scan = tokio::task::spawn_blocking(move || watch::scan(&owned)).await?;
        self.pipeline.metrics().scanned(scan.files.len(), began.elapsed());
        complaints.warn(&scan);
        let retries = self.note_retries().await;
        self.leave_known(&scan).await?;
        let lane_of = |path: &Path| robot_of(self.pipeline.config(), path);
        self.book.note(&scan.files, Instant::now(), tail::is_marked, lane_of);
        // files are taken also while the database is busy
        retries?;
        self.give_up_vanished(folders, &scan).await?;
        let stale = self.pipeline.store().stale_robots().await?;
        self.stale.look(&stale, self.concluded_robot.as_deref(), Instant::now());
        tracing::trace!(
            files = scan.files.len(),
            waiting = self.book.waiting(Instant::now()),
            open = self.tasks.len(),
            to_conclude = stale.len() + self.concluding.len(),
            "looked at the watched folders"
        );
        Ok(())
    }

    /// Leaves files alone that are seen for the first time and whose fate was decided as they lie there: a start with a
    /// hundred thousand of them asks the database a few hundred times. With an archive, each is looked at, since it
    /// may have to be moved there.
    async fn leave_known(&mut self, scan: &Scan) -> Result<(), PipelineError> {
        if self.pipeline.config().watch.archive.is_some() {
            return Ok(());
        }
        let unseen: Vec<&FoundFile> = self.book.unseen(&scan.files).collect();
        for some in unseen.chunks(FILES_ASKED_AT_ONCE) {
            let known = self.pipeline.known_as_they_are(some).await?;
            for path in &known {
                tracing::debug!(file = %path.display(), "known as it lies there");
                self.pipeline.metrics().export(ExportEnd::Known);
            }
            self.book.taken_before(known.into_iter());
        }
        Ok(())
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

    /// Reads the configuration again, for exports that are taken from now on; one that cannot be used changes
    /// nothing.
    fn reload(&mut self) {
        let Some(config) = (self.reread)() else { return };
        tracing::info!("configuration read again");
        self.book.settle_in(config.watch.settle);
        self.pipeline = self.pipeline.with_config(config.into());
        self.is_reloaded = true;
    }

    /// Lets exports be taken again that a person asked for, by the configuration as it is now.
    async fn note_retries(&mut self) -> Result<(), PipelineError> {
        let asked = self.pipeline.store().paths_to_retry().await?;
        let asked: HashSet<PathBuf> = asked.into_iter().collect();
        if !asked.is_subset(&self.asked) {
            self.reload();
            asked.iter().for_each(|path| self.book.again(path));
        }
        self.asked = asked;
        Ok(())
    }

    /// Starts as many tasks as there may be, for growing files first.
    fn take_what_is_due(&mut self) {
        let (now, most) = (Instant::now(), self.pipeline.config().watch.live_files);
        self.places.say_hanging(now);
        while self.places.has_free(most, now)
            && let Some(due) = self.book.next_growing()
        {
            self.follow(due, now);
        }
        let waiting = self.book.growing_waiting();
        if waiting > 0 && self.places.are_taken(most, now) {
            self.places.say_short(waiting, most);
            self.places.ask(waiting, now);
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
                starting.push((due, robot, class));
            }
        }
        starting.into_iter().for_each(|(due, robot, class)| self.take(due, robot, class));
    }

    /// Tells how many files wait and are being read. Each file that waits is looked at, so that of a long queue it is
    /// not told with every event.
    fn count_queues(&mut self) {
        let began = Instant::now();
        if began < self.next_count {
            return;
        }
        let (metrics, config) = (self.pipeline.metrics(), self.pipeline.config());
        metrics.queue(Queue::Growing, self.book.growing_waiting(), self.places.count());
        for (class, queue) in [(Class::Small, Queue::Small), (Class::Large, Queue::Large)] {
            let waiting = self.book.settled_waiting(|bytes| Class::of(bytes, config) == class);
            metrics.queue(queue, waiting, self.settled[class as usize]);
        }
        self.next_count = Instant::now() + COUNTING_SHARE * began.elapsed();
    }

    fn progressed(&mut self, file: FileId, progress: Progress) {
        match progress {
            Progress::Begun => self.admitted(file),
            Progress::CaughtUp => self.places.caught_up(file, Instant::now()),
            Progress::Grown(run_id) => self.open_tests.grew(run_id),
            Progress::Reading | Progress::Read(_) | Progress::Cycle(_) => {}
        }
    }

    /// When something is due though nothing happens.
    fn next_look(&self) -> Option<Instant> {
        let now = Instant::now();
        let places = self.places.next_look(self.book.growing_waiting() > 0, now);
        // while conclusions are drawn, their end is waited for
        let stale = if self.concluding.is_empty() { self.stale.next_look(now) } else { None };
        places.into_iter().chain(stale).min()
    }

    /// Notes that the run of a file has its number, or that the file is closed.
    fn admitted(&mut self, file: FileId) {
        for place in &mut self.admitting {
            place.take_if(|admitting| *admitting == file);
        }
    }

    /// Begins to read a growing file.
    fn follow(&mut self, due: NextAttempt, now: Instant) {
        let Place { sign, give_way } = self.places.give(due.file, &due.path, &self.stop, now);
        let (pipeline, sender) = (self.pipeline.clone(), self.progress.0.clone());
        let (ends, file) = (Ends { stop: self.stop.clone(), give_way }, due.file);
        let live = named_robot(pipeline.config(), &due.path).map(|robot| pipeline.metrics().live(&robot));
        let live = Arc::new(live);
        let progress = move |progress| {
            match progress {
                Progress::Reading => sign.reads(Instant::now()),
                Progress::Read(bytes) => {
                    if sign.has_read(bytes) {
                        live.iter().for_each(LiveFile::read);
                    }
                }
                Progress::Begun | Progress::CaughtUp => {
                    sign.waits_for_others();
                    // nobody listens any more when the daemon ends
                    let _ = sender.send((file, progress));
                }
                Progress::Grown(_) => {
                    let _ = sender.send((file, progress));
                }
                Progress::Cycle(_) => live.iter().for_each(LiveFile::stored),
            }
        };
        self.tasks.spawn(async move {
            let (path, patience) = (due.path.clone(), due.patience);
            let reading =
                tokio::spawn(async move { pipeline.follow(&path, patience, &ends, progress).await });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Growing, result }
        });
    }

    /// Begins to read a settled file.
    fn take(&mut self, due: NextAttempt, robot: String, class: Class) {
        let (pipeline, stop) = (self.pipeline.clone(), self.stop.clone());
        let (sender, file) = (self.progress.0.clone(), due.file);
        let progress = move |progress| {
            if progress == Progress::Begun {
                // nobody listens any more when the daemon ends
                let _ = sender.send((file, progress));
            }
        };
        self.tasks.spawn(async move {
            let path = due.path.clone();
            let reading = tokio::spawn(async move {
                let outcome = pipeline.process(&path, Retry::Never, &stop, progress).await?;
                archive::after(&pipeline, &path, &outcome).await;
                Ok(Followed::Outcome(outcome))
            });
            let result = reading.await.unwrap_or_else(|panic| Err(panic.into()));
            Closed { due, way: ReadMode::Settled(robot, class), result }
        });
    }

    /// Takes over the robots that wait for conclusions, and says of which of them they failed.
    fn take_over_stale(&mut self, stale: &[StaleRobot], faults: &[ConclusionFault]) {
        for fault in faults {
            tracing::warn!(robot = fault.robot, "nothing new is concluded of this robot: {}", fault.reason);
        }
        self.stale.take_over(stale, faults, Instant::now());
    }

    /// Begins conclusions for the robot whose turn it is.
    fn conclude_what_is_due(&mut self) {
        if !self.concluding.is_empty() {
            return;
        }
        let is_through = |robot: &str| !self.robots.contains(robot) && !self.book.has_settled(robot);
        let Some(robot) = self.stale.next(Instant::now(), is_through) else { return };
        self.concluded_robot = Some(robot.clone());
        let pipeline = self.pipeline.clone();
        self.concluding.spawn(async move {
            let began = Instant::now();
            let concluded = pipeline.conclude_isolated(&robot).await;
            if matches!(concluded, Ok(Conclusion::Drawn(_))) {
                pipeline.metrics().stage(Stage::Conclude, began.elapsed());
            }
            (robot, concluded)
        });
    }

    /// Announces conclusions, or notes that they are still to be drawn.
    fn concluded(
        &mut self,
        (robot, result): (String, Result<Conclusion, PipelineError>),
        report: &mut impl FnMut(Event<'_>),
    ) -> Result<(), PipelineError> {
        self.concluded_robot = None;
        self.open_tests.concluded();
        match result {
            Err(PipelineError::Store(error)) if !error.is_fatal() => {
                tracing::warn!(robot, %error, "conclusions not stored now; trying again");
                self.stale.again(robot, Instant::now());
                return Ok(());
            }
            Err(error) => return Err(error),
            Ok(Conclusion::Faulty(_)) => {
                self.pipeline.metrics().conclusion_failed();
                self.stale.failed(robot, Instant::now());
            }
            Ok(Conclusion::Elsewhere) => {
                tracing::debug!(robot, "another daemon draws conclusions");
                self.stale.again(robot, Instant::now());
            }
            Ok(Conclusion::UpToDate) => self.stale.concluded(&robot),
            Ok(Conclusion::Drawn(concluded)) => {
                self.stale.concluded(&robot);
                announce(&concluded, report);
            }
        }
        Ok(())
    }

    /// Notes, logs and reports what became of a file.
    fn close(&mut self, closed: Closed, report: &mut impl FnMut(Event<'_>)) -> Result<(), PipelineError> {
        let Closed { due, way, result } = closed;
        self.admitted(due.file);
        self.asked.remove(&due.path);
        let mut read = 0;
        match &way {
            ReadMode::Growing => read = self.places.take_back(due.file),
            ReadMode::Settled(robot, class) => {
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
            Err(PipelineError::Task(error)) if error.is_panic() => {
                tracing::error!(file = %due.path.display(), %error, "internal error; other exports go on");
                self.pipeline.metrics().export(ExportEnd::Failed);
                let is_growing = way == ReadMode::Growing;
                self.book.close(&due, if is_growing { Closing::UntilSettled } else { Closing::Unreadable });
                return Ok(());
            }
            result => result?,
        };
        self.book.close(&due, closing(&followed, &way, read));
        if let Followed::Outcome(outcome) = &followed {
            log_outcome(&due.path, outcome);
            self.pipeline.metrics().export(end_of(outcome));
            if let Outcome::Stored(run) = outcome {
                self.stale.completed(&run.robot, Instant::now());
            }
            report(Event::Export(&due.path, outcome));
        }
        Ok(())
    }
}

/// What becomes of a file of which so many bytes were read while it grew.
fn closing(followed: &Followed, way: &ReadMode, read: u64) -> Closing {
    match (followed, way) {
        (Followed::GaveWay, _) => Closing::GaveWay(read),
        (Followed::UntilSettled, _) => Closing::UntilSettled,
        (Followed::NotYet, _) => Closing::Again,
        (Followed::Outcome(Outcome::Changed | Outcome::InWork { .. } | Outcome::Interrupted), _) => {
            Closing::Again
        }
        (Followed::Outcome(Outcome::Unreadable { .. }), _) => Closing::Unreadable,
        (Followed::Outcome(_), ReadMode::Growing) => Closing::Done,
        (Followed::Outcome(_), ReadMode::Settled(..)) => Closing::Taken,
    }
}

/// Waits until then, or for ever.
async fn until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment.into()).await,
        None => std::future::pending().await,
    }
}

/// How what became of an export is counted.
fn end_of(outcome: &Outcome) -> ExportEnd {
    match outcome {
        Outcome::Stored(_) => ExportEnd::Stored,
        Outcome::AlreadyStored { .. } | Outcome::Quarantined { known: true, .. } => ExportEnd::Known,
        Outcome::Quarantined { .. } => ExportEnd::Quarantined,
        Outcome::Interrupted | Outcome::Changed | Outcome::Unreadable { .. } | Outcome::InWork { .. } => {
            ExportEnd::Later
        }
    }
}
