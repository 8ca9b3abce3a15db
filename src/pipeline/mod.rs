//! The one way data flows: ingest, segment, identify, friction, verify, store, detect.
//!
//! An export goes through three stages that run at once: a reading thread that cuts cycles, analysis on
//! blocking threads, and recording in the order of the cycles. The daemon, which takes several exports
//! at once, and the one-shot command use the same path, for files that have settled ([`take::intake`]) and
//! files that grow ([`take::follow`]). A cycle is done when the transaction that stores its rows commits;
//! whatever was cut short is read again from behind the last stored cycle ([`take::resume`]).

pub mod take;
pub mod conclude;
pub mod stored;
pub mod look;
pub mod context;
mod friction;
mod production;
pub mod reweight;
pub mod retention;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError};
use std::time::Instant;

use jiff::Timestamp;
use tokio::sync::{Semaphore, mpsc};
use tokio_util::sync::CancellationToken;

use crate::config::Config;
use crate::ingest::bytes::source;
use crate::ingest::find::watch::FoundFile;
use crate::ingest::rejection::Rejection;
use crate::metrics::{Metrics, Stage};
use crate::numerics::analyse::Method;
use crate::robot::Robot;
use crate::store::{Store, StoreError};
use context::{InAnalysis, Lane, OpenRun, Outcome, Pipeline, PipelineError, Progress, Retry};
use production::CycleWork;
use take::admitted::AdmittedExport;
use take::cutting::{CutCycle, ReadEnd};
use take::intake::Admission;

/// Cycles between the reading thread and analysis. One is enough to keep both busy; each takes
/// 12 MB at 250 Hz and five minutes.
const CYCLES_READ_AHEAD: usize = 1;

/// Cycles under analysis at once in each lane, whatever the number of exports: the two cores that the
/// program is made for.
const CYCLES_IN_ANALYSIS: usize = 2;

impl Pipeline {
    /// A pipeline into `store`.
    #[must_use]
    pub fn new(config: Arc<Config>, store: Store) -> Self {
        let places = [(); 2].map(|()| Arc::new(Semaphore::new(CYCLES_IN_ANALYSIS)));
        Self {
            config,
            store,
            methods: Arc::default(),
            places,
            concluding: Arc::default(),
            open: Arc::default(),
            usual: Arc::default(),
            metrics: Metrics::default(),
        }
    }

    /// The same pipeline, which counts its work in `metrics`.
    #[must_use]
    pub fn counting(self, metrics: Metrics) -> Self {
        Self { metrics, ..self }
    }

    /// Where the pipeline counts its work.
    #[must_use]
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The same pipeline under another configuration, for exports that are taken from now on.
    #[must_use]
    pub fn with_config(&self, config: Arc<Config>) -> Self {
        // structure analyses hold the settings of `[analysis]`
        let methods = match config.analysis == self.config.analysis {
            true => Arc::clone(&self.methods),
            false => Arc::default(),
        };
        Self { config, methods, ..self.clone() }
    }

    /// The configuration that the pipeline follows.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The database that the pipeline fills.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Closes the database; what is committed is safe without it, but its log stays behind.
    ///
    /// # Errors
    /// Those of the last checkpoint.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }

    /// Takes one export from disk to stored results.
    ///
    /// # Errors
    /// [`PipelineError`] where going on with other files makes no sense, or the database was busy.
    pub async fn process(
        &self,
        path: &Path,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl Fn(Progress) + Send + Sync + Clone + 'static,
    ) -> Result<Outcome, PipelineError> {
        let name = source::path_text(path);
        let state = take::intake::source_state(path);
        if let (Retry::Never, Some(state)) = (retry, state)
            && let Some(known) = self.store.known_source(&name, state).await?
            && take::decide::is_decided(&known, retry)
        {
            return Ok(take::intake::decided(path, known));
        }
        let outcome = self.take(path, retry, stop, progress).await?;
        if let (Some(run_id), Some(state)) = (outcome.run_id(), state) {
            self.store.remember_source(&name, state, run_id).await?;
        }
        Ok(outcome)
    }

