//! `PUT /v1/exports/NAME?explain=true`: how the daemon would treat an export, which it does not keep.

use std::sync::Arc;

use axum::http::StatusCode;
use serde::Serialize;
use utoipa::ToSchema;

use super::answer::Refusal;
use super::api::torque::{PATIENCE, in_turn};
use super::receive::of_disk;
use super::shared::Shared;
use super::spool::Claim;
use crate::pipeline::look::explain::{CycleSketch, Explainer, Explanation, NextAction};
use armwatch_store::time_in_views;

/// Largest export that is explained, bytes: an hour of six joints at 250 Hz, read and analysed in seconds.
pub(super) const MOST_EXPLAINED: u64 = 64 << 20;

/// How an export would be treated
#[derive(Debug, Serialize, ToSchema)]
pub struct Explained {
    /// Name of the file
    name: String,
    /// What would happen to it
    #[schema(inline)]
    next: Next,
    /// The run with its content, or the one that it would continue
    run_id: Option<i64>,
    /// The run that it would supersede
    supersedes_run_id: Option<i64>,
    /// The robot, if the name gives one of the configuration
    robot: Option<String>,
    /// Model of the arm by its description
    model: Option<String>,
    /// Name of the layout
    layout: Option<String>,
    /// `test` or `production`
    kind: Option<&'static str>,
    /// Start of the recording, UTC
    #[schema(format = DateTime)]
    started_at: Option<String>,
    /// Rows that were read
    rows: Option<u64>,
    /// Time from the first to the last row, s
    duration_s: Option<f64>,
    /// Complete cycles
    cycles: Option<usize>,
    /// Cycles with parameters
    cycles_identified: Option<usize>,
    /// Faults, the worst first, with line, column, value and remedy
    problems: Vec<String>,
    /// Remarks about name, start, rows and cycles
    remarks: Vec<String>,
}

/// Treatment of an export
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum Next {
    /// It would be stored.
    Store,
    /// Nothing: a run has its content.
    Nothing,
    /// It would be quarantined.
    Quarantine,
}

impl Explained {
    fn new(name: String, of: &Explanation) -> Self {
        let (next, run_id, supersedes_run_id) = match of.next {
            NextAction::Store { continues, replaces } => (Next::Store, continues, replaces),
            NextAction::Nothing { run_id } => (Next::Nothing, Some(run_id), None),
            NextAction::Quarantine => (Next::Quarantine, None, None),
        };
        let (recognised, reading) = (of.recognised.as_ref(), of.reading.as_ref());
        let is_identified = |cycles: &[CycleSketch]| {
            let analysed = cycles.iter().filter_map(|cycle| cycle.analysis.as_ref());
            analysed.filter(|analysis| analysis.identification.is_ok()).count()
        };
        Self {
            name,
            next,
            run_id,
            supersedes_run_id,
            robot: recognised.map(|of| of.robot.clone()),
            model: recognised.map(|of| of.entry.description.model.clone()),
            layout: recognised.map(|of| of.entry.layout.name.clone()),
            kind: recognised.map(|of| of.entry.layout.stage.kind().run_kind().name()),
            started_at: recognised.map(|of| time_in_views(of.started_at)),
            rows: reading.map(|of| of.rows),
            duration_s: reading.map(|of| of.duration),
            cycles: reading.map(|of| of.cycles.len()),
            cycles_identified: reading.map(|of| is_identified(&of.cycles)),
            problems: of.problems(),
            remarks: of.remarks(),
        }
    }
}

/// Explains an upload that has arrived completely, and deletes it.
///
/// # Errors
/// 503 while other exports are being read, 507 on a full disk, 500 if the database fails.
pub(super) async fn explained(shared: &Shared, name: String, claim: Claim) -> Result<Explained, Refusal> {
    let config = Arc::clone(&shared.config.borrow());
    let store = shared.looking().await?.clone();
    let of_name = name.clone();
    let moved = tokio::task::spawn_blocking(move || claim.named(&of_name)).await;
    let (folder, path) = moved.map_err(Refusal::internal)?.map_err(|error| of_disk(&error))?;
    let explain = async move {
        let _folder = folder;
        let explained = Explainer::with_store(config, store).explain(&path, false).await;
        Ok(Explained::new(name, &explained.map_err(Refusal::internal)?))
    };
    let Some(explained) = in_turn(&shared.replays, PATIENCE, explain).await else {
        let sentence = "other exports are being read; try again";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(5));
    };
    explained.map_err(Refusal::internal)?
}
