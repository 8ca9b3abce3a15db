//! Passes events on to routes and sends due messages, with one task per route, so that a slow receiver delays neither
//! the others nor the pipeline.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use tokio_util::sync::CancellationToken;

use super::worker::Worker;
use armwatch_config::{AlertSettings, Config};
use armwatch_store::Store;

/// Time for messages in transit when the program stops; undelivered ones are sent at the next start.
const STOP_TIME: Duration = Duration::from_secs(5);

/// Shortest and longest time between two looks for unacknowledged alarms.
const REMIND_LOOK: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(60));

/// Running delivery, in parallel with the daemon.
#[derive(Debug)]
pub struct Dispatcher {
    nudge: watch::Sender<()>,
    task: JoinHandle<()>,
}

impl Dispatcher {
    /// Delivers with the newest of `configs`, until `stop` is cancelled.
    pub fn start(store: Store, configs: watch::Receiver<Arc<Config>>, stop: CancellationToken) -> Self {
        let (nudge, heard) = watch::channel(());
        Self { nudge, task: tokio::spawn(deliver(store, configs, stop, heard)) }
    }

    /// Reports that there may be new events.
    pub fn nudge(&self) {
        self.nudge.send_replace(());
    }

    /// Waits for the end.
    pub async fn ended(self) {
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the delivery of alarms ended");
        }
    }
}

async fn deliver(
    store: Store,
    mut configs: watch::Receiver<Arc<Config>>,
    stop: CancellationToken,
    heard: watch::Receiver<()>,
) {
    while !stop.is_cancelled() {
        let settings = Arc::new(configs.borrow_and_update().alerts.clone());
        let end = stop.child_token();
        let mut tasks = start(&store, &settings, &end, &heard);
        loop {
            tokio::select! {
                () = stop.cancelled() => break,
                changed = configs.changed() => match changed {
                    Ok(()) if configs.borrow().alerts == *settings => {}
                    Ok(()) => {
                        tracing::info!("the routes of alarms have changed");
                        break;
                    }
                    // the configuration no longer changes
                    Err(_) => {
                        stop.cancelled().await;
                        break;
                    }
                },
            }
        }
        end.cancel();
        let ending = async {
            while let Some(ended) = tasks.join_next().await {
                if let Err(error) = ended {
                    tracing::error!(%error, "a route of alarms ended");
                }
            }
        };
        if tokio::time::timeout(STOP_TIME, ending).await.is_err() {
            tracing::warn!("messages on their way were cut by the stop; they are sent again");
            tasks.shutdown().await;
        }
    }
}

fn start(
    store: &Store,
    settings: &Arc<AlertSettings>,
    end: &CancellationToken,
    heard: &watch::Receiver<()>,
) -> JoinSet<()> {
    let mut tasks = JoinSet::new();
    for place in 0..settings.routes.len() {
        if let Some(worker) = Worker::new(store.clone(), Arc::clone(settings), place, end.clone()) {
            tasks.spawn(worker.run(heard.clone()));
        }
    }
    tasks.spawn(retire(store.clone(), Arc::clone(settings)));
    if let Some(after) = settings.remind_after {
        tasks.spawn(remind(store.clone(), after, end.clone()));
    }
    tasks
}

/// Closes the deliveries of removed routes.
async fn retire(store: Store, settings: Arc<AlertSettings>) {
    let names: Vec<&str> = settings.routes.iter().map(|route| route.name.as_str()).collect();
    match store.retire_routes(&names).await {
        Ok(0) => {}
        Ok(spared) => {
            tracing::warn!(spared, "messages waited for routes that are not in the configuration any more");
        }
        Err(error) => tracing::warn!(%error, "routes that are gone were not ended; at the next start"),
    }
}

/// Sends unacknowledged alarms again.
async fn remind(store: Store, after: Duration, end: CancellationToken) {
    let pause = (after / 4).clamp(REMIND_LOOK.0, REMIND_LOOK.1);
    loop {
        match store.remind(Timestamp::now(), after).await {
            Ok(0) => {}
            Ok(alarms) => tracing::debug!(alarms, "nobody has answered; told again"),
            Err(error) => tracing::warn!(%error, "unanswered alarms not looked at now; trying again"),
        }
        tokio::select! {
            () = end.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
    }
}
