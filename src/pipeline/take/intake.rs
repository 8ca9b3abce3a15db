//! From a path to cycles: recognition, ledger check, reading.

use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Instant;

use jiff::Timestamp;
use jiff::tz::TimeZone;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::admitted::AdmittedExport;
use super::cutting::{CutCycle, Cutting, ReadEnd};
use super::decide::{Compared, Decision, Facts, Start, Unfinished};
use super::{content, cut_file, decide, new_robot, record, resume};
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Retry};
use crate::pipeline::cycle_memory::RecordingTurn;
use armwatch_config::{Config, FleetEntry, UNKNOWN_ROBOT};
use armwatch_ingest::bytes::blocks::Passed;
use armwatch_ingest::bytes::fingerprint::fingerprint;
use armwatch_ingest::bytes::parts::RecordingParts;
use armwatch_ingest::bytes::{fingerprint, parts, source};
use armwatch_ingest::find::archive::original_name;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::reader::ReadOptions;
use armwatch_ingest::table::start;
use armwatch_method::buffers::Buffers;
use armwatch_model::run::{ContentHash, ContentPrefix, RunHeader, RunStatus};
use armwatch_model::text;
use armwatch_store::{EarlierRun, Identity, KnownRun, RecordingName, RunStart, SourceState, Store};

/// Result of the admission of an export.
#[derive(Debug)]
pub enum Admission {
    /// It needs reading.
    Read(Box<AdmittedExport>),
    /// Its treatment is final.
    Decided(Outcome),
}

/// Looks up an export by its content and admits it if it is new or unfinished. `hashed` contains its content and its
/// number of bytes, if they are known.
///
/// # Errors
/// Those of the store. A file that cannot be read is quarantined; one that vanished is [`Outcome::Changed`].
pub async fn admit(
    pipeline: &Pipeline,
    path: &Path,
    retry: Retry,
    hashed: Option<(ContentHash, u64)>,
) -> Result<Admission, PipelineError> {
    if let Some(rejection) = content::missing_part(pipeline, path).await? {
        return Ok(Admission::Decided(
            quarantined(pipeline, &header_of_name(pipeline, path), rejection).await?,
        ));
    }
    if let Some(content) = hashed {
        return admit_content(pipeline, path, retry, content, file_time(path)).await;
    }
    let owned = path.to_path_buf();
    let read = pipeline.with_files(move || (fingerprint(&owned), file_time(&owned))).await?;
    let ((content_hash, source_bytes), file_time) = match read {
        (Ok(identity), file_time) => (identity, file_time),
        (Err(error), _) if error.kind() == std::io::ErrorKind::NotFound => {
            return Ok(Admission::Decided(Outcome::Changed));
        }
        (Err(error), file_time) => {
            let rejection = Rejection::from_io(path, &error);
            let header = RunHeader {
                robot: UNKNOWN_ROBOT.into(),
                started_at: file_time,
                ..header_of_name(pipeline, path)
            };
            let outcome = quarantined(pipeline, &header, rejection.clone()).await?;
            let passing = rejection.is_passing;
            return Ok(Admission::Decided(if passing { Outcome::Unreadable { rejection } } else { outcome }));
        }
    };
    admit_content(pipeline, path, retry, (content_hash, source_bytes), file_time).await
}

/// Header of a run whose export's content cannot be read, from its name.
fn header_of_name(pipeline: &Pipeline, path: &Path) -> RunHeader {
    let (store, recognition) = (pipeline.store(), &pipeline.config().recognition);
    let recognised = recognition.recognise(&file_name(path)).ok();
    let started_at = recognised.as_ref().and_then(|of| of.started_at).unwrap_or_else(|| file_time(path));
    let robot = recognised.map_or_else(|| UNKNOWN_ROBOT.to_owned(), |of| of.robot);
    header(path, ledger_path(store, path), &robot, "", started_at, path_identity(store, path), 0)
}

