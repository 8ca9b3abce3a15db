//! Places for resuming the reading after a restart.

use sqlx::Row;

use crate::engine::{Bind, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{count, size};
use armwatch_model::run::ContentPrefix;

/// A place of an export between two cycles, in a format that only its writer knows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredPoint {
    /// Cycles before it.
    pub cycles: u32,
    /// Byte of the decompressed file, the first to be read next.
    pub byte: u64,
    /// State of the reader at that byte.
    pub state: Vec<u8>,
}

/// Source of the cycles of a run so far.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadSoFar {
    /// First bytes of the file.
    pub prefix: ContentPrefix,
    /// Place for resuming the reading; `None` keeps the stored place.
    pub resume: Option<StoredPoint>,
    /// True if the end of the file has cut the cycle, so that the cycle changes if the file grows.
    pub cut_by_end: bool,
}

impl Store {
    /// Place for resuming the reading of a run after its stored cycles.
    pub async fn resume_point(&self, run_id: i64) -> Result<Option<StoredPoint>, StoreError> {
        self.checked(of_run(&self.readers, run_id).await)
    }

    /// Deletes the place, so that the run is read from its start next time.
    pub async fn forget_resume_point(&self, run_id: i64) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        self.checked(forget(&mut *transaction, run_id).await)?;
        self.commit(transaction).await
    }
}

/// Stores the place for resuming the reading of a run.
pub(crate) async fn set(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    point: &StoredPoint,
) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO resume_point (run_id, cycles, byte, state) VALUES ($1, $2, $3, $4)
         ON CONFLICT (run_id) DO UPDATE
         SET cycles = excluded.cycles, byte = excluded.byte, state = excluded.state",
    )
    .bind_all((run_id, point.cycles, count(point.byte), &point.state))
    .run(executor)
    .await
}

/// Place for resuming the reading of a run, if the cycles before it are stored.
pub(crate) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Option<StoredPoint>> {
    sqlx::query(
        "SELECT cycles, byte, state
         FROM resume_point JOIN run USING (run_id)
         WHERE run_id = $1 AND cycles <= cycles_stored",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(StoredPoint {
            cycles: size(&row, "cycles")?,
            byte: size(&row, "byte")?,
            state: row.try_get("state")?,
        })
    })
    .fetch_optional(executor)
    .await
}

/// Deletes the place, so that the run is read from its start next time.
pub(crate) async fn forget(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM resume_point WHERE run_id = $1").bind(run_id).run(executor).await
}
