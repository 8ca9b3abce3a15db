//! The end of a run: its analysis and its completion, in one transaction.

use std::path::Path;
use std::sync::Arc;

use jiff::Timestamp;

use super::error::StoreError;
use super::ledger::run_progress::{self, RunTotals};
use super::ledger::runs::Owner;
use super::ledger::{identity, quarantine, runs};
use super::results::run_analysis;
use super::robot::history;
use super::robot::indices::friction::{self, CycleSpeedFits};
use crate::engine::EngineTransaction;
use crate::handle::Store;
use crate::ledger::supersession;
use crate::ledger::supersession::Contest;
use armwatch_model::analysis::RunAnalysis;
use armwatch_model::analysis::measurements::RunMeasurements;
use armwatch_model::run::{ContentHash, ContentPrefix};

/// An open transaction that ends a run. Dropping it without [`commit`](Self::commit) leaves the database unchanged. It
/// holds the only writer, so do slow work before you open it, with
/// [`Store::run_measurements`](super::handle::Store::run_measurements). The conclusion from the robot's history follows
/// later, see [`ConclusionTransaction`](super::robot::conclude::ConclusionTransaction).
#[derive(Debug)]
pub struct FinishTransaction {
    pub(super) transaction: EngineTransaction,
    pub(super) path: Arc<Path>,
    pub(super) run_id: i64,
    pub(super) robot_id: i64,
    pub(super) replaced: Option<Replaced>,
    /// The run of the same recording that stays in force, because this one has no result.
    pub(super) kept: Option<i64>,
}

/// A run that an ending run supersedes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Replaced {
    /// The run.
    pub run_id: i64,
    /// True if it certainly has different first rows, as another recording has.
    pub begins_otherwise: bool,
}

impl FinishTransaction {
    /// Reads the measurements of this run's cycles.
    pub async fn measurements(&mut self) -> Result<RunMeasurements, StoreError> {
        let result = history::run_measurements(&mut self.transaction, self.run_id).await;
        self.checked(result)
    }

    /// Stores the analysis of this run, replacing an earlier one.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for a statistic of a parameter that no cycle of the run has.
    pub async fn store_analysis(&mut self, analysis: &RunAnalysis) -> Result<(), StoreError> {
        let result = run_analysis::replace(&mut self.transaction, self.robot_id, self.run_id, analysis).await;
        self.checked(result)
    }

    /// Replaces the fits of friction over speed of this run's cycles.
    ///
    /// # Errors
    /// [`StoreError`] of the database, also for a fit of a cycle that is not stored.
    pub async fn replace_speed_fits(&mut self, fits: &[CycleSpeedFits]) -> Result<(), StoreError> {
        let result = friction::replace_speed_fits(&mut self.transaction, self.run_id, fits).await;
        self.checked(result)
    }

    /// Gives the run the identity of its content, which is known after the last row, and lets it supersede the run
    /// whose file it has overwritten. Returns [`Owner::Other`] and stores nothing if another complete run has this
    /// content: this run is to be discarded then. `first_rows` is the hash of its first rows, which shows if the other
    /// recording begins with the same rows.
    pub async fn adopt(
        &mut self,
        content: &ContentPrefix,
        first_rows: &ContentHash,
    ) -> Result<Owner, StoreError> {
        let noted = identity::set_first_rows(&mut *self.transaction, self.run_id, first_rows).await;
        self.checked(noted)?;
        let owner = runs::adopt(&mut self.transaction, self.run_id, content).await;
        let owner = self.checked(owner)?;
        if owner == Owner::Ours {
            let replaced = supersession::replaced_by(&mut *self.transaction, self.run_id).await;
            if let Some(old) = self.checked(replaced)? {
                let contest = supersession::supersede_worse(&mut self.transaction, self.run_id, old).await;
                match self.checked(contest)? {
                    Contest::New => {
                        let otherwise =
                            identity::begin_otherwise(&mut *self.transaction, self.run_id, old).await;
                        self.replaced =
                            Some(Replaced { run_id: old, begins_otherwise: self.checked(otherwise)? });
                    }
                    Contest::Old => self.kept = Some(old),
                    Contest::Both => {}
                }
            }
        }
        Ok(owner)
    }

    /// Moves the start of the recording, and those of its cycles, to a time that is now known.
    pub async fn set_start(&mut self, started_at: Timestamp) -> Result<(), StoreError> {
        let result = identity::set_start(&mut self.transaction, self.run_id, started_at).await;
        self.checked(result)
    }

    /// The run that this one has superseded in [`FinishTransaction::adopt`].
    pub fn replaced(&self) -> Option<Replaced> {
        self.replaced
    }

    /// The run of the same recording that stays in force because no cycle of this one has a result; found by
    /// [`FinishTransaction::adopt`].
    pub fn kept(&self) -> Option<i64> {
        self.kept
    }

    /// Marks the run as complete; it supersedes quarantined ones of the same recording. If a [better run](Self::kept)
    /// stays in force, that one supersedes this run.
    ///
    /// # Errors
    /// [`StoreError::Refused`] if not every cycle is stored.
    pub async fn complete(&mut self, totals: RunTotals) -> Result<(), StoreError> {
        let result = run_progress::mark_complete(&mut *self.transaction, self.run_id, totals).await;
        self.checked(result)?;
        let superseded = match self.kept {
            Some(old) => supersession::set_aside(&mut *self.transaction, self.run_id, old).await,
            None => quarantine::supersede_faulty(&mut *self.transaction, self.run_id).await,
        };
        self.checked(superseded)
    }

    /// Commits the changes.
    ///
    /// # Errors
    /// [`StoreError`] of the database; nothing is stored then.
    pub async fn commit(self) -> Result<(), StoreError> {
        self.transaction.commit().await.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }

    fn checked<T>(&self, result: sqlx::Result<T>) -> Result<T, StoreError> {
        result.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }
}

impl Store {
    /// Opens the transaction that ends a run. A complete run may be ended again.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] if the run is unknown or quarantined.
    pub async fn finish_run(&self, run_id: i64) -> Result<FinishTransaction, StoreError> {
        let mut transaction = self.begin().await?;
        let robot = runs::robot_of_run(&mut *transaction, run_id, self.session()).await;
        let robot = self.checked(robot)?;
        let robot_id = robot.ok_or_else(|| self.run_not_open(run_id))?;
        Ok(FinishTransaction {
            transaction,
            path: Arc::clone(&self.path),
            run_id,
            robot_id,
            replaced: None,
            kept: None,
        })
    }
}
