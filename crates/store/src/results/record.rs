//! Results of one cycle: every row of it, or none.

use std::collections::{HashMap, HashSet};

use sqlx::QueryBuilder;

use super::{channel_response, factors, production, temperatures, torque_noise};
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::ledger::resume::ReadSoFar;
use crate::ledger::{resume, run_progress, runs};
use crate::models;
use crate::values::{ROWS_PER_STATEMENT, count, finite, joint_number, json_numbers, of_some_rows};
use armwatch_model::analysis::interval::{LEVEL, half_width};
use armwatch_model::analysis::refusal::RefusalCause;
use armwatch_model::analysis::{
    CycleAnalysis, Estimator, FrictionPoint, Identification, IdentifiedParameter, JointResidual, TorqueRmsd,
};
use armwatch_model::robot::{ParameterId, Robot};

/// Outcome of storing a cycle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Recorded {
    /// Its rows are stored and the progress of the run has moved.
    Stored,
    /// It was stored before; nothing is written.
    Known,
    /// The run accepts no cycles.
    RunNotOpen,
}

impl Store {
    /// Stores all rows of a cycle and the progress of the run in one transaction. Returns `false` and stores nothing if
    /// the run already has this cycle.
    ///
    /// # Errors
    /// [`StoreError::RunNotOpen`] if the run is not streaming.
    pub async fn record_cycle(
        &self,
        run_id: i64,
        analysis: &CycleAnalysis,
        robot: &Robot,
    ) -> Result<bool, StoreError> {
        self.record_cycle_read(run_id, analysis, robot, None).await
    }

    /// Like [`Store::record_cycle`]. Also stores the source of the cycles so far, and the place for resuming the
    /// reading after them.
    ///
    /// # Errors
    /// Those of [`Store::record_cycle`].
    pub async fn record_cycle_read(
        &self,
        run_id: i64,
        analysis: &CycleAnalysis,
        robot: &Robot,
        read: Option<&ReadSoFar>,
    ) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        let session = self.session();
        let recorded = record_cycle(&mut transaction, (run_id, session), analysis, robot, read).await;
        match self.checked(recorded)? {
            Recorded::Stored => self.commit(transaction).await.map(|()| true),
            Recorded::Known => Ok(false),
            Recorded::RunNotOpen => Err(self.run_not_open(run_id)),
        }
    }
}

/// Stores the rows of a cycle of a run that the session reads, and moves the progress. Call this in a transaction.
pub(crate) async fn record_cycle(
    connection: &mut EngineConnection,
    (run_id, session): (i64, Option<i64>),
    analysis: &CycleAnalysis,
    robot: &Robot,
    read: Option<&ReadSoFar>,
) -> sqlx::Result<Recorded> {
    let Some(run_start) = runs::open_run_start(&mut *connection, run_id, session).await? else {
        return Ok(Recorded::RunNotOpen);
    };
    let cut_by_end = read.is_some_and(|read| read.cut_by_end);
    let Some(cycle_id) = insert_cycle(&mut *connection, run_id, run_start, analysis, cut_by_end).await?
    else {
        return Ok(Recorded::Known);
    };
    let parameters = analysis.identification.as_ref().map_or(&[][..], |i| &i.parameters[..]);
    let columns = analysis.factors.columns.iter().flatten().copied();
    let wanted: HashSet<ParameterId> = parameters.iter().map(|p| p.id).chain(columns).collect();
    let mut wanted: Vec<ParameterId> = wanted.into_iter().collect();
    // a set has no order, but keys must be the same on every machine
    wanted.sort_unstable();
    let model = models::robot_model_id(&mut *connection, robot).await?;
    let keys = models::ensure_parameters(&mut *connection, model, robot, &wanted).await?;
    if let Ok(found) = &analysis.identification {
        record_identification(&mut *connection, cycle_id, &keys, found, &analysis.verification).await?;
    }
    if analysis.refusal().is_some() && !analysis.refusal_causes.is_empty() {
        insert_causes(&mut *connection, cycle_id, &analysis.refusal_causes).await?;
    }
    factors::record_contrast(&mut *connection, cycle_id, &analysis.warming_contrast).await?;
    factors::record(&mut *connection, cycle_id, model, &keys, &analysis.factors).await?;
    if let Some(response) = &analysis.response {
        channel_response::record(&mut *connection, run_id, response).await?;
    }
    temperatures::record(&mut *connection, cycle_id, &analysis.temperatures).await?;
    torque_noise::record(&mut *connection, cycle_id, &analysis.torque_noise).await?;
    let numbered: Vec<(i64, FrictionPoint)> = (1..).zip(analysis.friction_points.iter().copied()).collect();
    for rows in numbered.chunks(ROWS_PER_STATEMENT) {
        insert_friction_points(&mut *connection, cycle_id, rows).await?;
    }
    if let Some(check) = &analysis.production {
        production::record(&mut *connection, cycle_id, check).await?;
    }
    if let Some(point) = read.and_then(|read| read.resume.as_ref()) {
        resume::set(&mut *connection, run_id, point).await?;
    }
    let description =
        run_progress::Description { robot_model_id: model, figures_hash: models::figures_hash(robot) };
    run_progress::advance(connection, run_id, &description, read.map(|read| &read.prefix)).await?;
    Ok(Recorded::Stored)
}

