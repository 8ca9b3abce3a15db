//! Intervals of parameters that were stored before their widths were: Student's quantile is no function of SQL, so that
//! a migration cannot fill them.

use sqlx::{FromRow, QueryBuilder, Row};

use crate::engine::{Engine, EngineConnection, EngineExecutor, EnginePool, EngineRow, begin_writing};
use crate::values::{ROWS_PER_STATEMENT, finite};
use armwatch_model::analysis::interval::{LEVEL, student_quantile};

/// Cycles that are filled in one transaction: some ten thousand parameters, a tenth of a second.
const CYCLES_AT_ONCE: i64 = 200;

/// A parameter of a cycle with what its interval follows from.
struct KnownFreedom {
    cycle_id: i64,
    model_parameter_id: i64,
    std_error: f64,
    degrees_of_freedom: f64,
}

impl FromRow<'_, EngineRow> for KnownFreedom {
    fn from_row(row: &EngineRow) -> Result<Self, sqlx::Error> {
        Ok(Self {
            cycle_id: row.try_get("cycle_id")?,
            model_parameter_id: row.try_get("model_parameter_id")?,
            std_error: row.try_get("std_error")?,
            degrees_of_freedom: row.try_get("degrees_of_freedom")?,
        })
    }
}

/// Fills what is not filled yet, some cycles a transaction; a stop in between loses nothing. Without anything to do it
/// costs one look at an empty table.
pub(crate) async fn fill(writer: &EnginePool) -> Result<(), sqlx::Error> {
    while reached(writer).await?.is_some() {
        let mut transaction = begin_writing(writer).await?;
        // another process may have gone on meanwhile
        if let Some(after) = reached(&mut *transaction).await? {
            fill_some(&mut transaction, after).await?;
        }
        transaction.commit().await?;
    }
    Ok(())
}

async fn reached(executor: impl EngineExecutor<'_>) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar("SELECT after_cycle_id FROM interval_fill").fetch_optional(executor).await
}

async fn fill_some(connection: &mut EngineConnection, after: i64) -> Result<(), sqlx::Error> {
    let Some(last) = last_of_some(&mut *connection, after).await? else {
        sqlx::query("DELETE FROM interval_fill").execute(connection).await?;
        return Ok(());
    };
    let known = parameters(&mut *connection, after, last).await?;
    for rows in known.chunks(ROWS_PER_STATEMENT) {
        set_half_widths(&mut *connection, rows).await?;
    }
    sqlx::query("UPDATE interval_fill SET after_cycle_id = $1").bind(last).execute(connection).await?;
    Ok(())
}

/// Key of the last of the next cycles.
async fn last_of_some(executor: impl EngineExecutor<'_>, after: i64) -> Result<Option<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT max(cycle_id) FROM (SELECT cycle_id FROM cycle WHERE cycle_id > $1 ORDER BY cycle_id LIMIT $2) AS next",
    )
    .bind(after)
    .bind(CYCLES_AT_ONCE)
    .fetch_one(executor)
    .await
}

async fn parameters(
    executor: impl EngineExecutor<'_>,
    after: i64,
    last: i64,
) -> Result<Vec<KnownFreedom>, sqlx::Error> {
    sqlx::query_as(
        "SELECT cycle_id, model_parameter_id, std_error, degrees_of_freedom
         FROM cycle_parameter
         WHERE cycle_id > $1 AND cycle_id <= $2 AND std_error IS NOT NULL AND degrees_of_freedom IS NOT NULL
               AND half_width_95 IS NULL",
    )
    .bind(after)
    .bind(last)
    .fetch_all(executor)
    .await
}

async fn set_half_widths(
    executor: impl EngineExecutor<'_>,
    rows: &[KnownFreedom],
) -> Result<(), sqlx::Error> {
    let mut query =
        QueryBuilder::<Engine>::new("WITH filled (cycle_id, model_parameter_id, half_width) AS (");
    query.push_values(rows, |mut row, of| {
        let quantile = student_quantile(0.5 + 0.5 * LEVEL, of.degrees_of_freedom);
        row.push_bind(of.cycle_id)
            .push_bind(of.model_parameter_id)
            .push_bind(finite(quantile * of.std_error));
    });
    query.push(
        ") UPDATE cycle_parameter SET half_width_95 = filled.half_width
         FROM filled
         WHERE cycle_parameter.cycle_id = filled.cycle_id
               AND cycle_parameter.model_parameter_id = filled.model_parameter_id",
    );
    query.build().execute(executor).await?;
    Ok(())
}
