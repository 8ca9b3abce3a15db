//! Summaries of a test by joint.

use serde::{Deserialize, Serialize};
use sqlx::Row;

use crate::engine::{EngineExecutor, EngineRow};
use crate::values::{joint, size};
use armwatch_model::analysis::{Estimate, JointSummary, RmsdSwing, WarmFriction};

/// A joint's summary with the estimator of its torque deviations.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::robot) struct SummaryRow {
    pub(in crate::robot) summary: JointSummary,
    pub(in crate::robot) estimator: Option<String>,
}

impl SummaryRow {
    /// The summary for comparison with tests whose latest torque deviations are those of `estimator`: deviations of
    /// another estimator are not comparable and therefore omitted.
    pub(in crate::robot) fn among(self, estimator: Option<&str>) -> JointSummary {
        match self.estimator.as_deref() == estimator {
            true => self.summary,
            false => JointSummary { relative_rmsd: None, rmsd_swing: None, ..self.summary },
        }
    }
}

/// The columns of `run_joint_summary AS summary` that [`of_row`] reads.
macro_rules! summary_columns {
    () => {
        "summary.joint, summary.warm_friction_nm, summary.warm_friction_std_error_nm, summary.warm_minute,
         summary.warm_speed_fraction, summary.excitation_friction_nm, summary.excitation_friction_std_error_nm,
         summary.excitation_minute, summary.excitation_speed_fraction, summary.half_speed_friction_nm,
         summary.half_speed_std_error_nm, summary.relative_rmsd, summary.rmsd_swing, summary.rmsd_swing_cycles,
         summary.relative_noise, summary.torque_rms_nm"
    };
}
pub(in crate::robot) use summary_columns;

/// Summaries of a run with the latest stored friction index, by joint.
pub(in crate::robot) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<SummaryRow>> {
    sqlx::query(concat!(
        "SELECT ",
        summary_columns!(),
        ", summary.estimator, found.friction_index, found.friction_index_std_error
         FROM run_joint_summary AS summary
         LEFT JOIN run_friction_index AS found ON found.run_id = summary.run_id AND found.joint = summary.joint
         WHERE summary.run_id = $1
         ORDER BY summary.joint",
    ))
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(SummaryRow { summary: of_row(&row)?, estimator: row.try_get("estimator")? })
    })
    .fetch_all(executor)
    .await
}

/// Reads the columns of a summary and of its friction index.
pub(in crate::robot) fn of_row(row: &EngineRow) -> sqlx::Result<JointSummary> {
    let warm = ["warm_friction_nm", "warm_friction_std_error_nm", "warm_minute", "warm_speed_fraction"];
    let excitation = [
        "excitation_friction_nm",
        "excitation_friction_std_error_nm",
        "excitation_minute",
        "excitation_speed_fraction",
    ];
    let friction_index = estimate(row, "friction_index", "friction_index_std_error")?;
    let half_speed_friction = estimate(row, "half_speed_friction_nm", "half_speed_std_error_nm")?;
    let rmsd_swing = match row.try_get("rmsd_swing")? {
        Some(value) => Some(RmsdSwing { value, cycles: size(row, "rmsd_swing_cycles")? }),
        None => None,
    };
    Ok(JointSummary {
        joint: joint(row, "joint")?,
        warm_friction: warm_friction(row, warm)?,
        excitation_friction: warm_friction(row, excitation)?,
        half_speed_friction,
        friction_index,
        relative_rmsd: row.try_get("relative_rmsd")?,
        rmsd_swing,
        relative_noise: row.try_get("relative_noise")?,
        torque_rms: row.try_get("torque_rms_nm")?,
    })
}

fn estimate(row: &EngineRow, value: &str, std_error: &str) -> sqlx::Result<Option<Estimate>> {
    let std_error: Option<f64> = row.try_get(std_error)?;
    let value: Option<f64> = row.try_get(value)?;
    Ok(value.map(|value| Estimate { value, std_error: std_error.unwrap_or(f64::NAN) }))
}

/// Reads friction of a run: columns of torque, standard error, minute and speed.
fn warm_friction(row: &EngineRow, columns: [&str; 4]) -> sqlx::Result<Option<WarmFriction>> {
    let [torque, std_error, minute, speed_fraction] =
        columns.map(|column| row.try_get::<Option<f64>, _>(column));
    Ok(match (torque?, std_error?, minute?, speed_fraction?) {
        (Some(torque), std_error, Some(minute), Some(speed_fraction)) => {
            Some(WarmFriction { torque, std_error: std_error.unwrap_or(f64::NAN), minute, speed_fraction })
        }
        _ => None,
    })
}
