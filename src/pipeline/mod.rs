//! The single path of data: ingest, segment, identify, friction, verify, store, detect.
//!
//! An export passes three stages that run at once: a reading thread that cuts cycles, analysis on blocking threads, and
//! recording in the order of the cycles. The daemon, which processes several exports at once, and the one-shot command
//! use the same path, for files that have settled ([`take::intake`]) and files that grow ([`take::follow`]). A cycle is
//! complete when the transaction that stores its rows commits; after an interruption, reading continues after the last
//! stored cycle ([`take::resume`]).

pub mod take;
pub mod conclude;
pub mod stored;
pub mod look;
mod cycle_memory;
pub mod context;
pub mod friction;
mod production;
mod streaming;
pub mod ahead;
pub mod reweight;
pub mod retention;
#[cfg(test)]
mod tests;

use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use ahead::ReadAhead;
use context::{Lane, OnProgress, OpenRun, Outcome, Pipeline, PipelineError, Progress, Retry};
use cycle_memory::CycleMemory;
use jiff::Timestamp;
use streaming::{Streaming, analysis_threads};
use take::admitted::AdmittedExport;
use take::cutting::{CutCycle, ReadEnd};
use take::intake::Admission;
use tokio::sync::{Semaphore, mpsc};
use tokio::task::JoinError;
use tokio_util::sync::CancellationToken;

use crate::metrics::Metrics;
use armwatch_config::Config;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_ingest::find::watch::FoundFile;
use armwatch_ingest::rejection::Rejection;
use armwatch_method::analyse::Method;
use armwatch_method::buffers::Buffers;
use armwatch_method::spare_threads::SpareThreads;
use armwatch_model::robot::Robot;
use armwatch_model::text;
use armwatch_store::{SourceState, Store, StoreError};

impl Pipeline {
    /// Creates a pipeline into `store`.
    pub fn new(config: Arc<Config>, store: Store) -> Self {
        let places = [(); 2].map(|()| Arc::new(Semaphore::new(analysis_threads())));
        let memory = CycleMemory::new(config.limits.cycles_bytes);
        Self {
            config,
            store,
            methods: Arc::default(),
            places,
            concluding: Arc::default(),
            open: Arc::default(),
            memory,
            usual: Arc::default(),
            metrics: Metrics::default(),
            access: FileAccess::default(),
        }
    }

    /// The same pipeline, with `access` for opening files.
    pub fn opening(&self, access: &FileAccess) -> Self {
        Self { access: access.clone(), ..self.clone() }
    }

    /// Runs work with files on a thread for blocking work.
    ///
    /// # Errors
    /// A panic of the work.
    pub(in crate::pipeline) async fn with_files<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, JoinError> {
        let access = self.access.clone();
        tokio::task::spawn_blocking(move || access.during(work)).await
    }

    /// The same pipeline, counting its work in `metrics`.
    #[must_use]
    pub fn counting(self, metrics: Metrics) -> Self {
        Self { metrics, ..self }
    }

    /// The metrics of the pipeline.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The same pipeline with another configuration, for exports from now on.
    pub fn with_config(&self, config: Arc<Config>) -> Self {
        // structure analyses contain the settings of `[analysis]`
        let methods = match config.analysis == self.config.analysis {
            true => Arc::clone(&self.methods),
            false => Arc::default(),
        };
        let memory = self.memory.up_to(config.limits.cycles_bytes);
        Self { config, methods, memory, ..self.clone() }
    }

    /// The configuration that the pipeline follows.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The same configuration, shared.
    pub fn shared_config(&self) -> Arc<Config> {
        Arc::clone(&self.config)
    }

    /// The database that the pipeline fills.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// Closes the database. Committed data is safe without it, but the write-ahead log is left.
    ///
    /// # Errors
    /// Those of the last checkpoint.
    pub async fn close(self) -> Result<(), StoreError> {
        self.store.close().await
    }

    /// Processes one export from the file to stored results.
    ///
    /// # Errors
    /// [`PipelineError`] if other files would fail too, or the database was busy.
    pub async fn process(
        &self,
        path: &Path,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        self.process_reading(path, AheadReading::NotBegun, retry, stop, progress).await
    }

    /// Like [`process`](Self::process), for an export that may be read ahead.
    ///
    /// # Errors
    /// Those of [`process`](Self::process).
    pub async fn process_ahead(
        &self,
        path: &Path,
        ahead: Option<ReadAhead>,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        self.process_reading(path, AheadReading::Begun(ahead), retry, stop, progress).await
    }

    async fn process_reading(
        &self,
        path: &Path,
        reading: AheadReading,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        let name = take::intake::ledger_path(&self.store, path);
        let state = take::intake::source_state(path);
        let known = self.known_outcome(path, &name, (retry, state)).await?;
        if let Some(outcome) = known {
            return Ok(outcome);
        }
        let Some(claimed) = self.claim_export(path).await? else {
            return Ok(Outcome::InWork { run_id: None });
        };
        let taken = match claimed.is_shared() {
            // another daemon may have read it in the meantime
            true => self.known_outcome(path, &name, (retry, state)).await,
            false => Ok(None),
        };
        let taken = match taken {
            Ok(Some(outcome)) => Ok(outcome),
            Ok(None) => self.take_and_remember(path, (&name, state), reading, retry, stop, progress).await,
            Err(error) => Err(error),
        };
        self.release_export(claimed).await;
        taken
    }

