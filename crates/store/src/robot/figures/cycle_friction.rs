//! Friction of each joint in each cycle as one number, and the meaning of a run's mean parameters.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};
use sqlx::Row;

use crate::engine::{EngineExecutor, EngineRow};
use crate::values::{grouping_terms, joint, parameter, size};
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::anomaly::{CycleSeries, RunParameter};
use armwatch_model::robot::{ParameterId, ParameterKind};

/// Friction of each cycle and joint of a run, in the order of cycles and joints.
pub(in crate::robot) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<CycleSeries>> {
    sqlx::query(
        "SELECT cycle.number AS cycle, level.joint, level.minute, level.ln_torque, level.offset_nm, level.levels,
                level.speed_fraction
         FROM cycle
         JOIN cycle_friction_level AS level USING (cycle_id)
         WHERE cycle.run_id = $1
         ORDER BY cycle.number, level.joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let friction = CycleFriction {
            joint: joint(&row, "joint")?,
            minute: row.try_get("minute")?,
            ln_torque: row.try_get("ln_torque")?,
            offset: row.try_get("offset_nm")?,
            levels: size(&row, "levels")?,
            speed_fraction: row.try_get("speed_fraction")?,
        };
        Ok(CycleSeries { cycle: size(&row, "cycle")?, friction })
    })
    .fetch_all(executor)
    .await
}

/// The mean of a parameter over the cycles of a test.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(in crate::robot) struct MeanParameter {
    /// Key of the parameter.
    pub(in crate::robot) model_parameter_id: i64,
    /// Mean, in its SI unit.
    pub(super) mean: f64,
    /// Standard deviation of one cycle; NaN with one cycle.
    pub(super) std_dev: f64,
    /// Number of cycles.
    pub(in crate::robot) cycles: u32,
}

/// Meaning of the inertial parameters of all descriptions, by key.
pub(in crate::robot) struct Inertial(HashMap<i64, (ParameterId, Vec<(f64, ParameterId)>)>);

/// Reads the meaning of the inertial parameters of all descriptions.
pub(in crate::robot) async fn inertial(executor: impl EngineExecutor<'_>) -> sqlx::Result<Inertial> {
    let rows = sqlx::query("SELECT model_parameter_id, joint, name, grouping FROM model_parameter")
        .try_map(|row: EngineRow| {
            let grouping: Option<String> = row.try_get("grouping")?;
            let terms = grouping.map(|text| grouping_terms(&text)).unwrap_or_default();
            Ok((row.try_get::<i64, _>("model_parameter_id")?, (parameter(&row, "joint", "name")?, terms)))
        })
        .fetch_all(executor)
        .await?;
    let is_inertial = |(_, (id, _)): &(i64, (ParameterId, _))| matches!(id.kind, ParameterKind::Inertial(_));
    Ok(Inertial(rows.into_iter().filter(is_inertial).collect()))
}

impl Inertial {
    /// Means of a run's inertial parameters, in natural order.
    pub(in crate::robot) fn of_run(&self, means: &[MeanParameter]) -> Vec<RunParameter> {
        let of = |mean: &MeanParameter| {
            let (id, terms) = self.0.get(&mean.model_parameter_id)?;
            let MeanParameter { mean, std_dev, cycles, .. } = *mean;
            Some(RunParameter { id: *id, mean, std_dev, cycles, terms: terms.clone() })
        };
        let mut found: Vec<RunParameter> = means.iter().filter_map(of).collect();
        found.sort_by_key(|parameter| parameter.id);
        found
    }
}
