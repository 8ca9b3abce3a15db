//! `GET /v1/quarantine/RUN/excerpt` and `/file`: an export in quarantine, for persons who may act.
//!
//! A watched folder may contain files that are no exports. Only a file is shown in which a layout has read a cell.

use std::path::PathBuf;
use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::header::{CONTENT_DISPOSITION, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::number::number;
use super::torque::{PATIENCE, in_turn};
use crate::serve::access::Scope;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_ingest::bytes::fingerprint::content;
use armwatch_ingest::excerpt::excerpt;
use armwatch_model::run::ContentHash;
use armwatch_store::QuarantineRow;

/// Lines before and after the faulty one.
const LINES_AROUND: u64 = 2;

/// Characters of a line that are shown.
const SHOWN_CHARACTERS: usize = 2000;

/// Largest export that is sent, bytes. It is in memory once, until its client has read it.
const MOST_BYTES: u64 = 64 << 20;

/// Lines of an export around its fault
#[derive(Debug, Serialize, ToSchema)]
pub struct FaultExcerpt {
    /// The run in quarantine
    run_id: i64,
    /// Number of the first line, from 1
    first_line: u64,
    /// The lines, at most 2,000 characters of each
    lines: Vec<String>,
    /// Line with the fault, from 1
    line: u64,
    /// First character of the faulty cell in its line, from 0, if its column is found
    cell_begin: Option<usize>,
    /// Character after the cell
    cell_end: Option<usize>,
}

/// Lines of an export in quarantine around its fault
#[utoipa::path(
    get, path = "/v1/quarantine/{run_id}/excerpt", tag = "Rows", operation_id = "excerpt",
    params(("run_id" = i64, Path, description = "Its run")),
    responses(
        (status = 200, description = "The lines", body = FaultExcerpt),
        (status = 400, description = "The number is none", body = Problem),
        (status = 404, description = "The run has no fault, or none in a line of an export", body = Problem),
        (status = 410, description = "The file is gone or has changed", body = Problem),
        (status = 503, description = "Other exports are being read; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn of_fault(
    State(shared): State<Arc<Shared>>,
    Path(run_id): Path<String>,
    headers: HeaderMap,
) -> Result<Json<FaultExcerpt>, Refusal> {
    let (fault, found) = read(&shared, &run_id, &headers).await?;
    let (line, column) = (fault.line.unwrap_or_default(), fault.column.clone());
    let most = shared.config.borrow().limits.export_bytes;
    let path = found.path;
    let found =
        tokio::task::spawn_blocking(move || excerpt(&path, line, column.as_deref(), LINES_AROUND, most));
    let found = found.await.map_err(Refusal::internal)?.ok().flatten().ok_or_else(gone)?;
    let shown = |line: &String| line.chars().take(SHOWN_CHARACTERS).collect::<String>();
    let cell = found.cell.filter(|cell| cell.end <= SHOWN_CHARACTERS);
    Ok(Json(FaultExcerpt {
        run_id: fault.run_id,
        first_line: found.first_line,
        lines: found.lines.iter().map(shown).collect(),
        line,
        cell_begin: cell.as_ref().map(|cell| cell.start),
        cell_end: cell.map(|cell| cell.end),
    }))
}

/// An export in quarantine
#[utoipa::path(
    get, path = "/v1/quarantine/{run_id}/file", tag = "Rows", operation_id = "quarantinedFile",
    params(("run_id" = i64, Path, description = "Its run")),
    responses(
        (status = 200, description = "The bytes of the file", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 400, description = "The number is none", body = Problem),
        (status = 404, description = "The run has no fault, or none in a line of an export", body = Problem),
        (status = 410, description = "The file is gone or has changed", body = Problem),
        (status = 413, description = "The file is larger than 64 MiB", body = Problem),
        (status = 503, description = "Other exports are being read; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["act"])),
)]
pub async fn file(
    State(shared): State<Arc<Shared>>,
    Path(run_id): Path<String>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Refusal> {
    let (fault, found) = read(&shared, &run_id, &headers).await?;
    // a name in quotation marks: other characters would end it or the header
    let name: String = fault
        .source_name
        .chars()
        .map(|letter| if letter.is_ascii_graphic() && !"\"\\".contains(letter) { letter } else { '_' })
        .collect();
    let fixed = [
        (CONTENT_TYPE, "application/octet-stream".to_owned()),
        (X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
        (CONTENT_DISPOSITION, format!("attachment; filename=\"{name}\"")),
    ];
    Ok((fixed, found.bytes))
}

/// A file with its content.
struct QuarantinedFile {
    path: PathBuf,
    bytes: Vec<u8>,
}

/// The latest fault of a run and the file that has it, unchanged.
async fn read(
    shared: &Arc<Shared>,
    run_id: &str,
    headers: &HeaderMap,
) -> Result<(QuarantineRow, QuarantinedFile), Refusal> {
    shared.access.check_for(Scope::Act, headers)?;
    let run_id: i64 = number(run_id, "run", "GET /v1/views/quarantine has the numbers in its column run_id")?;
    let store = shared.looking().await?;
    let faults = store.faults().await.map_err(Refusal::internal)?;
    let fault = faults.into_iter().find(|fault| fault.run_id == run_id).ok_or_else(|| {
        let sentence =
            format!("run {run_id} has no fault; GET /v1/views/quarantine lists those that have one");
        Refusal::new(StatusCode::NOT_FOUND, sentence)
    })?;
    if !is_export(&fault) {
        let sentence = "no layout has read a cell of this file; it may be no export and is not shown; \
                        `armwatch quarantine explain` shows it on the daemon's machine";
        return Err(Refusal::new(StatusCode::NOT_FOUND, sentence));
    }
    let source = store.run_source(run_id).await.map_err(Refusal::internal)?.ok_or_else(gone)?;
    let folders = shared.config.borrow().watch.folders.clone();
    let reading = async move {
        let first_of = move || {
            source.paths.into_iter().find_map(|path| read_unchanged(path, &source.content_hash, &folders))
        };
        tokio::task::spawn_blocking(first_of).await
    };
    let Some(found) = in_turn(&shared.replays, PATIENCE, reading).await else {
        let sentence = "other exports are being read again; try again";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(5));
    };
    let found = found.flatten().map_err(Refusal::internal)?;
    Ok((fault, found.ok_or_else(gone)??))
}

/// Returns true if the rows before the fault were read by a layout: its cell has a value in a column that the layout names.
fn is_export(fault: &QuarantineRow) -> bool {
    fault.line.is_some_and(|line| line > 1)
        && (fault.cycles_stored > 0 || fault.column.is_some() && fault.value.is_some())
}

/// The file at a path, or the refusal of a large one; `None` if its content is another or if it is outside the watched
/// folders. Links are followed first.
fn read_unchanged(
    path: PathBuf,
    wanted: &ContentHash,
    folders: &[PathBuf],
) -> Option<Result<QuarantinedFile, Refusal>> {
    let real = std::fs::canonicalize(&path).ok()?;
    let is_below =
        |folder: &PathBuf| std::fs::canonicalize(folder).is_ok_and(|folder| real.starts_with(folder));
    if !folders.iter().any(is_below) || !real.is_file() {
        return None;
    }
    match content(&real, MOST_BYTES).ok()? {
        Some((bytes, hash)) => (hash == *wanted).then_some(Ok(QuarantinedFile { path: real, bytes })),
        None => {
            let sentence = format!(
                "the file is larger than {} MiB; copy it from the folder on the daemon's machine",
                MOST_BYTES >> 20
            );
            Some(Err(Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, sentence)))
        }
    }
}

fn gone() -> Refusal {
    let sentence = "the file is gone or has changed since; `armwatch quarantine explain` names its path";
    Refusal::new(StatusCode::GONE, sentence)
}
