//! Lists that people request by name: robots, runs, cycles.

use super::handle::Store;
use super::table::{AskError, ResultTable};
use super::views::HealthStatus;
use crate::engine::Bind;

/// Selection of runs, or of cycles of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ListFilter<'a> {
    /// Only of this robot.
    pub robot: Option<&'a str>,
    /// Only of this run.
    pub run_id: Option<i64>,
    /// Only with this status.
    pub status: Option<&'a str>,
    /// Only runs of this kind: `test` or `production`.
    pub kind: Option<&'a str>,
    /// Number of entries, newest first.
    pub most: u32,
}

/// Anomalies that are not settled. The states are listed, so that settled ones are not read: index `anomaly_by_state`.
pub(super) const UNSETTLED: &str = "SELECT * FROM anomalies
     WHERE state IN ('open', 'acknowledged', 'shelved', 'maintenance')
     LIMIT $1";

impl Store {
    /// Robots by name, with the number of their tests, the times and the status.
    pub async fn robot_list(&self) -> Result<ResultTable, AskError> {
        let place =
            |(place, status): (usize, &HealthStatus)| format!(" WHEN '{}' THEN {place}", status.name());
        let name =
            |(place, status): (usize, &HealthStatus)| format!(" WHEN {place} THEN '{}'", status.name());
        let all = || HealthStatus::WORST_FIRST.iter().enumerate();
        let (places, names) = (all().map(place).collect::<String>(), all().map(name).collect::<String>());
        let unknown = HealthStatus::Unknown.name();
        let statement = format!(
            "WITH
                 of_runs AS (
                     SELECT robot, count(CASE WHEN kind = 'test' AND status = 'complete' THEN 1 END) AS tests,
                            count(CASE WHEN kind = 'production' AND status = 'complete' THEN 1 END) AS logs,
                            CAST(sum(CASE WHEN status = 'complete' THEN cycles ELSE 0 END) AS BIGINT) AS cycles,
                            min(CASE WHEN kind = 'test' AND status = 'complete' THEN started_at END) AS first_test_at,
                            max(CASE WHEN kind = 'test' AND status = 'complete' THEN started_at END) AS last_test_at
                     FROM runs GROUP BY robot
                 ),
                 of_joints AS (
                     SELECT robot, count(*) AS joints, max(last_result_at) AS last_result_at,
                            min(CASE status {places} END) AS worst
                     FROM fleet_health GROUP BY robot
                 )
             SELECT robot,
                    CASE worst {names} ELSE '{unknown}' END AS status,
                    (SELECT latest.model FROM runs AS latest
                     WHERE latest.robot = of_runs.robot AND latest.status IN ('complete', 'streaming')
                     ORDER BY latest.started_at DESC LIMIT 1) AS model,
                    joints, tests, logs, cycles, first_test_at, last_test_at, last_result_at,
                    (SELECT count(*) FROM anomalies
                     WHERE anomalies.robot = of_runs.robot AND anomalies.state = 'open') AS open_anomalies
             FROM of_runs LEFT JOIN of_joints USING (robot)
             WHERE tests + logs > 0 OR EXISTS (
                 SELECT 1 FROM runs WHERE runs.robot = of_runs.robot AND runs.status = 'streaming')
             ORDER BY robot"
        );
        self.answer(&statement, |query| query).await
    }

    /// Anomalies that are not settled, at most `most`: rows of the view `anomalies`, in no order.
    pub async fn unsettled_anomalies(&self, most: u32) -> Result<ResultTable, AskError> {
        self.answer(UNSETTLED, |query| query.bind(most)).await
    }

    /// The latest `most` friction indices of each joint, by robot and joint, the oldest first.
    pub async fn recent_indices(&self, most: u32) -> Result<ResultTable, AskError> {
        self.answer(
            "SELECT robot, joint, friction_index
             FROM (SELECT robot, joint, friction_index, started_at, run_id,
                          row_number() OVER (PARTITION BY robot, joint ORDER BY started_at DESC, run_id DESC) AS place
                   FROM friction_index) AS numbered
             WHERE place <= $1
             ORDER BY robot, joint, started_at, run_id",
            |query| query.bind(most),
        )
        .await
    }

    /// Runs, the newest first.
    pub async fn run_list(&self, wanted: &ListFilter<'_>) -> Result<ResultTable, AskError> {
        self.answer(
            "SELECT run_id, robot, started_at, kind, status, cycles, rows, source_name, reason
             FROM runs
             WHERE ($1 IS NULL OR robot = $1) AND ($2 IS NULL OR run_id = $2) AND ($3 IS NULL OR status = $3)
                   AND ($4 IS NULL OR kind = $4)
             ORDER BY started_at DESC, run_id DESC
             LIMIT $5",
            |query| {
                query
                    .bind_all((wanted.robot.map(str::to_owned), wanted.run_id))
                    .bind_all((wanted.status.map(str::to_owned), wanted.kind.map(str::to_owned)))
                    .bind(wanted.most)
            },
        )
        .await
    }

    /// Cycles, the newest first.
    pub async fn cycle_list(&self, wanted: &ListFilter<'_>) -> Result<ResultTable, AskError> {
        self.answer(
            "SELECT run_id, robot, cycle, started_at, duration_s, rows, status, condition_number, residual_std_nm, reason
             FROM cycles
             WHERE ($1 IS NULL OR robot = $1) AND ($2 IS NULL OR run_id = $2) AND ($3 IS NULL OR status = $3)
             ORDER BY started_at DESC, run_id DESC, cycle DESC
             LIMIT $4",
            |query| {
                query
                    .bind_all((wanted.robot.map(str::to_owned), wanted.run_id))
                    .bind_all((wanted.status.map(str::to_owned), wanted.most))
            },
        )
        .await
    }
}
