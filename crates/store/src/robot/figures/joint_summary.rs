//! What a test comes to for each joint, as rows and as bytes.

use sqlx::Row;

use super::packed::{Reader, add_joint, add_numbers};
use crate::engine::{EngineExecutor, EngineRow};
use crate::values::{joint, size};
use armwatch_model::analysis::{Estimate, JointSummary, RmsdSwing, WarmFriction};

/// A joint's summary with the estimator of its torque deviations.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::robot) struct SummaryRow {
    pub(in crate::robot) summary: JointSummary,
    pub(in crate::robot) estimator: Option<String>,
}

impl SummaryRow {
    /// The summary beside tests whose latest torque deviations are those of `estimator`: those of another one do not
    /// compare.
    pub(in crate::robot) fn among(self, estimator: Option<&str>) -> JointSummary {
        match self.estimator.as_deref() == estimator {
            true => self.summary,
            false => JointSummary { relative_rmsd: None, rmsd_swing: None, ..self.summary },
        }
    }
}

/// Summaries of a run with the friction index that was stored last, by joint.
pub(in crate::robot) async fn of_run(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> Result<Vec<SummaryRow>, sqlx::Error> {
    sqlx::query(
        "SELECT summary.joint, summary.warm_friction_nm, summary.warm_friction_std_error_nm, summary.warm_minute,
                summary.warm_speed_fraction, summary.excitation_friction_nm,
                summary.excitation_friction_std_error_nm, summary.excitation_minute,
                summary.excitation_speed_fraction, summary.relative_rmsd, summary.rmsd_swing,
                summary.rmsd_swing_cycles, summary.relative_noise, summary.torque_rms_nm, summary.estimator,
                found.friction_index, found.friction_index_std_error
         FROM run_joint_summary AS summary
         LEFT JOIN run_friction_index AS found ON found.run_id = summary.run_id AND found.joint = summary.joint
         WHERE summary.run_id = $1
         ORDER BY summary.joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(SummaryRow { summary: of_row(&row)?, estimator: row.try_get("estimator")? })
    })
    .fetch_all(executor)
    .await
}

/// Reads the columns of a summary and of its friction index.
pub(in crate::robot) fn of_row(row: &EngineRow) -> Result<JointSummary, sqlx::Error> {
    let warm = ["warm_friction_nm", "warm_friction_std_error_nm", "warm_minute", "warm_speed_fraction"];
    let excitation = [
        "excitation_friction_nm",
        "excitation_friction_std_error_nm",
        "excitation_minute",
        "excitation_speed_fraction",
    ];
    let std_error: Option<f64> = row.try_get("friction_index_std_error")?;
    let friction_index = row
        .try_get::<Option<f64>, _>("friction_index")?
        .map(|value| Estimate { value, std_error: std_error.unwrap_or(f64::NAN) });
    let rmsd_swing = match row.try_get("rmsd_swing")? {
        Some(value) => Some(RmsdSwing { value, cycles: size(row, "rmsd_swing_cycles")? }),
        None => None,
    };
    Ok(JointSummary {
        joint: joint(row, "joint")?,
        warm_friction: warm_friction(row, warm)?,
        excitation_friction: warm_friction(row, excitation)?,
        friction_index,
        relative_rmsd: row.try_get("relative_rmsd")?,
        rmsd_swing,
        relative_noise: row.try_get("relative_noise")?,
        torque_rms: row.try_get("torque_rms_nm")?,
    })
}

/// Reads friction of a run: columns of torque, standard error, minute and speed.
fn warm_friction(row: &EngineRow, columns: [&str; 4]) -> Result<Option<WarmFriction>, sqlx::Error> {
    let [torque, std_error, minute, speed_fraction] =
        columns.map(|column| row.try_get::<Option<f64>, _>(column));
    Ok(match (torque?, std_error?, minute?, speed_fraction?) {
        (Some(torque), std_error, Some(minute), Some(speed_fraction)) => {
            Some(WarmFriction { torque, std_error: std_error.unwrap_or(f64::NAN), minute, speed_fraction })
        }
        _ => None,
    })
}

/// Bits that say which figures follow.
const WARM: u8 = 1;
const EXCITATION: u8 = 2;
const INDEX: u8 = 4;
const RMSD: u8 = 8;
const SWING: u8 = 16;
const ESTIMATOR: u8 = 32;
const NOISE: u8 = 64;
const TORQUE: u8 = 128;

