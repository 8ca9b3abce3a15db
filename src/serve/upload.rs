//! `PUT` and `HEAD /v1/exports/NAME`.
//!
//! The key of an upload is its name and, if the client gives it, its content. Repeating an upload does no harm: content
//! that is already in the spool or stored is not accepted twice.

use std::path;
use std::sync::Arc;
use std::time::{Instant, SystemTime};

use axum::Extension;
use axum::body::Body;
use axum::extract::{Path, Query, State};
use axum::http::header::{CONTENT_ENCODING, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::access::Scope;
use super::answer::{Json, Problem, Refusal, Refused, UPLOAD_COMPLETE, UPLOAD_OFFSET};
use super::explained::{Explained, MOST_EXPLAINED, explained};
use super::network::Network;
use super::part::ByteRange;
use super::receive::{BodyBounds, SLOW_START, no_uploads, of_disk, receive};
use super::shared::{Shared, Uploads};
use super::spool::{Busy, Claim};
use super::status::content_hash;
use crate::serve::shared::CLEANING_INTERVAL;
use armwatch_ingest::bytes::source::is_export;
use armwatch_model::run::{ContentHash, RunStatus};
use armwatch_store::{KnownRun, Store};

/// Header with the hash of the content that the client wants to send, 64 hexadecimal digits.
const CONTENT_BLAKE3: HeaderName = HeaderName::from_static("x-content-blake3");

/// Longest file name of usual file systems, bytes.
const LONGEST_NAME: usize = 255;

/// Media types of exports. `octet-stream` gives no information, nor does the form type, the default of `curl`.
const MEDIA_TYPES: [&str; 9] = [
    "text/csv",
    "text/plain",
    "application/csv",
    "application/gzip",
    "application/x-gzip",
    "application/zstd",
    "application/octet-stream",
    "binary/octet-stream",
    "application/x-www-form-urlencoded",
];

/// Query of an upload.
#[derive(Debug, Clone, Copy, Default, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wishes {
    /// True if the content may replace another one under the same name.
    #[serde(default)]
    supersede: bool,
    /// True if the content is only explained and not kept.
    #[serde(default)]
    explain: bool,
}

