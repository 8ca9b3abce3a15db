//! Stores friction of each joint in each cycle as one number, from the friction points.

use std::collections::{BTreeMap, HashMap};

use sqlx::QueryBuilder;

use super::history;
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor};
use crate::values::{ROWS_PER_STATEMENT, joint_number};
use armwatch_model::analysis::FrictionPoint;
use armwatch_model::analysis::cycle_friction::cycle_friction;
use armwatch_model::analysis::friction::CycleFriction;

/// Inserts the rows of a complete test with a cycle that has none yet: a complete run may have grown.
pub(super) async fn complete(connection: &mut EngineConnection, run_id: i64) -> sqlx::Result<()> {
    if has_cycle_without(&mut *connection, run_id).await? {
        complete_run(connection, run_id).await?;
    }
    Ok(())
}

async fn has_cycle_without(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<bool> {
    sqlx::query_scalar(
        "SELECT EXISTS (
             SELECT 1 FROM cycle
             WHERE cycle.run_id = $1
                   AND EXISTS (SELECT 1 FROM friction_point WHERE friction_point.cycle_id = cycle.cycle_id)
                   AND NOT EXISTS (SELECT 1 FROM cycle_friction_level AS level
                                   WHERE level.cycle_id = cycle.cycle_id))",
    )
    .bind(run_id)
    .fetch_one(executor)
    .await
}

async fn complete_run(connection: &mut EngineConnection, run_id: i64) -> sqlx::Result<()> {
    let mut by_cycle: BTreeMap<u32, Vec<FrictionPoint>> = BTreeMap::new();
    for of in history::friction_points(&mut *connection, run_id).await? {
        by_cycle.entry(of.cycle).or_default().push(of.point);
    }
    let keys: Vec<(u32, i64)> = sqlx::query_as("SELECT number, cycle_id FROM cycle WHERE run_id = $1")
        .bind(run_id)
        .fetch_all(&mut *connection)
        .await?;
    let keys: HashMap<u32, i64> = keys.into_iter().collect();
    let rows: Vec<(i64, CycleFriction)> = by_cycle
        .iter()
        .filter_map(|(cycle, points)| Some((*keys.get(cycle)?, cycle_friction(points))))
        .flat_map(|(cycle_id, of_joints)| of_joints.into_iter().map(move |of| (cycle_id, of)))
        .collect();
    for rows in rows.chunks(ROWS_PER_STATEMENT) {
        let mut insert = QueryBuilder::<Engine>::new(
            "INSERT INTO cycle_friction_level (cycle_id, joint, minute, ln_torque, offset_nm, levels, speed_fraction) ",
        );
        insert.push_values(rows, |mut row, (cycle_id, of)| {
            row.bind_all((*cycle_id, joint_number(of.joint), of.minute, of.ln_torque, of.offset))
                .bind_all((of.levels, of.speed_fraction));
        });
        insert.push(
            " ON CONFLICT (cycle_id, joint) DO UPDATE
              SET minute = excluded.minute, ln_torque = excluded.ln_torque, offset_nm = excluded.offset_nm,
                  levels = excluded.levels, speed_fraction = excluded.speed_fraction",
        );
        insert.build().execute(&mut *connection).await?;
    }
    Ok(())
}
