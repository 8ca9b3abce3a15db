//! Comparison of production windows with parameters of tests.

use std::collections::BTreeMap;

use jiff::Timestamp;
use sqlx::{QueryBuilder, Row};

use super::production_evidence;
use crate::engine::{Bind, Engine, EngineConnection, EngineExecutor, EngineRow, Run, row_of};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{ROWS_PER_STATEMENT, count, finite, joint, joint_number, of_some_rows, size};
use armwatch_model::analysis::log_summary::{log_evidence, summarise};
use armwatch_model::analysis::work_evidence::JointEvidence;
use armwatch_model::analysis::{
    Estimator, FrictionExcess, JointCheck, ProductionCheck, ProductionJoint, Rmsd, RmsdPair,
};

impl Store {
    /// At most `most` complete tests of the robot of run `run_id` whose parameters it may be compared with, the best
    /// first: the latest that started no later and those before it, then the first that started later.
    pub async fn reference_runs(&self, run_id: i64, most: usize) -> Result<Vec<i64>, StoreError> {
        self.checked(reference_runs(&self.readers, run_id, most).await)
    }

    /// Complete tests of a robot that windows from a time on may be compared with, oldest first: those that started
    /// later, and for each of these descriptions the latest `most` before.
    pub async fn reference_tests(
        &self,
        robot_id: i64,
        from: i64,
        robot_model_ids: &[i64],
        most: usize,
    ) -> Result<Vec<ReferenceTest>, StoreError> {
        let mut tests = Vec::new();
        for model in robot_model_ids {
            let mut before = self.checked(tests_before(&self.readers, robot_id, from, *model, most).await)?;
            before.reverse();
            tests.append(&mut before);
        }
        // the tests of one description are already in order
        tests.sort_by_key(|test| test.started_at);
        tests.extend(self.checked(tests_after(&self.readers, robot_id, from).await)?);
        Ok(tests)
    }

    /// Production windows of a robot that have factors, by run and number, with the test that they are compared with by
    /// `estimator`.
    pub async fn production_windows(
        &self,
        robot_id: i64,
        estimator: Estimator,
    ) -> Result<Vec<ProductionWindow>, StoreError> {
        self.checked(windows(&self.readers, robot_id, estimator).await)
    }

    /// The run whose parameters a production window was compared with.
    pub async fn checked_against(&self, run_id: i64, cycle: u32) -> Result<Option<i64>, StoreError> {
        self.checked(checked_against(&self.readers, run_id, cycle).await)
    }
}

/// Stores the check of a window that has none. Call this in a transaction.
pub(crate) async fn record(
    connection: &mut EngineConnection,
    cycle_id: i64,
    check: &ProductionCheck,
) -> sqlx::Result<()> {
    for joints in check.joints.chunks(ROWS_PER_STATEMENT) {
        insert(&mut *connection, cycle_id, check, joints).await?;
    }
    // a window without a moving joint has evidence without joints; one window without a row leaves the whole log
    // without evidence
    if !check.joints.is_empty() {
        production_evidence::record_window(connection, cycle_id, &check.evidence).await?;
    }
    Ok(())
}

async fn insert(
    executor: impl EngineExecutor<'_>,
    cycle_id: i64,
    of: &ProductionCheck,
    joints: &[JointCheck],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO production_check (cycle_id, joint, reference_run_id, estimator, rmsd_nm, relative_rmsd, samples,
                                       moving_rmsd_nm, moving_relative_rmsd, moving_samples, friction_excess, friction_share) ",
    )
    .push_values(joints, |mut row, check| {
        row.bind_all((cycle_id, joint_number(check.joint), of.reference_run_id, of.estimator.name()));
        for rmsd in [check.rmsd.all_rows, check.rmsd.moving_rows] {
            row.bind_all((of_some_rows(rmsd, rmsd.value), of_some_rows(rmsd, rmsd.relative)))
                .push_bind(count(rmsd.samples));
        }
        row.push_bind(check.friction.and_then(|friction| finite(friction.excess)))
            .push_bind(check.friction.and_then(|friction| finite(friction.share)));
    })
    .build()
    .run(executor)
    .await
}

