//! Events that depend on time alone: robots whose tests stop arriving, and the end of shelving.
//!
//! The expected time of a robot's next test follows from its history and is stored with its conclusions. Only a running
//! program can decide that this time has passed, and only for robots whose tests it saw arrive in time: an archive that
//! is read years later is not overdue.

use std::collections::HashSet;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use super::DaemonEvent;
use crate::alert;
use crate::pipeline::context::Outcome;
use armwatch_store::{Store, StoreError};

/// Time between two checks: short compared with the shortest interval of tests; a check is one query of a small table.
const LOOK: Duration = Duration::from_secs(10);

/// News of the daemon's work.
enum News {
    /// A run of this robot was stored.
    Stored(String),
    /// Conclusions were drawn for this robot.
    Concluded(String),
}

/// Watches for overdue tests in parallel with the daemon.
#[derive(Debug)]
pub struct OverdueWatch {
    news: mpsc::UnboundedSender<News>,
    task: JoinHandle<()>,
}

impl OverdueWatch {
    /// Starts watching, until `stop` is cancelled.
    pub fn start(store: Store, stop: CancellationToken) -> Self {
        let (news, heard) = mpsc::unbounded_channel();
        Self { news, task: tokio::spawn(look(store, stop, heard)) }
    }

    /// Receives the daemon's reports.
    pub fn note(&self, event: &DaemonEvent<'_>) {
        let news = match event {
            DaemonEvent::Export(_, Outcome::Stored(run)) => News::Stored(run.robot.clone()),
            DaemonEvent::Concluded(concluded) => News::Concluded(concluded.robot.clone()),
            DaemonEvent::Export(..) => return,
        };
        // the receiver is gone when the daemon ends
        let _ = self.news.send(news);
    }

    /// Waits for the end.
    pub async fn ended(self) {
        drop(self.news);
        if let Err(error) = self.task.await {
            tracing::error!(%error, "the check for overdue tests ended");
        }
    }
}

async fn look(store: Store, stop: CancellationToken, mut heard: mpsc::UnboundedReceiver<News>) {
    let (mut arrived, mut concluded): (HashSet<String>, HashSet<String>) = (HashSet::new(), HashSet::new());
    let mut timer = tokio::time::interval(LOOK);
    loop {
        let done = tokio::select! {
            () = stop.cancelled() => return,
            news = heard.recv() => match news {
                None => return,
                Some(News::Stored(robot)) => {
                    arrived.insert(robot);
                    Ok(())
                }
                Some(News::Concluded(robot)) => {
                    if arrived.remove(&robot) {
                        concluded.insert(robot);
                    }
                    watch_for_tests(&store, &mut concluded).await
                }
            },
            _ = timer.tick() => match watch_for_tests(&store, &mut concluded).await {
                Ok(()) => say_due(&store).await,
                failed => failed,
            },
        };
        if let Err(error) = done {
            tracing::warn!(%error, "overdue tests not checked now; trying again");
        }
    }
}

/// Expects the next test of these robots, and forgets each robot once its expectation is stored.
async fn watch_for_tests(store: &Store, robots: &mut HashSet<String>) -> Result<(), StoreError> {
    while let Some(robot) = robots.iter().next().cloned() {
        store.watch_for_tests(&robot, Timestamp::now()).await?;
        robots.remove(&robot);
    }
    Ok(())
}

/// Reports overdue robots, and ends shelving that has expired.
async fn say_due(store: &Store) -> Result<(), StoreError> {
    for robot in store.mark_overdue(Timestamp::now()).await? {
        alert::log_overdue(&robot);
    }
    // the routes of alarms send the events that this writes
    store.end_shelving(Timestamp::now()).await?;
    Ok(())
}
