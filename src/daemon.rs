//! The life of the daemon: look at the folders, take what grows and what has settled, stop when told.
//!
//! File events only say "look again"; the scan decides, and comparing it with the ledger makes
//! looking twice harmless. Files that grow are read at once, each on its own; files that have settled
//! are the backlog: a few at a time, those of one robot one after the other, so that its history grows in the
//! order of the names.

mod archive;
mod export_tasks;
mod file_schedule;
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
mod suspects;
mod turn;
mod vanished;

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use export_tasks::{Closed, ExportTasks, Happened, closing};
use file_schedule::{Begun, Closing, FileSchedule};
use judging::OpenTests;
use outcome_log::{end_of, log_outcome};
use service::ServiceManager;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::metrics::{ExportEnd, Stage};
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, PipelineError};
use crate::pipeline::take::follow::Followed;
use armwatch_config::{Config, WatchSettings};
use armwatch_ingest::find::watch::{Complaints, FoundFile, Scan};
use armwatch_ingest::find::{tail, watch};
use armwatch_model::text;
use armwatch_store::{ConclusionFault, Counts, DaemonClaim, StaleRobot};

pub use signals::{reload_on_hangup, stop_on_signal};
use stale::Stale;
use start::{begun_before, patiently, reweight};
use suspects::Suspects;
use turn::{ReadMode, robot_of};
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

/// Reads the configuration again; says why itself where it cannot be used.
pub type Reread<'r> = dyn Fn() -> Option<Config> + 'r;

