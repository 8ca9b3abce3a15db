//! What detectors compare of a complete test, by joint and over its cycles, in one row: of a thousand tests with 24 cycles
//! and six joints, a thousand rows are read in place of three hundred thousand.
//!
//! The row follows from other tables and says nothing that they do not. Triggers take it away when one of them changes
//! (migrations 0037 and 0038); where it is not there, or of another format, the tables are asked.

use sqlx::Row;

use super::cycle_friction::{self, MeanParameter};
use super::cycle_rmsd;
use super::joint_summary::{self, SummaryRow};
use super::packed::{Reader, add_count, add_joint, add_numbers};
use crate::engine::{EngineConnection, EngineExecutor, EngineRow};
use crate::values::size;
use armwatch_model::analysis::friction::CycleFriction;
use armwatch_model::analysis::measurements::CycleRmsd;
use armwatch_model::anomaly::CycleSeries;

/// First byte of the numbers; other values are of another format.
const FORMAT: u8 = 2;

/// What is compared of a test.
#[derive(Debug, Clone, PartialEq, Default)]
pub(in crate::robot) struct RunSeries {
    /// What the test comes to, by joint.
    pub(in crate::robot) joints: Vec<SummaryRow>,
    /// Friction of each cycle and joint, in this order.
    pub(in crate::robot) friction: Vec<CycleSeries>,
    /// Moving relative RMSD of each cycle and joint, in this order.
    pub(in crate::robot) rmsd: Vec<CycleRmsd>,
    /// Means of parameters over the cycles.
    pub(in crate::robot) parameters: Vec<MeanParameter>,
}

/// Writes the series of a complete test that has none. Call in a transaction, when all cycles have their friction levels.
pub(in crate::robot) async fn make(
    connection: &mut EngineConnection,
    run_id: i64,
) -> Result<RunSeries, sqlx::Error> {
    if let Some(series) = stored(&mut *connection, run_id).await?.as_deref().and_then(unpacked) {
        return Ok(series);
    }
    let series = of_run(&mut *connection, run_id).await?;
    sqlx::query(
        "INSERT INTO run_series (run_id, numbers) VALUES ($1, $2)
         ON CONFLICT (run_id) DO UPDATE SET numbers = excluded.numbers",
    )
    .bind(run_id)
    .bind(packed(&series))
    .execute(&mut *connection)
    .await?;
    Ok(series)
}

/// The series of a run, as it is stored or as the tables have it.
pub(in crate::robot) async fn read(
    connection: &mut EngineConnection,
    run_id: i64,
) -> Result<RunSeries, sqlx::Error> {
    let stored: Option<Vec<u8>> = stored(&mut *connection, run_id).await?;
    match stored.as_deref().and_then(unpacked) {
        Some(series) => Ok(series),
        None => of_run(connection, run_id).await,
    }
}

async fn stored(executor: impl EngineExecutor<'_>, run_id: i64) -> Result<Option<Vec<u8>>, sqlx::Error> {
    sqlx::query_scalar("SELECT numbers FROM run_series WHERE run_id = $1")
        .bind(run_id)
        .fetch_optional(executor)
        .await
}

/// The series of a run as the tables have it.
pub(in crate::robot) async fn of_run(
    connection: &mut EngineConnection,
    run_id: i64,
) -> Result<RunSeries, sqlx::Error> {
    Ok(RunSeries {
        joints: joint_summary::of_run(&mut *connection, run_id).await?,
        friction: cycle_friction::of_run(&mut *connection, run_id).await?,
        rmsd: cycle_rmsd::of_run(&mut *connection, run_id).await?,
        parameters: parameters(connection, run_id).await?,
    })
}

async fn parameters(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> Result<Vec<MeanParameter>, sqlx::Error> {
    sqlx::query(
        // one cycle has no scatter
        "SELECT model_parameter_id, mean, cycles,
                coalesce(sdv, (SELECT of_cycle.std_error FROM cycle_parameter AS of_cycle JOIN cycle USING (cycle_id)
                             WHERE cycle.run_id = parameter_statistic.run_id AND parameter_statistic.cycles = 1
                                   AND of_cycle.model_parameter_id = parameter_statistic.model_parameter_id
                                   AND cycle.status = 'complete' AND NOT cycle.doubtful
                            LIMIT 1)) AS sdv
         FROM parameter_statistic
         WHERE run_id = $1 AND \"window\" = 'all'
         ORDER BY model_parameter_id",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(MeanParameter {
            model_parameter_id: row.try_get("model_parameter_id")?,
            mean: row.try_get("mean")?,
            std_dev: row.try_get::<Option<f64>, _>("sdv")?.unwrap_or(f64::NAN),
            cycles: size(&row, "cycles")?,
        })
    })
    .fetch_all(executor)
    .await
}

