//! Summaries of complete tests, as detectors compare them.

use std::collections::{HashMap, HashSet};

use sqlx::Row;

use super::figures::cycle_friction;
use super::figures::joint_summary::SummaryRow;
use super::figures::packed::unpacked;
use super::figures::run_summary::{self, TestFigures};
use super::{cycle_friction_rows, maintenance};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, begin_reading};
use crate::error::StoreError;
use crate::handle::Store;
use crate::results::channel_response;
use crate::values::{joint, json_list, named, size, time};
use armwatch_model::analysis::refusal::{Channel, RefusalCause};
use armwatch_model::anomaly::{RunRefusal, RunSummary};

/// Tests summarised in one transaction. Other writers wait some tens of milliseconds for it.
const TESTS_AT_ONCE: usize = 32;

/// Tests that are evaluated together.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TestWindow {
    /// The tests, oldest first.
    pub tests: Vec<RunSummary>,
    /// Stored judgements, as bytes, by the key of the test.
    pub judgements: HashMap<i64, Vec<u8>>,
}

impl Store {
    /// Stores the summaries of those tests whose results have changed since, and of those that have none.
    pub async fn summarise_tests(&self, run_ids: &[i64], method: u64) -> Result<(), StoreError> {
        let outdated = self.checked(outdated(&self.readers, run_ids, method).await)?;
        for some in outdated.chunks(TESTS_AT_ONCE) {
            let mut transaction = self.begin().await?;
            for run_id in some {
                let stored = store_summary(&mut transaction, *run_id, method).await;
                self.checked(stored)?;
            }
            self.commit(transaction).await?;
        }
        Ok(())
    }

    /// Reads these tests of a robot, from their stored summaries if these are valid. `first_of_epochs` are other tests,
    /// with which epochs began.
    pub async fn test_window(
        &self,
        robot_id: i64,
        run_ids: &[i64],
        first_of_epochs: &[i64],
        method: u64,
    ) -> Result<TestWindow, StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        self.checked(window(&mut snapshot, robot_id, run_ids, first_of_epochs, Some(method)).await)
    }

    /// Stores judgements of tests, as bytes, replacing earlier ones.
    pub async fn keep_judgements(&self, judgements: &[(i64, Vec<u8>)]) -> Result<(), StoreError> {
        if judgements.is_empty() {
            return Ok(());
        }
        let mut transaction = self.begin().await?;
        for (run_id, bytes) in judgements {
            let kept = sqlx::query("UPDATE run_summary SET judgements = $1 WHERE run_id = $2")
                .bind_all((bytes, run_id))
                .execute(&mut *transaction)
                .await;
            self.checked(kept)?;
        }
        self.commit(transaction).await
    }

    /// Reads all complete tests of a robot from the tables, ordered by start, then key.
    pub async fn run_summaries(&self, robot_id: i64) -> Result<Vec<RunSummary>, StoreError> {
        let mut snapshot = self.checked(begin_reading(&self.readers).await)?;
        let run_ids = self.checked(complete_tests(&mut *snapshot, robot_id).await)?;
        Ok(self.checked(window(&mut snapshot, robot_id, &run_ids, &[], None).await)?.tests)
    }
}

async fn complete_tests(executor: impl EngineExecutor<'_>, robot_id: i64) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar("SELECT run_id FROM run WHERE robot_id = $1 AND kind = 'test' AND status = 'complete'")
        .bind(robot_id)
        .fetch_all(executor)
        .await
}

/// Those of these tests without a valid summary.
async fn outdated(executor: impl EngineExecutor<'_>, run_ids: &[i64], method: u64) -> sqlx::Result<Vec<i64>> {
    sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($1)) AND kind = 'test' AND status = 'complete'
               AND NOT EXISTS (SELECT 1 FROM run_summary AS summary
                               WHERE summary.run_id = run.run_id AND summary.revision = run.revision
                                     AND summary.method = $2)
         ORDER BY started_at, run_id",
    )
    .bind_all((json_list(run_ids), method.cast_signed()))
    .fetch_all(executor)
    .await
}

async fn store_summary(connection: &mut EngineConnection, run_id: i64, method: u64) -> sqlx::Result<()> {
    cycle_friction_rows::complete(&mut *connection, run_id).await?;
    let figures = run_summary::of_run(&mut *connection, run_id).await?;
    run_summary::store(connection, run_id, &figures, method).await
}

/// A test, before the estimator of the latest one is known.
struct SummarisedTest {
    run: RunSummary,
    joints: Vec<SummaryRow>,
    has_response: bool,
}

