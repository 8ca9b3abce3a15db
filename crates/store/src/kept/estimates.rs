//! Cycles that were identified with another estimator than the configured one, and the replacement of their results.

use std::path::Path;
use std::sync::Arc;

use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineTransaction, Run, row_of};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models;
use crate::results::run_analysis::JointDeviation;
use crate::results::{record, run_analysis};
use crate::robot::history;
use crate::values::{count, finite};
use armwatch_model::analysis::measurements::RunMeasurements;
use armwatch_model::analysis::{Estimator, Identification, ParameterStatistics, TorqueRmsd};

/// Reason why cycles without factors keep their estimator.
const NO_FACTORS: &str =
    "not changed: no factors of its rows are stored; read its export again into a new database";
/// Reason why cycles keep their estimator if Huber's is configured.
const NO_ROWS: &str =
    "not changed: huber weights single rows, which are not stored; read its export again into a new database";

/// Cycles of a run that were identified with another estimator than the configured one and can be identified again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OtherEstimate {
    /// The run.
    pub run_id: i64,
    /// Name of its robot.
    pub robot: String,
    /// Number of cycles.
    pub cycles: u32,
}

row_of!(OtherEstimate { run_id, robot, cycles });

/// Result of identifying a stored cycle again.
#[derive(Debug, Clone, PartialEq)]
pub struct NewEstimate {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Key of the description that its factors were made with.
    pub robot_model_id: i64,
    /// Parameters and self-verification, or the reason why the cycle keeps its results.
    pub found: Result<(Identification, Vec<TorqueRmsd>), String>,
}

impl Store {
    /// Stores which cycles cannot be identified again with the estimator `wanted`, and why: those without factors, and
    /// all cycles for an estimator that needs rows. Returns the number of cycles that were not marked before.
    pub async fn keep_estimates(&self, wanted: Estimator) -> Result<u64, StoreError> {
        // reading does not wait for another writer, and usually there is nothing to write
        if !self.checked(any_to_mark(&self.readers, wanted).await)? {
            return Ok(0);
        }
        let mut transaction = self.begin().await?;
        self.checked(forget_reasons(&mut *transaction, wanted).await)?;
        let kept = self.checked(mark_kept(&mut *transaction, wanted).await)?;
        self.commit(transaction).await?;
        Ok(kept)
    }

    /// Runs with cycles that were identified with another estimator than `wanted` and can be identified again, by
    /// start; for one robot, or for all.
    pub async fn other_estimates(
        &self,
        wanted: Estimator,
        robot_id: Option<i64>,
    ) -> Result<Vec<OtherEstimate>, StoreError> {
        self.checked(others(&self.readers, wanted, robot_id).await)
    }

    /// Numbers of the cycles of a run that [`Store::other_estimates`] counts, ascending.
    pub async fn cycles_of_other_estimates(
        &self,
        run_id: i64,
        wanted: Estimator,
    ) -> Result<Vec<u32>, StoreError> {
        self.checked(cycles_of(&self.readers, run_id, wanted).await)
    }

    /// Opens the transaction that replaces the estimates of a run's cycles by those of `estimator`.
    pub async fn replace_estimates(
        &self,
        run_id: i64,
        estimator: Estimator,
    ) -> Result<EstimateTransaction, StoreError> {
        let transaction = self.begin().await?;
        Ok(EstimateTransaction { transaction, path: Arc::clone(&self.path), run_id, estimator })
    }
}

/// An open transaction that replaces the estimates of a run's cycles and the results that follow from them. Dropping it
/// without [`commit`](Self::commit) leaves the database unchanged. It holds the only writer.
#[derive(Debug)]
pub struct EstimateTransaction {
    transaction: EngineTransaction,
    path: Arc<Path>,
    run_id: i64,
    estimator: Estimator,
}

impl EstimateTransaction {
    /// Replaces parameters, residuals and self-verification of a cycle by those of another estimator. Does nothing for
    /// a cycle that already has this estimator, or is gone.
    pub async fn replace(&mut self, new: &NewEstimate) -> Result<(), StoreError> {
        let result = replace(&mut self.transaction, self.run_id, self.estimator, new).await;
        self.checked(result)
    }

    /// Reads the measurements of the run's cycles, including the replaced ones.
    pub async fn measurements(&mut self) -> Result<RunMeasurements, StoreError> {
        let result = history::of_parameters(&mut self.transaction, self.run_id).await;
        self.checked(result)
    }

