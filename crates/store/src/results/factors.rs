//! Factors of a cycle's rows: written with the cycle, read for later identification.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

use sqlx::{QueryBuilder, Row};

use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::error::StoreError;
use crate::handle::Store;
use crate::models;
use crate::models::StoredModel;
use crate::values::{ROWS_PER_STATEMENT, count, joint, joint_number, named, of_some_rows, size};
use armwatch_model::analysis::{CycleFactors, Motion, RmsdPair, TorqueFactor, WarmingContrast};
use armwatch_model::robot::ParameterId;
use armwatch_model::run::Stage;

/// Stored data of a cycle for identification and verification.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredCycle {
    /// Run of the cycle.
    pub run_id: i64,
    /// Its robot.
    pub robot: String,
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Description that its parameters belong to.
    pub model: StoredModel,
    /// Cut-off of the analysis low-pass, Hz.
    pub cutoff: f64,
    /// Sample rate, Hz.
    pub sample_rate: f64,
    /// For each joint the part of its identified rows that counts as independent; empty for a cycle that was stored
    /// before this was known, or has no parameters.
    pub independent_shares: Vec<f64>,
    /// True if its values count: neither refused nor doubtful.
    pub counts: bool,
    /// True if it was refused only for its motion: joined with others, it may still contribute.
    pub joinable: bool,
    /// Its factors.
    pub factors: CycleFactors,
}

/// A description and the parameters of each joint's columns.
pub(super) type FactorLayout = (StoredModel, Arc<[Vec<ParameterId>]>);

/// Selection of a run's factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FactorsWanted {
    /// Those for identification: excitation stage, moving rows.
    Identification,
    /// All.
    All,
}

impl Store {
    /// Reads the factors of a run's cycles, in the order of the cycles; omits cycles without any.
    pub async fn factors_of_run(
        &self,
        run_id: i64,
        wanted: FactorsWanted,
    ) -> Result<Vec<StoredCycle>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(of_run(&mut connection, run_id, wanted).await)
    }

    /// Reads the factors of some cycles of a run, given by their numbers in ascending order; omits cycles without any.
    /// Memory does not grow with the run.
    pub async fn factors_of_cycles(
        &self,
        run_id: i64,
        cycles: &[u32],
    ) -> Result<Vec<StoredCycle>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(of_cycles(&mut connection, run_id, cycles).await)
    }
}

/// Stores the factors of a cycle. `keys` are those of the model's parameters.
pub(crate) async fn record(
    connection: &mut EngineConnection,
    cycle_id: i64,
    robot_model_id: i64,
    keys: &HashMap<ParameterId, i64>,
    factors: &CycleFactors,
) -> sqlx::Result<()> {
    if factors.factors.is_empty() {
        return Ok(());
    }
    let columns = columns_text(keys, &factors.columns)?;
    let layout = layout_id(&mut *connection, robot_model_id, &columns).await?;
    insert_cycle_layout(&mut *connection, cycle_id, layout).await?;
    for rows in factors.factors.chunks(ROWS_PER_STATEMENT) {
        insert_factors(&mut *connection, cycle_id, rows).await?;
    }
    Ok(())
}

/// Stores how well the parameters of a cycle fit the start and the end of its warming stage.
pub(crate) async fn record_contrast(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    contrasts: &[WarmingContrast],
) -> sqlx::Result<()> {
    if contrasts.is_empty() {
        return Ok(());
    }
    let parts: Vec<(i64, &str, RmsdPair)> = contrasts
        .iter()
        .flat_map(|c| {
            [("start", c.start), ("end", c.end)].map(|(part, of)| (joint_number(c.joint), part, of))
        })
        .collect();
    QueryBuilder::<Engine>::new(
        "INSERT INTO warming_rmsd (cycle_id, joint, part, rmsd_nm, relative_rmsd, samples, moving_rmsd_nm,
                                   moving_relative_rmsd, moving_samples) ",
    )
    .push_values(parts, |mut row, (joint, part, pair)| {
        row.push_bind(cycle_id).push_bind(joint).push_bind(part);
        for rmsd in [pair.all_rows, pair.moving_rows] {
            row.bind_all((of_some_rows(rmsd, rmsd.value), of_some_rows(rmsd, rmsd.relative)))
                .push_bind(count(rmsd.samples));
        }
    })
    .build()
    .run(executor)
    .await
}

/// Factors of the cycles of a run that have any, in the order of the cycles.
pub(crate) async fn of_run(
    connection: &mut EngineConnection,
    run_id: i64,
    wanted: FactorsWanted,
) -> sqlx::Result<Vec<StoredCycle>> {
    read(connection, run_id, wanted, 0..=u32::MAX).await
}