/// Reads tests. Torque deviations are those of the latest test's estimator: a test identified with another one has no
/// comparable deviations. Without a method, stored summaries are not used.
pub(super) async fn window(
    connection: &mut EngineConnection,
    robot_id: i64,
    run_ids: &[i64],
    first_of_epochs: &[i64],
    method: Option<u64>,
) -> sqlx::Result<TestWindow> {
    let inertial = cycle_friction::inertial(&mut *connection).await?;
    let mut judgements = HashMap::new();
    let mut tests = Vec::with_capacity(run_ids.len());
    for (mut test, figures, kept) in stored(&mut *connection, robot_id, run_ids, method).await? {
        let run = &mut test.run;
        let TestFigures { joints, friction, rmsd, parameters } = match figures {
            Some(figures) => figures,
            None => run_summary::of_run(&mut *connection, run.run_id).await?,
        };
        judgements.extend(kept.map(|kept| (run.run_id, kept)));
        (run.cycle_friction, run.whole_cycle_rmsd) = (friction, rmsd);
        run.parameters = inertial.of_run(&parameters);
        test.joints = joints;
        tests.push(test);
    }
    let tests = together(connection, robot_id, tests, first_of_epochs).await?;
    Ok(TestWindow { tests, judgements })
}

/// Tests with their stored results and judgements, as far as these are valid.
async fn stored(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    run_ids: &[i64],
    method: Option<u64>,
) -> sqlx::Result<Vec<(SummarisedTest, Option<TestFigures>, Option<Vec<u8>>)>> {
    sqlx::query(
        "SELECT run.run_id, run.started_at, run.cycles_stored, summary.numbers, summary.judgements,
                EXISTS (SELECT 1 FROM channel_response WHERE channel_response.run_id = run.run_id) AS has_response
         FROM run
         LEFT JOIN run_summary AS summary
                   ON summary.run_id = run.run_id AND summary.revision = run.revision AND summary.method = $3
         WHERE run.run_id IN (SELECT CAST(value AS BIGINT) FROM json_each($2)) AND run.robot_id = $1 AND run.kind = 'test'
               AND run.status = 'complete'
         ORDER BY run.started_at, run.run_id",
    )
    .bind_all((robot_id, json_list(run_ids), method.map(u64::cast_signed)))
    .try_map(|row: EngineRow| {
        let run = RunSummary {
            run_id: row.try_get("run_id")?,
            started_at: time(&row, "started_at")?,
            cycles: size(&row, "cycles_stored")?,
            ..RunSummary::default()
        };
        let test = SummarisedTest { run, joints: Vec::new(), has_response: row.try_get("has_response")? };
        let numbers: Option<&[u8]> = row.try_get("numbers")?;
        let judgements: Option<&[u8]> = row.try_get("judgements")?;
        Ok((test, numbers.and_then(unpacked), judgements.map(<[u8]>::to_vec)))
    })
    .fetch_all(executor)
    .await
}

/// Tests with the values that depend on all of them; `first_of_epochs` are others with which epochs began.
async fn together(
    connection: &mut EngineConnection,
    robot_id: i64,
    tests: Vec<SummarisedTest>,
    first_of_epochs: &[i64],
) -> sqlx::Result<Vec<RunSummary>> {
    let keys: Vec<i64> = tests.iter().map(|test| test.run.run_id).collect();
    let mut refused = refusals(&mut *connection, &keys).await?;
    let known = |row: &&SummaryRow| row.summary.relative_rmsd.is_some();
    let mut latest_first = tests.iter().rev().flat_map(|test| test.joints.iter().rev());
    let latest = latest_first.find(known).and_then(|row| row.estimator.clone());
    let (mut runs, mut with_response) = (Vec::with_capacity(tests.len()), HashSet::new());
    for SummarisedTest { mut run, joints, has_response } in tests {
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

/// Reads the response of the first run with one, among the runs that are compared with each other. Those of the others
/// are equal except for the scatter of the motion; that of the first stays while tests arrive.
async fn read_responses(
    connection: &mut EngineConnection,
    with_response: &HashSet<i64>,
    runs: &mut [RunSummary],
) -> sqlx::Result<()> {
    let mut known: Vec<Vec<u32>> = Vec::new();
    for run in runs.iter_mut().filter(|run| with_response.contains(&run.run_id)) {
        if !known.contains(&run.epochs) {
            run.response = channel_response::of_run(&mut *connection, run.run_id).await?;
            known.push(run.epochs.clone());
        }
    }
    Ok(())
}

/// Refused cycles of the tests of these keys, with the causes of refusal, the cause of most cycles first, by run.
async fn refusals(
    connection: &mut EngineConnection,
    keys: &[i64],
) -> sqlx::Result<HashMap<i64, (u32, Vec<RunRefusal>)>> {
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
    // the sentence of a cause is from the cycle that lists it earliest, and among these from the first cycle
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

fn refusal(row: &EngineRow) -> sqlx::Result<RunRefusal> {
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
