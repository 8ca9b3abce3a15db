//! Stores analyses in the database: one transaction per cycle, one for the end of a run.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use tokio::sync::mpsc;

use super::admitted::AdmittedExport;
use super::cutting::ReadTotals;
use crate::metrics::WorkStage;
use crate::pipeline::conclude::windows::too_late;
use crate::pipeline::context::{InAnalysis, Outcome, Pipeline, PipelineError, StoredRun};
use crate::pipeline::friction;
use armwatch_config::UNKNOWN_ROBOT;
use armwatch_ingest::excerpt;
use armwatch_ingest::rejection::Rejection;
use armwatch_method::analyse::Method;
use armwatch_method::analyse_run::analyse_run_on;
use armwatch_method::friction::points::excitation::excitation_friction;
use armwatch_model::analysis::RunAnalysis;
use armwatch_model::run::{RunHeader, RunKind};
use armwatch_model::text;
use armwatch_store::{CycleSpeedFits, ExportFault, Owner, Replaced, RunTotals};

/// Most cycles of a test in a row without parameters and friction before it ends: all have the same reason, and their
/// factors would fill the database. This is ten times the cycles of the whole test.
const MOST_WITHOUT_RESULT: usize = 250;

/// The result of recording the cycles of an export.
#[derive(Debug, Default)]
pub struct RecordedExport {
    /// Cycles without parameters, each with its reason.
    pub refused: Vec<(u32, String)>,
    /// Why the run cannot be complete: an analysis panicked, or too many cycles have no result.
    pub rejection: Option<Rejection>,
}

/// Records analyses in the order of their cycles.
///
/// # Errors
/// Those of the store. A panic of an analysis is a rejection of this run; other runs continue.
pub(in crate::pipeline) async fn cycles(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
    mut analyses: mpsc::Receiver<InAnalysis>,
    stored: impl Fn(u32),
) -> Result<RecordedExport, PipelineError> {
    let mut recorded = RecordedExport::default();
    let (store, metrics) = (pipeline.store(), pipeline.metrics());
    let mut without_result = stored_without_result(pipeline, intake).await?;
    recorded.rejection = too_many_without_result(intake, &without_result);
    if recorded.rejection.is_some() {
        return Ok(recorded);
    }
    while let Some(InAnalysis { analysis, read, written }) = analyses.recv().await {
        let (analysis, _until_recorded) = match analysis.await {
            Ok(analysis) => analysis,
            Err(error) => {
                tracing::error!(file = %text::of_path(&intake.path), %error, "an analysis panicked");
                let reason = format!("internal error while analysing a cycle: {error}");
                recorded.rejection =
                    Some(Rejection::of_file(&intake.path, reason, "report it with this file"));
                return Ok(recorded);
            }
        };
        for remark in &analysis.remarks {
            tracing::debug!(robot = %intake.header.robot, cycle = analysis.cycle, "{remark}");
        }
        let began = Instant::now();
        store.record_cycle_read(intake.run_id, &analysis, &intake.robot, Some(&read)).await?;
        metrics.stage(WorkStage::Record, began.elapsed());
        metrics.cycle_stored(written);
        stored(analysis.cycle);
        if let Some(reason) = analysis.refusal() {
            recorded.refused.push((analysis.cycle, reason.to_owned()));
        }
        match analysis.refusal() {
            Some(reason) if analysis.kind == RunKind::Test && analysis.friction_points.is_empty() => {
                without_result.count += 1;
                reason.clone_into(&mut without_result.reason);
            }
            _ => without_result.count = 0,
        }
        recorded.rejection = too_many_without_result(intake, &without_result);
        if recorded.rejection.is_some() {
            break;
        }
    }
    Ok(recorded)
}

/// Cycles of a test in a row that gave neither parameters nor friction.
#[derive(Debug, Default)]
struct WithoutResult {
    count: usize,
    /// The reason for the last of them.
    reason: String,
}

