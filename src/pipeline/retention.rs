//! Applies the retention times of factors: those of tests are removed, those of production are joined into one factor
//! per joint and motion of their log.
//!
//! It works in parallel with everything else: each transaction is short, and other writers have their turn in between.
//! It can be interrupted at any moment and continues later, since each transaction leaves the database consistent.

use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use tokio_util::sync::CancellationToken;

use super::context::PipelineError;
use armwatch_config::RetentionSettings;
use armwatch_method::NumericsError;
use armwatch_method::identify::joint_factors::{FactorColumns, joined, pack, unpack};
use armwatch_model::analysis::CycleFactors;
use armwatch_model::run::RunKind;
use armwatch_store::{DueRun, KeptSince, Store, WindowsToJoin};

/// Cycles per transaction: some 10 MB of factors.
const CYCLES_AT_ONCE: usize = 200;

/// Pause after a transaction: a waiting program tries again within this time.
const PAUSE: Duration = Duration::from_millis(10);

/// The earliest time of kept factors, at the time `now`.
pub fn kept_since(settings: &RetentionSettings, now: Timestamp) -> KeptSince {
    const DAY_S: f64 = 86_400.0;
    let before = |days: f64| {
        let age = SignedDuration::try_from_secs_f64(DAY_S * days).ok()?;
        now.checked_sub(age).ok()
    };
    KeptSince {
        tests: settings.tests_days.and_then(before),
        production: settings.production_days.and_then(before),
    }
}

/// Removes or joins the factors of the runs in [`Store::due_runs`], until a `stop` is requested. Returns the completed
/// runs.
pub async fn prune(
    store: &Store,
    kept: &KeptSince,
    stop: &CancellationToken,
) -> Result<Vec<DueRun>, PipelineError> {
    let mut done = Vec::new();
    for run in store.due_runs(kept).await? {
        let pruned = match run.kind {
            RunKind::Test => remove(store, run.run_id, stop).await?,
            RunKind::Production => join(store, run.run_id, stop).await?,
        };
        if stop.is_cancelled() {
            break;
        }
        if pruned {
            done.push(run);
        }
    }
    Ok(done)
}

/// Removes the factors of a run; returns true if none is left.
async fn remove(store: &Store, run_id: i64, stop: &CancellationToken) -> Result<bool, PipelineError> {
    while !stop.is_cancelled() {
        if store.remove_factors(run_id, CYCLES_AT_ONCE).await? == 0 {
            return Ok(true);
        }
        tokio::time::sleep(PAUSE).await;
    }
    Ok(false)
}

/// Joins the windows of a log; returns true if no window has its own factor any more.
async fn join(store: &Store, run_id: i64, stop: &CancellationToken) -> Result<bool, PipelineError> {
    while !stop.is_cancelled() {
        let Some(windows) = store.windows_to_join(run_id, CYCLES_AT_ONCE).await? else { return Ok(true) };
        let of_windows = windows.clone();
        let joined = tokio::task::spawn_blocking(move || join_factors(&of_windows)).await?;
        let stored = match joined {
            Ok(factors) => store.join_windows(&windows, &factors).await?,
            Err(error) => {
                tracing::warn!(run_id, %error, "windows keep their factors, which cannot be joined");
                false
            }
        };
        if !stored {
            // another program joins it, or reads the log again: it is tried again later
            return Ok(false);
        }
        tokio::time::sleep(PAUSE).await;
    }
    Ok(false)
}

fn join_factors(windows: &WindowsToJoin) -> Result<CycleFactors, NumericsError> {
    let columns = FactorColumns::of_stored(&windows.columns);
    let (of_columns, factors) = (windows.columns.clone(), windows.factors.clone());
    let factors = unpack(&CycleFactors { columns: of_columns, factors })?;
    let (packed, is_whole) = pack(&columns, &joined(&columns, &factors));
    if is_whole { Ok(packed) } else { Err(NumericsError::NotFinite("the joined factors")) }
}
