//! Files that a tool has copied and cut while their writer continued, such as `logrotate` with `copytruncate`. The next
//! rows have no header. They are read with the earlier header of the file, which is in the resume points of its runs.

use std::io::Read;
use std::path::Path;

use super::{intake, resume};
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_config::{FleetEntry, Layout};
use armwatch_ingest::bytes::fingerprint::RunningHash;
use armwatch_ingest::bytes::source;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::repeated;
use armwatch_ingest::table::reader::{ExportReader, ReadOptions};
use armwatch_model::robot::Robot;
use armwatch_store::{EarlierRun, SourceState};

/// Said of a file that was cut, and whose rows go on.
pub(super) const GOES_ON: &str = "the file was truncated and its rows continue without a header; they are \
    read with the earlier header, as another run";

/// The header with which this file was read before, under the settings that are in force.
pub(in crate::pipeline) async fn header_before(
    pipeline: &Pipeline,
    path: &Path,
    state: SourceState,
    entry: &FleetEntry,
) -> Result<Option<String>, PipelineError> {
    let FleetEntry { description, layout, .. } = entry;
    if !layout.header {
        return Ok(None);
    }
    let (store, config) = (pipeline.store(), pipeline.config());
    let settings = resume::settings_hash(layout, description, &config.limits, &config.analysis);
    let (located, name) = (intake::ledger_path(store, path), intake::file_name(path));
    let mut earlier = store.earlier_runs(&located, state.file, None).await?;
    // numbers of files are reused, mostly for files of another name
    earlier.retain(|of| of.same_file && of.source_name == name);
    earlier.sort_by_key(|of| std::cmp::Reverse(of.run.run_id));
    for of in earlier {
        let stored = store.resume_point(of.run.run_id).await?;
        let point = stored.and_then(|stored| resume::decoded(&stored.state, &settings));
        if let Some(header) = point.and_then(|point| point.header) {
            return Ok(Some(header));
        }
    }
    Ok(None)
}

/// The header that a file had before it was cut, if it has none now and its rows continue under that one.
pub(super) async fn header_of(
    pipeline: &Pipeline,
    path: &Path,
    state: SourceState,
    entry: &FleetEntry,
) -> Result<Option<String>, PipelineError> {
    let Some(header) = header_before(pipeline, path, state, entry).await? else { return Ok(None) };
    let (owned, entry, most) = (path.to_path_buf(), entry.clone(), pipeline.config().limits.export_bytes);
    let goes_on = pipeline.with_files(move || {
        let (layout, robot, options) = (&entry.layout, &entry.description, ReadOptions::default());
        let opens = |before: Option<&str>| opened(&owned, layout, robot, (most, options), before).is_ok();
        (!opens(None) && opens(Some(&header))).then_some(header)
    });
    Ok(goes_on.await?)
}

/// Opens a settled export, with the running hash of its bytes. `before` is the header that the file had before it was
/// cut, if it has none now.
pub(super) fn opened(
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    (most, options): (u64, ReadOptions),
    before: Option<&str>,
) -> Result<(ExportReader<Box<dyn Read + Send>>, RunningHash), Rejection> {
    let Some(header) = before else { return ExportReader::open(path, layout, robot, options, most) };
    let (bytes, hash) = source::open_hashing_up_to(path, most)?;
    let export = ExportReader::going_on(bytes, header, path, layout, robot, options)?
        .ok_or_else(|| Rejection::of_file(path, "an empty file", "export again"))?;
    Ok((export, hash))
}

/// A rejection with its cause, if other lines or an earlier state of the file show it: rows that were sent twice, or a
/// file that was shortened. If a tool copies a file and cuts it, its writer continues without a header. `run_id` is the
/// file's own run, if it has one.
pub(in crate::pipeline) async fn with_cause(
    pipeline: &Pipeline,
    path: &Path,
    run_id: Option<i64>,
    rejection: Rejection,
) -> Result<Rejection, PipelineError> {
    let most = pipeline.config().limits.export_bytes;
    let rejection = pipeline.with_files(move || repeated::explained(rejection, most)).await?;
    let Some(state) = intake::source_state(path).filter(|_| rejection.line.is_none_or(|line| line <= 2))
    else {
        return Ok(rejection);
    };
    let ledger_path = intake::ledger_path(pipeline.store(), path);
    let earlier = pipeline.store().earlier_runs(&ledger_path, state.file, None).await?;
    let name = intake::file_name(path);
    // numbers of files are reused, mostly for files of another name
    let is_cut = |of: &&EarlierRun| {
        Some(of.run.run_id) != run_id && of.same_file && of.source_name == name && of.read.bytes > state.bytes
    };
    let Some(cut) = earlier.iter().filter(is_cut).max_by_key(|of| of.run.run_id) else {
        return Ok(rejection);
    };
    let (before, earlier) = (cut.read.bytes, cut.run.run_id);
    Ok(Rejection {
        reason: format!(
            "{}; the file was shortened from {before} bytes or more, which run {earlier} has",
            rejection.reason
        )
        .into(),
        remedy: "make the tool that truncates it move it away instead, so that its writer begins a new file \
            with a header"
            .into(),
        ..rejection
    })
}
