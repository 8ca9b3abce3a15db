//! What is settled of a robot's histories, of tests and of ordinary work, boundary by boundary, and the runs of the
//! windows behind the latest.

use jiff::Timestamp;

use super::conclude::ConclusionTransaction;
use super::{history, run_brief_rows, settled_rows};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::log_summaries;
use armwatch_model::anomaly::settled::Settled;
use armwatch_model::anomaly::{ProductionSummary, RunSummary};
use armwatch_model::run::RunKind;

impl ConclusionTransaction {
    /// What is settled of the robot's history of this kind at the latest boundary, by this basis; nothing is settled at its
    /// beginning. What was settled by another basis is forgotten.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn settled(&mut self, kind: RunKind, basis: u64) -> Result<Settled, StoreError> {
        let forgotten = settled_rows::forget_others(&mut self.transaction, self.robot_id, kind, basis).await;
        self.checked(forgotten)?;
        let result = settled_rows::latest(&mut *self.transaction, self.robot_id, kind).await;
        Ok(self.checked(result)?.unwrap_or_default())
    }

    /// Keeps what is settled at a boundary, with a hash of what it follows from beside the runs; gives its key.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn keep_settled(
        &mut self,
        kind: RunKind,
        settled: &Settled,
        basis: u64,
    ) -> Result<i64, StoreError> {
        let result = settled_rows::insert(&mut *self.transaction, self.robot_id, kind, settled, basis).await;
        self.checked(result)
    }

    /// Leaves alone from now on what an earlier conclusion has taken back and what runs of the window say no more of.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn settle_withdrawn(&mut self, kind: RunKind, settled: &Settled) -> Result<(), StoreError> {
        let result =
            settled_rows::settle_withdrawn(&mut *self.transaction, self.robot_id, kind, settled).await;
        self.checked(result)
    }

    /// Forgets what follows from tests that began at this time or later.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn unsettle(&mut self, from: Timestamp) -> Result<(), StoreError> {
        let result = sqlx::query(
            "DELETE FROM settled_history WHERE robot_id = $1 AND kind = 'test' AND follows_until >= $2",
        )
        .bind(self.robot_id)
        .bind(from.as_microsecond())
        .execute(&mut *self.transaction)
        .await;
        self.checked(result)?;
        Ok(())
    }

    /// Summaries of the tests of the window behind a boundary, oldest first: those that it names, and at most `most` behind
    /// these. Their cycles are left out.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn window(&mut self, settled: &Settled, most: usize) -> Result<Vec<RunSummary>, StoreError> {
        let keys =
            settled_rows::keys(&mut *self.transaction, self.robot_id, RunKind::Test, settled, most).await;
        let keys = self.checked(keys)?;
        let completed = run_brief_rows::complete(&mut self.transaction, &keys).await;
        self.checked(completed)?;
        let first = &settled.first_of_epochs;
        let result = history::briefs(&mut self.transaction, self.robot_id, &keys, first).await;
        self.checked(result)
    }

    /// What the logs of ordinary work of the window behind a boundary come to, oldest first: those that it names, and at most `most`
    /// behind these.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn work_window(
        &mut self,
        settled: &Settled,
        most: usize,
    ) -> Result<Vec<ProductionSummary>, StoreError> {
        let keys =
            settled_rows::keys(&mut *self.transaction, self.robot_id, RunKind::Production, settled, most)
                .await;
        let keys = self.checked(keys)?;
        let result = log_summaries::summaries(&mut self.transaction, &keys).await;
        self.checked(result)
    }
}

impl Store {
    /// Summaries of the tests that a robot's latest conclusions stand on, oldest first, their cycles left out but for tests of
    /// which nothing is known in brief.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn latest_window(&self, robot_id: i64) -> Result<Vec<RunSummary>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        let settled = self
            .checked(settled_rows::latest(&mut *connection, robot_id, RunKind::Test).await)?
            .unwrap_or_default();
        let keys = settled_rows::keys(&mut *connection, robot_id, RunKind::Test, &settled, usize::MAX).await;
        let keys = self.checked(keys)?;
        self.checked(history::briefs(&mut connection, robot_id, &keys, &settled.first_of_epochs).await)
    }
}
