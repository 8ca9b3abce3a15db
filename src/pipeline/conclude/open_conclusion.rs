//! Conclusions on a test that is still being written.
//!
//! They are drawn after each stored cycle, in comparison with the robot's complete tests. They are stored in a separate
//! transaction after that of the cycle. Nothing is lost if the program ends in between: they depend on stored cycles
//! alone, and are drawn again with the next cycle, when the file is opened again, or with the whole test. The complete
//! tests are read once per test that is written; each cycle reads its own values only.

use std::sync::{Arc, PoisonError};
use std::time::Instant;

use tokio::task::JoinError;

use super::history::Concluded;
use super::isolation::panic_reason;
use super::method::METHOD;
use crate::pipeline::context::{Pipeline, PipelineError, RobotBaseline};
use armwatch_method::detect::runs::open_run::{UsualTests, detect_open};
use armwatch_method::partial_run::first_cycles;
use armwatch_model::analysis::measurements::RunMeasurements;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::{Anomaly, RunSummary};
use armwatch_store::{AttemptKind, OpenTest};

/// Robots whose complete tests are cached for a test that is being written, a megabyte each at most.
const MOST_KEPT: usize = 16;

/// The result of evaluating a test that is still being written.
#[derive(Debug, Clone, PartialEq)]
pub enum OpenConclusion {
    /// Anomalies have changed.
    Drawn(Concluded),
    /// There is nothing new, or the test is complete.
    Quiet,
    /// Conclusions from the complete tests come first.
    Waits,
}

impl Pipeline {
    /// Evaluates a test that is still being written, from its stored cycles.
    ///
    /// # Errors
    /// Those of the store, and panics as [`PipelineError::Task`].
    pub async fn conclude_open(&self, run_id: i64) -> Result<OpenConclusion, PipelineError> {
        let _turn = self.concluding.lock().await;
        let begun = Instant::now();
        let Some(test) = self.store.open_test(run_id).await? else { return Ok(OpenConclusion::Quiet) };
        // a slowly copied old recording contains no news of the present
        if test.cycles == 0 || !test.is_latest {
            return Ok(OpenConclusion::Quiet);
        }
        if !test.is_concluded {
            return Ok(OpenConclusion::Waits);
        }
        let subject = format!("run {run_id}");
        if self.begin_conclusion(&subject).await?.is_spent() {
            tracing::debug!(
                run_id,
                "not evaluated while it is written: this has ended the program three times"
            );
            return Ok(OpenConclusion::Quiet);
        }
        let judged = self.judge_open(test, begun).await;
        self.store.end_attempt(AttemptKind::Conclusion, &subject).await?;
        judged
    }

    /// Evaluates a test that is the latest of its robot.
    async fn judge_open(&self, test: OpenTest, begun: Instant) -> Result<OpenConclusion, PipelineError> {
        let run_id = test.run_id;
        let usual = self.usual_of(&test).await?;
        let measured = self.store.run_measurements(run_id).await?;
        let (judged, settings) = (test.clone(), self.config.detect);
        let findings = tokio::task::spawn_blocking(move || judge(&judged, &usual, &measured, &settings));
        let findings = findings.await?;
        let took_ms = begun.elapsed().as_secs_f64() * 1e3;
        tracing::debug!(
            robot = test.robot,
            run_id,
            cycles = test.cycles,
            found = findings.len(),
            took_ms,
            "judged"
        );
        if findings.is_empty() {
            return Ok(OpenConclusion::Quiet);
        }
        let mut conclusion = self.store.conclude(test.robot_id).await?;
        if conclusion.history().await? != test.history {
            return Ok(OpenConclusion::Waits);
        }
        let Some(reconciled) = conclusion.reconcile_open(&test, &findings).await? else {
            return Ok(OpenConclusion::Quiet);
        };
        conclusion.commit(test.history).await?;
        if reconciled.events.is_empty() {
            return Ok(OpenConclusion::Quiet);
        }
        let events = self.store.anomaly_events(&reconciled.events).await?;
        let new_anomalies = self.opened(&reconciled.opened()).await?;
        Ok(OpenConclusion::Drawn(Concluded { robot: test.robot, new_anomalies, events }))
    }

    /// Like [`Pipeline::conclude_open`], but a panic is logged and affects this test alone, which is evaluated as a
    /// whole when it is complete.
    pub async fn conclude_open_isolated(&self, run_id: i64) -> Result<OpenConclusion, PipelineError> {
        let pipeline = self.clone();
        let reason = |error: JoinError| {
            let reason = panic_reason(error)?;
            tracing::error!(run_id, "not evaluated while it is written: {reason}; report it with the log");
            Ok(OpenConclusion::Quiet)
        };
        match tokio::spawn(async move { pipeline.conclude_open(run_id).await }).await {
            Ok(Err(PipelineError::Task(error))) | Err(error) => reason(error),
            Ok(done) => done,
        }
    }

    async fn usual_of(&self, test: &OpenTest) -> Result<Arc<RobotBaseline>, PipelineError> {
        let settings = self.config.detect;
        let known = self.usual.lock().unwrap_or_else(PoisonError::into_inner).get(&test.robot_id).cloned();
        let holds = |of: &Arc<RobotBaseline>| {
            (of.run_id, of.history, of.settings) == (test.run_id, test.history, settings)
        };
        if let Some(usual) = known.filter(holds) {
            return Ok(usual);
        }
        let history = self.store.latest_window(test.robot_id, METHOD).await?;
        let joints = history.iter().map(|run| run.joints.len()).max().unwrap_or(0);
        let of_open = self.store.run_measurements(test.run_id).await?;
        let of_open = first_cycles(&RunSummary::default(), &of_open, test.cycles).joints.len();
        let joints = joints.max(of_open);
        let epochs = self.store.open_test_epochs(test, joints).await?;
        let (tests, history, epochs) = tokio::task::spawn_blocking(move || {
            (UsualTests::new(&history, joints, &epochs, &settings), history, epochs)
        })
        .await?;
        let mut first = Vec::new();
        for run in history.into_iter().filter(|run| tests.arm_run_ids().contains(&run.run_id)) {
            let measured = self.store.run_measurements(run.run_id).await?;
            first.push((run, measured));
        }
        let (run_id, history) = (test.run_id, test.history);
        let usual = Arc::new(RobotBaseline { run_id, history, settings, epochs, tests, first });
        let mut kept = self.usual.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.len() >= MOST_KEPT {
            kept.clear();
        }
        kept.insert(test.robot_id, Arc::clone(&usual));
        Ok(usual)
    }
}

fn judge(
    test: &OpenTest,
    usual: &RobotBaseline,
    measured: &RunMeasurements,
    settings: &DetectSettings,
) -> Vec<Anomaly> {
    let first: Vec<RunSummary> =
        usual.first.iter().map(|(run, measured)| first_cycles(run, measured, test.cycles)).collect();
    let open = RunSummary {
        run_id: test.run_id,
        started_at: test.started_at,
        epochs: usual.epochs.clone(),
        ..RunSummary::default()
    };
    detect_open(&usual.tests, &first, &first_cycles(&open, measured, test.cycles), settings)
}
