//! What detectors compare over the cycles of a complete test, in one row: of a thousand tests with 24 cycles and six joints,
//! a thousand rows are read in place of three hundred thousand.
//!
//! The row follows from other tables and says nothing that they do not. Triggers take it away when one of them changes
//! (migration 0037); where it is not there, or of another format, the tables are asked.

use std::collections::HashMap;

use sqlx::sqlite::{SqliteExecutor, SqliteRow};
use sqlx::{Row, SqliteConnection};

use super::cycle_friction::MeanParameter;
use super::{cycle_friction, cycle_rmsd};
use crate::analysis::friction::CycleFriction;
use crate::analysis::measurements::CycleRmsd;
use crate::anomaly::CycleSeries;
use crate::robot::JointIndex;
use crate::store::values::size;

/// First byte of the numbers; other values are of another format.
const FORMAT: u8 = 1;

/// What is compared over the cycles of a test.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct RunSeries {
    /// Friction of each cycle and joint, in this order.
    pub(super) friction: Vec<CycleSeries>,
    /// Moving relative RMSD of each cycle and joint, in this order.
    pub(super) rmsd: Vec<CycleRmsd>,
    /// Means of parameters over the cycles.
    pub(super) parameters: Vec<MeanParameter>,
}

/// The series of a robot's complete tests, by run.
pub(super) async fn by_run(
    connection: &mut SqliteConnection,
    robot_id: i64,
) -> Result<HashMap<i64, RunSeries>, sqlx::Error> {
    let rows = sqlx::query(
        "SELECT run.run_id, numbers
         FROM run
         LEFT JOIN run_series USING (run_id)
         WHERE robot_id = ? AND kind = 'test' AND status = 'complete'",
    )
    .bind(robot_id)
    .try_map(|row: SqliteRow| {
        let numbers: Option<&[u8]> = row.try_get("numbers")?;
        Ok((row.try_get::<i64, _>("run_id")?, numbers.and_then(unpacked)))
    })
    .fetch_all(&mut *connection)
    .await?;
    let mut found = HashMap::with_capacity(rows.len());
    for (run_id, series) in rows {
        let series = match series {
            Some(series) => series,
            None => of_run(&mut *connection, run_id).await?,
        };
        found.insert(run_id, series);
    }
    Ok(found)
}

/// Writes the series of the robot's complete tests that have none. Call in a transaction, when all cycles have their
/// friction levels.
pub(super) async fn complete(connection: &mut SqliteConnection, robot_id: i64) -> Result<(), sqlx::Error> {
    for run_id in without(&mut *connection, robot_id).await? {
        let series = of_run(&mut *connection, run_id).await?;
        sqlx::query("INSERT INTO run_series (run_id, numbers) VALUES (?, ?)")
            .bind(run_id)
            .bind(packed(&series))
            .execute(&mut *connection)
            .await?;
    }
    Ok(())
}

/// Complete tests of a robot without a series: those that have changed since conclusions were drawn.
pub(super) async fn without(
    executor: impl SqliteExecutor<'_>,
    robot_id: i64,
) -> Result<Vec<i64>, sqlx::Error> {
    sqlx::query_scalar(
        "SELECT run_id FROM run
         WHERE robot_id = ? AND kind = 'test' AND status = 'complete'
               AND NOT EXISTS (SELECT 1 FROM run_series WHERE run_series.run_id = run.run_id)
         ORDER BY started_at, run_id",
    )
    .bind(robot_id)
    .fetch_all(executor)
    .await
}

/// The series of a run as the tables have it.
async fn of_run(connection: &mut SqliteConnection, run_id: i64) -> Result<RunSeries, sqlx::Error> {
    Ok(RunSeries {
        friction: cycle_friction::of_run(&mut *connection, run_id).await?,
        rmsd: cycle_rmsd::of_run(&mut *connection, run_id).await?,
        parameters: parameters(connection, run_id).await?,
    })
}

