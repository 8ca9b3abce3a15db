//! Friction baselines and indices: the stored data of each test, the baselines in force, and their replacement by a
//! conclusion.

use std::collections::{HashMap, HashSet};

use jiff::Timestamp;
use sqlx::{QueryBuilder, Row};

use super::friction;
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::temperatures;
use crate::robot::conclude::ConclusionTransaction;
use crate::robot::history;
use crate::robot::maintenance::DescriptionKey;
use crate::values::{ROWS_PER_STATEMENT, count, finite, joint, joint_number, json_list, size, time_text};
use armwatch_model::analysis::friction::{FrictionIndex, FrictionMap, MapLevel};
use armwatch_model::analysis::map_run::MapRun;
use armwatch_model::anomaly::epoch::{EpochCause, Maintenance, TestMoment};
use armwatch_model::robot::JointIndex;

/// A number above that of a joint's epochs.
const MOST_EPOCHS: i64 = 1_000_000;

/// Hash of the inputs of computed values.
pub type IndexBasis = [u8; 32];

/// Data of one complete test for its friction index.
#[derive(Debug, Clone, PartialEq)]
pub struct FrictionTest {
    /// Database key.
    pub run_id: i64,
    /// Start, and the description that its results were computed with.
    pub moment: TestMoment<DescriptionKey>,
    /// Usable friction points of the best level of each joint; `None` if they were not counted yet.
    pub points: Option<Vec<(JointIndex, usize)>>,
    /// Basis of its stored indices.
    pub basis: Option<IndexBasis>,
}

/// A robot's tests, oldest first, and the changes between them.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionTests {
    /// The tests.
    pub tests: Vec<FrictionTest>,
    /// Maintenance of the robot.
    pub work: Vec<Maintenance>,
    /// The baselines in force.
    pub baselines: Vec<StoredBaseline>,
    /// The basis of each joint's stored map.
    pub maps: HashMap<JointIndex, IndexBasis>,
}

/// A stored baseline in force.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredBaseline {
    /// Database key.
    pub friction_baseline_id: i64,
    /// The joint.
    pub joint: JointIndex,
    /// Ordinal of the epoch.
    pub epoch: u32,
    /// Basis of its map.
    pub basis: IndexBasis,
    /// Its runs, ascending.
    pub run_ids: Vec<i64>,
}

/// A baseline that follows from the present history.
#[derive(Debug, Clone, PartialEq)]
pub struct NewBaseline {
    /// The joint.
    pub joint: JointIndex,
    /// Ordinal of the epoch.
    pub epoch: u32,
    /// Reason why the epoch began.
    pub cause: EpochCause,
    /// Beginning of the epoch, microseconds since 1970.
    pub begins_at: i64,
    /// Basis of its map.
    pub basis: IndexBasis,
    /// Its runs.
    pub run_ids: Vec<i64>,
    /// Its map by level, and the reason if there is none; `None` if the map is stored already.
    pub formed: Option<(Vec<MapLevel>, Option<String>)>,
}

/// New indices of a test.
#[derive(Debug, Clone, PartialEq)]
pub struct NewIndices {
    /// Database key of the test.
    pub run_id: i64,
    /// Usable friction points of the best level of each joint.
    pub points: Vec<(JointIndex, usize)>,
    /// Basis of the indices; `None` without any baseline.
    pub basis: Option<IndexBasis>,
    /// The indices.
    pub indices: Vec<FrictionIndex>,
}

/// A baseline that another one has replaced.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReplacedBaseline {
    /// The joint.
    pub joint: JointIndex,
    /// Ordinal of the epoch.
    pub epoch: u32,
    /// Reason.
    pub because: String,
}

/// Friction of a robot that follows from its present history.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FrictionConclusion {
    /// Its tests, oldest first.
    pub run_ids: Vec<i64>,
    /// All baselines in force.
    pub baselines: Vec<NewBaseline>,
    /// Tests whose indices are new.
    pub indices: Vec<NewIndices>,
    /// The map of the latest epoch of each joint that has one, with its basis; without the map if that is stored.
    pub maps: Vec<(JointIndex, IndexBasis, Option<FrictionMap>)>,
    /// Reasons why joints have no map, as sentences.
    pub remarks: Vec<String>,
    /// True if it uses all tests. Otherwise it uses the latest ones, and changes no baseline and no map.
    pub is_whole: bool,
}

impl Store {
    /// Motion of a run and, on request, its friction.
    pub async fn friction_run(&self, test: &FrictionTest, with_points: bool) -> Result<MapRun, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(friction_run(&mut connection, test, with_points).await)
    }
}

