//! Results of runs, and overdue tests.

use jiff::Timestamp;
use sqlx::Row;

use super::anomalies::as_text;
use crate::engine::{Bind, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::size;

/// Outcome of a complete run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunResult {
    /// True if it gives no result for the arm.
    pub without_result: bool,
    /// Cycles stored.
    pub cycles: u32,
    /// Cycles that were refused.
    pub refused: u32,
    /// Reason for the first refusal.
    pub reason: Option<String>,
}

/// A robot whose next test did not arrive in time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OverdueRobot {
    /// Its name.
    pub robot: String,
    /// Latest time for the next test to begin, as in the views.
    pub expected_by: String,
}

impl Store {
    /// Outcome of run `run_id`; `None` if it is not complete.
    pub async fn run_result(&self, run_id: i64) -> Result<Option<RunResult>, StoreError> {
        let found = sqlx::query(
            "SELECT cycles_stored,
                    (SELECT count(*) FROM cycle WHERE cycle.run_id = run.run_id AND status = 'refused') AS refused,
                    (SELECT reason FROM cycle WHERE cycle.run_id = run.run_id AND status = 'refused'
                     ORDER BY number LIMIT 1) AS reason,
                    CASE kind
                        WHEN 'test' THEN NOT EXISTS (
                            SELECT 1 FROM run_joint_summary AS summary
                            WHERE summary.run_id = run.run_id
                                  AND coalesce(summary.warm_friction_nm, summary.excitation_friction_nm,
                                           summary.relative_rmsd) IS NOT NULL)
                            -- numbers that are doubted are a result, from which nothing is concluded
                            AND NOT EXISTS (
                                SELECT 1 FROM cycle WHERE cycle.run_id = run.run_id AND cycle.doubtful)
                        ELSE cycles_stored > 0 AND cycles_stored = (
                            SELECT count(*) FROM cycle WHERE cycle.run_id = run.run_id AND status = 'refused')
                    END AS without_result
             FROM run
             WHERE run_id = $1 AND status = 'complete'",
        )
        .bind(run_id)
        .try_map(|row: EngineRow| {
            Ok(RunResult {
                without_result: row.try_get("without_result")?,
                cycles: size(&row, "cycles_stored")?,
                refused: size(&row, "refused")?,
                reason: row.try_get("reason")?,
            })
        })
        .fetch_optional(&self.readers)
        .await;
        self.checked(found)
    }

    /// Stores that a test of this robot arrived in time, seen from `now`: from then on the robot can become overdue. A
    /// test older than the robot's usual interval is a copy of old files and does not count.
    pub async fn watch_for_tests(&self, robot: &str, now: Timestamp) -> Result<(), StoreError> {
        let mut transaction = self.begin().await?;
        let done = sqlx::query(
            "UPDATE robot SET watched = TRUE WHERE name = $1 AND NOT watched AND expected_by >= $2",
        )
        .bind_all((robot, as_text(now)))
        .execute(&mut *transaction)
        .await;
        self.checked(done)?;
        self.commit(transaction).await
    }

    /// Marks robots as overdue whose next test should have begun before `now`. Returns the newly marked ones, by name.
    pub async fn mark_overdue(&self, now: Timestamp) -> Result<Vec<OverdueRobot>, StoreError> {
        let due: sqlx::Result<Vec<(i64, String, String)>> = sqlx::query_as(
            "SELECT robot_id, name, expected_by FROM robot
             WHERE watched AND NOT overdue AND expected_by < $1
             ORDER BY name",
        )
        .bind(as_text(now))
        .fetch_all(&self.readers)
        .await;
        let mut marked = Vec::new();
        for (robot_id, robot, expected_by) in self.checked(due)? {
            // a test may have arrived, or another daemon marked the robot
            let mut transaction = self.begin().await?;
            let done = sqlx::query(
                "UPDATE robot SET overdue = TRUE WHERE robot_id = $1 AND expected_by = $2 AND NOT overdue",
            )
            .bind_all((robot_id, &expected_by))
            .execute(&mut *transaction)
            .await;
            let is_marked = self.checked(done)?.rows_affected() > 0;
            self.commit(transaction).await?;
            if is_marked {
                marked.push(OverdueRobot { robot, expected_by });
            }
        }
        Ok(marked)
    }
}
