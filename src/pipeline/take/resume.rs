//! Resume points: where reading an export continues after a restart. A point contains the state of reader, stage finder
//! and cutter, as bytes that the database stores with the cycles.
//!
//! A point is taken when the cutter has just cut. Reading continues at the start of the block of rows that contains the
//! cut, because the reader's state is a few numbers there; rows that are in cycles already are dropped once their stage
//! is known. A point is used only if its version, its layout, its description and all its bytes are right; otherwise
//! the export is read from its start.

use std::collections::VecDeque;

use tokio_util::sync::CancellationToken;

use super::admitted::AdmittedExport;
use super::cycles::{RowCutter, SAMPLE_RATE_ROWS};
use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::take::resume_point::ResumePoint;
use armwatch_config::{Layout, WorkLimits};
use armwatch_ingest::bytes::blocks::Passed;
use armwatch_ingest::bytes::fingerprint;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::reader::{ExportReader, ReadPosition};
use armwatch_method::segment::stages::FinderState;
use armwatch_model::analysis::settings::AnalysisSettings;
use armwatch_model::robot::Robot;
use armwatch_model::run::ContentHash;
use armwatch_model::text;
use armwatch_store::StoredPoint;

/// Changes whenever the meaning of the stored state changes, or the rows that follow from it: reader, stages and
/// cycles.
const VERSION: u64 = 4;

/// Bytes of the hash after the others.
const CHECK_BYTES: usize = 32;

/// The blocks of rows that may contain the next cut, each with the state before it.
#[derive(Debug, Default)]
pub struct ReadPositions(VecDeque<(ReadPosition, FinderState)>);

impl ReadPositions {
    /// Notes the block that is pushed into `cutter` next.
    pub fn note(&mut self, position: ReadPosition, cutter: &RowCutter) {
        self.0.push_back((position, cutter.stages()));
    }

    /// The point at the last cut of `cutter`. `None` within the first rows, because a point saves nothing there.
    pub fn at_cut(&self, cutter: &RowCutter) -> Option<ResumePoint> {
        let state = cutter.cutter();
        let (position, stages) = self.0.iter().rfind(|(position, _)| position.rows <= state.rows_cut)?;
        (position.rows >= SAMPLE_RATE_ROWS as u64).then(|| ResumePoint {
            position: *position,
            stages: stages.clone(),
            cutter: state,
            sample_rate: cutter.sample_rate(),
            first_rows: cutter.first_rows(),
            header: None,
        })
    }

    /// Forgets blocks whose rows were all examined for a cut.
    pub fn forget_before(&mut self, rows_settled: u64) {
        while self.0.get(1).is_some_and(|(next, _)| next.rows <= rows_settled) {
            self.0.pop_front();
        }
    }
}

/// Hash of everything besides the bytes that determines the cycles of an export and their results: layout, description,
/// bounds, settings of the analysis, and program. A run with stored cycles continues only if it is the same.
pub fn settings_hash(
    layout: &Layout,
    robot: &Robot,
    limits: &WorkLimits,
    analysis: &AnalysisSettings,
) -> ContentHash {
    let program = (env!("CARGO_PKG_VERSION"), VERSION);
    let bounds = (limits.cycle_rows, limits.export_bytes);
    fingerprint::of_bytes(format!("{program:?} {layout:?} {robot:?} {bounds:?} {analysis:?}").as_bytes())
}

/// The point that is stored with the cycles of a run, if it can be used with these settings.
pub(in crate::pipeline) async fn of_run(
    pipeline: &Pipeline,
    run_id: i64,
    settings: &ContentHash,
) -> Result<Option<ResumePoint>, PipelineError> {
    let Some(stored) = pipeline.store().resume_point(run_id).await? else { return Ok(None) };
    let point = decoded(&stored.state, settings);
    if point.is_none() {
        tracing::info!(run_id, "read from the start: the stored state no longer fits");
    }
    Ok(point)
}

