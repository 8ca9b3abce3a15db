//! Moves the export of a complete run to the archive, if one is configured.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use super::export_tasks::on_own_thread;
use crate::pipeline::context::{Outcome, Pipeline, PipelineError, Retry};
use crate::pipeline::take::intake;
use armwatch_ingest::bytes::access::FileAccess;
use armwatch_ingest::bytes::parts::RecordingParts;
use armwatch_ingest::find::archive::{Archived, archive};
use armwatch_ingest::find::watch;
use armwatch_model::run::RunStatus;
use armwatch_model::text;
use armwatch_store::SourceState;

/// If disk or file server exceed this time plus the time of a slow copy, they do not answer, and the export stays.
const ANSWERS_WITHIN: Duration = Duration::from_secs(60);

/// Slowest accepted copy, bytes per millisecond: an export is written, and read twice.
const SLOWEST_BYTES_MS: u64 = 500;

/// Copies into the archive that have not ended in time. Until they end, further exports stay, so that an archive
/// without answer blocks no export and only one thread.
static HANGING: AtomicUsize = AtomicUsize::new(0);

/// Archives the export at `path`, of `bytes` bytes, if its run is complete. If the archive refuses, that is logged and
/// the source stays. The daemon tries again when it next sees the file, at the latest after a restart.
///
/// # Errors
/// [`PipelineError`] if the database cannot be synced. Linux reports a lost write only once, so the daemon cannot
/// continue: committed rows may be missing after the next start, when this source is read again.
pub async fn after(
    pipeline: &Pipeline,
    path: &Path,
    bytes: u64,
    outcome: &Outcome,
) -> Result<(), PipelineError> {
    let Some(folder) = pipeline.config().watch.archive.clone() else { return Ok(()) };
    let (Outcome::Stored(_) | Outcome::AlreadyStored { .. }, Some(run_id)) = (outcome, outcome.run_id())
    else {
        return Ok(());
    };
    // the next part of a recording is read together with those before it
    if RecordingParts::of(path).is_some() || pipeline.config().part_of(&text::of_file_name(path)).is_some() {
        return Ok(());
    }
    // a commit survives the end of the process, but only a synced one survives a power failure
    pipeline.store().sync().await?;
    let file = text::of_path(path);
    match moved(pipeline, (path, bytes), folder, run_id).await {
        Ok(Some(Archived::At(target))) => tracing::info!(%file, target = %text::of_path(&target), "archived"),
        Ok(Some(Archived::Changed)) => tracing::info!(%file, "not archived: it changed in the meantime"),
        Ok(None) => {}
        Err(error) => tracing::warn!(%file, %error, "not archived; it stays at its place"),
    }
    Ok(())
}

async fn moved(
    pipeline: &Pipeline,
    (path, bytes): (&Path, u64),
    folder: PathBuf,
    run_id: i64,
) -> Result<Option<Archived>, Box<dyn std::error::Error + Send + Sync>> {
    let store = pipeline.store();
    let is_complete = store.known_run(run_id).await?.is_some_and(|run| run.status == RunStatus::Complete);
    let Some(run) = store.run_source(run_id).await?.filter(|_| is_complete) else { return Ok(None) };
    let below = below(path, &pipeline.config().watch.folders);
    let (source, content) = (path.to_owned(), run.content_hash);
    let archiving = move || {
        if is_inside(&source, &folder) {
            // a link or mount makes the archive visible in a watched folder
            return Ok((None, None));
        }
        let archived = archive(&source, &content, &folder, &below)?;
        let state = match &archived {
            Archived::At(target) => intake::source_state(target),
            Archived::Changed => None,
        };
        std::io::Result::Ok((Some(archived), state))
    };
    let time = ANSWERS_WITHIN + Duration::from_millis(bytes / SLOWEST_BYTES_MS);
    let (archived, state) = within(&HANGING, time, archiving).await??;
    if let (Some(Archived::At(target)), Some(state)) = (&archived, state) {
        // commands that read samples again find the export there
        store.remember_source(&intake::ledger_path(store, target), state, run_id).await?;
    }
    Ok(archived)
}