/// The last stored cycles of a run without result: the same cycles are stored, however often reading is interrupted.
async fn stored_without_result(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
) -> Result<WithoutResult, PipelineError> {
    if intake.cycles_stored == 0 || intake.layout.stage.kind().run_kind() != RunKind::Test {
        return Ok(WithoutResult::default());
    }
    let measured = pipeline.store().run_measurements(intake.run_id).await?;
    let with_parameters = measured.parameters.iter().map(|of| of.cycle);
    let with_friction = measured.friction_points.iter().map(|of| of.cycle);
    let last = with_parameters.chain(with_friction).max().unwrap_or(0);
    let states = pipeline.store().cycle_states(intake.run_id).await?;
    let mut after: Vec<_> = states.into_iter().filter(|state| state.cycle > last).collect();
    let reason = after.last_mut().and_then(|state| state.reason.take()).unwrap_or_default();
    Ok(WithoutResult { count: after.len(), reason })
}

fn too_many_without_result(intake: &AdmittedExport, without: &WithoutResult) -> Option<Rejection> {
    (without.count >= MOST_WITHOUT_RESULT).then(|| {
        Rejection::of_file(
            &intake.path,
            format!(
                "{} cycles in a row gave neither parameters nor friction; the reason of the last one: {}",
                without.count, without.reason
            ),
            "correct the recording or the layout; `armwatch explain` shows the result of each cycle of the file",
        )
    })
}

/// Ends a run: stores its overall results and its completion, in one transaction. If another run with the same content
/// was completed in the meantime, this one is removed. Conclusions from the robot's history follow later, see
/// [`Pipeline::conclude`]. `written_at` is the last write time of the file. If the file's name gives no start, the
/// start is that time minus the recording's duration, for growing and settled files.
pub async fn finish(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
    method: &Method,
    totals: ReadTotals,
    refused: Vec<(u32, String)>,
    written_at: Option<Timestamp>,
) -> Result<Outcome, PipelineError> {
    let began = Instant::now();
    let of_test = match intake.layout.stage.kind().run_kind() {
        RunKind::Test => Some(analyse_test(pipeline, intake, method).await?),
        RunKind::Production => None,
    };
    let mut ending = pipeline.store().finish_run(intake.run_id).await?;
    if let Owner::Other(run_id) = ending.adopt(&totals.content, &totals.first_rows).await? {
        drop(ending);
        pipeline.store().merge_run(intake.run_id, run_id).await?;
        return Ok(Outcome::AlreadyStored { run_id });
    }
    if let Some(written_at) = written_at.filter(|_| !intake.named_start) {
        ending.set_start(start_before(written_at, totals.duration)).await?;
    }
    if let Some((analysis, speed_fits)) = of_test {
        ending.store_analysis(&analysis).await?;
        ending.replace_speed_fits(&speed_fits).await?;
    }
    let figures = RunTotals {
        rows: usize::try_from(totals.rows).unwrap_or(usize::MAX),
        rows_skipped: usize::try_from(totals.rows_skipped).unwrap_or(usize::MAX),
        sample_rate: totals.sample_rate,
        cycles: totals.cycles,
    };
    ending.complete(figures).await?;
    let (replaced, kept) = (ending.replaced(), ending.kept());
    ending.commit().await?;
    if let Some(kept) = kept {
        tracing::warn!(
            file = %intake.path.display(), run_id = intake.run_id,
            "does not replace run {kept}, which is the same recording, because no cycle has a result"
        );
    }
    if let Some(boundary) = pipeline.store().arrived_too_late(intake.run_id).await? {
        let words = too_late(&intake.header.robot, boundary);
        tracing::warn!(file = %text::of_path(&intake.path), run_id = intake.run_id, "{words}");
    }
    pipeline.metrics().stage(WorkStage::Finish, began.elapsed());
    if let Some(Replaced { run_id: old, begins_otherwise: true }) = replaced {
        tracing::warn!(
            file = %text::of_path(&intake.path), run_id = intake.run_id,
            "replaces run {old}, which is the same recording by its name but begins with other rows: if it \
            continues run {old}, as the next part of one recording, join the parts in one file; if these \
            are two recordings, give the other file a name with its own start and ingest it again, or set \
            on_rewrite = \"keep_both\" under [watch]"
        );
    }
    Ok(Outcome::Stored(StoredRun {
        run_id: intake.run_id,
        robot: intake.header.robot.clone(),
        cycles: totals.cycles,
        refused,
        rows: totals.rows,
    }))
}