    /// Those of `files` whose fate was decided when they were as they lie there now, which [`process`](Self::process)
    /// would only say again.
    ///
    /// # Errors
    /// Those of the store.
    pub async fn known_as_they_are(&self, files: &[&FoundFile]) -> Result<Vec<PathBuf>, PipelineError> {
        let names: Vec<String> = files.iter().map(|file| source::path_text(&file.path)).collect();
        let known = self.store.known_sources(&names).await?;
        let is_known = |(file, name): &(&&FoundFile, &String)| {
            known.get(*name).is_some_and(|(bytes, modified, run)| {
                *bytes == file.size
                    && Timestamp::try_from(file.modified).is_ok_and(|seen| seen.as_microsecond() == *modified)
                    && take::decide::is_decided(run, Retry::Never)
            })
        };
        Ok(files.iter().zip(&names).filter(is_known).map(|(file, _)| file.path.clone()).collect())
    }

    async fn take(
        &self,
        path: &Path,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl Fn(Progress) + Send + Sync + Clone + 'static,
    ) -> Result<Outcome, PipelineError> {
        let intake = match take::intake::admit(self, path, retry).await? {
            Admission::Read(intake) => *intake,
            Admission::Decided(outcome) => return Ok(outcome),
        };
        let _open = self.open(intake.run_id);
        progress(Progress::Begun);
        let reason = match self.take_admitted(&intake, stop, progress).await {
            Err(PipelineError::Store(StoreError::Refused { detail, .. })) => {
                format!("results that the database refuses: {detail}")
            }
            // other exports go on
            Err(PipelineError::Task(error)) => conclude::isolation::panic_reason(error)?,
            done => return done,
        };
        tracing::error!(file = %path.display(), run_id = intake.run_id, "{reason}");
        let remedy = format!(
            "`armwatch quarantine retry {}` reads the file anew from its start; if that ends alike, report it with this \
             file",
            intake.run_id
        );
        take::record::quarantine(self, &intake, Rejection::of_file(path, reason, remedy)).await
    }

    async fn take_admitted(
        &self,
        intake: &AdmittedExport,
        stop: &CancellationToken,
        progress: impl Fn(Progress) + Send + Sync + Clone + 'static,
    ) -> Result<Outcome, PipelineError> {
        let method = match self.method(intake).await? {
            Ok(method) => method,
            Err(rejection) => return take::record::quarantine(self, intake, rejection).await,
        };
        let reading = {
            let (intake, stop, progress) = (intake.clone(), stop.clone(), progress.clone());
            move |cycles: mpsc::Sender<CutCycle>| {
                take::intake::read_cycles(&intake, &cycles, &stop, |bytes| progress(Progress::Read(bytes)))
            }
        };
        let (end, refused) = self.stream(intake, &method, Lane::Backlog, reading, progress).await?;
        match end {
            ReadEnd::Complete(totals) => {
                // a name without start was given the time at which the file was last written
                let written_at = Some(intake.header.started_at);
                take::record::finish(self, intake, &method, totals, refused, written_at).await
            }
            ReadEnd::Rejected(rejection) if rejection.is_passing => Ok(Outcome::Unreadable { rejection }),
            ReadEnd::Rejected(rejection) => take::record::quarantine(self, intake, rejection).await,
            ReadEnd::Interrupted => Ok(Outcome::Interrupted),
            // its stored cycles are compared with the file when it is looked at again
            ReadEnd::Changed => {
                self.store.forget_resume_point(intake.run_id).await?;
                Ok(Outcome::Changed)
            }
        }
    }

