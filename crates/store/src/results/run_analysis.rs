//! Results of a whole run: fits over time, statistics, summaries. Storing them again replaces them.

use std::collections::HashMap;

use sqlx::QueryBuilder;

use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, Run};
use crate::models;
use crate::values::{ROWS_PER_STATEMENT, count, finite, joint_number};
use armwatch_model::analysis::{
    Estimate, JointSummary, ParameterStatistics, RmsdSwing, RunAnalysis, WarmUpFit,
};
use armwatch_model::robot::{JointIndex, ParameterId};

/// Replaces all stored results of a run as a whole. Call this in a transaction.
pub(crate) async fn replace(
    connection: &mut EngineConnection,
    robot_id: i64,
    run_id: i64,
    analysis: &RunAnalysis,
) -> sqlx::Result<()> {
    delete_run_fits(&mut *connection, run_id).await?;
    for rows in analysis.warm_up_fits.chunks(ROWS_PER_STATEMENT) {
        insert_fits(&mut *connection, robot_id, Some(run_id), rows).await?;
    }
    delete_statistics(&mut *connection, run_id).await?;
    let keys = models::parameter_keys_of_run(&mut *connection, run_id).await?;
    for rows in analysis.statistics.chunks(ROWS_PER_STATEMENT) {
        insert_statistics(&mut *connection, run_id, &keys, rows).await?;
    }
    delete_summaries(&mut *connection, run_id).await?;
    for rows in analysis.summaries.chunks(ROWS_PER_STATEMENT) {
        insert_summaries(&mut *connection, run_id, rows).await?;
    }
    set_estimator(&mut *connection, run_id).await
}

/// Replaces the results of a run that follow from its cycles' parameters: their statistics, and the torque deviations
/// of its summary. Stores nothing for a run that has no summary yet. Call this in a transaction.
pub(crate) async fn replace_of_parameters(
    connection: &mut EngineConnection,
    run_id: i64,
    statistics: &[ParameterStatistics],
    deviations: &[JointDeviation],
) -> sqlx::Result<()> {
    if !has_summary(&mut *connection, run_id).await? {
        return Ok(());
    }
    delete_statistics(&mut *connection, run_id).await?;
    let keys = models::parameter_keys_of_run(&mut *connection, run_id).await?;
    for rows in statistics.chunks(ROWS_PER_STATEMENT) {
        insert_statistics(&mut *connection, run_id, &keys, rows).await?;
    }
    for deviation in deviations {
        update_deviation(&mut *connection, run_id, deviation).await?;
    }
    set_estimator(&mut *connection, run_id).await
}

/// Deviation of a joint's torque from the model in a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointDeviation {
    /// The joint.
    pub joint: JointIndex,
    /// Median over cycles of the moving relative RMSD of the excitation stage.
    pub relative_rmsd: Option<f64>,
    /// Swing of that RMSD between cycles.
    pub rmsd_swing: Option<RmsdSwing>,
}

async fn has_summary(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM run_joint_summary WHERE run_id = $1)")
        .bind(run_id)
        .fetch_one(executor)
        .await
}

async fn update_deviation(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    of: &JointDeviation,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run_joint_summary SET relative_rmsd = $1, rmsd_swing = $2, rmsd_swing_cycles = $3
         WHERE run_id = $4 AND joint = $5",
    )
    .bind_all((of.relative_rmsd.and_then(finite), of.rmsd_swing.and_then(|swing| finite(swing.value))))
    .bind_all((of.rmsd_swing.map(|swing| count(swing.cycles)), run_id, joint_number(of.joint)))
    .run(executor)
    .await
}

/// Stores the estimator of the torque deviations in a run's summary: that of its last identified cycle, which selected
/// the cycles.
async fn set_estimator(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run_joint_summary
         SET estimator = (SELECT estimator FROM cycle WHERE run_id = $1 AND samples IS NOT NULL
                          ORDER BY number DESC LIMIT 1)
         WHERE run_id = $1",
    )
    .bind(run_id)
    .run(executor)
    .await
}

/// Replaces the fits over all runs of a robot. Call this in a transaction.
pub(crate) async fn replace_mixed_fits(
    connection: &mut EngineConnection,
    robot_id: i64,
    fits: &[WarmUpFit],
) -> sqlx::Result<()> {
    delete_mixed_fits(&mut *connection, robot_id).await?;
    for rows in fits.chunks(ROWS_PER_STATEMENT) {
        insert_fits(&mut *connection, robot_id, None, rows).await?;
    }
    Ok(())
}

async fn delete_run_fits(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM warmup_fit WHERE run_id = $1").bind(run_id).run(executor).await
}

