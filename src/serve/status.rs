//! Status of an export, and health of the daemon.

use std::path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::access::Scope;
use super::answer::{Json, Problem, Refusal, Refused};
use super::shared::Shared;
use crate::metrics::{Disk, FolderState};
use crate::serve::shared::{Readiness, Uploads};
use armwatch_model::run::ContentHash;
use armwatch_store::{StoreError, ViewRows, time_in_views};

/// Status of an export
#[derive(Debug, Serialize, ToSchema)]
pub struct ExportStatus {
    /// BLAKE3 hash of its content, 64 hexadecimal digits; null while the file grows
    hash: Option<String>,
    /// Its run; null while it waits
    run_id: Option<i64>,
    /// waiting, or the status of its run, such as complete or quarantined
    status: String,
    /// Number of stored cycles
    cycles: u64,
    /// Reason for its quarantine
    reason: Option<String>,
}

/// The process lives
#[derive(Debug, Serialize, ToSchema)]
pub struct Health {
    /// ok
    status: &'static str,
}

/// Readiness of the daemon
#[derive(Debug, Serialize, ToSchema)]
pub struct Ready {
    /// True if the daemon can work
    ready: bool,
    /// True if the database answers
    database: bool,
    /// True if the daemon can receive uploads, or if uploads are off
    spool: bool,
    /// True if the disk of the copy for readers answers, or if no copy is written
    snapshot: bool,
    /// Reason why the daemon refuses uploads although they are on; all other work continues. Null without a token that
    /// may read
    uploads_refused: Option<String>,
    /// True if every watched folder answers; false if a disk or file server does not
    folders_answer: bool,
    /// Number of watched folders
    folders_watched: usize,
    /// Number of watched folders that do not answer
    folders_silent: usize,
    /// The watched folders. Empty without a token that may read, since other clients need no names of folders
    folders: Vec<WatchedFolder>,
    /// True if the daemon is about to stop
    stopping: bool,
    /// Reason why the daemon cannot work; null if it can
    reason: Option<&'static str>,
}

/// Last scan of a watched folder
#[derive(Debug, Serialize, ToSchema)]
pub struct WatchedFolder {
    /// Path of the folder, from the root
    folder: String,
    /// Time of the daemon's last scan of it; null before the first scan since the daemon's start
    last_scan_at: Option<String>,
    /// True if the last scan ended in time and none hangs
    answers: bool,
}

