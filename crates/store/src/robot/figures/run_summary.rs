//! The values of a complete test that detectors compare, by joint and over its cycles, in one row. For a thousand tests
//! with 24 cycles and six joints, a conclusion reads a thousand rows instead of three hundred thousand.
//!
//! The row is computed from other tables. It is valid as long as its revision is that of the test (`run.revision`) and
//! the program uses the method that computed it.

use serde::{Deserialize, Serialize};
use sqlx::Row;

use super::cycle_friction::{self, MeanParameter};
use super::cycle_rmsd;
use super::joint_summary::{self, SummaryRow};
use super::packed::packed;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::values::size;
use armwatch_model::analysis::measurements::CycleRmsd;
use armwatch_model::anomaly::CycleSeries;

/// The values of a test that detectors compare.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(in crate::robot) struct TestFigures {
    /// Summaries of the test, by joint.
    pub(in crate::robot) joints: Vec<SummaryRow>,
    /// Friction of each cycle and joint, in this order.
    pub(in crate::robot) friction: Vec<CycleSeries>,
    /// Moving relative RMSD of each cycle and joint, in this order.
    pub(in crate::robot) rmsd: Vec<CycleRmsd>,
    /// Means of parameters over the cycles.
    pub(in crate::robot) parameters: Vec<MeanParameter>,
}

/// Replaces the stored values of a test. Judgements stay: they have hashes of all their inputs.
pub(in crate::robot) async fn store(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    figures: &TestFigures,
    method: u64,
) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO run_summary (run_id, revision, method, numbers)
         SELECT run_id, revision, $2, $3 FROM run WHERE run_id = $1
         ON CONFLICT (run_id) DO UPDATE
         SET revision = excluded.revision, method = excluded.method, numbers = excluded.numbers",
    )
    .bind_all((run_id, method.cast_signed(), packed(figures)?))
    .run(executor)
    .await
}

/// The values of a test, read from the tables.
pub(in crate::robot) async fn of_run(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<TestFigures> {
    Ok(TestFigures {
        joints: joint_summary::of_run(&mut *connection, run_id).await?,
        friction: cycle_friction::of_run(&mut *connection, run_id).await?,
        rmsd: cycle_rmsd::of_run(&mut *connection, run_id).await?,
        parameters: parameters(connection, run_id).await?,
    })
}

async fn parameters(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Vec<MeanParameter>> {
    sqlx::query(
        // one cycle has no scatter
        "SELECT model_parameter_id, mean, cycles,
                coalesce(sdv, (SELECT of_cycle.std_error FROM cycle_parameter AS of_cycle JOIN cycle USING (cycle_id)
                             WHERE cycle.run_id = parameter_statistic.run_id AND parameter_statistic.cycles = 1
                                   AND of_cycle.model_parameter_id = parameter_statistic.model_parameter_id
                                   AND cycle.status = 'complete' AND NOT cycle.doubtful
                            LIMIT 1)) AS sdv
         FROM parameter_statistic
         WHERE run_id = $1 AND \"window\" = 'all'
         ORDER BY model_parameter_id",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(MeanParameter {
            model_parameter_id: row.try_get("model_parameter_id")?,
            mean: row.try_get("mean")?,
            std_dev: row.try_get::<Option<f64>, _>("sdv")?.unwrap_or(f64::NAN),
            cycles: size(&row, "cycles")?,
        })
    })
    .fetch_all(executor)
    .await
}
