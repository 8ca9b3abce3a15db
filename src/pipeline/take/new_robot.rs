//! Exports of an unknown robot: a name that may be another robot's is questioned, and one that does not match the
//! pattern of file names is reported.

use std::path::Path;

use super::intake::{Recognised, file_name};
use crate::pipeline::context::{Pipeline, PipelineError};
use armwatch_ingest::bytes::access::metadata;
use armwatch_ingest::rejection::Rejection;
use armwatch_model::robot::name::{NameLikeness, likeness, original_of};
use armwatch_model::text;

/// Why an export does not become the first of a new robot; `None` if its robot is known, or the name is clearly its
/// own.
pub(in crate::pipeline) async fn question(
    pipeline: &Pipeline,
    path: &Path,
    recognised: &Recognised<'_>,
) -> Result<Option<Rejection>, PipelineError> {
    let robot = &recognised.robot;
    // the configuration names it, which is an answer
    if recognised.entry.robots == *robot || pipeline.store().knows_robot(robot).await? {
        return Ok(None);
    }
    let mut known = pipeline.store().known_robots().await?;
    if let Some(original) = original_of(robot)
        && let Some(beside) = path.file_name().and_then(|name| name.to_str())
    {
        // the original may arrive later
        let beside = path.with_file_name(beside.replacen(robot.as_str(), original, 1));
        if pipeline.with_files(move || metadata(&beside).is_ok()).await? {
            known.push(original.to_owned());
        }
    }
    let own = format!("add a [[robot]] entry with name = \"{robot}\" if it is a separate robot");
    let (reason, remedy) = match likeness(robot, known.iter().map(String::as_str)) {
        None => return Ok(None),
        Some(NameLikeness::Spelling(same)) => (
            format!(
                "no robot \"{robot}\" is known, and the name differs from \"{same}\" only in case, blanks or form"
            ),
            format!("rename the file if it is an export of {same}; {own}"),
        ),
        Some(NameLikeness::Copy(original)) => (
            format!(
                "no robot \"{robot}\" is known, and the file is named as a copy of an export of {original}"
            ),
            format!("delete the copy, or rename it if it is another test of {original}; {own}"),
        ),
    };
    Ok(Some(Rejection::of_file(path, reason, remedy)))
}

/// Reports that a file has created a new robot although the pattern of file names does not match it.
pub(in crate::pipeline) async fn say_unmatched(
    pipeline: &Pipeline,
    path: &Path,
    robot: &str,
) -> Result<(), PipelineError> {
    let is_matched = pipeline.config().recognition.fits(&file_name(path));
    if !is_matched && !pipeline.store().knows_robot(robot).await? {
        tracing::warn!(
            file = %text::of_path(path),
            robot,
            "recognition.file_name does not match the name, which becomes that of a new robot; if it \
            belongs to no robot, rename the file or change the pattern, and exclude its run with `armwatch \
            set-aside RUN`"
        );
    }
    Ok(())
}