/// At most `most` complete tests with parameters of the robot of `run_id`: first those that started no later, latest
/// first, then the first later one.
pub(crate) async fn reference_runs(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    most: usize,
) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT run_id
         FROM (
             SELECT * FROM (
                 SELECT 0 AS is_later, run_id, -started_at AS place, content_hash
                 FROM run
                 WHERE robot_id = (SELECT robot_id FROM run WHERE run_id = $1) AND status = 'complete' AND kind = 'test'
                       AND started_at <= (SELECT started_at FROM run WHERE run_id = $1)
                       AND EXISTS (SELECT 1 FROM cycle WHERE cycle.run_id = run.run_id AND cycle.status = 'complete'
                                   AND NOT cycle.doubtful)
                 ORDER BY started_at DESC, content_hash DESC
                 LIMIT $2) AS before
             UNION ALL
             SELECT * FROM (
                 SELECT 1 AS is_later, run_id, started_at AS place, content_hash
                 FROM run
                 WHERE robot_id = (SELECT robot_id FROM run WHERE run_id = $1) AND status = 'complete' AND kind = 'test'
                       AND started_at > (SELECT started_at FROM run WHERE run_id = $1)
                       AND EXISTS (SELECT 1 FROM cycle WHERE cycle.run_id = run.run_id AND cycle.status = 'complete'
                                   AND NOT cycle.doubtful)
                 ORDER BY started_at, content_hash DESC
                 LIMIT $2) AS behind
         ) AS nearest
         ORDER BY is_later, place, content_hash DESC
         LIMIT $2",
    )
    .bind_all((run_id, count(most)))
    .fetch_all(executor)
    .await
}

/// A test that production may be compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReferenceTest {
    /// Database key of the run.
    pub run_id: i64,
    /// Start of the recording, microseconds UTC.
    pub started_at: i64,
    /// Description that its parameters belong to.
    pub robot_model_id: i64,
}

row_of!(ReferenceTest { run_id, started_at, robot_model_id });

/// A production window with factors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProductionWindow {
    /// Database key of the run.
    pub run_id: i64,
    /// Number of the window, from 1.
    pub cycle: u32,
    /// Start of the window, microseconds UTC.
    pub started_at: i64,
    /// Description that its factors were made with.
    pub robot_model_id: i64,
    /// The test that conclusions have compared it with, by the requested estimator.
    pub settled_against: Option<i64>,
}

row_of!(ProductionWindow { run_id, cycle, started_at, robot_model_id, settled_against });

/// Description that the parameters of a row of `run` belong to. NULL for a test without parameters, or with cycles of
/// two descriptions, which cannot be combined. A test whose factors were removed keeps it: windows stay with the test
/// that they were compared with.
macro_rules! model_of_test {
    () => {
        "(SELECT CASE WHEN min(coalesce(factor_layout.robot_model_id, run.robot_model_id))
                           = max(coalesce(factor_layout.robot_model_id, run.robot_model_id))
                      THEN max(coalesce(factor_layout.robot_model_id, run.robot_model_id)) END
          FROM cycle
          LEFT JOIN cycle_factor_layout USING (cycle_id)
          LEFT JOIN factor_layout USING (factor_layout_id)
          WHERE cycle.run_id = run.run_id AND cycle.status = 'complete' AND NOT cycle.doubtful
                AND (factor_layout.factor_layout_id IS NOT NULL
                     OR cycle.factors_gone IS NOT NULL AND run.robot_model_id IS NOT NULL))"
    };
}

/// Complete tests of a robot with parameters that started later, oldest first. The order is that of recording, not of
/// storing.
async fn tests_after(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    from: i64,
) -> sqlx::Result<Vec<ReferenceTest>> {
    sqlx::query_as(concat!(
        "SELECT run_id, started_at, robot_model_id
         FROM (SELECT run_id, started_at, content_hash, ",
        model_of_test!(),
        " AS robot_model_id
               FROM run
               WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND started_at > $2) AS known
         WHERE robot_model_id IS NOT NULL
         ORDER BY started_at, content_hash"
    ))
    .bind_all((robot_id, from))
    .fetch_all(executor)
    .await
}

