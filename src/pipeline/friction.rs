//! Friction beyond a run's own warm-up: over speed by cycle, and the robot's map with the index of each run.

use std::collections::HashMap;

use super::context::PipelineError;
use crate::analysis::FrictionPoint;
use crate::analysis::measurements::CyclePoint;
use crate::numerics::friction::index::{RobotFriction, robot_friction};
use crate::numerics::friction::over_speed::friction_over_speed;
use crate::numerics::friction::record::MapRun;
use crate::robot::JointIndex;
use crate::store::{CycleSpeedFits, FrictionRun, Store};

/// Fits friction over speed of each cycle of run `run_id`.
///
/// # Errors
/// Those of the store.
pub async fn over_speed(
    store: &Store,
    run_id: i64,
    points: &[CyclePoint],
) -> Result<Vec<CycleSpeedFits>, PipelineError> {
    let fractions = store.independent_fractions(run_id).await?;
    let points = points.to_vec();
    Ok(tokio::task::spawn_blocking(move || speed_fits(&points, &fractions)).await?)
}

/// Friction over speed by cycle; joints with too few speeds have said so as cycle remarks already.
fn speed_fits(points: &[CyclePoint], fractions: &HashMap<u32, f64>) -> Vec<CycleSpeedFits> {
    points
        .chunk_by(|a, b| a.cycle == b.cycle)
        .filter_map(|of_cycle| {
            let cycle = of_cycle.first()?.cycle;
            let fraction = *fractions.get(&cycle)?;
            let points: Vec<FrictionPoint> = of_cycle.iter().map(|row| row.point).collect();
            let mut joints: Vec<JointIndex> = points.iter().map(|p| p.joint).collect();
            joints.sort_unstable();
            joints.dedup();
            let fits = joints.into_iter().filter_map(|j| friction_over_speed(j, &points, fraction).ok());
            Some(CycleSpeedFits { cycle, joints: fits.collect() })
        })
        .collect()
}

/// Friction of a robot over speed and thermal state.
#[derive(Debug)]
pub struct FrictionHistory {
    /// Runs that it stands on, oldest first.
    pub run_ids: Vec<i64>,
    /// Maps, and the indices of those runs.
    pub found: RobotFriction,
}

impl FrictionHistory {
    /// Fits the map of a robot over its runs.
    #[must_use]
    pub fn of_runs(runs: Vec<FrictionRun>, baseline_runs: usize) -> Self {
        let (run_ids, runs): (Vec<i64>, Vec<MapRun>) =
            runs.into_iter().map(|run| (run.run_id, run.run)).unzip();
        Self { run_ids, found: robot_friction(&runs, baseline_runs) }
    }
}
