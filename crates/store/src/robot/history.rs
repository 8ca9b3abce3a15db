//! Measurements of a run, as fits and detectors read them.

use std::collections::{BTreeMap, HashMap};

use sqlx::Row;

use super::figures::cycle_rmsd;
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::torque_noise;
use crate::values::{identified, joint, named, size};
use armwatch_model::analysis::measurements::{CycleParameters, CyclePoint, CycleRmsd, RunMeasurements};
use armwatch_model::analysis::{CarriedLoad, FrictionPoint, GravityRemoval, IdentifiedParameter};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};

const GRAVITY_REMOVALS: [GravityRemoval; 3] =
    [GravityRemoval::AxisVertical, GravityRemoval::Fitted, GravityRemoval::Model];

/// Nominal speeds closer than this are one level: levels differ by some percent, and a fraction may have been computed
/// in more than one way.
const SAME_SPEED: f64 = 1e-9;

/// True if the friction points of a row of `cycle` count: those of a complete cycle, and of one that only lacked motion
/// for identifying parameters. Points of a cycle that a finding refuses or doubts do not count.
macro_rules! friction_counts {
    () => {
        "(cycle.status = 'complete' AND NOT cycle.doubtful
          OR cycle.status = 'refused' AND NOT EXISTS (
              SELECT 1 FROM cycle_refusal WHERE cycle_refusal.cycle_id = cycle.cycle_id))"
    };
}

impl Store {
    /// Friction points of a run, in the order of the cycles.
    pub async fn friction_points(&self, run_id: i64) -> Result<Vec<CyclePoint>, StoreError> {
        self.checked(friction_points(&self.readers, run_id).await)
    }

    /// Reads the measurements of a run's stored cycles, without the writer.
    pub async fn run_measurements(&self, run_id: i64) -> Result<RunMeasurements, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(run_measurements(&mut connection, run_id).await)
    }

    /// Mean motor temperature of each joint over cycles, each given by run and number, degC; `None` for a joint without
    /// one, and empty if no joint has one.
    pub async fn motor_temperatures(&self, cycles: &[(i64, u32)]) -> Result<Vec<Option<f64>>, StoreError> {
        let mut sums: BTreeMap<usize, (f64, usize)> = BTreeMap::new();
        for cycle in cycles {
            let found = self.checked(motor_temperatures(&self.readers, *cycle).await)?;
            for (joint, celsius) in found {
                let sum = sums.entry(joint).or_default();
                *sum = (sum.0 + celsius, sum.1 + 1);
            }
        }
        let joints = sums.keys().copied().max().unwrap_or(0);
        let mean = |joint| sums.get(&joint).map(|(sum, count)| sum / *count as f64);
        Ok((1..=joints).map(mean).collect())
    }

    /// Speed levels with warm friction of a joint in the robot's latest complete test, as fractions of the largest. A
    /// test without warm friction is skipped.
    pub async fn latest_warm_levels(&self, robot_id: i64) -> Result<Vec<f64>, StoreError> {
        self.checked(latest_warm_levels(&self.readers, robot_id).await)
    }

    /// Key and name of every robot with a complete test, by name.
    pub async fn tested_robots(&self) -> Result<Vec<(i64, String)>, StoreError> {
        self.checked(tested_robots(&self.readers).await)
    }
}

async fn motor_temperatures(
    executor: impl EngineExecutor<'_>,
    (run_id, cycle): (i64, u32),
) -> sqlx::Result<Vec<(usize, f64)>> {
    sqlx::query(
        "SELECT joint, temperature_degc FROM cycle JOIN cycle_temperature USING (cycle_id)
         WHERE run_id = $1 AND cycle.number = $2 AND joint > 0 ORDER BY joint",
    )
    .bind_all((run_id, i64::from(cycle)))
    .try_map(|row: EngineRow| Ok((size(&row, "joint")?, row.try_get("temperature_degc")?)))
    .fetch_all(executor)
    .await
}

