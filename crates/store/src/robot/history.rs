//! What detection and fits read back: one run's measurements, one robot's history.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;

use sqlx::Row;

use super::figures::joint_summary::SummaryRow;
use super::figures::run_series::{self, RunSeries};
use super::figures::{cycle_friction, cycle_rmsd, run_brief};
use super::maintenance;
use crate::engine::{EngineConnection, EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::{channel_response, torque_noise};
use crate::values::{identified, joint, json_list, named, size, time};
use armwatch_model::analysis::measurements::{CycleParameters, CyclePoint, CycleRmsd, RunMeasurements};
use armwatch_model::analysis::refusal::{Channel, RefusalCause};
use armwatch_model::analysis::{FrictionPoint, GravityRemoval, IdentifiedParameter};
use armwatch_model::anomaly::{RunRefusal, RunSummary};
use armwatch_model::robot::{JointIndex, ParameterId, ParameterKind};

const GRAVITY_REMOVALS: [GravityRemoval; 3] =
    [GravityRemoval::AxisVertical, GravityRemoval::Fitted, GravityRemoval::Model];

/// Nominal speeds closer than this are one level; levels lie some percent apart, and a fraction
/// may have been computed in more than one way.
const SAME_SPEED: f64 = 1e-9;

/// Whether friction points of a row of `cycle` count: those of a complete cycle, and of one that only had nothing to
/// identify parameters on. What a finding has refused or doubted does not.
macro_rules! friction_counts {
    () => {
        "(cycle.status = 'complete' AND NOT cycle.doubtful
          OR cycle.status = 'refused' AND NOT EXISTS (
              SELECT 1 FROM cycle_refusal WHERE cycle_refusal.cycle_id = cycle.cycle_id))"
    };
}

impl Store {
    /// Friction points of a run, in the order of the cycles.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn friction_points(&self, run_id: i64) -> Result<Vec<CyclePoint>, StoreError> {
        self.checked(friction_points(&self.readers, run_id).await)
    }

    /// Reads what the stored cycles of a run measured, without holding the writer.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_measurements(&self, run_id: i64) -> Result<RunMeasurements, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(run_measurements(&mut connection, run_id).await)
    }

    /// Reads the summaries of a robot's complete runs, ordered by start, then key.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn run_summaries(&self, robot_id: i64) -> Result<Vec<RunSummary>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(run_summaries(&mut connection, robot_id).await)
    }

    /// Reads the cycles of the tests at these places that are left out.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn read_cycles(&self, runs: &mut [RunSummary], places: &[usize]) -> Result<(), StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(read_cycles(&mut connection, runs, places).await)
    }

    /// Speed levels, as fractions of the largest, at which joints of the robot's latest complete test have warm friction;
    /// of tests without, of the one before.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn latest_warm_levels(&self, robot_id: i64) -> Result<Vec<f64>, StoreError> {
        self.checked(latest_warm_levels(&self.readers, robot_id).await)
    }

    /// Key and name of every robot with a complete test, by name.
    ///
    /// # Errors
    /// [`StoreError`] of the database.
    pub async fn tested_robots(&self) -> Result<Vec<(i64, String)>, StoreError> {
        self.checked(tested_robots(&self.readers).await)
    }
}

