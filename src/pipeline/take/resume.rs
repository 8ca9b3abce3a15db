//! Where reading goes on after a restart: places of an export between two cycles, with all that reader, finder of
//! stages and cutter know there, as bytes that the database keeps with the cycles.
//!
//! A point is taken where the cutter has just cut. Reading goes on a little before, at the start of the block of
//! rows that the cut lies in, where the reader's state is a few numbers; rows that are in cycles already are left
//! out once their stage is known. What is written down is checked when it is read: a point of another version, of
//! another layout or description, or with a byte changed is none, and the export is read from its start.

use std::collections::VecDeque;

use tokio_util::sync::CancellationToken;

use super::admitted::AdmittedExport;
use super::cycles::{RowCutter, SAMPLE_RATE_ROWS};
use crate::config::{Layout, WorkLimits};
use crate::ingest::bytes::blocks::Passed;
use crate::ingest::bytes::fingerprint;
use crate::ingest::rejection::Rejection;
use crate::ingest::table::cell::Decimal;
use crate::ingest::table::cell_reader::PreviousTime;
use crate::ingest::table::reader::{ExportReader, Place};
use crate::numerics::analyse::AnalysisSettings;
use crate::numerics::segment::cycles::CutterState;
use crate::numerics::segment::stages::{FinderState, OutsideLevels, SignalState};
use crate::numerics::segment::stages_from_motion::{Motion, MotionState, Phase};
use crate::pipeline::context::{Pipeline, PipelineError};
use crate::pipeline::take::resume_point::ResumePoint;
use crate::robot::Robot;
use crate::run::{ContentHash, Stage};
use crate::store::StoredPoint;

/// Changes with the meaning of what is written down, and of the rows that it makes: reader, stages and cycles.
const VERSION: u64 = 2;

/// Bytes of the hash behind the others.
const CHECK_BYTES: usize = 32;

/// The blocks of rows that the next cut may lie in, each with what was known before it.
#[derive(Debug, Default)]
pub struct Places(VecDeque<(Place, FinderState)>);

impl Places {
    /// Notes the block that is pushed into `cutter` next.
    pub fn note(&mut self, place: Place, cutter: &RowCutter) {
        self.0.push_back((place, cutter.stages()));
    }

    /// The point at the last cut of `cutter`. `None` within the first rows, where nothing is saved.
    #[must_use]
    pub fn at_cut(&self, cutter: &RowCutter) -> Option<ResumePoint> {
        let state = cutter.cutter();
        let (place, stages) = self.0.iter().rfind(|(place, _)| place.rows <= state.rows_cut)?;
        (place.rows >= SAMPLE_RATE_ROWS as u64).then(|| ResumePoint {
            place: *place,
            stages: stages.clone(),
            cutter: state,
            sample_rate: cutter.sample_rate(),
            first_rows: cutter.first_rows(),
        })
    }

    /// Forgets blocks all of whose rows were looked at for a cut.
    pub fn forget_before(&mut self, rows_settled: u64) {
        while self.0.get(1).is_some_and(|(next, _)| next.rows <= rows_settled) {
            self.0.pop_front();
        }
    }
}

/// What decides the cycles of an export and what they say, besides its bytes: layout, description, bounds, settings
/// of the analysis and program. Stored cycles of a run are gone on with only where it is the same.
#[must_use]
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
///
/// # Errors
/// Those of the store.
pub(in crate::pipeline) async fn of_run(
    pipeline: &Pipeline,
    run_id: i64,
    settings: &ContentHash,
) -> Result<Option<ResumePoint>, PipelineError> {
    let Some(stored) = pipeline.store().resume_point(run_id).await? else { return Ok(None) };
    let point = decoded(&stored.state, settings);
    if point.is_none() {
        tracing::info!(run_id, "read from the start: what was stored to go on with does not fit any more");
    }
    Ok(point)
}

/// Passes over what the stored cycles of `intake` were read from, up to its point. `Passed::Going`: a stop was
/// asked for.
///
/// # Errors
/// A rejection of a file that cannot be read so far.
pub fn pass_to_point<R: std::io::Read>(
    export: &mut ExportReader<R>,
    intake: &AdmittedExport,
    stop: &CancellationToken,
    progress: impl Fn(),
) -> Result<Passed, Rejection> {
    let Some(ResumePoint { place, cutter, .. }) = &intake.resume else { return Ok(Passed::There) };
    let mut passed = Passed::Going;
    while passed == Passed::Going && !stop.is_cancelled() {
        passed = export.pass_to(place)?;
        progress();
    }
    let (file, run_id) = (intake.path.display(), intake.run_id);
    match passed {
        Passed::There => {
            tracing::info!(%file, run_id, line = place.line, cycles = cutter.cycles_cut, "resumed at byte {}", place.byte);
        }
        Passed::Elsewhere => tracing::warn!(%file, run_id, "not the file any more that was read before"),
        Passed::Going => {}
    }
    Ok(passed)
}