/// The latest complete tests of a robot with parameters of a description that started no later, latest first. Only its
/// latest 256 tests are searched: no older test has a description that is new.
async fn tests_before(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    from: i64,
    robot_model_id: i64,
    most: usize,
) -> sqlx::Result<Vec<ReferenceTest>> {
    sqlx::query_as(concat!(
        "SELECT run_id, started_at, $3 AS robot_model_id
         FROM (SELECT run_id, started_at, content_hash, robot_model_id
               FROM run
               WHERE robot_id = $1 AND kind = 'test' AND status = 'complete' AND started_at <= $2
               ORDER BY started_at DESC, content_hash DESC
               LIMIT 256) AS run
         WHERE ",
        model_of_test!(),
        " = $3
         ORDER BY started_at DESC, content_hash DESC
         LIMIT $4"
    ))
    .bind_all((robot_id, from, robot_model_id, count(most)))
    .fetch_all(executor)
    .await
}

/// Production windows of a robot, by run and number. Includes those of quarantined logs, because these are shown.
pub(crate) async fn windows(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    estimator: Estimator,
) -> sqlx::Result<Vec<ProductionWindow>> {
    sqlx::query_as(
        "SELECT run.run_id, cycle.number AS cycle, cycle.started_at, factor_layout.robot_model_id,
                (SELECT reference_run_id FROM production_check
                 WHERE production_check.cycle_id = cycle.cycle_id AND settled
                       AND production_check.estimator = $2
                 LIMIT 1) AS settled_against
         FROM run
         JOIN cycle USING (run_id)
         JOIN cycle_factor_layout USING (cycle_id)
         JOIN factor_layout USING (factor_layout_id)
         WHERE run.robot_id = $1 AND run.kind = 'production' AND run.superseded_by_run_id IS NULL
               AND cycle.status = 'complete' AND cycle.factors_gone IS NULL
         ORDER BY run.run_id, cycle.number",
    )
    .bind_all((robot_id, estimator.name()))
    .fetch_all(executor)
    .await
}

/// Stores the tests with which windows of a run, given by their numbers, are compared from now on, replacing earlier
/// ones, and the new summary of the run. Call this in a transaction.
pub(crate) async fn settle(
    connection: &mut EngineConnection,
    run_id: i64,
    checks: &[(u32, ProductionCheck)],
) -> sqlx::Result<()> {
    for (number, check) in checks {
        let Some(cycle_id) = cycle_id(&mut *connection, run_id, *number).await? else { continue };
        delete(&mut *connection, cycle_id).await?;
        record(&mut *connection, cycle_id, check).await?;
        mark_settled(&mut *connection, cycle_id).await?;
    }
    summarise_run(connection, run_id).await
}

/// Summarises logs of a robot that began at this time or later and have settled windows but no summary, such as a log
/// that was opened again and ended without a new window. Call this in a transaction.
pub(crate) async fn summarise_rest(
    connection: &mut EngineConnection,
    robot_id: i64,
    from: Option<Timestamp>,
) -> sqlx::Result<()> {
    let without: Vec<i64> = sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE robot_id = $1 AND kind = 'production' AND status IN ('complete', 'quarantined') AND started_at >= $2
               AND superseded_by_run_id IS NULL
               AND NOT EXISTS (SELECT 1 FROM production_summary AS summary WHERE summary.run_id = run.run_id)
               AND EXISTS (SELECT 1 FROM cycle JOIN production_check USING (cycle_id)
                           WHERE cycle.run_id = run.run_id AND settled)",
    )
    .bind_all((robot_id, from.map_or(i64::MIN, Timestamp::as_microsecond)))
    .fetch_all(&mut *connection)
    .await?;
    for run_id in without {
        summarise_run(&mut *connection, run_id).await?;
    }
    Ok(())
}