/// All factors of those of `cycles`, numbers in ascending order, that have any.
async fn of_cycles(
    connection: &mut EngineConnection,
    run_id: i64,
    cycles: &[u32],
) -> sqlx::Result<Vec<StoredCycle>> {
    let (Some(&first), Some(&last)) = (cycles.first(), cycles.last()) else { return Ok(Vec::new()) };
    let mut read = read(connection, run_id, FactorsWanted::All, first..=last).await?;
    read.retain(|cycle| cycles.contains(&cycle.cycle));
    Ok(read)
}

async fn read(
    connection: &mut EngineConnection,
    run_id: i64,
    wanted: FactorsWanted,
    range: RangeInclusive<u32>,
) -> sqlx::Result<Vec<StoredCycle>> {
    let mut layouts: HashMap<i64, FactorLayout> = HashMap::new();
    let mut cycles = Vec::new();
    let mut factors = factors_by_cycle(&mut *connection, run_id, wanted, &range).await?;
    let mut shares = shares_by_cycle(&mut *connection, run_id).await?;
    for head in heads(&mut *connection, run_id, &range).await? {
        let (model, columns) = match layouts.get(&head.layout) {
            Some(known) => known.clone(),
            None => {
                let read = layout(&mut *connection, head.layout).await?;
                layouts.insert(head.layout, read.clone());
                read
            }
        };
        let factors = factors.remove(&head.cycle_id).unwrap_or_default();
        cycles.push(StoredCycle {
            run_id,
            robot: head.robot,
            cycle: head.cycle,
            model,
            cutoff: head.cutoff,
            sample_rate: head.sample_rate,
            independent_shares: shares.remove(&head.cycle_id).unwrap_or_default(),
            counts: head.counts,
            joinable: head.joinable,
            factors: CycleFactors { columns, factors },
        });
    }
    Ok(cycles)
}

/// A cycle with factors.
pub(super) struct FactorHead {
    pub(super) cycle_id: i64,
    robot: String,
    pub(super) cycle: u32,
    cutoff: f64,
    sample_rate: f64,
    counts: bool,
    joinable: bool,
    pub(super) layout: i64,
}

pub(super) async fn heads(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    range: &RangeInclusive<u32>,
) -> sqlx::Result<Vec<FactorHead>> {
    sqlx::query(
        "SELECT cycle.cycle_id, robot.name AS robot, cycle.number AS cycle, cutoff_hz, cycle.sample_rate_hz,
                cycle.status = 'complete' AND NOT cycle.doubtful AS counts,
                cycle.status = 'refused'
                AND NOT EXISTS (SELECT 1 FROM cycle_refusal WHERE cycle_refusal.cycle_id = cycle.cycle_id)
                AS joinable, factor_layout_id
         FROM cycle
         JOIN cycle_factor_layout USING (cycle_id)
         JOIN run USING (run_id)
         JOIN robot USING (robot_id)
         WHERE run_id = $1 AND cycle.number BETWEEN $2 AND $3
         ORDER BY cycle.number",
    )
    .bind_all((run_id, range.start(), range.end()))
    .try_map(|row: EngineRow| {
        Ok(FactorHead {
            cycle_id: row.try_get("cycle_id")?,
            robot: row.try_get("robot")?,
            cycle: size(&row, "cycle")?,
            cutoff: row.try_get("cutoff_hz")?,
            sample_rate: row.try_get("sample_rate_hz")?,
            counts: row.try_get("counts")?,
            joinable: row.try_get("joinable")?,
            layout: row.try_get("factor_layout_id")?,
        })
    })
    .fetch_all(executor)
    .await
}

pub(super) async fn factors_by_cycle(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    wanted: FactorsWanted,
    range: &RangeInclusive<u32>,
) -> sqlx::Result<HashMap<i64, Vec<TorqueFactor>>> {
    let rows = sqlx::query(
        "SELECT cycle_id, joint, stage, motion, torque_factor.rows, factor
         FROM cycle
         JOIN torque_factor USING (cycle_id)
         WHERE run_id = $1 AND cycle.number BETWEEN $2 AND $3
               AND ($4 OR (stage = 'excitation' AND motion = 'moving'))
         ORDER BY cycle_id, torque_factor_id",
    )
    .bind_all((run_id, range.start(), range.end(), wanted == FactorsWanted::All))
    .try_map(|row: EngineRow| {
        let factor = TorqueFactor {
            joint: joint(&row, "joint")?,
            stage: named(&row, "stage", &Stage::ALL, Stage::name)?,
            motion: named(&row, "motion", &Motion::BOTH, Motion::name)?,
            rows: size(&row, "rows")?,
            upper: numbers(row.try_get("factor")?)?,
        };
        Ok((row.try_get::<i64, _>("cycle_id")?, factor))
    })
    .fetch_all(executor)
    .await?;
    let mut by_cycle: HashMap<i64, Vec<TorqueFactor>> = HashMap::new();
    for (cycle_id, factor) in rows {
        by_cycle.entry(cycle_id).or_default().push(factor);
    }
    Ok(by_cycle)
}

