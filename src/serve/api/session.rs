//! `GET /v1/session`: what the sender may do. It is answered without a token, so that a page can ask for one.

use std::path::Path;
use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use crate::serve::access::Scope;
use crate::serve::answer::Json;
use crate::serve::shared::Shared;
use armwatch_config::shown_database;
use armwatch_store::time_in_views;

/// The program, and what this request may do
#[derive(Debug, Serialize, ToSchema)]
pub struct Session {
    /// Version of the program
    version: &'static str,
    /// Name of the database file
    database: Option<String>,
    /// Time of the daemon's machine, UTC
    #[schema(format = DateTime)]
    now: String,
    /// Whether requests need a token
    needs_token: bool,
    /// Whether this request may read what is stored
    may_read: bool,
    /// Whether it may answer alarms and enter work
    may_act: bool,
    /// Whether it may send exports, where uploads are on
    may_upload: bool,
}

/// The program, and what this request may do
///
/// Answered without a token.
#[utoipa::path(
    get, path = "/v1/session", tag = "Daemon", operation_id = "session",
    responses((status = 200, description = "What this request may do", body = Session)),
)]
pub async fn session(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Json<Session> {
    let may = |scope| shared.access.check_for(scope, &headers).is_ok();
    Json(Session {
        version: env!("CARGO_PKG_VERSION"),
        database: name(&shared.config.borrow().database),
        now: time_in_views(Timestamp::now()),
        needs_token: shared.access.needs_token(),
        may_read: may(Scope::Read),
        may_act: may(Scope::Act),
        may_upload: may(Scope::Upload) && shared.uploads.is_some(),
    })
}

/// Name of the database, without the folder or the server that it lies on.
fn name(database: &Path) -> Option<String> {
    let shown = shown_database(database);
    let (path, _) = shown.split_once('?').unwrap_or((&shown, ""));
    Path::new(path).file_name().map(|name| name.to_string_lossy().into_owned())
}
