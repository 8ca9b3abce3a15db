//! From a path to cycles: recognition, ledger check, reading.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::cutting::{CutCycle, Cutting, ReadEnd};
use super::{Outcome, Pipeline, PipelineError, Retry};
use crate::config::{FleetEntry, Layout, RewritePolicy};
use crate::ingest::csv::{ExportReader, ReadOptions};
use crate::ingest::fingerprint::{self, fingerprint};
use crate::ingest::rejection::Rejection;
use crate::ingest::source;
use crate::robot::Robot;
use crate::run::{ContentHash, ContentPrefix, FileId, RunHeader, RunStatus};
use crate::store::{Beginning, EarlierRun, Identity, KnownRun, SourceState};

/// Robot name of an export that names none.
const UNKNOWN_ROBOT: &str = "unknown";

/// An export that was let in.
#[derive(Debug, Clone)]
pub struct Intake {
    /// Where it lies.
    pub path: PathBuf,
    /// Its row in the ledger.
    pub run_id: i64,
    /// What is known of it.
    pub header: RunHeader,
    /// The arm that made it.
    pub robot: Arc<Robot>,
    /// Its layout.
    pub layout: Arc<Layout>,
    /// Cycles stored by an earlier attempt.
    pub cycles_stored: u32,
}

/// Whether an export needs reading.
#[derive(Debug)]
pub enum Known {
    /// It needs reading.
    No(Box<Intake>),
    /// Its fate is decided.
    Yes(Outcome),
}

/// Looks an export up by its content and lets it in if it is new, or was left unfinished.
///
/// # Errors
/// Those of the store. A file that cannot be read is quarantined; one that vanished is
/// [`Outcome::Changed`].
pub async fn admit(pipeline: &Pipeline, path: &Path, retry: Retry) -> Result<Known, PipelineError> {
    let owned = path.to_path_buf();
    let read = tokio::task::spawn_blocking(move || (fingerprint(&owned), file_time(&owned))).await?;
    let ((content_hash, source_bytes), file_time) = match read {
        (Ok(identity), file_time) => (identity, file_time),
        (Err(error), _) if error.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Known::Yes(Outcome::Changed));
        }
        (Err(error), file_time) => {
            let rejection =
                Rejection::of_file(path, format!("cannot be read: {error}"), "check its permissions");
            let header = header(path, UNKNOWN_ROBOT, "", file_time, path_identity(path), 0);
            return Ok(Known::Yes(quarantined(pipeline, &header, rejection).await?));
        }
    };
    let Some(state) = source_state(path) else { return Ok(Known::Yes(Outcome::Changed)) };
    let known = pipeline.store().lookup(&content_hash).await?;
    let start = start(pipeline, path, state.file).await?;
    // a content that was superseded at this path has come back to it
    let returns =
        |known: &KnownRun| known.status == RunStatus::Superseded && start.beginning.instead_of.is_some();
    if let Some(known) = &known
        && !returns(known)
    {
        if let Some(outcome) = decided(path, known.clone(), retry) {
            leave(pipeline, known.run_id, &start).await?;
            return Ok(Known::Yes(outcome));
        }
        if pipeline.is_open(known.run_id) {
            return Ok(Known::Yes(Outcome::InWork { run_id: known.run_id }));
        }
    }
    let (entry, robot, started_at) = match recognise(pipeline, path, file_time) {
        Ok(recognised) => recognised,
        Err(rejection) => {
            let header = header(path, UNKNOWN_ROBOT, "", file_time, content_hash, source_bytes);
            return Ok(Known::Yes(quarantined(pipeline, &header, rejection).await?));
        }
    };
    let description = Arc::clone(&entry.description);
    let header = header(path, &robot, &description.model, started_at, content_hash, source_bytes);
    let onwards = known.map_or(start.beginning.onwards, |known| Some(known.run_id));
    let instead_of = start.beginning.instead_of.filter(|old| Some(*old) != onwards);
    let beginning = Beginning { onwards, instead_of };
    let begun =
        pipeline.store().begin_source(&header, Identity::Content(content_hash), beginning, state).await?;
    Ok(Known::No(Box::new(Intake {
        path: path.to_path_buf(),
        run_id: begun.run_id,
        header,
        robot: description,
        layout: Arc::clone(&entry.layout),
        cycles_stored: begun.cycles_stored,
    })))
}

