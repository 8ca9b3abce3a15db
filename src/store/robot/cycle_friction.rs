//! Friction of each joint in each cycle as one number, and mean parameters of a run: what detectors compare over cycles
//! and runs.

use std::collections::HashMap;

use sqlx::Row;
use sqlx::sqlite::{SqliteExecutor, SqliteRow};

use crate::analysis::friction::CycleFriction;
use crate::anomaly::{CycleSeries, RunParameter};
use crate::robot::{ParameterId, ParameterKind};
use crate::store::values::{joint, parameter, size, standard_parameter};

/// Friction of each cycle and joint of the robot's complete tests, by run, in the order of cycles and joints.
pub(in crate::store) async fn by_run(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
) -> Result<HashMap<i64, Vec<CycleSeries>>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT run.run_id, cycle.number AS cycle, level.joint, level.minute, level.ln_torque, level.offset_nm,
                level.levels, level.speed_fraction
         FROM run
         JOIN cycle USING (run_id)
         JOIN cycle_friction_level AS level USING (cycle_id)
         WHERE run.robot_id = ? AND run.kind = 'test' AND run.status = 'complete'
         ORDER BY run.run_id, cycle.number, level.joint",
    )
    .bind(robot_id)
    .try_map(|row: SqliteRow| {
        let friction = CycleFriction {
            joint: joint(&row, "joint")?,
            minute: row.try_get("minute")?,
            ln_torque: row.try_get("ln_torque")?,
            offset: row.try_get("offset_nm")?,
            levels: size(&row, "levels")?,
            speed_fraction: row.try_get("speed_fraction")?,
        };
        Ok((row.try_get("run_id")?, CycleSeries { cycle: size(&row, "cycle")?, friction }))
    })
    .fetch_all(executor)
    .await?;
    let mut runs: HashMap<i64, Vec<CycleSeries>> = HashMap::new();
    for (run_id, of) in rows {
        runs.entry(run_id).or_default().push(of);
    }
    Ok(runs)
}

/// Mean inertial parameters of the robot's complete tests, by run, in natural order.
pub(in crate::store) async fn parameters_by_run(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
) -> Result<HashMap<i64, Vec<RunParameter>>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT run.run_id, of.mean, of.sdv, of.cycles, model_parameter.joint, model_parameter.name,
                model_parameter.grouping
         FROM run
         JOIN parameter_statistic AS of USING (run_id)
         JOIN model_parameter USING (model_parameter_id)
         WHERE run.robot_id = ? AND run.kind = 'test' AND run.status = 'complete' AND of.\"window\" = 'all'",
    )
    .bind(robot_id)
    .try_map(|row: SqliteRow| {
        let grouping: Option<String> = row.try_get("grouping")?;
        let of = RunParameter {
            id: parameter(&row, "joint", "name")?,
            mean: row.try_get("mean")?,
            std_dev: row.try_get::<Option<f64>, _>("sdv")?.unwrap_or(f64::NAN),
            cycles: size(&row, "cycles")?,
            terms: grouping.map(|text| terms(&text)).unwrap_or_default(),
        };
        Ok((row.try_get::<i64, _>("run_id")?, of))
    })
    .fetch_all(executor)
    .await?;
    let mut runs: HashMap<i64, Vec<RunParameter>> = HashMap::new();
    for (run_id, of) in rows.into_iter().filter(|(_, of)| matches!(of.id.kind, ParameterKind::Inertial(_))) {
        runs.entry(run_id).or_default().push(of);
    }
    runs.values_mut().for_each(|of| of.sort_by_key(|parameter| parameter.id));
    Ok(runs)
}

/// The terms of a grouping such as `J2_mPx + 0.27 J3_m - J4_mPz`; those that are not understood are left out.
fn terms(grouping: &str) -> Vec<(f64, ParameterId)> {
    let (mut sign, mut factor) = (1.0, 1.0);
    let mut found = Vec::new();
    for word in grouping.split_whitespace() {
        if let Some(id) = standard_parameter(word) {
            found.push((sign * factor, id));
            (sign, factor) = (1.0, 1.0);
        } else if let Ok(number) = word.parse::<f64>() {
            factor = number;
        } else {
            sign = if word == "-" { -1.0 } else { 1.0 };
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::model::base_parameters::base_parameters;
    use crate::testing::er3a;

    #[test]
    fn a_grouping_is_read_as_it_is_written() {
        let base = base_parameters(&er3a()).unwrap();
        for (index, kept) in base.kept.iter().enumerate() {
            let read = terms(&base.grouping_formula(index));
            assert_eq!(read[0], (1.0, *kept));
            assert_eq!(read.len(), base.grouping[index].len() + 1);
            for ((coefficient, id), term) in read[1..].iter().zip(&base.grouping[index]) {
                assert_eq!(*id, term.id);
                assert!((coefficient - term.coefficient).abs() < 1e-5 * term.coefficient.abs());
            }
        }
    }
}
