//! `GET /`: the dashboard. Its files are part of the program; it asks nothing of any other server.

use std::sync::Arc;

use axum::Router;
use axum::extract::Path;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;

use super::answer::Refusal;
use super::shared::Shared;
use crate::ingest::bytes::fingerprint::of_bytes;

/// What a page may load and do: only what comes from here.
const POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; \
                      form-action 'none'";

/// A file of the dashboard.
struct Asset {
    name: &'static str,
    content: &'static [u8],
}

macro_rules! assets {
    ($($name:literal),* $(,)?) => {
        [$(Asset { name: $name, content: include_bytes!(concat!("page/", $name)) }),*]
    };
}

/// All files of the folder `page/`.
static ASSETS: &[Asset] = &assets![
    "actions.js",
    "alarm.js",
    "api.js",
    "dialog.js",
    "dom.js",
    "early.js",
    "fleet.js",
    "format.js",
    "friction-plots.js",
    "icon.svg",
    "index-plot.js",
    "index.html",
    "ingest.js",
    "live.js",
    "main.js",
    "part.js",
    "plot.js",
    "robot.js",
    "run.js",
    "spark.js",
    "status.js",
    "style.css",
    "uPlot.iife.min.js",
    "uPlot.min.css",
    "uplot.LICENSE",
];

/// The page and its files.
pub(super) fn routes() -> Router<Arc<Shared>> {
    Router::new().route("/", get(page)).route("/assets/{name}", get(asset))
}

async fn page(headers: HeaderMap) -> Response {
    answer("index.html", &headers)
}

async fn asset(Path(name): Path<String>, headers: HeaderMap) -> Response {
    answer(&name, &headers)
}

fn answer(name: &str, headers: &HeaderMap) -> Response {
    let Some(asset) = ASSETS.iter().find(|asset| asset.name == name) else {
        return Refusal::new(StatusCode::NOT_FOUND, format!("the dashboard has no file {name}"))
            .into_response();
    };
    // a newer program has newer files: a browser asks each time, and mostly hears that nothing has changed
    let tag = format!("\"{}\"", of_bytes(asset.content));
    let fixed = [
        (CACHE_CONTROL, "no-cache"),
        (CONTENT_SECURITY_POLICY, POLICY),
        (REFERRER_POLICY, "no-referrer"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
    ];
    if headers.get(IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes()) {
        return (StatusCode::NOT_MODIFIED, [(ETAG, tag)], fixed).into_response();
    }
    ([(ETAG, tag)], [(CONTENT_TYPE, content_type(asset.name))], fixed, asset.content).into_response()
}

fn content_type(name: &str) -> &'static str {
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_served() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/serve/page");
        let mut files: Vec<String> = std::fs::read_dir(folder)
            .expect("the folder")
            .map(|entry| entry.expect("a file").file_name().to_string_lossy().into_owned())
            .collect();
        let mut served: Vec<&str> = ASSETS.iter().map(|asset| asset.name).collect();
        files.sort_unstable();
        served.sort_unstable();
        assert_eq!(files, served);
    }
}
