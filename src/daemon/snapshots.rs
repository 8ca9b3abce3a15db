//! Copies of the database for readers, made in parallel with the daemon: after conclusions, and not too often.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::metrics::Metrics;
use armwatch_config::SnapshotSettings;
use armwatch_store::Store;

/// Writes copies in parallel with the daemon.
#[derive(Debug)]
pub struct Snapshots {
    concluded: Arc<Notify>,
    task: JoinHandle<()>,
}

impl Snapshots {
    /// Writes a copy now, and another each time conclusions were drawn since the last, until `stop` is cancelled; then
    /// a last one if it is due.
    pub fn start(
        store: Store,
        settings: SnapshotSettings,
        metrics: Metrics,
        stop: CancellationToken,
    ) -> Self {
        let concluded = Arc::new(Notify::new());
        concluded.notify_one();
        let task = tokio::spawn(write(store, settings, metrics, stop, Arc::clone(&concluded)));
        Self { concluded, task }
    }

    /// Reports that there is something new.
    pub fn note(&self) {
        self.concluded.notify_one();
    }

    /// Waits for the end.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "writing snapshots ended");
        }
    }
}

async fn write(
    store: Store,
    settings: SnapshotSettings,
    metrics: Metrics,
    stop: CancellationToken,
    concluded: Arc<Notify>,
) {
    let mut earliest = Instant::now();
    loop {
        tokio::select! {
            // conclusions drawn during the last copy are included even if the stop arrived then too
            biased;
            () = concluded.notified() => {}
            () = stop.cancelled() => return,
        }
        let is_ending = tokio::select! {
            () = stop.cancelled() => true,
            () = tokio::time::sleep_until(earliest) => false,
        };
        let began = Instant::now();
        match store.snapshot(&settings.file).await {
            Ok(bytes) => {
                metrics.snapshot(bytes, began.elapsed());
                let took = milliseconds(began.elapsed());
                tracing::debug!(file = %settings.file.display(), bytes, took_ms = took, "snapshot");
            }
            Err(error) => {
                metrics.snapshot_failed();
                tracing::warn!(
                    file = %settings.file.display(), %error,
                    "no snapshot; the earlier one stays, trying again later"
                );
            }
        }
        if is_ending {
            return;
        }
        earliest = Instant::now() + settings.interval;
    }
}

fn milliseconds(time: Duration) -> u64 {
    u64::try_from(time.as_millis()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tokio takes one of several branches that are ready at random, so one round proves little.
    const ROUNDS: usize = 20;

    #[tokio::test]
    async fn a_stop_during_a_copy_leaves_nothing_out_that_was_concluded_meanwhile() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("fleet.db")).await.expect("a database");
        for round in 0..ROUNDS {
            let file = folder.path().join(format!("copy{round}.db"));
            let settings = SnapshotSettings { file: file.clone(), interval: Duration::from_secs(3600) };
            let stop = CancellationToken::new();
            let snapshots = Snapshots::start(store.clone(), settings, Metrics::counting(), stop.clone());
            // both before the task has started: for the task they arrive during a copy
            snapshots.note();
            stop.cancel();
            snapshots.ended().await;
            assert!(file.exists(), "round {round}");
        }
    }
}
