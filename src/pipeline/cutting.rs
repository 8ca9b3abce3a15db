//! Rows to cycles on their way to analysis, the same for files that have settled and files that grow.

use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

use super::cycles::RowCutter;
use super::intake::Intake;
use crate::ingest::fingerprint::RunningHash;
use crate::ingest::rejection::Rejection;
use crate::run::{ContentPrefix, Cycle, Samples};

/// A cycle, and the first bytes of the export that it and those before it were read from.
#[derive(Debug, Clone, PartialEq)]
pub struct CutCycle {
    /// The cycle.
    pub cycle: Cycle,
    /// At least all bytes of its rows.
    pub read: ContentPrefix,
}

/// How the reading of an export ended.
#[derive(Debug, Clone, PartialEq)]
pub enum ReadEnd {
    /// At the end of the file.
    Complete(ReadTotals),
    /// At something not understood.
    Rejected(Rejection),
    /// At a stop that was asked for.
    Interrupted,
    /// At the end of a file that is no longer the one that was admitted.
    Changed,
}

/// Figures of a whole export.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadTotals {
    /// Rows, those outside cycles included.
    pub rows: u64,
    /// Rows per second, from the median time step of the first rows, Hz; zero where it is unknown.
    pub sample_rate: f64,
    /// Cycles, those stored by an earlier attempt included.
    pub cycles: u32,
    /// The whole content.
    pub content: ContentPrefix,
}

/// Cuts the rows of an export into cycles and sends those that are not stored yet.
#[derive(Debug)]
pub struct Cutting<'i> {
    intake: &'i Intake,
    cycles: &'i mpsc::Sender<CutCycle>,
    stop: &'i CancellationToken,
    hash: RunningHash,
    cutter: RowCutter,
    cycle_count: u32,
}

impl<'i> Cutting<'i> {
    /// A cutter at the start of the export of `intake`; `hash` is of what its reader has read.
    ///
    /// # Errors
    /// A rejection where the robot's transmission cannot be inverted.
    pub fn new(
        intake: &'i Intake,
        cycles: &'i mpsc::Sender<CutCycle>,
        stop: &'i CancellationToken,
        hash: RunningHash,
    ) -> Result<Self, Rejection> {
        let cutter = RowCutter::new(&intake.path, &intake.layout, &intake.robot)?
            .with_most_rows(intake.limits.cycle_rows);
        Ok(Self { intake, cycles, stop, hash, cutter, cycle_count: 0 })
    }

    /// Takes the next rows and sends the cycles that they end. `false` if reading is to end, because a stop
    /// was asked for or nobody takes cycles any more.
    ///
    /// # Errors
    /// A rejection of rows that make no cycle.
    pub fn push(&mut self, samples: Samples) -> Result<bool, Rejection> {
        for cycle in self.cutter.push(samples)? {
            if self.stop.is_cancelled() || !self.send(cycle) {
                return Ok(false);
            }
        }
        Ok(!self.stop.is_cancelled())
    }

    /// Ends the export after `rows` rows and sends its last cycles.
    ///
    /// # Errors
    /// A rejection of an export without stages.
    pub fn end(mut self, rows: u64) -> Result<ReadEnd, Rejection> {
        for cycle in self.cutter.finish()? {
            if !self.send(cycle) {
                return Ok(ReadEnd::Interrupted);
            }
        }
        Ok(ReadEnd::Complete(ReadTotals {
            rows,
            sample_rate: self.cutter.sample_rate(),
            cycles: self.cycle_count,
            content: self.hash.prefix(),
        }))
    }

    fn send(&mut self, cycle: Cycle) -> bool {
        self.cycle_count += 1;
        if self.cycle_count <= self.intake.cycles_stored {
            return true;
        }
        self.cycles.blocking_send(CutCycle { cycle, read: self.hash.prefix() }).is_ok()
    }
}
