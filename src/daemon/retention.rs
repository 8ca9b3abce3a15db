//! Taking away what has had its time, beside the daemon: at its start, and once a day.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::config::Config;
use crate::pipeline::retention::{kept_since, prune};
use crate::store::Store;

/// Time between two looks. What is removed in one leaves room for what comes until the next.
const LOOK: Duration = Duration::from_secs(24 * 3600);

/// Takes away factors that have had their time, as `[retention]` says.
#[derive(Debug)]
pub struct Pruning {
    task: JoinHandle<()>,
}

impl Pruning {
    /// Looks now and once a day, by the configuration in force then, until `stop` is cancelled.
    #[must_use]
    pub fn start(store: Store, configs: watch::Receiver<Arc<Config>>, stop: CancellationToken) -> Self {
        Self { task: tokio::spawn(look(store, configs, stop)) }
    }

    /// Waits for the end.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "taking away old factors ended");
        }
    }
}

async fn look(store: Store, configs: watch::Receiver<Arc<Config>>, stop: CancellationToken) {
    loop {
        let kept = kept_since(&configs.borrow().retention, Timestamp::now());
        match prune(&store, &kept, &stop).await {
            Ok(runs) if runs.is_empty() => tracing::debug!("no factors have had their time"),
            Ok(runs) => {
                let cycles: u64 = runs.iter().map(|run| run.cycles).sum();
                let megabytes = runs.iter().map(|run| run.bytes).sum::<u64>() / 1_000_000;
                tracing::info!(
                    runs = runs.len(),
                    cycles,
                    megabytes,
                    "factors had had their time ([retention]); the room they took is used again"
                );
            }
            Err(error) => tracing::warn!(%error, "old factors stay for now; looking again tomorrow"),
        }
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(LOOK) => {}
        }
    }
}
