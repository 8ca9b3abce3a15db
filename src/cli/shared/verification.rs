//! Stored verification of a run's cycles: the fit of each by its own parameters.

use crate::report::rmsd::CycleVerification;
use armwatch_store::{Store, StoreError};

/// All cycles of a run; cycles without parameters have the reason.
pub(in crate::cli) async fn verified_cycles(
    store: &Store,
    run_id: i64,
) -> Result<Vec<CycleVerification>, StoreError> {
    let rmsd = store.self_rmsd(run_id).await?;
    let contrasts = store.warming_contrasts(run_id).await?;
    let states = store.cycle_states(run_id).await?;
    let cycles = states.into_iter().map(|state| CycleVerification {
        cycle: state.cycle,
        rmsd: rmsd.iter().filter(|of| of.cycle == state.cycle).map(|of| of.value).collect(),
        contrast: contrasts.iter().filter(|of| of.cycle == state.cycle).map(|of| of.value).collect(),
        reason: state.reason,
    });
    Ok(cycles.collect())
}