/// Skips the part of the file that the stored cycles of `intake` were read from, up to its point. `Passed::Going` means
/// that a stop was requested.
///
/// # Errors
/// A rejection of a file that is unreadable within this part.
pub fn pass_to_point<R: std::io::Read>(
    export: &mut ExportReader<R>,
    intake: &AdmittedExport,
    stop: &CancellationToken,
    progress: impl Fn(),
) -> Result<Passed, Rejection> {
    let Some(ResumePoint { position, cutter, .. }) = &intake.resume else { return Ok(Passed::There) };
    let mut passed = Passed::Going;
    while passed == Passed::Going && !stop.is_cancelled() {
        passed = export.pass_to(position)?;
        progress();
    }
    let (file, run_id) = (text::of_path(&intake.path), intake.run_id);
    match passed {
        Passed::There => {
            tracing::info!(%file, run_id, line = position.line, cycles = cutter.cycles_cut, "resumed at byte {}", position.byte);
        }
        Passed::Elsewhere => tracing::warn!(%file, run_id, "no longer the file that was read before"),
        Passed::Going => {}
    }
    Ok(passed)
}

/// A point in its stored form: version and state by postcard, which keeps every bit of numbers, and a hash of both with
/// the settings. `None` if it cannot be encoded: the export is then read from its start.
pub fn encoded(point: &ResumePoint, settings: &ContentHash) -> Option<StoredPoint> {
    let mut state = postcard::to_stdvec(&(VERSION, point)).ok()?;
    let check = check(&state, settings);
    state.extend(check.0);
    Some(StoredPoint { cycles: point.cutter.cycles_cut, byte: point.position.byte, state })
}

/// The point that [`encoded`] made with these settings; `None` for anything else.
pub fn decoded(state: &[u8], settings: &ContentHash) -> Option<ResumePoint> {
    let (written, found) = state.split_at_checked(state.len().checked_sub(CHECK_BYTES)?)?;
    if check(written, settings).0 != *found {
        return None;
    }
    let (version, state) = postcard::take_from_bytes::<u64>(written).ok()?;
    if version != VERSION {
        return None;
    }
    let (point, rest) = postcard::take_from_bytes(state).ok()?;
    rest.is_empty().then_some(point)
}

fn check(written: &[u8], settings: &ContentHash) -> ContentHash {
    fingerprint::of_bytes(&[written, &settings.0].concat())
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_ingest::table::cell::Decimal;
    use armwatch_ingest::table::clock::{ClockOrigin, PreviousTime};
    use armwatch_method::segment::cycles::CutterState;
    use armwatch_method::segment::stages::{OutsideLevels, SignalState};
    use armwatch_method::segment::stages_from_motion::{MotionFinderState, MotionPhase, MovingJoints};
    use armwatch_model::run::Stage;

    #[test]
    fn a_point_comes_back_bit_by_bit_and_one_of_another_version_is_none() {
        let settings = ContentHash([7; 32]);
        let point = ResumePoint {
            position: ReadPosition {
                line: 3,
                byte: u64::MAX,
                rows: 1,
                rows_skipped: 6,
                previous: Some(PreviousTime {
                    recorded: 0.1 + 0.2,
                    seconds: -0.0,
                    ..PreviousTime::default()
                }),
                origin: Some(Decimal { digits: -1_700_000_000_004, places: 3 }),
                moment: Some(ClockOrigin { nanoseconds: i64::MIN, period_s: Some(0.1), is_local: true }),
            },
            stages: FinderState {
                first_time: Some(f64::MIN_POSITIVE),
                signal: SignalState {
                    present: Some(Stage::Warming),
                    candidate: Some((Stage::Between, 1.0 / 3.0)),
                    outside: Some(OutsideLevels { level: 9.75, start_s: 4.0 }),
                },
                motion: MotionFinderState {
                    moved: vec![None, Some(2.5)],
                    recent: [(1.0, vec![0.5, 1e-300]), (1.5, vec![])].into(),
                    block: MovingJoints::Several,
                    block_start: Some(0.7),
                    block_last: None,
                    last: Some(0.8),
                    stage: Some(Stage::Friction),
                    candidate: Some((MovingJoints::OneJoint, 0.9)),
                    phase: MotionPhase::Warming,
                },
            },
            cutter: CutterState { rows_cut: 5, cycles_cut: 4, number_cut: 9, counter_reached: u32::MAX },
            sample_rate: 1000.0 / 3.0,
            first_rows: ContentHash([3; 32]),
            header: Some("time,pos_1".into()),
        };
        let stored = encoded(&point, &settings).expect("written down");
        assert_eq!(decoded(&stored.state, &settings).as_ref(), Some(&point));
        let mut older = stored.state[..stored.state.len() - CHECK_BYTES].to_vec();
        older[0] -= 1;
        older.extend(check(&older, &settings).0);
        assert_eq!(decoded(&older, &settings), None);
    }
}

#[cfg(test)]
mod points_tests;
