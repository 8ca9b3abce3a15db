//! Conclusions from a robot's whole history: fits over its runs, its friction map, the reference of its production,
//! anomalies and health.
//!
//! Conclusions are drawn after one run or after many, so that a backlog of a thousand exports does not need a thousand
//! conclusions. The database knows which robots wait for conclusions, so that none is forgotten if the program ends in
//! between.
//!
//! Reading and computing need no lock. They take two steps with a short transaction each: first the values that
//! detectors compare (indices, checks of production), then the findings. Each transaction verifies that the history is
//! still the one that was read. If it is not, the history is read again, so that no older reading is stored over a
//! newer one. If another program has stored the same conclusions, nothing is written. Events of anomalies are therefore
//! stored once.

use std::collections::HashSet;

use super::method::{INDEX_METHOD, METHOD};
use super::windows::{judge_logs, judge_tests};
use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::friction::friction_conclusion;
use crate::pipeline::production;
use armwatch_method::analyse_run::warm_up_fits_on;
use armwatch_method::detect::window::Lengths;
use armwatch_method::friction::points::level_means::nearest_level;
use armwatch_model::anomaly::{JointHealth, Knowledge};
use armwatch_store::{AnomalyHistoryRow, AnomalyRow, StaleRobot};

/// In a longer backlog, conclusions are drawn each time this many runs of a robot have ended, so that the wait for them
/// stays short.
pub const RUNS_AT_ONCE: usize = 12;

/// Most readings of a history that changes during the computation. A run takes minutes and conclusions take seconds, so
/// that two changes in a row are rare; after this many readings the robot stays stale.
const MOST_READINGS: usize = 4;

/// New conclusions from a robot's history.
#[derive(Debug, Clone, PartialEq)]
pub struct Concluded {
    /// The robot.
    pub robot: String,
    /// Anomalies that became open.
    pub new_anomalies: Vec<AnomalyRow>,
    /// All that happened to anomalies, in order.
    pub events: Vec<AnomalyHistoryRow>,
}

impl Pipeline {
    /// Draws conclusions for every robot whose history has changed since the last time, by name.
    pub async fn conclude(&self) -> Result<Vec<Concluded>, PipelineError> {
        let mut concluded = Vec::new();
        // conclusions of one robot may change those of others of its model, but the latter change no others
        for _ in 0..2 {
            for robot in self.store.stale_robots().await? {
                concluded.extend(self.conclude_robot(&robot).await?);
            }
        }
        Ok(concluded)
    }

    /// Draws conclusions for the robot of this name, unless they are as new as its history.
    pub async fn conclude_named(&self, name: &str) -> Result<Option<Concluded>, PipelineError> {
        let stale = self.store.stale_robots().await?;
        match stale.iter().find(|robot| robot.name == name) {
            Some(robot) => self.conclude_robot(robot).await,
            None => Ok(None),
        }
    }

    /// Returns `None` if another program has drawn the same conclusions in the meantime.
    async fn conclude_robot(&self, robot: &StaleRobot) -> Result<Option<Concluded>, PipelineError> {
        // of two concurrent writers, the one that has read less must not write last
        let _turn = self.concluding.lock().await;
        let mut history = robot.history;
        for _ in 1..MOST_READINGS {
            match self.conclude_from(robot, history, false).await? {
                HistoryOutcome::Done(concluded) => return Ok(concluded),
                HistoryOutcome::Overtaken(now) => history = now,
            }
        }
        match self.conclude_from(robot, history, true).await? {
            HistoryOutcome::Done(concluded) => Ok(concluded),
            HistoryOutcome::Overtaken(_) => Ok(None),
        }
    }

