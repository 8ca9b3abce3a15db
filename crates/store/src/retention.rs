//! Retention: which factors are due for removal, their removal, and the space that this frees.
//!
//! Results are never changed. Factors that future conclusions need stay too: those of runs that are being read, of
//! robots whose history has no conclusion, of tests of baselines, and of the last tests of each description, which
//! production is compared with.

use jiff::Timestamp;
use sqlx::{AssertSqlSafe, Row};

use super::error::StoreError;
use super::handle::Store;
use super::results::joined_factors::remove_of;
use super::values::{count, named, size};
use crate::engine::{Bind, Dialect, EngineExecutor, EngineRow, catalog};
use armwatch_model::run::RunKind;

/// Tests that are examined for a production window until one has parameters. This many of the latest tests of a robot
/// keep their factors, whatever their age.
pub const MOST_REFERENCES: usize = 8;

/// Earliest time of factors of single cycles that are kept; `None` keeps all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct KeptSince {
    /// Tests.
    pub tests: Option<Timestamp>,
    /// Production.
    pub production: Option<Timestamp>,
}

/// A run whose cycles have their own factors that are due.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DueRun {
    /// The run.
    pub run_id: i64,
    /// Its robot.
    pub robot: String,
    /// Its kind: factors of a test are removed, those of a production log joined.
    pub kind: RunKind,
    /// Cycles with their own factors.
    pub cycles: u64,
    /// Size of these factors, bytes; the pages that contain them need some 15 % more.
    pub bytes: u64,
}

/// Free space inside the file of a database.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FreeSpace {
    /// Size of a page, bytes.
    pub page_bytes: u64,
    /// Pages of the file.
    pub pages: u64,
    /// Unused pages among them; new data fills them first.
    pub free_pages: u64,
    /// True if they can be returned to the file system while the database is in use.
    pub can_shrink: bool,
}

impl FreeSpace {
    /// Unused bytes.
    pub fn bytes(&self) -> u64 {
        self.page_bytes * self.free_pages
    }
}

impl Store {
    /// Runs with factors that are due, oldest first. The age of a run begins at its last cycle, or when it was stored
    /// if that was later.
    pub async fn due_runs(&self, kept: &KeptSince) -> Result<Vec<DueRun>, StoreError> {
        if *kept == KeptSince::default() {
            return Ok(Vec::new());
        }
        let mut due = self.checked(due_runs(&self.readers, kept).await)?;
        for run in &mut due {
            run.bytes = self.checked(bytes_of(&self.readers, run.run_id).await)?;
        }
        Ok(due)
    }

    /// Deletes the factors of at most `most` cycles of a run in one transaction, and returns the number of cycles.
    /// Deletes none of a run that is being read.
    pub async fn remove_factors(&self, run_id: i64, most: usize) -> Result<usize, StoreError> {
        let mut transaction = self.begin().await?;
        let cycles = self.checked(cycles_with_factors(&mut *transaction, run_id, most).await)?;
        if !cycles.is_empty() {
            self.checked(remove_of(&mut transaction, &cycles, "removed").await)?;
        }
        self.commit(transaction).await?;
        Ok(cycles.len())
    }

    /// Free space in the file.
    pub async fn free_space(&self) -> Result<FreeSpace, StoreError> {
        const INCREMENTAL: u64 = 2;
        if self.dialect() == Dialect::Postgres {
            const PAGE: u64 = 8192;
            let bytes = self.checked(catalog::bytes_on_server(&self.readers).await)?;
            let pages = u64::try_from(bytes).unwrap_or(0) / PAGE;
            return Ok(FreeSpace { page_bytes: PAGE, pages, free_pages: 0, can_shrink: false });
        }
        let mut figures = [0_u64; 4];
        for (figure, pragma) in
            figures.iter_mut().zip(["page_size", "page_count", "freelist_count", "auto_vacuum"])
        {
            let asked = sqlx::query(AssertSqlSafe(format!("PRAGMA {pragma}")));
            let row = self.checked(asked.fetch_one(&self.readers).await)?;
            *figure = u64::try_from(self.checked(row.try_get::<i64, _>(0))?).unwrap_or(0);
        }
        let [page_bytes, pages, free_pages, auto_vacuum] = figures;
        Ok(FreeSpace { page_bytes, pages, free_pages, can_shrink: auto_vacuum == INCREMENTAL })
    }

