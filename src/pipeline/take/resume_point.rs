//! The point after stored cycles that reading continues from.

use serde::{Deserialize, Serialize};

use armwatch_ingest::table::reader::ReadPosition;
use armwatch_method::segment::cycles::CutterState;
use armwatch_method::segment::stages::FinderState;
use armwatch_model::run::ContentHash;

/// The point that reading continues from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResumePoint {
    /// State of the reader before a block of rows.
    pub position: ReadPosition,
    /// State of the stage finder there.
    pub stages: FinderState,
    /// State of the cutter after its last cut, in that block or at its start.
    pub cutter: CutterState,
    /// Rows per second of the first rows, Hz.
    pub sample_rate: f64,
    /// Hash of the first rows.
    pub first_rows: ContentHash,
    /// Header of the rows: if the file is cut and its rows continue without a header, they are read with this one.
    /// `None` if columns are selected by number.
    pub header: Option<String>,
}