/// Stores the results of identification: parameters, the residual of each joint's torque, and self-verification.
pub(crate) async fn record_identification(
    connection: &mut EngineConnection,
    cycle_id: i64,
    keys: &HashMap<ParameterId, i64>,
    found: &Identification,
    verification: &[TorqueRmsd],
) -> sqlx::Result<()> {
    for rows in found.parameters.chunks(ROWS_PER_STATEMENT) {
        insert_parameters(&mut *connection, cycle_id, keys, rows).await?;
    }
    for rows in found.residuals.chunks(ROWS_PER_STATEMENT) {
        insert_residuals(&mut *connection, cycle_id, rows).await?;
    }
    for rows in verification.chunks(ROWS_PER_STATEMENT) {
        insert_rmsd(&mut *connection, cycle_id, None, rows).await?;
    }
    Ok(())
}

/// Inserts a cycle; `None` if the run has one of that number.
async fn insert_cycle(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    run_start: i64,
    analysis: &CycleAnalysis,
    cut_by_end: bool,
) -> sqlx::Result<Option<i64>> {
    let (identification, refusal) = (analysis.identification.as_ref(), analysis.refusal());
    let remarks = (!analysis.remarks.is_empty()).then(|| analysis.remarks.join("\n"));
    sqlx::query_scalar(
        "INSERT INTO cycle (run_id, number, started_at, duration_s, rows, sample_rate_hz, cutoff_hz, status, reason,
                            remarks, samples, condition_number, scaled_condition_number, residual_std_nm,
                            estimator, mean_speeds_rad_s, doubtful, error_basis, cut_by_end)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16, $17, $18, $19)
         ON CONFLICT (run_id, number) DO NOTHING
         RETURNING cycle_id",
    )
    .bind_all((run_id, analysis.cycle, after(run_start, analysis.start), finite(analysis.duration)))
    .bind_all((count(analysis.rows), finite(analysis.sample_rate), finite(analysis.cutoff)))
    .bind_all((refusal.map_or("complete", |_| "refused"), refusal, remarks))
    .bind(identification.map(|i| count(i.samples)).ok())
    .bind(identification.ok().and_then(|i| finite(i.condition_number)))
    .bind(identification.ok().and_then(|i| finite(i.scaled_condition_number)))
    .bind_all((identification.ok().and_then(|i| finite(i.residual_std)), analysis.estimator.name()))
    .bind((!analysis.mean_speeds.is_empty()).then(|| json_numbers(&analysis.mean_speeds)))
    .bind_all((analysis.is_doubtful(), identification.is_ok().then_some("blocks"), cut_by_end))
    .fetch_optional(executor)
    .await
}