/// Like [`admit`], for a file whose content was readable.
async fn admit_content(
    pipeline: &Pipeline,
    path: &Path,
    retry: Retry,
    (content_hash, source_bytes): (ContentHash, u64),
    file_time: Timestamp,
) -> Result<Admission, PipelineError> {
    let Some(state) = source_state(path) else { return Ok(Admission::Decided(Outcome::Changed)) };
    let recognised = recognise(pipeline.config(), path, file_time);
    let facts = facts(pipeline, path, Some(content_hash), state, recognised.as_ref().ok(), retry).await?;
    let facts = match facts {
        Ok(facts) => facts,
        Err(rejection) => return Ok(Admission::Decided(Outcome::Unreadable { rejection })),
    };
    forget_unreadable(pipeline, path).await?;
    // a part that arrived before its predecessor
    for late in RecordingParts::of(path).map_or_else(Vec::new, |parts| parts.later()) {
        forget_unreadable(pipeline, &late).await?;
    }
    let header_before = match &recognised {
        // files are rarely rewritten
        Ok(recognised) if facts.earlier.iter().any(|of| of.same_file && !of.begins_alike) => {
            cut_file::header_of(pipeline, path, state, recognised.entry).await?
        }
        _ => None,
    };
    let facts = facts.of_cut_file(header_before.is_some());
    let ledger_path = ledger_path(pipeline.store(), path);
    let start = match decide::decide(&facts) {
        Decision::Known { run, unfinished } => {
            leave(pipeline, run.run_id, unfinished).await?;
            return Ok(Admission::Decided(decided(path, run)));
        }
        Decision::InWork { run_id } => {
            return Ok(Admission::Decided(Outcome::InWork { run_id: Some(run_id) }));
        }
        Decision::Read(start) => start,
    };
    let questioned = match recognised {
        // a continued run already has its robot
        Ok(recognised) if start.continues.is_none() => {
            let question = new_robot::question(pipeline, path, &recognised).await?;
            question.map_or(Ok(recognised), Err)
        }
        recognised => recognised,
    };
    let recognised = match questioned {
        Ok(recognised) => recognised,
        Err(rejection) => {
            let header = header(path, ledger_path, UNKNOWN_ROBOT, "", file_time, content_hash, source_bytes);
            return Ok(Admission::Decided(quarantined(pipeline, &header, rejection).await?));
        }
    };
    let model = &recognised.entry.description.model;
    let header = header(
        path,
        ledger_path,
        &recognised.robot,
        model,
        recognised.started_at,
        content_hash,
        source_bytes,
    );
    if let (Some(unfinished), Some(run_id)) = (start.merges, start.continues) {
        pipeline.store().merge_run(unfinished, run_id).await?;
    }
    let identity = Identity::Content(content_hash);
    let intake = begin(pipeline, path, &recognised, header, identity, start, state).await?;
    if header_before.is_some() {
        tracing::warn!(file = %text::of_path(path), run_id = intake.run_id, "{}", cut_file::GOES_ON);
    }
    Ok(Admission::Read(Box::new(AdmittedExport { header_before, ..intake })))
}

/// Starts or continues the run of a file.
pub(in crate::pipeline) async fn begin(
    pipeline: &Pipeline,
    path: &Path,
    recognised: &Recognised<'_>,
    header: RunHeader,
    identity: Identity,
    start: Start,
    state: SourceState,
) -> Result<AdmittedExport, PipelineError> {
    let FleetEntry { description, layout, .. } = recognised.entry;
    let Config { limits, analysis, .. } = pipeline.config();
    let made_with = resume::settings_hash(layout, description, limits, analysis);
    let Start { continues, replaces, afresh, .. } = start;
    if continues.is_none() {
        new_robot::say_unmatched(pipeline, path, &recognised.robot).await?;
    }
    let beginning = RunStart { continues, replaces, made_with: Some(made_with), afresh };
    let begun = pipeline.store().begin_source(&header, identity, beginning, state).await?;
    if begun.afresh {
        tracing::warn!(
            file = %text::of_path(path), run_id = begun.run.run_id,
            "read from the start: layout, description, settings or program have changed since its cycles \
            were stored"
        );
    }
    let resume = resume::of_run(pipeline, begun.run.run_id, &made_with).await?;
    Ok(AdmittedExport {
        path: path.to_path_buf(),
        run_id: begun.run.run_id,
        header,
        robot: Arc::clone(description),
        layout: Arc::clone(layout),
        named_start: recognised.named_start,
        cycles_stored: begun.run.cycles_stored,
        resume,
        made_with,
        limits: *limits,
        memory: pipeline.memory.clone(),
        header_before: None,
        turn: RecordingTurn::come(),
    })
}

