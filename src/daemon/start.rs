//! Work before the daemon watches: stored cycles of another estimator, files that were started before.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use super::file_schedule::KnownFile;
use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::reweight::{Reweighted, Reweighting};
use armwatch_store::{StoreError, UnfinishedSource};

/// Interval of progress messages while stored cycles are identified again at the start.
const REWEIGHTING_SAID: Duration = Duration::from_secs(5);

/// Pause before the database is queried again after a failure.
const STORE_PAUSE: Duration = Duration::from_secs(1);

/// Retries a start's access to the database while another program locks it or its server does not answer; `None` if a
/// stop comes first.
pub(super) async fn patiently<T>(
    stop: &CancellationToken,
    mut attempt: impl AsyncFnMut() -> Result<T, PipelineError>,
) -> Result<Option<T>, PipelineError> {
    loop {
        match attempt().await {
            Err(PipelineError::Store(
                error @ (StoreError::Busy { .. }
                | StoreError::Unreachable { .. }
                | StoreError::LeaseEnded { .. }),
            )) => {
                tracing::warn!(%error, "the daemon cannot start now; trying again");
            }
            done => return done.map(Some),
        }
        tokio::select! {
            () = stop.cancelled() => return Ok(None),
            () = tokio::time::sleep(STORE_PAUSE) => {}
        }
    }
}

/// Files whose runs are incomplete, and how they continue.
pub(super) fn begun_before(unfinished: &[UnfinishedSource]) -> HashMap<PathBuf, KnownFile> {
    let begun = |source: &UnfinishedSource| {
        if source.growing {
            return KnownFile::Growing;
        }
        KnownFile::Settled(source.bytes, source.modified.as_microsecond())
    };
    unfinished.iter().map(|source| (source.path.clone(), begun(source))).collect()
}

/// Identifies stored cycles of another estimator than the configured one again. Returns `false` if a stop was requested
/// before all were done: nothing may be read or concluded then.
pub(super) async fn reweight(pipeline: &Pipeline, stop: &CancellationToken) -> Result<bool, PipelineError> {
    let estimator = pipeline.config().analysis.estimator.name();
    let mut said = Instant::now();
    let mut progress = |at: Reweighting| {
        if said.elapsed() > REWEIGHTING_SAID {
            said = Instant::now();
            tracing::info!(done = at.done, total = at.total, "cycles identified again as {estimator}");
        }
    };
    let Reweighted { cycles, kept, interrupted } = pipeline.reweight(stop, &mut progress).await?;
    if cycles > 0 {
        tracing::info!(cycles, "identified again from their factors as {estimator}");
    }
    if kept > 0 {
        tracing::warn!(
            kept,
            "cycles keep another estimator than {estimator}; view cycles, estimator_reason, has the reason"
        );
    }
    Ok(!interrupted)
}
