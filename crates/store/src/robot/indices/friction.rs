//! Friction over speed and thermal state: read for maps, written at the end of a run.

use std::collections::{HashMap, HashSet};

use jiff::Timestamp;
use sqlx::{QueryBuilder, Row};

use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run, begin_reading};
use crate::error::StoreError;
use crate::handle::Store;
use crate::robot::figures::friction_series::{self, FrictionSeries, TestPoints};
use crate::robot::history;
use crate::values::{ROWS_PER_STATEMENT, count, finite, joint, joint_number, json_numbers, size, time};
use armwatch_model::analysis::friction::{
    FrictionIndex, FrictionMap, JointSpeedFits, SpeedCoefficient, SpeedFit, ThermalSource,
};
use armwatch_model::analysis::map_run::CycleMotion;
use armwatch_model::analysis::{CycleTemperatures, Estimate};
use armwatch_model::robot::JointIndex;
use armwatch_model::run::temperature::ZERO_CELSIUS;

/// Runs used for warm-up fits over runs in a longer history: the first and the latest ones. This bounds the work of a
/// conclusion.
const FIRST_RUNS: i64 = 12;
const LATEST_RUNS: i64 = 24;

pub(super) const MICROSECONDS: f64 = 1e6;

/// Friction over speed of one cycle.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleSpeedFits {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// One entry per joint.
    pub joints: Vec<JointSpeedFits>,
}

impl Store {
    /// Reads the friction points of a robot's complete runs at one nominal speed, oldest run first. In a long history
    /// only the first dozen and the latest two dozen runs are used. Times count from the start of each point's own run.
    pub async fn friction_history(
        &self,
        robot_id: i64,
        speed_fraction: f64,
        method: u64,
    ) -> Result<FrictionSeries, StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        self.checked(friction_history(&mut snapshot, robot_id, speed_fraction, method).await)
    }

    /// Friction indices of the complete runs of a robot, by joint, oldest run first.
    pub async fn friction_indices(&self, robot: &str) -> Result<Vec<IndexRow>, StoreError> {
        self.checked(indices(&self.readers, robot).await)
    }

    /// Source of the thermal state of each joint of a robot that has a friction map, by joint.
    pub async fn thermal_sources(&self, robot: &str) -> Result<Vec<ThermalSourceRow>, StoreError> {
        self.checked(thermal_sources(&self.readers, robot).await)
    }

    /// Reads cut-off and sample rate, Hz, of each cycle of a run that has both, by number of the cycle.
    pub async fn cutoffs_and_rates(&self, run_id: i64) -> Result<HashMap<u32, [f64; 2]>, StoreError> {
        self.checked(cutoffs_and_rates(&self.readers, run_id).await)
    }
}

/// Friction points of the robot's first and latest complete runs at one nominal speed, oldest run first. Times count
/// from the start of each point's own run.
pub(crate) async fn friction_history(
    connection: &mut EngineConnection,
    robot_id: i64,
    speed_fraction: f64,
    method: u64,
) -> sqlx::Result<FrictionSeries> {
    let mut series = friction_series::of_robot(&mut *connection, robot_id, speed_fraction, method).await?;
    let mut tests = Vec::new();
    for (run_id, _, revision) in first_and_latest_runs(&mut *connection, robot_id).await? {
        let stored = series.remove(&run_id);
        let is_stored = stored.is_some();
        let points = match stored {
            Some(points) => points,
            None => history::friction_points_at(&mut *connection, run_id, speed_fraction).await?,
        };
        tests.push(TestPoints { run_id, revision, points, is_stored });
    }
    Ok(FrictionSeries { speed_fraction, tests })
}