/// Adds the joint, which figures it has, and these.
pub(in crate::robot) fn pack(bytes: &mut Vec<u8>, row: &SummaryRow) {
    let JointSummary {
        joint,
        warm_friction,
        excitation_friction,
        friction_index,
        relative_rmsd,
        rmsd_swing,
        relative_noise,
        torque_rms,
    } = row.summary;
    let bit = |bit: u8, is_there: bool| if is_there { bit } else { 0 };
    add_joint(bytes, joint);
    bytes.push(
        bit(WARM, warm_friction.is_some())
            | bit(EXCITATION, excitation_friction.is_some())
            | bit(INDEX, friction_index.is_some())
            | bit(RMSD, relative_rmsd.is_some())
            | bit(SWING, rmsd_swing.is_some())
            | bit(ESTIMATOR, row.estimator.is_some())
            | bit(NOISE, relative_noise.is_some())
            | bit(TORQUE, torque_rms.is_some()),
    );
    for WarmFriction { torque, std_error, minute, speed_fraction } in
        warm_friction.iter().chain(&excitation_friction).copied()
    {
        add_numbers(bytes, [torque, std_error, minute, speed_fraction]);
    }
    if let Some(Estimate { value, std_error }) = friction_index {
        add_numbers(bytes, [value, std_error]);
    }
    if let Some(rmsd) = relative_rmsd {
        add_numbers(bytes, [rmsd]);
    }
    if let Some(RmsdSwing { value, cycles }) = rmsd_swing {
        add_numbers(bytes, [value, cycles as f64]);
    }
    for figure in relative_noise.iter().chain(&torque_rms) {
        add_numbers(bytes, [*figure]);
    }
    if let Some(name) = &row.estimator {
        // names of estimators are short words
        let name = &name.as_bytes()[..name.len().min(usize::from(u8::MAX))];
        bytes.push(u8::try_from(name.len()).unwrap_or(u8::MAX));
        bytes.extend(name);
    }
}

/// What [`pack`] added.
pub(super) fn unpack(reader: &mut Reader<'_>) -> Option<SummaryRow> {
    let joint = reader.joint()?;
    let bits = reader.u8()?;
    let mut friction = |bit: u8| -> Option<Option<WarmFriction>> {
        if bits & bit == 0 {
            return Some(None);
        }
        let [torque, std_error, minute, speed_fraction] = reader.numbers()?;
        Some(Some(WarmFriction { torque, std_error, minute, speed_fraction }))
    };
    let (warm_friction, excitation_friction) = (friction(WARM)?, friction(EXCITATION)?);
    let (mut friction_index, mut relative_rmsd, mut rmsd_swing, mut estimator) = (None, None, None, None);
    if bits & INDEX != 0 {
        let [value, std_error] = reader.numbers()?;
        friction_index = Some(Estimate { value, std_error });
    }
    if bits & RMSD != 0 {
        relative_rmsd = Some(reader.f64()?);
    }
    if bits & SWING != 0 {
        let [value, cycles] = reader.numbers()?;
        rmsd_swing = Some(RmsdSwing { value, cycles: cycles as usize });
    }
    let relative_noise = if bits & NOISE != 0 { Some(reader.f64()?) } else { None };
    let torque_rms = if bits & TORQUE != 0 { Some(reader.f64()?) } else { None };
    if bits & ESTIMATOR != 0 {
        let length = usize::from(reader.u8()?);
        estimator = Some(std::str::from_utf8(reader.bytes(length)?).ok()?.to_owned());
    }
    let summary = JointSummary {
        joint,
        warm_friction,
        excitation_friction,
        friction_index,
        relative_rmsd,
        rmsd_swing,
        relative_noise,
        torque_rms,
    };
    Some(SummaryRow { summary, estimator })
}

#[cfg(test)]
mod tests {
    use super::*;
    use armwatch_model::robot::JointIndex;

    #[test]
    fn any_choice_of_figures_comes_back() {
        let warm = WarmFriction { torque: 1.0 / 3.0, std_error: 0.1, minute: 60.0, speed_fraction: 0.6 };
        for bits in 0..=u8::MAX {
            let is = |bit: u8| bits & bit != 0;
            let summary = JointSummary {
                joint: JointIndex::new(3),
                warm_friction: is(WARM).then_some(warm),
                excitation_friction: is(EXCITATION).then_some(WarmFriction { torque: 2.0, ..warm }),
                friction_index: is(INDEX).then_some(Estimate { value: 1.1, std_error: 0.01 }),
                relative_rmsd: is(RMSD).then_some(0.07),
                rmsd_swing: is(SWING).then_some(RmsdSwing { value: 0.002, cycles: 24 }),
                relative_noise: is(NOISE).then_some(0.013),
                torque_rms: is(TORQUE).then_some(31.0),
            };
            let row = SummaryRow { summary, estimator: is(ESTIMATOR).then(|| "weighted".to_owned()) };
            let mut bytes = Vec::new();
            pack(&mut bytes, &row);
            let mut reader = Reader(&bytes);
            assert_eq!(unpack(&mut reader), Some(row), "{bits}");
            assert!(reader.0.is_empty());
            assert_eq!(unpack(&mut Reader(&bytes[..bytes.len() - 1])), None);
        }
    }
}
