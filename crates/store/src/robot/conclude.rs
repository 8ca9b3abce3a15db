//! Conclusions from a robot's history: the robots that wait for one, its inputs, and the transaction that stores it.

use std::path::Path;
use std::sync::Arc;

use jiff::Timestamp;

use super::alarms::anomalies::{self, Reconciled};
use super::figures::friction_series::{self, FrictionSeries};
use super::{conclusion_faults, settled};
use crate::engine::{Bind, EngineExecutor, EngineTransaction, Run, row_of};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::{production, run_analysis};
use armwatch_model::analysis::{ProductionCheck, WarmUpFit};
use armwatch_model::anomaly::settled::NewlySettled;
use armwatch_model::anomaly::{Anomaly, Findings};
use armwatch_model::run::RunKind;

/// A robot whose conclusion is older than its history.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StaleRobot {
    /// Its key.
    pub robot_id: i64,
    /// Its name.
    pub name: String,
    /// Number of changes of its history when this was read.
    pub history: i64,
}

row_of!(StaleRobot { robot_id, name, history });

/// An open transaction that stores the conclusion of a robot. Dropping it without [`commit`](Self::commit) leaves the
/// database unchanged. It holds the only writer, so read and compute before you open it.
#[derive(Debug)]
pub struct ConclusionTransaction {
    pub(crate) transaction: EngineTransaction,
    pub(crate) path: Arc<Path>,
    pub(crate) robot_id: i64,
}

impl ConclusionTransaction {
    /// Replaces the fits over all runs of the robot.
    pub async fn replace_mixed_fits(&mut self, fits: &[WarmUpFit]) -> Result<(), StoreError> {
        let result = run_analysis::replace_mixed_fits(&mut self.transaction, self.robot_id, fits).await;
        self.checked(result)
    }

    /// Stores the friction points that fits over the robot's tests use, one row per test. Does so only if the history
    /// is still the one that they were read from.
    pub async fn keep_friction_points(
        &mut self,
        history: &FrictionSeries,
        method: u64,
    ) -> Result<(), StoreError> {
        let result = friction_series::keep(&mut self.transaction, self.robot_id, history, method).await;
        self.checked(result)
    }

    /// Returns true if another program has already stored a conclusion from the present history.
    pub async fn is_concluded(&mut self) -> Result<bool, StoreError> {
        let result = is_concluded(&mut *self.transaction, self.robot_id).await;
        self.checked(result)
    }

    /// Present number of changes of the robot's history.
    pub async fn history(&mut self) -> Result<i64, StoreError> {
        let result = history_of(&mut *self.transaction, self.robot_id).await;
        self.checked(result)
    }

    /// Stores the comparisons of a production log's windows, given by their numbers, with tests. Replaces earlier ones.
    pub async fn settle_production(
        &mut self,
        run_id: i64,
        checks: &[(u32, ProductionCheck)],
    ) -> Result<(), StoreError> {
        let result = production::settle(&mut self.transaction, run_id, checks).await;
        self.checked(result)
    }

    /// Stores summaries of production logs whose windows are all settled and that have none.
    pub async fn summarise_settled_logs(&mut self) -> Result<(), StoreError> {
        let settled = settled::latest(&mut *self.transaction, self.robot_id, RunKind::Production).await;
        // older ones have a summary: a log that loses it also loses its settled part
        let from = self.checked(settled)?.and_then(|settled| settled.leads_from).map(|(at, _)| at);
        let result = production::summarise_rest(&mut self.transaction, self.robot_id, from).await;
        self.checked(result)
    }

    /// Makes the stored anomalies and health of the robot agree with its whole history, and stores the events. Known
    /// anomalies keep their number and the answers of people. Those that ended are resolved, those that vanished
    /// withdrawn. `settled` is settled from now on; anomalies settled earlier stay unchanged.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for findings that name a run which is not stored.
    pub async fn reconcile(
        &mut self,
        findings: &Findings,
        settled: &[NewlySettled],
    ) -> Result<Reconciled, StoreError> {
        let result = self.reconciled(findings, settled).await;
        self.checked(result)
    }

    async fn reconciled(
        &mut self,
        findings: &Findings,
        settled: &[NewlySettled],
    ) -> sqlx::Result<Reconciled> {
        let mut ended: Vec<(i64, &[Anomaly])> = Vec::with_capacity(settled.len());
        for of in settled {
            ended.push((self.keep_settled(of.kind, &of.settled).await?, &of.ended));
        }
        let (robot_id, clock) = (self.robot_id, Timestamp::now());
        let reconciled =
            anomalies::reconcile(&mut self.transaction, robot_id, findings, &ended, clock).await?;
        for kind in [RunKind::Test, RunKind::Production] {
            settled::settle_withdrawn(&mut self.transaction, robot_id, kind).await?;
        }
        Ok(reconciled)
    }

    /// Commits the values that findings follow from. The robot stays stale until [`Self::commit`] of its findings.
    ///
    /// # Errors
    /// [`StoreError`] of the database; nothing is stored then.
    pub async fn commit_figures(self) -> Result<(), StoreError> {
        self.transaction.commit().await.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }

    /// Commits the conclusion from the history with `history` changes. If the history has changed since, the robot
    /// stays stale.
    ///
    /// # Errors
    /// [`StoreError`] of the database; nothing is stored then.
    pub async fn commit(mut self, history: i64) -> Result<(), StoreError> {
        let marked = mark_concluded(&mut *self.transaction, self.robot_id, history).await;
        self.checked(marked)?;
        let forgotten = conclusion_faults::forget(&mut *self.transaction, self.robot_id).await;
        self.checked(forgotten)?;
        self.transaction.commit().await.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }

    pub(super) fn checked<T>(&self, result: sqlx::Result<T>) -> Result<T, StoreError> {
        result.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }
}

impl Store {
    /// Robots whose history has changed since their conclusion, by name.
    pub async fn stale_robots(&self) -> Result<Vec<StaleRobot>, StoreError> {
        self.checked(stale_robots(&self.readers).await)
    }

    /// Opens the transaction that stores the conclusion of a robot.
    pub async fn conclude(&self, robot_id: i64) -> Result<ConclusionTransaction, StoreError> {
        let transaction = self.begin().await?;
        Ok(ConclusionTransaction { transaction, path: Arc::clone(&self.path), robot_id })
    }
}

/// Robots whose history has changed since their conclusion, by name.
pub(crate) async fn stale_robots(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<StaleRobot>> {
    sqlx::query_as("SELECT robot_id, name, history FROM robot WHERE history <> concluded ORDER BY name")
        .fetch_all(executor)
        .await
}

async fn history_of(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<i64> {
    sqlx::query_scalar("SELECT history FROM robot WHERE robot_id = $1")
        .bind(robot_id)
        .fetch_one(executor)
        .await
}

async fn is_concluded(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<bool> {
    sqlx::query_scalar("SELECT history = concluded FROM robot WHERE robot_id = $1")
        .bind(robot_id)
        .fetch_one(executor)
        .await
}

async fn mark_concluded(executor: impl EngineExecutor<'_>, robot_id: i64, history: i64) -> sqlx::Result<()> {
    sqlx::query("UPDATE robot SET concluded = $1 WHERE robot_id = $2")
        .bind_all((history, robot_id))
        .run(executor)
        .await
}