    /// Reads, analyses and records the cycles of an export; `read` runs on a blocking thread. Returns how
    /// reading ended and the cycles without parameters.
    async fn stream<E: FromRejection>(
        &self,
        intake: &AdmittedExport,
        method: &Arc<Method>,
        lane: Lane,
        read: impl FnOnce(mpsc::Sender<CutCycle>) -> E + Send + 'static,
        progress: impl Fn(Progress),
    ) -> Result<(E, Vec<(u32, String)>), PipelineError> {
        let work = production::work(self, intake, method).await?;
        let (to_analysis, cycles) = mpsc::channel::<CutCycle>(CYCLES_READ_AHEAD);
        // the task being awaited and those in the channel are the cycles in analysis
        let (to_record, analyses) = mpsc::channel::<InAnalysis>(CYCLES_IN_ANALYSIS - 1);

        let reader = tokio::task::spawn_blocking(move || read(to_analysis));
        let places = Arc::clone(&self.places[lane as usize]);
        let analyser = tokio::spawn(analyse_in_order(work, places, cycles, to_record, self.metrics.clone()));
        let recorded = take::record::cycles(self, intake, analyses, |n| progress(Progress::Cycle(n))).await;
        // a recorder that ended early has dropped its end of the channel, so both others end too
        let recorded = recorded?;
        analyser.await?;
        let end = reader.await?;
        Ok((recorded.rejection.map_or(end, E::rejected), recorded.refused))
    }

    /// The structure analysis of the export's robot.
    async fn method(&self, intake: &AdmittedExport) -> Result<Result<Arc<Method>, Rejection>, PipelineError> {
        if let Some(method) = self.known_method(&intake.robot) {
            return Ok(Ok(method));
        }
        let (robot, settings) = (Robot::clone(&intake.robot), self.config.analysis);
        let made = tokio::task::spawn_blocking(move || Method::new(robot, settings)).await?;
        match made {
            Err(error) => Ok(Err(Rejection::of_file(
                &intake.path,
                format!("the description of {} has no base parameters: {error}", intake.robot.model),
                "check it with `armwatch robot check`",
            ))),
            Ok(method) => {
                let formulas =
                    method.base.kept.iter().enumerate().map(|(k, id)| (*id, method.base.grouping_formula(k)));
                self.store.describe_model(&method.robot, &formulas.collect::<Vec<_>>()).await?;
                let method = Arc::new(method);
                let mut methods = self.methods.lock().unwrap_or_else(PoisonError::into_inner);
                methods.push(Arc::clone(&method));
                Ok(Ok(method))
            }
        }
    }

    /// Counts a run among those being read.
    fn open(&self, run_id: i64) -> OpenRun {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).insert(run_id);
        OpenRun(Arc::clone(&self.open), run_id)
    }

    /// Whether an export of the run is being read.
    #[must_use]
    pub fn is_open(&self, run_id: i64) -> bool {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).contains(&run_id)
    }

    fn known_method(&self, robot: &Robot) -> Option<Arc<Method>> {
        let methods = self.methods.lock().unwrap_or_else(PoisonError::into_inner);
        methods.iter().find(|method| method.robot == *robot).cloned()
    }
}

/// An end of reading that an analysis may have cut short.
trait FromRejection: Send + 'static {
    /// The end at a rejection.
    fn rejected(rejection: Rejection) -> Self;
}

impl FromRejection for ReadEnd {
    fn rejected(rejection: Rejection) -> Self {
        Self::Rejected(rejection)
    }
}

/// Starts analyses as cycles arrive and hands on their handles in the order of the cycles.
async fn analyse_in_order(
    work: CycleWork,
    places: Arc<Semaphore>,
    mut cycles: mpsc::Receiver<CutCycle>,
    to_record: mpsc::Sender<InAnalysis>,
    metrics: Metrics,
) {
    let mut bytes = 0;
    // a cycle is not taken over before it is its turn: those that wait fill the memory
    while let Ok(turn) = to_record.reserve().await {
        let Some(CutCycle { cycle, read, took, written }) = cycles.recv().await else { return };
        metrics.stage(Stage::Read, took);
        let until = read.prefix.bytes;
        metrics.cycle_read(cycle.samples.rows(), until.saturating_sub(bytes));
        bytes = until;
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { return };
        let (work, metrics) = (work.clone(), metrics.clone());
        let analysis = tokio::task::spawn_blocking(move || {
            let began = Instant::now();
            let analysis = work.analyse(&cycle);
            metrics.stage(Stage::Analyse, began.elapsed());
            drop(place);
            analysis
        });
        turn.send(InAnalysis { analysis, read, written });
    }
}