/// Status of an export
#[utoipa::path(
    get, path = "/v1/exports/{name}", tag = "Exports", operation_id = "exportStatus",
    params(("name" = String, Path, description = "BLAKE3 of its content, 64 hexadecimal digits, or the name of its file")),
    responses(
        (status = 200, description = "Where it stands", body = ExportStatus),
        (status = 404, description = "No such export is known", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ("token" = ["upload"]), ()),
)]
pub async fn of_export(
    State(shared): State<Arc<Shared>>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Json<ExportStatus>, Refusal> {
    // a token for uploads may also ask for the status of an export
    if shared.access.check_for(Scope::Upload, &headers).is_err() {
        shared.access.check(&headers)?;
    }
    let (found, unknown) = match content_hash(&name) {
        Some(hash) => (of_content(&shared, &hash).await?, "no export of this content is known".to_owned()),
        None => {
            let wanted = "give the name of a file or the BLAKE3 hash of its content, 64 hexadecimal digits";
            (of_name(&shared, &name).await?, format!("no export {name} is known; {wanted}"))
        }
    };
    found.map(Json).ok_or_else(|| Refusal::new(StatusCode::NOT_FOUND, unknown))
}

/// Status of a content: its run, or the waiting upload.
async fn of_content(shared: &Shared, hash: &ContentHash) -> Result<Option<ExportStatus>, Refusal> {
    let known = shared.store.lookup(hash).await.map_err(Refusal::internal)?;
    if let Some(run) = known {
        return Ok(Some(ExportStatus {
            hash: Some(hash.to_string()),
            run_id: Some(run.run_id),
            status: run.status.name().to_owned(),
            cycles: run.cycles_stored.into(),
            reason: run.reason,
        }));
    }
    let is_waiting = shared.uploads.as_ref().is_some_and(|uploads| uploads.is_waiting(hash));
    Ok(is_waiting.then(|| waiting(hash)))
}

/// An upload that the ledger does not know yet.
fn waiting(hash: &ContentHash) -> ExportStatus {
    let (hash, status) = (Some(hash.to_string()), "waiting".to_owned());
    ExportStatus { hash, run_id: None, status, cycles: 0, reason: None }
}

/// Status of the latest export with a name: the waiting upload if there is one, otherwise the latest run whose file had
/// this name, otherwise a content that is known under another name.
async fn of_name(shared: &Shared, name: &str) -> Result<Option<ExportStatus>, Refusal> {
    let uploads = shared.uploads.as_ref();
    if let Some(sent) = uploads.and_then(|uploads| uploads.waiting_as(name))
        && let Some(found) = of_content(shared, &sent).await?.filter(|found| found.run_id.is_none())
    {
        return Ok(Some(found));
    }
    if let Some(run) = latest_run(shared, "source_name", name).await? {
        return Ok(Some(run));
    }
    if let Some(uploads) = uploads {
        for sent in [uploads.waiting_as(name), uploads.known_as(name)].into_iter().flatten() {
            if let Some(found) = of_content(shared, &sent).await? {
                return Ok(Some(found));
            }
        }
        // an upload from before the start of this process, not yet read by a scan
        if let Some(there) = content_in_spool(uploads, name).await? {
            return Ok(Some(of_content(shared, &there).await?.unwrap_or_else(|| waiting(&there))));
        }
    }
    let seen = shared.store.run_of_file_named(name).await.map_err(Refusal::internal)?;
    match seen {
        Some(run_id) => latest_run(shared, "run_id", &run_id.to_string()).await,
        None => Ok(None),
    }
}

/// The latest run that has this value in a column of the view `runs`.
async fn latest_run(shared: &Shared, column: &str, value: &str) -> Result<Option<ExportStatus>, Refusal> {
    let wanted = ViewRows {
        filters: vec![(column.to_owned(), value.to_owned())],
        order: Some(("run_id".into(), true)),
        limit: 1,
    };
    let runs = shared.looking().await?.rows_of_view("runs", &wanted).await.map_err(Refusal::unanswered)?;
    let status = |run: serde_json::Value| {
        let text = |column: &str| run[column].as_str().map(str::to_owned);
        ExportStatus {
            hash: text("content_hash"),
            run_id: run["run_id"].as_i64(),
            status: text("status").unwrap_or_default(),
            cycles: run["cycles"].as_u64().unwrap_or_default(),
            reason: text("reason"),
        }
    };
    Ok(runs.objects().next().map(status))
}

/// Content of the upload with this name, if it is in the spool and can be read.
async fn content_in_spool(uploads: &Uploads, name: &str) -> Result<Option<ContentHash>, Refusal> {
    // reads nothing outside the folder
    if name.starts_with('.') || path::Path::new(name).file_name() != Some(name.as_ref()) {
        return Ok(None);
    }
    let (spool, of) = (uploads.spool.clone(), name.to_owned());
    let there = tokio::task::spawn_blocking(move || spool.content(&of)).await;
    Ok(there.map_err(Refusal::internal)?.unwrap_or_else(|error| {
        // not an error of the daemon: a client may send a name that no file can have
        tracing::debug!(name, %error, "an upload that is asked for cannot be read");
        None
    }))
}

/// Liveness of the process
#[utoipa::path(
    get, path = "/health", tag = "Daemon", operation_id = "health",
    responses((status = 200, description = "It lives", body = Health)),
)]
pub async fn health() -> Json<Health> {
    Json(Health { status: "ok" })
}

/// Time limit for a check of database or spool. After it, the disk counts as not answering.
const LOOKS_WITHIN: Duration = Duration::from_secs(3);

/// Lifetime of an answer to [`ready`]. Requests need no token, so frequent ones must cost little.
const READY_HOLDS: Duration = Duration::from_secs(1);