    /// Replaces the run's overall parameters and torque deviations, if it has ended.
    pub async fn replace_run_figures(
        &mut self,
        statistics: &[ParameterStatistics],
        deviations: &[JointDeviation],
    ) -> Result<(), StoreError> {
        let (transaction, run_id) = (&mut self.transaction, self.run_id);
        let result = run_analysis::replace_of_parameters(transaction, run_id, statistics, deviations).await;
        self.checked(result)
    }

    /// Commits the changes; the robot needs a new conclusion.
    ///
    /// # Errors
    /// [`StoreError`] of the database; nothing is stored then.
    pub async fn commit(mut self) -> Result<(), StoreError> {
        let changed = change_history(&mut *self.transaction, self.run_id).await;
        self.checked(changed)?;
        self.transaction.commit().await.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }

    fn checked<T>(&self, result: sqlx::Result<T>) -> Result<T, StoreError> {
        result.map_err(|e| StoreError::from_sqlx(&self.path, &e))
    }
}

/// The other estimators, for the index on the column.
fn others_than(wanted: Estimator) -> [&'static str; 2] {
    match wanted {
        Estimator::Ordinary => ["weighted", "huber"],
        Estimator::Weighted => ["ordinary", "huber"],
        Estimator::Huber => ["ordinary", "weighted"],
    }
}

/// Checks for a cycle of another estimator that is not marked as kept yet, and for one that is marked without a reason.
/// Every conclusion runs this query: marked cycles are separate in the index `cycle_by_estimator` and not read again.
pub(crate) const ANY_TO_MARK: &str = "SELECT EXISTS (
             SELECT 1 FROM cycle
             WHERE estimator IN ($1, $2) AND samples IS NOT NULL AND estimator_wanted IS NULL
                   AND ($3 = 'huber' OR NOT EXISTS (SELECT 1 FROM torque_factor
                                                    WHERE torque_factor.cycle_id = cycle.cycle_id)))
         OR EXISTS (
             SELECT 1 FROM cycle
             WHERE estimator IN ($1, $2) AND samples IS NOT NULL AND estimator_wanted IN ($1, $2)
                   AND ($3 = 'huber' OR NOT EXISTS (SELECT 1 FROM torque_factor
                                                    WHERE torque_factor.cycle_id = cycle.cycle_id)))
         OR EXISTS (
             SELECT 1 FROM cycle
             WHERE estimator = $3 AND samples IS NOT NULL AND estimator_wanted IN ($1, $2, $3))";

async fn any_to_mark(executor: impl EngineExecutor<'_>, wanted: Estimator) -> sqlx::Result<bool> {
    let [first, second] = others_than(wanted);
    sqlx::query_scalar(ANY_TO_MARK).bind(first).bind(second).bind(wanted.name()).fetch_one(executor).await
}

/// Deletes reasons for an estimator that is no longer configured.
async fn forget_reasons(executor: impl EngineExecutor<'_>, wanted: Estimator) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE cycle SET estimator_wanted = NULL, estimator_reason = NULL
         WHERE estimator_wanted IS NOT NULL AND (estimator_wanted <> $1 OR estimator = $1)",
    )
    .bind(wanted.name())
    .run(executor)
    .await
}

async fn mark_kept(executor: impl EngineExecutor<'_>, wanted: Estimator) -> sqlx::Result<u64> {
    let [first, second] = others_than(wanted);
    let done = sqlx::query(
        "UPDATE cycle SET estimator_wanted = $3, estimator_reason = CASE WHEN $3 = 'huber' THEN $4 ELSE $5 END
         WHERE estimator IN ($1, $2) AND samples IS NOT NULL AND estimator_wanted IS DISTINCT FROM $3
               AND ($3 = 'huber' OR NOT EXISTS (SELECT 1 FROM torque_factor
                                                WHERE torque_factor.cycle_id = cycle.cycle_id))",
    )
    .bind_all((first, second, wanted.name(), NO_ROWS, NO_FACTORS))
    .execute(executor)
    .await?;
    Ok(done.rows_affected())
}

