//! `GET /v1/payload`: the load that an arm carries in one run and not in another.

use std::sync::Arc;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Query, State};
use axum::http::{HeaderMap, StatusCode};
use serde::Deserialize;
use utoipa::IntoParams;

use super::torque::{PATIENCE, in_turn};
use crate::pipeline::stored::chosen_cycles::StoredError;
use crate::pipeline::stored::payload::{RunPayload, payload_of_runs};
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;

/// The two runs
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct Asked {
    /// Run without the load, by number or by the name of its export
    empty: String,
    /// Run with the load, by number or by the name of its export
    loaded: String,
}

/// Payload of an arm
///
/// From the stored factors of two tests of one robot; no export is read.
#[utoipa::path(
    get, path = "/v1/payload", tag = "Rows", operation_id = "payload", params(Asked),
    responses(
        (status = 200, description = "Mass, centre and inertia with intervals", body = RunPayload),
        (status = 400, description = "empty or loaded is missing", body = Problem),
        (status = 404, description = "No such runs, or runs that cannot be compared; the sentence says why", body = Problem),
        (status = 503, description = "Other cycles are being read; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn payload(
    State(shared): State<Arc<Shared>>,
    asked: Result<Query<Asked>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Json<RunPayload>, Refusal> {
    shared.access.check(&headers)?;
    let Query(Asked { empty, loaded }) = asked.map_err(|_| {
        let sentence = "give two runs, as in ?empty=1&loaded=2";
        Refusal::new(StatusCode::BAD_REQUEST, sentence)
    })?;
    let config = Arc::clone(&shared.config.borrow());
    let store = shared.looking().await?.clone();
    let read = async move { payload_of_runs(&config, &store, &empty, &loaded).await };
    let Some(read) = in_turn(&shared.replays, PATIENCE, read).await else {
        let sentence = "other cycles are being read; try again";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(5));
    };
    let found = read.unwrap_or_else(|error| Err(error.into()));
    found.map(Json).map_err(|error| match error {
        StoredError::Store(_) | StoredError::Task(_) => Refusal::internal(error),
        _ => Refusal::new(StatusCode::NOT_FOUND, error.to_string()),
    })
}