/// Key, start in microseconds and revision of the first and latest complete runs of a robot, oldest first.
async fn first_and_latest_runs(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
) -> sqlx::Result<Vec<(i64, i64, i64)>> {
    sqlx::query_as(
        "SELECT run_id, started_at, revision FROM (
             SELECT run_id, started_at, revision FROM run
             WHERE robot_id = $1 AND kind = 'test' AND status = 'complete'
             ORDER BY started_at, run_id LIMIT $2) AS earliest
         UNION
         SELECT run_id, started_at, revision FROM (
             SELECT run_id, started_at, revision FROM run
             WHERE robot_id = $1 AND kind = 'test' AND status = 'complete'
             ORDER BY started_at DESC, run_id DESC LIMIT $3) AS latest
         ORDER BY started_at, run_id",
    )
    .bind_all((robot_id, FIRST_RUNS, LATEST_RUNS))
    .fetch_all(executor)
    .await
}

/// The cycles of a run as intervals of motion: a test moves from its first row to its last. `temperatures` are those of
/// the cycles by key.
pub(in crate::robot) async fn motion(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    run_started_at: i64,
    mut temperatures: HashMap<i64, CycleTemperatures>,
) -> sqlx::Result<Vec<CycleMotion>> {
    sqlx::query(
        "SELECT cycle_id, started_at, duration_s, mean_speeds_rad_s FROM cycle
         WHERE run_id = $1 ORDER BY started_at",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let start = (row.try_get::<i64, _>("started_at")? - run_started_at) as f64 / MICROSECONDS;
        let duration: f64 = row.try_get("duration_s")?;
        let speeds: Option<&str> = row.try_get("mean_speeds_rad_s")?;
        let speeds = speeds.map_or(Ok(Vec::new()), serde_json::from_str);
        let speeds = speeds.map_err(|error| sqlx::Error::Decode(error.into()))?;
        let temperatures = temperatures.remove(&row.try_get("cycle_id")?).unwrap_or_default();
        Ok(CycleMotion { start, end: start + duration, speeds, temperatures })
    })
    .fetch_all(executor)
    .await
}

async fn cutoffs_and_rates(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<HashMap<u32, [f64; 2]>> {
    let rows = sqlx::query(
        "SELECT number, sample_rate_hz, cutoff_hz FROM cycle
         WHERE run_id = $1 AND sample_rate_hz > 0 AND cutoff_hz > 0",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let cutoff_and_rate = [row.try_get("cutoff_hz")?, row.try_get("sample_rate_hz")?];
        Ok((size::<u32>(&row, "number")?, cutoff_and_rate))
    })
    .fetch_all(executor)
    .await?;
    Ok(rows.into_iter().collect())
}

/// The friction index of one joint in one run, with its run.
#[derive(Debug, Clone, PartialEq)]
pub struct IndexRow {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the run.
    pub started_at: Timestamp,
    /// The joint.
    pub joint: JointIndex,
    /// 1 = unchanged.
    pub index: Estimate,
    /// Measured friction relative to that of the baseline.
    pub raw: Option<f64>,
    /// True if the run was too short for the map.
    pub short: bool,
}