    /// Draws conclusions from the history at change count `history`. If a run of the robot ended during the
    /// computation, in this program or another one, they are stored only if `in_any_case`; the robot stays stale then.
    async fn conclude_from(
        &self,
        robot: &StaleRobot,
        history: i64,
        in_any_case: bool,
    ) -> Result<HistoryOutcome, PipelineError> {
        let dates = self.judge_dates(robot).await?;
        if dates.changes_history && !in_any_case {
            let now = self.store.conclude(robot.robot_id).await?.history().await?;
            return Ok(HistoryOutcome::Overtaken(now));
        }
        let needs_all = in_any_case || !dates.by_arrival().is_empty();
        // no conclusion compares figures of two estimators
        let history = match self.reweight_robot(robot.robot_id).await? {
            true => self.store.conclude(robot.robot_id).await?.history().await?,
            false => history,
        };
        let levels = self.store.latest_warm_levels(robot.robot_id).await?;
        let reference = self.config.analysis.reference_speed_fraction;
        // the level of the latest friction index, or the reference speed without one
        let level = nearest_level(levels.into_iter(), reference).unwrap_or(reference);
        let over_tests = self.store.friction_history(robot.robot_id, level, METHOD).await?;
        let points = over_tests.points();
        let spare = self.spare_threads();
        let mixed = tokio::task::spawn_blocking(move || warm_up_fits_on(&spare, &points)).await?;
        let baseline_runs = self.config.detect.baseline_runs;
        let (friction, plan) =
            friction_conclusion(&self.store, robot.robot_id, baseline_runs, needs_all).await?;
        for remark in &friction.remarks {
            tracing::debug!(robot = robot.name, "{remark}");
        }
        let peers = self.store.peers(robot.robot_id, baseline_runs).await?;
        let settled = production::settle(&self.store, robot.robot_id, self.config.analysis.estimator).await?;
        let mut figures = self.store.conclude(robot.robot_id).await?;
        let now = figures.history().await?;
        if now == history && figures.is_concluded().await? {
            return Ok(HistoryOutcome::Done(None));
        }
        if now != history && !in_any_case {
            return Ok(HistoryOutcome::Overtaken(now));
        }
        // a test that has changed in the meantime gave parameters that are no longer stored
        if now == history {
            for (run_id, checks) in &settled {
                figures.settle_production(*run_id, checks).await?;
            }
            figures.summarise_settled_logs().await?;
            figures.keep_friction_points(&over_tests, METHOD).await?;
        }
        figures.replace_mixed_fits(&mixed).await?;
        let replaced = figures.replace_friction(&friction).await?;
        if let Some(plan) = plan.filter(|_| now == history) {
            figures.keep_friction_plan(&plan, baseline_runs, INDEX_METHOD).await?;
        }
        figures.commit_figures().await?;
        for of in &replaced {
            tracing::info!(
                robot = robot.name,
                joint = %of.joint,
                epoch = of.epoch,
                "the friction baseline is formed recomputed: {} (view baseline_changes)",
                of.because
            );
        }
        // a test completed in the meantime has no index yet
        let known: HashSet<i64> = friction.run_ids.iter().copied().collect();
        let (in_order, settings) = (&known - dates.by_arrival(), &self.config.detect);
        let judge = async |known: Option<&HashSet<i64>>| {
            judge_tests(&self.store, robot.robot_id, known, &peers, settings, &Lengths::OF_TESTS).await
        };
        let tests = judge(needs_all.then_some(&in_order)).await?;
        let by_arrival = match dates.by_arrival().is_empty() {
            true => Vec::new(),
            false => {
                let with = judge(in_any_case.then_some(&known)).await?.findings.anomalies;
                dates.shown_by_arrival(with, &tests.findings.anomalies)
            }
        };
        let logs = judge_logs(&self.store, robot.robot_id, settings, &Lengths::OF_LOGS).await?;
        tracing::debug!(
            robot = robot.name,
            tests = tests.runs,
            recomputed = tests.recomputed,
            logs = logs.runs,
            settled = tests.settled.len() + logs.settled.len(),
            computing_ms = (tests.computing + logs.computing).as_secs_f64() * 1e3,
            "judged"
        );
        let mut findings = tests.findings;
        findings.anomalies.extend(by_arrival);
        findings.anomalies.extend(logs.findings.anomalies);
        findings.anomalies.extend(dates.anomaly());
        self.measure_loads(&robot.name, &mut findings.anomalies).await?;
        let unrecorded = |of: &&mut JointHealth| {
            of.last_result_run_id.is_none() && !self.config.has_torque(&robot.name, of.joint)
        };
        for health in findings.health.iter_mut().filter(unrecorded) {
            health.knowledge = Knowledge::Unsettled;
            health.reason =
                Some("its torque is not recorded: torque.not_recorded of the layout names it".into());
        }
        let mut conclusion = self.store.conclude(robot.robot_id).await?;
        let now = conclusion.history().await?;
        if now == history && conclusion.is_concluded().await? {
            return Ok(HistoryOutcome::Done(None));
        }
        if now != history && !in_any_case {
            return Ok(HistoryOutcome::Overtaken(now));
        }
        let reconciled = conclusion.reconcile(&findings, &[tests.settled, logs.settled].concat()).await?;
        conclusion.compared_with(peers.len(), baseline_runs).await?;
        conclusion.commit(history).await?;
        let events = self.store.anomaly_events(&reconciled.events).await?;
        let new_anomalies = self.opened(&reconciled.opened()).await?;
        Ok(HistoryOutcome::Done(Some(Concluded { robot: robot.name.clone(), new_anomalies, events })))
    }

    pub(super) async fn opened(&self, ids: &[i64]) -> Result<Vec<AnomalyRow>, PipelineError> {
        let Some(first) = ids.iter().min() else { return Ok(Vec::new()) };
        let rows = self.store.anomalies_after(first - 1).await?;
        Ok(rows.into_iter().filter(|row| ids.contains(&row.anomaly_id)).collect())
    }
}

/// The result of reading a history and drawing conclusions from it.
enum HistoryOutcome {
    /// Conclusions are stored, by this program or by another one that reports them.
    Done(Option<Concluded>),
    /// The history has changed in the meantime; the total number of its changes.
    Overtaken(i64),
}