/// The daemon at work.
struct Work<'r> {
    pipeline: Pipeline,
    reread: &'r Reread<'r>,
    stop: CancellationToken,
    schedule: FileSchedule,
    missing: Missing,
    exports: ExportTasks,
    /// The configuration was read again, and what watches the folders does not know it yet.
    is_reloaded: bool,
    /// Files that were to be read again at the last look.
    asked: HashSet<PathBuf>,
    /// Robots that wait for conclusions.
    stale: Stale,
    /// Conclusions being drawn, one robot at a time.
    concluding: JoinSet<(String, Result<Conclusion, PipelineError>)>,
    /// The robot that they are of.
    concluded_robot: Option<String>,
    /// Tests that are judged while they are written.
    open_tests: OpenTests,
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
    let began = Instant::now();
    let failed = patiently(&stop, async || Ok(pipeline.store().take_over_attempts().await?)).await?;
    let Some(failed) = failed else { return Ok(()) };
    let mut work = Work::new(pipeline, reread, stop.child_token(), begun_before(&unfinished));
    work.suspect(began, failed);
    let missed = tokio::spawn(archive::take_missed(pipeline.clone(), work.stop.clone()));
    let watched = work.run_loop(reload, &mut report).await;
    // after a failure the others finish their cycles too
    work.stop.cancel();
    missed.await?;
    while let Some(closed) = work.exports.next().await {
        let ended = closed.and_then(|closed| work.close(closed, &mut report));
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
        let exports = ExportTasks::new(stop.clone());
        Self {
            pipeline: pipeline.clone(),
            reread,
            stop,
            schedule: FileSchedule::new(pipeline.config().watch.settle, begun),
            missing: Missing::default(),
            exports,
            is_reloaded: false,
            asked: HashSet::new(),
            stale: Stale::default(),
            concluding: JoinSet::new(),
            concluded_robot: None,
            open_tests: OpenTests::default(),
        }
    }

    /// Lets files that the program did not survive be read one at a time.
    fn suspect(&mut self, began: Instant, failed: Vec<(PathBuf, u32)>) {
        for (path, attempts) in &failed {
            tracing::warn!(
                file = %path.display(), attempts,
                "the program ended while this export was read; such exports are read one at a time, three times at most"
            );
        }
        self.schedule.suspect(Suspects::new(began, failed));
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
            self.exports.begin(&self.pipeline, &mut self.schedule);
            self.conclude_what_is_due();
            self.exports.count_queues(&self.pipeline, &self.schedule);
            self.open_tests.begin(&self.pipeline);
            let next_look = self.next_look();
            tokio::select! {
                () = self.stop.cancelled() => {}
                happened = self.exports.happened() => match happened? {
                    Happened::Ended(closed) => self.close(*closed, report)?,
                    Happened::Grown(run_id) => self.open_tests.grew(run_id),
                    Happened::Progressed => {}
                },
                Some(concluded) = self.concluding.join_next() => self.concluded(concluded?, report)?,
                Some(judged) = self.open_tests.next() => if let Some(of) = judged? { announce(&of, report) },
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
            self.exports.count(),
            self.schedule.waiting(Instant::now()).saturating_sub(self.exports.count()),
            self.stale.count() + self.concluding.len()
        )
    }

    async fn scan(&mut self, folders: &[PathBuf], complaints: &mut Complaints) -> Result<(), PipelineError> {
        self.pipeline.store().check_files()?;
        let (owned, began) = (folders.to_vec(), Instant::now());
        let scan = tokio::task::spawn_blocking(move || watch::scan(&owned)).await?;
        self.pipeline.metrics().scanned(scan.files.len(), began.elapsed());
        complaints.warn(&scan);
        let retries = self.note_retries().await;
        self.leave_known(&scan).await?;
        let lane_of = |path: &Path| robot_of(self.pipeline.config(), path);
        self.schedule.note(&scan.files, Instant::now(), tail::is_marked, lane_of);
        // files are taken also while the database is busy
        retries?;
        let is_there = |path: &Path| !vanished::is_missing(path, folders, &scan);
        self.pipeline.store().unblock_vanished(is_there).await?;
        self.give_up_vanished(folders, &scan).await?;
        let stale = self.pipeline.store().stale_robots().await?;
        self.stale.look(&stale, self.concluded_robot.as_deref(), Instant::now());
        tracing::trace!(
            files = scan.files.len(),
            waiting = self.schedule.waiting(Instant::now()),
            open = self.exports.count(),
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
        let unseen: Vec<&FoundFile> = self.schedule.unseen(&scan.files).collect();
        for some in unseen.chunks(FILES_ASKED_AT_ONCE) {
            let known = self.pipeline.known_as_they_are(some).await?;
            for path in &known {
                tracing::debug!(file = %text::of_path(path), "known as it lies there");
                self.pipeline.metrics().export(ExportEnd::Known);
            }
            self.schedule.taken_before(known.into_iter());
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
        self.schedule.settle_in(config.watch.settle);
        self.pipeline = self.pipeline.with_config(config.into());
        self.is_reloaded = true;
    }

    /// Lets exports be taken again that a person asked for, by the configuration as it is now.
    async fn note_retries(&mut self) -> Result<(), PipelineError> {
        let asked = self.pipeline.store().paths_to_retry().await?;
        let asked: HashSet<PathBuf> = asked.into_iter().collect();
        if !asked.is_subset(&self.asked) {
            self.reload();
            let (config, now) = (self.pipeline.config(), Instant::now());
            asked.iter().for_each(|path| self.schedule.again(path, now, |path| robot_of(config, path)));
        }
        self.asked = asked;
        Ok(())
    }

    /// When something is due though nothing happens.
    fn next_look(&self) -> Option<Instant> {
        let now = Instant::now();
        let places = self.exports.next_look(&self.schedule, now);
        // while conclusions are drawn, their end is waited for
        let stale = if self.concluding.is_empty() { self.stale.next_look(now) } else { None };
        places.into_iter().chain(stale).min()
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
        let is_through =
            |robot: &str| !self.exports.reads_settled(robot) && !self.schedule.has_settled(robot);
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
        self.asked.remove(&due.path);
        let read = self.exports.free(&due, &way);
        let followed = match result {
            Err(PipelineError::Store(error)) if !error.is_fatal() => {
                tracing::warn!(file = %text::of_path(&due.path), %error, "not stored now; trying again");
                self.schedule.close(&due, Closing::Again);
                return Ok(());
            }
            Err(PipelineError::Task(error)) if error.is_panic() => {
                tracing::error!(file = %text::of_path(&due.path), %error, "internal error; other exports go on");
                self.pipeline.metrics().export(ExportEnd::Failed);
                let is_growing = way == ReadMode::Growing;
                self.schedule
                    .close(&due, if is_growing { Closing::UntilSettled } else { Closing::Unreadable });
                return Ok(());
            }
            result => result?,
        };
        self.schedule.close(&due, closing(&followed, &way, read));
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

/// Waits until then, or for ever.
async fn until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment.into()).await,
        None => std::future::pending().await,
    }
}