/// Readiness of the daemon
///
/// The daemon is ready if the database answers, uploads are possible, the disk of the copy for readers answers, and
/// each watched folder answers. The answer is valid for a second. It names folders only for a token that may read.
#[utoipa::path(
    get, path = "/ready", tag = "Daemon", operation_id = "ready",
    responses(
        (status = 200, description = "It can", body = Ready),
        (status = 503, description = "It cannot", body = Ready),
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn ready(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Response {
    let stopping = shared.stop.is_cancelled();
    let Readiness { database, obstacle, .. } = readiness(&shared).await;
    let looked_at = |of: FolderState| WatchedFolder {
        folder: of.folder,
        last_scan_at: of.looked_at.map(time_in_views),
        answers: of.answers,
    };
    let mut folders: Vec<WatchedFolder> = shared.metrics.folders().into_iter().map(looked_at).collect();
    let (folders_watched, folders_silent) = (folders.len(), folders.iter().filter(|of| !of.answers).count());
    let folders_answer = folders_silent == 0;
    let (spool, snapshot) = (obstacle.is_none(), shared.metrics.answers(Disk::Snapshot));
    let may_read = shared.access.check(&headers).is_ok();
    folders.retain(|_| may_read);
    let uploads_refused = obstacle.filter(|_| may_read);
    let reasons = [
        database.err(),
        (!spool).then_some("uploads are refused"),
        (!snapshot).then_some("the disk of the snapshot does not answer"),
        (!folders_answer).then_some("a watched folder does not answer"),
        stopping.then_some("it stops"),
    ];
    let reason = reasons.into_iter().flatten().next();
    let status = if reason.is_none() { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let (ready, database) = (reason.is_none(), database.is_ok());
    let ready = Ready {
        ready,
        database,
        spool,
        snapshot,
        uploads_refused,
        folders_answer,
        folders_watched,
        folders_silent,
        folders,
        stopping,
        reason,
    };
    (status, Json(ready)).into_response()
}

/// State of database and spool, at most a second old.
pub(super) async fn readiness(shared: &Arc<Shared>) -> Readiness {
    // requests that arrive during this check wait for its result
    let mut last = shared.readiness.lock().await;
    if let Some(known) = last.as_ref().filter(|known| known.at.elapsed() < READY_HOLDS) {
        return known.clone();
    }
    let database = match shared.metrics.answers(Disk::Database) {
        true => look(shared, |shared| async move { shared.store.probe().await }).await,
        false => None,
    };
    let database = match database {
        Some(Ok(())) => Ok(()),
        // this answer needs no token, and the full message names paths
        Some(Err(StoreError::Displaced { .. })) => Err("the open database is no longer the file at its path"),
        Some(Err(_)) => Err("the database does not answer"),
        None => Err("the disk of the database does not answer"),
    };
    let of_uploads = |shared: Arc<Shared>| async move {
        match &shared.uploads {
            Some(uploads) => uploads.obstacle().await,
            None => None,
        }
    };
    let obstacle = match shared.metrics.answers(Disk::Spool) {
        true => look(shared, of_uploads).await,
        false => None,
    };
    let obstacle = obstacle.unwrap_or_else(|| Some("the disk of the spool does not answer".to_owned()));
    last.insert(Readiness { at: Instant::now(), database, obstacle }).clone()
}

/// Result of `ask`, or `None` if it does not answer in time. Its task may then hang in a call to a disk.
async fn look<T: Send + 'static, A: Future<Output = T> + Send + 'static>(
    shared: &Arc<Shared>,
    ask: impl FnOnce(Arc<Shared>) -> A,
) -> Option<T> {
    let asked = tokio::spawn(ask(Arc::clone(shared)));
    tokio::time::timeout(LOOKS_WITHIN, asked).await.ok()?.ok()
}

/// Answers a request to an unknown address.
pub async fn nothing() -> Refusal {
    Refusal::new(
        StatusCode::NOT_FOUND,
        "there is the dashboard at /, the API under /v1/ (docs/api.md), /metrics, /health and /ready",
    )
}

/// Answers a request with an unsupported method.
pub async fn no_method() -> Refusal {
    Refusal::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "GET asks, PUT sends an export, POST does something with an alarm (docs/api.md)",
    )
}

/// Parses a hash of 64 hexadecimal digits.
pub fn content_hash(text: &str) -> Option<ContentHash> {
    let digits = text.as_bytes();
    let mut hash = [0; 32];
    if digits.len() != 2 * hash.len() || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    for (byte, at) in hash.iter_mut().zip((0..).step_by(2)) {
        *byte = u8::from_str_radix(text.get(at..at + 2)?, 16).ok()?;
    }
    Some(ContentHash(hash))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hash_is_read_as_it_is_written() {
        let hash = ContentHash(std::array::from_fn(|at| u8::try_from(7 * at).unwrap_or(0)));
        assert_eq!(content_hash(&hash.to_string()), Some(hash));
        assert_eq!(content_hash(&hash.to_string().to_uppercase()), Some(hash));
        let shorter = &hash.to_string()[1..];
        for wrong in ["", "x", shorter, &format!("{shorter}g"), &"+1".repeat(32)] {
            assert_eq!(content_hash(wrong), None, "{wrong}");
        }
    }
}