/// A baseline in force, for display.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BaselineRow {
    /// The joint.
    pub joint: JointIndex,
    /// Ordinal of the epoch.
    pub epoch: u32,
    /// Reason why the epoch began, as in the view `baselines`.
    pub cause: String,
    /// Starts of its tests, ascending.
    pub tests: Vec<Timestamp>,
}

/// A baseline that was formed, and the reason if it is no longer in force.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BaselineChange {
    /// The joint.
    pub joint: JointIndex,
    /// Ordinal of the epoch.
    pub epoch: u32,
    /// Reason for its replacement; `None` while it is in force.
    pub replaced_because: Option<String>,
}

impl Store {
    /// The baselines in force of a robot, by joint and epoch.
    pub async fn baselines(&self, robot: &str) -> Result<Vec<BaselineRow>, StoreError> {
        let rows = sqlx::query(
            "SELECT joint, epoch, cause, started_at FROM baselines
             WHERE robot = $1 AND started_at IS NOT NULL
             ORDER BY joint, epoch, started_at",
        )
        .bind(robot)
        .try_map(|row: EngineRow| {
            Ok(BaselineRow {
                joint: joint(&row, "joint")?,
                epoch: size(&row, "epoch")?,
                cause: row.try_get("cause")?,
                tests: vec![time_text(&row, "started_at")?],
            })
        })
        .fetch_all(&self.readers)
        .await;
        let mut found: Vec<BaselineRow> = Vec::new();
        for row in self.checked(rows)? {
            match found.last_mut() {
                Some(last) if (last.joint, last.epoch) == (row.joint, row.epoch) => {
                    last.tests.extend(row.tests)
                }
                _ => found.push(row),
            }
        }
        Ok(found)
    }

    /// All baselines of a robot that were ever formed, in that order.
    pub async fn baseline_changes(&self, robot: &str) -> Result<Vec<BaselineChange>, StoreError> {
        let rows = sqlx::query(
            "SELECT joint, epoch, replaced_because FROM baseline_changes
             WHERE robot = $1 ORDER BY friction_baseline_id",
        )
        .bind(robot)
        .try_map(|row: EngineRow| {
            Ok(BaselineChange {
                joint: joint(&row, "joint")?,
                epoch: size(&row, "epoch")?,
                replaced_because: row.try_get("replaced_because")?,
            })
        })
        .fetch_all(&self.readers)
        .await;
        self.checked(rows)
    }
}

impl ConclusionTransaction {
    /// Stores the present friction of the robot. Returns the baselines that were replaced.
    pub async fn replace_friction(
        &mut self,
        found: &FrictionConclusion,
    ) -> Result<Vec<ReplacedBaseline>, StoreError> {
        let result = replace(&mut self.transaction, self.robot_id, found).await;
        self.checked(result)
    }
}

/// Reads the column `basis`; `None` also for one of another length, which is invalid.
pub(in crate::robot) fn basis(row: &EngineRow) -> sqlx::Result<Option<IndexBasis>> {
    let stored: Option<&[u8]> = row.try_get("basis")?;
    Ok(stored.and_then(|bytes| bytes.try_into().ok()))
}

pub(in crate::robot) async fn in_force(
    connection: &mut EngineConnection,
    robot_id: i64,
) -> sqlx::Result<Vec<StoredBaseline>> {
    let mut found = sqlx::query(
        "SELECT friction_baseline_id, joint, epoch, basis FROM friction_baseline
         WHERE robot_id = $1 AND replaced_at IS NULL
         ORDER BY joint, epoch",
    )
    .bind(robot_id)
    .try_map(|row: EngineRow| {
        Ok(StoredBaseline {
            friction_baseline_id: row.try_get("friction_baseline_id")?,
            joint: joint(&row, "joint")?,
            epoch: size(&row, "epoch")?,
            basis: basis(&row)?.unwrap_or_default(),
            run_ids: Vec::new(),
        })
    })
    .fetch_all(&mut *connection)
    .await?;
    for baseline in &mut found {
        baseline.run_ids = sqlx::query_scalar(
            "SELECT run_id FROM friction_baseline_run WHERE friction_baseline_id = $1 ORDER BY run_id",
        )
        .bind(baseline.friction_baseline_id)
        .fetch_all(&mut *connection)
        .await?;
    }
    Ok(found)
}