/// How the run of a file begins, and from which of its first bytes its stored cycles are.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// The beginning.
    pub beginning: Beginning,
    /// What is stored already was read from these bytes.
    pub read: ContentPrefix,
    /// An unfinished run that lay at this path, whatever the file holds now.
    unfinished: Option<i64>,
    /// Whether that run's cycles come from this file's first bytes.
    unfinished_is_prefix: bool,
}

/// Finds out how the run of the file at `path` begins: its first bytes are compared with what runs were
/// read from that lay at this path, or in this file.
///
/// # Errors
/// Those of the store.
pub async fn start(pipeline: &Pipeline, path: &Path, file: FileId) -> Result<Start, PipelineError> {
    let earlier = pipeline.store().earlier_runs(&path.display().to_string(), file).await?;
    let owned = path.to_path_buf();
    let compared = tokio::task::spawn_blocking(move || {
        let begins_with = |run: &EarlierRun| matches!(fingerprint::prefix(&owned, run.read.bytes), Ok(Some(prefix)) if prefix == run.read);
        earlier.into_iter().map(|run| (begins_with(&run), run)).collect::<Vec<_>>()
    });
    let policy = pipeline.config().watch.on_rewrite;
    Ok(chosen(&compared.await?, policy))
}

/// Chooses among runs, each with whether the file begins with what it was read from.
fn chosen(earlier: &[(bool, EarlierRun)], policy: RewritePolicy) -> Start {
    let mut start = Start {
        beginning: Beginning::default(),
        read: fingerprint::nothing(),
        unfinished: None,
        unfinished_is_prefix: false,
    };
    for (is_prefix, EarlierRun { run, read, same_path }) in earlier {
        let (unfinished, complete) = (run.status == RunStatus::Streaming, run.status == RunStatus::Complete);
        // nothing is stored of it that could be wrong
        let empty = *same_path && unfinished && run.cycles_stored == 0;
        let goes_on = unfinished || complete || (*same_path && run.status == RunStatus::Quarantined);
        if *same_path && unfinished {
            (start.unfinished, start.unfinished_is_prefix) = (Some(run.run_id), *is_prefix || empty);
        }
        if start.beginning.onwards.is_none() && goes_on && (*is_prefix || empty) {
            start.beginning.onwards = Some(run.run_id);
            start.read = if *is_prefix && run.cycles_stored > 0 { *read } else { fingerprint::nothing() };
        } else if *same_path && (unfinished || (complete && policy == RewritePolicy::Supersede)) {
            start.beginning.instead_of = Some(run.run_id);
        }
    }
    start
}

/// Leaves a file whose content is stored as `run_id`: an unfinished run that was read from this path goes,
/// or stands as superseded where the file was rewritten.
async fn leave(pipeline: &Pipeline, run_id: i64, start: &Start) -> Result<(), PipelineError> {
    match start.unfinished.filter(|unfinished| *unfinished != run_id) {
        Some(unfinished) if start.unfinished_is_prefix => {
            pipeline.store().discard_run(unfinished).await?;
        }
        Some(unfinished) => pipeline.store().supersede_run(run_id, unfinished).await?,
        None => {}
    }
    Ok(())
}

/// What is said of an export that the ledger knows, unless it needs reading.
#[must_use]
pub fn decided(path: &Path, known: KnownRun, retry: Retry) -> Option<Outcome> {
    match known.status {
        RunStatus::Complete | RunStatus::Superseded => Some(Outcome::AlreadyStored { run_id: known.run_id }),
        RunStatus::Quarantined if retry == Retry::Never => Some(Outcome::Quarantined {
            run_id: known.run_id,
            rejection: Rejection::stored(path, known.reason.unwrap_or_default()),
            cycles: known.cycles_stored,
        }),
        RunStatus::Quarantined | RunStatus::Streaming => None,
    }
}

