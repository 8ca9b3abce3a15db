//! One factor for the windows of a production log, replacing one per window.

use std::collections::HashSet;
use std::sync::Arc;

use sqlx::{QueryBuilder, Row};

use super::factors::{self, FactorLayout, FactorsWanted};
use super::production_evidence;
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models::StoredModel;
use crate::values::{ROWS_PER_STATEMENT, count, joint, joint_number, named, size};
use armwatch_model::analysis::{CycleFactors, Motion, TorqueFactor};
use armwatch_model::robot::ParameterId;
use armwatch_model::run::Stage;

/// Factors of the joined windows of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct JoinedFactors {
    /// The log.
    pub run_id: i64,
    /// Description that their columns belong to.
    pub model: StoredModel,
    /// One factor per joint, stage and motion: of all rows of the joined windows.
    pub factors: CycleFactors,
}

/// Windows of a log that have their own factors, and the factors to be joined.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowsToJoin {
    /// The log.
    pub run_id: i64,
    /// Parameters of each joint's columns.
    pub columns: Arc<[Vec<ParameterId>]>,
    /// Factors of these windows, and those that earlier ones were joined into.
    pub factors: Vec<TorqueFactor>,
    cycle_ids: Vec<i64>,
    layout: i64,
    /// Rows of the windows joined before: an unchanged number shows that no other program has joined more since.
    joined_rows: i64,
}

impl WindowsToJoin {
    /// Number of windows.
    pub fn windows(&self) -> usize {
        self.cycle_ids.len()
    }
}

impl Store {
    /// Factors that windows of a run were joined into, one entry per choice of columns; none for a test.
    pub async fn joined_factors(&self, run_id: i64) -> Result<Vec<JoinedFactors>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(joined_factors(&mut connection, run_id).await)
    }

    /// The first windows of a run, at most `most`, that have their own factors over the same columns; `None` if no
    /// window has.
    pub async fn windows_to_join(
        &self,
        run_id: i64,
        most: usize,
    ) -> Result<Option<WindowsToJoin>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(windows_to_join(&mut connection, run_id, most).await)
    }

    /// Replaces the factors of `windows` by `joined`, in one transaction. Returns `false` and changes nothing if the
    /// stored factors have changed, or their run is being read.
    pub async fn join_windows(
        &self,
        windows: &WindowsToJoin,
        joined: &CycleFactors,
    ) -> Result<bool, StoreError> {
        let mut transaction = self.begin().await?;
        if !self.checked(are_as_read(&mut transaction, windows).await)? {
            return Ok(false);
        }
        self.checked(replace(&mut transaction, windows, joined).await)?;
        self.checked(remove_of(&mut transaction, &windows.cycle_ids, "joined").await)?;
        self.commit(transaction).await?;
        Ok(true)
    }
}

async fn joined_factors(connection: &mut EngineConnection, run_id: i64) -> sqlx::Result<Vec<JoinedFactors>> {
    let layouts: Vec<i64> = sqlx::query_scalar(
        "SELECT DISTINCT factor_layout_id FROM log_factor WHERE run_id = $1 ORDER BY factor_layout_id",
    )
    .bind(run_id)
    .fetch_all(&mut *connection)
    .await?;
    let mut found = Vec::with_capacity(layouts.len());
    for layout in layouts {
        let (model, columns): FactorLayout = factors::layout(&mut *connection, layout).await?;
        let factors = of_layout(&mut *connection, run_id, layout).await?;
        found.push(JoinedFactors { run_id, model, factors: CycleFactors { columns, factors } });
    }
    Ok(found)
}

async fn windows_to_join(
    connection: &mut EngineConnection,
    run_id: i64,
    most: usize,
) -> sqlx::Result<Option<WindowsToJoin>> {
    let heads = factors::heads(&mut *connection, run_id, &(0..=u32::MAX)).await?;
    let Some(first) = heads.first() else { return Ok(None) };
    let alike: Vec<_> = heads.iter().take_while(|head| head.layout == first.layout).take(most).collect();
    let range = first.cycle..=alike.last().map_or(first.cycle, |last| last.cycle);
    let mut by_cycle =
        factors::factors_by_cycle(&mut *connection, run_id, FactorsWanted::All, &range).await?;
    let (_, columns): FactorLayout = factors::layout(&mut *connection, first.layout).await?;
    let mut factors = of_layout(&mut *connection, run_id, first.layout).await?;
    let joined_rows = factors.iter().map(|of| count(of.rows)).sum();
    let cycle_ids: Vec<i64> = alike.iter().map(|head| head.cycle_id).collect();
    factors.extend(cycle_ids.iter().filter_map(|id| by_cycle.remove(id)).flatten());
    Ok(Some(WindowsToJoin { run_id, columns, factors, cycle_ids, layout: first.layout, joined_rows }))
}

