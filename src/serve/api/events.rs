//! `GET /v1/events`: reports to a page that the database has changed, so that the page requests its content again.

use std::convert::Infallible;
use std::future::ready;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{Event, KeepAlive};
use axum::response::{IntoResponse, Sse};
use futures_util::StreamExt;
use futures_util::stream::{once, unfold};
use serde_json::json;
use tokio::time::{Instant, sleep_until};

use crate::serve::answer::{Refusal, Refused};
use crate::serve::shared::Shared;

/// Time between two checks of the database. A page requests its content at most this often.
const LOOK_INTERVAL: Duration = Duration::from_secs(1);

/// Time after which a silent stream sends a sign of life.
const ALIVE_INTERVAL: Duration = Duration::from_secs(10);

/// Asks nginx, and proxies that copy it, to pass each event on at once.
const UNBUFFERED: (&str, &str) = ("x-accel-buffering", "no");

/// Duration of a stream. Its client then requests another one. Without this limit a client that reads nothing would
/// hold a stream for days, because the few bytes of a quiet stream fit into the buffers on the way.
const LONGEST_STREAM: Duration = Duration::from_secs(600);

/// Hear of changes
///
/// Server-sent events: `changed` when the database has changed, at most once a second; `alive` at once and every
/// 10 s. The stream
/// ends after 10 minutes; ask again.
#[utoipa::path(
    get, path = "/v1/events", tag = "Rows", operation_id = "events",
    responses((status = 200, description = "Events", body = String, content_type = "text/event-stream"), Refused),
    security(("token" = ["read"]), ()),
)]
pub async fn events(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Refusal> {
    shared.access.check(&headers)?;
    shared.looking().await?;
    let (mut changes, stop) = (shared.changes.subscribe(), shared.stop.clone());
    // the page may have read its content before the stream began
    changes.mark_changed();
    let end = Instant::now() + LONGEST_STREAM;
    let stream = unfold((changes, stop, end), async |(mut changes, stop, end)| {
        let changed = tokio::select! {
            () = stop.cancelled() => return None,
            () = sleep_until(end) => return None,
            changed = changes.changed() => changed,
        };
        changed.ok()?;
        let version = *changes.borrow_and_update();
        let event = Event::default().event("changed").data(json!({"version": version}).to_string());
        Some((Ok(event), (changes, stop, end)))
    });
    let stream = once(ready(Ok::<_, Infallible>(alive()))).chain(stream);
    let sent = Sse::new(stream).keep_alive(KeepAlive::new().interval(ALIVE_INTERVAL).event(alive()));
    Ok(([UNBUFFERED], sent))
}

fn alive() -> Event {
    Event::default().event("alive").data("{}")
}

/// Checks for changes of the database while a client listens, until the program stops.
pub async fn watch(shared: &Shared) {
    let mut seen = None;
    loop {
        tokio::select! {
            () = shared.stop.cancelled() => return,
            () = tokio::time::sleep(LOOK_INTERVAL) => {}
        }
        if shared.changes.receiver_count() == 0 {
            continue;
        }
        let Some(store) = shared.looking.get() else { continue };
        match store.data_version().await {
            Ok(version) if seen != Some(version) => {
                if seen.replace(version).is_some() {
                    shared.changes.send_modify(|changes| *changes += 1);
                }
            }
            Ok(_) => {}
            Err(error) => tracing::debug!(%error, "no look at the database"),
        }
    }
}
