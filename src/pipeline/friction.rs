//! Friction at the end of a run: over speed by cycle, and the robot's map with the index of each run.

use std::collections::HashMap;

use super::PipelineError;
use crate::analysis::FrictionPoint;
use crate::numerics::friction_index::{MapRun, RobotFriction, robot_friction};
use crate::numerics::friction_speed::friction_over_speed;
use crate::robot::JointIndex;
use crate::store::{CyclePoint, CycleSpeedFits, FinishTransaction, Store, StoreError};

/// What a run says of friction beyond its own warm-up.
#[derive(Debug)]
pub struct RunFriction {
    speed_fits: Vec<CycleSpeedFits>,
    run_ids: Vec<i64>,
    robot: RobotFriction,
}

/// Fits friction over speed of each cycle of run `run_id`, and the robot's map over its history. Made before
/// the transaction that ends the run.
///
/// # Errors
/// Those of the store.
pub async fn analyse(
    store: &Store,
    run_id: i64,
    points: &[CyclePoint],
    baseline_runs: usize,
) -> Result<RunFriction, PipelineError> {
    let fractions = store.independent_fractions(run_id).await?;
    let points = points.to_vec();
    let (run_ids, runs): (Vec<i64>, Vec<MapRun>) =
        store.friction_runs(run_id).await?.into_iter().map(|run| (run.run_id, run.run)).unzip();
    let (speed_fits, robot) = tokio::task::spawn_blocking(move || {
        (speed_fits(&points, &fractions), robot_friction(&runs, baseline_runs))
    })
    .await?;
    for remark in &robot.remarks {
        tracing::debug!(run_id, "{remark}");
    }
    Ok(RunFriction { speed_fits, run_ids, robot })
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

impl RunFriction {
    /// Stores it with the end of the run.
    ///
    /// # Errors
    /// Those of the store.
    pub async fn store(&self, ending: &mut FinishTransaction) -> Result<(), StoreError> {
        ending.replace_speed_fits(&self.speed_fits).await?;
        ending.replace_friction_maps(&self.run_ids, &self.robot).await
    }
}
