//! An export that is read.

use std::path::PathBuf;
use std::sync::Arc;

use super::resume_point::ResumePoint;
use crate::pipeline::cycle_memory::{CycleMemory, RecordingTurn};
use armwatch_config::{Layout, WorkLimits};
use armwatch_model::robot::Robot;
use armwatch_model::run::{ContentHash, RunHeader};

/// An export that was let in.
#[derive(Debug, Clone)]
pub struct AdmittedExport {
    /// Where it lies.
    pub path: PathBuf,
    /// Its row in the ledger; zero of one that is read before the ledger has let it in.
    pub run_id: i64,
    /// What is known of it.
    pub header: RunHeader,
    /// The arm that made it.
    pub robot: Arc<Robot>,
    /// Its layout.
    pub layout: Arc<Layout>,
    /// Whether its name says the start of the recording.
    pub named_start: bool,
    /// Cycles stored by an earlier attempt.
    pub cycles_stored: u32,
    /// Where reading goes on behind some of them, if not at the start.
    pub resume: Option<ResumePoint>,
    /// What decides its cycles besides its bytes.
    pub made_with: ContentHash,
    /// What reading it may take.
    pub limits: WorkLimits,
    /// Memory of the cycles of all exports that are being read and analysed.
    pub memory: CycleMemory,
    /// The header that the file had before it was cut, if it has none now.
    pub header_before: Option<String>,
    /// Whether its analyses are recorded as they end.
    pub turn: RecordingTurn,
}
