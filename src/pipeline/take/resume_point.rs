//! Where reading goes on behind stored cycles.

use serde::{Deserialize, Serialize};

use armwatch_ingest::table::reader::ReadPosition;
use armwatch_method::segment::cycles::CutterState;
use armwatch_method::segment::stages::FinderState;
use armwatch_model::run::ContentHash;

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
    /// Header of the rows: if the file is cut and its rows go on without one, they are read by it. `None` if columns go by
    /// number.
    pub header: Option<String>,
}
