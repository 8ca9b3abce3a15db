//! Parameters under a name, with their source cycles; and cross-verification.

use std::collections::HashMap;

use serde::Serialize;
use sqlx::{QueryBuilder, Row};

use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models;
use crate::models::StoredModel;
use crate::results::record;
use crate::values::{ROWS_PER_STATEMENT, count, finite, identified, named, size};
use armwatch_model::analysis::estimator_kind::{ErrorSource, EstimatorKind};
use armwatch_model::analysis::{Estimator, Identification, IdentifiedParameter, TorqueRmsd};
use armwatch_model::robot::ParameterId;

/// Parameters from selected cycles.
#[derive(Debug, Clone, PartialEq)]
pub struct ParameterSet {
    /// Description that the parameters belong to.
    pub model: StoredModel,
    /// Values with standard errors, condition numbers and residual.
    pub identification: Identification,
    /// Their source cycles.
    pub sources: Vec<SourceCycle>,
    /// Method that turned their rows into parameters.
    pub estimator: EstimatorKind,
    /// Source of the standard errors.
    pub errors: ErrorSource,
}

/// A source cycle of a parameter set.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SourceCycle {
    /// Its run.
    pub run_id: i64,
    /// Its number, from 1.
    pub cycle: u32,
    /// Its robot.
    pub robot: String,
}

impl Store {
    /// Reads the parameters of one cycle, in no particular order; none for a refused or unknown one.
    pub async fn cycle_parameters(
        &self,
        run_id: i64,
        cycle: u32,
    ) -> Result<Vec<IdentifiedParameter>, StoreError> {
        self.checked(of_cycle(&self.readers, run_id, cycle).await)
    }

    /// Stores parameters under a name. Returns `false` and stores nothing if the name is in use.
    pub async fn save_parameter_set(&self, name: &str, set: &ParameterSet) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let saved = self.checked(save(&mut transaction, name, set).await)?;
        self.commit(transaction).await?;
        Ok(saved)
    }

    /// Reads the parameters stored under a name.
    pub async fn parameter_set(&self, name: &str) -> Result<Option<ParameterSet>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(find(&mut connection, name).await)
    }

    /// Stores how well the parameters of run `reference_run_id`, by `estimator`, fit cycles of run `run_id`, given by
    /// their numbers. Replaces earlier results for these cycles; stores all or nothing.
    pub async fn store_cross_verification(
        &self,
        run_id: i64,
        reference_run_id: i64,
        estimator: Estimator,
        by_cycle: &[(u32, Vec<TorqueRmsd>)],
    ) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let reference = (reference_run_id, estimator);
        for (cycle, rmsd) in by_cycle {
            let replaced = replace_cross(&mut transaction, run_id, *cycle, reference, rmsd).await;
            self.checked(replaced)?;
        }
        self.commit(transaction).await
    }
}

/// Stores a set; returns `false` and stores nothing if the name is in use.
pub(crate) async fn save(
    connection: &mut EngineConnection,
    name: &str,
    set: &ParameterSet,
) -> sqlx::Result<bool> {
    let Some(set_id) = insert_set(&mut *connection, name, set).await? else { return Ok(false) };
    let keys = models::parameter_keys(&mut *connection, set.model.robot_model_id).await?;
    for rows in set.identification.parameters.chunks(ROWS_PER_STATEMENT) {
        insert_values(&mut *connection, set_id, &keys, rows).await?;
    }
    for rows in set.sources.chunks(ROWS_PER_STATEMENT) {
        insert_sources(&mut *connection, set_id, rows).await?;
    }
    Ok(true)
}

/// The set of this name.
pub(crate) async fn find(
    connection: &mut EngineConnection,
    name: &str,
) -> sqlx::Result<Option<ParameterSet>> {
    let Some((set_id, mut set)) = read_set(&mut *connection, name).await? else { return Ok(None) };
    set.identification.parameters = read_values(&mut *connection, set_id).await?;
    set.sources = read_sources(connection, set_id).await?;
    Ok(Some(set))
}

/// Parameters of a cycle, by joint; empty for a refused or unknown one.
pub(crate) async fn of_cycle(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    cycle: u32,
) -> sqlx::Result<Vec<IdentifiedParameter>> {
    sqlx::query(
        "SELECT joint, name, value, std_error, degrees_of_freedom
         FROM cycle
         JOIN cycle_parameter USING (cycle_id)
         JOIN model_parameter USING (model_parameter_id)
         WHERE run_id = $1 AND number = $2",
    )
    .bind_all((run_id, cycle))
    .try_map(|row| identified(&row))
    .fetch_all(executor)
    .await
}

/// Replaces the cross-verification of a cycle with the parameters of a run by an estimator.
async fn replace_cross(
    connection: &mut EngineConnection,
    run_id: i64,
    cycle: u32,
    reference: (i64, Estimator),
    rmsd: &[TorqueRmsd],
) -> sqlx::Result<()> {
    let Some(cycle_id) = cycle_id(&mut *connection, run_id, cycle).await? else { return Ok(()) };
    delete_cross(&mut *connection, cycle_id, reference.0).await?;
    for rows in rmsd.chunks(ROWS_PER_STATEMENT) {
        record::insert_rmsd(&mut *connection, cycle_id, Some(reference), rows).await?;
    }
    Ok(())
}