/// Get the received size of an upload
///
/// The headers `Upload-Offset` and `Upload-Complete` give it.
#[utoipa::path(
    head, path = "/v1/exports/{name}", tag = "Exports", operation_id = "uploadOffset",
    params(
        ("name" = String, Path, description = "Name of the file"),
        ("X-Content-BLAKE3" = Option<String>, Header, description = "Hash of the content that is meant, 64 hexadecimal digits"),
    ),
    responses(
        (status = 200, description = "So many bytes are there", headers(
            ("Upload-Offset" = u64, description = "Bytes that are there"),
            ("Upload-Complete" = String, description = "?1 where the export is whole, ?0 else"),
        )),
        (status = 404, description = "Nothing of this name is here"),
        (status = 401, description = "The token is missing or not one of the daemon"),
        (status = 403, description = "The token may not do this"),
    ),
    security(("token" = ["upload"]), ()),
)]
pub async fn offset(
    State(shared): State<Arc<Shared>>,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Refusal> {
    shared.access.check_for(Scope::Upload, &headers)?;
    let uploads = uploads(&shared)?;
    check_name(&name)?;
    let (content, spool) = (declared_content(&headers)?, uploads.spool.clone());
    let found = tokio::task::spawn_blocking(move || spool.offset(&name, content.as_ref())).await;
    let found = found.map_err(Refusal::internal)?.map_err(|e| no_spool(&e))?;
    match found {
        Some((bytes, whole)) => Ok((StatusCode::OK, offset_headers(bytes, whole)).into_response()),
        None => Err(Refusal::new(StatusCode::NOT_FOUND, "nothing of this name is here").at(0)),
    }
}

/// Send an export, or a part of one
///
/// 201 means that all bytes are on disk. A part has `Content-Range`, and its answer gives the start of the next part.
/// With `?explain=true` the daemon reads and analyses the export, says how it would treat it, and keeps nothing.
#[utoipa::path(
    put, path = "/v1/exports/{name}", tag = "Exports", operation_id = "upload",
    params(
        ("name" = String, Path, description = "Name of the file, which says robot, date and time; ends in .csv, .csv.gz, .csv.zst, .parquet or .mcap"),
        ("supersede" = Option<bool>, Query, description = "Whether the content takes the place of another one under this name"),
        ("explain" = Option<bool>, Query, description = "Whether the content, of at most 64 MB, is only explained and not kept"),
        ("Content-Range" = Option<String>, Header, description = "bytes FIRST-LAST/TOTAL, or bytes */TOTAL to end an upload"),
        ("X-Content-BLAKE3" = Option<String>, Header, description = "Hash of the content, 64 hexadecimal digits"),
    ),
    request_body(description = "The bytes of the export", content((Vec<u8> = "application/octet-stream"), (String = "text/csv"))),
    responses(
        (status = 200, description = "The content is here or stored already; or, with explain, how it would be treated", body = Answered),
        (status = 201, description = "The export is taken", body = Taken),
        (status = 202, description = "The part is here; more is wanted from Upload-Offset on"),
        (status = 400, description = "Name, range or hash is wrong, the body broke off, or the export is empty", body = Problem),
        (status = 404, description = "Uploads are off", body = Problem),
        (status = 408, description = "Too slow; go on from Upload-Offset", body = Problem),
        (status = 409, description = "The name has another content, or the part does not begin at Upload-Offset or has another total", body = Problem),
        (status = 413, description = "Larger than allowed", body = Problem),
        (status = 415, description = "No export by name, media type or encoding", body = Problem),
        (status = 422, description = "The name says no robot of the configuration", body = Problem),
        (status = 503, description = "Other uploads are under way; try again after Retry-After", body = Problem),
        (status = 507, description = "No space left, or the spool cannot be written; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["upload"]), ()),
)]
pub async fn put(
    State(shared): State<Arc<Shared>>,
    Extension(network): Extension<Network>,
    Path(name): Path<String>,
    wishes: Result<Query<Wishes>, axum::extract::rejection::QueryRejection>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Refusal> {
    shared.access.check_for(Scope::Upload, &headers)?;
    let uploads = uploads(&shared)?;
    let Query(wishes) = wishes.map_err(|_| {
        Refusal::new(StatusCode::BAD_REQUEST, "the parameters are supersede and explain, true or false")
    })?;
    check_name(&name)?;
    check_robot(uploads, &name)?;
    check_media(&headers)?;
    let content = declared_content(&headers)?;
    let most = uploads.settings.max_bytes.min(if wishes.explain { MOST_EXPLAINED } else { u64::MAX });
    let part = ByteRange::of(&headers, most)?;
    if !wishes.explain
        && let Some(content) = &content
        && let Some(run) = stored(&shared.store, uploads, &name, content).await?
    {
        uploads.remember_known(&name, *content);
        return Ok(Taken::new(name, content, None, Some(&run), false).answer());
    }
    let _place = uploads.places.try_acquire().map_err(|_| {
        let most = uploads.settings.at_once;
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, format!("{most} uploads are under way; try again"))
            .after(5)
    })?;
    let client = format!("{} {network}", shared.access.token_name(&headers));
    // an upload of the same export has another key
    let key = if wishes.explain { format!("{name}\nexplain") } else { name.clone() };
    let claim = claimed(uploads, &key, content, client, part).await?;
    let bounds = BodyBounds {
        bytes: part.most(most),
        idle: uploads.settings.idle_timeout,
        slow_start: SLOW_START,
        total: uploads.settings.total_timeout,
    };
    let claim = receive(claim, part.is_from_start(), body, bounds, &shared.stop).await?;
    let length = claim.length().map_err(Refusal::internal)?;
    if part.total.is_some_and(|total| length < total) {
        return Ok((StatusCode::ACCEPTED, offset_headers(length, false)).into_response());
    }
    if length == 0 {
        claim.remove();
        return Err(Refusal::new(StatusCode::BAD_REQUEST, "the export is empty"));
    }
    if wishes.explain {
        return Ok(Json(explained(&shared, name, claim).await?).into_response());
    }
    let upload = Upload { name, declared: content, length, claim, supersede: wishes.supersede };
    // continues even if the client disconnects after it has sent everything
    let shared = Arc::clone(&shared);
    let placed = tokio::spawn(async move { place(&shared, upload).await });
    placed.await.map_err(Refusal::internal)?.map(Taken::answer)
}

/// Deletes abandoned uploads until the stop. Logs each time uploads become possible or impossible.
pub async fn clean(shared: &Shared) {
    let Some(uploads) = &shared.uploads else { return };
    loop {
        uploads.obstacle().await;
        let spool = uploads.spool.clone();
        match tokio::task::spawn_blocking(move || spool.remove_stale(SystemTime::now(), Instant::now())).await
        {
            Ok(Ok(0)) => {}
            Ok(Ok(removed)) => tracing::info!(removed, "uploads that nobody went on with are given up"),
            Ok(Err(error)) => tracing::warn!(%error, "cannot look for uploads that nobody goes on with"),
            Err(error) => tracing::error!(%error, "cleaning uploads panicked"),
        }
        tokio::select! {
            () = shared.stop.cancelled() => return,
            () = tokio::time::sleep(CLEANING_INTERVAL) => {}
        }
    }
}

fn uploads(shared: &Shared) -> Result<&Uploads, Refusal> {
    shared.uploads.as_ref().ok_or_else(|| {
        Refusal::new(
            StatusCode::NOT_FOUND,
            "uploads are off; [serve.upload] in the configuration lets them in",
        )
    })
}

/// Checks that a name is a single file in the spool, and that a scan recognises it as an export.
fn check_name(name: &str) -> Result<(), Refusal> {
    let bad = |sentence: &str| Err(Refusal::new(StatusCode::BAD_REQUEST, sentence));
    if name.contains(['/', '\\']) || name.contains("..") {
        return bad("the name must be that of a file, without folders");
    }
    if name.chars().any(char::is_control) {
        return bad("the name has a control character");
    }
    if name.len() > LONGEST_NAME {
        return bad("the name is longer than 255 bytes");
    }
    if name.starts_with('.') {
        return bad("the name begins with a dot: hidden files are not read");
    }
    if !is_export(path::Path::new(name)) {
        let sentence = "the name must end in .csv, .csv.gz, .csv.zst, .parquet or .mcap";
        return Err(Refusal::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, sentence));
    }
    Ok(())
}

