//! Reads exports while they grow. They are read like settled ones, but by a reader that waits at the end of the written
//! rows.
//!
//! Anything unusual (rows that are not understood, a compressed file, an unknown robot) is left until the file has
//! settled, and is then decided on the whole file: a half-written row may look wrong and become right. Cycles stored
//! until then stay, and the run continues.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::admitted::AdmittedExport;
use super::cutting::{CutCycle, Cutting, ReadEnd};
use super::decide::Decision;
use super::intake::Recognised;
use super::{attempt, cut_file, decide, intake, new_robot, record, resume};
use crate::pipeline::context::{OnProgress, Outcome, Pipeline, PipelineError, Progress, Retry};
use crate::pipeline::{FromRejection, Lane};
use armwatch_config::FleetEntry;
use armwatch_ingest::bytes::blocks::Passed;
use armwatch_ingest::bytes::fingerprint::HashingReader;
use armwatch_ingest::bytes::parts::RecordingParts;
use armwatch_ingest::find::tail;
use armwatch_ingest::find::tail::{Fate, Growing, Growth, Tail};
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions, Step};
use armwatch_method::buffers::Buffers;
use armwatch_model::run::{ContentHash, RunKind};
use armwatch_model::text;
use armwatch_store::{AttemptKind, BlockReason, Identity, SourceState, StoreError};

/// Time between two looks at a growing file. A row waits at most a tenth of the second within which its cycle is
/// promised to be stored; ten looks per second cost a local disk almost nothing.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// The result of following a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Followed {
    /// The file is complete, or changed, or a stop was requested.
    Outcome(Outcome),
    /// Its header is not complete yet.
    NotYet,
    /// It is decided on when it has settled.
    UntilSettled,
    /// It cannot be read further, for this reason, until it is corrected or has settled; the reason is stored.
    Blocked(Rejection),
    /// It gave its place to another file; its run continues after its last stored cycle.
    GaveWay,
}

/// External causes that end the reading of a growing export.
#[derive(Debug, Clone)]
pub struct Ends {
    /// The program ends: reading ends at once.
    pub stop: CancellationToken,
    /// Another file needs the place: reading ends when all written rows are read, or after the next cycle.
    pub give_way: CancellationToken,
}

impl Pipeline {
    /// Reads an export that may still grow, cycle by cycle as its rows are written, until it is complete: see [`tail`].
    /// A file that has not changed for `settle` is complete; `ends` lists the other causes that end reading.
    ///
    /// # Errors
    /// Those of [`Pipeline::process`].
    pub async fn follow(
        &self,
        path: &Path,
        settle: Duration,
        ends: &Ends,
        progress: impl OnProgress,
    ) -> Result<Followed, PipelineError> {
        let Some(claimed) = self.claim_export(path).await? else {
            return Ok(Followed::Outcome(Outcome::InWork { run_id: None }));
        };
        let name = intake::ledger_path(&self.store, path);
        let followed = self.follow_counted((path, &name), settle, ends, progress).await;
        self.release_export(claimed).await;
        followed
    }

    /// Follows a file that no other program reads; its name in the ledger is `name`.
    async fn follow_counted(
        &self,
        (path, name): (&Path, &str),
        settle: Duration,
        ends: &Ends,
        progress: impl OnProgress,
    ) -> Result<Followed, PipelineError> {
        if self.begin_attempt(name, intake::source_state(path), &ends.stop).await?.is_spent() {
            // the count stays until the file has settled, which ends in quarantine
            return self.blocked((path, name), attempt::spent(path)).await;
        }
        let followed = self.follow_claimed((path, name), settle, ends, progress).await?;
        let outcome = match &followed {
            Followed::Outcome(outcome) => Some(outcome),
            _ => None,
        };
        self.end_attempt(name, outcome).await?;
        match followed {
            Followed::Blocked(rejection) => self.blocked((path, name), rejection).await,
            followed => Ok(followed),
        }
    }

    /// Stores that a growing file cannot be read further. The log shows it once.
    async fn blocked(
        &self,
        (path, name): (&Path, &str),
        rejection: Rejection,
    ) -> Result<Followed, PipelineError> {
        let rejection = cut_file::with_cause(self, path, None, rejection).await?;
        let source_name = intake::file_name(path);
        let robot = self.config().recognition.recognise(&source_name).ok().map(|recognised| recognised.robot);
        let block = BlockReason {
            path: name,
            robot: robot.as_deref(),
            source_name: &source_name,
            line: rejection.line,
            problem: &rejection.problem(),
            remedy: &rejection.remedy,
        };
        if self.store.block_file(block).await? {
            tracing::warn!("cannot be read further until it is corrected or has settled: {rejection}");
        }
        Ok(Followed::Blocked(rejection))
    }