async fn shares_by_cycle(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<HashMap<i64, Vec<f64>>> {
    let rows: Vec<(i64, f64)> = sqlx::query_as(
        "SELECT cycle_id, coalesce(independent_share, 1.0)
         FROM cycle
         JOIN joint_residual USING (cycle_id)
         WHERE run_id = $1
         ORDER BY cycle_id, joint",
    )
    .bind(run_id)
    .fetch_all(executor)
    .await?;
    let mut by_cycle: HashMap<i64, Vec<f64>> = HashMap::new();
    for (cycle_id, share) in rows {
        by_cycle.entry(cycle_id).or_default().push(share);
    }
    Ok(by_cycle)
}

pub(super) async fn layout(
    connection: &mut EngineConnection,
    factor_layout_id: i64,
) -> sqlx::Result<FactorLayout> {
    let (model, columns) = read_layout(&mut *connection, factor_layout_id).await?;
    let keys = models::parameter_keys(connection, model.robot_model_id).await?;
    let ids: HashMap<i64, ParameterId> = keys.into_iter().map(|(id, key)| (key, id)).collect();
    let listed: Vec<Vec<i64>> =
        serde_json::from_str(&columns).map_err(|error| sqlx::Error::Decode(error.into()))?;
    let named = |key: &i64| {
        ids.get(key).copied().ok_or_else(|| sqlx::Error::Decode(format!("no parameter has key {key}").into()))
    };
    let by_joint: sqlx::Result<Vec<Vec<ParameterId>>> =
        listed.iter().map(|of| of.iter().map(named).collect()).collect();
    Ok((model, by_joint?.into()))
}

async fn read_layout(
    executor: impl EngineExecutor<'_>,
    factor_layout_id: i64,
) -> sqlx::Result<(StoredModel, String)> {
    sqlx::query(
        "SELECT robot_model_id, name, description_hash, columns
         FROM factor_layout
         JOIN robot_model USING (robot_model_id)
         WHERE factor_layout_id = $1",
    )
    .bind(factor_layout_id)
    .try_map(|row: EngineRow| {
        let model = StoredModel {
            robot_model_id: row.try_get("robot_model_id")?,
            name: row.try_get("name")?,
            description_hash: row.try_get("description_hash")?,
        };
        Ok((model, row.try_get("columns")?))
    })
    .fetch_one(executor)
    .await
}

/// Key of a choice of columns, which is inserted if it is new.
async fn layout_id(
    connection: &mut EngineConnection,
    robot_model_id: i64,
    columns: &str,
) -> sqlx::Result<i64> {
    sqlx::query(
        "INSERT INTO factor_layout (robot_model_id, columns) VALUES ($1, $2)
         ON CONFLICT (robot_model_id, columns) DO NOTHING",
    )
    .bind_all((robot_model_id, columns))
    .execute(&mut *connection)
    .await?;
    sqlx::query_scalar(
        "SELECT factor_layout_id FROM factor_layout WHERE robot_model_id = $1 AND columns = $2",
    )
    .bind_all((robot_model_id, columns))
    .fetch_one(connection)
    .await
}

async fn insert_cycle_layout(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    factor_layout_id: i64,
) -> sqlx::Result<()> {
    sqlx::query("INSERT INTO cycle_factor_layout (cycle_id, factor_layout_id) VALUES ($1, $2)")
        .bind_all((cycle_id, factor_layout_id))
        .run(executor)
        .await
}

async fn insert_factors(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    rows: &[TorqueFactor],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new("INSERT INTO torque_factor (cycle_id, joint, stage, motion, rows, factor) ")
        .push_values(rows, |mut row, factor| {
            row.bind_all((cycle_id, joint_number(factor.joint), factor.stage.name())).bind_all((
                factor.motion.name(),
                count(factor.rows),
                bytes(&factor.upper),
            ));
        })
        .build()
        .run(executor)
        .await
}

fn columns_text(keys: &HashMap<ParameterId, i64>, columns: &[Vec<ParameterId>]) -> sqlx::Result<String> {
    let key = |id: &ParameterId| {
        keys.get(id)
            .copied()
            .ok_or_else(|| sqlx::Error::Encode(format!("parameter {id} is not in the model").into()))
    };
    let listed: sqlx::Result<Vec<Vec<i64>>> = columns.iter().map(|of| of.iter().map(key).collect()).collect();
    serde_json::to_string(&listed?).map_err(|error| sqlx::Error::Encode(error.into()))
}

pub(super) fn bytes(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

pub(super) fn numbers(bytes: &[u8]) -> sqlx::Result<Vec<f64>> {
    let (numbers, rest) = bytes.as_chunks::<8>();
    if rest.is_empty() {
        Ok(numbers.iter().map(|of| f64::from_le_bytes(*of)).collect())
    } else {
        Err(sqlx::Error::Decode(format!("a factor of {} bytes", bytes.len()).into()))
    }
}
