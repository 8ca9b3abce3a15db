//! Friction points of a test at one speed level, in one row: fits over a robot's tests read three dozen rows in place of
//! ten thousand.
//!
//! The row follows from other tables and says nothing that they do not. It is written with the conclusions that have read
//! those tables, for the tests that fits stand on alone. Triggers take it away when one of the tables changes (migration
//! 0038); where it is not there, or of another format, the tables are asked.

use std::collections::HashMap;

use super::packed::{Reader, add_count, add_joint, add_numbers};
use crate::engine::{EngineConnection, EngineExecutor};
use armwatch_model::analysis::{FrictionPoint, GravityRemoval};

/// First byte of the numbers; other values are of another format.
const FORMAT: u8 = 1;

const GRAVITY_REMOVALS: [GravityRemoval; 3] =
    [GravityRemoval::AxisVertical, GravityRemoval::Fitted, GravityRemoval::Model];

/// Friction points that fits over the tests of a robot stand on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionHistory {
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
    /// Its points at the speed level.
    pub points: Vec<FrictionPoint>,
    /// Whether they were stored in one row already.
    pub is_stored: bool,
}

impl FrictionHistory {
    /// The points of all tests.
    #[must_use]
    pub fn points(&self) -> Vec<FrictionPoint> {
        self.tests.iter().flat_map(|test| &test.points).copied().collect()
    }
}

/// The series of a robot at one speed level, by run.
pub(in crate::robot) async fn of_robot(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    speed_fraction: f64,
) -> Result<HashMap<i64, Vec<FrictionPoint>>, sqlx::Error> {
    let rows: Vec<(i64, Vec<u8>)> = sqlx::query_as(
        "SELECT run_id, numbers FROM run_friction_series WHERE robot_id = $1 AND speed_fraction = $2",
    )
    .bind(robot_id)
    .bind(speed_fraction)
    .fetch_all(executor)
    .await?;
    Ok(rows.into_iter().filter_map(|(run_id, bytes)| Some((run_id, unpacked(&bytes)?))).collect())
}

/// Makes the stored series of a robot those of this history. Call in the transaction of a conclusion whose history is the
/// one that was read.
pub(in crate::robot) async fn keep(
    connection: &mut EngineConnection,
    robot_id: i64,
    history: &FrictionHistory,
) -> Result<(), sqlx::Error> {
    let stored: Vec<(i64, f64)> =
        sqlx::query_as("SELECT run_id, speed_fraction FROM run_friction_series WHERE robot_id = $1")
            .bind(robot_id)
            .fetch_all(&mut *connection)
            .await?;
    let is_kept = |run_id: i64, speed: f64| {
        // a level is the same number where it is the same level
        speed.to_bits() == history.speed_fraction.to_bits()
            && history.tests.iter().any(|test| test.run_id == run_id && test.is_stored)
    };
    for (run_id, speed) in stored.into_iter().filter(|(run_id, speed)| !is_kept(*run_id, *speed)) {
        remove(&mut *connection, run_id, speed).await?;
    }
    for test in history.tests.iter().filter(|test| !test.is_stored) {
        sqlx::query(
            "INSERT INTO run_friction_series (robot_id, run_id, speed_fraction, numbers)
             SELECT $1, run_id, $3, $4 FROM run WHERE run_id = $2 AND robot_id = $1",
        )
        .bind(robot_id)
        .bind(test.run_id)
        .bind(history.speed_fraction)
        .bind(packed(&test.points))
        .execute(&mut *connection)
        .await?;
    }
    Ok(())
}

async fn remove(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    speed_fraction: f64,
) -> Result<(), sqlx::Error> {
    sqlx::query("DELETE FROM run_friction_series WHERE run_id = $1 AND speed_fraction = $2")
        .bind(run_id)
        .bind(speed_fraction)
        .execute(executor)
        .await?;
    Ok(())
}

/// The format, the count, then the points; all numbers little-endian.
fn packed(points: &[FrictionPoint]) -> Vec<u8> {
    let mut bytes = vec![FORMAT];
    add_count(&mut bytes, points.len());
    for of in points {
        add_joint(&mut bytes, of.joint);
        bytes.extend(of.direction.to_le_bytes());
        let gravity = GRAVITY_REMOVALS.iter().position(|removal| *removal == of.gravity).unwrap_or_default();
        bytes.push(u8::try_from(gravity).unwrap_or_default());
        add_count(&mut bytes, of.samples);
        add_numbers(&mut bytes, [of.time, of.speed_fraction, of.speed, of.torque, of.std]);
    }
    bytes
}

/// `None` for bytes of another format.
fn unpacked(bytes: &[u8]) -> Option<Vec<FrictionPoint>> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let points = reader.list(|reader| {
        let joint = reader.joint()?;
        let direction = i8::from_le_bytes(reader.take()?);
        let gravity = *GRAVITY_REMOVALS.get(usize::from(reader.u8()?))?;
        let samples = usize::try_from(reader.u32()?).ok()?;
        let [time, speed_fraction, speed, torque, std] = reader.numbers()?;
        Some(FrictionPoint { joint, time, speed_fraction, speed, direction, torque, std, samples, gravity })
    })?;
    reader.0.is_empty().then_some(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::JointIndex;

    #[test]
    fn points_come_back_to_the_last_bit() {
        let point = |gravity, direction| FrictionPoint {
            joint: JointIndex::new(5),
            time: 1.0 / 3.0,
            speed_fraction: 0.6,
            speed: f64::MIN_POSITIVE,
            direction,
            torque: -1e-300,
            std: 0.25,
            samples: 70_000,
            gravity,
        };
        let points: Vec<FrictionPoint> = GRAVITY_REMOVALS
            .into_iter()
            .flat_map(|gravity| [point(gravity, -1), point(gravity, 1)])
            .collect();
        let bytes = packed(&points);
        assert_eq!(unpacked(&bytes), Some(points));
        assert_eq!(unpacked(&bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked(&[&bytes[..], &[0]].concat()), None);
        assert_eq!(unpacked(&[2]), None);
        assert_eq!(unpacked(&packed(&[])), Some(Vec::new()));
    }
}