    async fn follow_claimed(
        &self,
        (path, name): (&Path, &str),
        settle: Duration,
        ends: &Ends,
        progress: impl OnProgress,
    ) -> Result<Followed, PipelineError> {
        // the set of parts is known when they have settled
        if RecordingParts::of(path).is_some() {
            return Ok(Followed::UntilSettled);
        }
        let recognised = match intake::recognise(self.config(), path, intake::file_time(path)) {
            Ok(recognised) => recognised,
            // the row with the start is possibly not written yet
            Err(rejection) if rejection.is_passing => return Ok(Followed::NotYet),
            Err(rejection) => return Ok(Followed::Blocked(rejection)),
        };
        let (owned, arm) = (path.to_path_buf(), recognised.entry.clone());
        let opened = self.with_files(move || open(&owned, &arm, None)).await?;
        let opened = match opened {
            Err(rejection) => self.open_going_on(path, recognised.entry).await?.ok_or(rejection),
            opened => opened,
        };
        let opened = match opened {
            Ok(Opening::Open(opened)) => *opened,
            Ok(Opening::NotYet) => return Ok(Followed::NotYet),
            Ok(Opening::Compressed) => return Ok(Followed::UntilSettled),
            Err(rejection) => return Ok(Followed::Blocked(rejection)),
        };
        let intake = match self.begin_growing(path, &recognised, &opened).await? {
            Ok(intake) => intake,
            Err(followed) => return Ok(followed),
        };
        let open = self.open(intake.run_id);
        let followed = self.follow_begun((opened, intake), name, settle, ends, progress).await;
        open.close(&self.store).await;
        followed
    }

    /// Opens a file whose first line is not a header, if its rows continue under the header that it had before.
    async fn open_going_on(&self, path: &Path, entry: &FleetEntry) -> Result<Option<Opening>, PipelineError> {
        let Some(state) = intake::source_state(path) else { return Ok(None) };
        let Some(header) = cut_file::header_before(self, path, state, entry).await? else { return Ok(None) };
        let (owned, arm) = (path.to_path_buf(), entry.clone());
        Ok(self.with_files(move || open(&owned, &arm, Some(&header))).await?.ok())
    }

    /// Reads a growing export whose run has started.
    async fn follow_begun(
        &self,
        (opened, intake): (Opened, AdmittedExport),
        name: &str,
        settle: Duration,
        ends: &Ends,
        progress: impl OnProgress,
    ) -> Result<Followed, PipelineError> {
        let path = &*intake.path;
        progress(Progress::Begun);
        let method = match self.method(&intake, None).await? {
            Ok(method) => method,
            Err(rejection) => return Ok(Followed::Blocked(rejection)),
        };
        let stored = Arc::new(AtomicU32::new(intake.cycles_stored));
        let reading = {
            let (intake, ends, progress) = (intake.clone(), ends.clone(), progress.clone());
            let survived =
                Survived { pipeline: self.clone(), name: name.to_owned(), stored: Arc::clone(&stored) };
            move |cycles: mpsc::Sender<CutCycle>| {
                read_growing(opened, &intake, &cycles, settle, (&ends, survived), progress)
            }
        };
        let grown = {
            let (progress, run_id) = (progress.clone(), intake.run_id);
            let is_test = intake.layout.stage.kind().run_kind() == RunKind::Test;
            move |of| {
                if let Progress::Cycle(cycle) = of {
                    stored.fetch_max(cycle, Ordering::Relaxed);
                }
                progress(of);
                if is_test && matches!(of, Progress::Cycle(_)) {
                    progress(Progress::Grown(run_id));
                }
            }
        };
        // cycles stored before the program ended are possibly not evaluated yet
        if intake.cycles_stored > 0 {
            grown(Progress::Cycle(intake.cycles_stored));
        }
        // many growing files may be idle: none of them keeps memory for its next cycle
        let ((end, grown), refused) =
            match self.stream(&intake, &method, (Lane::Live, Buffers::default()), reading, grown).await {
                Err(PipelineError::Store(StoreError::Refused { detail, .. })) => {
                    return Ok(refused_by_database(path, &detail));
                }
                done => done?,
            };
        match end {
            ReadEnd::Complete(totals) => {
                let written_at = grown.map(|(_, written_at)| written_at);
                let finished = record::finish(self, &intake, &method, totals, refused, written_at).await;
                if let Err(PipelineError::Store(StoreError::Refused { detail, .. })) = &finished {
                    return Ok(refused_by_database(path, detail));
                }
                let outcome = finished?;
                if let (Some(run_id), Some((state, _))) = (outcome.run_id(), grown) {
                    self.store.remember_source(&intake.header.source_path, state, run_id).await?;
                }
                Ok(Followed::Outcome(outcome))
            }
            ReadEnd::Rejected(rejection) => Ok(Followed::Blocked(rejection)),
            ReadEnd::Interrupted if ends.stop.is_cancelled() => Ok(Followed::Outcome(Outcome::Interrupted)),
            ReadEnd::Interrupted => Ok(Followed::GaveWay),
            ReadEnd::Changed => {
                self.store.forget_resume_point(intake.run_id).await?;
                Ok(Followed::Outcome(Outcome::Changed))
            }
        }
    }