async fn insert_parameters(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    keys: &HashMap<ParameterId, i64>,
    rows: &[IdentifiedParameter],
) -> sqlx::Result<()> {
    let shown: Vec<&IdentifiedParameter> = rows.iter().filter(|of| of.is_shown()).collect();
    if shown.is_empty() {
        return Ok(());
    }
    QueryBuilder::<Engine>::new(
        "INSERT INTO cycle_parameter (cycle_id, model_parameter_id, value, std_error, degrees_of_freedom,
                                      half_width_95) ",
    )
    .push_values(shown, |mut row, parameter| {
        row.bind_all((cycle_id, keys.get(&parameter.id).copied(), finite(parameter.value)))
            .bind_all((finite(parameter.std_error), finite(parameter.degrees_of_freedom)))
            .push_bind(finite(half_width(parameter, LEVEL)));
    })
    .build()
    .run(executor)
    .await
}

/// Stores the causes of a cycle's refusal.
async fn insert_causes(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    causes: &[RefusalCause],
) -> sqlx::Result<()> {
    let numbered: Vec<(i64, &RefusalCause)> = (1..).zip(causes).collect();
    QueryBuilder::<Engine>::new(
        "INSERT INTO cycle_refusal (cycle_id, number, finding, channel, joint, sentence) ",
    )
    .push_values(numbered, |mut row, (number, cause)| {
        row.bind_all((cycle_id, number, &cause.finding, cause.channel.name()))
            .bind_all((cause.joint.map(joint_number), &cause.sentence));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_residuals(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    rows: &[JointResidual],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO joint_residual (cycle_id, joint, residual_std_nm, independent_share) ",
    )
    .push_values(rows, |mut row, residual| {
        row.bind_all((cycle_id, joint_number(residual.joint), finite(residual.std)))
            .push_bind(finite(residual.independent_share));
    })
    .build()
    .run(executor)
    .await
}

/// Stores self-verification, or cross-verification with the parameters of a run by an estimator.
pub(crate) async fn insert_rmsd(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    reference: Option<(i64, Estimator)>,
    rows: &[TorqueRmsd],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO torque_rmsd (cycle_id, joint, stage, verification, reference_run_id, estimator, rmsd_nm,
                                  relative_rmsd, samples, moving_rmsd_nm, moving_relative_rmsd, moving_samples) ",
    )
    .push_values(rows, |mut row, rmsd| {
        row.bind_all((cycle_id, joint_number(rmsd.joint), rmsd.scope.name()))
            .bind_all((reference.map_or("self", |_| "cross"), reference.map(|(run_id, _)| run_id)))
            .push_bind(reference.map(|(_, estimator)| estimator.name()));
        for part in [rmsd.all_rows, rmsd.moving_rows] {
            row.bind_all((of_some_rows(part, part.value), of_some_rows(part, part.relative)))
                .push_bind(count(part.samples));
        }
    })
    .build()
    .run(executor)
    .await
}

async fn insert_friction_points(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    rows: &[(i64, FrictionPoint)],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO friction_point (cycle_id, number, joint, time_s, speed_fraction, speed_rad_s, direction,
                                     torque_nm, std_nm, samples, gravity, load_nm, load_friction) ",
    )
    .push_values(rows, |mut row, (number, point)| {
        row.bind_all((cycle_id, *number, joint_number(point.joint), finite(point.time)))
            .bind_all((finite(point.speed_fraction), finite(point.speed), point.direction))
            .bind_all((finite(point.torque), finite(point.std), count(point.samples)))
            .bind_all((point.gravity.name(), point.load.and_then(|load| finite(load.torque))))
            .push_bind(point.load.and_then(|load| finite(load.friction)));
    })
    .build()
    .run(executor)
    .await
}

/// Microseconds UTC, `seconds` after `start`. The cast saturates, and recordings last hours.
fn after(start: i64, seconds: f64) -> i64 {
    start.saturating_add((seconds * 1e6).round() as i64)
}