/// Runs blocking work. Returns an error if it takes longer than `time`, or if earlier work still hangs.
async fn within<T: Send + 'static>(
    hanging: &'static AtomicUsize,
    time: Duration,
    work: impl FnOnce() -> T + Send + 'static,
) -> std::io::Result<T> {
    let no_answer = |detail: String| std::io::Error::new(std::io::ErrorKind::TimedOut, detail);
    if hanging.load(Ordering::Relaxed) > 0 {
        return Err(no_answer("the archive has not answered since an earlier export".to_owned()));
    }
    let (answer, mut answered) = oneshot::channel();
    tokio::task::spawn_blocking(move || {
        if answer.send(work()).is_err() {
            // it was late and counted
            hanging.fetch_sub(1, Ordering::Relaxed);
        }
    });
    if let Ok(ended) = tokio::time::timeout(time, &mut answered).await {
        return ended.map_err(|_| std::io::Error::other("internal error while archiving"));
    }
    hanging.fetch_add(1, Ordering::Relaxed);
    answered.close();
    match answered.try_recv() {
        Ok(done) => {
            hanging.fetch_sub(1, Ordering::Relaxed);
            Ok(done)
        }
        Err(_) => Err(no_answer(format!("the archive has not answered for {} s", time.as_secs()))),
    }
}

/// Reads exports in the archive that the database does not know: it lost their runs with a disk, or it is an older copy
/// that was restored. Their sources are gone.
pub async fn take_missed(pipeline: Pipeline, stop: CancellationToken) {
    let Some(folder) = pipeline.config().watch.archive.clone() else { return };
    let found = tokio::task::spawn_blocking(move || watch::scan(&[from_root(&folder)], false)).await;
    let files = match found {
        Ok(scan) => scan.files,
        Err(error) => {
            tracing::error!(%error, "the archive was not searched for exports that the database lacks");
            return;
        }
    };
    let taking = |path: PathBuf| {
        let (pipeline, stop) = (pipeline.clone(), stop.clone());
        async move { take_if_missed(&pipeline, &path, &stop).await }
    };
    let robots = each_alone(files.into_iter().map(|file| file.path), &stop, taking).await;
    for robot in robots {
        if stop.is_cancelled() {
            // they are concluded when the daemon starts again
            return;
        }
        // a failure of one robot's history is stored and delays no other robot
        if let Err(error) = pipeline.conclude_isolated(&robot).await {
            tracing::warn!(robot, %error, "conclusions are drawn later");
        }
    }
}

/// Reads files one after the other, each in a separate task: a failure or panic is logged and does not affect the other
/// files. Returns the robots whose histories change.
async fn each_alone<F>(
    files: impl Iterator<Item = PathBuf>,
    stop: &CancellationToken,
    take: impl Fn(PathBuf) -> F,
) -> BTreeSet<String>
where
    F: Future<Output = Result<Option<String>, PipelineError>> + Send + 'static,
{
    let mut robots = BTreeSet::new();
    for path in files {
        if stop.is_cancelled() {
            break;
        }
        let file = text::of_path(&path);
        let taken = on_own_thread(FileAccess::default(), take(path)).await;
        match taken.map_err(PipelineError::from).and_then(|taken| taken) {
            Ok(robot) => robots.extend(robot),
            Err(error) => tracing::warn!(file, %error, "in the archive, but not read"),
        }
    }
    robots
}

