//! The one way from an export to cycles as the analysis gets them.

use std::path::{Path, PathBuf};

use crate::config::Layout;
use crate::ingest::csv::{ExportReader, ReadOptions};
use crate::ingest::rejection::Rejection;
use crate::ingest::source;
use crate::numerics::segment::{CycleCutter, SegmentError};
use crate::numerics::signal::median_step;
use crate::numerics::stages::{StageFinder, StageRule};
use crate::numerics::transmission::JointSide;
use crate::robot::Robot;
use crate::run::{Cycle, Samples};

/// First rows of an export that its sample rate is taken from. A fixed number, so that it does not depend
/// on the pieces in which a growing file is read.
const SAMPLE_RATE_ROWS: usize = 1000;

/// Brings the rows of an export to the joints, gives them their stage and cuts them into cycles.
#[derive(Debug)]
pub struct RowCutter {
    path: PathBuf,
    joint_side: JointSide,
    stages: StageFinder,
    cutter: CycleCutter,
    first_times: Vec<f64>,
}

impl RowCutter {
    /// At the start of an export; `path` only says where problems are.
    ///
    /// # Errors
    /// A rejection where the robot's transmission cannot be inverted.
    pub fn new(path: &Path, layout: &Layout, robot: &Robot) -> Result<Self, Rejection> {
        let motor = layout.motor_side;
        let joint_side = JointSide::new(robot, motor.position, motor.torque).map_err(|error| {
            Rejection::of_file(path, error.to_string(), "correct the transmission of the robot's description")
        })?;
        let rule = layout.stage.rule();
        let cutter = match rule {
            StageRule::Windows { .. } => CycleCutter::of_windows(),
            _ => CycleCutter::new(),
        };
        let stages = StageFinder::new(rule);
        Ok(Self { path: path.to_owned(), joint_side, stages, cutter, first_times: Vec::new() })
    }

    /// Takes the next rows and gives the cycles that they end.
    ///
    /// # Errors
    /// A rejection of rows that make no cycle.
    pub fn push(&mut self, mut samples: Samples) -> Result<Vec<Cycle>, Rejection> {
        let missing = SAMPLE_RATE_ROWS.saturating_sub(self.first_times.len());
        self.first_times.extend(samples.time.iter().take(missing));
        self.joint_side.apply(&mut samples);
        let staged = self.stages.push(samples).map_err(|error| rejected(&self.path, &error))?;
        self.cutter.push(staged).map_err(|error| rejected(&self.path, &error))
    }

    /// Ends the export and gives its last cycles. Nothing is left to cut.
    ///
    /// # Errors
    /// A rejection of an export without stages.
    pub fn finish(&mut self) -> Result<Vec<Cycle>, Rejection> {
        let mut cutter = std::mem::take(&mut self.cutter);
        let cut = |error: SegmentError| rejected(&self.path, &error);
        let mut cycles = cutter.push(self.stages.finish()).map_err(cut)?;
        cycles.extend(cutter.finish().map_err(cut)?);
        Ok(cycles)
    }

    /// Rows per second, from the median time step of the first rows, Hz; zero where it is unknown.
    #[must_use]
    pub fn sample_rate(&self) -> f64 {
        median_step(&self.first_times).map_or(0.0, |step| 1.0 / step)
    }
}

/// Gives the cycle of number `wanted` to someone who wants to see one again; `None` if the export does not have
/// it. Reads no further than its end.
///
/// # Errors
/// A rejection of the file, of its rows, or of a recording without cycles.
pub fn read_cycle(
    path: &Path,
    layout: &Layout,
    robot: &Robot,
    wanted: u32,
) -> Result<Option<Cycle>, Rejection> {
    let bytes = source::open(path)?;
    let mut cutter = RowCutter::new(path, layout, robot)?;
    for chunk in ExportReader::new(bytes, path, layout, robot, ReadOptions::default())? {
        let cycles = cutter.push(chunk?.samples)?;
        if let Some(found) = cycles.into_iter().find(|cycle| cycle.number == wanted) {
            return Ok(Some(found));
        }
    }
    Ok(cutter.finish()?.into_iter().find(|cycle| cycle.number == wanted))
}

fn rejected(path: &Path, error: &dyn std::error::Error) -> Rejection {
    Rejection::of_file(path, error.to_string(), "")
}