/// Stores the summary of a log from its settled windows, replacing an earlier one.
async fn summarise_run(connection: &mut EngineConnection, run_id: i64) -> sqlx::Result<()> {
    let mut by_reference: BTreeMap<i64, BTreeMap<u32, Vec<JointCheck>>> = BTreeMap::new();
    for (reference, cycle, check) in checks_of_run(&mut *connection, run_id).await? {
        by_reference.entry(reference).or_default().entry(cycle).or_default().push(check);
    }
    let mut known = production_evidence::of_log(&mut *connection, run_id).await?;
    let mut of_windows: BTreeMap<i64, Vec<Option<Vec<JointEvidence>>>> = BTreeMap::new();
    for (reference, evidence) in production_evidence::of_windows(&mut *connection, run_id).await? {
        of_windows.entry(reference).or_default().push(evidence);
    }
    delete_summaries(&mut *connection, run_id).await?;
    for (reference, windows) in by_reference {
        let joints = summarise(windows.values().map(Vec::as_slice));
        if joints.is_empty() {
            continue;
        }
        insert_summaries(&mut *connection, run_id, reference, &joints).await?;
        // windows without factors have no evidence any more: the evidence of their log with them stays
        let all: Option<Vec<_>> = of_windows.remove(&reference).unwrap_or_default().into_iter().collect();
        let of_log = all.map(|windows| log_evidence(&windows));
        if let Some(evidence) = of_log.or_else(|| known.remove(&reference)).filter(|of| !of.is_empty()) {
            production_evidence::record_log(&mut *connection, run_id, reference, &evidence).await?;
        }
    }
    Ok(())
}

async fn cycle_id(executor: impl EngineExecutor<'_>, run_id: i64, number: u32) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar("SELECT cycle_id FROM cycle WHERE run_id = $1 AND number = $2")
        .bind_all((run_id, number))
        .fetch_optional(executor)
        .await
}

async fn delete(executor: impl EngineExecutor<'_>, cycle_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM production_check WHERE cycle_id = $1").bind(cycle_id).run(executor).await
}

async fn mark_settled(executor: impl EngineExecutor<'_>, cycle_id: i64) -> sqlx::Result<()> {
    sqlx::query("UPDATE production_check SET settled = TRUE WHERE cycle_id = $1")
        .bind(cycle_id)
        .run(executor)
        .await
}

/// Settled checks of a run with the test and the number of the window, as far as a summary needs them.
async fn checks_of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<(i64, u32, JointCheck)>> {
    sqlx::query(
        "SELECT reference_run_id, cycle.number AS cycle, joint, moving_relative_rmsd, moving_samples,
                friction_excess, friction_share
         FROM cycle
         JOIN production_check USING (cycle_id)
         WHERE run_id = $1 AND settled AND moving_relative_rmsd IS NOT NULL
         ORDER BY cycle.number, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let relative = row.try_get("moving_relative_rmsd")?;
        let moving_rows = Rmsd { relative, samples: size(&row, "moving_samples")?, ..Rmsd::default() };
        let excess: Option<f64> = row.try_get("friction_excess")?;
        let share: Option<f64> = row.try_get("friction_share")?;
        let check = JointCheck {
            joint: joint(&row, "joint")?,
            rmsd: RmsdPair { moving_rows, ..RmsdPair::default() },
            friction: excess.zip(share).map(|(excess, share)| FrictionExcess { excess, share }),
        };
        Ok((row.try_get("reference_run_id")?, size(&row, "cycle")?, check))
    })
    .fetch_all(executor)
    .await
}

async fn delete_summaries(executor: impl EngineExecutor<'_>, run_id: i64) -> sqlx::Result<()> {
    sqlx::query("DELETE FROM production_summary WHERE run_id = $1").bind(run_id).run(executor).await
}

async fn insert_summaries(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    reference_run_id: i64,
    joints: &[ProductionJoint],
) -> sqlx::Result<()> {
    QueryBuilder::<Engine>::new(
        "INSERT INTO production_summary (run_id, reference_run_id, joint, windows, relative_rmsd, friction_excess,
                                         friction_share) ",
    )
    .push_values(joints, |mut row, of| {
        row.bind_all((run_id, reference_run_id, joint_number(of.joint), count(of.windows)))
            .bind_all((of.relative_rmsd, of.friction.excess, of.friction.share));
    })
    .build()
    .run(executor)
    .await
}

/// The run whose parameters a window was compared with.
pub(crate) async fn checked_against(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
    cycle: u32,
) -> sqlx::Result<Option<i64>> {
    sqlx::query_scalar(
        "SELECT reference_run_id FROM cycle JOIN production_check USING (cycle_id)
         WHERE run_id = $1 AND number = $2
         LIMIT 1",
    )
    .bind_all((run_id, cycle))
    .fetch_optional(executor)
    .await
}
