//! Progress of reading a run, and its end.

use crate::engine::{Bind, EngineExecutor, Run};
use crate::values::{count, finite};
use armwatch_model::run::ContentPrefix;

/// Totals of a run that are known after its last row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunTotals {
    /// Rows of the export.
    pub rows: usize,
    /// Bad rows that were skipped, in addition to those.
    pub rows_skipped: usize,
    /// Sample rate, Hz.
    pub sample_rate: f64,
    /// Cycles of the export; all of them must be stored.
    pub cycles: u32,
}

/// The description that a cycle was analysed with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Description {
    /// Its key.
    pub(crate) robot_model_id: i64,
    /// Hash of everything that results depend on.
    pub(crate) figures_hash: [u8; 32],
}

/// Advances the progress by one cycle, and stores the source of the cycles if it is known.
pub(crate) async fn advance(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    description: &Description,
    read: Option<&ContentPrefix>,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET cycles_stored = cycles_stored + 1, robot_model_id = $1, figures_hash = $2,
             prefix_bytes = coalesce($3, prefix_bytes),
             prefix_hash = coalesce($4, prefix_hash)
         WHERE run_id = $5",
    )
    .bind_all((description.robot_model_id, &description.figures_hash[..]))
    .bind_all((read.map(|prefix| count(prefix.bytes)), read.map(|prefix| &prefix.hash.0[..]), run_id))
    .run(executor)
    .await
}

pub(crate) async fn mark_complete(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    totals: RunTotals,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE run
         SET status = 'complete', rows = $1, rows_skipped = $2, sample_rate_hz = $3, cycles_total = $4,
             growing = FALSE, prefix_bytes = NULL, prefix_hash = NULL
         WHERE run_id = $5",
    )
    .bind_all((count(totals.rows), count(totals.rows_skipped), finite(totals.sample_rate), totals.cycles))
    .bind(run_id)
    .run(executor)
    .await
}