    /// The known outcome of a file that has not changed since its treatment was decided.
    async fn known_outcome(
        &self,
        path: &Path,
        name: &str,
        (retry, state): (Retry, Option<SourceState>),
    ) -> Result<Option<Outcome>, PipelineError> {
        let (Retry::Never, Some(state)) = (retry, state) else { return Ok(None) };
        let known = self.store.known_source(name, state).await?;
        let decided = known.filter(|known| take::decide::is_decided(known, retry));
        Ok(decided.map(|known| take::intake::decided(path, known)))
    }

    async fn take_and_remember(
        &self,
        path: &Path,
        (name, state): (&str, Option<SourceState>),
        reading: AheadReading,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        let is_spent = match &reading {
            // counted before it was read ahead
            AheadReading::Begun(Some(_)) => false,
            AheadReading::NotBegun | AheadReading::Begun(None) => {
                self.begin_attempt(name, state, stop).await?.is_spent()
            }
        };
        let outcome = if is_spent {
            self.quarantine_unread(path, name, state).await?
        } else {
            let ahead = match reading {
                AheadReading::NotBegun => self.read_ahead(path, retry, stop).await?,
                AheadReading::Begun(ahead) => ahead,
            };
            self.take(path, ahead, retry, stop, progress).await?
        };
        match (outcome.run_id(), state) {
            (Some(run_id), Some(state)) => self.store.remember_source(name, state, run_id).await?,
            _ => self.end_attempt(name, Some(&outcome)).await?,
        }
        Ok(outcome)
    }

    /// Selects the files that have not changed since their treatment was decided; [`process`](Self::process) would only
    /// repeat their outcome.
    pub async fn known_as_they_are(&self, files: &[&FoundFile]) -> Result<Vec<PathBuf>, PipelineError> {
        let names: Vec<String> =
            files.iter().map(|file| take::intake::ledger_path(&self.store, &file.path)).collect();
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
        ahead: Option<ReadAhead>,
        retry: Retry,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        let ahead = match ahead {
            Some(ahead) => match self.take_unhashed(path, ahead, retry, progress.clone()).await? {
                Ok(outcome) => return Ok(outcome),
                Err(ahead) => ahead,
            },
            None => None,
        };
        let hashed = ahead.as_ref().and_then(|ahead| ahead.hashed(path));
        let intake = match take::intake::admit(self, path, retry, hashed).await? {
            Admission::Read(intake) => *intake,
            Admission::Decided(outcome) => return Ok(outcome),
        };
        let open = self.open(intake.run_id);
        progress(Progress::Begun);
        let taken = self.take_begun_export(path, &intake, ahead, stop, progress).await;
        open.close(&self.store).await;
        taken
    }

    /// Processes an export whose run has started. If its results cannot be stored, that is a fault of this export
    /// alone.
    async fn take_begun_export(
        &self,
        path: &Path,
        intake: &AdmittedExport,
        ahead: Option<ReadAhead>,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        let reason = match self.take_admitted(intake, ahead, stop, progress).await {
            Err(PipelineError::Store(StoreError::Refused { detail, .. })) => {
                format!("results that the database refuses: {detail}")
            }
            // other exports continue
            Err(PipelineError::Task(error)) => conclude::isolation::panic_reason(error)?,
            done => return done,
        };
        tracing::error!(file = %text::of_path(path), run_id = intake.run_id, "{reason}");
        let remedy = format!(
            "`armwatch quarantine retry {}` reads the file from its start again; if it fails again, report \
            it with this file",
            intake.run_id
        );
        take::record::quarantine(self, intake, Rejection::of_file(path, reason, remedy)).await
    }

