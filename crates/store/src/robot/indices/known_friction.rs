//! Stored data of complete tests for their friction indices.

use std::collections::HashMap;

use sqlx::Row;

use super::baselines::{FrictionTest, FrictionTests, IndexBasis, basis, in_force};
use crate::engine::{EngineConnection, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::maintenance::{self, DescriptionKey};
use crate::values::{joint, json_list};
use armwatch_model::anomaly::epoch::TestMoment;
use armwatch_model::robot::JointIndex;

impl Store {
    /// Data of a robot's complete tests for their friction indices.
    pub async fn friction_tests(&self, robot_id: i64) -> Result<FrictionTests, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(of_robot(&mut connection, robot_id).await)
    }
}

async fn of_robot(connection: &mut EngineConnection, robot_id: i64) -> sqlx::Result<FrictionTests> {
    let moments = maintenance::test_moments(&mut *connection, robot_id).await?;
    of_moments(connection, robot_id, moments).await
}

/// Data of the tests of these keys.
pub(in crate::robot) async fn of_keys(
    connection: &mut EngineConnection,
    robot_id: i64,
    keys: &[i64],
) -> sqlx::Result<FrictionTests> {
    let moments = maintenance::moments_of(&mut *connection, robot_id, keys).await?;
    of_moments(connection, robot_id, moments).await
}

async fn of_moments(
    connection: &mut EngineConnection,
    robot_id: i64,
    moments: Vec<(i64, TestMoment<DescriptionKey>)>,
) -> sqlx::Result<FrictionTests> {
    let keys: Vec<i64> = moments.iter().map(|(run_id, _)| *run_id).collect();
    let mut points = points_by_run(&mut *connection, &keys).await?;
    let test = |(run_id, moment): (i64, TestMoment<DescriptionKey>)| {
        let (basis, points) = points.remove(&run_id).map_or((None, None), |(basis, of)| (basis, Some(of)));
        FrictionTest { run_id, moment, points, basis }
    };
    let tests = moments.into_iter().map(test).collect();
    let maps = sqlx::query("SELECT joint, basis FROM friction_law WHERE robot_id = $1 AND basis IS NOT NULL")
        .bind(robot_id)
        .try_map(|row: EngineRow| Ok((joint(&row, "joint")?, basis(&row)?.unwrap_or_default())))
        .fetch_all(&mut *connection)
        .await?;
    Ok(FrictionTests {
        tests,
        work: maintenance::of_robot(&mut *connection, robot_id).await?,
        baselines: in_force(connection, robot_id).await?,
        maps: maps.into_iter().collect(),
    })
}

type KnownPoints = (Option<IndexBasis>, Vec<(JointIndex, usize)>);

async fn points_by_run(
    connection: &mut EngineConnection,
    keys: &[i64],
) -> sqlx::Result<HashMap<i64, KnownPoints>> {
    // one row per test: `joint points joint points ...`
    let rows = sqlx::query(
        "SELECT run.run_id, run_friction.run_id IS NOT NULL AS is_known, run_friction.basis,
                (SELECT string_agg(joint || ' ' || points, ' ') FROM run_friction_points
                 WHERE run_friction_points.run_id = run.run_id) AS points
         FROM run
         LEFT JOIN run_friction USING (run_id)
         WHERE run.run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))",
    )
    .bind(json_list(keys))
    .try_map(|row: EngineRow| {
        let (is_known, points): (bool, Option<&str>) = (row.try_get("is_known")?, row.try_get("points")?);
        if !is_known && points.is_none() {
            return Ok(None);
        }
        let known = (basis(&row)?, points_by_joint(points.unwrap_or_default())?);
        Ok(Some((row.try_get::<i64, _>("run_id")?, known)))
    })
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().flatten().collect())
}

/// Reads `joint points joint points ...`, by joint.
fn points_by_joint(text: &str) -> sqlx::Result<Vec<(JointIndex, usize)>> {
    let unknown = || sqlx::Error::Decode(format!("friction points of joints: {text}").into());
    let words: Vec<&str> = text.split_whitespace().collect();
    let pair = |pair: &[&str]| {
        let [joint, points] = pair else { return None };
        Some((JointIndex::from_number(joint.parse().ok()?)?, points.parse().ok()?))
    };
    let found: Option<Vec<(JointIndex, usize)>> = words.chunks(2).map(pair).collect();
    let mut found = found.ok_or_else(unknown)?;
    found.sort_unstable();
    Ok(found)
}
