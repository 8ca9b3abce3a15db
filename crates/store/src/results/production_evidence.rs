//! Evidence of windows and logs of production: the torque residual relative to a test, projected on the direction of
//! each possible cause.
//!
//! Format: for each joint its number as one byte, its windows and rows as four bytes each, and the products as eight
//! bytes each, little-endian.

use std::collections::BTreeMap;

use sqlx::QueryBuilder;

use crate::engine::{Bind, Engine, EngineExecutor, Run};
use crate::values::unreadable;
use armwatch_model::analysis::work_evidence::{JointEvidence, PRODUCTS};
use armwatch_model::robot::JointIndex;

/// Bytes before the products of a joint.
const HEAD: usize = 9;
const BYTES_OF_JOINT: usize = HEAD + 8 * PRODUCTS;

/// Stores the evidence of a window that has none.
pub(super) async fn record_window(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    evidence: &[JointEvidence],
) -> sqlx::Result<()> {
    sqlx::query("INSERT INTO window_evidence (cycle_id, numbers) VALUES ($1, $2)")
        .bind_all((cycle_id, packed(evidence)))
        .run(executor)
        .await
}

/// Evidence of the settled windows of a log with their tests; `None` for windows without evidence.
pub(super) async fn of_windows(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<(i64, Option<Vec<JointEvidence>>)>> {
    let rows: Vec<(i64, i64, Option<Vec<u8>>)> = sqlx::query_as(
        "SELECT cycle.cycle_id, settled.reference_run_id, window_evidence.numbers
         FROM cycle
         JOIN (SELECT DISTINCT production_check.cycle_id, reference_run_id
               FROM cycle JOIN production_check USING (cycle_id)
               WHERE cycle.run_id = $1 AND settled) AS settled USING (cycle_id)
         LEFT JOIN window_evidence USING (cycle_id)
         WHERE cycle.run_id = $1
         ORDER BY cycle.number",
    )
    .bind(run_id)
    .fetch_all(executor)
    .await?;
    let read = |(cycle_id, reference, numbers): (i64, i64, Option<Vec<u8>>)| {
        let own =
            numbers.map(|bytes| unpacked(&bytes).ok_or_else(|| unreadable("window_evidence", cycle_id)));
        Ok((reference, own.transpose()?))
    };
    rows.into_iter().map(read).collect()
}

/// Stores the evidence of a log for one test, replacing earlier evidence.
pub(super) async fn record_log(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    reference_run_id: i64,
    evidence: &[JointEvidence],
) -> sqlx::Result<()> {
    sqlx::query(
        "INSERT INTO log_evidence (run_id, reference_run_id, numbers) VALUES ($1, $2, $3)
         ON CONFLICT (run_id, reference_run_id) DO UPDATE SET numbers = excluded.numbers",
    )
    .bind_all((run_id, reference_run_id, packed(evidence)))
    .run(executor)
    .await
}

/// Evidence of one log, by test.
pub(super) async fn of_log(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<BTreeMap<i64, Vec<JointEvidence>>> {
    let rows: Vec<(i64, Vec<u8>)> =
        sqlx::query_as("SELECT reference_run_id, numbers FROM log_evidence WHERE run_id = $1")
            .bind(run_id)
            .fetch_all(executor)
            .await?;
    let read = |(reference, bytes): (i64, Vec<u8>)| {
        Ok((reference, unpacked(&bytes).ok_or_else(|| unreadable("log_evidence", run_id))?))
    };
    rows.into_iter().map(read).collect()
}

/// Evidence of the logs of a list, by log and test.
pub(super) async fn of_logs(
    executor: impl EngineExecutor<'_>,
    run_ids: &str,
) -> sqlx::Result<BTreeMap<(i64, i64), Vec<JointEvidence>>> {
    let rows: Vec<(i64, i64, Vec<u8>)> = sqlx::query_as(
        "SELECT run_id, reference_run_id, numbers FROM log_evidence
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))",
    )
    .bind(run_ids)
    .fetch_all(executor)
    .await?;
    let read = |(run_id, reference, bytes): (i64, i64, Vec<u8>)| {
        Ok(((run_id, reference), unpacked(&bytes).ok_or_else(|| unreadable("log_evidence", run_id))?))
    };
    rows.into_iter().map(read).collect()
}

/// Deletes the evidence of windows; that of their logs stays.
pub(super) async fn remove_windows(executor: impl EngineExecutor<'_>, cycle_ids: &[i64]) -> sqlx::Result<()> {
    let mut query = QueryBuilder::<Engine>::new("DELETE FROM window_evidence WHERE cycle_id IN (");
    let mut listed = query.separated(", ");
    for id in cycle_ids {
        listed.push_bind(*id);
    }
    listed.push_unseparated(")");
    query.build().run(executor).await
}

/// Evidence in the stored format.
pub(crate) fn packed(evidence: &[JointEvidence]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(BYTES_OF_JOINT * evidence.len());
    for of in evidence {
        bytes.push(u8::try_from(of.joint.number()).unwrap_or(u8::MAX));
        for count in [of.windows, of.samples] {
            bytes.extend(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
        }
        bytes.extend(of.products.iter().flat_map(|number| number.to_le_bytes()));
    }
    bytes
}

fn unpacked(bytes: &[u8]) -> Option<Vec<JointEvidence>> {
    let (joints, rest) = bytes.as_chunks::<BYTES_OF_JOINT>();
    let of = |bytes: &[u8; BYTES_OF_JOINT]| {
        let (head, products) = bytes.split_first_chunk::<HEAD>()?;
        let count = |at: usize| {
            let four: [u8; 4] = head[at..at + 4].try_into().ok()?;
            usize::try_from(u32::from_le_bytes(four)).ok()
        };
        let mut found = [0.0; PRODUCTS];
        for (number, bytes) in found.iter_mut().zip(products.as_chunks::<8>().0) {
            *number = f64::from_le_bytes(*bytes);
        }
        let joint = JointIndex::from_number(usize::from(head[0]))?;
        Some(JointEvidence { joint, windows: count(1)?, samples: count(5)?, products: found })
    };
    joints.iter().map(of).collect::<Option<Vec<_>>>().filter(|_| rest.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_comes_back() {
        let of = |joint: usize| JointEvidence {
            joint: JointIndex::new(joint),
            windows: 3 + joint,
            samples: 6000,
            products: std::array::from_fn(|place| place as f64 / 7.0 - joint as f64),
        };
        let evidence = vec![of(0), of(4)];
        let bytes = packed(&evidence);
        assert_eq!(bytes.len(), 2 * 369);
        assert_eq!(unpacked(&bytes), Some(evidence));
        assert_eq!(unpacked(&bytes[1..]), None);
        assert_eq!(unpacked(&[]), Some(Vec::new()));
    }
}
