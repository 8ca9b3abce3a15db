//! Logs and counts the outcomes of exports.

use std::path::Path;

use crate::metrics::ExportEnd;
use crate::pipeline::context::Outcome;
use armwatch_model::text;

/// Logs the outcome of an export, at a level that fits its consequence.
pub(super) fn log_outcome(path: &Path, outcome: &Outcome) {
    let file = text::of_path(path);
    match outcome {
        Outcome::Stored(run) => {
            tracing::info!(%file, robot = %run.robot, run_id = run.run_id, cycles = run.cycles, rows = run.rows, "stored");
            for (cycles, reason) in run.refusals() {
                tracing::warn!(%file, robot = %run.robot, run_id = run.run_id, cycles, reason, "no parameters");
            }
        }
        Outcome::AlreadyStored { run_id } => tracing::debug!(%file, run_id, "already stored"),
        // logged when it was read
        Outcome::Quarantined { rejection, known: true, .. } => {
            tracing::debug!("quarantined before: {rejection}");
        }
        Outcome::Quarantined { run_id, rejection, cycles, .. } => tracing::warn!(
            %file,
            run_id,
            line = rejection.line,
            column = rejection.column.as_deref(),
            cycles,
            "quarantined: {rejection}"
        ),
        Outcome::Interrupted => {
            tracing::info!(%file, "stopped after a cycle; the rest follows at the next start")
        }
        Outcome::Unreadable { rejection } => {
            tracing::warn!(%file, "cannot be read now, trying again: {rejection}");
        }
        Outcome::Changed => tracing::info!(%file, "changed while being read; reading again"),
        Outcome::InWork { run_id: None } => tracing::debug!(%file, "another daemon reads it"),
        Outcome::InWork { run_id: Some(run_id) } => {
            tracing::debug!(%file, run_id, "another program reads it, or the same content is being read under another name");
        }
    }
}

/// The metric's name for the outcome of an export.
pub(super) fn end_of(outcome: &Outcome) -> ExportEnd {
    match outcome {
        Outcome::Stored(_) => ExportEnd::Stored,
        Outcome::AlreadyStored { .. } | Outcome::Quarantined { known: true, .. } => ExportEnd::Known,
        Outcome::Quarantined { .. } => ExportEnd::Quarantined,
        Outcome::Interrupted | Outcome::Changed | Outcome::Unreadable { .. } | Outcome::InWork { .. } => {
            ExportEnd::Later
        }
    }
}