fn check_robot(uploads: &Uploads, name: &str) -> Result<(), Refusal> {
    if uploads.settings.unknown_robots {
        return Ok(());
    }
    let refuse = |sentence: String| Err(Refusal::new(StatusCode::UNPROCESSABLE_ENTITY, sentence));
    let config = Arc::clone(&uploads.config.borrow());
    match config.recognition.recognise(name) {
        Err(error) => {
            refuse(format!("{error}; rename the file, or change [recognition] in the configuration"))
        }
        Ok(found) if config.robot_entry(&found.robot).is_none() => {
            refuse(format!("no [[robot]] of the configuration matches robot \"{}\"", found.robot))
        }
        Ok(_) => Ok(()),
    }
}

fn check_media(headers: &HeaderMap) -> Result<(), Refusal> {
    let refuse = |sentence: &str| Err(Refusal::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, sentence));
    let text = |name| headers.get(name).map(|value: &HeaderValue| value.to_str().unwrap_or("?"));
    if text(CONTENT_ENCODING).is_some_and(|encoding| !encoding.eq_ignore_ascii_case("identity")) {
        return refuse("send the file as it is, without Content-Encoding; .csv.gz and .csv.zst are taken");
    }
    let media = text(CONTENT_TYPE).map(|media| media.split(';').next().unwrap_or_default().trim());
    match media {
        Some(media) if !MEDIA_TYPES.iter().any(|known| media.eq_ignore_ascii_case(known)) => {
            refuse("send the bytes of the file alone, as text/csv or application/octet-stream")
        }
        _ => Ok(()),
    }
}

fn declared_content(headers: &HeaderMap) -> Result<Option<ContentHash>, Refusal> {
    let Some(value) = headers.get(CONTENT_BLAKE3) else { return Ok(None) };
    let hash = value.to_str().ok().and_then(|text| content_hash(text.trim()));
    hash.map(Some).ok_or_else(|| {
        Refusal::new(StatusCode::BAD_REQUEST, "X-Content-BLAKE3 must have 64 hexadecimal digits")
    })
}

/// Run with this content that belongs to the robot in the file name, or to a robot whose exports are read in the same
/// way.
async fn known_as(
    store: &Store,
    uploads: &Uploads,
    name: &str,
    content: &ContentHash,
) -> Result<Option<KnownRun>, Refusal> {
    let config = Arc::clone(&uploads.config.borrow());
    let runs = store.runs_of_content(content).await.map_err(Refusal::internal)?;
    let of_name = config.recognition.recognise(name).ok();
    let is_alike = |(_, robot, source): &&(KnownRun, String, String)| {
        of_name.as_ref().is_none_or(|of| config.reads_alike((&of.robot, name), (robot, source)))
    };
    Ok(runs.iter().find(is_alike).map(|(run, ..)| run.clone()))
}

