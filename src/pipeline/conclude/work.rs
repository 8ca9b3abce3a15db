//! Findings from the logs of ordinary work of a robot, of which a window is read.

use std::time::{Duration, Instant};

use armwatch_method::detect::production::detect_production;
use armwatch_method::detect::production::window::{basis, work_logs};
use armwatch_method::detect::window::{Lengths, is_over, next, put_together};
use armwatch_model::analysis::Estimator;
use armwatch_model::anomaly::Anomaly;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::settled::Settled;
use armwatch_model::run::RunKind;
use armwatch_store::{ConclusionTransaction, StoreError};

/// What logs say, and what it took.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct JudgedWork {
    /// What is not settled of it.
    pub anomalies: Vec<Anomaly>,
    /// What was settled now: by the key of what settles them, anomalies that ended before a boundary.
    pub settled: Vec<(i64, Vec<Anomaly>)>,
    /// What is settled at the boundary in force.
    pub at: Settled,
    /// Logs that the detectors had, of all windows.
    pub logs: usize,
    /// Time of the detectors.
    pub computing: Duration,
}

/// Judges the ordinary work of a robot: one window, and before it those whose boundary came into force since, or that something has
/// changed in. `estimator` is that of the tests that logs are held against.
///
/// # Errors
/// Those of the store.
pub async fn judged_work(
    conclusion: &mut ConclusionTransaction,
    estimator: Estimator,
    settings: &DetectSettings,
    lengths: &Lengths,
) -> Result<JudgedWork, StoreError> {
    let basis = basis(settings, estimator, lengths);
    let at = conclusion.settled(RunKind::Production, basis).await?;
    let mut judged = JudgedWork { at, ..JudgedWork::default() };
    loop {
        let history = conclusion.work_window(&judged.at, lengths.most_behind(&judged.at)).await?;
        let logs = work_logs(&history);
        let began = Instant::now();
        let found = detect_production(&history, settings);
        judged.computing += began.elapsed();
        judged.logs += logs.len();
        let anomalies = put_together(&judged.at, &logs, found, lengths);
        if !is_over(&judged.at, &logs, lengths) {
            judged.anomalies = anomalies;
            return Ok(judged);
        }
        let (next, ended) = next(&judged.at, &logs, &anomalies, lengths);
        let key = conclusion.keep_settled(RunKind::Production, &next, basis).await?;
        judged.settled.push((key, ended));
        judged.at = next;
    }
}
