//! The lock of the one daemon of a host, on a server.
//!
//! The connections that write hold it. A daemon that lost its connection therefore cannot write before it has the lock
//! again, and cannot conflict with another daemon of the same name that has taken the lock since.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::{EngineConnection, EnginePool, EnginePoolOptions};

/// Longest wait of a claim: the server needs a moment to notice that the previous daemon was killed.
const PATIENCE: Duration = Duration::from_secs(1);

const BETWEEN_TRIES: Duration = Duration::from_millis(50);

/// Lock state of the writer's connections. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct HostLock {
    /// Name of the host that the lock belongs to.
    host: Arc<str>,
    is_held: Arc<AtomicBool>,
}

impl HostLock {
    /// The lock of a host; the empty name is for a daemon without a name.
    pub(crate) fn of(host: &str) -> Self {
        Self { host: host.into(), is_held: Arc::default() }
    }

    /// Connections of a writer that take the lock when they are opened, after the first claim. A connection that cannot
    /// get it is closed, and opened again until the timeout of the pool.
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

    /// Takes the lock with the connection that writes; returns true if it was free.
    pub(crate) async fn claim(&self, writer: &EnginePool) -> sqlx::Result<bool> {
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

    /// Releases the lock as soon as the writer is free; otherwise it ends with the connection.
    pub(crate) fn leave(&self, writer: &EnginePool) {
        self.is_held.store(false, Ordering::SeqCst);
        let writer = writer.clone();
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            runtime.spawn(async move {
                // the session holds no other session lock, and this call does not release locks of transactions
                let left = sqlx::query("SELECT pg_catalog.pg_advisory_unlock_all()").execute(&writer);
                if let Err(error) = left.await {
                    tracing::debug!(%error, "the lock of the daemon ends with its connection");
                }
            });
        }
    }

    async fn take(&self, connection: &mut EngineConnection) -> sqlx::Result<bool> {
        let key = "pg_catalog.hashtextextended('armwatch daemon ' || $1, 0)";
        let taken = format!("SELECT pg_catalog.pg_try_advisory_lock({key})");
        let taken = sqlx::query_scalar(sqlx::AssertSqlSafe(taken)).bind(self.host.to_string());
        taken.fetch_one(connection).await
    }
}