async fn latest_warm_levels(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
) -> Result<Vec<f64>, sqlx::Error> {
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

async fn tested_robots(executor: impl EngineExecutor<'_>) -> Result<Vec<(i64, String)>, sqlx::Error> {
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
) -> Result<RunMeasurements, sqlx::Error> {
    Ok(RunMeasurements {
        friction_points: friction_points(&mut *connection, run_id).await?,
        parameters: parameters_by_cycle(&mut *connection, run_id).await?,
        relative_rmsd: excitation_rmsd(&mut *connection, run_id).await?,
        whole_cycle_rmsd: cycle_rmsd::of_run(&mut *connection, run_id).await?,
        torque_noise: torque_noise::of_run(connection, run_id).await?,
    })
}

/// What follows from the parameters of a run's cycles; friction points are left out.
pub(crate) async fn of_parameters(
    connection: &mut EngineConnection,
    run_id: i64,
) -> Result<RunMeasurements, sqlx::Error> {
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
) -> Result<Vec<CyclePoint>, sqlx::Error> {
    sqlx::query(
        concat!(
            "SELECT cycle.number AS cycle, joint, time_s, speed_fraction, speed_rad_s, direction, torque_nm, std_nm,
                    friction_point.samples, gravity
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

/// Parameters of every identified cycle of a run that counts and has the estimator of its last one: figures over cycles
/// never mix two estimators.
async fn parameters_by_cycle(
    connection: &mut EngineConnection,
    run_id: i64,
) -> Result<Vec<CycleParameters>, sqlx::Error> {
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
            // Natural order: inertia by link, friction by joint, motor inertia by joint, couplings.
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
) -> Result<HashMap<u32, (f64, Vec<f64>)>, sqlx::Error> {
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

/// Moving relative RMSD of the excitation stage under self-verification, of the cycles as [`parameters_by_cycle`].
async fn excitation_rmsd(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> Result<Vec<CycleRmsd>, sqlx::Error> {
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

/// Summaries of a robot's complete tests, oldest first. Torque deviations are those of the estimator that made the
/// latest: a test that was identified with another one has none to compare.
pub(crate) async fn run_summaries(
    connection: &mut EngineConnection,
    robot_id: i64,
) -> Result<Vec<RunSummary>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT run.run_id, run.started_at, run.cycles_stored, run_series.numbers,
                EXISTS (SELECT 1 FROM channel_response WHERE channel_response.run_id = run.run_id) AS has_response
         FROM run
         LEFT JOIN run_series USING (run_id)
         WHERE run.robot_id = $1 AND run.kind = 'test' AND run.status = 'complete'
         ORDER BY run.started_at, run.run_id",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| {
        let numbers: Option<&[u8]> = row.try_get("numbers")?;
        Ok((test(&row)?, numbers.and_then(run_series::unpacked)))
    })
    .fetch_all(&mut *connection)
    .await?;
    let inertial = cycle_friction::inertial(&mut *connection).await?;
    let mut tests = Vec::with_capacity(rows.len());
    for (mut test, series) in rows {
        let series = match series {
            Some(series) => series,
            None => run_series::of_run(&mut *connection, test.run.run_id).await?,
        };
        test.joints = fill(&mut test.run, series, &inertial);
        tests.push(test);
    }
    together(connection, robot_id, tests, &[]).await
}

/// As [`run_summaries`], of the tests of these keys, with the cycles left out of those of which something is known in brief.
/// Epochs are told apart by these and the tests with which others began.
pub(super) async fn briefs(
    connection: &mut EngineConnection,
    robot_id: i64,
    keys: &[i64],
    first_of_epochs: &[i64],
) -> Result<Vec<RunSummary>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT run.run_id, run.started_at, run.cycles_stored, run_brief.joints, run_brief.brief, run_brief.judgements,
                EXISTS (SELECT 1 FROM channel_response WHERE channel_response.run_id = run.run_id) AS has_response
         FROM run
         LEFT JOIN run_brief USING (run_id)
         WHERE run.run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($2)) AND run.robot_id = $1 AND run.kind = 'test'
               AND run.status = 'complete'
         ORDER BY run.started_at, run.run_id",
    )
    .bind(robot_id)
    .bind(json_list(keys))
    .try_map(|row: EngineRow| {
        let (joints, brief): (Option<&[u8]>, Option<&[u8]>) =
            (row.try_get("joints")?, row.try_get("brief")?);
        let judgements: Option<&[u8]> = row.try_get("judgements")?;
        let known = match (joints, brief, judgements) {
            (Some(joints), Some(brief), Some(judgements)) => run_brief::unpacked(joints, brief, judgements),
            _ => None,
        };
        let mut test = test(&row)?;
        let is_known = known.is_some();
        if let Some((joints, brief)) = known {
            (test.joints, test.run.brief, test.run.is_brief) = (joints, Some(Arc::new(brief)), true);
        }
        Ok((test, is_known))
    })
    .fetch_all(&mut *connection)
    .await?;
    let mut tests = Vec::with_capacity(rows.len());
    let mut inertial = None;
    for (mut test, is_known) in rows {
        if !is_known {
            if inertial.is_none() {
                inertial = Some(cycle_friction::inertial(&mut *connection).await?);
            }
            let series = run_series::read(&mut *connection, test.run.run_id).await?;
            if let Some(inertial) = &inertial {
                test.joints = fill(&mut test.run, series, inertial);
            }
        }
        tests.push(test);
    }
    together(connection, robot_id, tests, first_of_epochs).await
}

/// Reads the cycles of the tests at these places that are left out.
pub(crate) async fn read_cycles(
    connection: &mut EngineConnection,
    runs: &mut [RunSummary],
    places: &[usize],
) -> Result<(), sqlx::Error> {
    let inertial = cycle_friction::inertial(&mut *connection).await?;
    for &place in places {
        if let Some(run) = runs.get_mut(place).filter(|run| run.is_brief) {
            let series = run_series::read(&mut *connection, run.run_id).await?;
            // figures by joint are there
            fill(run, series, &inertial);
            run.is_brief = false;
        }
    }
    Ok(())
}

/// A test, before it is known which estimator the latest has.
struct Test {
    run: RunSummary,
    joints: Vec<SummaryRow>,
    has_response: bool,
}

fn test(row: &EngineRow) -> Result<Test, sqlx::Error> {
    let run = RunSummary {
        run_id: row.try_get("run_id")?,
        started_at: time(row, "started_at")?,
        cycles: size(row, "cycles_stored")?,
        ..RunSummary::default()
    };
    Ok(Test { run, joints: Vec::new(), has_response: row.try_get("has_response")? })
}

/// Gives a test its cycles; figures by joint.
fn fill(run: &mut RunSummary, series: RunSeries, inertial: &cycle_friction::Inertial) -> Vec<SummaryRow> {
    let RunSeries { joints, friction, rmsd, parameters } = series;
    run.cycle_friction = friction;
    run.whole_cycle_rmsd = rmsd;
    run.parameters = inertial.of_run(&parameters);
    joints
}

/// Tests with what follows from all of them together; `first_of_epochs` are others with which epochs began.
async fn together(
    connection: &mut EngineConnection,
    robot_id: i64,
    tests: Vec<Test>,
    first_of_epochs: &[i64],
) -> Result<Vec<RunSummary>, sqlx::Error> {
    let keys: Vec<i64> = tests.iter().map(|test| test.run.run_id).collect();
    let mut refused = refusals(&mut *connection, &keys).await?;
    let known = |row: &&SummaryRow| row.summary.relative_rmsd.is_some();
    let mut latest_first = tests.iter().rev().flat_map(|test| test.joints.iter().rev());
    let latest = latest_first.find(known).and_then(|row| row.estimator.clone());
    let (mut runs, mut with_response) = (Vec::with_capacity(tests.len()), HashSet::new());
    for Test { mut run, joints, has_response } in tests {
        run.joints = joints.into_iter().map(|row| row.among(latest.as_deref())).collect();
        (run.refused_cycles, run.refusals) = refused.remove(&run.run_id).unwrap_or_default();
        if has_response {
            with_response.insert(run.run_id);
        }
        runs.push(run);
    }
    let joints = runs.iter().flat_map(|run| &run.joints).map(|of| of.joint.number()).max().unwrap_or(0);
    let among = [&keys, first_of_epochs].concat();
    let mut epochs = maintenance::epoch_ordinals(&mut *connection, robot_id, joints, &among).await?;
    for run in &mut runs {
        run.epochs = epochs.remove(&run.run_id).unwrap_or_default();
    }
    read_responses(connection, &with_response, &mut runs).await?;
    Ok(runs)
}

/// Reads the response of the first run with one, of the runs that are compared with each other. Those of the others
/// are the same but for the motion's own scatter; that of the first stays while tests come.
async fn read_responses(
    connection: &mut EngineConnection,
    with_response: &HashSet<i64>,
    runs: &mut [RunSummary],
) -> Result<(), sqlx::Error> {
    let mut known: Vec<Vec<u32>> = Vec::new();
    for run in runs.iter_mut().filter(|run| with_response.contains(&run.run_id)) {
        if !known.contains(&run.epochs) {
            run.response = channel_response::of_run(&mut *connection, run.run_id).await?;
            known.push(run.epochs.clone());
        }
    }
    Ok(())
}

/// Refused cycles of the tests of these keys, and why they were refused, the cause of most cycles first, by run.
async fn refusals(
    connection: &mut EngineConnection,
    keys: &[i64],
) -> Result<HashMap<i64, (u32, Vec<RunRefusal>)>, sqlx::Error> {
    let keys = json_list(keys);
    let counts: Vec<(i64, u32)> = sqlx::query_as(
        "SELECT run_id, count(*)
         FROM cycle
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)) AND status = 'refused'
         GROUP BY run_id",
    )
    .bind(&keys)
    .fetch_all(&mut *connection)
    .await?;
    let mut by_run: HashMap<i64, (u32, Vec<RunRefusal>)> =
        counts.into_iter().map(|(run_id, cycles)| (run_id, (cycles, Vec::new()))).collect();
    // the sentence of a cause is that of the cycle which names it first, and of these the first cycle's
    let causes = sqlx::query(
        "SELECT run_id, finding, channel, joint, max(CASE WHEN nth = 1 THEN sentence END) AS sentence,
                min(cycle) AS first_cycle, count(*) AS cycles
         FROM (
             SELECT cycle.run_id, coalesce(why.finding, 'nothing_to_identify') AS finding,
                    coalesce(why.channel, 'motion') AS channel, why.joint,
                    coalesce(why.sentence, cycle.reason) AS sentence, cycle.number AS cycle,
                    coalesce(why.number, 0) AS place,
                    row_number() OVER (PARTITION BY cycle.run_id, why.finding, why.channel, why.joint
                                       ORDER BY coalesce(why.number, 0), cycle.number) AS nth
             FROM cycle
             LEFT JOIN cycle_refusal AS why USING (cycle_id)
             WHERE cycle.run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)) AND cycle.status = 'refused'
         ) AS found
         GROUP BY run_id, finding, channel, joint
         ORDER BY run_id, cycles DESC, min(place), joint NULLS FIRST",
    )
    .bind(&keys)
    .try_map(|row: EngineRow| Ok((row.try_get::<i64, _>("run_id")?, refusal(&row)?)))
    .fetch_all(connection)
    .await?;
    for (run_id, cause) in causes {
        by_run.entry(run_id).or_default().1.push(cause);
    }
    Ok(by_run)
}