/// The time `duration` seconds before `end`, to the microsecond.
pub fn start_before(end: Timestamp, duration: f64) -> Timestamp {
    let duration = Duration::try_from_secs_f64(duration).unwrap_or_default();
    let duration = Duration::from_micros(u64::try_from(duration.as_micros()).unwrap_or_default());
    end.checked_sub(duration).unwrap_or(end)
}

/// Overall results of a test; a production log has none beyond its windows.
async fn analyse_test(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
    method: &Method,
) -> Result<(RunAnalysis, Vec<CycleSpeedFits>), PipelineError> {
    let measurements = Arc::new(pipeline.store().run_measurements(intake.run_id).await?);
    let (robot, settings) = (method.robot.clone(), pipeline.config().analysis);
    let (spare, measured) = (pipeline.spare_threads(), Arc::clone(&measurements));
    let analysis = tokio::task::spawn_blocking(move || {
        let friction = excitation_friction(&robot, settings.reference_speed_fraction, &measured.parameters);
        let mut analysis = analyse_run_on(&spare, robot.joint_count(), &settings, &measured);
        for (summary, friction) in analysis.summaries.iter_mut().zip(friction) {
            summary.excitation_friction = friction.map(|of| of.friction);
            summary.half_speed_friction = friction.and_then(|of| of.at_half_speed);
        }
        analysis
    });
    let (points, spare) = (&measurements.friction_points, pipeline.spare_threads());
    let speed_fits = friction::over_speed(pipeline.store(), intake.run_id, points, spare).await?;
    Ok((analysis.await?, speed_fits))
}

/// Quarantines an admitted export; whole cycles before the fault stay stored.
pub async fn quarantine(
    pipeline: &Pipeline,
    intake: &AdmittedExport,
    rejection: Rejection,
) -> Result<Outcome, PipelineError> {
    // any file that ends with .csv has a name: without a start in it and without a readable row, it belongs to no robot
    let rejection =
        super::cut_file::with_cause(pipeline, &intake.path, Some(intake.run_id), rejection).await?;
    let robot = if intake.named_start { &intake.header.robot } else { UNKNOWN_ROBOT };
    let header = RunHeader { robot: robot.to_owned(), ..intake.header.clone() };
    let run_id = write_down(pipeline, &header, &rejection).await?;
    let cycles = pipeline.store().known_run(run_id).await?.map_or(0, |run| run.cycles_stored);
    Ok(Outcome::Quarantined { run_id, rejection, cycles, known: false })
}

/// Stores why an export was not understood, with the place in the file if it can be found. Returns the key of the run.
pub(in crate::pipeline) async fn write_down(
    pipeline: &Pipeline,
    header: &RunHeader,
    rejection: &Rejection,
) -> Result<i64, PipelineError> {
    let (place, most) = (rejection.clone(), pipeline.config().limits.export_bytes);
    let excerpt = pipeline.with_files(move || excerpt::of_rejection(&place, 0, most)).await?;
    let fault = ExportFault {
        reason: rejection.sentence(),
        problem: rejection.reason.to_string(),
        line: rejection.line,
        column: rejection.column.as_deref().map(str::to_owned),
        byte: excerpt.map(|excerpt| excerpt.byte),
        value: rejection.value.as_deref().map(str::to_owned),
        remedy: rejection.remedy.to_string(),
    };
    Ok(pipeline.store().quarantine(header, &fault).await?)
}
