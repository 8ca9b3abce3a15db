//! Findings from a history of any length, of which a window of tests is read.

use std::collections::HashSet;
use std::time::Duration;

use jiff::Timestamp;

use super::in_brief::detected;
use armwatch_method::detect::runs::window::basis;
use armwatch_method::detect::window::{Lengths, is_over, next, put_together};
use armwatch_model::anomaly::peer::Peer;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::settled::Settled;
use armwatch_model::anomaly::{Anomaly, Findings, RunSummary};
use armwatch_model::run::RunKind;
use armwatch_store::{ConclusionTransaction, StoreError};

/// What a history says, and what it took.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Judged {
    /// What is not settled of it.
    pub findings: Findings,
    /// What was settled now: by the key of what settles them, anomalies that ended before a boundary.
    pub settled: Vec<(i64, Vec<Anomaly>)>,
    /// What is settled at the boundary in force.
    pub at: Settled,
    /// Tests that the detectors had, of all windows.
    pub tests: usize,
    /// Tests whose cycles were read.
    pub read: usize,
    /// Time of the detectors.
    pub computing: Duration,
    /// Start of the first test that was left out.
    left_out: Option<Timestamp>,
}

/// Judges the history of a robot: one window, and before it those whose boundary came into force since, or that something has
/// changed in. `known` are the tests that count; `None` where all do. What is settled follows from these, so that the robot
/// has to be [released](release) where some were left out.
///
/// # Errors
/// Those of the store.
pub async fn judged(
    conclusion: &mut ConclusionTransaction,
    known: Option<&HashSet<i64>>,
    peers: &[Peer],
    settings: &DetectSettings,
    lengths: &Lengths,
) -> Result<Judged, StoreError> {
    let basis = basis(settings, peers, lengths);
    let mut judged = Judged { at: conclusion.settled(RunKind::Test, basis).await?, ..Judged::default() };
    loop {
        let most = lengths.most_behind(&judged.at);
        let (mut tests, left_out) = window(conclusion, &judged.at, most, known).await?;
        judged.left_out = judged.left_out.into_iter().chain(left_out).min();
        let found = detected(conclusion, &mut tests, peers, settings).await?;
        judged.tests += tests.len();
        judged.read += found.read;
        judged.computing += found.computing;
        let anomalies = put_together(&judged.at, &tests, found.findings.anomalies, lengths);
        if !is_over(&judged.at, &tests, lengths) {
            judged.findings = Findings { anomalies, ..found.findings };
            return Ok(judged);
        }
        let (next, ended) = next(&judged.at, &tests, &anomalies, lengths);
        let key = conclusion.keep_settled(RunKind::Test, &next, basis).await?;
        judged.settled.push((key, ended));
        judged.at = next;
    }
}

/// Forgets what was settled without tests that were left out. Call when findings are stored.
///
/// # Errors
/// Those of the store.
pub async fn release(conclusion: &mut ConclusionTransaction, judged: &Judged) -> Result<(), StoreError> {
    match judged.left_out {
        Some(from) => conclusion.unsettle(from).await,
        None => Ok(()),
    }
}

/// Tests of a window that are known, at most `most` behind those that it names, and the start of the first one that is not.
async fn window(
    conclusion: &mut ConclusionTransaction,
    settled: &Settled,
    most: usize,
    known: Option<&HashSet<i64>>,
) -> Result<(Vec<RunSummary>, Option<Timestamp>), StoreError> {
    let mut asked = most;
    loop {
        let mut tests = conclusion.window(settled, asked).await?;
        let Some(known) = known else { return Ok((tests, None)) };
        let all = tests.len();
        let left_out = tests.iter().find(|of| !known.contains(&of.run_id)).map(|of| of.started_at);
        tests.retain(|of| known.contains(&of.run_id));
        let are_all = all < settled.read.len() + asked;
        if are_all || tests.len() >= settled.read.len() + most {
            tests.truncate(settled.read.len() + most);
            return Ok((tests, left_out));
        }
        asked += all - tests.len();
    }
}
