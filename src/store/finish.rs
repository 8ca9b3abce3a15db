//! The end of a run: its analysis, the robot's history and what follows from it, in one transaction.

use std::path::Path;
use std::sync::Arc;

use sqlx::{Sqlite, Transaction};

use super::anomalies::{self, Reconciled};
use super::friction::{self, CycleSpeedFits};
use super::history::{self, RunMeasurements};
use super::ledger::{self, Owner, RunTotals};
use super::{StoreError, quarantine, run_analysis};
use crate::analysis::{FrictionPoint, RunAnalysis, WarmUpFit};
use crate::anomaly::{Findings, RunSummary};
use crate::numerics::friction_index::RobotFriction;
use crate::run::ContentPrefix;

/// An open transaction that ends a run. Dropping it without [`commit`](Self::commit) leaves the
/// database as it was. It holds the only writer: do slow work before opening it, with
/// [`Store::run_measurements`](super::Store::run_measurements) and
/// [`Store::friction_history`](super::Store::friction_history).
#[derive(Debug)]
pub struct FinishTransaction {
    pub(super) transaction: Transaction<'static, Sqlite>,
    pub(super) path: Arc<Path>,
    pub(super) run_id: i64,
    pub(super) robot_id: i64,
}

impl FinishTransaction {
    /// Reads what the cycles of this run measured.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn measurements(&mut self) -> Result<RunMeasurements, StoreError> {
        let result = history::run_measurements(&mut self.transaction, self.run_id).await;
        self.checked(result)
    }

    /// Stores the analysis of this run, in place of an earlier one.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a statistic of a parameter that no cycle of the run has.
    pub async fn store_analysis(&mut self, analysis: &RunAnalysis) -> Result<(), StoreError> {
        let result = run_analysis::replace(&mut self.transaction, self.robot_id, self.run_id, analysis).await;
        self.checked(result)
    }

    /// Reads the summaries of the robot's complete runs and of this one, ordered by start, then key.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_summaries(&mut self) -> Result<Vec<RunSummary>, StoreError> {
        let result = history::run_summaries(&mut *self.transaction, self.robot_id, self.run_id).await;
        self.checked(result)
    }

    /// Reads the friction points of the robot's complete runs and of this one at one nominal speed,
    /// oldest run first; times count from each point's own run.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_history(&mut self, speed_fraction: f64) -> Result<Vec<FrictionPoint>, StoreError> {
        let result =
            history::friction_history(&mut *self.transaction, self.robot_id, self.run_id, speed_fraction)
                .await;
        self.checked(result)
    }

    /// Replaces the fits over all runs of the robot.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn replace_mixed_fits(&mut self, fits: &[WarmUpFit]) -> Result<(), StoreError> {
        let result = run_analysis::replace_mixed_fits(&mut self.transaction, self.robot_id, fits).await;
        self.checked(result)
    }

    /// Replaces the fits of friction over speed of this run's cycles.
    ///
    /// # Errors
    /// [`StoreError`] of the database; a fit of a cycle that is not stored is one.
    pub async fn replace_speed_fits(&mut self, fits: &[CycleSpeedFits]) -> Result<(), StoreError> {
        let result = friction::replace_speed_fits(&mut self.transaction, self.run_id, fits).await;
        self.checked(result)
    }

    /// Replaces the friction maps of the robot, and the friction index of the runs `run_ids` that they
    /// stand on, in the order of `found.indices`.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn replace_friction_maps(
        &mut self,
        run_ids: &[i64],
        found: &RobotFriction,
    ) -> Result<(), StoreError> {
        let result = friction::replace_maps(&mut self.transaction, self.robot_id, run_ids, found).await;
        self.checked(result)
    }

    /// Makes the stored anomalies and health of the robot agree with its whole history. Known
    /// anomalies keep their number and a person's acknowledgement; those that ended or vanished are
    /// resolved.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for findings that name a run which is not stored.
    pub async fn reconcile(&mut self, findings: &Findings) -> Result<Reconciled, StoreError> {
        let result = anomalies::reconcile(&mut self.transaction, self.robot_id, findings).await;
        self.checked(result)
    }

    /// Gives the run the identity of its content, which is known now that it is read to its end, and the
    /// place of the run whose file it was written over. [`Owner::Other`], and nothing written, if another
    /// complete run has this content: this one is to be discarded.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn adopt(&mut self, content: &ContentPrefix) -> Result<Owner, StoreError> {
        let owner = ledger::adopt(&mut self.transaction, self.run_id, content).await;
        let owner = self.checked(owner)?;
        if owner == Owner::Ours {
            let replaced = ledger::replaced_by(&mut *self.transaction, self.run_id).await;
            if let Some(old) = self.checked(replaced)? {
                let superseded = ledger::supersede(&mut *self.transaction, self.run_id, old).await;
                self.checked(superseded)?;
            }
        }
        Ok(owner)
    }

    /// Marks the run complete; quarantined ones of the same recording are superseded by it.
    ///
    /// # Errors
    /// [`StoreError::Refused`] if not every cycle is stored.
    pub async fn complete(&mut self, totals: RunTotals) -> Result<(), StoreError> {
        let result = ledger::mark_complete(&mut *self.transaction, self.run_id, totals).await;
        self.checked(result)?;
        let superseded = quarantine::supersede_faulty(&mut *self.transaction, self.run_id).await;
        self.checked(superseded)
    }

    /// Makes all of it lasting.
    ///
    /// # Errors
    /// [`StoreError`] of the database; nothing is stored then.
    pub async fn commit(self) -> Result<(), StoreError> {
        self.transaction.commit().await.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }

    fn checked<T>(&self, result: Result<T, sqlx::Error>) -> Result<T, StoreError> {
        result.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }
}
