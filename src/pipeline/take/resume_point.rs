//! Where reading goes on behind stored cycles.

use serde::{Deserialize, Serialize};

use crate::ingest::table::reader::ReadPosition;
use crate::numerics::segment::cycles::CutterState;
use crate::numerics::segment::stages::FinderState;
use crate::run::ContentHash;

/// Where reading goes on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResumePoint {
    /// Where the reader stood before a block of rows.
    pub position: ReadPosition,
    /// What the finder of stages knew there.
    pub stages: FinderState,
    /// Where the cutter stood behind its last cut, in that block or at its start.
    pub cutter: CutterState,
    /// Rows per second of the first rows, Hz.
    pub sample_rate: f64,
    /// Hash of the first rows.
    pub first_rows: ContentHash,
}