async fn friction_run(
    connection: &mut EngineConnection,
    test: &FrictionTest,
    with_points: bool,
) -> sqlx::Result<MapRun> {
    let started_at = test.moment.started_at.as_microsecond();
    let temperatures = temperatures::of_run(&mut *connection, test.run_id).await?;
    let spans = friction::motion(&mut *connection, test.run_id, started_at, temperatures).await?;
    let points = match with_points {
        true => history::friction_points(connection, test.run_id).await?,
        false => Vec::new(),
    };
    let points = points.into_iter().map(|row| row.point).collect();
    Ok(MapRun { started_at: started_at as f64 / friction::MICROSECONDS, spans, points })
}

async fn replace(
    connection: &mut EngineConnection,
    robot_id: i64,
    found: &FrictionConclusion,
) -> sqlx::Result<Vec<ReplacedBaseline>> {
    let mut replaced = Vec::new();
    if found.is_whole {
        replaced = replace_baselines(&mut *connection, robot_id, found).await?;
        let joints: HashSet<JointIndex> = found.maps.iter().map(|(joint, ..)| *joint).collect();
        friction::keep_maps(&mut *connection, robot_id, &joints).await?;
    }
    for (_, basis, map) in &found.maps {
        if let Some(map) = map {
            friction::replace_map(&mut *connection, robot_id, map, basis).await?;
        }
    }
    // a test may have left the history since it was read
    let complete: HashSet<i64> = sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($2)) AND robot_id = $1 AND kind = 'test'
               AND status = 'complete'",
    )
    .bind_all((robot_id, json_list(&found.indices.iter().map(|of| of.run_id).collect::<Vec<i64>>())))
    .fetch_all(&mut *connection)
    .await?
    .into_iter()
    .collect();
    for of_run in found.indices.iter().filter(|of| complete.contains(&of.run_id)) {
        replace_basis(&mut *connection, of_run.run_id, of_run.basis).await?;
        replace_points(&mut *connection, of_run).await?;
        friction::replace_indices(&mut *connection, of_run.run_id, &of_run.indices).await?;
    }
    Ok(replaced)
}

/// Stores the basis of a test's indices. A new row counts as a revision of the test.
async fn replace_basis(
    connection: &mut EngineConnection,
    run_id: i64,
    basis: Option<IndexBasis>,
) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM run_friction WHERE run_id = $1").bind(run_id).execute(&mut *connection).await?;
    sqlx::query("INSERT INTO run_friction (run_id, basis) VALUES ($1, $2)")
        .bind_all((run_id, basis.as_ref().map(|basis| &basis[..])))
        .run(connection)
        .await
}

