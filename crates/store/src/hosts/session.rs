//! Sessions with a lease. The number of a session is the epoch of its lease: every transaction that writes checks if
//! its session has ended. A daemon that was stopped for longer than its lease therefore cannot commit work that another
//! one has claimed. Only the server's clock counts.

use std::time::{Duration, Instant};

use tokio::task::JoinHandle;

use super::kinds::SessionKind;
use crate::engine::{Bind, EngineExecutor, Run, begin_writing};
use crate::error::StoreError;
use crate::handle::Store;

/// Renewals of a lease during its length, so that one or two renewals may fail.
const RENEWALS: u32 = 4;

/// A session that is renewed in the background.
#[derive(Debug)]
pub(super) struct Joined {
    store: Store,
    renewing: JoinHandle<()>,
}

impl Drop for Joined {
    fn drop(&mut self) {
        self.renewing.abort();
    }
}

impl Joined {
    pub(super) async fn leave(self) {
        self.renewing.abort();
        let Some(session) = self.store.own_host.session() else { return };
        if let Err(error) = leave(&self.store, session).await {
            tracing::debug!(%error, "the session ends with its lease");
        }
    }
}

/// Begins a session. For a daemon, this ends the sessions of earlier daemons of the same host, because it holds the
/// host's lock.
pub(super) async fn join(store: &Store, kind: SessionKind) -> Result<Joined, StoreError> {
    begin(store, kind).await?;
    let renewing = tokio::spawn(renew(store.clone(), kind));
    Ok(Joined { store: store.clone(), renewing })
}

async fn begin(store: &Store, kind: SessionKind) -> Result<i64, StoreError> {
    let mut transaction = store.checked(begin_writing(&store.control()).await)?;
    let host = store.own_host.place().host();
    if kind == SessionKind::Daemon {
        let earlier = sqlx::query(
            "UPDATE host_session SET ended_at = clock_us(), end_reason = 'restarted'
             WHERE host = $1 AND kind = 'daemon' AND ended_at IS NULL",
        );
        store.checked(earlier.bind(host).execute(&mut *transaction).await)?;
        store.checked(free_claims(&mut *transaction).await)?;
    }
    let begun = sqlx::query_scalar(
        "INSERT INTO host_session (host, kind, version, started_at, seen_at, alive_until)
         SELECT $1, $2, $3, now, now, now + $4 FROM (SELECT clock_us() AS now) AS clock
         RETURNING host_session_id",
    )
    .bind(host)
    .bind(match kind {
        SessionKind::Daemon => "daemon",
        SessionKind::Command => "command",
    })
    .bind_all((env!("CARGO_PKG_VERSION"), microseconds(store.own_host.lease())));
    let session: i64 = store.checked(begun.fetch_one(&mut *transaction).await)?;
    store.commit(transaction).await?;
    store.own_host.set_session(session);
    Ok(session)
}

/// Renews the lease for as long as the program runs, begins a new session if the old one has ended, and ends those of
/// others whose lease has expired.
async fn renew(store: Store, kind: SessionKind) {
    let own = store.own_host.clone();
    let (lease, host) = (own.lease(), own.place().host().to_owned());
    let (mut heard, mut is_said) = (Instant::now(), false);
    loop {
        tokio::select! {
            () = tokio::time::sleep(lease / RENEWALS) => {}
            () = own.session_ended() => {}
        }
        let Some(session) = store.own_host.session() else { return };
        let renewed = match extend(&store.control(), session, lease).await {
            Ok(true) => Ok(()),
            Ok(false) => begin_again(&store, kind).await.map(|now| {
                tracing::warn!(
                    host,
                    session,
                    now,
                    "this program was silent for longer than its lease of {} s, and others have taken over: \
                    joined again; exports in progress continue after their last stored cycle",
                    lease.as_secs_f64()
                );
            }),
            Err(error) => store.checked(Err(error)),
        };
        let done = match renewed {
            Ok(()) => end_silent(&store).await,
            Err(error) => Err(error),
        };
        match done {
            Ok(()) => (heard, is_said) = (Instant::now(), false),
            Err(error) if !is_said && heard.elapsed() > lease => {
                is_said = true;
                tracing::warn!(host, %error, "the lease cannot be renewed; others may take over");
            }
            Err(error) => tracing::debug!(host, %error, "the lease is not renewed now; trying again"),
        }
    }
}

/// Begins a session after the earlier one has ended. A daemon needs the lock of its host for that, as each connection
/// of its writer does: another daemon of the same name may have claimed the work, and must not lose its session to this
/// one.
async fn begin_again(store: &Store, kind: SessionKind) -> Result<i64, StoreError> {
    if kind == SessionKind::Daemon {
        store.checked(store.writer.acquire().await).map(drop)?;
    }
    begin(store, kind).await
}

/// Extends a lease; `false` if its session has ended.
async fn extend(executor: impl EngineExecutor<'_>, session: i64, lease: Duration) -> sqlx::Result<bool> {
    let done = sqlx::query(
        "UPDATE host_session SET seen_at = clock_us(), alive_until = clock_us() + $2
         WHERE host_session_id = $1 AND ended_at IS NULL",
    )
    .bind_all((session, microseconds(lease)))
    .execute(executor)
    .await?;
    Ok(done.rows_affected() > 0)
}

/// Ends sessions whose lease has expired, and deletes their claims. After a restart of the server, every session has
/// the time of a lease to renew.
async fn end_silent(store: &Store) -> Result<(), StoreError> {
    let silent = sqlx::query_scalar(
        "SELECT EXISTS (SELECT 1 FROM host_session WHERE ended_at IS NULL AND alive_until < clock_us())
                AND clock_us() - CAST(extract(epoch FROM pg_postmaster_start_time()) * 1000000 AS bigint) > $1",
    );
    let lease = microseconds(store.own_host.lease());
    let is_silent: bool = store.checked(silent.bind(lease).fetch_one(&store.control()).await)?;
    if !is_silent {
        return Ok(());
    }
    let mut transaction = store.checked(begin_writing(&store.control()).await)?;
    let ended = sqlx::query_scalar(
        "UPDATE host_session SET ended_at = clock_us(), end_reason = 'lease_ended'
         WHERE ended_at IS NULL AND alive_until < clock_us()
         RETURNING host",
    );
    let hosts: Vec<String> = store.checked(ended.fetch_all(&mut *transaction).await)?;
    store.checked(free_claims(&mut *transaction).await)?;
    store.commit(transaction).await?;
    for host in hosts {
        tracing::warn!(host, "this host was silent for longer than its lease: others take over its work");
    }
    Ok(())
}

async fn leave(store: &Store, session: i64) -> Result<(), StoreError> {
    let mut transaction = store.checked(begin_writing(&store.control()).await)?;
    let left = sqlx::query(
        "UPDATE host_session SET ended_at = clock_us(), seen_at = clock_us(), end_reason = 'stopped'
         WHERE host_session_id = $1 AND ended_at IS NULL",
    );
    store.checked(left.bind(session).execute(&mut *transaction).await)?;
    store.checked(free_claims(&mut *transaction).await)?;
    store.commit(transaction).await
}

/// Deletes the claims of sessions that have ended.
async fn free_claims(executor: impl EngineExecutor<'_>) -> sqlx::Result<()> {
    let freed = "DELETE FROM claim USING host_session AS ended
                 WHERE ended.host_session_id = claim.host_session_id AND ended.ended_at IS NOT NULL";
    sqlx::query(freed).run(executor).await
}

fn microseconds(time: Duration) -> i64 {
    i64::try_from(time.as_micros()).unwrap_or(i64::MAX)
}
