//! Several daemons on one database of a server: sessions with a lease, their claims, and the places of their files. A
//! database in a file has one daemon, and every claim of it succeeds at once.

pub(super) mod claims;
pub(super) mod folders;
pub(super) mod list;
pub(super) mod kinds;
pub(super) mod session;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use self::kinds::{ClaimKind, SessionKind};
use super::error::StoreError;
use super::handle::Store;
use crate::engine::{Dialect, EngineTransaction};
use armwatch_model::run::FileId;

/// Membership among the programs that write to a database, until the program leaves or the process ends. A lease,
/// renewed in the background, shows that the program is alive.
#[derive(Debug)]
pub struct HostSession {
    joined: Option<session::Joined>,
    store: Store,
}

impl HostSession {
    /// Releases all claims and ends the session. If that fails, the lease expires. Attempts in progress do not count as
    /// having ended the program.
    pub async fn leave(self) {
        // if this cannot be stored, the program has not ended in good order either
        let _ = self.store.break_off_attempts().await;
        if let Some(joined) = self.joined {
            joined.leave().await;
        }
    }
}

impl Store {
    /// Joins the programs that write to a database on a server, each with a session and a lease. A database in a file
    /// needs no session. For a daemon, [`Store::claim`] comes first.
    pub async fn join(&self, kind: SessionKind) -> Result<HostSession, StoreError> {
        let joined = match self.dialect() {
            Dialect::Sqlite => None,
            Dialect::Postgres => Some(session::join(self, kind).await?),
        };
        Ok(HostSession { joined, store: self.clone() })
    }

    /// Number of this program's session, under which it writes; `None` on a file, and before it has joined.
    pub(crate) fn session(&self) -> Option<i64> {
        self.own_host.session()
    }

    /// Claims a subject for this program; `false` if another one works on it. Repeating a claim succeeds.
    pub async fn claim_work(&self, kind: ClaimKind, subject: &str) -> Result<bool, StoreError> {
        let Some(session) = self.session() else { return Ok(true) };
        // lasting claims are checked often, but written only the first time
        let holder = self.checked(claims::holder(&self.control(), kind, subject).await)?;
        if let Some(holder) = holder {
            return Ok(holder == session);
        }
        self.checked(claims::claim(&self.control(), kind, subject, session).await)
    }

    /// Releases claims. If that fails, they end with the session.
    pub async fn release_work(&self, subjects: &[(ClaimKind, &str)]) {
        let Some(session) = self.session() else { return };
        for (kind, subject) in subjects {
            let released = claims::release(&self.control(), *kind, subject, session).await;
            if let Err(error) = released {
                tracing::debug!(kind = kind.name(), subject, %error, "stays claimed until the session ends");
            }
        }
    }

    /// Runs that other programs are reading.
    pub async fn runs_of_others(&self) -> Result<HashSet<i64>, StoreError> {
        match self.session() {
            Some(session) => self.checked(claims::runs_of_others(&self.readers, session).await),
            None => Ok(HashSet::new()),
        }
    }

    /// Claims a run for this program, in the transaction that begins it.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] if another program reads it, and others of the database.
    pub(crate) async fn claim_run(
        &self,
        transaction: &mut EngineTransaction,
        run_id: i64,
    ) -> Result<(), StoreError> {
        let Some(session) = self.session() else { return Ok(()) };
        let subject = run_id.to_string();
        let claimed = claims::claim(&mut **transaction, ClaimKind::Run, &subject, session).await;
        if self.checked(claimed)? { Ok(()) } else { Err(self.run_not_open(run_id)) }
    }

    /// Refuses to write to a run that another program reads.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] then, and others of the database.
    pub(crate) async fn refuse_run_of_another(
        &self,
        transaction: &mut EngineTransaction,
        run_id: i64,
    ) -> Result<(), StoreError> {
        let Some(session) = self.session() else { return Ok(()) };
        let is_other = claims::is_of_another(&mut **transaction, run_id, session).await;
        if self.checked(is_other)? { Err(self.run_not_open(run_id)) } else { Ok(()) }
    }

    /// Number of a file, distinct from those of other hosts.
    pub(crate) fn numbered(&self, file: FileId) -> FileId {
        self.own_host.place().file(file)
    }

    /// True if other daemons see the file at this path under the same path, so that it has to be claimed.
    pub fn is_shared(&self, path: &Path) -> bool {
        self.own_host.place().is_shared(path)
    }

    /// A path as stored in the ledger: with the name of the host if there are several hosts and the file is in no
    /// shared folder.
    pub fn located(&self, path: String) -> String {
        self.own_host.place().located(path)
    }

    /// The file on this host for a path of the ledger; `None` for a file of another host.
    pub fn local_path(&self, located: &str) -> Option<PathBuf> {
        self.own_host.place().local_path(located)
    }
}
