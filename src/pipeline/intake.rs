//! From a path to cycles: recognition, ledger check, reading.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use jiff::Timestamp;
use jiff::tz::TimeZone;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::cutting::{CutCycle, Cutting, ReadEnd};
use super::resume::{self, ResumePoint};
use super::{Outcome, Pipeline, PipelineError, Retry, record};
use crate::config::{Config, FleetEntry, Layout, RewritePolicy, WorkLimits};
use crate::ingest::blocks::Passed;
use crate::ingest::csv::{ExportReader, ReadOptions};
use crate::ingest::fingerprint::{self, fingerprint};
use crate::ingest::rejection::Rejection;
use crate::ingest::source;
use crate::ingest::start;
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
    /// Where reading goes on behind some of them, if not at the start.
    pub resume: Option<ResumePoint>,
    /// What reading it may take.
    pub limits: WorkLimits,
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
            let rejection = Rejection::from_io(path, &error);
            let header = header(path, UNKNOWN_ROBOT, "", file_time, path_identity(path), 0);
            let outcome = quarantined(pipeline, &header, rejection.clone()).await?;
            let passing = rejection.is_passing;
            return Ok(Known::Yes(if passing { Outcome::Unreadable { rejection } } else { outcome }));
        }
    };
    let admitted = admit_content(pipeline, path, retry, (content_hash, source_bytes), file_time).await?;
    let run_id = match &admitted {
        Known::No(intake) => Some(intake.run_id),
        Known::Yes(outcome) => outcome.run_id(),
    };
    if let Some(run_id) = run_id {
        supersede_unreadable(pipeline, path, run_id).await?;
    }
    Ok(admitted)
}

/// Lets the run of a file that could be read take the place of what was written down when it could not.
async fn supersede_unreadable(pipeline: &Pipeline, path: &Path, run_id: i64) -> Result<(), PipelineError> {
    match pipeline.store().lookup(&path_identity(path)).await? {
        Some(unreadable) if unreadable.status == RunStatus::Quarantined => {
            Ok(pipeline.store().supersede_run(run_id, unreadable.run_id).await?)
        }
        _ => Ok(()),
    }
}

