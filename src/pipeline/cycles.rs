//! An export's cycles, one after another, as the analysis gets them: the one way from bytes to cycles.

use std::path::{Path, PathBuf};

use crate::config::Layout;
use crate::ingest::csv::{ExportReader, ReadOptions};
use crate::ingest::fingerprint::RunningHash;
use crate::ingest::rejection::Rejection;
use crate::ingest::source;
use crate::numerics::segment::{CycleCutter, SegmentError};
use crate::numerics::signal::median_step;
use crate::numerics::transmission::JointSide;
use crate::robot::Robot;
use crate::run::{ContentHash, Cycle};

/// Reads an export, brings its channels to the joints and cuts cycles.
pub struct CycleReader {
    export: ExportReader<Box<dyn std::io::Read + Send>>,
    hash: RunningHash,
    joint_side: JointSide,
    /// Gone once the last cycle is out.
    cutter: Option<CycleCutter>,
    path: PathBuf,
    sample_rate: Option<f64>,
}

impl CycleReader {
    /// Opens an export and reads its header.
    ///
    /// # Errors
    /// A rejection of the file, of its header, or of a transmission that cannot be inverted.
    pub fn open(path: &Path, layout: &Layout, robot: &Robot) -> Result<Self, Rejection> {
        let (bytes, hash) = source::open_hashing(path)?;
        let export = ExportReader::new(bytes, path, layout, robot, ReadOptions::default())?;
        let motor = layout.motor_side;
        let joint_side = JointSide::new(robot, motor.position, motor.torque).map_err(|error| {
            Rejection::of_file(path, error.to_string(), "correct the transmission of the robot's description")
        })?;
        let cutter = Some(CycleCutter::new());
        Ok(Self { export, hash, joint_side, cutter, path: path.to_owned(), sample_rate: None })
    }

    /// Reads the next piece of the export and gives the cycles that it ends, often none; `None` after the
    /// last piece.
    ///
    /// # Errors
    /// A rejection of rows, or of a recording without cycles.
    pub fn next_cycles(&mut self) -> Result<Option<Vec<Cycle>>, Rejection> {
        let rejected = |error: SegmentError| Rejection::of_file(&self.path, error.to_string(), "");
        match self.export.next() {
            Some(chunk) => {
                let mut samples = chunk?.samples;
                self.joint_side.apply(&mut samples);
                self.sample_rate =
                    self.sample_rate.or_else(|| median_step(&samples.time).map(|step| 1.0 / step));
                let Some(cutter) = &mut self.cutter else { return Ok(None) };
                cutter.push(samples).map(Some).map_err(rejected)
            }
            None => match self.cutter.take() {
                Some(cutter) => {
                    cutter.finish().map(|last| Some(last.into_iter().collect())).map_err(rejected)
                }
                None => Ok(None),
            },
        }
    }

    /// Hash and number of the bytes on disk that were read so far.
    #[must_use]
    pub fn so_far(&self) -> (ContentHash, u64) {
        self.hash.so_far()
    }

    /// Rows so far, those outside cycles included.
    #[must_use]
    pub fn rows(&self) -> u64 {
        self.export.rows()
    }

    /// Rows per second, from the median time step of the first rows, Hz; zero while it is unknown.
    #[must_use]
    pub fn sample_rate(&self) -> f64 {
        self.sample_rate.unwrap_or(0.0)
    }
}