/// Collects the facts about the file at `path` for the decision. Compares its first bytes with the content of earlier
/// runs of the same path, the same file or the same recording. Returns a rejection if the file cannot be read now.
/// Writes nothing.
pub(in crate::pipeline) async fn facts(
    pipeline: &Pipeline,
    path: &Path,
    content: Option<ContentHash>,
    state: SourceState,
    recognised: Option<&Recognised<'_>>,
    retry: Retry,
) -> Result<Result<Facts, Rejection>, PipelineError> {
    let name = file_name(path);
    let known = match &content {
        Some(of) => content::run_of_content(pipeline, path, of, recognised).await?,
        None => None,
    };
    let recording = recognised.and_then(Recognised::recording);
    let recording =
        recording.map(|(robot, started_at)| RecordingName { robot, started_at, source_name: &name });
    let ledger_path = ledger_path(pipeline.store(), path);
    let mut earlier = pipeline.store().earlier_runs(&ledger_path, state.file, recording).await?;
    let of_others = pipeline.store().runs_of_others().await?;
    let is_open = |run_id: i64| pipeline.is_open(run_id) || of_others.contains(&run_id);
    // a run open in this program belongs to another file, which had this name; another program may read this very file
    earlier.retain(|of| {
        let run_id = of.run.run_id;
        !pipeline.is_open(run_id) && (of.same_path || !of_others.contains(&run_id))
    });
    let read: Vec<ContentPrefix> = earlier.iter().map(|run| run.read).collect();
    let owned = path.to_path_buf();
    let compared = pipeline.with_files(move || {
        // a failure to read must not count as a different content
        let begins_with = |read: ContentPrefix| match fingerprint::prefix(&owned, read.bytes) {
            Ok(prefix) => Ok(prefix == Some(read)),
            Err(error) => Err(Rejection::from_io(&owned, &error)),
        };
        read.into_iter().map(begins_with).collect::<Result<Vec<_>, _>>()
    });
    let begin_alike = match compared.await? {
        Ok(alike) => alike,
        Err(rejection) => return Ok(Err(rejection)),
    };
    let is_elsewhere = |of: &EarlierRun| of_others.contains(&of.run.run_id);
    let read_elsewhere = earlier
        .iter()
        .zip(&begin_alike)
        .find_map(|(of, alike)| (*alike && is_elsewhere(of)).then_some(of.run.run_id));
    let here = earlier.into_iter().zip(begin_alike).filter(|(of, _)| !is_elsewhere(of));
    let compared = here.map(|(earlier, begins_alike)| Compared {
        same_robot: recognised.is_some_and(|of| of.robot == earlier.robot),
        same_recording: recognised.is_some_and(|of| is_recording_of(pipeline.config(), of, &earlier)),
        begins_alike,
        run: earlier.run,
        read: earlier.read,
        same_path: earlier.same_path,
        same_file: earlier.same_file,
    });
    Ok(Ok(Facts {
        known_is_open: known.as_ref().is_some_and(|known| is_open(known.run_id)),
        read_elsewhere,
        known,
        names_recording: recognised.is_some_and(|of| of.recording().is_some()),
        earlier: compared.collect(),
        on_rewrite: pipeline.config().watch.on_rewrite,
        retry,
    }))
}

/// Returns true if a file repeats the recording of an earlier run: both names give robot and time, and the
/// configuration assigns the same kind to both. A production log of a run that began as a test is another recording.
fn is_recording_of(config: &Config, file: &Recognised<'_>, earlier: &EarlierRun) -> bool {
    let Some((robot, started_at)) = file.recording() else { return false };
    let same_moment = match config.recognition.recognise(&earlier.source_name) {
        Ok(named) => named.robot == robot && named.is_definite && named.started_at == Some(started_at),
        // its name was read with another pattern
        Err(_) => earlier.robot == robot && earlier.started_at == started_at,
    };
    // the kind is known once reading has begun
    let same_kind =
        earlier.run.cycles_stored == 0 || earlier.kind == file.entry.layout.stage.kind().run_kind();
    let entry = config.export_entry(&earlier.robot, &earlier.source_name);
    same_moment && same_kind && entry.is_none_or(|entry| std::ptr::eq(entry, file.entry))
}