/// A point as it is stored.
#[must_use]
pub fn encoded(point: &ResumePoint, settings: &ContentHash) -> StoredPoint {
    let mut out = Writer::default();
    out.whole(VERSION);
    out.place(&point.place);
    out.finder(&point.stages);
    let CutterState { rows_cut, cycles_cut, number_cut, counter_reached } = point.cutter;
    out.whole(rows_cut);
    [cycles_cut, number_cut, counter_reached].into_iter().for_each(|number| out.whole(number.into()));
    out.number(point.sample_rate);
    out.0.extend(point.first_rows.0);
    let check = check(&out.0, settings);
    out.0.extend(check.0);
    StoredPoint { cycles: cycles_cut, byte: point.place.byte, state: out.0 }
}

/// The point that [`encoded`] made with these settings; `None` of anything else.
#[must_use]
pub fn decoded(state: &[u8], settings: &ContentHash) -> Option<ResumePoint> {
    let (words, found) = state.split_at_checked(state.len().checked_sub(CHECK_BYTES)?)?;
    if check(words, settings).0 != *found {
        return None;
    }
    let mut from = Reader(words);
    if from.whole()? != VERSION {
        return None;
    }
    let (place, stages) = (from.place()?, from.finder()?);
    let cutter = CutterState {
        rows_cut: from.whole()?,
        cycles_cut: from.small()?,
        number_cut: from.small()?,
        counter_reached: from.small()?,
    };
    let sample_rate = from.number()?;
    let first_rows = ContentHash(from.0.try_into().ok()?);
    Some(ResumePoint { place, stages, cutter, sample_rate, first_rows })
}

fn check(words: &[u8], settings: &ContentHash) -> ContentHash {
    fingerprint::of_bytes(&[words, &settings.0].concat())
}

/// Numbers as words of eight bytes, bit by bit, since what follows from them is to be the same bit by bit.
#[derive(Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn whole(&mut self, number: u64) {
        self.0.extend(number.to_le_bytes());
    }

    fn number(&mut self, number: f64) {
        self.whole(number.to_bits());
    }

    fn decimal(&mut self, Decimal { digits, places }: Decimal) {
        let digits = digits.cast_unsigned();
        // the low half is what is left of it
        [(digits >> 64) as u64, digits as u64].into_iter().for_each(|half| self.whole(half));
        self.whole(places.into());
    }

    fn optional<T>(&mut self, value: Option<T>, write: impl FnOnce(&mut Self, T)) {
        self.whole(value.is_some().into());
        if let Some(value) = value {
            write(self, value);
        }
    }

    fn place(&mut self, place: &Place) {
        [place.line, place.byte, place.rows, place.rows_skipped]
            .into_iter()
            .for_each(|number| self.whole(number));
        self.optional(place.previous, |out, PreviousTime { recorded, seconds }| {
            [recorded, seconds].into_iter().for_each(|time| out.number(time));
        });
        self.optional(place.origin, Self::decimal);
        self.optional(place.moment, |out, moment| out.whole(moment.cast_unsigned()));
    }

    fn finder(&mut self, state: &FinderState) {
        let SignalState { present, candidate, outside } = state.signal;
        self.optional(state.first_time, Self::number);
        self.optional(present, Self::stage);
        self.optional(candidate, |out, (stage, since)| {
            out.stage(stage);
            out.number(since);
        });
        self.optional(outside, |out, OutsideLevels { level, start_s }| {
            [level, start_s].into_iter().for_each(|number| out.number(number));
        });
        self.motion(&state.motion);
    }

    fn motion(&mut self, state: &MotionState) {
        self.whole(state.moved.len() as u64);
        state.moved.iter().for_each(|moved| self.optional(*moved, Self::number));
        self.whole(state.recent.len() as u64);
        for (time, positions) in &state.recent {
            self.number(*time);
            self.whole(positions.len() as u64);
            positions.iter().for_each(|position| self.number(*position));
        }
        self.whole(state.block as u64);
        [state.block_start, state.block_last, state.last]
            .into_iter()
            .for_each(|time| self.optional(time, Self::number));
        self.optional(state.stage, Self::stage);
        self.optional(state.candidate, |out, (motion, since)| {
            out.whole(motion as u64);
            out.number(since);
        });
        self.whole(state.phase as u64);
    }

    fn stage(&mut self, stage: Stage) {
        self.whole(stage as u64);
    }
}

/// Reads what [`Writer`] writes; `None` where it is not that.
struct Reader<'b>(&'b [u8]);

