//! From a path to cycles: recognition, ledger check, reading.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::cycles::CycleReader;
use super::{Outcome, Pipeline, PipelineError, Retry};
use crate::config::Layout;
use crate::ingest::fingerprint::fingerprint;
use crate::ingest::rejection::Rejection;
use crate::robot::Robot;
use crate::run::{ContentHash, Cycle, RunHeader, RunStatus};
use crate::store::{KnownRun, SourceState};

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

/// How the reading of an export ended.
#[derive(Debug, Clone, PartialEq)]
pub enum ReadEnd {
    /// At the end of the file.
    Complete(ReadTotals),
    /// At something not understood.
    Rejected(Rejection),
    /// At a stop that was asked for.
    Interrupted,
    /// At the end of a file that is no longer the one that was admitted.
    Changed,
}

/// Figures of a whole export.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadTotals {
    /// Rows, those outside cycles included.
    pub rows: u64,
    /// Rows per second, from the median time step of the first rows, Hz; zero where it is unknown.
    pub sample_rate: f64,
    /// Cycles, those stored by an earlier attempt included.
    pub cycles: u32,
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
    let known = pipeline.store().lookup(&content_hash).await?;
    if let Some(outcome) = known.and_then(|known| decided(path, known, retry)) {
        return Ok(Known::Yes(outcome));
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
    let begun = pipeline.store().begin_run(&header).await?;
    Ok(Known::No(Box::new(Intake {
        path: path.to_path_buf(),
        run_id: begun.run_id,
        header,
        robot: description,
        layout: Arc::clone(&entry.layout),
        cycles_stored: begun.cycles_stored,
    })))
}

/// What is said of an export that the ledger knows, unless it needs reading.
#[must_use]
pub fn decided(path: &Path, known: KnownRun, retry: Retry) -> Option<Outcome> {
    match known.status {
        RunStatus::Complete => Some(Outcome::AlreadyStored { run_id: known.run_id }),
        RunStatus::Quarantined if retry == Retry::Never => Some(Outcome::Quarantined {
            run_id: known.run_id,
            rejection: Rejection::stored(path, known.reason.unwrap_or_default()),
            cycles: known.cycles_stored,
        }),
        RunStatus::Quarantined | RunStatus::Streaming => None,
    }
}

/// Size and time of a file; `None` where the file system does not tell.
#[must_use]
pub fn source_state(path: &Path) -> Option<SourceState> {
    let metadata = std::fs::metadata(path).ok()?;
    let modified = Timestamp::try_from(metadata.modified().ok()?).ok()?;
    Some(SourceState { bytes: metadata.len(), modified })
}

/// Reads the export of `intake` and sends its cycles, those already stored left out. Runs on a
/// blocking thread; ends early when the receiver is gone or a stop is asked for.
pub fn read_cycles(
    intake: &Intake,
    cycles: &mpsc::Sender<Cycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> ReadEnd {
    match read(intake, cycles, stop, progress) {
        Ok(end) => end,
        Err(rejection) => ReadEnd::Rejected(rejection),
    }
}

fn read(
    intake: &Intake,
    cycles: &mpsc::Sender<Cycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> Result<ReadEnd, Rejection> {
    let mut reader = CycleReader::open(&intake.path, &intake.layout, &intake.robot)?;
    let mut cycle_count = 0;
    let mut send = |cycle: Cycle| {
        cycle_count += 1;
        cycle_count <= intake.cycles_stored || cycles.blocking_send(cycle).is_ok()
    };
    while let Some(cut) = reader.next_cycles()? {
        progress(reader.so_far().1);
        for cycle in cut {
            if stop.is_cancelled() || !send(cycle) {
                return Ok(ReadEnd::Interrupted);
            }
        }
        if stop.is_cancelled() {
            return Ok(ReadEnd::Interrupted);
        }
    }
    let unchanged = reader.so_far().0 == intake.header.content_hash;
    Ok(if unchanged {
        ReadEnd::Complete(ReadTotals {
            rows: reader.rows(),
            sample_rate: reader.sample_rate(),
            cycles: cycle_count,
        })
    } else {
        ReadEnd::Changed
    })
}

type Recognition<'a> = (&'a crate::config::FleetEntry, String, Timestamp);

/// Which robot made the export, and when, by its file name.
fn recognise<'a>(
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

fn header(
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
fn file_time(path: &Path) -> Timestamp {
    std::fs::metadata(path)
        .and_then(|metadata| metadata.modified())
        .ok()
        .and_then(|modified| Timestamp::try_from(modified).ok())
        .unwrap_or(Timestamp::UNIX_EPOCH)
}
