//! The host of a handle: the paths of its files, its lock on the server, and the session under which it writes.

pub(crate) mod location;

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use tokio::sync::Notify;

use self::location::ClusterLocation;
use super::engine::host_lock::HostLock;
use super::engine::{EngineExecutor, EnginePool};
use armwatch_config::ClusterSettings;

/// Host data of a handle. Clones share it.
#[derive(Debug, Clone)]
pub(crate) struct OwnHost(Arc<OwnHostData>);

#[derive(Debug)]
struct OwnHostData {
    place: ClusterLocation,
    lease: Duration,
    lock: HostLock,
    /// Session of all writes; 0 without one.
    session: AtomicI64,
    /// Woken when a transaction finds that the session has ended.
    ended: Notify,
    /// A separate connection for leases and claims, which must not wait for the writer. `None` on a file.
    control: Option<EnginePool>,
}

impl OwnHost {
    pub(crate) fn new(settings: &ClusterSettings, lock: HostLock, control: Option<EnginePool>) -> Self {
        Self(Arc::new(OwnHostData {
            place: ClusterLocation::of(settings),
            lease: settings.lease,
            lock,
            session: AtomicI64::new(0),
            ended: Notify::new(),
            control,
        }))
    }

    /// Host data of a handle that only reads, or of a file.
    pub(crate) fn none(settings: &ClusterSettings) -> Self {
        Self::new(settings, HostLock::of(""), None)
    }

    /// A copy for a handle that only reads.
    pub(crate) fn to_look(&self) -> Self {
        Self(Arc::new(OwnHostData {
            place: self.0.place.clone(),
            lease: self.0.lease,
            lock: HostLock::of(""),
            session: AtomicI64::new(0),
            ended: Notify::new(),
            control: None,
        }))
    }

    pub(crate) fn place(&self) -> &ClusterLocation {
        &self.0.place
    }

    pub(crate) fn lock(&self) -> &HostLock {
        &self.0.lock
    }

    pub(crate) fn lease(&self) -> Duration {
        self.0.lease
    }

    pub(crate) fn session(&self) -> Option<i64> {
        Some(self.0.session.load(Ordering::SeqCst)).filter(|session| *session != 0)
    }

    pub(crate) fn set_session(&self, session: i64) {
        self.0.session.store(session, Ordering::SeqCst);
    }

    /// Returns when a transaction has found that the session has ended.
    pub(crate) async fn session_ended(&self) {
        self.0.ended.notified().await;
    }

    pub(crate) fn control(&self, writer: &EnginePool) -> EnginePool {
        self.0.control.clone().unwrap_or_else(|| writer.clone())
    }

    /// True if there is no session, or it has not ended. Every transaction that writes checks it.
    pub(crate) async fn is_alive(&self, executor: impl EngineExecutor<'_>) -> sqlx::Result<bool> {
        let Some(session) = self.session() else { return Ok(true) };
        let alive = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM host_session WHERE host_session_id = $1 AND ended_at IS NULL)",
        );
        let is_alive: bool = alive.bind(session).fetch_one(executor).await?;
        if !is_alive {
            self.0.ended.notify_one();
        }
        Ok(is_alive)
    }
}
