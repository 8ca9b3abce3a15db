//! Robots of one model: their first tests, and the robots that need another comparison.

use sqlx::Row;

use super::conclude::ConclusionTransaction;
use super::figures::joint_summary::{self, summary_columns};
use crate::engine::{Bind, EngineConnection, EngineExecutor, EngineRow, row_of};
use crate::error::StoreError;
use crate::handle::Store;
use armwatch_model::analysis::JointSummary;
use armwatch_model::anomaly::peer::{MOST_PEERS, Peer};

/// Largest fleet of a model whose new arms are each compared at once with all others. In larger fleets the comparison
/// is repeated when their number has doubled, so that a fleet of hundreds is not evaluated hundreds of times.
const COMPARED_AT_ONCE: i64 = 8;

impl Store {
    /// The first `tests` complete tests of each other robot whose latest test is of the same model, for robots with
    /// that many, by name; at most [`MOST_PEERS`].
    pub async fn peers(&self, robot_id: i64, tests: usize) -> Result<Vec<Peer>, StoreError> {
        let mut connection = self.checked(self.readers.acquire().await)?;
        self.checked(peers(&mut connection, robot_id, tests).await)
    }
}

impl ConclusionTransaction {
    /// Stores the number of others that the robot was compared with, and makes robots of its model stale that could be
    /// compared with more than they were. `tests` is the number of tests that a robot needs for the comparison.
    pub async fn compared_with(&mut self, peers: usize, tests: usize) -> Result<(), StoreError> {
        let result = compared_with(&mut self.transaction, self.robot_id, peers, tests).await;
        self.checked(result)
    }
}

/// A robot of a model.
#[derive(Debug, Clone, PartialEq, Eq)]
struct PeerRobot {
    robot_id: i64,
    name: String,
    peers_compared: i64,
    /// Complete tests, counted up to the needed number.
    tests: i64,
}

row_of!(PeerRobot { robot_id, name, peers_compared, tests });

/// All robots of the model of a robot's latest test, by name.
async fn members(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    tests: usize,
) -> sqlx::Result<Vec<PeerRobot>> {
    sqlx::query_as(
        "WITH latest AS (
             SELECT robot_id, name, peers_compared,
                    (SELECT model FROM run
                     WHERE run.robot_id = robot.robot_id AND status = 'complete' AND kind = 'test'
                     ORDER BY started_at DESC, run_id DESC LIMIT 1) AS model
             FROM robot
         )
         SELECT latest.robot_id, latest.name, latest.peers_compared,
                (SELECT count(*) FROM (
                     SELECT 1 FROM run
                     WHERE run.robot_id = latest.robot_id AND status = 'complete' AND kind = 'test'
                     LIMIT $2) AS first) AS tests
         FROM latest
         JOIN latest AS own ON own.robot_id = $1 AND own.model = latest.model
         ORDER BY latest.name",
    )
    .bind_all((robot_id, i64::try_from(tests).unwrap_or(i64::MAX)))
    .fetch_all(executor)
    .await
}

async fn peers(connection: &mut EngineConnection, robot_id: i64, tests: usize) -> sqlx::Result<Vec<Peer>> {
    let members = members(&mut *connection, robot_id, tests).await?;
    let needed = i64::try_from(tests).unwrap_or(i64::MAX);
    let others = members.into_iter().filter(|of| of.robot_id != robot_id && of.tests >= needed);
    let mut found = Vec::new();
    for PeerRobot { robot_id, name, .. } in others.take(MOST_PEERS) {
        found.push(Peer { robot: name, tests: first_tests(&mut *connection, robot_id, needed).await? });
    }
    Ok(found)
}

async fn first_tests(
    executor: impl EngineExecutor<'_>,
    robot_id: i64,
    tests: i64,
) -> sqlx::Result<Vec<Vec<JointSummary>>> {
    let rows = sqlx::query(concat!(
        "SELECT early.run_id, ",
        summary_columns!(),
        ", NULL AS friction_index, NULL AS friction_index_std_error
         FROM (SELECT run_id, started_at FROM run
               WHERE robot_id = $1 AND status = 'complete' AND kind = 'test'
               ORDER BY started_at, run_id LIMIT $2) AS early
         JOIN run_joint_summary AS summary USING (run_id)
         ORDER BY early.started_at, early.run_id, summary.joint",
    ))
    .bind_all((robot_id, tests))
    .try_map(|row: EngineRow| Ok((row.try_get::<i64, _>("run_id")?, joint_summary::of_row(&row)?)))
    .fetch_all(executor)
    .await?;
    Ok(rows.chunk_by(|a, b| a.0 == b.0).map(|test| test.iter().map(|(_, of)| *of).collect()).collect())
}

async fn compared_with(
    connection: &mut EngineConnection,
    robot_id: i64,
    peers: usize,
    tests: usize,
) -> sqlx::Result<()> {
    sqlx::query("UPDATE robot SET peers_compared = $1 WHERE robot_id = $2")
        .bind_all((i64::try_from(peers).unwrap_or(i64::MAX), robot_id))
        .execute(&mut *connection)
        .await?;
    let members = members(&mut *connection, robot_id, tests).await?;
    let needed = i64::try_from(tests).unwrap_or(i64::MAX);
    let with_baseline = members.iter().filter(|of| of.tests >= needed).count();
    for of in members.iter().filter(|of| of.robot_id != robot_id) {
        let others = with_baseline - usize::from(of.tests >= needed);
        let others = i64::try_from(others.min(MOST_PEERS)).unwrap_or(i64::MAX);
        let is_due = others > of.peers_compared
            && (others <= COMPARED_AT_ONCE || others >= 2 * of.peers_compared || others == MOST_PEERS as i64);
        if is_due {
            // stored at the same time, so that no other robot makes it stale again before its conclusion
            sqlx::query("UPDATE robot SET history = history + 1, peers_compared = $1 WHERE robot_id = $2")
                .bind_all((others, of.robot_id))
                .execute(&mut *connection)
                .await?;
        }
    }
    Ok(())
}