/// The format, then the rows of each list behind their count.
fn packed(series: &RunSeries) -> Vec<u8> {
    let RunSeries { joints, friction, rmsd, parameters } = series;
    let mut bytes = vec![FORMAT];
    add_count(&mut bytes, joints.len());
    joints.iter().for_each(|row| joint_summary::pack(&mut bytes, row));
    add_count(&mut bytes, friction.len());
    for CycleSeries { cycle, friction } in friction {
        bytes.extend(cycle.to_le_bytes());
        add_joint(&mut bytes, friction.joint);
        bytes.extend(friction.levels.to_le_bytes());
        add_numbers(
            &mut bytes,
            [friction.minute, friction.ln_torque, friction.offset, friction.speed_fraction],
        );
    }
    add_count(&mut bytes, rmsd.len());
    for of in rmsd {
        bytes.extend(of.cycle.to_le_bytes());
        add_joint(&mut bytes, of.joint);
        add_numbers(&mut bytes, [of.relative_rmsd]);
    }
    add_count(&mut bytes, parameters.len());
    for of in parameters {
        bytes.extend(of.model_parameter_id.to_le_bytes());
        add_numbers(&mut bytes, [of.mean, of.std_dev]);
        bytes.extend(of.cycles.to_le_bytes());
    }
    bytes
}

/// `None` for bytes of another format.
pub(in crate::robot) fn unpacked(bytes: &[u8]) -> Option<RunSeries> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let joints = reader.list(joint_summary::unpack)?;
    let friction = reader.list(|reader| {
        let (cycle, joint, levels) = (reader.u32()?, reader.joint()?, reader.u32()?);
        let [minute, ln_torque, offset, speed_fraction] = reader.numbers()?;
        let friction = CycleFriction { joint, minute, ln_torque, offset, levels, speed_fraction };
        Some(CycleSeries { cycle, friction })
    })?;
    let rmsd = reader.list(|reader| {
        Some(CycleRmsd { cycle: reader.u32()?, joint: reader.joint()?, relative_rmsd: reader.f64()? })
    })?;
    let parameters = reader.list(|reader| {
        let model_parameter_id = reader.i64()?;
        let [mean, std_dev] = reader.numbers()?;
        Some(MeanParameter { model_parameter_id, mean, std_dev, cycles: reader.u32()? })
    })?;
    reader.0.is_empty().then_some(RunSeries { joints, friction, rmsd, parameters })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::analysis::JointSummary;
    use armwatch_model::robot::JointIndex;

    #[test]
    fn a_series_comes_back_to_the_last_bit() {
        let joint = JointIndex::new(5);
        let friction = CycleFriction {
            joint,
            minute: 0.1,
            ln_torque: -1.0 / 3.0,
            offset: f64::MIN_POSITIVE,
            levels: 6,
            speed_fraction: 0.8,
        };
        let summary = JointSummary {
            joint,
            warm_friction: None,
            excitation_friction: None,
            friction_index: None,
            relative_rmsd: Some(0.05),
            rmsd_swing: None,
            relative_noise: None,
            torque_rms: None,
        };
        let series = RunSeries {
            joints: vec![SummaryRow { summary, estimator: None }],
            friction: vec![CycleSeries { cycle: 70_000, friction }; 3],
            rmsd: vec![CycleRmsd { cycle: 2, joint, relative_rmsd: 0.07 }],
            parameters: vec![
                MeanParameter {
                    model_parameter_id: 1 << 40,
                    mean: 1e-300,
                    std_dev: 0.5,
                    cycles: 24
                };
                2
            ],
        };
        let bytes = packed(&series);
        assert_eq!(bytes.len(), 17 + 10 + 3 * 41 + 13 + 2 * 28);
        assert_eq!(unpacked(&bytes), Some(series));
        assert_eq!(unpacked(&bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked(&[&bytes[..], &[0]].concat()), None);
        assert_eq!(unpacked(&[1]), None);
        assert_eq!(unpacked(&[&[FORMAT], &[255; 4][..], &[0; 12]].concat()), None);
        assert_eq!(unpacked(&packed(&RunSeries::default())), Some(RunSeries::default()));
    }
}
