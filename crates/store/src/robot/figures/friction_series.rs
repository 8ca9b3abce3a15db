//! Friction points of a test at one speed level, in one row: fits over a robot's tests read three dozen rows instead of
//! ten thousand.
//!
//! The row is computed from other tables. Conclusions that have read those tables write it, for the tests of fits. It
//! is valid as long as its revision is that of the test and the program uses the method that computed it. Otherwise the
//! tables are read.

use std::collections::HashMap;

use super::packed::{packed, unpacked};
use crate::engine::{Bind, EngineConnection, EngineExecutor, Run};
use armwatch_model::analysis::FrictionPoint;

/// Friction points used by fits over the tests of a robot.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionSeries {
    /// Speed level, as a fraction of the largest speed.
    pub speed_fraction: f64,
    /// Points of each test, oldest test first; times count from the start of the test.
    pub tests: Vec<TestPoints>,
}

/// Friction points of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct TestPoints {
    /// Database key.
    pub run_id: i64,
    /// Number of changes of the test when they were read.
    pub revision: i64,
    /// Its points at the speed level.
    pub points: Vec<FrictionPoint>,
    /// True if they were already stored in one row.
    pub is_stored: bool,
}

impl FrictionSeries {
    /// The points of all tests.
    pub fn points(&self) -> Vec<FrictionPoint> {
        self.tests.iter().flat_map(|test| &test.points).copied().collect()
    }
}

/// The series of a robot at one speed level, by run.
pub(in crate::robot) async fn of_robot(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    speed_fraction: f64,
    method: u64,
) -> sqlx::Result<HashMap<i64, Vec<FrictionPoint>>> {
    let rows: Vec<(i64, Vec<u8>)> = sqlx::query_as(
        "SELECT run.run_id, series.numbers
         FROM run_friction_series AS series
         CROSS JOIN run
         WHERE run.run_id = series.run_id AND run.revision = series.revision
               AND series.robot_id = $1 AND series.speed_fraction = $2 AND series.method = $3",
    )
    .bind_all((robot_id, speed_fraction, method.cast_signed()))
    .fetch_all(executor)
    .await?;
    Ok(rows.into_iter().filter_map(|(run_id, bytes)| Some((run_id, unpacked(&bytes)?))).collect())
}

/// Replaces the stored series of a robot by those of this history. Call this in the transaction of a conclusion whose
/// history is still the one that was read.
pub(in crate::robot) async fn keep(
    connection: &mut EngineConnection,
    robot_id: i64,
    history: &FrictionSeries,
    method: u64,
) -> sqlx::Result<()> {
    let stored: Vec<(i64, f64)> =
        sqlx::query_as("SELECT run_id, speed_fraction FROM run_friction_series WHERE robot_id = $1")
            .bind(robot_id)
            .fetch_all(&mut *connection)
            .await?;
    let is_kept = |run_id: i64, speed: f64| {
        // equal levels are bitwise equal
        speed.to_bits() == history.speed_fraction.to_bits()
            && history.tests.iter().any(|test| test.run_id == run_id && test.is_stored)
    };
    for (run_id, speed) in stored.into_iter().filter(|(run_id, speed)| !is_kept(*run_id, *speed)) {
        remove(&mut *connection, run_id, speed).await?;
    }
    for test in history.tests.iter().filter(|test| !test.is_stored) {
        sqlx::query(
            "INSERT INTO run_friction_series (robot_id, run_id, speed_fraction, revision, method, numbers)
             SELECT $1, run_id, $3, $4, $5, $6 FROM run WHERE run_id = $2 AND robot_id = $1",
        )
        .bind_all((robot_id, test.run_id, history.speed_fraction, test.revision, method.cast_signed()))
        .bind(packed(&test.points)?)
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

async fn remove(executor: impl EngineExecutor<'_>, run_id: i64, speed_fraction: f64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM run_friction_series WHERE run_id = $1 AND speed_fraction = $2")
        .bind_all((run_id, speed_fraction))
        .run(executor)
        .await
}