/// As [`admit`], for a file whose content could be read.
async fn admit_content(
    pipeline: &Pipeline,
    path: &Path,
    retry: Retry,
    (content_hash, source_bytes): (ContentHash, u64),
    file_time: Timestamp,
) -> Result<Known, PipelineError> {
    let Some(state) = source_state(path) else { return Ok(Known::Yes(Outcome::Changed)) };
    let known = pipeline.store().lookup(&content_hash).await?;
    let recognised = recognise(pipeline.config(), path, file_time);
    let recording = recognised.as_ref().ok().and_then(Recognised::recording);
    let start = match start(pipeline, path, state.file, recording).await? {
        Ok(start) => start,
        Err(rejection) => return Ok(Known::Yes(Outcome::Unreadable { rejection })),
    };
    // a content that was superseded at this path has come back to it
    let returns = |known: &KnownRun| known.status == RunStatus::Superseded && start.replaces_here;
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
    let Recognised { entry, robot, started_at, .. } = match recognised {
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
    let resume = resume::of_run(pipeline, begun.run_id, &entry.layout, &description).await?;
    Ok(Known::No(Box::new(Intake {
        path: path.to_path_buf(),
        run_id: begun.run_id,
        header,
        robot: description,
        layout: Arc::clone(&entry.layout),
        cycles_stored: begun.cycles_stored,
        resume,
        limits: pipeline.config().limits,
    })))
}

/// How the run of a file begins, and from which of its first bytes its stored cycles are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Start {
    /// The beginning.
    pub beginning: Beginning,
    /// What is stored already was read from these bytes.
    pub read: ContentPrefix,
    /// Whether the run that it takes the place of lay at this path.
    replaces_here: bool,
    /// An unfinished run that is not to go on, since this file's content is stored otherwise.
    unfinished: Option<Unfinished>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Unfinished {
    /// Its cycles come from the first bytes of this file.
    Prefix(i64),
    /// This file was written over what it was read from.
    Rewritten(i64),
}

/// Finds out how the run of the file at `path` begins: its first bytes are compared with what runs were
/// read from that lay at this path, in this file, or are of this recording. `recording` is robot and start where
/// the name says both. A rejection if the file cannot be read now.
///
/// # Errors
/// Those of the store.
pub async fn start(
    pipeline: &Pipeline,
    path: &Path,
    file: FileId,
    recording: Option<(&str, Timestamp)>,
) -> Result<Result<Start, Rejection>, PipelineError> {
    forget_unreadable(pipeline, path).await?;
    let mut earlier = pipeline.store().earlier_runs(&source::path_text(path), file, recording).await?;
    // what is being read is another file's, which had this name
    earlier.retain(|run| !pipeline.is_open(run.run.run_id));
    let owned = path.to_path_buf();
    let compared = tokio::task::spawn_blocking(move || {
        let begins_with = |run: &EarlierRun| match fingerprint::prefix(&owned, run.read.bytes) {
            Ok(prefix) => Ok(prefix == Some(run.read)),
            // a failure to read must not pass for another content
            Err(error) => Err(Rejection::from_io(&owned, &error)),
        };
        earlier.into_iter().map(|run| Ok((begins_with(&run)?, run))).collect::<Result<Vec<_>, _>>()
    });
    let policy = pipeline.config().watch.on_rewrite;
    Ok(compared.await?.map(|compared| chosen(&compared, recording, policy)))
}

/// Takes away what was written down of a file while it could not be read.
async fn forget_unreadable(pipeline: &Pipeline, path: &Path) -> Result<(), PipelineError> {
    let known = pipeline.store().lookup(&path_identity(path)).await?;
    if let Some(run) = known.filter(|run| run.status == RunStatus::Quarantined) {
        pipeline.store().discard_run(run.run_id).await?;
    }
    Ok(())
}

/// Chooses among runs, each with whether the file begins with what it was read from.
///
/// A run is superseded only by the same recording: by a file whose name says the same robot and start; while it is
/// unfinished, only by one at its own path. A file whose name says no start, such as `current.csv`, holds one
/// recording after the other; of those, only an unfinished one is superseded whose very file was written over.
fn chosen(
    earlier: &[(bool, EarlierRun)],
    recording: Option<(&str, Timestamp)>,
    policy: RewritePolicy,
) -> Start {
    let mut start = Start {
        beginning: Beginning::default(),
        read: fingerprint::nothing(),
        replaces_here: false,
        unfinished: None,
    };
    for (is_prefix, earlier) in earlier {
        let EarlierRun { run, same_path, same_file, .. } = earlier;
        let (unfinished, complete) = (run.status == RunStatus::Streaming, run.status == RunStatus::Complete);
        // nothing is stored of it that could be wrong
        let empty = *same_path && *same_file && unfinished && run.cycles_stored == 0;
        // a header alone is that of any file
        let faulty = run.status == RunStatus::Quarantined && (*same_path || run.cycles_stored > 0);
        // another file of the recording that is complete stays as it is
        let goes_on = unfinished || (complete && (*same_path || *same_file)) || faulty;
        let same_recording = recording == Some((earlier.robot.as_str(), earlier.started_at));
        let rewritten = match run.status {
            RunStatus::Streaming => (same_recording && *same_path) || *same_file,
            RunStatus::Complete => same_recording && policy == RewritePolicy::Supersede,
            RunStatus::Quarantined | RunStatus::Superseded => false,
        };
        if start.beginning.onwards.is_none() && goes_on && (*is_prefix || empty) {
            start.beginning.onwards = Some(run.run_id);
            start.read =
                if *is_prefix && run.cycles_stored > 0 { earlier.read } else { fingerprint::nothing() };
            start.unfinished = unfinished.then_some(Unfinished::Prefix(run.run_id));
        } else if start.beginning.instead_of.is_none() && rewritten {
            start.beginning.instead_of = Some(run.run_id);
            start.replaces_here = *same_path;
            if unfinished && start.unfinished.is_none() {
                start.unfinished = Some(Unfinished::Rewritten(run.run_id));
            }
        }
    }
    start
}

/// Leaves a file whose content is stored as `run_id`: an unfinished run that was read from it goes, or stands
/// as superseded where the file was rewritten.
async fn leave(pipeline: &Pipeline, run_id: i64, start: &Start) -> Result<(), PipelineError> {
    match start.unfinished {
        Some(Unfinished::Prefix(unfinished)) if unfinished != run_id => {
            pipeline.store().merge_run(unfinished, run_id).await?;
        }
        Some(Unfinished::Rewritten(unfinished)) if unfinished != run_id => {
            pipeline.store().supersede_run(run_id, unfinished).await?;
        }
        _ => {}
    }
    Ok(())
}

/// What is said of an export that the ledger knows, unless it needs reading.
#[must_use]
pub fn decided(path: &Path, known: KnownRun, retry: Retry) -> Option<Outcome> {
    match known.status {
        RunStatus::Complete | RunStatus::Superseded => Some(Outcome::AlreadyStored { run_id: known.run_id }),
        RunStatus::Quarantined if retry == Retry::Never && !known.retry_asked => Some(Outcome::Quarantined {
            run_id: known.run_id,
            rejection: Rejection::stored(path, known.reason.unwrap_or_default()),
            cycles: known.cycles_stored,
            known: true,
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
    read(intake, ReadOptions::default(), cycles, stop, progress).unwrap_or_else(ReadEnd::Rejected)
}

/// As [`read_cycles`], in blocks of any size.
pub(super) fn read(
    intake: &Intake,
    options: ReadOptions,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> Result<ReadEnd, Rejection> {
    let (bytes, hash) = source::open_hashing_up_to(&intake.path, intake.limits.export_bytes)?;
    let mut export = ExportReader::new(bytes, &intake.path, &intake.layout, &intake.robot, options)?;
    match resume::pass_to_point(&mut export, intake, stop, || progress(hash.bytes()))? {
        Passed::There => {}
        Passed::Elsewhere => return Ok(ReadEnd::Changed),
        Passed::Going => return Ok(ReadEnd::Interrupted),
    }
    let mut cutting = Cutting::new(intake, cycles, stop, hash.clone())?;
    for chunk in export.by_ref() {
        progress(hash.bytes());
        if !cutting.push(chunk?)? {
            return Ok(ReadEnd::Interrupted);
        }
    }
    if hash.so_far().0 != intake.header.content_hash {
        return Ok(ReadEnd::Changed);
    }
    cutting.end(export.rows(), export.passed_over().rows)
}

/// What an export's name says of it.
#[derive(Debug, Clone)]
pub struct Recognised<'a> {
    /// The robot's description and the layout of its exports.
    pub entry: &'a FleetEntry,
    /// The individual robot.
    pub robot: String,
    /// Start of the recording: from its rows or its name or, without one there, the file's time.
    pub started_at: Timestamp,
    /// Whether the rows or the name say the start.
    named_start: bool,
}

impl Recognised<'_> {
    /// Which recording it is, where the name says so.
    #[must_use]
    pub fn recording(&self) -> Option<(&str, Timestamp)> {
        self.named_start.then_some((self.robot.as_str(), self.started_at))
    }
}

/// Which robot made the export, and when, by its file name.
///
/// # Errors
/// A rejection of a name that says no robot, or one without description.
pub fn recognise<'a>(
    config: &'a Config,
    path: &Path,
    file_time: Timestamp,
) -> Result<Recognised<'a>, Rejection> {
    let recognised = config.recognition.recognise(&file_name(path)).map_err(|error| {
        Rejection::of_file(
            path,
            error.to_string(),
            "rename the file, or change [recognition] in the configuration",
        )
    })?;
    let entry = config.export_entry(&recognised.robot, &file_name(path)).ok_or_else(|| {
        Rejection::of_file(
            path,
            format!("no description for robot \"{}\" and this file", recognised.robot),
            "add a [[robot]] entry whose name matches to the configuration",
        )
    })?;
    let started_at = match &entry.layout.start {
        Some(start) => Some(start::recorded_start(path, &entry.layout, start, &zone(config, path)?)?),
        None => recognised.started_at,
    };
    Ok(Recognised {
        entry,
        robot: recognised.robot,
        started_at: started_at.unwrap_or(file_time),
        named_start: started_at.is_some(),
    })
}

/// The time zone of clocks in names and rows.
fn zone(config: &Config, path: &Path) -> Result<TimeZone, Rejection> {
    config.recognition.zone().ok_or_else(|| {
        let reason = format!("time zone {} is not known on this machine", config.recognition.time_zone);
        Rejection::of_file(path, reason, "install the time zone database (package tzdata)")
    })
}

async fn quarantined(
    pipeline: &Pipeline,
    header: &RunHeader,
    rejection: Rejection,
) -> Result<Outcome, PipelineError> {
    let run_id = record::write_down(pipeline, header, &rejection).await?;
    Ok(Outcome::Quarantined { run_id, rejection, cycles: 0, known: false })
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
        source_path: source::path_text(path),
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

#[cfg(test)]
mod tests {
    use super::*;

    const START: Timestamp = Timestamp::UNIX_EPOCH;

    fn earlier(run_id: i64, status: RunStatus, cycles_stored: u32, places: [bool; 2]) -> EarlierRun {
        let [same_path, same_file] = places;
        EarlierRun {
            run: KnownRun { run_id, status, reason: None, cycles_stored, retry_asked: false },
            robot: "A".into(),
            started_at: START,
            read: ContentPrefix { bytes: 9, hash: ContentHash([9; 32]) },
            same_path,
            same_file,
        }
    }

    fn begins(
        earlier: &[(bool, EarlierRun)],
        recording: Option<(&str, Timestamp)>,
    ) -> (Option<i64>, Option<i64>) {
        let start = chosen(earlier, recording, RewritePolicy::Supersede);
        (start.beginning.onwards, start.beginning.instead_of)
    }

    #[test]
    fn a_file_that_begins_with_what_was_read_goes_on() {
        let named = Some(("A", START));
        for status in [RunStatus::Streaming, RunStatus::Complete, RunStatus::Quarantined] {
            let runs = [(true, earlier(1, status, 2, [true, true]))];
            assert_eq!(begins(&runs, named), (Some(1), None), "{status:?}");
            assert_eq!(begins(&runs, None), (Some(1), None), "{status:?}");
        }
        assert_eq!(
            begins(&[(true, earlier(1, RunStatus::Superseded, 2, [true, true]))], named),
            (None, None)
        );
        // renamed, while its old name has got another file
        let runs = [
            (false, earlier(2, RunStatus::Complete, 2, [true, false])),
            (true, earlier(1, RunStatus::Streaming, 2, [false, true])),
        ];
        assert_eq!(begins(&runs, None), (Some(1), None));
        assert_eq!(begins(&runs, named), (Some(1), Some(2)));
    }

    #[test]
    fn only_the_same_recording_supersedes() {
        let complete = [(false, earlier(1, RunStatus::Complete, 2, [true, true]))];
        assert_eq!(begins(&complete, Some(("A", START))), (None, Some(1)));
        let next_day = START + jiff::SignedDuration::from_hours(24);
        for other in [None, Some(("B", START)), Some(("A", next_day))] {
            assert_eq!(begins(&complete, other), (None, None), "{other:?}");
        }
        let kept = chosen(&complete, Some(("A", START)), RewritePolicy::KeepBoth);
        assert_eq!(kept.beginning, Beginning::default());
    }

    #[test]
    fn a_recording_exported_again_elsewhere_supersedes_a_complete_run_only() {
        let named = Some(("A", START));
        let elsewhere = |status| [(false, earlier(1, status, 2, [false, false]))];
        let found = chosen(&elsewhere(RunStatus::Complete), named, RewritePolicy::Supersede);
        assert_eq!((found.beginning.instead_of, found.replaces_here), (Some(1), false));
        assert_eq!(begins(&elsewhere(RunStatus::Streaming), named), (None, None), "it may be a copy");
        assert_eq!(begins(&elsewhere(RunStatus::Quarantined), named), (None, None));
        let kept = chosen(&elsewhere(RunStatus::Complete), named, RewritePolicy::KeepBoth);
        assert_eq!(kept.beginning, Beginning::default());
        // a longer file elsewhere is another file; one that goes on where a reader was cut short is the same
        let begins_alike = |status| [(true, earlier(1, status, 2, [false, false]))];
        assert_eq!(begins(&begins_alike(RunStatus::Complete), named), (None, Some(1)));
        assert_eq!(begins(&begins_alike(RunStatus::Streaming), named), (Some(1), None));
    }

    #[test]
    fn an_unfinished_run_whose_file_was_written_over_is_superseded_and_one_that_was_moved_is_not() {
        let unfinished = |cycles, places| [(false, earlier(1, RunStatus::Streaming, cycles, places))];
        assert_eq!(begins(&unfinished(2, [true, true]), None), (None, Some(1)));
        assert_eq!(begins(&unfinished(2, [true, false]), None), (None, None), "another file has its name");
        assert_eq!(begins(&unfinished(0, [true, true]), None), (Some(1), None), "nothing is stored of it");
    }
}
