//! Re-estimates: histories identified again, cycle by cycle, under a name. Also the names of all kept estimates.

use std::collections::HashMap;

use jiff::Timestamp;
use serde::{Serialize, Serializer};
use sqlx::{QueryBuilder, Row};

use super::parameter_sets::SourceCycle;
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models;
use crate::models::StoredModel;
use crate::values::{ROWS_PER_STATEMENT, count, finite, in_views, joint_number, named, size, time};
use armwatch_model::analysis::estimator_kind::EstimatorKind;
use armwatch_model::analysis::{Identification, IdentifiedParameter, ParameterStatistics};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Selected cycles identified again, each alone.
#[derive(Debug, Clone, PartialEq)]
pub struct Reestimate {
    /// Description that the parameters belong to.
    pub model: StoredModel,
    /// Method that turned rows into parameters.
    pub estimator: EstimatorKind,
    /// The cycles, in the order of runs and cycles.
    pub cycles: Vec<ReestimatedCycle>,
    /// Statistics over the cycles of each run.
    pub statistics: Vec<ReestimatedStatistics>,
}

/// A cycle identified again.
#[derive(Debug, Clone, PartialEq)]
pub struct ReestimatedCycle {
    /// The cycle.
    pub source: SourceCycle,
    /// Its parameters: one view of all joints stacked, or one per joint; none if identification failed.
    pub views: Vec<CycleView>,
    /// Reason why it, or some of its joints, has no parameters.
    pub reason: Option<String>,
}

/// Parameters of a cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleView {
    /// The joint that supplied the rows; `None` for all joints stacked.
    pub seen_by: Option<JointIndex>,
    /// Values with standard errors.
    pub identification: Identification,
    /// Half the width of the 95 % interval of each.
    pub half_width: Vec<f64>,
    /// Share of data in each, if a prior took part.
    pub data_share: Option<Vec<f64>>,
}

/// Statistics of a parameter over the cycles of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct ReestimatedStatistics {
    /// The robot.
    pub robot: String,
    /// The run.
    pub run_id: i64,
    /// See [`CycleView::seen_by`].
    pub seen_by: Option<JointIndex>,
    /// The statistics.
    pub statistics: ParameterStatistics,
}

/// An estimate that is kept under a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct KeptEstimate {
    /// The name.
    pub name: String,
    /// Kind of the estimate.
    pub kind: KeptKind,
    /// Name of the model.
    pub model: String,
    /// Method of the estimate.
    pub estimator: EstimatorKind,
    /// Robots of its source cycles, separated by commas.
    #[serde(serialize_with = "robot_names")]
    pub robots: String,
    /// Number of its source cycles.
    pub cycles: u32,
    /// Time of storing.
    #[serde(serialize_with = "in_views")]
    pub saved_at: Timestamp,
}

fn robot_names<S: Serializer>(robots: &str, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(robots.split(','))
}

armwatch_model::named_enum! {
    /// Kind of a kept estimate.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum KeptKind {
        /// One parameter set from cycles together.
        Set = "set",
        /// One identification for each cycle.
        EachCycle = "each-cycle",
    }
}

armwatch_model::serialize_by_name!(KeptKind);

impl Store {
    /// Stores a re-estimate under a name, in one transaction; returns `false` and stores nothing if the name is in use.
    ///
    /// # Errors
    /// [`StoreError::Refused`] for parameters that the model does not have.
    pub async fn save_reestimate(&self, name: &str, found: &Reestimate) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let saved = self.checked(save(&mut transaction, name, found).await)?;
        self.commit(transaction).await?;
        Ok(saved)
    }

    /// All kept estimates, by name.
    pub async fn kept_estimates(&self) -> Result<Vec<KeptEstimate>, StoreError> {
        self.checked(kept(&self.readers).await)
    }

    /// Deletes the parameter set or re-estimate of this name; returns true if there was one.
    pub async fn delete_estimate(&self, name: &str) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let set = self.checked(delete_set(&mut *transaction, name).await)?;
        let reestimate = self.checked(delete(&mut *transaction, name).await)?;
        self.commit(transaction).await?;
        Ok(set || reestimate)
    }
}

/// Stores a re-estimate; returns `false` and stores nothing if the name is in use.
pub(crate) async fn save(
    connection: &mut EngineConnection,
    name: &str,
    found: &Reestimate,
) -> sqlx::Result<bool> {
    let Some(reestimate_id) = insert(&mut *connection, name, found).await? else { return Ok(false) };
    let keys = models::parameter_keys(&mut *connection, found.model.robot_model_id).await?;
    for cycle in &found.cycles {
        let cycle_id = insert_cycle(&mut *connection, reestimate_id, cycle).await?;
        for view in &cycle.views {
            insert_view(&mut *connection, cycle_id, view).await?;
            let numbered: Vec<(usize, &IdentifiedParameter)> =
                view.identification.parameters.iter().enumerate().collect();
            for rows in numbered.chunks(ROWS_PER_STATEMENT) {
                insert_values(&mut *connection, cycle_id, &keys, view, rows).await?;
            }
        }
    }
    for rows in found.statistics.chunks(ROWS_PER_STATEMENT) {
        insert_statistics(&mut *connection, reestimate_id, &keys, rows).await?;
    }
    Ok(true)
}

