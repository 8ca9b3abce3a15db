//! An export that is admitted for reading.

use std::path::PathBuf;
use std::sync::Arc;

use super::resume_point::ResumePoint;
use crate::pipeline::cycle_memory::{CycleMemory, RecordingTurn};
use armwatch_config::{Layout, WorkLimits};
use armwatch_model::robot::Robot;
use armwatch_model::run::{ContentHash, RunHeader};

/// An export that was admitted.
#[derive(Debug, Clone)]
pub struct AdmittedExport {
    /// Its path.
    pub path: PathBuf,
    /// Its row in the ledger; zero for an export that is read before the ledger has admitted it.
    pub run_id: i64,
    /// Its known facts.
    pub header: RunHeader,
    /// The arm that made it.
    pub robot: Arc<Robot>,
    /// Its layout.
    pub layout: Arc<Layout>,
    /// True if its name gives the start of the recording.
    pub named_start: bool,
    /// Cycles stored by an earlier attempt.
    pub cycles_stored: u32,
    /// The point after stored cycles that reading continues from, if not from the start.
    pub resume: Option<ResumePoint>,
    /// Hash of everything besides its bytes that determines its cycles.
    pub made_with: ContentHash,
    /// Limits on its reading.
    pub limits: WorkLimits,
    /// Memory of the cycles of all exports that are being read and analysed.
    pub memory: CycleMemory,
    /// The header that the file had before it was cut, if it has none now.
    pub header_before: Option<String>,
    /// Turn to record its analyses.
    pub turn: RecordingTurn,
}