async fn latest_warm_levels(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<Vec<f64>> {
    sqlx::query_scalar(
        "SELECT warm_speed_fraction FROM run_joint_summary
         WHERE warm_friction_nm IS NOT NULL AND warm_minute IS NOT NULL AND warm_speed_fraction IS NOT NULL
               AND run_id = (SELECT run.run_id FROM run CROSS JOIN run_joint_summary AS summary
                             WHERE summary.run_id = run.run_id AND robot_id = $1 AND kind = 'test'
                                   AND status = 'complete'
                                   AND warm_friction_nm IS NOT NULL AND warm_minute IS NOT NULL
                                   AND warm_speed_fraction IS NOT NULL
                             ORDER BY started_at DESC, run.run_id DESC LIMIT 1)
         ORDER BY joint",
    )
    .bind(robot_id)
    .fetch_all(executor)
    .await
}

async fn tested_robots(executor: impl EngineExecutor<'_>) -> sqlx::Result<Vec<(i64, String)>> {
    sqlx::query_as(
        "SELECT robot_id, name FROM robot
         WHERE EXISTS (SELECT 1 FROM run
                       WHERE run.robot_id = robot.robot_id AND kind = 'test' AND status = 'complete')
         ORDER BY name",
    )
    .fetch_all(executor)
    .await
}

pub(crate) async fn run_measurements(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<RunMeasurements> {
    Ok(RunMeasurements {
        friction_points: friction_points(&mut *connection, run_id).await?,
        parameters: parameters_by_cycle(&mut *connection, run_id).await?,
        relative_rmsd: excitation_rmsd(&mut *connection, run_id).await?,
        whole_cycle_rmsd: cycle_rmsd::of_run(&mut *connection, run_id).await?,
        torque_noise: torque_noise::of_run(connection, run_id).await?,
    })
}

/// Measurements that depend on the parameters of a run's cycles; without friction points.
pub(crate) async fn of_parameters(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<RunMeasurements> {
    Ok(RunMeasurements {
        friction_points: Vec::new(),
        parameters: parameters_by_cycle(&mut *connection, run_id).await?,
        relative_rmsd: excitation_rmsd(connection, run_id).await?,
        whole_cycle_rmsd: Vec::new(),
        torque_noise: Vec::new(),
    })
}

/// Every friction point of a run that counts.
pub(crate) async fn friction_points(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<CyclePoint>> {
    sqlx::query(
        concat!(
            "SELECT cycle.number AS cycle, joint, time_s, speed_fraction, speed_rad_s, direction, torque_nm, std_nm,
                    friction_point.samples, gravity,
                    load_nm, load_friction
             FROM cycle
             JOIN friction_point USING (cycle_id)
             WHERE cycle.run_id = $1 AND ",
            friction_counts!(),
            " ORDER BY cycle.number, friction_point.number"
        )
    )
    .bind(run_id)
    .try_map(|row| Ok(CyclePoint { cycle: size(&row, "cycle")?, point: friction_point(&row)? }))
    .fetch_all(executor)
    .await
}

/// Parameters of every identified cycle of a run that counts and has the estimator of its last one: statistics over
/// cycles never mix two estimators.
async fn parameters_by_cycle(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<Vec<CycleParameters>> {
    let rows = sqlx::query(
        "SELECT cycle.number AS cycle, joint, name, value, std_error, degrees_of_freedom
         FROM cycle
         JOIN cycle_parameter USING (cycle_id)
         JOIN model_parameter USING (model_parameter_id)
         WHERE cycle.run_id = $1 AND cycle.status = 'complete' AND NOT cycle.doubtful
               AND cycle.estimator = (SELECT last.estimator FROM cycle AS last
                                      WHERE last.run_id = $1 AND last.samples IS NOT NULL
                                      ORDER BY last.number DESC LIMIT 1)
         ORDER BY cycle.number",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| Ok((size::<u32>(&row, "cycle")?, identified(&row)?)))
    .fetch_all(&mut *connection)
    .await?;
    let mut by_cycle: BTreeMap<u32, Vec<IdentifiedParameter>> = BTreeMap::new();
    for (cycle, identified) in rows {
        by_cycle.entry(cycle).or_default().push(identified);
    }
    let mut motions = motions(connection, run_id).await?;
    Ok(by_cycle
        .into_iter()
        .map(|(cycle, mut parameters)| {
            // Natural order: inertia by link, friction by joint, motor inertia by joint, all others.
            parameters.sort_by_key(natural_place);
            let (minute, mean_speeds) = motions.remove(&cycle).unwrap_or_default();
            CycleParameters { cycle, minute, mean_speeds, parameters }
        })
        .collect())
}

/// Middle of each cycle of a run, min, and mean speeds of its joints.
async fn motions(
    connection: &mut EngineConnection,
    run_id: i64,
) -> sqlx::Result<HashMap<u32, (f64, Vec<f64>)>> {
    let rows = sqlx::query(
        "SELECT number AS cycle,
                CAST(cycle.started_at - run.started_at AS DOUBLE PRECISION) / 6e7 + duration_s / 120 AS minute,
                mean_speeds_rad_s
         FROM cycle
         JOIN run USING (run_id)
         WHERE run_id = $1",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let speeds: Option<&str> = row.try_get("mean_speeds_rad_s")?;
        let speeds = speeds.map_or(Ok(Vec::new()), serde_json::from_str);
        let speeds = speeds.map_err(|error| sqlx::Error::Decode(error.into()))?;
        Ok((size::<u32>(&row, "cycle")?, (row.try_get("minute")?, speeds)))
    })
    .fetch_all(connection)
    .await?;
    Ok(rows.into_iter().collect())
}

/// Moving relative RMSD of the excitation stage under self-verification, for the cycles of [`parameters_by_cycle`].
async fn excitation_rmsd(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<Vec<CycleRmsd>> {
    sqlx::query(
        "SELECT cycle.number AS cycle, joint, moving_relative_rmsd
         FROM cycle
         JOIN torque_rmsd USING (cycle_id)
         WHERE cycle.run_id = $1 AND cycle.status = 'complete' AND NOT cycle.doubtful
               AND stage = 'excitation' AND verification = 'self'
               AND moving_relative_rmsd IS NOT NULL
               AND cycle.estimator = (SELECT last.estimator FROM cycle AS last
                                      WHERE last.run_id = $1 AND last.samples IS NOT NULL
                                      ORDER BY last.number DESC LIMIT 1)
         ORDER BY cycle.number, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| cycle_rmsd::of_row(&row))
    .fetch_all(executor)
    .await
}

/// Friction points of run `run_id` at one nominal speed, in the order of the cycles.
pub(crate) async fn friction_points_at(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    speed_fraction: f64,
) -> sqlx::Result<Vec<FrictionPoint>> {
    sqlx::query(
        concat!(
            "SELECT joint, time_s, speed_fraction, speed_rad_s, direction, torque_nm, std_nm, friction_point.samples,
                    gravity, load_nm, load_friction
             FROM cycle
             CROSS JOIN friction_point
             WHERE friction_point.cycle_id = cycle.cycle_id AND cycle.run_id = $1
                   AND speed_fraction BETWEEN $2 AND $3 AND ",
            friction_counts!(),
            " ORDER BY cycle.number, friction_point.number"
        )
    )
    .bind_all((run_id, speed_fraction - SAME_SPEED, speed_fraction + SAME_SPEED))
    .try_map(|row| friction_point(&row))
    .fetch_all(executor)
    .await
}

fn friction_point(row: &EngineRow) -> sqlx::Result<FrictionPoint> {
    let std: Option<f64> = row.try_get("std_nm")?;
    let (carried, friction): (Option<f64>, Option<f64>) =
        (row.try_get("load_nm")?, row.try_get("load_friction")?);
    Ok(FrictionPoint {
        joint: joint(row, "joint")?,
        time: row.try_get("time_s")?,
        speed_fraction: row.try_get("speed_fraction")?,
        speed: row.try_get("speed_rad_s")?,
        direction: row.try_get("direction")?,
        torque: row.try_get("torque_nm")?,
        std: std.unwrap_or(f64::NAN),
        samples: size(row, "samples")?,
        gravity: named(row, "gravity", &GRAVITY_REMOVALS, GravityRemoval::name)?,
        load: carried.zip(friction).map(|(torque, friction)| CarriedLoad { torque, friction }),
    })
}

/// Sort key for the order of [`armwatch_model::robot::ParameterId::natural_order`].
fn natural_place(parameter: &IdentifiedParameter) -> (u8, JointIndex, ParameterKind) {
    let ParameterId { joint, kind } = parameter.id;
    let group = match kind {
        ParameterKind::Inertial(_) => 0,
        ParameterKind::Friction(_) => 1,
        ParameterKind::MotorInertia => 2,
        ParameterKind::Coupling(_) => 3,
        ParameterKind::Spring(_) => 4,
        ParameterKind::Crank(_) => 5,
    };
    (group, joint, kind)
}
