//! The lock of the one daemon of a database on a server.
//!
//! The connections that write hold it, so that a daemon whose connection is lost cannot write before it has the lock
//! again: a second daemon that has taken it meanwhile is never worked against.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::{EngineConnection, EnginePool, EnginePoolOptions};

/// How long a claim waits: the server needs a moment to notice that the daemon before this one was killed.
const PATIENCE: Duration = Duration::from_secs(1);

const BETWEEN_TRIES: Duration = Duration::from_millis(50);

/// Whether the writer's connections hold the lock. Clones share it.
#[derive(Debug, Clone, Default)]
pub(in crate::store) struct DaemonLock(Arc<AtomicBool>);

impl DaemonLock {
    /// Connections of a writer that take the lock when they are opened, from the moment on that it was taken first. One
    /// that cannot have it is closed, and opened again as long as a turn at the pool may wait.
    pub(in crate::store) fn of_writer(&self, options: EnginePoolOptions) -> EnginePoolOptions {
        let lock = self.clone();
        options.after_connect(move |connection, _| {
            let is_daemon = lock.0.load(Ordering::SeqCst);
            Box::pin(async move {
                if is_daemon && !take(connection).await? {
                    return Err(sqlx::Error::Protocol("another daemon has taken over the database".into()));
                }
                Ok(())
            })
        })
    }

    /// Takes the lock with the connection that writes; whether it was free.
    pub(in crate::store) async fn claim(&self, writer: &EnginePool) -> Result<bool, sqlx::Error> {
        let mut connection = writer.acquire().await?;
        let deadline = Instant::now() + PATIENCE;
        let mut is_taken = take(&mut connection).await?;
        while !is_taken && Instant::now() < deadline {
            tokio::time::sleep(BETWEEN_TRIES).await;
            is_taken = take(&mut connection).await?;
        }
        self.0.store(is_taken, Ordering::SeqCst);
        Ok(is_taken)
    }

    /// Gives the lock back, as soon as the writer has a turn for it; it goes with the connection otherwise.
    pub(in crate::store) fn leave(&self, writer: &EnginePool) {
        self.0.store(false, Ordering::SeqCst);
        let writer = writer.clone();
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(async move {
                let left =
                    sqlx::query("SELECT pg_catalog.pg_advisory_unlock(1098343522, 3)").execute(&writer);
                if let Err(error) = left.await {
                    tracing::debug!(%error, "the lock of the daemon goes with its connection");
                }
            });
        }
    }
}

async fn take(connection: &mut EngineConnection) -> Result<bool, sqlx::Error> {
    sqlx::query_scalar("SELECT pg_catalog.pg_try_advisory_lock(1098343522, 3)").fetch_one(connection).await
}
