//! Removes factors past their retention time, in parallel with the daemon: at its start, and once per day.

use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::pipeline::retention::{kept_since, prune};
use armwatch_config::Config;
use armwatch_store::Store;

/// Time between two removals. The space of one removal is reused until the next.
const LOOK: Duration = Duration::from_secs(24 * 3600);

/// If the latest export is older than this at the start, the clock is in doubt: a machine that starts without a network
/// may be years ahead, and a removal then could not be undone.
const DOUBTFUL: SignedDuration = SignedDuration::from_hours(31 * 24);

/// Removes factors past the retention time in `[retention]`.
#[derive(Debug)]
pub struct Pruning {
    task: JoinHandle<()>,
}

impl Pruning {
    /// Removes factors now and once per day, with the configuration in force then, until `stop` is cancelled. If the
    /// latest export is more than a month old by the clock, the first removal waits for a day.
    pub fn start(store: Store, configs: watch::Receiver<Arc<Config>>, stop: CancellationToken) -> Self {
        Self { task: tokio::spawn(look(store, configs, stop)) }
    }

    /// Waits for the end.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the deletion of old factors ended");
        }
    }
}

async fn look(store: Store, configs: watch::Receiver<Arc<Config>>, stop: CancellationToken) {
    if let Some(latest) = doubtful(&store, Timestamp::now()).await {
        tracing::warn!(
            %latest,
            "by the clock of this computer the latest export came more than a month ago: is the clock \
            right? Expired factors are deleted in a day, or now with `armwatch prune`"
        );
        if waited(&stop).await {
            return;
        }
    }
    loop {
        let kept = kept_since(&configs.borrow().retention, Timestamp::now());
        match prune(&store, &kept, &stop).await {
            Ok(runs) if runs.is_empty() => tracing::debug!("no factors have expired"),
            Ok(runs) => {
                let cycles: u64 = runs.iter().map(|run| run.cycles).sum();
                let megabytes = runs.iter().map(|run| run.bytes).sum::<u64>() / 1_000_000;
                tracing::info!(
                    runs = runs.len(),
                    cycles,
                    megabytes,
                    "factors have expired ([retention]); their space is used again"
                );
            }
            Err(error) => tracing::warn!(%error, "old factors stay for now; trying again tomorrow"),
        }
        if waited(&stop).await {
            return;
        }
    }
}

/// Waits for the next removal; returns true if the end is requested.
async fn waited(stop: &CancellationToken) -> bool {
    tokio::select! {
        () = stop.cancelled() => true,
        () = tokio::time::sleep(LOOK) => false,
    }
}

/// The arrival of the latest export, if it makes the clock `now` doubtful.
async fn doubtful(store: &Store, now: Timestamp) -> Option<Timestamp> {
    match store.last_entered_at().await {
        Ok(latest) => latest.filter(|latest| now.duration_since(*latest) > DOUBTFUL),
        Err(error) => {
            tracing::debug!(%error, "the time of the latest export is unknown");
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_clock_far_ahead_of_the_latest_export_is_doubted() {
        let folder = tempfile::tempdir().expect("a folder");
        let store = Store::open(&folder.path().join("fleet.db")).await.expect("a database");
        let in_days = |days: i64| Timestamp::now() + SignedDuration::from_hours(24 * days);
        assert_eq!(doubtful(&store, in_days(400)).await, None, "nothing was stored, nothing can be lost");
        let size = armwatch_store::SyntheticSize { robots: 1, runs: 1, cycles: 1, logs: 0 };
        store.fill_synthetic(size, std::path::Path::new("/inbox")).await.expect("a history");
        // entered at the beginning of 1970
        let entered = Timestamp::from_microsecond(1).expect("a time");
        assert_eq!(doubtful(&store, in_days(0)).await, Some(entered));
        assert_eq!(doubtful(&store, entered + SignedDuration::from_hours(30 * 24)).await, None);
    }
}
