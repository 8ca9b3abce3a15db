//! Finds the run of an export's content, and missing parts of it.

use std::path::Path;

use super::intake::{self, Recognised};
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_ingest::bytes::parts::RecordingParts;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::joined;
use armwatch_model::run::{ContentHash, RunStatus};
use armwatch_store::KnownRun;

/// The run of a content: of the same robot, or of another one whose exports give the same rows, because the file was
/// renamed. An export of several robots has a run for each. A superseded or set-aside run stays that of its robot.
pub(super) async fn run_of_content(
    pipeline: &Pipeline,
    path: &Path,
    content: &ContentHash,
    recognised: Option<&Recognised<'_>>,
) -> Result<Option<KnownRun>, PipelineError> {
    let mut runs = pipeline.store().runs_of_content(content).await?;
    if let Some(of) = recognised {
        let (config, name) = (pipeline.config(), intake::file_name(path));
        runs.retain(|(run, robot, source)| {
            let has_ended = matches!(run.status, RunStatus::Superseded | RunStatus::SetAside);
            (*robot == of.robot || !has_ended) && config.reads_alike((&of.robot, &name), (robot, source))
        });
        runs.sort_by_key(|(_, robot, _)| *robot != of.robot);
    }
    Ok(runs.into_iter().next().map(|(run, ..)| run))
}

/// Why a recording in several files is not read: a part is missing.
pub(super) async fn missing_part(
    pipeline: &Pipeline,
    path: &Path,
) -> Result<Option<Rejection>, PipelineError> {
    let Some(parts) = RecordingParts::of(path) else { return Ok(None) };
    let missing = pipeline.with_files(move || parts.missing()).await?;
    Ok(missing.map(|missing| joined::missing_part(path, &missing)))
}