/// The complete run with this content.
async fn stored(
    store: &Store,
    uploads: &Uploads,
    name: &str,
    content: &ContentHash,
) -> Result<Option<KnownRun>, Refusal> {
    let known = known_as(store, uploads, name, content).await?;
    Ok(known.filter(|run| run.status == RunStatus::Complete))
}

/// Claims the upload. Checks that the part continues it and that there is space.
async fn claimed(
    uploads: &Uploads,
    name: &str,
    content: Option<ContentHash>,
    client: String,
    part: ByteRange,
) -> Result<Claim, Refusal> {
    let (spool, name) = (uploads.spool.clone(), name.to_owned());
    let idle = uploads.settings.idle_timeout.as_secs();
    let claim = move || {
        spool.prepare().map_err(|error| no_spool(&error))?;
        let claim = spool.claim(&name, content.as_ref(), &client).map_err(|error| no_spool(&error))?;
        let mut claim = claim.map_err(|busy| under_way(busy, idle))?;
        check_part(&claim, part)?;
        spool.room_for(part.length.unwrap_or(0), SystemTime::now()).map_err(|error| of_disk(&error))?;
        let total = part.total.or(part.length);
        claim.begin(part.is_from_start(), total).map_err(|error| of_disk(&error))?;
        Ok(claim)
    };
    tokio::task::spawn_blocking(claim).await.map_err(Refusal::internal)?
}

/// Checks that a part begins at the end of the upload and belongs to the same export.
fn check_part(claim: &Claim, part: ByteRange) -> Result<(), Refusal> {
    if part.is_from_start() {
        return Ok(());
    }
    let there = claim.length().map_err(Refusal::internal)?;
    let refuse = |sentence: String| Err(Refusal::new(StatusCode::CONFLICT, sentence).at(there));
    if let (Some(begun), Some(total)) = (claim.total(), part.total)
        && begun != total
    {
        return refuse(format!(
            "the upload was begun as one of {begun} bytes, and Content-Range says {total}; go on with {begun}, or send \
             the whole export"
        ));
    }
    if there != part.first {
        return refuse(format!("{there} bytes are here; go on from there, or send the whole export"));
    }
    Ok(())
}

/// Refusal of an upload that cannot be claimed now. An idle client is disconnected after `idle` seconds.
fn under_way(busy: Busy, idle: u64) -> Refusal {
    match busy {
        Busy::Upload => Refusal::new(
            StatusCode::CONFLICT,
            "an upload of this name is under way; try again when it has ended",
        )
        .after(idle),
        Busy::Client => Refusal::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "other uploads with this token from this address are under way; try again",
        )
        .after(5),
    }
}

/// Refusal because the spool cannot be used.
fn no_spool(error: &std::io::Error) -> Refusal {
    tracing::warn!(%error, "the folder for uploads cannot be used");
    no_uploads(&format!("the folder for uploads cannot be used: {error}"))
}

/// An upload that has arrived completely.
struct Upload {
    name: String,
    declared: Option<ContentHash>,
    length: u64,
    claim: Claim,
    supersede: bool,
}

/// A finished upload, or how an export would be treated
#[derive(ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "describes both answers in the OpenAPI document")]
enum Answered {
    Taken(Taken),
    Explained(Explained),
}

/// A finished upload
#[derive(Debug, Serialize, ToSchema)]
struct Taken {
    /// Name of the file
    name: String,
    /// BLAKE3 of the content, 64 hexadecimal digits
    hash: String,
    /// Bytes of the content; null if it was stored before
    bytes: Option<u64>,
    /// True if the content is new
    new: bool,
    /// The run with this content, if there is one
    run_id: Option<i64>,
    /// Status of that run, such as complete or quarantined
    status: Option<String>,
    /// Address with the status of its processing
    status_at: String,
}

impl Taken {
    fn new(
        name: String,
        content: &ContentHash,
        bytes: Option<u64>,
        run: Option<&KnownRun>,
        new: bool,
    ) -> Self {
        Self {
            name,
            hash: content.to_string(),
            bytes,
            new,
            run_id: run.map(|run| run.run_id),
            status: run.map(|run| run.status.name().to_owned()),
            status_at: format!("/v1/exports/{content}"),
        }
    }

