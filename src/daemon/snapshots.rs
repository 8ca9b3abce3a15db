//! Copies of the database for readers, beside the daemon: when conclusions were drawn, and not too often.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::Notify;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::metrics::Metrics;
use armwatch_config::SnapshotSettings;
use armwatch_store::Store;

/// Writes copies beside the daemon.
#[derive(Debug)]
pub struct Snapshots {
    concluded: Arc<Notify>,
    task: JoinHandle<()>,
}

impl Snapshots {
    /// Writes a copy now, and one each time something was concluded since the last, until `stop` is cancelled; then a
    /// last one where it is due.
    #[must_use]
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

    /// Hears that there is something new.
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
            () = stop.cancelled() => return,
            () = concluded.notified() => {}
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
