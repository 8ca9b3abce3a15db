//! The lock of the one daemon of a host, on a server.
//!
//! The connections that write hold it, so that a daemon whose connection is lost cannot write before it has the lock
//! again: another daemon of the same name that has taken it meanwhile is never worked against.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::{EngineConnection, EnginePool, EnginePoolOptions};

/// How long a claim waits: the server needs a moment to notice that the daemon before this one was killed.
const PATIENCE: Duration = Duration::from_secs(1);

const BETWEEN_TRIES: Duration = Duration::from_millis(50);

/// Whether the writer's connections hold the lock. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct HostLock {
    /// Name of the host, which the lock is of.
    host: Arc<str>,
    is_held: Arc<AtomicBool>,
}

impl HostLock {
    /// That of a host; the empty name is that of a daemon that has none.
    pub(crate) fn of(host: &str) -> Self {
        Self { host: host.into(), is_held: Arc::default() }
    }

    /// Connections of a writer that take the lock when they are opened, from the moment on that it was taken first. One
    /// that cannot have it is closed, and opened again as long as a turn at the pool may wait.
    pub(crate) fn of_writer(&self, options: EnginePoolOptions) -> EnginePoolOptions {
        let lock = self.clone();
        options.after_connect(move |connection, _| {
            let lock = lock.clone();
            Box::pin(async move {
                if lock.is_held.load(Ordering::SeqCst) && !lock.take(connection).await? {
                    return Err(sqlx::Error::Protocol("another daemon has taken over the database".into()));
                }
                Ok(())
            })
        })
    }

    /// Takes the lock with the connection that writes; whether it was free.
    pub(crate) async fn claim(&self, writer: &EnginePool) -> Result<bool, sqlx::Error> {
        let mut connection = writer.acquire().await?;
        let deadline = Instant::now() + PATIENCE;
        let mut is_taken = self.take(&mut connection).await?;
        while !is_taken && Instant::now() < deadline {
            tokio::time::sleep(BETWEEN_TRIES).await;
            is_taken = self.take(&mut connection).await?;
        }
        self.is_held.store(is_taken, Ordering::SeqCst);
        Ok(is_taken)
    }

    /// Gives the lock back, as soon as the writer has a turn for it; it goes with the connection otherwise.
    pub(crate) fn leave(&self, writer: &EnginePool) {
        self.is_held.store(false, Ordering::SeqCst);
        let writer = writer.clone();
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(async move {
                // the session holds no other lock: those of transactions are not given back by this
                let left = sqlx::query("SELECT pg_catalog.pg_advisory_unlock_all()").execute(&writer);
                if let Err(error) = left.await {
                    tracing::debug!(%error, "the lock of the daemon goes with its connection");
                }
            });
        }
    }

    async fn take(&self, connection: &mut EngineConnection) -> Result<bool, sqlx::Error> {
        let key = "pg_catalog.hashtextextended('armwatch daemon ' || $1, 0)";
        let taken = format!("SELECT pg_catalog.pg_try_advisory_lock({key})");
        let taken = sqlx::query_scalar(sqlx::AssertSqlSafe(taken)).bind(self.host.to_string());
        taken.fetch_one(connection).await
    }
}