/// All kept estimates, by name.
pub(crate) async fn kept(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<KeptEstimate>> {
    sqlx::query(
        "SELECT parameter_set.name, 'set' AS kind, robot_model.name AS model, estimator, saved_at,
                (SELECT string_agg(robot, ',') FROM (
                     SELECT robot FROM parameter_set_source AS source
                     WHERE source.parameter_set_id = parameter_set.parameter_set_id
                     GROUP BY robot ORDER BY min(run_id), robot) AS of_set) AS robots,
                (SELECT count(*) FROM parameter_set_source
                 WHERE parameter_set_source.parameter_set_id = parameter_set.parameter_set_id) AS cycles
         FROM parameter_set
         JOIN robot_model USING (robot_model_id)
         UNION ALL
         SELECT reestimate.name, 'each-cycle', robot_model.name, estimator, saved_at,
                (SELECT string_agg(robot, ',') FROM (
                     SELECT robot FROM reestimate_cycle AS cycle
                     WHERE cycle.reestimate_id = reestimate.reestimate_id
                     GROUP BY robot ORDER BY min(run_id), robot) AS of_cycles),
                (SELECT count(*) FROM reestimate_cycle
                 WHERE reestimate_cycle.reestimate_id = reestimate.reestimate_id)
         FROM reestimate
         JOIN robot_model USING (robot_model_id)
         ORDER BY 1",
    )
    .try_map(|row: EngineRow| {
        Ok(KeptEstimate {
            name: row.try_get("name")?,
            kind: named(&row, "kind", &KeptKind::ALL, KeptKind::name)?,
            model: row.try_get("model")?,
            estimator: named(&row, "estimator", &EstimatorKind::ALL, EstimatorKind::name)?,
            robots: row.try_get::<Option<String>, _>("robots")?.unwrap_or_default(),
            cycles: size(&row, "cycles")?,
            saved_at: time(&row, "saved_at")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Deletes the set of this name; returns true if there was one.
async fn delete_set(executor: impl EngineExecutor<'_>, name: &str) -> sqlx::Result<bool> {
    let done = sqlx::query("DELETE FROM parameter_set WHERE name = $1").bind(name).execute(executor).await?;
    Ok(done.rows_affected() > 0)
}

/// Deletes the re-estimate of this name; returns true if there was one.
pub(crate) async fn delete(executor: impl EngineExecutor<'_>, name: &str) -> sqlx::Result<bool> {
    let done = sqlx::query("DELETE FROM reestimate WHERE name = $1").bind(name).execute(executor).await?;
    Ok(done.rows_affected() > 0)
}

async fn insert(
    executor: impl EngineExecutor<'_>,
    name: &str,
    found: &Reestimate,
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar(
        "INSERT INTO reestimate (name, robot_model_id, estimator)
         SELECT $1, $2, $3
         WHERE NOT EXISTS (SELECT 1 FROM parameter_set WHERE name = $1)
         ON CONFLICT (name) DO NOTHING
         RETURNING reestimate_id",
    )
    .bind_all((name, found.model.robot_model_id, found.estimator.name()))
    .fetch_optional(executor)
    .await
}

async fn insert_cycle(
    executor: impl EngineExecutor<'_>,
    reestimate_id: i64,
    cycle: &ReestimatedCycle,
) -> sqlx::Result<i64> {
    sqlx::query_scalar(
        "INSERT INTO reestimate_cycle (reestimate_id, robot, run_id, cycle, reason) VALUES ($1, $2, $3, $4, $5)
         RETURNING reestimate_cycle_id",
    )
    .bind_all((reestimate_id, &cycle.source.robot, cycle.source.run_id, cycle.source.cycle, &cycle.reason))
    .fetch_one(executor)
    .await
}

/// Number of the joint, 0 for all joints together: a key cannot be NULL.
fn seen_by(joint: Option<JointIndex>) -> i64 {
    joint.map_or(0, joint_number)
}

async fn insert_view(executor: impl EngineExecutor<'_>, cycle_id: i64, view: &CycleView) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO reestimate_view (reestimate_cycle_id, seen_by_joint, samples, condition_number,
                                      scaled_condition_number, residual_std_nm)
         VALUES ($1, $2, $3, $4, $5, $6)",
    )
    .bind_all((cycle_id, seen_by(view.seen_by), count(view.identification.samples)))
    .bind(finite(view.identification.condition_number))
    .bind(finite(view.identification.scaled_condition_number))
    .bind(finite(view.identification.residual_std))
    .run(executor)
    .await
}

async fn insert_values(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    keys: &HashMap<ParameterId, i64>,
    view: &CycleView,
    rows: &[(usize, &IdentifiedParameter)],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO reestimate_value (reestimate_cycle_id, seen_by_joint, model_parameter_id, value, std_error,
                                       half_width_95, data_share) ",
    )
    .push_values(rows, |mut row, (k, parameter)| {
        row.bind_all((cycle_id, seen_by(view.seen_by), keys.get(&parameter.id).copied()))
            .bind_all((finite(parameter.value), finite(parameter.std_error)))
            .push_bind(view.half_width.get(*k).copied().and_then(finite))
            .push_bind(view.data_share.as_ref().and_then(|share| share.get(*k).copied()).and_then(finite));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_statistics(
    executor: impl EngineExecutor<'_>,
    reestimate_id: i64,
    keys: &HashMap<ParameterId, i64>,
    rows: &[ReestimatedStatistics],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO reestimate_statistic (reestimate_id, robot, run_id, seen_by_joint, model_parameter_id,
                                           \"window\", mean, min, max, d_mm, d_se, sdv, cycles) ",
    )
    .push_values(rows, |mut row, of_run| {
        let figures = &of_run.statistics;
        row.bind_all((reestimate_id, &of_run.robot, of_run.run_id, seen_by(of_run.seen_by)))
            .bind_all((keys.get(&figures.id).copied(), figures.window.name(), finite(figures.mean)))
            .bind_all((finite(figures.min), finite(figures.max), figures.d_mm.and_then(finite)))
            .bind_all((figures.d_se.and_then(finite), figures.sdv.and_then(finite)))
            .push_bind(count(figures.cycles));
    })
    .build()
    .run(executor)
    .await
}