    async fn begin_growing(
        &self,
        path: &Path,
        recognised: &Recognised<'_>,
        &Opened { state, goes_on, .. }: &Opened,
    ) -> Result<Result<AdmittedExport, Followed>, PipelineError> {
        let facts = intake::facts(self, path, None, state, Some(recognised), Retry::Never).await?;
        let facts = match facts {
            Ok(facts) => facts.of_cut_file(goes_on),
            Err(rejection) => return Ok(Err(Followed::Blocked(rejection))),
        };
        intake::forget_unreadable(self, path).await?;
        let start = match decide::decide(&facts) {
            Decision::Read(start) => start,
            Decision::InWork { run_id } => {
                return Ok(Err(Followed::Outcome(Outcome::InWork { run_id: Some(run_id) })));
            }
            // the whole content is already known
            Decision::Known { .. } => return Ok(Err(Followed::UntilSettled)),
        };
        // a scan that saw it while it was written can come after its end: a complete run stays complete
        if let Some(run_id) = facts.stored_whole(state.bytes) {
            return Ok(Err(Followed::Outcome(Outcome::AlreadyStored { run_id })));
        }
        if start.continues.is_none()
            && let Some(rejection) = new_robot::question(self, path, recognised).await?
        {
            return Ok(Err(Followed::Blocked(rejection)));
        }
        // placeholder until the content is read completely
        let no_hash = ContentHash([0; 32]);
        let Recognised { entry, robot, started_at, .. } = recognised;
        let model = &entry.description.model;
        let header = intake::header(
            path,
            intake::ledger_path(&self.store, path),
            robot,
            model,
            *started_at,
            no_hash,
            state.bytes,
        );
        let identity = Identity::Growing(start.read);
        let intake = intake::begin(self, path, recognised, header, identity, start, state).await?;
        let (run_id, cycles) = (intake.run_id, intake.cycles_stored);
        tracing::info!(file = %text::of_path(path), run_id, robot, cycles, "growing");
        if goes_on {
            tracing::warn!(file = %text::of_path(path), run_id, "{}", cut_file::GOES_ON);
        }
        Ok(Ok(intake))
    }
}

/// A growing export whose header is understood.
struct Opened {
    export: ExportReader<HashingReader<Tail>>,
    growth: Growth,
    state: SourceState,
    /// True if its rows are read under a header that the file had before.
    goes_on: bool,
}

enum Opening {
    Open(Box<Opened>),
    NotYet,
    Compressed,
}

/// Opens a growing file. `before` is the header that it had before, if its own is missing.
fn open(path: &Path, entry: &FleetEntry, before: Option<&str>) -> Result<Opening, Rejection> {
    let Some(Growing { reader, growth }) = tail::open(path)? else { return Ok(Opening::Compressed) };
    let (layout, robot, options) = (&entry.layout, &entry.description, ReadOptions::default());
    let export = match before {
        None => ExportReader::of_growing(reader, path, layout, robot, options)?,
        Some(header) => ExportReader::going_on(reader, header, path, layout, robot, options)?,
    };
    let state = state_of(&growth).ok_or_else(|| {
        Rejection::of_file(path, "the file system does not report its state", "copy it to another one")
    })?;
    Ok(match export {
        Some(export) => Opening::Open(Box::new(Opened { export, growth, state, goes_on: before.is_some() })),
        None => Opening::NotYet,
    })
}

/// How reading ended, with the state of the file that was read to the end and the time of its last write.
type GrownEnd = (ReadEnd, Option<(SourceState, Timestamp)>);

impl FromRejection for GrownEnd {
    fn rejected(rejection: Rejection) -> Self {
        (ReadEnd::Rejected(rejection), None)
    }
}

fn read_growing(
    opened: Opened,
    intake: &AdmittedExport,
    cycles: &mpsc::Sender<CutCycle>,
    settle: Duration,
    ends: (&Ends, Survived),
    progress: impl Fn(Progress),
) -> GrownEnd {
    let Opened { mut export, mut growth, .. } = opened;
    let end = read(&mut export, &mut growth, intake, cycles, settle, ends, progress);
    // with the size that was read: a file that has grown since is another one
    let state = state_of(&growth).filter(|state| state.bytes == growth.hash().bytes());
    let written_at = growth.written_at().ok().and_then(|at| Timestamp::try_from(at).ok());
    (end.unwrap_or_else(ReadEnd::Rejected), state.zip(written_at))
}

