//! The life of the daemon: look at the folders, take what has settled, stop when told.
//!
//! File events only say "look again"; the scan decides, and comparing it with the ledger makes
//! looking twice harmless.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tokio::signal::unix::{SignalKind, signal};
use tokio_util::sync::CancellationToken;

use crate::alert;
use crate::ingest::settle::{Observation, Settling};
use crate::ingest::watch::{self, Complaints, FoundFile};
use crate::pipeline::{Outcome, Pipeline, PipelineError, Retry};

/// Hints that arrive within this time cause one scan: a copy of a large file makes thousands.
const HINT_PAUSE: Duration = Duration::from_millis(100);

/// What the daemon knows of a file between two scans.
#[derive(Debug)]
enum FileState {
    /// Still being written, as far as can be seen.
    Settling(Settling),
    /// Taken at this size and modification time.
    Taken(Observation),
}

/// Watches the configured folders until `stop` is cancelled, then finishes the cycle in hand.
/// `report` hears the outcome of every export.
///
/// # Errors
/// [`PipelineError`] where the daemon cannot go on: a full disk, or another daemon on the database.
pub async fn watch(
    pipeline: &Pipeline,
    stop: &CancellationToken,
    mut report: impl FnMut(&Path, &Outcome),
) -> Result<(), PipelineError> {
    let _claim = pipeline.store().claim().map_err(PipelineError::from)?;
    let settings = pipeline.config().watch.clone();
    let (mut watcher, mut hints) = watch::watch_folders(&settings.folders);
    let mut complaints = Complaints::default();
    let mut states: HashMap<PathBuf, FileState> = HashMap::new();
    while !stop.is_cancelled() {
        let folders = settings.folders.clone();
        let scan = tokio::task::spawn_blocking(move || watch::scan(&folders)).await?;
        complaints.warn(&scan);
        states.retain(|path, _| scan.files.iter().any(|file| file.path == *path));
        for file in &scan.files {
            if stop.is_cancelled() || !is_due(&mut states, file, settings.settle) {
                continue;
            }
            let outcome = match pipeline.process(&file.path, Retry::Never, stop, |_| ()).await {
                Err(PipelineError::Store(error)) if !error.is_fatal() => {
                    tracing::warn!(file = %file.path.display(), %error, "not stored now; trying again");
                    states.remove(&file.path);
                    continue;
                }
                outcome => outcome?,
            };
            log_outcome(&file.path, &outcome);
            report(&file.path, &outcome);
            if matches!(outcome, Outcome::Changed) {
                states.remove(&file.path);
            }
        }
        tokio::select! {
            () = stop.cancelled() => {}
            () = tokio::time::sleep(settings.scan_interval) => {}
            _ = hints.recv() => tokio::time::sleep(HINT_PAUSE).await,
        }
        watcher.watch_missing();
    }
    Ok(())
}

/// Whether a file has settled and was not taken as it is now. Notes what was seen.
fn is_due(states: &mut HashMap<PathBuf, FileState>, file: &FoundFile, settle: Duration) -> bool {
    let seen = Observation { size: file.size, modified: file.modified, at: Instant::now() };
    let settling = match states.get(&file.path) {
        Some(FileState::Taken(taken)) if taken.size == seen.size && taken.modified == seen.modified => {
            return false;
        }
        Some(FileState::Settling(settling)) => settling.again(seen),
        Some(FileState::Taken(_)) | None => Settling::first(seen),
    };
    let due = settling.is_settled(settle);
    let state = if due { FileState::Taken(seen) } else { FileState::Settling(settling) };
    states.insert(file.path.clone(), state);
    due
}

/// Logs what became of an export, by consequence.
fn log_outcome(path: &Path, outcome: &Outcome) {
    let file = path.display();
    match outcome {
        Outcome::Stored(run) => {
            tracing::info!(%file, robot = %run.robot, run_id = run.run_id, cycles = run.cycles, rows = run.rows, "stored");
            for (cycle, reason) in &run.refused {
                tracing::warn!(%file, cycle, "no parameters: {reason}");
            }
            for anomaly in &run.new_anomalies {
                alert::log_opened(anomaly);
            }
        }
        Outcome::AlreadyStored { run_id } => tracing::debug!(%file, run_id, "already stored"),
        Outcome::Quarantined { rejection, .. } => tracing::warn!("quarantined: {rejection}"),
        Outcome::Interrupted => {
            tracing::info!(%file, "stopped at a cycle; the rest follows at the next start")
        }
        Outcome::Changed => tracing::info!(%file, "changed while being read; looking again"),
    }
}

/// A token that SIGINT and SIGTERM cancel. A second signal ends the process at once, which is safe:
/// what is done is committed.
///
/// # Errors
/// If the handlers cannot be installed.
pub fn stop_on_signal() -> std::io::Result<CancellationToken> {
    let stop = CancellationToken::new();
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let token = stop.clone();
    tokio::spawn(async move {
        for first in [true, false] {
            let name = tokio::select! {
                _ = terminate.recv() => "SIGTERM",
                _ = interrupt.recv() => "SIGINT",
            };
            if first {
                tracing::info!("{name}: finishing the cycle in hand; send it again to stop at once");
                token.cancel();
            } else {
                std::process::exit(130);
            }
        }
    });
    Ok(stop)
}