async fn of_layout(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    layout: i64,
) -> sqlx::Result<Vec<TorqueFactor>> {
    sqlx::query(
        "SELECT joint, stage, motion, rows, factor FROM log_factor
         WHERE run_id = $1 AND factor_layout_id = $2
         ORDER BY log_factor_id",
    )
    .bind_all((run_id, layout))
    .try_map(|row: EngineRow| {
        Ok(TorqueFactor {
            joint: joint(&row, "joint")?,
            stage: named(&row, "stage", &Stage::ALL, Stage::name)?,
            motion: named(&row, "motion", &Motion::BOTH, Motion::name)?,
            rows: size(&row, "rows")?,
            upper: factors::numbers(row.try_get("factor")?)?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Checks that the windows still have the factors that were read, and that their log is not being read.
async fn are_as_read(connection: &mut EngineConnection, windows: &WindowsToJoin) -> sqlx::Result<bool> {
    let joined_rows: i64 = sqlx::query_scalar(
        "SELECT CAST(coalesce(sum(rows), 0) AS BIGINT) FROM log_factor WHERE run_id = $1 AND factor_layout_id = $2",
    )
    .bind_all((windows.run_id, windows.layout))
    .fetch_one(&mut *connection)
    .await?;
    let left: Vec<i64> = sqlx::query_scalar(
        "SELECT cycle_id FROM run JOIN cycle USING (run_id) JOIN cycle_factor_layout USING (cycle_id)
         WHERE run_id = $1 AND factor_layout_id = $2 AND run.status <> 'streaming'",
    )
    .bind_all((windows.run_id, windows.layout))
    .fetch_all(connection)
    .await?;
    let left: HashSet<i64> = left.into_iter().collect();
    Ok(joined_rows == windows.joined_rows && windows.cycle_ids.iter().all(|id| left.contains(id)))
}

async fn replace(
    connection: &mut EngineConnection,
    windows: &WindowsToJoin,
    joined: &CycleFactors,
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM log_factor WHERE run_id = $1 AND factor_layout_id = $2")
        .bind_all((windows.run_id, windows.layout))
        .execute(&mut *connection)
        .await?;
    for rows in joined.factors.chunks(ROWS_PER_STATEMENT) {
        insert(&mut *connection, windows, rows).await?;
    }
    Ok(())
}

async fn insert(
    executor: impl EngineExecutor<'_>,
    windows: &WindowsToJoin,
    rows: &[TorqueFactor],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO log_factor (run_id, factor_layout_id, joint, stage, motion, rows, factor) ",
    )
    .push_values(rows, |mut row, factor| {
        row.bind_all((windows.run_id, windows.layout, joint_number(factor.joint), factor.stage.name()))
            .bind_all((factor.motion.name(), count(factor.rows), factors::bytes(&factor.upper)));
    })
    .build()
    .run(executor)
    .await
}

/// Deletes the factors of cycles and stores their fate.
pub(crate) async fn remove_of(
    connection: &mut EngineConnection,
    cycle_ids: &[i64],
    gone: &str,
) -> sqlx::Result<()> {
    for ids in cycle_ids.chunks(ROWS_PER_STATEMENT) {
        production_evidence::remove_windows(&mut *connection, ids).await?;
        for (statement, end) in [
            ("DELETE FROM torque_factor WHERE cycle_id IN (", None),
            ("DELETE FROM cycle_factor_layout WHERE cycle_id IN (", None),
            ("UPDATE cycle SET factors_gone = ", Some(" WHERE cycle_id IN (")),
        ] {
            let mut query = QueryBuilder::<Engine>::new(statement);
            if let Some(end) = end {
                query.push_bind(gone).push(end);
            }
            let mut listed = query.separated(", ");
            for id in ids {
                listed.push_bind(*id);
            }
            listed.push_unseparated(")");
            query.build().execute(&mut *connection).await?;
        }
    }
    Ok(())
}