/// Reads an export of the archive unless it is known; returns the robot whose history it changes.
async fn take_if_missed(
    pipeline: &Pipeline,
    path: &Path,
    stop: &CancellationToken,
) -> Result<Option<String>, PipelineError> {
    let Some(state) = intake::source_state(path) else { return Ok(None) };
    // earlier versions stored the path as given, and the modification time
    let given = pipeline.config().watch.archive.as_deref().and_then(|folder| {
        Some(folder.join(path.strip_prefix(from_root(folder)).ok()?).display().to_string())
    });
    let earlier = SourceState { modified: intake::file_time(path), ..state };
    for (name, state) in [(Some(intake::ledger_path(pipeline.store(), path)), state), (given, earlier)] {
        if let Some(name) = name
            && pipeline.store().known_source(&name, state).await?.is_some()
        {
            return Ok(None);
        }
    }
    match pipeline.process(path, Retry::Never, stop, |_| ()).await? {
        Outcome::Stored(run) => {
            tracing::warn!(
                file = %text::of_path(path), run_id = run.run_id,
                "in the archive, but not in the database: read again"
            );
            Ok(Some(run.robot))
        }
        _ => Ok(None),
    }
}

fn is_inside(path: &Path, folder: &Path) -> bool {
    let real = std::fs::canonicalize(folder);
    real.is_ok_and(|folder| std::fs::canonicalize(path).is_ok_and(|path| path.starts_with(folder)))
}

/// The sub-folder of a file within its watched folder, which the archive keeps.
fn below(path: &Path, folders: &[PathBuf]) -> PathBuf {
    let path = from_root(path);
    let parent = path.parent().unwrap_or(Path::new(""));
    let below = folders.iter().find_map(|folder| parent.strip_prefix(from_root(folder)).ok());
    below.unwrap_or(Path::new("")).to_owned()
}

/// An absolute path, without resolving links.
pub fn from_root(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_store::StoreError;

    #[test]
    fn sub_folders_are_kept() {
        let folders = [PathBuf::from("inbox"), PathBuf::from("/mnt/cell 7")];
        assert_eq!(below(Path::new("inbox/R00.csv"), &folders), Path::new(""));
        assert_eq!(below(Path::new("/mnt/cell 7/2026/01/R00.csv"), &folders), Path::new("2026/01"));
        assert_eq!(below(Path::new("elsewhere/R00.csv"), &folders), Path::new(""));
    }
    #[tokio::test]
    async fn an_export_that_fails_leaves_the_others_of_the_archive() {
        let taking = |path: PathBuf| async move {
            match path.to_str() {
                Some("broken") => Err(PipelineError::Store(StoreError::Refused {
                    path: "fleet.db".into(),
                    detail: "NOT NULL".into(),
                })),
                Some("panics") => panic!("index 7 of 3"),
                Some("known") => Ok(None),
                _ => Ok(Some(path.display().to_string())),
            }
        };
        let files = ["A", "panics", "broken", "known", "B"].map(PathBuf::from);
        let stop = CancellationToken::new();
        let robots = each_alone(files.clone().into_iter(), &stop, taking).await;
        assert_eq!(robots.into_iter().collect::<Vec<_>>(), ["A", "B"]);
        stop.cancel();
        assert!(each_alone(files.into_iter(), &stop, taking).await.is_empty(), "taken after a stop");
    }

    #[tokio::test]
    async fn an_archive_that_does_not_answer_is_given_up_and_left_alone_until_it_does() {
        static HANGING: AtomicUsize = AtomicUsize::new(0);
        let (release, hangs) = std::sync::mpsc::channel::<()>();
        let first = within(&HANGING, Duration::from_millis(10), move || hangs.recv().is_ok()).await;
        assert_eq!(first.unwrap_err().kind(), std::io::ErrorKind::TimedOut);
        let patient = Duration::from_secs(60);
        assert!(within(&HANGING, patient, || true).await.is_err(), "another thread would hang too");
        release.send(()).unwrap();
        while HANGING.load(Ordering::Relaxed) > 0 {
            tokio::task::yield_now().await;
        }
        assert!(within(&HANGING, patient, || true).await.unwrap());
    }
}
