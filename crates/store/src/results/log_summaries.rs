//! Summaries of production logs as detectors read them: for a window of logs at once.

use std::collections::{BTreeMap, HashMap};

use jiff::Timestamp;
use sqlx::Row;

use super::production_evidence;
use crate::engine::{EngineConnection, EngineExecutor, EngineRow};
use crate::values::{joint, json_list, size, time};
use armwatch_model::analysis::{FrictionExcess, ProductionJoint};
use armwatch_model::anomaly::ProductionSummary;
use armwatch_model::robot::JointIndex;

/// Summaries of these logs, oldest first, and within a log in the order of the tests with which it is compared.
///
/// Tests and starts are read once and not with every row: hundreds of logs have thousands of rows.
pub(crate) async fn summaries(
    connection: &mut EngineConnection,
    run_ids: &[i64],
) -> sqlx::Result<Vec<ProductionSummary>> {
    let asked = json_list(run_ids);
    let logs = begun(&mut *connection, &asked).await?;
    let tests = tests_of_logs(&mut *connection, &asked).await?;
    let mut evidence = production_evidence::of_logs(&mut *connection, &asked).await?;
    let place_of_log: HashMap<i64, usize> =
        logs.iter().enumerate().map(|(place, log)| (log.0, place)).collect();
    let place_of_test: HashMap<i64, usize> =
        tests.iter().enumerate().map(|(place, test)| (test.run_id, place)).collect();
    let mut rows: Vec<(usize, usize, ProductionJoint)> = Vec::new();
    for (run_id, reference_run_id, of_joint) in joints_of_logs(&mut *connection, &asked).await? {
        if let Some((log, test)) = place_of_log.get(&run_id).zip(place_of_test.get(&reference_run_id)) {
            rows.push((*log, *test, of_joint));
        }
    }
    rows.sort_by_key(|(log, test, of_joint)| (*log, *test, of_joint.joint));
    let summary = |rows: &[(usize, usize, ProductionJoint)]| {
        let (log, test, _) = rows.first()?;
        let ((run_id, started_at), test) = (logs[*log], &tests[*test]);
        let with_error = |(_, _, of_joint): &(usize, usize, ProductionJoint)| {
            let test_relative_rmsd = test.relative_rmsd.get(&of_joint.joint).copied();
            ProductionJoint { test_relative_rmsd, ..*of_joint }
        };
        let evidence = evidence.remove(&(run_id, test.run_id)).unwrap_or_default();
        let joints = rows.iter().map(with_error).collect();
        Some(ProductionSummary { run_id, started_at, reference_run_id: test.run_id, joints, evidence })
    };
    Ok(rows.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).filter_map(summary).collect())
}

/// Runs of a list and their starts, oldest first.
async fn begun(executor: impl EngineExecutor<'_>, run_ids: &str) -> sqlx::Result<Vec<(i64, Timestamp)>> {
    sqlx::query(
        "SELECT run_id, started_at FROM run
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))
         ORDER BY started_at, run_id",
    )
    .bind(run_ids)
    .try_map(|row: EngineRow| Ok((row.try_get("run_id")?, time(&row, "started_at")?)))
    .fetch_all(executor)
    .await
}

/// A test with which logs are compared.
struct TestOfLogs {
    run_id: i64,
    /// Its own relative RMSD while a joint moves, for joints with a known value.
    relative_rmsd: BTreeMap<JointIndex, f64>,
}

/// The tests with which the logs of a list are compared, in the order of recording.
async fn tests_of_logs(executor: impl EngineExecutor<'_>, run_ids: &str) -> sqlx::Result<Vec<TestOfLogs>> {
    let rows = sqlx::query(
        "SELECT test.run_id, of_test.joint, of_test.relative_rmsd
         FROM (SELECT DISTINCT reference_run_id FROM production_summary
               WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))) AS held
         JOIN run AS test ON test.run_id = held.reference_run_id
         LEFT JOIN run_joint_summary AS of_test
                   ON of_test.run_id = test.run_id AND of_test.relative_rmsd IS NOT NULL
         ORDER BY test.started_at, test.content_hash, of_test.joint",
    )
    .bind(run_ids)
    .try_map(|row: EngineRow| {
        let relative_rmsd: Option<f64> = row.try_get("relative_rmsd")?;
        let of_joint = match relative_rmsd {
            Some(error) => Some((joint(&row, "joint")?, error)),
            None => None,
        };
        Ok((row.try_get::<i64, _>("run_id")?, of_joint))
    })
    .fetch_all(executor)
    .await?;
    let of_test = |rows: &[(i64, Option<(JointIndex, f64)>)]| TestOfLogs {
        run_id: rows[0].0,
        relative_rmsd: rows.iter().filter_map(|(_, of_joint)| *of_joint).collect(),
    };
    Ok(rows.chunk_by(|a, b| a.0 == b.0).map(of_test).collect())
}

/// Summaries of joints in the logs of a list, each with its log and its test; without the RMSD of the test itself.
async fn joints_of_logs(
    executor: impl EngineExecutor<'_>,
    run_ids: &str,
) -> sqlx::Result<Vec<(i64, i64, ProductionJoint)>> {
    sqlx::query(
        "SELECT run_id, reference_run_id, joint, windows, relative_rmsd, friction_excess, friction_share
         FROM production_summary
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1))",
    )
    .bind(run_ids)
    .try_map(|row: EngineRow| {
        let of_joint = ProductionJoint {
            joint: joint(&row, "joint")?,
            windows: size(&row, "windows")?,
            relative_rmsd: row.try_get("relative_rmsd")?,
            friction: FrictionExcess {
                excess: row.try_get("friction_excess")?,
                share: row.try_get("friction_share")?,
            },
            test_relative_rmsd: None,
        };
        Ok((row.try_get("run_id")?, row.try_get("reference_run_id")?, of_joint))
    })
    .fetch_all(executor)
    .await
}
