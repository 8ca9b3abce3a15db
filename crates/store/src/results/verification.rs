//! Self-verification of a run's stored cycles: differences of estimated and measured torque.

use sqlx::Row;

use crate::engine::{EngineExecutor, EngineRow};
use crate::error::StoreError;
use crate::handle::Store;
use crate::values::{joint, named, size};
use armwatch_model::analysis::{Rmsd, RmsdPair, RmsdScope, TorqueRmsd, WarmingContrast};
use armwatch_model::run::Stage;

/// State of a cycle in the ledger.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleState {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// Rows of the cycle in the export.
    pub rows: usize,
    /// Cut-off of the analysis low-pass, Hz; `None` for a cycle that could not be filtered.
    pub cutoff: Option<f64>,
    /// Reason if the cycle has no parameters.
    pub reason: Option<String>,
    /// Remarks on the cycle, one per line.
    pub remarks: Option<String>,
    /// Fate of its factors, if it had separate ones and has none any more.
    pub factors_gone: Option<FactorsGone>,
}

armwatch_model::named_enum! {
    /// Fate of the factors of a cycle.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum FactorsGone {
        /// They are part of the factors of its log.
        Joined = "joined",
        /// They were removed after the retention time.
        Removed = "removed",
    }
}

/// A value of a cycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OfCycle<T> {
    /// Number of the cycle, from 1.
    pub cycle: u32,
    /// The value.
    pub value: T,
}

impl Store {
    /// States of the cycles of a run, in order.
    pub async fn cycle_states(&self, run_id: i64) -> Result<Vec<CycleState>, StoreError> {
        self.checked(cycle_states(&self.readers, run_id).await)
    }

    /// RMSD of a run's cycles with their own parameters, by cycle, joint and stage.
    pub async fn self_rmsd(&self, run_id: i64) -> Result<Vec<OfCycle<TorqueRmsd>>, StoreError> {
        self.checked(self_rmsd(&self.readers, run_id).await)
    }

    /// RMSD over the first and over the last third of the warming stages of a run, by cycle and joint.
    pub async fn warming_contrasts(&self, run_id: i64) -> Result<Vec<OfCycle<WarmingContrast>>, StoreError> {
        self.checked(warming_contrasts(&self.readers, run_id).await)
    }
}

/// All cycles of a run, in order.
pub(crate) async fn cycle_states(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<CycleState>> {
    sqlx::query(
        "SELECT number, rows, cutoff_hz, reason, remarks, factors_gone FROM cycle WHERE run_id = $1 ORDER BY number",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        Ok(CycleState {
            cycle: size(&row, "number")?,
            rows: size(&row, "rows")?,
            cutoff: row.try_get("cutoff_hz")?,
            reason: row.try_get("reason")?,
            remarks: row.try_get("remarks")?,
            factors_gone: match row.try_get::<Option<&str>, _>("factors_gone")? {
                Some(_) => Some(named(&row, "factors_gone", &FactorsGone::ALL, FactorsGone::name)?),
                None => None,
            },
        })
    })
    .fetch_all(executor)
    .await
}

/// RMSD of a run's cycles with their own parameters, by cycle, joint and stage.
pub(crate) async fn self_rmsd(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<OfCycle<TorqueRmsd>>> {
    const SCOPES: [RmsdScope; 4] = [
        RmsdScope::Stage(Stage::Excitation),
        RmsdScope::Stage(Stage::Friction),
        RmsdScope::Stage(Stage::Warming),
        RmsdScope::WholeCycle,
    ];
    sqlx::query(
        "SELECT cycle, joint, stage, rmsd_nm, relative_rmsd, moving_rmsd_nm, moving_relative_rmsd, samples,
                moving_samples
         FROM cycle_rmsd
         WHERE run_id = $1 AND verification = 'self'
         ORDER BY cycle, joint, CASE stage WHEN 'excitation' THEN 1 WHEN 'friction' THEN 2
                                           WHEN 'warming' THEN 3 ELSE 4 END",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let RmsdPair { all_rows, moving_rows } = pair(&row, "")?;
        let scope = named(&row, "stage", &SCOPES, RmsdScope::name)?;
        let value = TorqueRmsd { joint: joint(&row, "joint")?, scope, all_rows, moving_rows };
        Ok(OfCycle { cycle: size(&row, "cycle")?, value })
    })
    .fetch_all(executor)
    .await
}

/// Contrast of start and end of the warming stages of a run's cycles, by cycle and joint.
pub(crate) async fn warming_contrasts(
    executor: impl EngineExecutor<'_>,
    run_id: i64,
) -> sqlx::Result<Vec<OfCycle<WarmingContrast>>> {
    sqlx::query(
        "SELECT cycle, joint, start_rmsd_nm, end_rmsd_nm, start_relative_rmsd, end_relative_rmsd,
                start_moving_rmsd_nm, end_moving_rmsd_nm, start_moving_relative_rmsd,
                end_moving_relative_rmsd, start_samples, end_samples, start_moving_samples,
                end_moving_samples
         FROM warming_contrast
         WHERE run_id = $1
         ORDER BY cycle, joint",
    )
    .bind(run_id)
    .try_map(|row: EngineRow| {
        let (start, end) = (pair(&row, "start_")?, pair(&row, "end_")?);
        let value = WarmingContrast { joint: joint(&row, "joint")?, start, end };
        Ok(OfCycle { cycle: size(&row, "cycle")?, value })
    })
    .fetch_all(executor)
    .await
}

/// Reads the six columns of a deviation, whose names begin with `prefix`.
fn pair(row: &EngineRow, prefix: &str) -> sqlx::Result<RmsdPair> {
    let rows = |motion: &str| -> sqlx::Result<Rmsd> {
        let figure = |name: &str| -> sqlx::Result<f64> {
            let value: Option<f64> = row.try_get(format!("{prefix}{motion}{name}").as_str())?;
            Ok(value.unwrap_or(f64::NAN))
        };
        let samples = size(row, &format!("{prefix}{motion}samples"))?;
        if samples == 0 {
            return Ok(Rmsd::default());
        }
        Ok(Rmsd { value: figure("rmsd_nm")?, relative: figure("relative_rmsd")?, samples })
    };
    Ok(RmsdPair { all_rows: rows("")?, moving_rows: rows("moving_")? })
}