fn read(
    export: &mut ExportReader<HashingReader<Tail>>,
    growth: &mut Growth,
    intake: &AdmittedExport,
    cycles: &mpsc::Sender<CutCycle>,
    settle: Duration,
    (Ends { stop, give_way }, mut survived): (&Ends, Survived),
    progress: impl Fn(Progress),
) -> Result<ReadEnd, Rejection> {
    let failed = |error: std::io::Error| Rejection::from_io(&intake.path, &error);
    match resume::pass_to_point(export, intake, stop, || ())? {
        Passed::There => {}
        Passed::Elsewhere => return Ok(ReadEnd::Changed),
        Passed::Going => return Ok(ReadEnd::Interrupted),
    }
    let mut cutting = Cutting::new(intake, cycles, stop, growth.hash().clone())?.with_header(export.header());
    // true if the last look read all written rows: rows read next were then written just now
    let mut is_up = false;
    loop {
        let (began, written) = (Instant::now(), if is_up { growth.written_at().ok() } else { None });
        let step = export.step()?;
        progress(Progress::Read(growth.hash().bytes()));
        is_up = matches!(step, Step::Waiting);
        match step {
            Step::Rows(chunk) => {
                cutting.note_read(began.elapsed(), written);
                let known = cutting.cycle_count().max(intake.cycles_stored);
                if !cutting.push(*chunk)? || (give_way.is_cancelled() && cutting.cycle_count() > known) {
                    return Ok(ReadEnd::Interrupted);
                }
            }
            Step::Waiting => match growth.look(settle, Instant::now()).map_err(failed)? {
                Fate::Growing if give_way.is_cancelled() => return Ok(ReadEnd::Interrupted),
                Fate::Growing => {
                    progress(Progress::CaughtUp);
                    survived.note(cutting.cycle_count());
                    pause(stop);
                }
                Fate::Done => {}
                Fate::Rewritten => match shortened_to(growth) {
                    // like a deleted file: the rows read so far are the recording
                    Some(bytes) if cutting.cycle_count() > 0 => {
                        tracing::warn!(
                            file = %intake.path.display(), run_id = intake.run_id,
                            "the file was shortened from {} to {bytes} bytes while it was read: its run \
                            ends here, and later rows are another recording",
                            growth.hash().bytes()
                        );
                        return cutting.end(export);
                    }
                    _ => return Ok(ReadEnd::Changed),
                },
            },
            Step::End => break,
        }
        if stop.is_cancelled() || cycles.is_closed() {
            return Ok(ReadEnd::Interrupted);
        }
    }
    if !growth.is_as_read().map_err(failed)? {
        return Ok(ReadEnd::Changed);
    }
    cutting.end(export)
}

/// The size of a file that is shorter than the part that was read, bytes.
fn shortened_to(growth: &Growth) -> Option<u64> {
    let (_, bytes, _) = growth.state().ok()?;
    (bytes < growth.hash().bytes()).then_some(bytes)
}

/// Ends the attempt at a growing file once all written rows are read and stored, so that a file that is written for
/// days is not a suspect all the time. If rows written later crash the program, counting starts again with the next
/// start.
struct Survived {
    pipeline: Pipeline,
    name: String,
    /// Stored cycles.
    stored: Arc<AtomicU32>,
}

impl Survived {
    /// Notes that all written rows were read; they make `cycles` whole cycles.
    fn note(&mut self, cycles: u32) {
        if self.name.is_empty() || self.stored.load(Ordering::Relaxed) < cycles {
            return;
        }
        let name = std::mem::take(&mut self.name);
        let store = self.pipeline.store();
        let ended = Handle::current().block_on(async {
            store.end_attempt(AttemptKind::Export, &name).await?;
            store.unblock_file(&name).await
        });
        if let Err(error) = ended {
            tracing::debug!(%error, "noted at the next look that a file is read as far as it is written");
            self.name = name;
        }
    }
}

/// Waits until the next look; a requested stop ends the wait.
fn pause(stop: &CancellationToken) {
    // continue in either case
    let _ = Handle::current().block_on(tokio::time::timeout(LOOK_INTERVAL, stop.cancelled()));
}

fn state_of(growth: &Growth) -> Option<SourceState> {
    let (file, bytes, modified) = growth.state().ok()?;
    Some(SourceState { bytes, modified: Timestamp::try_from(modified).ok()?, file })
}

/// The file is read again as a whole when it has settled, and is quarantined if the database still refuses it.
fn refused_by_database(path: &Path, detail: &str) -> Followed {
    let reason = format!("results that the database refuses: {detail}");
    Followed::Blocked(Rejection::of_file(path, reason, "report it with this file"))
}
