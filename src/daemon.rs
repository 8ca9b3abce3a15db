//! The main loop of the daemon: scan the folders, read growing and settled files, stop on request.
//!
//! File events only trigger a scan; the scan decides, and the comparison with the ledger makes repeated scans harmless.
//! The main loop never waits for a file system: separate threads read folders, exports and the configuration. Growing
//! files are read at once, each independently; settled files are the backlog: a few are read at a time, and those of
//! one robot one after the other, so that its history grows in the order of the names.

mod archive;
pub mod disks;
mod export_tasks;
mod file_schedule;
mod folders;
mod judging;
mod left_out;
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
use std::sync::Arc;
use std::time::{Duration, Instant};

use export_tasks::{Closed, ExportTasks, Happened, closing};
use file_schedule::{Closing, FileSchedule, KnownFile, Sighting};
use folders::{FolderLooks, Folders, Turned};
use judging::OpenTests;
use left_out::LeftOutPlaces;
use outcome_log::{end_of, log_outcome};
use service::ServiceManager;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinSet;
use tokio_util::sync::CancellationToken;

use crate::metrics::{ExportEnd, WorkStage};
use crate::pipeline::conclude::history::Concluded;
use crate::pipeline::conclude::isolation::Conclusion;
use crate::pipeline::context::{Outcome, Pipeline, PipelineError};
use crate::pipeline::take::follow::Followed;
use armwatch_config::{Config, WatchSettings};
use armwatch_model::text;
use armwatch_store::{ConclusionFault, DaemonClaim, StaleRobot, StoredCounts};

pub use signals::{reload_on_hangup, stop_on_signal};
use stale::Stale;
use start::{begun_before, patiently, reweight};
use suspects::Suspects;
use turn::{ReadMode, robot_of};
use vanished::Missing;

/// At a stop, the daemon abandons exports whose disk or file server has not answered for this long.
const UNANSWERED_AT_STOP: Duration = Duration::from_secs(5);

/// After this time, the log reports that the configuration cannot be read. The earlier one stays in force.
const REREAD_WITHIN: Duration = Duration::from_secs(5);

/// Time for drawing waiting conclusions when the daemon stops; the next start draws the others. A fleet's backlog takes
/// minutes, and stopping a service should take seconds.
const CONCLUDE_AT_STOP: Duration = Duration::from_secs(5);

/// Most files per database query.
const FILES_ASKED_AT_ONCE: usize = 500;

/// An event that the daemon reports.
#[derive(Debug)]
pub enum DaemonEvent<'a> {
    /// The outcome of an export.
    Export(&'a Path, &'a Outcome),
    /// New conclusions from a robot's history.
    Concluded(&'a Concluded),
}

/// Why a run ends if its file is gone.
const VANISHED: &str = "the file vanished before it was read to its end; put it back, or export it again";

/// Reads the configuration again; logs the reason if it cannot be used. Called on a separate thread.
pub type Reread = Arc<dyn Fn() -> Option<Config> + Send + Sync>;

/// A configuration that is being read.
struct Rereading {
    read: oneshot::Receiver<Option<Config>>,
    /// When its delay is logged; `None` after that.
    due: Option<Instant>,
}

/// The running daemon.
struct RunningDaemon {
    pipeline: Pipeline,
    reread: Reread,
    rereading: Option<Rereading>,
    /// Another request has arrived in the meantime.
    rereads_again: bool,
    /// Files that are read again with the new configuration.
    retries: HashSet<PathBuf>,
    stop: CancellationToken,
    schedule: FileSchedule,
    missing: Missing,
    left_out: LeftOutPlaces,
    exports: ExportTasks,
    /// The configuration was read again, and the folder scanner does not know it yet.
    is_reloaded: bool,
    /// Files that were marked for reading again at the last scan.
    asked: HashSet<PathBuf>,
    /// Robots that wait for conclusions.
    stale: Stale,
    /// Conclusions being drawn, one robot at a time.
    concluding: JoinSet<(String, Result<Conclusion, PipelineError>)>,
    /// The robot of these conclusions.
    concluded_robot: Option<String>,
    /// Tests that are evaluated while they are written.
    open_tests: OpenTests,
}

