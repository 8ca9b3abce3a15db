//! Mean temperatures of cycles: kelvin in the program, degC in the database.

use std::collections::HashMap;

use sqlx::{QueryBuilder, Row};

use crate::engine::{Engine, EngineConnection, EngineExecutor, EngineRow, Run};
use crate::values::{ROWS_PER_STATEMENT, finite, size};
use armwatch_model::analysis::CycleTemperatures;
use armwatch_model::run::temperature::ZERO_CELSIUS;

/// Number of the ambient temperature among the joints, which count from 1.
const HALL: usize = 0;

/// Inserts the temperatures of a cycle. Call this in a transaction.
pub(crate) async fn record(
    connection: &mut EngineConnection,
    cycle_id: i64,
    temperatures: &CycleTemperatures,
) -> sqlx::Result<()> {
    let motors = (1..).zip(temperatures.motor.iter().copied());
    let all = [(HALL, temperatures.ambient)].into_iter().chain(motors);
    let known: Vec<(usize, f64)> = all.filter_map(|(joint, kelvin)| Some((joint, kelvin?))).collect();
    for rows in known.chunks(ROWS_PER_STATEMENT) {
        insert(&mut *connection, cycle_id, rows).await?;
    }
    Ok(())
}

async fn insert(executor: impl EngineExecutor<'_>, cycle_id: i64, rows: &[(usize, f64)]) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new("INSERT INTO cycle_temperature (cycle_id, joint, temperature_degc) ")
        .push_values(rows, |mut row, (joint, kelvin)| {
            // joint numbers are far below the limit of an i64
            row.push_bind(cycle_id).push_bind(*joint as i64).push_bind(finite(kelvin - ZERO_CELSIUS));
        })
        .build()
        .run(executor)
        .await
}

/// Temperatures of the cycles of a run, K, by the cycle's key.
pub(crate) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<HashMap<i64, CycleTemperatures>> {
    let rows = sqlx::query(
        "SELECT cycle_id, joint, temperature_degc
         FROM cycle
         JOIN cycle_temperature USING (cycle_id)
         WHERE run_id = $1
         ORDER BY cycle_id, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let celsius: f64 = row.try_get("temperature_degc")?;
        Ok((row.try_get::<i64, _>("cycle_id")?, size::<usize>(&row, "joint")?, celsius + ZERO_CELSIUS))
    })
    .fetch_all(executor)
    .await?;
    let mut found: HashMap<i64, CycleTemperatures> = HashMap::new();
    for (cycle_id, joint, kelvin) in rows {
        let of_cycle = found.entry(cycle_id).or_default();
        match joint {
            HALL => of_cycle.ambient = Some(kelvin),
            joint => {
                let needed = of_cycle.motor.len().max(joint);
                of_cycle.motor.resize(needed, None);
                of_cycle.motor[joint - 1] = Some(kelvin);
            }
        }
    }
    Ok(found)
}
