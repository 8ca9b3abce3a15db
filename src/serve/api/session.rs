//! `GET /v1/session`: what the sender may do. It is answered without a token, so that a page can ask for one.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde_json::{Value, json};

use crate::serve::shared::Shared;

/// Version of the program, whether a token is needed, and what this request may do.
pub async fn session(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Json<Value> {
    Json(json!({
        "version": env!("CARGO_PKG_VERSION"),
        "database": shared.config.borrow().database.file_name().map(|name| name.to_string_lossy().into_owned()),
        "now": Timestamp::now().to_string(),
        "needs_token": shared.access.needs_token(),
        "may_read": shared.access.check(&headers).is_ok(),
        "may_act": shared.access.check_action(&headers).is_ok(),
    }))
}
