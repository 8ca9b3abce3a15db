//! Noise of the torque channels by cycle.

use sqlx::{QueryBuilder, Row};

use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow};
use crate::values::{ROWS_PER_STATEMENT, joint, joint_number, size};
use armwatch_model::analysis::TorqueNoise;
use armwatch_model::analysis::measurements::CycleNoise;

/// Inserts the noise of a cycle. Call this in a transaction.
pub(crate) async fn record(
    connection: &mut EngineConnection,
    cycle_id: i64,
    noises: &[TorqueNoise],
) -> sqlx::Result<()> {
    let known: Vec<&TorqueNoise> =
        noises.iter().filter(|of| of.value.is_finite() && of.relative.is_finite()).collect();
    for rows in known.chunks(ROWS_PER_STATEMENT) {
        QueryBuilder::<Engine>::new("INSERT INTO channel_noise (cycle_id, joint, noise_nm, relative_noise) ")
            .push_values(rows, |mut row, of| {
                row.bind_all((cycle_id, joint_number(of.joint), of.value, of.relative));
            })
            .build()
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

/// Noise of the cycles of a run that count, in the order of cycles and joints.
pub(crate) async fn of_run(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Vec<CycleNoise>> {
    sqlx::query(
        "SELECT cycle.number AS cycle, joint, noise_nm, relative_noise
         FROM cycle
         JOIN channel_noise USING (cycle_id)
         WHERE cycle.run_id = $1 AND cycle.status = 'complete' AND NOT cycle.doubtful
         ORDER BY cycle.number, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let (noise, relative_noise): (f64, f64) = (row.try_get("noise_nm")?, row.try_get("relative_noise")?);
        Ok(CycleNoise {
            cycle: size(&row, "cycle")?,
            joint: joint(&row, "joint")?,
            relative_noise,
            torque_rms: noise / relative_noise,
        })
    })
    .fetch_all(executor)
    .await
}
