//! Cuts rows into cycles for analysis, in the same way for settled and growing files.

use std::io::Read;
use std::time::{Duration, Instant, SystemTime};

use tokio::runtime::Handle;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::admitted::AdmittedExport;
use super::cycles::RowCutter;
use super::resume::{self, ReadPositions};
use super::resume_point::ResumePoint;
use crate::pipeline::cycle_memory::{HeldCycle, OpenCycle};
use armwatch_ingest::bytes::fingerprint::RunningHash;
use armwatch_ingest::rejection::Rejection;
use armwatch_ingest::table::mended::{Mended, MendedRow};
use armwatch_ingest::table::reader::{Chunk, ExportReader};
use armwatch_method::buffers::Buffers;
use armwatch_model::run::{ContentHash, ContentPrefix, Cycle};
use armwatch_store::{ReadSoFar, StoredPoint};

/// Longest header that is kept, bytes; it is stored again with each cycle.
const LONGEST_HEADER: usize = 64 << 10;

/// A cycle, and the bytes that it and the cycles before it were read from.
#[derive(Debug, PartialEq)]
pub struct CutCycle {
    /// The cycle.
    pub cycle: Cycle,
    /// Sentences about repairs in its rows and in those since the cycle before it.
    pub remarks: Vec<String>,
    /// At least all bytes of its rows, and where reading goes on behind them.
    pub read: ReadSoFar,
    /// Work of reading and cutting since the cycle before it, without waiting.
    pub took: Duration,
    /// When the row that ended it was written, if known.
    pub written: Option<SystemTime>,
    /// Its memory.
    pub held: HeldCycle,
}

/// How the reading of an export ended.
#[derive(Debug, Clone, PartialEq)]
pub enum ReadEnd {
    /// At the end of the file.
    Complete(ReadTotals),
    /// At something not understood.
    Rejected(Rejection),
    /// At a requested stop.
    Interrupted,
    /// At the end of a file that is no longer the one that was admitted.
    Changed,
}

/// Totals of a whole export.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadTotals {
    /// Rows, including those outside cycles.
    pub rows: u64,
    /// Bad rows that were skipped, in addition to those.
    pub rows_skipped: u64,
    /// Rows per second, from the median time step of the first rows, Hz; zero if unknown.
    pub sample_rate: f64,
    /// Cycles, including those stored by an earlier attempt.
    pub cycles: u32,
    /// The whole content.
    pub content: ContentPrefix,
    /// Hash of the first rows, see [`RowCutter::first_rows`].
    pub first_rows: ContentHash,
    /// Time from the first row to the last, s.
    pub duration: f64,
}

/// Cuts the rows of an export into cycles and sends those that are not stored yet.
#[derive(Debug)]
pub struct Cutting<'i> {
    intake: &'i AdmittedExport,
    cycles: &'i mpsc::Sender<CutCycle>,
    stop: &'i CancellationToken,
    hash: RunningHash,
    cutter: RowCutter,
    open_cycle: OpenCycle,
    cycle_count: u32,
    positions: ReadPositions,
    /// Repairs in rows that no cycle has yet.
    mended: Vec<MendedRow>,
    header: Option<String>,
    took: Duration,
    written: Option<SystemTime>,
}

impl<'i> Cutting<'i> {
    /// Creates a cutter at the start of the export of `intake`, or at its resume point; `hash` is the hash of the bytes
    /// read so far.
    ///
    /// # Errors
    /// A rejection if the robot's transmission cannot be inverted.
    pub fn new(
        intake: &'i AdmittedExport,
        cycles: &'i mpsc::Sender<CutCycle>,
        stop: &'i CancellationToken,
        hash: RunningHash,
    ) -> Result<Self, Rejection> {
        let mut cutter = RowCutter::new(&intake.path, &intake.layout, &intake.robot)?
            .with_most_rows(intake.limits.cycle_rows)
            .with_most_bytes(intake.limits.cycles_bytes);
        let mut cycle_count = 0;
        if let Some(point) = &intake.resume {
            cutter = cutter.at(point);
            cycle_count = point.cutter.cycles_cut;
        }
        let positions = ReadPositions::default();
        Ok(Self {
            intake,
            cycles,
            stop,
            hash,
            cutter,
            open_cycle: intake.memory.enter(intake.turn.clone()),
            cycle_count,
            positions,
            mended: Vec::new(),
            header: None,
            took: Duration::ZERO,
            written: None,
        })
    }

    /// Takes the memory of cycles' channels from `buffers`.
    #[must_use]
    pub fn with_buffers(mut self, buffers: Buffers) -> Self {
        self.cutter = self.cutter.with_buffers(buffers);
        self
    }

    /// Sets the header of the rows, which is stored with the position.
    #[must_use]
    pub fn with_header(mut self, header: Option<&str>) -> Self {
        self.header = header.filter(|header| header.len() <= LONGEST_HEADER).map(str::to_owned);
        self
    }

