//! Counts requests and measures the time of their answers.

use std::sync::Arc;
use std::time::Instant;

use axum::extract::{MatchedPath, Request, State};
use axum::http::Method;
use axum::middleware::Next;
use axum::response::Response;

use super::shared::Shared;

/// Common label of all addresses without a route, because clients may send any address.
const NO_ROUTE: &str = "other";

/// Answers a request and counts it under the pattern of its address.
pub async fn count(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let began = Instant::now();
    let method = method(request.method());
    let route = request.extensions().get::<MatchedPath>().cloned();
    let answer = next.run(request).await;
    let route = route.as_ref().map_or(NO_ROUTE, MatchedPath::as_str);
    shared.metrics.request(method, route, answer.status().as_str(), began.elapsed());
    answer
}

/// Name of a known method, otherwise `other`, because clients may send any word.
fn method(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::PUT => "PUT",
        Method::POST => "POST",
        _ => "other",
    }
}