/// Number, size and time of a file; `None` where it is not there, or the file system does not tell.
#[must_use]
pub fn source_state(path: &Path) -> Option<SourceState> {
    let metadata = std::fs::metadata(path).ok()?;
    let modified = Timestamp::try_from(metadata.modified().ok()?).ok()?;
    Some(SourceState { bytes: metadata.len(), modified, file: fingerprint::id_of(&metadata) })
}

/// Reads the export of `intake`, which has settled, and sends its cycles, those already stored left out.
/// Runs on a blocking thread; ends early when the receiver is gone or a stop is asked for.
pub fn read_cycles(
    intake: &Intake,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> ReadEnd {
    read(intake, cycles, stop, progress).unwrap_or_else(ReadEnd::Rejected)
}

fn read(
    intake: &Intake,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> Result<ReadEnd, Rejection> {
    let (bytes, hash) = source::open_hashing(&intake.path)?;
    let mut export =
        ExportReader::new(bytes, &intake.path, &intake.layout, &intake.robot, ReadOptions::default())?;
    let mut cutting = Cutting::new(intake, cycles, stop, hash.clone())?;
    for chunk in export.by_ref() {
        progress(hash.bytes());
        if !cutting.push(chunk?.samples)? {
            return Ok(ReadEnd::Interrupted);
        }
    }
    if hash.so_far().0 != intake.header.content_hash {
        return Ok(ReadEnd::Changed);
    }
    cutting.end(export.rows())
}

/// The description of a robot and its exports, its name, and the start of the recording.
pub type Recognition<'a> = (&'a FleetEntry, String, Timestamp);

/// Which robot made the export, and when, by its file name.
///
/// # Errors
/// A rejection of a name that says no robot, or one without description.
pub fn recognise<'a>(
    pipeline: &'a Pipeline,
    path: &Path,
    file_time: Timestamp,
) -> Result<Recognition<'a>, Rejection> {
    let config = pipeline.config();
    let recognised = config.recognition.recognise(&file_name(path)).map_err(|error| {
        Rejection::of_file(
            path,
            error.to_string(),
            "rename the file, or change [recognition] in the configuration",
        )
    })?;
    let entry = config.robot_entry(&recognised.robot).ok_or_else(|| {
        Rejection::of_file(
            path,
            format!("no description for robot \"{}\"", recognised.robot),
            "add a [[robot]] entry whose name matches to the configuration",
        )
    })?;
    Ok((entry, recognised.robot, recognised.started_at.unwrap_or(file_time)))
}

async fn quarantined(
    pipeline: &Pipeline,
    header: &RunHeader,
    rejection: Rejection,
) -> Result<Outcome, PipelineError> {
    let run_id = pipeline
        .store()
        .quarantine(header, &rejection.sentence(), rejection.line, rejection.column.as_deref())
        .await?;
    Ok(Outcome::Quarantined { run_id, rejection, cycles: 0 })
}

/// What is known of an export before its rows are read.
#[must_use]
pub fn header(
    path: &Path,
    robot: &str,
    model: &str,
    started_at: Timestamp,
    content_hash: ContentHash,
    source_bytes: u64,
) -> RunHeader {
    RunHeader {
        robot: robot.to_owned(),
        model: model.to_owned(),
        started_at,
        source_name: file_name(path),
        source_path: path.display().to_string(),
        content_hash,
        source_bytes,
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Identity of a file whose content cannot be read: its path stands in.
fn path_identity(path: &Path) -> ContentHash {
    crate::ingest::fingerprint::of_bytes(path.as_os_str().as_encoded_bytes())
}

/// Modification time of a file, the best guess at its recording where its name has none.
#[must_use]
pub fn file_time(path: &Path) -> Timestamp {
    std::fs::metadata(path)
        .and_then(|metadata| metadata.modified())
        .ok()
        .and_then(|modified| Timestamp::try_from(modified).ok())
        .unwrap_or(Timestamp::UNIX_EPOCH)
}