    /// Cycles cut so far, including those stored by an earlier attempt.
    pub fn cycle_count(&self) -> u32 {
        self.cycle_count
    }

    /// Notes the time that reading the next pushed rows took, and when the last of them was written, if known.
    pub fn note_read(&mut self, took: Duration, written: Option<SystemTime>) {
        self.took += took;
        self.written = written;
    }

    /// Adds the next rows and sends the cycles that they end. Returns `false` if reading must end, because a stop was
    /// requested or the receiver is dropped.
    ///
    /// # Errors
    /// A rejection of rows that form no cycle, after the cycles before them.
    pub fn push(&mut self, chunk: Chunk) -> Result<bool, Rejection> {
        let began = Instant::now();
        self.positions.note(chunk.position, &self.cutter);
        self.cutter.note_line(chunk.first_line);
        self.mended.extend(chunk.mended);
        self.cutter.push(chunk.samples);
        self.took += began.elapsed();
        if !self.send_cut()? {
            return Ok(false);
        }
        self.positions.forget_before(self.cutter.rows_settled());
        self.open_cycle.has(self.cutter.open_bytes(), self.stop);
        self.wait_for_room();
        Ok(!self.stop.is_cancelled())
    }

    /// Sends the cut cycles, each before the next one is cut.
    fn send_cut(&mut self) -> Result<bool, Rejection> {
        let mut cut = self.next_cycle();
        while let Ok(Some(cycle)) = cut {
            cut = self.next_cycle();
            // only the last cut has a point: points of earlier cuts in the same block would read the same rows again
            let is_last = !matches!(cut, Ok(Some(_))) && self.cutter.all_taken();
            let point = if is_last { self.positions.at_cut(&self.cutter) } else { None };
            let point = point.map(|point| ResumePoint { header: self.header.clone(), ..point });
            let point = point.and_then(|point| resume::encoded(&point, &self.intake.made_with));
            if self.stop.is_cancelled() || !self.send(cycle, point, None) {
                return Ok(false);
            }
        }
        cut.map(|_| true)
    }

    fn next_cycle(&mut self) -> Result<Option<Cycle>, Rejection> {
        let began = Instant::now();
        let cycle = self.cutter.next_cycle();
        self.took += began.elapsed();
        cycle
    }

    /// Ends the export that `reader` has read, and sends its last cycles. They have no point to go on from, since the end of
    /// the file has cut them.
    ///
    /// # Errors
    /// A rejection of an export without stages.
    pub fn end<R: Read>(mut self, reader: &ExportReader<R>) -> Result<ReadEnd, Rejection> {
        self.cutter.finish();
        // the end of the file ended the cycle
        self.written = None;
        let mut next = self.next_cycle()?;
        while let Some(cycle) = next {
            next = self.next_cycle()?;
            let behind = if next.is_none() { reader.left_out_at_end() } else { Vec::new() };
            if !self.send(cycle, None, Some(behind)) {
                return Ok(ReadEnd::Interrupted);
            }
        }
        Ok(ReadEnd::Complete(ReadTotals {
            rows: reader.rows(),
            rows_skipped: reader.passed_over().rows,
            sample_rate: self.cutter.sample_rate(),
            cycles: self.cycle_count,
            content: self.hash.prefix(),
            first_rows: self.cutter.first_rows(),
            duration: self.cutter.last_time(),
        }))
    }

    /// Waits until the last cycle is taken: rows read during the wait would be one more cycle in memory.
    fn wait_for_room(&self) {
        if self.cycles.capacity() == 0
            && let Ok(runtime) = Handle::try_current()
        {
            // the receiver is dropped: the next send reports it
            let _ = runtime.block_on(self.cycles.reserve());
        }
    }

    /// Sends a cycle. `at_end` are sentences about the end of the file, if that has cut the cycle.
    fn send(&mut self, cycle: Cycle, resume: Option<StoredPoint>, at_end: Option<Vec<String>>) -> bool {
        let last = cycle.samples.time.last().copied().unwrap_or(f64::INFINITY);
        let (cut_by_end, mut mended) = (at_end.is_some(), Mended::default());
        let of_cycle = self.mended.iter().take_while(|of| of.time <= last).count();
        mended.add(&self.mended.drain(..of_cycle).collect::<Vec<_>>());
        let remarks = mended.sentences().into_iter().chain(at_end.unwrap_or_default()).collect();
        self.cycle_count += 1;
        if self.cycle_count <= self.intake.cycles_stored {
            return true;
        }
        let read = ReadSoFar { prefix: self.hash.prefix(), resume, cut_by_end };
        let took = std::mem::take(&mut self.took);
        let held = self.intake.memory.hold(&cycle);
        self.cycles
            .blocking_send(CutCycle { cycle, remarks, read, took, written: self.written, held })
            .is_ok()
    }
}
