//! What became of an export, and whether the program lives.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Json;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};

use super::answer::Refusal;
use super::shared::Shared;
use crate::run::ContentHash;
use crate::serve::shared::Readiness;

/// `GET /v1/exports/HASH`: status, cycles and, where there is one, the reason.
pub async fn of_content(
    State(shared): State<Arc<Shared>>,
    Path(hash): Path<String>,
    headers: HeaderMap,
) -> Result<Json<Value>, Refusal> {
    shared.access.check(&headers)?;
    let hash = content_hash(&hash).ok_or_else(|| {
        Refusal::new(StatusCode::BAD_REQUEST, "give the BLAKE3 hash of the export, 64 hexadecimal digits")
    })?;
    let known = shared.store.lookup(&hash).await.map_err(|error| Refusal::internal(&error))?;
    if let Some(run) = known {
        return Ok(Json(json!({
            "hash": hash.to_string(), "run_id": run.run_id, "status": run.status.name(),
            "cycles": run.cycles_stored, "reason": run.reason,
        })));
    }
    if shared.uploads.as_ref().is_some_and(|uploads| uploads.is_waiting(&hash)) {
        return Ok(Json(json!({
            "hash": hash.to_string(), "run_id": null, "status": "waiting", "cycles": 0, "reason": null,
        })));
    }
    Err(Refusal::new(StatusCode::NOT_FOUND, "no export of this content is known"))
}

/// `GET /health`: the process lives.
pub async fn health() -> Json<Value> {
    Json(json!({"status": "ok"}))
}

/// How long an answer to [`ready`] holds: who asks in a loop, without a token, costs next to nothing.
const READY_HOLDS: Duration = Duration::from_secs(1);

/// `GET /ready`: the database answers and uploads can be written.
pub async fn ready(State(shared): State<Arc<Shared>>) -> Response {
    let stopping = shared.stop.is_cancelled();
    let Readiness { database, spool, .. } = readiness(&shared).await;
    let is_ready = database && spool && !stopping;
    let status = if is_ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    let told = json!({"ready": is_ready, "database": database, "spool": spool, "stopping": stopping});
    (status, Json(told)).into_response()
}

async fn readiness(shared: &Shared) -> Readiness {
    // those that ask meanwhile wait for this look
    let mut last = shared.readiness.lock().await;
    if let Some(known) = last.filter(|known| known.at.elapsed() < READY_HOLDS) {
        return known;
    }
    let database = shared.store.probe().await.is_ok();
    let spool = match &shared.uploads {
        Some(uploads) => uploads.is_writable().await,
        None => true,
    };
    *last.insert(Readiness { at: Instant::now(), database, spool })
}

/// Any other address.
pub async fn nothing() -> Refusal {
    Refusal::new(
        StatusCode::NOT_FOUND,
        "there is the dashboard at /, the API under /v1/ (docs/api.md), /metrics, /health and /ready",
    )
}

/// Any other method.
pub async fn no_method() -> Refusal {
    Refusal::new(
        StatusCode::METHOD_NOT_ALLOWED,
        "GET asks, PUT sends an export, POST does something with an alarm (docs/api.md)",
    )
}

/// A hash of 64 hexadecimal digits.
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
