//! What follows from a robot's whole history: fits over its runs, its friction map, what production is held
//! against, anomalies and health.
//!
//! Conclusions depend on the set of complete runs alone. They are drawn in a transaction of their own, after
//! one run or after many: a backlog of a thousand exports is not judged a thousand times. The database knows
//! which robots wait for it, so that nothing is forgotten if the program ends in between.

use crate::anomaly::RunSummary;
use crate::numerics::analyse::warm_up_fits;
use crate::numerics::detect::production::detect_production;
use crate::numerics::detect::runs::detect;
use crate::numerics::friction::level_means::nearest_level;
use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::friction::FrictionHistory;
use crate::pipeline::production;
use crate::store::{AnomalyRow, StaleRobot};

/// Of a longer backlog, conclusions are drawn each time this many runs of a robot have ended: the friction index
/// is made for the latest two dozen runs, and no run is to be passed over.
pub const RUNS_AT_ONCE: usize = 12;

/// What the history of a robot says that it did not say before.
#[derive(Debug, Clone, PartialEq)]
pub struct Concluded {
    /// The robot.
    pub robot: String,
    /// Anomalies that became open.
    pub new_anomalies: Vec<AnomalyRow>,
}

impl Pipeline {
    /// Draws conclusions for every robot whose history has changed since the last time, by name.
    ///
    /// # Errors
    /// Those of the store.
    pub async fn conclude(&self) -> Result<Vec<Concluded>, PipelineError> {
        let mut concluded = Vec::new();
        for robot in self.store.stale_robots().await? {
            concluded.push(self.conclude_robot(&robot).await?);
        }
        Ok(concluded)
    }

    /// Draws conclusions for the robot of this name, unless they are as new as its history.
    ///
    /// # Errors
    /// Those of the store.
    pub async fn conclude_named(&self, name: &str) -> Result<Option<Concluded>, PipelineError> {
        let stale = self.store.stale_robots().await?;
        match stale.iter().find(|robot| robot.name == name) {
            Some(robot) => self.conclude_robot(robot).await.map(Some),
            None => Ok(None),
        }
    }

    async fn conclude_robot(&self, robot: &StaleRobot) -> Result<Concluded, PipelineError> {
        // of two at once, the one that has read less must not be the later to write
        let _turn = self.concluding.lock().await;
        // no conclusion compares figures of two estimators
        let history = match self.reweight_robot(robot.robot_id).await? {
            true => self.store.conclude(robot.robot_id).await?.history().await?,
            false => robot.history,
        };
        let summaries = self.store.run_summaries(robot.robot_id).await?;
        let level = reference_level(&summaries, self.config.analysis.reference_speed_fraction);
        let points = self.store.friction_history(robot.robot_id, level).await?;
        let runs = self.store.friction_runs(robot.robot_id).await?;
        let baseline_runs = self.config.detect.baseline_runs;
        let (mixed, friction) = tokio::task::spawn_blocking(move || {
            (warm_up_fits(&points), FrictionHistory::of_runs(runs, baseline_runs))
        })
        .await?;
        for remark in &friction.found.remarks {
            tracing::debug!(robot = robot.name, "{remark}");
        }
        let settled = production::settle(&self.store, robot.robot_id, self.config.analysis.estimator).await?;
        let mut conclusion = self.store.conclude(robot.robot_id).await?;
        // a test that has changed meanwhile gave parameters that nobody stores any more
        if conclusion.history().await? == history {
            for (run_id, checks) in &settled {
                conclusion.settle_production(*run_id, checks).await?;
            }
        }
        conclusion.replace_mixed_fits(&mixed).await?;
        conclusion.replace_friction_maps(&friction.run_ids, &friction.found).await?;
        // detectors watch the index that was stored just now
        let mut findings = detect(&conclusion.run_summaries().await?, &self.config.detect);
        findings.anomalies.extend(detect_production(&conclusion.production_summaries().await?));
        let reconciled = conclusion.reconcile(&findings).await?;
        conclusion.commit(history).await?;
        let new_anomalies = self.opened(&reconciled.opened).await?;
        Ok(Concluded { robot: robot.name.clone(), new_anomalies })
    }

    async fn opened(&self, ids: &[i64]) -> Result<Vec<AnomalyRow>, PipelineError> {
        if ids.is_empty() {
            return Ok(Vec::new());
        }
        let before = ids.iter().min().map_or(0, |first| first - 1);
        let rows = self.store.anomalies_after(before).await?;
        Ok(rows.into_iter().filter(|row| ids.contains(&row.anomaly_id)).collect())
    }
}

/// The speed level that the latest run's warm friction was taken at, the reference itself without one.
fn reference_level(summaries: &[RunSummary], reference: f64) -> f64 {
    let latest = summaries.iter().rev().find_map(|run| {
        let levels =
            run.joints.iter().filter_map(|joint| joint.warm_friction).map(|warm| warm.speed_fraction);
        nearest_level(levels, reference)
    });
    latest.unwrap_or(reference)
}
