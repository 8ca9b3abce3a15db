//! Findings in a window of a history of any length, of tests and of production logs.
//!
//! Reading and computing hold no lock of the database. The caller stores the findings if the history has not changed in
//! the meantime.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::method::METHOD;
use crate::pipeline::context::PipelineError;
use armwatch_method::detect::production::detect_production;
use armwatch_method::detect::production::window::work_logs;
use armwatch_method::detect::runs::detect_with;
use armwatch_method::detect::runs::judgement::Kept;
use armwatch_method::detect::window::{Lengths, Windowed, is_over, next, put_together};
use armwatch_model::anomaly::peer::Peer;
use armwatch_model::anomaly::settings::DetectSettings;
use armwatch_model::anomaly::settled::{NewlySettled, Settled};
use armwatch_model::anomaly::{Anomaly, Findings};
use armwatch_model::run::RunKind;
use armwatch_model::text;
use armwatch_store::{Store, TestWindow};

/// Warning about a run of this robot that began before the first unsettled one.
pub fn too_late(robot: &str, boundary: Timestamp) -> String {
    format!(
        "it began before {}, and conclusions of {} from before that time are final: it is stored, but no \
        conclusion uses it; `armwatch conclude {} --from TIME` evaluates the history again from an earlier \
        time",
        boundary.strftime("%Y-%m-%dT%H:%MZ"),
        text::shown(robot),
        text::shown(robot)
    )
}

/// Findings from a history, and the work that they took.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WindowFindings {
    /// Findings that are not settled.
    pub findings: Findings,
    /// The parts of the history that these findings settle, oldest first.
    pub settled: Vec<NewlySettled>,
    /// Number of runs that the detectors used, in all windows.
    pub runs: usize,
    /// Number of tests whose cycles were evaluated again.
    pub recomputed: usize,
    /// Time of the detectors.
    pub computing: Duration,
}

/// Evaluates the tests of a robot: the window after the latest boundary and, if enough tests have arrived since, those
/// after later boundaries. `known` are the tests that count; `None` if all do. Nothing is settled while a test is set
/// aside.
///
/// # Errors
/// Those of the store, and panics of detectors.
pub async fn judge_tests(
    store: &Store,
    robot_id: i64,
    known: Option<&HashSet<i64>>,
    peers: &[Peer],
    settings: &DetectSettings,
    lengths: &Lengths,
) -> Result<WindowFindings, PipelineError> {
    let mut at = store.settled(robot_id, RunKind::Test).await?;
    let (mut judged, mut is_any_left_out) = (WindowFindings::default(), false);
    loop {
        let most = if known.is_some() { usize::MAX } else { 2 * lengths.step };
        let [mut before, mut behind] = store.window_keys(robot_id, RunKind::Test, &at, most).await?;
        if let Some(known) = known {
            let all = before.len() + behind.len();
            before.retain(|run_id| known.contains(run_id));
            behind.retain(|run_id| known.contains(run_id));
            is_any_left_out |= before.len() + behind.len() < all;
            behind.truncate(2 * lengths.step);
        }
        let keys = [before, behind].concat();
        store.summarise_tests(&keys, METHOD).await?;
        let window = store.test_window(robot_id, &keys, &at.first_of_epochs, METHOD).await?;
        let (peers, settings) = (peers.to_vec(), *settings);
        let detecting = tokio::task::spawn_blocking(move || detected(window, &peers, &settings));
        let found = detecting.await?;
        store.keep_judgements(&found.judgements).await?;
        judged.recomputed += found.recomputed;
        judged.computing += found.computing;
        match judged.add(RunKind::Test, &at, &found.window.tests, found.findings, is_any_left_out, lengths) {
            Some(next) => at = next,
            None => return Ok(judged),
        }
    }
}

/// Findings in a window of tests.
struct Detected {
    window: TestWindow,
    findings: Findings,
    /// New evaluations, as bytes, by test.
    judgements: Vec<(i64, Vec<u8>)>,
    recomputed: usize,
    computing: Duration,
}

fn detected(window: TestWindow, peers: &[Peer], settings: &DetectSettings) -> Detected {
    let began = Instant::now();
    let kept = Kept::new(METHOD, window.judgements.iter().map(|(run_id, bytes)| (*run_id, &bytes[..])));
    let (findings, judged) = detect_with(&window.tests, peers, settings, &kept);
    let (judgements, recomputed) = (judged.changed(&kept), judged.recomputed);
    Detected { window, findings, judgements, recomputed, computing: began.elapsed() }
}

/// Evaluates the production logs of a robot, like [`judge_tests`] its tests.
///
/// # Errors
/// Those of the store, and panics of detectors.
pub async fn judge_logs(
    store: &Store,
    robot_id: i64,
    settings: &DetectSettings,
    lengths: &Lengths,
) -> Result<WindowFindings, PipelineError> {
    let mut at = store.settled(robot_id, RunKind::Production).await?;
    let mut judged = WindowFindings::default();
    loop {
        let keys = store.window_keys(robot_id, RunKind::Production, &at, 2 * lengths.step).await?.concat();
        let history = store.log_window(&keys).await?;
        let settings = *settings;
        let (history, anomalies, computing) = tokio::task::spawn_blocking(move || {
            let began = Instant::now();
            let found = detect_production(&history, &settings);
            (history, found, began.elapsed())
        })
        .await?;
        judged.computing += computing;
        let findings = Findings { anomalies, ..Findings::default() };
        match judged.add(RunKind::Production, &at, &work_logs(&history), findings, false, lengths) {
            Some(next) => at = next,
            None => return Ok(judged),
        }
    }
}

impl WindowFindings {
    /// Adds the findings of a window. Returns the next boundary if it is in force.
    fn add(
        &mut self,
        kind: RunKind,
        at: &Settled,
        window: &[impl Windowed],
        found: Findings,
        is_any_left_out: bool,
        lengths: &Lengths,
    ) -> Option<Settled> {
        self.runs += window.len();
        let anomalies = put_together(at, window, found.anomalies);
        if !is_over(at, window, lengths) {
            let earlier: Vec<Anomaly> = std::mem::take(&mut self.findings.anomalies);
            self.findings = Findings { anomalies: [earlier, anomalies].concat(), ..found };
            return None;
        }
        let (settled, ended) = next(at, window, &anomalies, lengths);
        if is_any_left_out {
            self.findings.anomalies.extend(ended);
        } else {
            self.settled.push(NewlySettled { kind, settled: settled.clone(), ended });
        }
        Some(settled)
    }
}