/// The daemon's resources besides its pipeline.
pub struct Control {
    /// The daemon's claim on the database.
    pub claim: DaemonClaim,
    /// Stops the daemon.
    pub stop: CancellationToken,
    /// Requests to read the configuration again; see [`reload_on_hangup`].
    pub reload: mpsc::Receiver<()>,
    /// Reads the configuration, on request and before quarantined exports are read again, because their robot or layout
    /// may have been corrected.
    pub reread: Reread,
}

/// Watches the configured folders until a stop is requested, then finishes the current cycles. `report` receives the
/// outcome of every export and the conclusions of each robot.
///
/// # Errors
/// [`PipelineError`] if the daemon cannot continue, for example with a full disk.
pub async fn watch(
    pipeline: &Pipeline,
    control: Control,
    mut report: impl FnMut(DaemonEvent<'_>),
) -> Result<(), PipelineError> {
    let Control { claim, stop, reload, reread } = control;
    let counts = patiently(&stop, async || Ok(pipeline.store().counts().await?)).await?;
    let Some(StoredCounts { quarantined_runs, open_anomalies, .. }) = counts else { return Ok(()) };
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
    if patiently(&stop, async || Ok(pipeline.store().forget_folders().await?)).await?.is_none() {
        return Ok(());
    }
    let mut work = RunningDaemon::new(pipeline, reread, stop.child_token(), begun_before(&unfinished));
    work.suspect(began, failed);
    let missed = tokio::spawn(archive::take_missed(pipeline.clone(), work.stop.clone()));
    let watched = work.run_loop(&claim, reload, &mut report).await;
    // after a failure, the other exports finish their cycles too
    work.stop.cancel();
    // an archive without answer is examined at the next start
    if let Ok(missed) = tokio::time::timeout(UNANSWERED_AT_STOP, missed).await {
        missed?;
    }
    while let Some(closed) = work.exports.next_answering(UNANSWERED_AT_STOP).await {
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
    // the remaining conclusions are drawn when the daemon starts again
    let end = Instant::now() + CONCLUDE_AT_STOP;
    while Instant::now() < end
        && let Some(robot) = work.stale.next(Instant::now(), |_| true)
    {
        let concluded = work.pipeline.conclude_isolated(&robot).await;
        work.concluded((robot, concluded), &mut report)?;
    }
    Ok(())
}

impl RunningDaemon {
    fn new(
        pipeline: &Pipeline,
        reread: Reread,
        stop: CancellationToken,
        begun: HashMap<PathBuf, KnownFile>,
    ) -> Self {
        let exports = ExportTasks::new(stop.clone());
        Self {
            pipeline: pipeline.clone(),
            reread,
            rereading: None,
            rereads_again: false,
            retries: HashSet::new(),
            stop,
            schedule: FileSchedule::new(pipeline.config().watch.settle, begun),
            missing: Missing::default(),
            left_out: LeftOutPlaces::default(),
            exports,
            is_reloaded: false,
            asked: HashSet::new(),
            stale: Stale::default(),
            concluding: JoinSet::new(),
            concluded_robot: None,
            open_tests: OpenTests::default(),
        }
    }

    /// Lets files that crashed the program be read one at a time.
    fn suspect(&mut self, began: Instant, failed: Vec<(PathBuf, u32)>) {
        for (path, attempts) in &failed {
            tracing::warn!(
                file = %text::of_path(path), attempts,
                "the program ended while this export was read; such exports are read one at a time, at most \
                three times"
            );
        }
        self.schedule.suspect(Suspects::new(began, failed));
    }

    /// The settings in force, with absolute folders, like stored paths.
    fn watch_settings(&self) -> WatchSettings {
        let mut settings = self.pipeline.config().watch.clone();
        settings.folders.iter_mut().for_each(|folder| *folder = archive::from_root(folder));
        settings
    }

    /// Scans and reads files until a stop is requested.
    async fn run_loop(
        &mut self,
        claim: &DaemonClaim,
        mut reload: mpsc::Receiver<()>,
        report: &mut impl FnMut(DaemonEvent<'_>),
    ) -> Result<(), PipelineError> {
        let mut folders = Folders::new(&self.watch_settings(), self.pipeline.metrics().clone());
        folders.join_by(self.pipeline.shared_config());
        let mut next_look = Instant::now() + self.pipeline.config().watch.scan_interval;
        let stop = self.stop.clone();
        let pipeline = self.pipeline.clone();
        let stale = patiently(&stop, async || Ok(pipeline.store().stale_robots().await?)).await?;
        let faults = patiently(&stop, async || Ok(pipeline.store().conclusion_faults().await?)).await?;
        self.take_over_stale(&stale.unwrap_or_default(), &faults.unwrap_or_default());
        let mut manager = ServiceManager::ready(Instant::now());
        let mut beats = tokio::time::interval(DaemonClaim::BEAT);
        while !self.stop.is_cancelled() {
            let now = Instant::now();
            if std::mem::take(&mut self.is_reloaded) {
                folders.set(&self.watch_settings());
                folders.join_by(self.pipeline.shared_config());
            }
            for turned in folders.turned(now) {
                next_look = now;
                self.note_answer(&turned).await?;
            }
            self.exports.begin(&self.pipeline, &mut self.schedule);
            self.conclude_what_is_due();
            self.exports.count_queues(&self.pipeline, &self.schedule);
            self.open_tests.begin(&self.pipeline);
            let next_event = self.next_event();
            let (next_begin, next_turn) = (folders.next_begin(), folders.next_turn());
            let reread_due = self.rereading.as_ref().and_then(|reading| reading.due);
            tokio::select! {
                () = self.stop.cancelled() => {}
                happened = self.exports.happened() => match happened? {
                    Happened::Ended(closed) => self.close(*closed, report)?,
                    Happened::Grown(run_id) => self.open_tests.grew(run_id),
                    Happened::Progressed => {}
                },
                Some(concluded) = self.concluding.join_next() => self.concluded(concluded?, report)?,
                Some(judged) = self.open_tests.next() => if let Some(of) = judged? { report(DaemonEvent::Concluded(&of)) },
                is_new = folders.happened() => if is_new { next_look = now },
                Some(()) = reload.recv() => self.reload(),
                config = read_again(&mut self.rereading) => if self.reloaded(config) { next_look = now },
                () = until(reread_due) => if self.reread_is_overdue() { next_look = now },
                () = until(next_event) => {}
                () = until(next_turn) => {}
                () = until(next_begin) => folders.begin(Instant::now()),
                () = until(manager.next_beat()) => manager.beat(Instant::now()),
                _ = beats.tick() => claim.beat(),
                () = tokio::time::sleep_until(next_look.into()) => {
                    match self.look(&folders.look()).await {
                        Err(PipelineError::Store(error)) if !error.is_fatal() => {
                            tracing::warn!(%error, "not everything was scanned; scanning again");
                        }
                        looked => looked?,
                    }
                    manager.status(self.at_work());
                    next_look = Instant::now() + self.pipeline.config().watch.scan_interval;
                }
            }
        }
        manager.stopping();
        Ok(())
    }

    /// Current activity of the daemon, for the service manager.
    fn at_work(&self) -> String {
        format!(
            "{} exports being read, {} wait, {} robots to conclude",
            self.exports.count(),
            self.schedule.waiting(Instant::now()).saturating_sub(self.exports.count()),
            self.stale.count() + self.concluding.len()
        )
    }

    /// Processes the results of scans and the changes that other programs have made to the database.
    async fn look(&mut self, look: &FolderLooks<'_>) -> Result<(), PipelineError> {
        self.pipeline.store().check_files()?;
        let retries = self.note_retries().await;
        self.leave_known(&look.files).await?;
        let lane_of = |path: &Path| robot_of(self.pipeline.config(), path);
        self.schedule.note(&look.files, Instant::now(), lane_of);
        // files are read also while the database is busy
        retries?;
        let is_there = |path: &Path| !vanished::is_missing(path, look);
        self.pipeline.store().unblock_vanished(is_there).await?;
        self.give_up_vanished(look).await?;
        self.left_out.note(&self.pipeline, look).await?;
        let stale = self.pipeline.store().stale_robots().await?;
        self.stale.look(&stale, self.concluded_robot.as_deref(), Instant::now());
        if look.is_whole {
            tracing::trace!(
                files = look.files.len(),
                waiting = self.schedule.waiting(Instant::now()),
                open = self.exports.count(),
                to_conclude = stale.len() + self.concluding.len(),
                "scanned the watched folders"
            );
        }
        Ok(())
    }

    /// Skips files that are seen for the first time and have not changed since their treatment was decided: a start
    /// with a hundred thousand of them needs a few hundred queries. If there is an archive, each file is processed,
    /// since it may have to be archived.
    async fn leave_known(&mut self, files: &[Sighting<'_>]) -> Result<(), PipelineError> {
        if self.pipeline.config().watch.archive.is_some() {
            return Ok(());
        }
        for some in self.schedule.unseen(files).chunks(FILES_ASKED_AT_ONCE) {
            let known = self.pipeline.known_as_they_are(some).await?;
            for path in &known {
                tracing::debug!(file = %text::of_path(path), "already known, unchanged");
                self.pipeline.metrics().export(ExportEnd::Known);
            }
            self.schedule.taken_before(known.into_iter());
        }
        Ok(())
    }

    /// Ends unfinished runs whose files are gone.
    async fn give_up_vanished(&mut self, look: &FolderLooks<'_>) -> Result<(), PipelineError> {
        let store = self.pipeline.store();
        let mut unfinished = store.unfinished_sources().await?;
        // an open file is read to its end, even if its name is gone
        unfinished.retain(|source| !self.pipeline.is_open(source.run_id));
        let settle = self.pipeline.config().watch.settle;
        for run_id in self.missing.note(&unfinished, look, settle, Instant::now()) {
            match store.give_up_run(run_id, VANISHED).await {
                Ok(_) => tracing::warn!(run_id, "{VANISHED}"),
                Err(error) if !error.is_fatal() => {
                    tracing::debug!(run_id, %error, "given up at the next scan")
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Starts to read the configuration again, for exports from then on. An invalid configuration changes nothing.
    fn reload(&mut self) {
        if self.rereading.is_some() {
            self.rereads_again = true;
            return;
        }
        let (reread, (answer, read)) = (Arc::clone(&self.reread), oneshot::channel());
        let reading = std::thread::Builder::new().name("configuration".into()).spawn(move || {
            // a daemon that stops does not wait for it
            let _ = answer.send(reread());
        });
        if let Err(error) = reading {
            tracing::error!(%error, "the configuration is not read again; the earlier one stays in force");
        }
        self.rereading = Some(Rereading { read, due: Some(Instant::now() + REREAD_WITHIN) });
    }

    /// Applies a configuration that was read again, if it is valid. Returns true if exports waited for it.
    fn reloaded(&mut self, config: Option<Config>) -> bool {
        self.rereading = None;
        if let Some(config) = config {
            tracing::info!("configuration read again");
            self.schedule.settle_in(config.watch.settle);
            self.pipeline = self.pipeline.with_config(config.into());
            self.is_reloaded = true;
        }
        if std::mem::take(&mut self.rereads_again) {
            self.reload();
        }
        self.retry()
    }

    /// Logs that the configuration is not readable; exports that wait for it continue without it. Returns true if there
    /// are any.
    fn reread_is_overdue(&mut self) -> bool {
        if let Some(reading) = &mut self.rereading {
            reading.due = None;
            tracing::error!(
                "the configuration cannot be read: no answer for {} s; the earlier one stays in force until \
                it answers; check the disk or file server of its files",
                REREAD_WITHIN.as_secs()
            );
        }
        self.retry()
    }

    /// Lets exports that a person requested be read again, with the present configuration.
    async fn note_retries(&mut self) -> Result<(), PipelineError> {
        let asked = self.pipeline.store().paths_to_retry().await?;
        let asked: HashSet<PathBuf> = asked.into_iter().collect();
        if !asked.is_subset(&self.asked) {
            self.retries.extend(asked.iter().cloned());
            self.reload();
        }
        self.asked = asked;
        Ok(())
    }

    /// Lets the exports that wait for the configuration be read again. Returns true if there are any.
    fn retry(&mut self) -> bool {
        let waits = !self.retries.is_empty();
        let (config, now) = (self.pipeline.config(), Instant::now());
        for path in self.retries.drain() {
            self.schedule.again(&path, now, |path| robot_of(config, path));
        }
        waits
    }

    /// Stores that a folder has stopped or begun to answer, for commands that query the database.
    async fn note_answer(&mut self, turned: &Turned) -> Result<(), PipelineError> {
        let folder = turned.folder.display().to_string();
        let noted = self.pipeline.store().note_folder(&folder, turned.looked_at, turned.answers).await;
        match noted {
            Err(error) if !error.is_fatal() => {
                tracing::debug!(folder, %error, "`armwatch status` cannot show if it answers");
                Ok(())
            }
            noted => Ok(noted?),
        }
    }

    /// Time of the next action that needs no event.
    fn next_event(&self) -> Option<Instant> {
        let now = Instant::now();
        let places = self.exports.next_look(&self.schedule, now);
        // while conclusions are being drawn, only their end matters
        let stale = if self.concluding.is_empty() { self.stale.next_look(now) } else { None };
        places.into_iter().chain(stale).min()
    }

    /// Takes over the robots that wait for conclusions, and those whose conclusions failed.
    fn take_over_stale(&mut self, stale: &[StaleRobot], faults: &[ConclusionFault]) {
        for fault in faults {
            tracing::warn!(robot = fault.robot, "no new conclusion for this robot: {}", fault.reason);
        }
        self.stale.take_over(stale, faults, Instant::now());
    }

    /// Starts conclusions for the robot whose turn it is.
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
                pipeline.metrics().stage(WorkStage::Conclude, began.elapsed());
            }
            (robot, concluded)
        });
    }

    /// Reports conclusions, or notes that they are still to be drawn.
    fn concluded(
        &mut self,
        (robot, result): (String, Result<Conclusion, PipelineError>),
        report: &mut impl FnMut(DaemonEvent<'_>),
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
                report(DaemonEvent::Concluded(&concluded));
            }
        }
        Ok(())
    }

    /// Notes, logs and reports the outcome of a file.
    fn close(
        &mut self,
        closed: Closed,
        report: &mut impl FnMut(DaemonEvent<'_>),
    ) -> Result<(), PipelineError> {
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
                tracing::error!(file = %text::of_path(&due.path), %error, "internal error; other exports continue");
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
            report(DaemonEvent::Export(&due.path, outcome));
        }
        Ok(())
    }
}

/// Waits for a configuration that is being read, or for ever if none is.
async fn read_again(rereading: &mut Option<Rereading>) -> Option<Config> {
    match rereading {
        // if the thread could not start or panicked, there is no configuration
        Some(reading) => (&mut reading.read).await.unwrap_or(None),
        None => std::future::pending().await,
    }
}

/// Waits until `moment`, or for ever.
async fn until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment.into()).await,
        None => std::future::pending().await,
    }
}
