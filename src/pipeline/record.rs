//! From analyses to the database: one transaction a cycle, one for the end of a run.

use tokio::sync::mpsc;

use super::cutting::ReadTotals;
use super::intake::Intake;
use super::{InAnalysis, Outcome, Pipeline, PipelineError, StoredRun, friction};
use crate::analysis::{FrictionPoint, RunAnalysis, WarmUpFit};
use crate::ingest::rejection::Rejection;
use crate::numerics::analyse::{AnalysisSettings, Method, RunResults, analyse_run, warm_up_fits};
use crate::numerics::detect::detect;
use crate::robot::{JointIndex, ParameterId};
use crate::store::{AnomalyRow, Owner, RunMeasurements, RunTotals, Store};

/// Up to this many runs of a robot, the fits over all its runs are renewed with every run; later,
/// each time the history has grown by this fraction. Renewing them always would make the work of a
/// long history grow with its square.
const MIXED_FITS_EVERY_RUN_UP_TO: usize = 20;

/// What recording the cycles of an export came to.
#[derive(Debug, Default)]
pub struct Recorded {
    /// Cycles without parameters, each with its reason.
    pub refused: Vec<(u32, String)>,
    /// Why the run cannot be complete, if an analysis panicked.
    pub rejection: Option<Rejection>,
}

/// Records analyses in the order of their cycles.
///
/// # Errors
/// Those of the store. A panic of an analysis is a rejection of this run; other runs go on.
pub(super) async fn cycles(
    store: &Store,
    intake: &Intake,
    mut analyses: mpsc::Receiver<InAnalysis>,
    stored: impl Fn(u32),
) -> Result<Recorded, PipelineError> {
    let mut recorded = Recorded::default();
    while let Some((handle, read)) = analyses.recv().await {
        let analysis = match handle.await {
            Ok(analysis) => analysis,
            Err(error) => {
                tracing::error!(file = %intake.path.display(), %error, "an analysis panicked");
                let reason = format!("internal error while analysing a cycle: {error}");
                recorded.rejection =
                    Some(Rejection::of_file(&intake.path, reason, "report it with this file"));
                return Ok(recorded);
            }
        };
        for remark in &analysis.remarks {
            tracing::debug!(robot = %intake.header.robot, cycle = analysis.cycle, "{remark}");
        }
        store.record_cycle_read(intake.run_id, &analysis, &intake.robot, Some(&read)).await?;
        stored(analysis.cycle);
        if let Err(reason) = analysis.identification {
            recorded.refused.push((analysis.cycle, reason));
        }
    }
    Ok(recorded)
}