async fn cycle_id(executor: impl EngineExecutor<'_>, run_id: i64, cycle: u32) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar("SELECT cycle_id FROM cycle WHERE run_id = $1 AND number = $2")
        .bind_all((run_id, cycle))
        .fetch_optional(executor)
        .await
}

async fn delete_cross(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    reference_run_id: i64,
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM torque_rmsd WHERE cycle_id = $1 AND reference_run_id = $2")
        .bind_all((cycle_id, reference_run_id))
        .run(executor)
        .await
}

async fn insert_set(
    executor: impl EngineExecutor<'_>,
    name: &str,
    set: &ParameterSet,
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar(
        "INSERT INTO parameter_set (name, robot_model_id, samples, condition_number, scaled_condition_number,
                                    residual_std_nm, estimator, error_basis)
         SELECT $1, $2, $3, $4, $5, $6, $7, $8
         WHERE NOT EXISTS (SELECT 1 FROM reestimate WHERE name = $1)
         ON CONFLICT (name) DO NOTHING
         RETURNING parameter_set_id",
    )
    .bind_all((name, set.model.robot_model_id, count(set.identification.samples)))
    .bind(finite(set.identification.condition_number))
    .bind_all((finite(set.identification.scaled_condition_number), finite(set.identification.residual_std)))
    .bind_all((set.estimator.name(), set.errors.name()))
    .fetch_optional(executor)
    .await
}

async fn insert_values(
    executor: impl EngineExecutor<'_>,
    set_id: i64,
    keys: &HashMap<ParameterId, i64>,
    rows: &[IdentifiedParameter],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO parameter_set_value (parameter_set_id, model_parameter_id, value, std_error, degrees_of_freedom) ",
    )
    .push_values(rows, |mut row, parameter| {
        row.bind_all((set_id, keys.get(&parameter.id).copied(), finite(parameter.value)))
            .bind_all((finite(parameter.std_error), finite(parameter.degrees_of_freedom)));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_sources(
    executor: impl EngineExecutor<'_>,
    set_id: i64,
    rows: &[SourceCycle],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new("INSERT INTO parameter_set_source (parameter_set_id, run_id, cycle, robot) ")
        .push_values(rows, |mut row, source| {
            row.push_bind(set_id).push_bind(source.run_id).push_bind(source.cycle).push_bind(&source.robot);
        })
        .build()
        .run(executor)
        .await
}

/// The set without its values and sources.
async fn read_set(
    executor: impl EngineExecutor<'_>,
    name: &str,
) -> sqlx::Result<Option<(i64, ParameterSet)>> {
    sqlx::query(
        "SELECT parameter_set_id, robot_model_id, robot_model.name AS model, description_hash, samples,
                condition_number, scaled_condition_number, residual_std_nm, estimator, error_basis
         FROM parameter_set
         JOIN robot_model USING (robot_model_id)
         WHERE parameter_set.name = $1",
    )
    .bind(name)
    .try_map(|row: EngineRow| {
        let figure = |column: &str| -> sqlx::Result<f64> {
            Ok(row.try_get::<Option<f64>, _>(column)?.unwrap_or(f64::NAN))
        };
        let set = ParameterSet {
            model: StoredModel {
                robot_model_id: row.try_get("robot_model_id")?,
                name: row.try_get("model")?,
                description_hash: row.try_get("description_hash")?,
            },
            identification: Identification {
                residuals: Vec::new(),
                parameters: Vec::new(),
                samples: size(&row, "samples")?,
                condition_number: figure("condition_number")?,
                scaled_condition_number: figure("scaled_condition_number")?,
                residual_std: figure("residual_std_nm")?,
            },
            sources: Vec::new(),
            estimator: named(&row, "estimator", &EstimatorKind::ALL, EstimatorKind::name)?,
            errors: named(&row, "error_basis", &ErrorSource::ALL, ErrorSource::name)?,
        };
        Ok((row.try_get("parameter_set_id")?, set))
    })
    .fetch_optional(executor)
    .await
}

async fn read_values(
    executor: impl EngineExecutor<'_>,
    set_id: i64,
) -> sqlx::Result<Vec<IdentifiedParameter>> {
    sqlx::query(
        "SELECT joint, name, value, std_error, degrees_of_freedom
         FROM parameter_set_value
         JOIN model_parameter USING (model_parameter_id)
         WHERE parameter_set_id = $1",
    )
    .bind(set_id)
    .try_map(|row| identified(&row))
    .fetch_all(executor)
    .await
}

async fn read_sources(executor: impl EngineExecutor<'_>, set_id: i64) -> sqlx::Result<Vec<SourceCycle>> {
    sqlx::query(
        "SELECT run_id, cycle, robot FROM parameter_set_source WHERE parameter_set_id = $1 ORDER BY run_id, cycle",
    )
    .bind(set_id)
    .try_map(|row: EngineRow| {
        Ok(SourceCycle {
            run_id: row.try_get("run_id")?,
            cycle: size(&row, "cycle")?,
            robot: row.try_get("robot")?,
        })
    })
    .fetch_all(executor)
    .await
}