async fn parameters(
    executor: impl SqliteExecutor<'_>,
    run_id: i64,
) -> Result<Vec<MeanParameter>, sqlx::Error> {
    sqlx::query(
        // one cycle has no scatter
        "SELECT model_parameter_id, mean, cycles,
                ifnull(sdv, (SELECT of_cycle.std_error FROM cycle_parameter AS of_cycle JOIN cycle USING (cycle_id)
                             WHERE cycle.run_id = parameter_statistic.run_id AND parameter_statistic.cycles = 1
                                   AND of_cycle.model_parameter_id = parameter_statistic.model_parameter_id
                                   AND cycle.status = 'complete' AND NOT cycle.doubtful)) AS sdv
         FROM parameter_statistic
         WHERE run_id = ? AND \"window\" = 'all'
         ORDER BY model_parameter_id",
    )
    .bind(run_id)
    .try_map(|row: SqliteRow| {
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

/// The format, the three counts, then the rows of each; all numbers little-endian.
fn packed(series: &RunSeries) -> Vec<u8> {
    let RunSeries { friction, rmsd, parameters } = series;
    let mut bytes = vec![FORMAT];
    for length in [friction.len(), rmsd.len(), parameters.len()] {
        bytes.extend(u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
    }
    for CycleSeries { cycle, friction } in friction {
        add_place(&mut bytes, *cycle, friction.joint);
        bytes.extend(friction.levels.to_le_bytes());
        for number in [friction.minute, friction.ln_torque, friction.offset, friction.speed_fraction] {
            bytes.extend(number.to_le_bytes());
        }
    }
    for of in rmsd {
        add_place(&mut bytes, of.cycle, of.joint);
        bytes.extend(of.relative_rmsd.to_le_bytes());
    }
    for of in parameters {
        bytes.extend(of.model_parameter_id.to_le_bytes());
        bytes.extend(of.mean.to_le_bytes());
        bytes.extend(of.std_dev.to_le_bytes());
        bytes.extend(of.cycles.to_le_bytes());
    }
    bytes
}

fn add_place(bytes: &mut Vec<u8>, cycle: u32, joint: JointIndex) {
    bytes.extend(cycle.to_le_bytes());
    // an arm has nine joints at most
    bytes.push(u8::try_from(joint.number()).unwrap_or(u8::MAX));
}

/// `None` for bytes of another format.
fn unpacked(bytes: &[u8]) -> Option<RunSeries> {
    let mut reader = Reader(bytes);
    let [FORMAT] = reader.take()? else { return None };
    let lengths = [reader.u32()?, reader.u32()?, reader.u32()?];
    let friction = (0..lengths[0]).map(|_| {
        let (cycle, joint) = reader.place()?;
        let levels = reader.u32()?;
        let [minute, ln_torque, offset, speed_fraction] =
            [reader.f64()?, reader.f64()?, reader.f64()?, reader.f64()?];
        let friction = CycleFriction { joint, minute, ln_torque, offset, levels, speed_fraction };
        Some(CycleSeries { cycle, friction })
    });
    let friction = friction.collect::<Option<Vec<_>>>()?;
    let rmsd = (0..lengths[1]).map(|_| {
        let (cycle, joint) = reader.place()?;
        Some(CycleRmsd { cycle, joint, relative_rmsd: reader.f64()? })
    });
    let rmsd = rmsd.collect::<Option<Vec<_>>>()?;
    let parameters = (0..lengths[2]).map(|_| {
        Some(MeanParameter {
            model_parameter_id: i64::from_le_bytes(reader.take()?),
            mean: reader.f64()?,
            std_dev: reader.f64()?,
            cycles: reader.u32()?,
        })
    });
    let parameters = parameters.collect::<Option<Vec<_>>>()?;
    reader.0.is_empty().then_some(RunSeries { friction, rmsd, parameters })
}

/// Bytes that are read from their front.
struct Reader<'b>(&'b [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn place(&mut self) -> Option<(u32, JointIndex)> {
        let cycle = self.u32()?;
        let [joint] = self.take()?;
        Some((cycle, JointIndex::from_number(usize::from(joint))?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let series = RunSeries {
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
        assert_eq!(bytes.len(), 13 + 3 * 41 + 13 + 2 * 28);
        assert_eq!(unpacked(&bytes), Some(series));
        assert_eq!(unpacked(&bytes[..bytes.len() - 1]), None);
        assert_eq!(unpacked(&[&bytes[..], &[0]].concat()), None);
        assert_eq!(unpacked(&[2]), None);
        assert_eq!(unpacked(&[FORMAT, 255, 255, 255, 255, 0, 0, 0, 0, 0, 0, 0, 0]), None);
        assert_eq!(unpacked(&packed(&RunSeries::default())), Some(RunSeries::default()));
    }
}
