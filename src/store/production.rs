//! Windows of production held against parameters of tests.

use sqlx::sqlite::SqliteExecutor;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

use super::analyses::of_some_rows;
use super::values::{ROWS_PER_STATEMENT, count, finite, joint_number};
use crate::analysis::{JointCheck, ProductionCheck};

/// Tests that are looked at until one has parameters of the robot's present description.
const MOST_REFERENCES: i64 = 8;

/// Writes the check of a window that has none. Call in a transaction.
pub(super) async fn record(
    connection: &mut SqliteConnection,
    cycle_id: i64,
    check: &ProductionCheck,
) -> Result<(), sqlx::Error> {
    for joints in check.joints.chunks(ROWS_PER_STATEMENT) {
        insert(&mut *connection, cycle_id, check.reference_run_id, joints).await?;
    }
    Ok(())
}

/// Writes the check of a window, given by its number, unless it has one. Call in a transaction.
pub(super) async fn add(
    connection: &mut SqliteConnection,
    run_id: i64,
    cycle: u32,
    check: &ProductionCheck,
) -> Result<(), sqlx::Error> {
    match unchecked_cycle(&mut *connection, run_id, cycle).await? {
        Some(cycle_id) => record(connection, cycle_id, check).await,
        None => Ok(()),
    }
}

async fn unchecked_cycle(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    cycle: u32,
) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT cycle_id FROM cycle
         WHERE run_id = ? AND number = ?
               AND NOT EXISTS (SELECT 1 FROM production_check WHERE production_check.cycle_id = cycle.cycle_id)",
    )
    .bind(run_id)
    .bind(cycle)
    .fetch_optional(executor)
    .await
}

async fn insert(
    executor: impl SqliteExecutor<'_>,
    cycle_id: i64,
    reference_run_id: i64,
    joints: &[JointCheck],
) -> Result<(), sqlx::Error> {
    QueryBuilder::<Sqlite>::new(
        "INSERT INTO production_check (cycle_id, joint, reference_run_id, rmsd_nm, relative_rmsd, samples,
                                       moving_rmsd_nm, moving_relative_rmsd, moving_samples, bias_nm, max_nm) ",
    )
    .push_values(joints, |mut row, check| {
        row.push_bind(cycle_id).push_bind(joint_number(check.joint)).push_bind(reference_run_id);
        for rmsd in [check.rmsd.all_rows, check.rmsd.moving_rows] {
            row.push_bind(of_some_rows(rmsd, rmsd.value))
                .push_bind(of_some_rows(rmsd, rmsd.relative))
                .push_bind(count(rmsd.samples));
        }
        row.push_bind(check.bias.and_then(finite)).push_bind(check.max.and_then(finite));
    })
    .build()
    .execute(executor)
    .await?;
    Ok(())
}

/// Complete tests with parameters of the robot of `run_id`, the latest no later than it first, then the
/// first later one.
pub(super) async fn reference_runs(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT test.run_id
         FROM run
         JOIN run AS test USING (robot_id)
         WHERE run.run_id = ? AND test.status = 'complete' AND test.kind = 'test'
               AND EXISTS (SELECT 1 FROM cycle WHERE cycle.run_id = test.run_id AND cycle.status = 'complete')
         ORDER BY test.started_at > run.started_at, abs(test.started_at - run.started_at), test.run_id DESC
         LIMIT ?",
    )
    .bind(run_id)
    .bind(MOST_REFERENCES)
    .fetch_all(executor)
    .await
}

/// Runs of production of the robot of `run_id` with windows that could be checked and are not.
pub(super) async fn unchecked_runs(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT run.run_id FROM run
         WHERE robot_id = (SELECT robot_id FROM run WHERE run_id = ?) AND kind = 'production'
               AND run.status <> 'quarantined'
               AND EXISTS (
                   SELECT 1 FROM cycle
                   WHERE cycle.run_id = run.run_id AND cycle.status = 'complete'
                         AND cycle.cycle_id NOT IN (SELECT cycle_id FROM production_check)
               )
         ORDER BY run.run_id",
    )
    .bind(run_id)
    .fetch_all(executor)
    .await
}

/// The run whose parameters a window was held against.
pub(super) async fn checked_against(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
    cycle: u32,
) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT reference_run_id FROM cycle JOIN production_check USING (cycle_id)
         WHERE run_id = ? AND number = ?
         LIMIT 1",
    )
    .bind(run_id)
    .bind(cycle)
    .fetch_optional(executor)
    .await
}
