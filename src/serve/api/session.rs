//! `GET /v1/session`: the permissions of the sender. The answer needs no token, so that a page can ask for one.

use std::path::Path;
use std::sync::Arc;

use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::header::{ORIGIN, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::IntoResponse;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::serve::access::Scope;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_config::shown_database;
use armwatch_store::time_in_views;

/// The program, and the permissions of this request
#[derive(Debug, Serialize, ToSchema)]
pub struct Session {
    /// Version of the program
    version: &'static str,
    /// Name of the database file
    database: Option<String>,
    /// Time of the daemon's machine, UTC
    #[schema(format = DateTime)]
    now: String,
    /// True if requests need a token
    needs_token: bool,
    /// True if this request may read the stored data
    may_read: bool,
    /// True if it may answer alarms and enter work
    may_act: bool,
    /// True if uploads are on and it may send exports
    may_upload: bool,
}

/// The program, and the permissions of this request
///
/// This request needs no token.
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

/// A token, in exchange for a cookie
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Login {
    /// The token
    token: String,
    /// True if the browser keeps it for 90 days; otherwise the browser keeps it until it is closed
    #[serde(default)]
    keep: bool,
}

/// Log a browser in
///
/// Sets a cookie that scripts cannot read. The browser sends it with each request, in place of the token.
#[utoipa::path(
    post, path = "/v1/session", tag = "Daemon", operation_id = "logIn",
    request_body = Login,
    responses(
        (status = 204, description = "The cookie is set"),
        (status = 400, description = "The body lacks the token, or has an unknown field", body = Problem),
        Refused,
    ),
)]
pub async fn log_in(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    login: Result<axum::Json<Login>, JsonRejection>,
) -> Result<impl IntoResponse, Refusal> {
    shared.access.check_own_page(&headers)?;
    let example = r#"{"token": "0123456789abcdef", "keep": true}"#;
    let axum::Json(login) = login.map_err(|rejection| Refusal::of_json(&rejection, example))?;
    let cookie = shared.access.log_in(&login.token, login.keep, is_secure(&headers))?;
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, cookie)]))
}

/// Log a browser out
#[utoipa::path(
    delete, path = "/v1/session", tag = "Daemon", operation_id = "logOut",
    responses((status = 204, description = "The cookie is deleted"), Refused),
)]
pub async fn log_out(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Refusal> {
    shared.access.check_own_page(&headers)?;
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, shared.access.log_out(is_secure(&headers)))]))
}

/// Returns true if the page came over TLS according to its Origin, which a proxy forwards.
fn is_secure(headers: &HeaderMap) -> bool {
    headers.get(ORIGIN).is_some_and(|origin| origin.as_bytes().starts_with(b"https://"))
}

/// Name of the database without its folder or server.
fn name(database: &Path) -> Option<String> {
    let shown = shown_database(database);
    let (path, _) = shown.split_once('?').unwrap_or((&shown, ""));
    Path::new(path).file_name().map(|name| name.to_string_lossy().into_owned())
}