impl Pipeline {
    /// Stores why a file or link is not read, unless that is stored already.
    pub async fn list_skipped(&self, path: &Path, rejection: Rejection) -> Result<(), PipelineError> {
        let identity = path_identity(self.store(), path);
        let known = self.store().lookup(&identity).await?;
        if known.is_none_or(|run| run.status != RunStatus::Quarantined) {
            let ledger_path = ledger_path(self.store(), path);
            let header = header(path, ledger_path, UNKNOWN_ROBOT, "", Timestamp::now(), identity, 0);
            record::write_down(self, &header, &rejection).await?;
        }
        Ok(())
    }

    /// Deletes the entry that [`Pipeline::list_skipped`] stored.
    pub async fn unlist_skipped(&self, path: &Path) -> Result<(), PipelineError> {
        forget_unreadable(self, path).await
    }
}

/// Deletes the entry of a file that was unreadable before.
pub(in crate::pipeline) async fn forget_unreadable(
    pipeline: &Pipeline,
    path: &Path,
) -> Result<(), PipelineError> {
    let known = pipeline.store().lookup(&path_identity(pipeline.store(), path)).await?;
    // the bytes of its cycles identify a run with cycles
    if let Some(run) = known.filter(|run| run.status == RunStatus::Quarantined && run.cycles_stored == 0) {
        pipeline.store().discard_run(run.run_id).await?;
    }
    Ok(())
}

/// Leaves a file whose content is stored as `run_id`. An unfinished run that was read from it is removed, or marked as
/// superseded if the file was overwritten.
async fn leave(
    pipeline: &Pipeline,
    run_id: i64,
    unfinished: Option<Unfinished>,
) -> Result<(), PipelineError> {
    match unfinished {
        Some(Unfinished::Prefix(unfinished)) => pipeline.store().merge_run(unfinished, run_id).await?,
        Some(Unfinished::Rewritten(unfinished)) => {
            pipeline.store().supersede_run(run_id, unfinished).await?;
        }
        None => {}
    }
    Ok(())
}

/// The outcome of an export whose run decides its treatment.
pub fn decided(path: &Path, known: KnownRun) -> Outcome {
    match known.status {
        RunStatus::Quarantined => Outcome::Quarantined {
            run_id: known.run_id,
            rejection: Rejection::stored(path, known.reason.unwrap_or_default()),
            cycles: known.cycles_stored,
            known: true,
        },
        RunStatus::Complete | RunStatus::Superseded | RunStatus::SetAside | RunStatus::Streaming => {
            Outcome::AlreadyStored { run_id: known.run_id }
        }
    }
}

/// Number, size and time of a file; `None` if it does not exist, or the file system does not report them.
pub fn source_state(path: &Path) -> Option<SourceState> {
    let state = parts::state(path).ok()?;
    let modified = Timestamp::try_from(state.changed).ok()?;
    Some(SourceState { bytes: state.bytes, modified, file: state.file })
}

/// Reads the settled export of `intake` and sends its cycles, except those already stored. Runs on a blocking thread.
/// Ends early when the receiver is dropped or a stop is requested. The channels of the cycles take memory from
/// `buffers`.
pub fn read_cycles(
    intake: &AdmittedExport,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
    buffers: Buffers,
) -> ReadEnd {
    let is_admitted = |content| content == intake.header.content_hash;
    let options = ReadOptions::default();
    read_if(intake, (options, buffers), cycles, stop, progress, is_admitted).unwrap_or_else(ReadEnd::Rejected)
}

/// Like [`read_cycles`], for an export that the ledger has not admitted yet, so that its content is unknown. Its hash
/// is stored in `whole` with the last row.
pub(in crate::pipeline) fn read_before_its_turn(
    export: &AdmittedExport,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
    whole: &OnceLock<ContentHash>,
    buffers: Buffers,
) -> ReadEnd {
    let is_sound = |content| {
        // nothing else sets it
        let _ = whole.set(content);
        true
    };
    let options = (ReadOptions::default(), buffers);
    read_if(export, options, cycles, stop, progress, is_sound).unwrap_or_else(ReadEnd::Rejected)
}