/// Ends a run: what it says as a whole, what the robot's history says with it, and its mark of
/// completion, in one transaction. Where another run was completed with the same content meanwhile,
/// this one goes.
///
/// # Errors
/// Those of the store.
pub async fn finish(
    pipeline: &Pipeline,
    intake: &Intake,
    method: &Method,
    totals: ReadTotals,
    refused: Vec<(u32, String)>,
) -> Result<Outcome, PipelineError> {
    let _turn = pipeline.ending.lock().await;
    let measurements = pipeline.store().run_measurements(intake.run_id).await?;
    let baseline_runs = pipeline.config().detect.baseline_runs;
    let friction =
        friction::analyse(pipeline.store(), intake.run_id, &measurements.friction_points, baseline_runs)
            .await?;
    let (joints, settings) = (method.robot.joint_count(), pipeline.config().analysis);
    let analysis =
        tokio::task::spawn_blocking(move || analyse_run(joints, &settings, &as_results(measurements)))
            .await?;

    let mixed = mixed_fits(pipeline, intake, reference_level(&analysis, &settings)).await?;

    let mut ending = pipeline.store().finish_run(intake.run_id).await?;
    if let Owner::Other(run_id) = ending.adopt(&totals.content).await? {
        drop(ending);
        pipeline.store().merge_run(intake.run_id, run_id).await?;
        return Ok(Outcome::AlreadyStored { run_id });
    }
    ending.store_analysis(&analysis).await?;
    if let Some(fits) = mixed {
        ending.replace_mixed_fits(&fits).await?;
    }
    friction.store(&mut ending).await?;
    let history = ending.run_summaries().await?;
    let findings = detect(&history, &pipeline.config().detect);
    let reconciled = ending.reconcile(&findings).await?;
    let figures = RunTotals {
        rows: usize::try_from(totals.rows).unwrap_or(usize::MAX),
        sample_rate: totals.sample_rate,
        cycles: totals.cycles,
    };
    ending.complete(figures).await?;
    ending.commit().await?;
    Ok(Outcome::Stored(StoredRun {
        run_id: intake.run_id,
        robot: intake.header.robot.clone(),
        cycles: totals.cycles,
        refused,
        rows: totals.rows,
        new_anomalies: opened(pipeline.store(), &reconciled.opened).await?,
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
    let cycles =
        pipeline.store().lookup(&intake.header.content_hash).await?.map_or(0, |run| run.cycles_stored);
    Ok(Outcome::Quarantined { run_id, rejection, cycles })
}

async fn opened(store: &Store, ids: &[i64]) -> Result<Vec<AnomalyRow>, PipelineError> {
    if ids.is_empty() {
        return Ok(Vec::new());
    }
    let before = ids.iter().min().map_or(0, |first| first - 1);
    let rows = store.anomalies_after(before).await?;
    Ok(rows.into_iter().filter(|row| ids.contains(&row.anomaly_id)).collect())
}

/// Warm-up fits over all runs of the robot at one speed, this run included; `None` where they are not
/// due. Made before the transaction that ends the run: they take long, and it holds the only writer.
async fn mixed_fits(
    pipeline: &Pipeline,
    intake: &Intake,
    speed_fraction: f64,
) -> Result<Option<Vec<WarmUpFit>>, PipelineError> {
    let complete = pipeline.store().complete_runs_beside(intake.run_id).await?;
    if !mixed_fits_due(complete + 1) {
        return Ok(None);
    }
    let points = pipeline.store().friction_history(intake.run_id, speed_fraction).await?;
    Ok(Some(tokio::task::spawn_blocking(move || warm_up_fits(&points)).await?))
}

fn mixed_fits_due(runs: usize) -> bool {
    let step = runs.div_ceil(MIXED_FITS_EVERY_RUN_UP_TO);
    step > 0 && runs.is_multiple_of(step)
}

/// The speed level that this run's warm friction was taken at, the reference itself without one.
fn reference_level(analysis: &RunAnalysis, settings: &AnalysisSettings) -> f64 {
    let levels =
        analysis.summaries.iter().filter_map(|summary| summary.warm_friction).map(|warm| warm.speed_fraction);
    let distance = |level: f64| (level - settings.reference_speed_fraction).abs();
    levels.min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(settings.reference_speed_fraction)
}

/// Turns rows by cycle into series by parameter and joint.
fn as_results(measurements: RunMeasurements) -> RunResults {
    let friction_points: Vec<(u32, FrictionPoint)> =
        measurements.friction_points.into_iter().map(|row| (row.cycle, row.point)).collect();
    let mut parameters: Vec<(ParameterId, Vec<(u32, f64)>)> = Vec::new();
    for row in measurements.parameters {
        for (place, parameter) in row.parameters.into_iter().enumerate() {
            // every cycle has the same parameters in the same order
            match parameters.get_mut(place).filter(|(id, _)| *id == parameter.id) {
                Some((_, values)) => values.push((row.cycle, parameter.value)),
                None => parameters.push((parameter.id, vec![(row.cycle, parameter.value)])),
            }
        }
    }
    let mut relative_rmsd: Vec<(JointIndex, Vec<(u32, f64)>)> = Vec::new();
    for row in measurements.relative_rmsd {
        match relative_rmsd.iter_mut().find(|(joint, _)| *joint == row.joint) {
            Some((_, values)) => values.push((row.cycle, row.relative_rmsd)),
            None => relative_rmsd.push((row.joint, vec![(row.cycle, row.relative_rmsd)])),
        }
    }
    RunResults { friction_points, parameters, relative_rmsd }
}
