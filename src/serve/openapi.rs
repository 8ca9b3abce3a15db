//! `GET /v1/openapi.json`: a machine-readable description of the API, made from the code that answers.

use std::sync::Arc;

use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use utoipa::openapi::OpenApi;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::{Modify, OpenApi as _};

use super::answer::{Refusal, Refused};
use super::shared::Shared;

/// General part of the description. The code of each route describes the route.
#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "armwatch",
        description = "What an armwatch daemon tells and takes over HTTP. Times are UTC. Views and columns are described in docs/schema.md.",
    ),
    tags(
        (name = "Rows", description = "What is stored"),
        (name = "Actions", description = "What people do with alarms, robots and exports; these need a token always"),
        (name = "Exports", description = "Uploads, and what became of exports"),
        (name = "Daemon", description = "The program itself"),
    ),
    paths(metrics),
    modifiers(&TokenScheme),
)]
struct General;

/// Security scheme: how requests carry a token.
struct TokenScheme;

impl Modify for TokenScheme {
    fn modify(&self, document: &mut OpenApi) {
        let scheme = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(
            "A token of serve.token_file or serve.token, with the scopes read, act and upload. A daemon without tokens \
             answers programs of its own machine, which then read and upload.",
        ));
        let components = document.components.get_or_insert_default();
        components.add_security_scheme("token", SecurityScheme::Http(scheme.build()));
    }
}

/// The description without the routes.
pub(super) fn general() -> OpenApi {
    let mut document = General::openapi();
    // the program's licence does not apply to its answers
    document.info.license = None;
    document.info.contact = None;
    document
}

/// Figures for Prometheus
///
/// In its text format; docs/metrics.md.
#[utoipa::path(
    get, path = "/metrics", tag = "Daemon", operation_id = "metrics",
    responses((status = 200, description = "The figures", body = String, content_type = "text/plain"), Refused),
    security(("token" = ["read"]), ()),
)]
#[expect(dead_code, reason = "describes the address that the room's file metrics answers")]
fn metrics() {}

/// This description
#[utoipa::path(
    get, path = "/v1/openapi.json", tag = "Daemon", operation_id = "openapi",
    responses((status = 200, description = "OpenAPI 3.1", body = serde_json::Value), Refused),
    security(("token" = ["read"]), ()),
)]
pub async fn openapi(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Response, Refusal> {
    shared.access.check(&headers)?;
    let document = shared.description.get().ok_or_else(|| Refusal::internal("the API has no description"))?;
    Ok(([(CONTENT_TYPE, "application/json")], document.clone()).into_response())
}