impl Reader<'_> {
    fn whole(&mut self) -> Option<u64> {
        let (word, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(u64::from_le_bytes(*word))
    }

    fn small(&mut self) -> Option<u32> {
        self.whole()?.try_into().ok()
    }

    fn decimal(&mut self) -> Option<Decimal> {
        let (high, low) = (u128::from(self.whole()?), u128::from(self.whole()?));
        Some(Decimal { digits: (high << 64 | low).cast_signed(), places: self.small()? })
    }

    fn number(&mut self) -> Option<f64> {
        self.whole().map(f64::from_bits)
    }

    fn optional<T>(&mut self, read: impl FnOnce(&mut Self) -> Option<T>) -> Option<Option<T>> {
        match self.whole()? {
            0 => Some(None),
            1 => read(self).map(Some),
            _ => None,
        }
    }

    fn place(&mut self) -> Option<Place> {
        Some(Place {
            line: self.whole()?,
            byte: self.whole()?,
            rows: self.whole()?,
            rows_skipped: self.whole()?,
            previous: self
                .optional(|from| Some(PreviousTime { recorded: from.number()?, seconds: from.number()? }))?,
            origin: self.optional(Self::decimal)?,
            moment: self.optional(|from| from.whole().map(u64::cast_signed))?,
        })
    }

    fn finder(&mut self) -> Option<FinderState> {
        Some(FinderState {
            first_time: self.optional(Self::number)?,
            signal: SignalState {
                present: self.optional(Self::stage)?,
                candidate: self.optional(|from| Some((from.stage()?, from.number()?)))?,
                outside: self.optional(|from| {
                    Some(OutsideLevels { level: from.number()?, start_s: from.number()? })
                })?,
            },
            motion: self.motion()?,
        })
    }

    fn motion(&mut self) -> Option<MotionState> {
        let moved = (0..self.whole()?).map(|_| self.optional(Self::number)).collect::<Option<_>>()?;
        let recent = (0..self.whole()?).map(|_| {
            let time = self.number()?;
            let positions = (0..self.whole()?).map(|_| self.number()).collect::<Option<_>>()?;
            Some((time, positions))
        });
        Some(MotionState {
            moved,
            recent: recent.collect::<Option<_>>()?,
            block: self.motion_kind()?,
            block_start: self.optional(Self::number)?,
            block_last: self.optional(Self::number)?,
            last: self.optional(Self::number)?,
            stage: self.optional(Self::stage)?,
            candidate: self.optional(|from| Some((from.motion_kind()?, from.number()?)))?,
            phase: self.phase()?,
        })
    }

    fn motion_kind(&mut self) -> Option<Motion> {
        let motion = self.whole()?;
        [Motion::Rest, Motion::OneJoint, Motion::Several].into_iter().find(|of| *of as u64 == motion)
    }

    fn phase(&mut self) -> Option<Phase> {
        let phase = self.whole()?;
        [Phase::Begun, Phase::Friction, Phase::Warming].into_iter().find(|of| *of as u64 == phase)
    }

    fn stage(&mut self) -> Option<Stage> {
        let stage = self.whole()?;
        let stages = [Stage::Between, Stage::Excitation, Stage::Friction, Stage::Warming];
        stages.into_iter().find(|of| *of as u64 == stage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::take::resume_point::ResumePoint;

    #[test]
    fn a_point_comes_back_bit_by_bit_and_one_of_another_version_is_none() {
        let settings = ContentHash([7; 32]);
        let point = ResumePoint {
            place: Place {
                line: 3,
                byte: u64::MAX,
                rows: 1,
                rows_skipped: 6,
                previous: Some(PreviousTime { recorded: 0.1 + 0.2, seconds: -0.0 }),
                origin: Some(Decimal { digits: -1_700_000_000_004, places: 3 }),
                moment: Some(i64::MIN),
            },
            stages: FinderState {
                first_time: Some(f64::MIN_POSITIVE),
                signal: SignalState {
                    present: Some(Stage::Warming),
                    candidate: Some((Stage::Between, 1.0 / 3.0)),
                    outside: Some(OutsideLevels { level: 9.75, start_s: 4.0 }),
                },
                motion: MotionState {
                    moved: vec![None, Some(2.5)],
                    recent: [(1.0, vec![0.5, 1e-300]), (1.5, vec![])].into(),
                    block: Motion::Several,
                    block_start: Some(0.7),
                    block_last: None,
                    last: Some(0.8),
                    stage: Some(Stage::Friction),
                    candidate: Some((Motion::OneJoint, 0.9)),
                    phase: Phase::Warming,
                },
            },
            cutter: CutterState { rows_cut: 5, cycles_cut: 4, number_cut: 9, counter_reached: u32::MAX },
            sample_rate: 1000.0 / 3.0,
            first_rows: ContentHash([3; 32]),
        };
        let stored = encoded(&point, &settings);
        assert_eq!(decoded(&stored.state, &settings).as_ref(), Some(&point));
        let mut older = stored.state[..stored.state.len() - CHECK_BYTES].to_vec();
        older[0] -= 1;
        older.extend(check(&older, &settings).0);
        assert_eq!(decoded(&older, &settings), None);
    }
}

#[cfg(test)]
mod points_tests;