/// Cycles of another estimator by run, except those that are marked as kept, which are not read.
pub(crate) const OTHERS: &str = "SELECT run.run_id, robot.name AS robot, count(*) AS cycles
         FROM (
             SELECT run_id FROM cycle
             WHERE estimator IN ($1, $2) AND samples IS NOT NULL AND estimator_wanted IS NULL
             UNION ALL
             SELECT run_id FROM cycle
             WHERE estimator IN ($1, $2) AND samples IS NOT NULL AND estimator_wanted IN ($1, $2)
         ) AS other
         JOIN run USING (run_id)
         JOIN robot USING (robot_id)
         WHERE $3 <> 'huber' AND ($4 IS NULL OR robot_id = $4)
         GROUP BY run.run_id, robot.name
         ORDER BY run.started_at, run.run_id";

async fn others(
    executor: impl EngineExecutor<'_>,
    wanted: Estimator,
    robot_id: Option<i64>,
) -> sqlx::Result<Vec<OtherEstimate>> {
    let [first, second] = others_than(wanted);
    sqlx::query_as(OTHERS).bind_all((first, second, wanted.name(), robot_id)).fetch_all(executor).await
}

async fn cycles_of(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    wanted: Estimator,
) -> sqlx::Result<Vec<u32>> {
    sqlx::query_scalar(
        "SELECT number FROM cycle
         WHERE run_id = $1 AND estimator <> $2 AND samples IS NOT NULL AND estimator_wanted IS DISTINCT FROM $2
         ORDER BY number",
    )
    .bind_all((run_id, wanted.name()))
    .fetch_all(executor)
    .await
}

async fn replace(
    connection: &mut EngineConnection,
    run_id: i64,
    estimator: Estimator,
    new: &NewEstimate,
) -> sqlx::Result<()> {
    let Some(cycle_id) = cycle_of_other(&mut *connection, run_id, new.cycle, estimator).await? else {
        return Ok(());
    };
    let (found, verification) = match &new.found {
        Ok(found) => found,
        Err(reason) => return keep(connection, cycle_id, estimator, reason).await,
    };
    delete_identification(&mut *connection, cycle_id).await?;
    let keys = models::parameter_keys(&mut *connection, new.robot_model_id).await?;
    record::record_identification(&mut *connection, cycle_id, &keys, found, verification).await?;
    // the thirds of the warming stage keep the deviations of the earlier estimator
    name_warming_estimator(&mut *connection, cycle_id).await?;
    set_estimator(connection, cycle_id, estimator, found).await
}

async fn cycle_of_other(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    cycle: u32,
    estimator: Estimator,
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar(
        "SELECT cycle_id FROM cycle
         WHERE run_id = $1 AND number = $2 AND estimator <> $3 AND samples IS NOT NULL",
    )
    .bind_all((run_id, cycle, estimator.name()))
    .fetch_optional(executor)
    .await
}

async fn keep(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    wanted: Estimator,
    reason: &str,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE cycle SET estimator_wanted = $1, estimator_reason = $2 WHERE cycle_id = $3")
        .bind_all((wanted.name(), format!("kept: {reason}"), cycle_id))
        .run(executor)
        .await
}

async fn delete_identification(connection: &mut EngineConnection, cycle_id: i64) -> sqlx::Result<()> {
    for statement in [
        "DELETE FROM cycle_parameter WHERE cycle_id = $1",
        "DELETE FROM joint_residual WHERE cycle_id = $1",
        "DELETE FROM torque_rmsd WHERE cycle_id = $1 AND verification = 'self'",
    ] {
        sqlx::query(statement).bind(cycle_id).execute(&mut *connection).await?;
    }
    Ok(())
}

async fn name_warming_estimator(executor: impl EngineExecutor<'_>, cycle_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE warming_rmsd SET estimator = (SELECT estimator FROM cycle WHERE cycle_id = $1)
         WHERE cycle_id = $1 AND estimator IS NULL",
    )
    .bind(cycle_id)
    .run(executor)
    .await
}

async fn set_estimator(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    estimator: Estimator,
    found: &Identification,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE cycle SET estimator = $1, error_basis = 'independent_rows', samples = $2, residual_std_nm = $3,
                          estimator_wanted = NULL, estimator_reason = NULL
         WHERE cycle_id = $4",
    )
    .bind_all((estimator.name(), count(found.samples), finite(found.residual_std), cycle_id))
    .run(executor)
    .await
}

async fn change_history(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE robot SET history = history + 1
         WHERE robot_id = (SELECT robot_id FROM run WHERE run_id = $1 AND status = 'complete')",
    )
    .bind(run_id)
    .run(executor)
    .await
}