async fn delete_mixed_fits(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<()> {
    // coalesce() as in the unique index, so that the index is used.
    sqlx::query("DELETE FROM warmup_fit WHERE robot_id = $1 AND coalesce(run_id, 0) = 0")
        .bind(robot_id)
        .run(executor)
        .await
}

async fn delete_statistics(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM parameter_statistic WHERE run_id = $1").bind(run_id).run(executor).await
}

async fn delete_summaries(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM run_joint_summary WHERE run_id = $1").bind(run_id).run(executor).await
}

async fn insert_fits(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    run_id: Option<i64>,
    rows: &[WarmUpFit],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO warmup_fit (robot_id, run_id, joint, speed_fraction, model, rmsd_nm, samples,
                                 first_min, last_min, a_extrapolated,
                                 a_nm, a_std_error_nm, b_nm, b_std_error_nm, t1_min, t1_std_error_min,
                                 c_nm, c_std_error_nm, t2_min, t2_std_error_min,
                                 c_first_nm, c_first_std_error_nm, t2_max_min) ",
    )
    .push_values(rows, |mut row, fit| {
        row.bind_all((robot_id, run_id, joint_number(fit.joint), finite(fit.speed_fraction)))
            .bind_all((fit.model.name(), finite(fit.rmsd), count(fit.samples), finite(fit.record[0])))
            .bind_all((finite(fit.record[1]), fit.asymptote_extrapolated()));
        let amplitude = |decay: Option<armwatch_model::analysis::Decay>| decay.map(|d| d.amplitude);
        let time_constant = |decay: Option<armwatch_model::analysis::Decay>| decay.map(|d| d.time_constant);
        let estimates: [Option<Estimate>; 5] = [
            Some(fit.a),
            amplitude(fit.slow),
            time_constant(fit.slow),
            amplitude(fit.fast),
            time_constant(fit.fast),
        ];
        for estimate in estimates {
            row.push_bind(estimate.and_then(|e| finite(e.value)))
                .push_bind(estimate.and_then(|e| finite(e.std_error)));
        }
        row.push_bind(fit.fast_shown.and_then(|shown| finite(shown.at_first.value)))
            .push_bind(fit.fast_shown.and_then(|shown| finite(shown.at_first.std_error)))
            .push_bind(fit.fast_shown.and_then(|shown| finite(shown.longest)));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_statistics(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    keys: &HashMap<ParameterId, i64>,
    rows: &[ParameterStatistics],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO parameter_statistic (run_id, model_parameter_id, \"window\", mean, min, max, d_mm, d_se, sdv,
                                          cycles) ",
    )
    .push_values(rows, |mut row, statistics| {
        row.bind_all((run_id, keys.get(&statistics.id).copied(), statistics.window.name()))
            .bind_all((finite(statistics.mean), finite(statistics.min), finite(statistics.max)))
            .bind_all((statistics.d_mm.and_then(finite), statistics.d_se.and_then(finite)))
            .bind_all((statistics.sdv.and_then(finite), count(statistics.cycles)));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_summaries(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    rows: &[JointSummary],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO run_joint_summary (run_id, joint, warm_friction_nm, warm_friction_std_error_nm, warm_minute,
                                        warm_speed_fraction, relative_rmsd, rmsd_swing, rmsd_swing_cycles,
                                        relative_noise, torque_rms_nm,
                                        excitation_friction_nm, excitation_friction_std_error_nm,
                                        excitation_minute, excitation_speed_fraction,
                                        half_speed_friction_nm, half_speed_std_error_nm) ",
    )
    .push_values(rows, |mut row, summary| {
        let (warm, excitation) = (summary.warm_friction, summary.excitation_friction);
        row.bind_all((run_id, joint_number(summary.joint), warm.and_then(|w| finite(w.torque))))
            .bind_all((warm.and_then(|w| finite(w.std_error)), warm.and_then(|w| finite(w.minute))))
            .push_bind(warm.and_then(|w| finite(w.speed_fraction)))
            .push_bind(summary.relative_rmsd.and_then(finite))
            .push_bind(summary.rmsd_swing.and_then(|s| finite(s.value)))
            .push_bind(summary.rmsd_swing.map(|s| count(s.cycles)))
            .bind_all((summary.relative_noise.and_then(finite), summary.torque_rms.and_then(finite)))
            .push_bind(excitation.and_then(|e| finite(e.torque)))
            .push_bind(excitation.and_then(|e| finite(e.std_error)))
            .push_bind(excitation.and_then(|e| finite(e.minute)))
            .push_bind(excitation.and_then(|e| finite(e.speed_fraction)))
            .push_bind(summary.half_speed_friction.and_then(|of| finite(of.value)))
            .push_bind(summary.half_speed_friction.and_then(|of| finite(of.std_error)));
    })
    .build()
    .run(executor)
    .await
}