async fn replace_points(connection: &mut EngineConnection, of: &NewIndices) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM run_friction_points WHERE run_id = $1")
        .bind(of.run_id)
        .execute(&mut *connection)
        .await?;
    for rows in of.points.chunks(ROWS_PER_STATEMENT) {
        QueryBuilder::<Engine>::new("INSERT INTO run_friction_points (run_id, joint, points) ")
            .push_values(rows, |mut row, (joint, points)| {
                row.push_bind(of.run_id).push_bind(joint_number(*joint)).push_bind(count(*points));
            })
            .build()
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

async fn replace_baselines(
    connection: &mut EngineConnection,
    robot_id: i64,
    found: &FrictionConclusion,
) -> sqlx::Result<Vec<ReplacedBaseline>> {
    let stored = in_force(&mut *connection, robot_id).await?;
    let is_same = |old: &StoredBaseline, new: &NewBaseline| (old.joint, old.basis) == (new.joint, new.basis);
    let mut replaced = Vec::new();
    for old in stored.iter().filter(|old| !found.baselines.iter().any(|new| is_same(old, new))) {
        let because = why_replaced(old, found);
        end_baseline(&mut *connection, old.friction_baseline_id, &because).await?;
        replaced.push(ReplacedBaseline { joint: old.joint, epoch: old.epoch, because });
    }
    // ordinals move if an earlier epoch was added or removed; the offset keeps them distinct during the update
    sqlx::query(
        "UPDATE friction_baseline SET epoch = epoch + $1 WHERE robot_id = $2 AND replaced_at IS NULL",
    )
    .bind_all((MOST_EPOCHS, robot_id))
    .execute(&mut *connection)
    .await?;
    for new in &found.baselines {
        if let Some(old) = stored.iter().find(|old| is_same(old, new)) {
            update_baseline(&mut *connection, old.friction_baseline_id, new).await?;
        }
    }
    for new in found.baselines.iter().filter(|new| !stored.iter().any(|old| is_same(old, new))) {
        insert_baseline(&mut *connection, robot_id, new).await?;
    }
    Ok(replaced)
}

/// Reason why a baseline is no longer in force, derived from the runs.
fn why_replaced(old: &StoredBaseline, found: &FrictionConclusion) -> String {
    let gone: Vec<&i64> = old.run_ids.iter().filter(|run| !found.run_ids.contains(run)).collect();
    if !gone.is_empty() {
        return format!("{} is no longer a complete test", named(&gone));
    }
    let shared = |new: &&NewBaseline| new.run_ids.iter().filter(|run| old.run_ids.contains(run)).count();
    let of_joint = found.baselines.iter().filter(|new| new.joint == old.joint);
    let Some(new) = of_joint.max_by_key(shared).filter(|new| shared(new) > 0) else {
        return "after changes of maintenance or descriptions, this epoch has too few full tests".into();
    };
    if new.run_ids.len() != old.run_ids.len() {
        return format!("a baseline now has {} tests (detect.baseline_runs)", new.run_ids.len());
    }
    let added: Vec<&i64> = new.run_ids.iter().filter(|run| !old.run_ids.contains(run)).collect();
    if added.is_empty() {
        return "the motion before its runs, or the program, has changed".into();
    }
    let newest_before = old.run_ids.iter().max().copied().unwrap_or(0);
    match added.iter().all(|run| **run > newest_before) {
        true => format!("{} arrived later but was recorded before its last one", named(&added)),
        false => format!("{} became part of it", named(&added)),
    }
}

fn named(runs: &[&i64]) -> String {
    let numbers: Vec<String> = runs.iter().map(ToString::to_string).collect();
    format!("run {}", numbers.join(", "))
}

async fn end_baseline(
    executor: impl EngineExecutor<'_>,
    friction_baseline_id: i64,
    because: &str,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE friction_baseline
         SET replaced_at = CAST(unixepoch('subsec') * 1000000 AS BIGINT), replaced_because = $1
         WHERE friction_baseline_id = $2",
    )
    .bind_all((because, friction_baseline_id))
    .run(executor)
    .await
}

fn maintenance_id(cause: EpochCause) -> Option<i64> {
    match cause {
        EpochCause::Maintenance(id) => Some(id),
        EpochCause::FirstTest | EpochCause::Description => None,
    }
}

async fn update_baseline(
    executor: impl EngineExecutor<'_>,
    friction_baseline_id: i64,
    new: &NewBaseline,
) -> sqlx::Result<()> {
    sqlx::query(
        "UPDATE friction_baseline SET epoch = $1, cause = $2, maintenance_id = $3, begins_at = $4
         WHERE friction_baseline_id = $5",
    )
    .bind_all((new.epoch, new.cause.name(), maintenance_id(new.cause), new.begins_at, friction_baseline_id))
    .run(executor)
    .await
}

async fn insert_baseline(
    connection: &mut EngineConnection,
    robot_id: i64,
    new: &NewBaseline,
) -> sqlx::Result<()> {
    let (levels, remark) = new.formed.as_ref().map_or((None, None), |(levels, remark)| {
        ((!levels.is_empty()).then(|| as_json(levels)), remark.as_deref())
    });
    let id: i64 = sqlx::query_scalar(
        "INSERT INTO friction_baseline (robot_id, joint, epoch, cause, maintenance_id, begins_at, basis, levels,
                                        remark)
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)
         RETURNING friction_baseline_id",
    )
    .bind_all((robot_id, joint_number(new.joint), new.epoch, new.cause.name(), maintenance_id(new.cause)))
    .bind_all((new.begins_at, &new.basis[..], levels, remark))
    .fetch_one(&mut *connection)
    .await?;
    for rows in new.run_ids.chunks(ROWS_PER_STATEMENT) {
        QueryBuilder::<Engine>::new("INSERT INTO friction_baseline_run (friction_baseline_id, run_id) ")
            .push_values(rows, |mut row, run_id| {
                row.push_bind(id).push_bind(*run_id);
            })
            .build()
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

/// Levels of a map as in the view `baselines`.
fn as_json(levels: &[MapLevel]) -> String {
    let level = |level: &MapLevel| {
        serde_json::json!({
            "speed_fraction": level.speed_fraction,
            "warm_nm": finite(level.warm.value),
            "cold_nm": finite(level.cold.value),
        })
    };
    serde_json::Value::from_iter(levels.iter().map(level)).to_string()
}