/// Indices of a robot's complete runs, by joint, oldest run first.
pub(crate) async fn indices(executor: impl EngineExecutor<'_>, robot: &str) -> sqlx::Result<Vec<IndexRow>> {
    sqlx::query(
        "SELECT run.run_id, run.started_at, joint, friction_index, friction_index_std_error, raw_index, short_run
         FROM run
         JOIN robot USING (robot_id)
         JOIN run_friction_index USING (run_id)
         WHERE robot.name = $1 AND run.status = 'complete'
         ORDER BY joint, run.started_at, run.run_id",
    )
    .bind(robot)
    .try_map(|row: EngineRow| {
        let std_error: Option<f64> = row.try_get("friction_index_std_error")?;
        Ok(IndexRow {
            run_id: row.try_get("run_id")?,
            started_at: time(&row, "started_at")?,
            joint: joint(&row, "joint")?,
            index: Estimate {
                value: row.try_get("friction_index")?,
                std_error: std_error.unwrap_or(f64::NAN),
            },
            raw: row.try_get("raw_index")?,
            short: row.try_get("short_run")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Source of the thermal state of a joint's map.
#[derive(Debug, Clone, PartialEq)]
pub struct ThermalSourceRow {
    /// The joint.
    pub joint: JointIndex,
    /// Name as in the view `friction_map`.
    pub source: String,
    /// Facts that the map does not know or use, one sentence per line.
    pub remarks: Option<String>,
}

/// Sources of the maps of a robot, by joint.
pub(crate) async fn thermal_sources(
    executor: impl EngineExecutor<'_>,
    robot: &str,
) -> sqlx::Result<Vec<ThermalSourceRow>> {
    sqlx::query(
        "SELECT joint, thermal_source, remarks FROM friction_law
         JOIN robot USING (robot_id)
         WHERE robot.name = $1
         ORDER BY joint",
    )
    .bind(robot)
    .try_map(|row: EngineRow| {
        Ok(ThermalSourceRow {
            joint: joint(&row, "joint")?,
            source: row.try_get("thermal_source")?,
            remarks: row.try_get("remarks")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// Replaces the fits over speed of a run. Call this in a transaction.
pub(crate) async fn replace_speed_fits(
    connection: &mut EngineConnection,
    run_id: i64,
    fits: &[CycleSpeedFits],
) -> sqlx::Result<()> {
    delete_speed_fits(&mut *connection, run_id).await?;
    let cycles = cycle_keys(&mut *connection, run_id).await?;
    let mut sides: Vec<SideOfCycle<'_>> = Vec::new();
    for of_cycle in fits {
        let Some(&cycle_id) = cycles.get(&of_cycle.cycle) else { continue };
        for of_joint in &of_cycle.joints {
            let directions = of_joint.directions.iter();
            sides.extend(directions.map(|fit| SideOfCycle { cycle_id, of_joint, fit }));
        }
    }
    for sides in sides.chunks(ROWS_PER_STATEMENT) {
        let keys = insert_speed_fits(&mut *connection, sides).await?;
        let mut coefficients: Vec<(i64, SpeedCoefficient)> = Vec::new();
        for side in sides {
            let Some(&fit_id) = keys.get(&side.place()) else { continue };
            coefficients.extend(side.fit.coefficients.iter().map(|of| (fit_id, *of)));
        }
        for rows in coefficients.chunks(ROWS_PER_STATEMENT) {
            insert_coefficients(&mut *connection, rows).await?;
        }
    }
    Ok(())
}

/// The fit of one direction of a joint in a cycle.
struct SideOfCycle<'f> {
    cycle_id: i64,
    of_joint: &'f JointSpeedFits,
    fit: &'f SpeedFit,
}

impl SideOfCycle<'_> {
    /// Cycle, joint and direction: the unique place of a fit.
    fn place(&self) -> (i64, i64, i64) {
        (self.cycle_id, joint_number(self.of_joint.joint), i64::from(self.fit.direction))
    }
}

/// Keys of a run's cycles by number.
async fn cycle_keys(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<HashMap<u32, i64>> {
    let rows = sqlx::query("SELECT number, cycle_id FROM cycle WHERE run_id = $1")
        .bind(run_id)
        .try_map(|row: EngineRow| Ok((size(&row, "number")?, row.try_get("cycle_id")?)))
        .fetch_all(executor)
        .await?;
    Ok(rows.into_iter().collect())
}

async fn delete_speed_fits(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query(
        "DELETE FROM friction_speed_fit WHERE cycle_id IN (SELECT cycle_id FROM cycle WHERE run_id = $1)",
    )
    .bind(run_id)
    .run(executor)
    .await
}

/// Returns the key of each fit by its place.
async fn insert_speed_fits(
    executor: impl EngineExecutor<'_>,
    sides: &[SideOfCycle<'_>],
) -> sqlx::Result<HashMap<(i64, i64, i64), i64>> {
    let mut query = QueryBuilder::<Engine>::new(
        "INSERT INTO friction_speed_fit (cycle_id, joint, direction, model, slowest_rad_s, fastest_rad_s, rmsd_nm, \
                                         reduced_chi_square, points, asymmetry_nm, asymmetry_std_error_nm) ",
    );
    query.push_values(sides, |mut row, SideOfCycle { cycle_id, of_joint, fit }| {
        let difference = of_joint.asymmetry.map(|asymmetry| asymmetry.difference);
        row.bind_all((*cycle_id, joint_number(of_joint.joint), i64::from(fit.direction)))
            .bind_all((fit.model.name(), fit.speeds[0], fit.speeds[1], finite(fit.rmsd)))
            .bind_all((fit.reduced_chi_square.and_then(finite), count(fit.points)))
            .push_bind(difference.and_then(|d| finite(d.value)))
            .push_bind(difference.and_then(|d| finite(d.std_error)));
    });
    query.push(" RETURNING friction_speed_fit_id, cycle_id, joint, direction");
    let rows = query
        .build()
        .try_map(|row: EngineRow| {
            let place = (row.try_get("cycle_id")?, row.try_get("joint")?, row.try_get("direction")?);
            Ok((place, row.try_get("friction_speed_fit_id")?))
        })
        .fetch_all(executor)
        .await?;
    Ok(rows.into_iter().collect())
}

async fn insert_coefficients(
    executor: impl EngineExecutor<'_>,
    coefficients: &[(i64, SpeedCoefficient)],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO friction_speed_coefficient (friction_speed_fit_id, name, value, std_error, at_bound) ",
    )
    .push_values(coefficients, |mut row, (fit_id, coefficient)| {
        let error = finite(coefficient.estimate.std_error).filter(|_| !coefficient.at_bound);
        row.bind_all((*fit_id, coefficient.name, finite(coefficient.estimate.value), error))
            .push_bind(coefficient.at_bound);
    })
    .build()
    .run(executor)
    .await
}

/// Deletes the maps of a robot's joints that are not among `joints`.
pub(in crate::robot) async fn keep_maps(
    connection: &mut EngineConnection,
    robot_id: i64,
    joints: &HashSet<JointIndex>,
) -> sqlx::Result<()> {
    let stored: Vec<i64> = sqlx::query_scalar("SELECT joint FROM friction_law WHERE robot_id = $1")
        .bind(robot_id)
        .fetch_all(&mut *connection)
        .await?;
    let kept: HashSet<i64> = joints.iter().map(|joint| joint_number(*joint)).collect();
    for joint in stored.into_iter().filter(|joint| !kept.contains(joint)) {
        delete_map(&mut *connection, robot_id, joint).await?;
    }
    Ok(())
}

/// Replaces the map of a joint by one that was fitted on `basis`. Call this in a transaction.
pub(in crate::robot) async fn replace_map(
    connection: &mut EngineConnection,
    robot_id: i64,
    map: &FrictionMap,
    basis: &[u8; 32],
) -> sqlx::Result<()> {
    delete_map(&mut *connection, robot_id, joint_number(map.joint)).await?;
    insert_law(&mut *connection, robot_id, map, basis).await?;
    insert_levels(connection, robot_id, map).await
}

/// Replaces the friction indices of a run. Call this in a transaction.
pub(in crate::robot) async fn replace_indices(
    connection: &mut EngineConnection,
    run_id: i64,
    indices: &[FrictionIndex],
) -> sqlx::Result<()> {
    delete_indices(&mut *connection, run_id).await?;
    for rows in indices.chunks(ROWS_PER_STATEMENT) {
        insert_indices(&mut *connection, run_id, rows).await?;
    }
    Ok(())
}

async fn delete_map(executor: impl EngineExecutor<'_>, robot_id: i64, joint: i64) -> sqlx::Result<()> {
    // levels are deleted with their law
    sqlx::query("DELETE FROM friction_law WHERE robot_id = $1 AND joint = $2")
        .bind_all((robot_id, joint))
        .run(executor)
        .await
}

async fn delete_indices(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM run_friction_index WHERE run_id = $1").bind(run_id).run(executor).await
}

async fn insert_law(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    map: &FrictionMap,
    basis: &[u8; 32],
) -> sqlx::Result<()> {
    const SECONDS: f64 = 60.0;
    let law = &map.law;
    let remarks = (!map.remarks.is_empty()).then(|| map.remarks.join("\n"));
    let (mut motor, mut hall) = (None, None);
    match map.source {
        ThermalSource::Motion => {}
        ThermalSource::MotorTemperature { warm, cold, curvature } => motor = Some((warm, cold, curvature)),
        ThermalSource::AmbientAndMotion { usual, coldness } => hall = Some((usual, coldness)),
    }
    let celsius = |kelvin: f64| finite(kelvin - ZERO_CELSIUS);
    sqlx::query(
        "INSERT INTO friction_law (robot_id, joint, slow_min, slow_std_error_min, fast_min, fast_std_error_min,
                                   slow_share, slow_share_std_error, cooling_ratio, cooling_ratio_std_error,
                                   relative_rmsd, explained, runs, points, remarks, covariance, thermal_source,
                                   warm_degc, cold_degc, curvature, curvature_std_error, ambient_degc, coldness_1_k,
                                   coldness_std_error_1_k, basis)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16,
                 $17, $18, $19, $20, $21, $22, $23, $24, $25)",
    )
    .bind_all((robot_id, joint_number(map.joint), law.slow_s.value / SECONDS))
    .bind_all((finite(law.slow_s.std_error / SECONDS), law.fast_s.value / SECONDS))
    .bind_all((finite(law.fast_s.std_error / SECONDS), law.slow_share.value))
    .bind_all((finite(law.slow_share.std_error), law.cooling_ratio.value))
    .bind_all((finite(law.cooling_ratio.std_error), finite(map.relative_rmsd), finite(map.explained)))
    .bind_all((count(map.runs), count(map.points), remarks, json_numbers(&map.covariance)))
    .bind_all((map.source.name(), motor.and_then(|(warm, ..)| celsius(warm))))
    .bind(motor.and_then(|(_, cold, _)| celsius(cold)))
    .bind(motor.and_then(|(.., curvature)| finite(curvature.value)))
    .bind(motor.and_then(|(.., curvature)| finite(curvature.std_error)))
    .bind(hall.and_then(|(usual, _)| celsius(usual)))
    .bind(hall.and_then(|(_, coldness)| finite(coldness.value)))
    .bind_all((hall.and_then(|(_, coldness)| finite(coldness.std_error)), &basis[..]))
    .run(executor)
    .await
}

async fn insert_levels(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    map: &FrictionMap,
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO friction_level (robot_id, joint, speed_fraction, warm_nm, warm_std_error_nm, cold_nm,
                                     cold_std_error_nm) ",
    )
    .push_values(&map.levels, |mut row, level| {
        row.bind_all((robot_id, joint_number(map.joint), level.speed_fraction, finite(level.warm.value)))
            .bind_all((finite(level.warm.std_error), finite(level.cold.value)))
            .push_bind(finite(level.cold.std_error));
    })
    .build()
    .run(executor)
    .await
}

async fn insert_indices(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    rows: &[FrictionIndex],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO run_friction_index (run_id, joint, friction_index, friction_index_std_error, ambient_coldness,
                                         ambient_coldness_std_error, coldness_at_start, points, raw_index,
                                         short_run) ",
    )
    .push_values(rows, |mut row, found| {
        row.bind_all((run_id, joint_number(found.joint), finite(found.index.value)))
            .bind_all((finite(found.index.std_error), finite(found.ambient.value)))
            .bind_all((finite(found.ambient.std_error), finite(found.coldness_at_start)))
            .bind_all((count(found.points), finite(found.raw), found.short));
    })
    .build()
    .run(executor)
    .await
}
