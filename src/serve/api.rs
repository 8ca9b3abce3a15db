//! `/v1/`: what is stored, as JSON, for pages and programs; and what people do with alarms.
//!
//! Reading goes through a handle of its own, so that pages take no turn of the pipeline's readers. Rows have the names
//! and units of the SQL views. What changes something needs a token, also on this machine: any page in a browser could
//! send such a request otherwise.

mod act;
mod events;
mod fleet;
mod rows;
mod session;

use std::sync::Arc;

use axum::Router;
use axum::routing::{get, post};

use super::shared::Shared;
pub(super) use events::watch;

/// The addresses under `/v1/` besides those of exports.
pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new()
        .route("/v1/session", get(session::session))
        .route("/v1/fleet", get(fleet::fleet))
        .route("/v1/views", get(rows::views))
        .route("/v1/views/{view}", get(rows::of_view))
        .route("/v1/events", get(events::events))
        .route("/v1/anomalies/{id}/{action}", post(act::on_anomaly))
        .route("/v1/robots/{robot}/maintenance", post(act::maintenance))
        .route("/v1/quarantine/{run_id}/retry", post(act::retry))
}
