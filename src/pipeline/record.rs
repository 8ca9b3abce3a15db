//! From analyses to the database: one transaction a cycle, one for the end of a run.

use tokio::sync::mpsc;
use tokio::task::JoinHandle;

use super::intake::{Intake, ReadTotals};
use super::{Outcome, Pipeline, PipelineError, StoredRun};
use crate::analysis::CycleAnalysis;
use crate::ingest::rejection::Rejection;
use crate::numerics::analyse::{Method, analyse_run, warm_up_fits};
use crate::numerics::detect::detect;
use crate::store::Store;

/// Records analyses in the order of their cycles. Returns a rejection if an analysis panicked: the
/// run cannot be complete then, and other runs are not touched.
///
/// # Errors
/// Those of the store.
pub async fn cycles(
    store: &Store,
    intake: &Intake,
    mut analyses: mpsc::Receiver<JoinHandle<CycleAnalysis>>,
    recorded: impl Fn(u32),
) -> Result<Option<Rejection>, PipelineError> {
    while let Some(handle) = analyses.recv().await {
        let analysis = match handle.await {
            Ok(analysis) => analysis,
            Err(error) => {
                tracing::error!(file = %intake.path.display(), %error, "an analysis panicked");
                return Ok(Some(Rejection::of_file(
                    &intake.path,
                    format!("internal error while analysing a cycle: {error}"),
                    "report it with this file",
                )));
            }
        };
        for remark in &analysis.remarks {
            tracing::debug!(robot = %intake.header.robot, cycle = analysis.cycle, "{remark}");
        }
        store.record_cycle(intake.run_id, &analysis, &intake.robot).await?;
        recorded(analysis.cycle);
    }
    Ok(None)
}

/// Ends a run: what it says as a whole, what the robot's history says with it, and its mark of
/// completion, in one transaction.
///
/// # Errors
/// Those of the store.
pub async fn finish(
    pipeline: &Pipeline,
    intake: &Intake,
    method: &Method,
    totals: ReadTotals,
) -> Result<Outcome, PipelineError> {
    let mut ending = pipeline.store().begin_finish(intake.run_id).await?;
    let results = ending.run_results().await?;
    let analysis = analyse_run(method.robot.joint_count(), &pipeline.settings(), &results);
    ending.record_run_analysis(&analysis).await?;
    ending.mark_complete(totals.rows).await?;
    let mixed = warm_up_fits(&ending.robot_friction_points().await?);
    ending.replace_mixed_fits(&mixed).await?;
    let history = ending.history().await?;
    let findings = detect(&history, &pipeline.config().detect);
    let new_anomalies = ending.reconcile(&findings).await?;
    let run = ending.commit().await?;
    Ok(Outcome::Stored(StoredRun {
        run_id: intake.run_id,
        robot: intake.header.robot.clone(),
        cycles: run.cycles,
        refused: run.refused,
        rows: totals.rows,
        new_anomalies,
    }))
}

/// Quarantines an export that was let in; whole cycles before the fault stay stored.
///
/// # Errors
/// Those of the store.
pub async fn quarantine(
    pipeline: &Pipeline,
    intake: &Intake,
    rejection: Rejection,
) -> Result<Outcome, PipelineError> {
    let run_id = pipeline
        .store()
        .quarantine(&intake.header, &rejection.sentence(), rejection.line, rejection.column.as_deref())
        .await?;
    let cycles = pipeline.store().lookup(&intake.header.content_hash).await?.map_or(0, |run| run.cycles_stored);
    Ok(Outcome::Quarantined { run_id, rejection, cycles })
}