/// Like [`read_cycles`], in blocks of any size.
#[cfg(test)]
pub(in crate::pipeline) fn read(
    intake: &AdmittedExport,
    options: ReadOptions,
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
) -> Result<ReadEnd, Rejection> {
    let is_admitted = |content| content == intake.header.content_hash;
    read_if(intake, (options, Buffers::default()), cycles, stop, progress, is_admitted)
}

/// Reads the export; after its last row, `is_asked_for` checks the content.
fn read_if(
    intake: &AdmittedExport,
    (options, buffers): (ReadOptions, Buffers),
    cycles: &mpsc::Sender<CutCycle>,
    stop: &CancellationToken,
    progress: impl Fn(u64),
    is_asked_for: impl FnOnce(ContentHash) -> bool,
) -> Result<ReadEnd, Rejection> {
    let most = intake.limits.export_bytes;
    let before = intake.header_before.as_deref();
    let (mut export, hash) =
        cut_file::opened(&intake.path, &intake.layout, &intake.robot, (most, options), before)?;
    match resume::pass_to_point(&mut export, intake, stop, || progress(hash.bytes()))? {
        Passed::There => {}
        Passed::Elsewhere => return Ok(ReadEnd::Changed),
        Passed::Going => return Ok(ReadEnd::Interrupted),
    }
    let mut cutting =
        Cutting::new(intake, cycles, stop, hash.clone())?.with_buffers(buffers).with_header(export.header());
    let mut began = Instant::now();
    for chunk in export.by_ref() {
        progress(hash.bytes());
        cutting.note_read(began.elapsed(), None);
        if !cutting.push(chunk?)? {
            return Ok(ReadEnd::Interrupted);
        }
        began = Instant::now();
    }
    if !is_asked_for(hash.so_far().0) {
        return Ok(ReadEnd::Changed);
    }
    cutting.end(&export)
}

/// The facts that an export's name gives.
#[derive(Debug, Clone)]
pub struct Recognised<'a> {
    /// The robot's description and the layout of its exports.
    pub entry: &'a FleetEntry,
    /// The individual robot.
    pub robot: String,
    /// Start of the recording from its rows or its name; otherwise the file's time, which is that of its end.
    pub started_at: Timestamp,
    /// True if the rows or the name give the start.
    pub named_start: bool,
    /// True if they give a time that no other recording of the robot has.
    is_definite: bool,
}

impl Recognised<'_> {
    /// Robot and start of the recording, if the name gives them.
    pub fn recording(&self) -> Option<(&str, Timestamp)> {
        self.is_definite.then_some((self.robot.as_str(), self.started_at))
    }
}

/// Recognises the robot of an export, and its time, by the file name.
///
/// # Errors
/// A rejection of a name that gives no robot, or a robot without description.
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
        is_definite: recognised.is_definite || entry.layout.start.is_some(),
    })
}

/// The time zone of clocks in names and rows.
fn zone(config: &Config, path: &Path) -> Result<TimeZone, Rejection> {
    config.recognition.zone().ok_or_else(|| {
        let reason = format!("time zone {} is not known on this computer", config.recognition.time_zone);
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

/// Facts about an export before its rows are read; `ledger_path` is the result of [`ledger_path`].
pub fn header(
    path: &Path,
    ledger_path: String,
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
        source_path: ledger_path,
        content_hash,
        source_bytes,
    }
}

/// Name of an export; for an export in the archive, its name before archiving; for one in several files, that of the
/// first part.
pub(in crate::pipeline) fn file_name(path: &Path) -> String {
    original_name(&text::of_file_name(&parts::named_by(path))).into_owned()
}

/// A path in the form of the ledger.
pub fn ledger_path(store: &Store, path: &Path) -> String {
    store.located(source::path_text(path))
}

/// Identity of a file whose content cannot be read: a hash of its path.
pub(in crate::pipeline) fn path_identity(store: &Store, path: &Path) -> ContentHash {
    let text = source::path_text(path);
    let located = store.located(text.clone());
    let bytes = if located == text { path.as_os_str().as_encoded_bytes() } else { located.as_bytes() };
    fingerprint::of_bytes(bytes)
}

/// Modification time of a file, the best estimate of its recording's time if its name has none.
pub fn file_time(path: &Path) -> Timestamp {
    parts::state(path)
        .ok()
        .and_then(|state| Timestamp::try_from(state.modified).ok())
        .unwrap_or(Timestamp::UNIX_EPOCH)
}