    /// Returns at most `most` free pages to the file system, in one transaction. Does nothing in a database that was
    /// created without this ability, see [`FreeSpace::can_shrink`].
    pub async fn give_back(&self, most: u32) -> Result<(), StoreError> {
        let asked = sqlx::raw_sql(AssertSqlSafe(format!("PRAGMA incremental_vacuum({most})")));
        self.checked(asked.execute(&self.writer).await).map(|_| ())
    }
}

async fn due_runs(executor: impl EngineExecutor<'_>, kept: &KeptSince) -> sqlx::Result<Vec<DueRun>> {
    let limit = |since: Option<Timestamp>| since.map(|since| since.as_microsecond());
    // rows with factors are a bounded part of the database, so the query begins with them
    sqlx::query(
        "WITH kept AS (
             SELECT run_id
             FROM (SELECT run.run_id,
                          row_number() OVER (PARTITION BY run.robot_id, run.robot_model_id
                                             ORDER BY run.started_at DESC, run.run_id DESC) AS place
                   FROM run
                   WHERE run.kind = 'test' AND run.status = 'complete'
                         AND EXISTS (SELECT 1 FROM cycle WHERE cycle.run_id = run.run_id
                                     AND cycle.status = 'complete' AND NOT cycle.doubtful)) AS tests
             WHERE place <= $3
             UNION
             SELECT friction_baseline_run.run_id
             FROM friction_baseline_run
             JOIN friction_baseline USING (friction_baseline_id)
             WHERE replaced_at IS NULL
         ),
         own AS (
             SELECT cycle.run_id, count(*) AS cycles, max(cycle.started_at) AS ended_at
             FROM cycle_factor_layout
             CROSS JOIN cycle
             WHERE cycle.cycle_id = cycle_factor_layout.cycle_id
             GROUP BY cycle.run_id
         )
         SELECT run.run_id, robot.name AS robot, run.kind, own.cycles
         FROM own
         JOIN run USING (run_id)
         JOIN robot USING (robot_id)
         WHERE run.status <> 'streaming' AND robot.history = robot.concluded
               AND max(own.ended_at, run.started_at, run.ingested_at) < CASE WHEN run.kind = 'test' THEN $1 ELSE $2 END
               AND NOT (run.kind = 'test' AND run.run_id IN (SELECT run_id FROM kept))
         ORDER BY run.started_at, run.run_id",
    )
    .bind_all((limit(kept.tests), limit(kept.production), count(MOST_REFERENCES)))
    .try_map(|row: EngineRow| {
        Ok(DueRun {
            run_id: row.try_get("run_id")?,
            robot: row.try_get("robot")?,
            kind: named(&row, "kind", &[RunKind::Test, RunKind::Production], RunKind::name)?,
            cycles: size(&row, "cycles")?,
            bytes: 0,
        })
    })
    .fetch_all(executor)
    .await
}

async fn bytes_of(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<u64> {
    sqlx::query(
        "SELECT CAST(coalesce(sum(length(factor)), 0) AS BIGINT) AS bytes
         FROM cycle JOIN torque_factor USING (cycle_id) WHERE run_id = $1",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| size(&row, "bytes"))
    .fetch_one(executor)
    .await
}

async fn cycles_with_factors(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    most: usize,
) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT cycle_id FROM run JOIN cycle USING (run_id) JOIN cycle_factor_layout USING (cycle_id)
         WHERE run_id = $1 AND run.status <> 'streaming'
         ORDER BY cycle.number
         LIMIT $2",
    )
    .bind_all((run_id, count(most)))
    .fetch_all(executor)
    .await
}