    async fn take_admitted(
        &self,
        intake: &AdmittedExport,
        ahead: Option<ReadAhead>,
        stop: &CancellationToken,
        progress: impl OnProgress,
    ) -> Result<Outcome, PipelineError> {
        let ahead = ahead.filter(|ahead| ahead.is_of(intake));
        let made = ahead.as_ref().map(|ahead| Arc::clone(&ahead.method));
        let method = match self.method(intake, made).await? {
            Ok(method) => method,
            Err(rejection) => return take::record::quarantine(self, intake, rejection).await,
        };
        let (end, refused) = match ahead {
            Some(ahead) => match self.record_ahead(intake, &method, ahead, progress).await? {
                (ReadEnd::Complete(totals), refused) if totals.content.hash != intake.header.content_hash => {
                    (ReadEnd::Changed, refused)
                }
                recorded => recorded,
            },
            None => {
                let buffers = Buffers::going_round();
                let reading = {
                    let (intake, stop, progress) = (intake.clone(), stop.clone(), progress.clone());
                    let buffers = buffers.clone();
                    move |cycles: mpsc::Sender<CutCycle>| {
                        let read = |bytes| progress(Progress::Read(bytes));
                        take::intake::read_cycles(&intake, &cycles, &stop, read, buffers)
                    }
                };
                self.stream(intake, &method, (Lane::Backlog, buffers), reading, progress).await?
            }
        };
        match end {
            ReadEnd::Complete(totals) => {
                // a name without start got the file's last write time
                let written_at = Some(intake.header.started_at);
                take::record::finish(self, intake, &method, totals, refused, written_at).await
            }
            ReadEnd::Rejected(rejection) if rejection.is_passing => Ok(Outcome::Unreadable { rejection }),
            ReadEnd::Rejected(rejection) => take::record::quarantine(self, intake, rejection).await,
            ReadEnd::Interrupted => Ok(Outcome::Interrupted),
            // its stored cycles are compared with the file when it is processed again
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
        (lane, buffers): (Lane, Buffers),
        read: impl FnOnce(mpsc::Sender<CutCycle>) -> E + Send + 'static,
        progress: impl Fn(Progress),
    ) -> Result<(E, Vec<(u32, String)>), PipelineError> {
        let work = production::work(self, intake, method).await?;
        let places = Arc::clone(&self.places[lane as usize]);
        let access = self.access.clone();
        let read = move |cycles| access.during(|| read(cycles));
        let streaming = Streaming::start(work, places, self.metrics.clone(), buffers, read);
        self.record(intake, streaming, |n| progress(Progress::Cycle(n))).await
    }

    /// Like [`stream`](Self::stream), for an export that is being read already.
    async fn record_ahead(
        &self,
        intake: &AdmittedExport,
        method: &Arc<Method>,
        ahead: ReadAhead,
        progress: impl Fn(Progress),
    ) -> Result<(ReadEnd, Vec<(u32, String)>), PipelineError> {
        // stores the kind of recording; its cycles are already in analysis
        production::work(self, intake, method).await?;
        let ReadAhead { streaming, bytes, turn, stop: _until_recorded, .. } = ahead;
        turn.comes();
        let stored = |cycle| {
            progress(Progress::Read(bytes.load(Ordering::Relaxed)));
            progress(Progress::Cycle(cycle));
        };
        self.record(intake, streaming, stored).await
    }

    /// Records the cycles of an export that is read and analysed.
    async fn record<E: FromRejection>(
        &self,
        intake: &AdmittedExport,
        streaming: Streaming<E>,
        stored: impl Fn(u32),
    ) -> Result<(E, Vec<(u32, String)>), PipelineError> {
        let (analyses, tasks) = streaming.into_parts();
        // a recorder that ended early has dropped its end of the channel, so both tasks end too
        let recorded = take::record::cycles(self, intake, analyses, stored).await?;
        let end = tasks.ended().await?;
        Ok((recorded.rejection.map_or(end, E::rejected), recorded.refused))
    }

    /// The structure analysis of the export's robot; `made` if it exists already.
    async fn method(
        &self,
        intake: &AdmittedExport,
        made: Option<Arc<Method>>,
    ) -> Result<Result<Arc<Method>, Rejection>, PipelineError> {
        if let Some(method) = self.known_method(&intake.robot) {
            return Ok(Ok(method));
        }
        let (robot, settings) = (Robot::clone(&intake.robot), self.config.analysis);
        let made = match made {
            Some(made) => Ok(made),
            None => {
                let made = tokio::task::spawn_blocking(move || Method::new(robot, settings));
                made.await?.map(Arc::new)
            }
        };
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
                let mut methods = self.methods.lock().unwrap_or_else(PoisonError::into_inner);
                methods.push(Arc::clone(&method));
                Ok(Ok(method))
            }
        }
    }

    /// Threads that no analysis of a settled export uses.
    fn spare_threads(&self) -> SpareThreads {
        streaming::spare_threads(&self.places[Lane::Backlog as usize])
    }

    /// Marks a run as being read.
    fn open(&self, run_id: i64) -> OpenRun {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).insert(run_id);
        OpenRun(Arc::clone(&self.open), run_id)
    }

    /// Returns true if an export of the run is being read.
    pub fn is_open(&self, run_id: i64) -> bool {
        self.open.lock().unwrap_or_else(PoisonError::into_inner).contains(&run_id)
    }

    fn known_method(&self, robot: &Robot) -> Option<Arc<Method>> {
        let methods = self.methods.lock().unwrap_or_else(PoisonError::into_inner);
        methods.iter().find(|method| method.robot == *robot).cloned()
    }
}

/// State of reading ahead when it is an export's turn.
enum AheadReading {
    /// Not yet: it is read ahead now.
    NotBegun,
    /// It was processed before its turn.
    Begun(Option<ReadAhead>),
}

/// An end of reading that an analysis may have caused.
trait FromRejection: Send + 'static {
    /// The end at a rejection.
    fn rejected(rejection: Rejection) -> Self;
}

impl FromRejection for ReadEnd {
    fn rejected(rejection: Rejection) -> Self {
        Self::Rejected(rejection)
    }
}