fn refusal(row: &EngineRow) -> Result<RunRefusal, sqlx::Error> {
    let of_joint = row.try_get::<Option<i64>, _>("joint")?.is_some();
    Ok(RunRefusal {
        cause: RefusalCause {
            finding: row.try_get("finding")?,
            channel: named(row, "channel", &Channel::ALL, Channel::name)?,
            joint: if of_joint { Some(joint(row, "joint")?) } else { None },
            sentence: row.try_get("sentence")?,
        },
        first_cycle: size(row, "first_cycle")?,
        cycles: size(row, "cycles")?,
    })
}

/// Friction points of run `run_id` at one nominal speed, in the order of the cycles.
pub(crate) async fn friction_points_at(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    speed_fraction: f64,
) -> Result<Vec<FrictionPoint>, sqlx::Error> {
    sqlx::query(
        concat!(
            "SELECT joint, time_s, speed_fraction, speed_rad_s, direction, torque_nm, std_nm, friction_point.samples,
                    gravity
             FROM cycle
             CROSS JOIN friction_point
             WHERE friction_point.cycle_id = cycle.cycle_id AND cycle.run_id = $1
                   AND speed_fraction BETWEEN $2 AND $3 AND ",
            friction_counts!(),
            " ORDER BY cycle.number, friction_point.number"
        )
    )
    .bind(run_id)
    .bind(speed_fraction - SAME_SPEED)
    .bind(speed_fraction + SAME_SPEED)
    .try_map(|row| friction_point(&row))
    .fetch_all(executor)
    .await
}

fn friction_point(row: &EngineRow) -> Result<FrictionPoint, sqlx::Error> {
    let std: Option<f64> = row.try_get("std_nm")?;
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
    })
}

/// Sort key that gives the order of [`armwatch_model::robot::ParameterId::natural_order`].
fn natural_place(parameter: &IdentifiedParameter) -> (u8, JointIndex, ParameterKind) {
    let ParameterId { joint, kind } = parameter.id;
    let group = match kind {
        ParameterKind::Inertial(_) => 0,
        ParameterKind::Friction(_) => 1,
        ParameterKind::MotorInertia => 2,
        ParameterKind::Coupling(_) => 3,
    };
    (group, joint, kind)
}
