//! After a run is complete: its export goes to the archive, where one is configured.

use std::path::{Path, PathBuf};

use crate::ingest::archive::{Archived, archive};
use crate::pipeline::{Outcome, Pipeline, intake};
use crate::run::RunStatus;

/// Archives the export at `path` if its run is complete. Whatever fails is logged and leaves the source where
/// it is; it is tried again when the file is looked at anew, at the latest after a restart.
pub async fn after(pipeline: &Pipeline, path: &Path, outcome: &Outcome) {
    let Some(folder) = pipeline.config().watch.archive.clone() else { return };
    let (Outcome::Stored(_) | Outcome::AlreadyStored { .. }, Some(run_id)) = (outcome, outcome.run_id())
    else {
        return;
    };
    let file = path.display();
    match moved(pipeline, path, folder, run_id).await {
        Ok(Some(Archived::At(target))) => tracing::info!(%file, target = %target.display(), "archived"),
        Ok(Some(Archived::Changed)) => tracing::info!(%file, "not archived: it changed meanwhile"),
        Ok(None) => {}
        Err(error) => tracing::warn!(%file, %error, "not archived; it stays where it is"),
    }
}

async fn moved(
    pipeline: &Pipeline,
    path: &Path,
    folder: PathBuf,
    run_id: i64,
) -> Result<Option<Archived>, Box<dyn std::error::Error + Send + Sync>> {
    let store = pipeline.store();
    let is_complete = store.known_run(run_id).await?.is_some_and(|run| run.status == RunStatus::Complete);
    let Some(run) = store.run_source(run_id).await?.filter(|_| is_complete) else { return Ok(None) };
    if is_inside(path, &folder) {
        // a link or mount lets the archive be seen in a watched folder
        return Ok(None);
    }
    let below = below(path, &pipeline.config().watch.folders);
    let source = path.to_owned();
    let content = run.content_hash;
    let archived = tokio::task::spawn_blocking(move || archive(&source, &content, &folder, &below)).await??;
    if let Archived::At(target) = &archived
        && let Some(state) = intake::source_state(target)
    {
        // commands that read samples again find the export there
        store.remember_source(&target.display().to_string(), state, run_id).await?;
    }
    Ok(Some(archived))
}

fn is_inside(path: &Path, folder: &Path) -> bool {
    let real = std::fs::canonicalize(folder);
    real.is_ok_and(|folder| std::fs::canonicalize(path).is_ok_and(|path| path.starts_with(folder)))
}

/// The sub-folder of its watched folder that a file lies in, which it keeps.
fn below(path: &Path, folders: &[PathBuf]) -> PathBuf {
    let parent = path.parent().unwrap_or(Path::new(""));
    folders.iter().find_map(|folder| parent.strip_prefix(folder).ok()).unwrap_or(Path::new("")).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sub_folders_are_kept() {
        let folders = [PathBuf::from("inbox"), PathBuf::from("/mnt/cell 7")];
        assert_eq!(below(Path::new("inbox/R00.csv"), &folders), Path::new(""));
        assert_eq!(below(Path::new("/mnt/cell 7/2026/01/R00.csv"), &folders), Path::new("2026/01"));
        assert_eq!(below(Path::new("elsewhere/R00.csv"), &folders), Path::new(""));
    }
}