    fn answer(self) -> Response {
        let status = if self.new { StatusCode::CREATED } else { StatusCode::OK };
        let bytes = self.bytes;
        let mut response = (status, Json(self)).into_response();
        if let Some(bytes) = bytes {
            response.headers_mut().extend(offset_headers(bytes, true));
        }
        response
    }
}

fn offset_headers(bytes: u64, whole: bool) -> HeaderMap {
    let mut headers = HeaderMap::new();
    headers.insert(UPLOAD_OFFSET, bytes.into());
    headers.insert(UPLOAD_COMPLETE, HeaderValue::from_static(if whole { "?1" } else { "?0" }));
    headers
}

/// Gives a finished upload its name, unless its content is in the spool or stored already.
async fn place(shared: &Shared, upload: Upload) -> Result<Taken, Refusal> {
    let uploads = uploads(shared)?;
    let Upload { name, declared, length, claim, supersede } = upload;
    let read = tokio::task::spawn_blocking(move || (claim.content(), claim)).await;
    let (content, claim) = read.map_err(Refusal::internal)?;
    let (content, _) = content.map_err(Refusal::internal)?;
    if let Some(declared) = declared.filter(|declared| *declared != content) {
        claim.remove();
        let sentence = format!("the bytes that arrived have hash {content}, not {declared}; send them again");
        return Err(Refusal::new(StatusCode::BAD_REQUEST, sentence));
    }
    let _turn = uploads.placing.lock().await;
    let (spool, of) = (uploads.spool.clone(), name.clone());
    let there = tokio::task::spawn_blocking(move || spool.content(&of)).await;
    let there = there.map_err(Refusal::internal)?.map_err(Refusal::internal)?;
    let known = known_as(&shared.store, uploads, &name, &content).await?;
    let is_new = there != Some(content) && known.is_none();
    let taken = Taken::new(name.clone(), &content, Some(length), known.as_ref(), is_new);
    // the file of a quarantined or unfinished run may no longer exist, so its bytes are accepted again
    if there == Some(content) || known.is_some_and(|run| run.status == RunStatus::Complete) {
        claim.remove();
        uploads.remember_known(&name, content);
        return Ok(taken);
    }
    if !supersede && let Some(other) = other_content(&shared.store, &name, there).await? {
        claim.remove();
        let sentence = format!(
            "the name holds another content, {other}; send it under another name, or with ?supersede=true to take \
             its place"
        );
        return Err(Refusal::new(StatusCode::CONFLICT, sentence));
    }
    let (spool, to) = (uploads.spool.clone(), name.clone());
    let put = tokio::task::spawn_blocking(move || spool.put(&claim, &to)).await;
    put.map_err(Refusal::internal)?.map_err(|error| of_disk(&error))?;
    tracing::info!(name, bytes = length, "uploaded");
    uploads.remember(&name, content);
    Ok(taken)
}

/// Content that already has this name in the spool, otherwise in the ledger, and is not quarantined.
async fn other_content(
    store: &Store,
    name: &str,
    there: Option<ContentHash>,
) -> Result<Option<ContentHash>, Refusal> {
    if let Some(there) = there {
        let known = store.lookup(&there).await.map_err(Refusal::internal)?;
        let is_faulty = known.is_some_and(|run| run.status == RunStatus::Quarantined);
        return Ok((!is_faulty).then_some(there));
    }
    store.content_named(name).await.map_err(Refusal::internal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_file_that_is_an_export() {
        for good in
            ["R00_20260105_0847.csv", "R00.CSV.GZ", "Rü 1.csv.zst", &format!("{}.csv", "R".repeat(251))]
        {
            assert_eq!(check_name(good), Ok(()), "{good}");
        }
        let long = format!("{}.csv", "R".repeat(252));
        for bad in
            ["../R.csv", "a/R.csv", "a\\R.csv", "..csv", ".R.csv", "R\0.csv", "R\n.csv", "\u{85}R.csv", &long]
        {
            assert_eq!(check_name(bad).map_err(|r| r.status), Err(StatusCode::BAD_REQUEST), "{bad:?}");
        }
        for other in ["R00.txt", "R00.csv.part", "R00", "", "csv"] {
            let refused = check_name(other).map_err(|r| r.status);
            assert_eq!(refused, Err(StatusCode::UNSUPPORTED_MEDIA_TYPE), "{other:?}");
        }
    }
}
