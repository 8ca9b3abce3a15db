//! Fit of each cycle's model to the cycle as a whole, which shows contacts.

use sqlx::Row;

use crate::engine::{EngineExecutor, EngineRow};
use crate::values::{joint, size};
use armwatch_model::analysis::measurements::CycleRmsd;

/// The moving relative RMSD of every cycle of a run that counts, in the order of cycles and joints; the run may be
/// incomplete.
pub(crate) async fn of_run(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Vec<CycleRmsd>> {
    sqlx::query(
        "SELECT cycle.number AS cycle, joint, moving_relative_rmsd
         FROM cycle
         JOIN torque_rmsd USING (cycle_id)
         WHERE cycle.run_id = $1 AND cycle.status = 'complete' AND NOT cycle.doubtful
               AND stage = 'all' AND verification = 'self' AND moving_relative_rmsd IS NOT NULL
         ORDER BY cycle.number, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| of_row(&row))
    .fetch_all(executor)
    .await
}

/// A row with the columns `cycle`, `joint` and `moving_relative_rmsd`.
pub(in crate::robot) fn of_row(row: &EngineRow) -> sqlx::Result<CycleRmsd> {
    Ok(CycleRmsd {
        cycle: size(row, "cycle")?,
        joint: joint(row, "joint")?,
        relative_rmsd: row.try_get("moving_relative_rmsd")?,
    })
}
