//! `GET /`: the dashboard. Its files are part of the program; it asks nothing of any other server.

use std::borrow::Cow;
use std::sync::{Arc, LazyLock};

use axum::Router;
use axum::extract::Path;
use axum::http::header::{
    CACHE_CONTROL, CONTENT_ENCODING, CONTENT_SECURITY_POLICY, CONTENT_TYPE, ETAG, IF_NONE_MATCH,
    REFERRER_POLICY, VARY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{AppendHeaders, IntoResponse, Response};
use axum::routing::get;
use flate2::Compression;
use serde_json::{Map, Value, json};

use super::answer::Refusal;
use super::compression::{compressed, is_among, tag_of, takes_gzip};
use super::shared::Shared;
use crate::language::{Language, module};
use armwatch_model::anomaly::AnomalyKind;
use armwatch_model::anomaly::quantity::Quantity;

/// What a page may load and do: only what comes from here.
const POLICY: &str = "default-src 'self'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'; base-uri 'none'; \
                      form-action 'none'";

/// A file of the dashboard.
struct Asset {
    name: &'static str,
    content: Cow<'static, [u8]>,
}

macro_rules! assets {
    ($($name:literal),* $(,)?) => {
        [$(Asset { name: $name, content: Cow::Borrowed(include_bytes!(concat!("page/", $name))) }),*]
    };
}

/// All files of the folder `page/`.
fn assets() -> impl IntoIterator<Item = Asset> {
    assets![
        "actions.js",
        "alarm.js",
        "alarms.js",
        "api.js",
        "cycle.js",
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
        "messages.js",
        "part.js",
        "plot.js",
        "quantities.js",
        "robot.js",
        "run.js",
        "spark.js",
        "status.js",
        "style.css",
        "upload.js",
        "uPlot.iife.min.js",
        "uPlot.min.css",
        "uplot.LICENSE",
        "wall.js",
    ]
}

/// Module with the quantities and kinds of anomalies, from the lists of the program.
const LISTS: &str = "lists.js";

/// Modules with the messages of languages other than English; `messages.js` loads the one of the page.
const MESSAGES: [(&str, Language); 3] = [
    ("messages-it.js", Language::Italian),
    ("messages-de.js", Language::German),
    ("messages-zh.js", Language::Chinese),
];

fn messages() -> impl Iterator<Item = Asset> {
    let asset = |(name, language)| Some(Asset { name, content: Cow::Owned(module(language)?.into_bytes()) });
    MESSAGES.into_iter().filter_map(asset)
}

fn lists() -> Asset {
    let quantities: Map<String, Value> = Quantity::ALL
        .iter()
        .map(|of| {
            let facts = json!({
                "label": of.label(), "unit": of.unit(), "value": of.value_form(), "score": of.score_form(),
                "friction": of.is_of_one_cause(Quantity::FrictionIndex),
            });
            (of.name().to_owned(), facts)
        })
        .collect();
    let kinds: Map<String, Value> =
        AnomalyKind::ALL.iter().map(|of| (of.name().to_owned(), json!({ "label": of.label() }))).collect();
    let (quantities, kinds) = (Value::Object(quantities), Value::Object(kinds));
    let content = format!("export const QUANTITIES = {quantities};\nexport const KINDS = {kinds};\n");
    Asset { name: LISTS, content: Cow::Owned(content.into_bytes()) }
}

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

/// A file as it is sent.
struct Sent {
    asset: Asset,
    tag: String,
    /// Compressed, where that is shorter.
    short: Option<Vec<u8>>,
}

/// All files, made ready when the first one is asked for.
static SENT: LazyLock<Vec<Sent>> = LazyLock::new(|| {
    let sent = |asset: Asset| Sent {
        tag: tag_of(&asset.content),
        short: compressed(&asset.content, Compression::best()),
        asset,
    };
    assets().into_iter().chain([lists()]).chain(messages()).map(sent).collect()
});

fn answer(name: &str, headers: &HeaderMap) -> Response {
    let Some(Sent { asset, tag, short }) = SENT.iter().find(|of| of.asset.name == name) else {
        return Refusal::new(StatusCode::NOT_FOUND, format!("the dashboard has no file {name}"))
            .into_response();
    };
    // a newer program has newer files: a browser asks each time, and mostly hears that nothing has changed
    let fixed = [(CACHE_CONTROL, "no-cache"), (VARY, "accept-encoding"), (X_CONTENT_TYPE_OPTIONS, "nosniff")];
    let tag = [(ETAG, tag.as_str())];
    if headers.get(IF_NONE_MATCH).is_some_and(|known| is_among(known, tag[0].1)) {
        return (StatusCode::NOT_MODIFIED, tag, fixed).into_response();
    }
    // modules have the policy of the page that loads them
    let of_page =
        [(CONTENT_SECURITY_POLICY, POLICY), (REFERRER_POLICY, "no-referrer"), (X_FRAME_OPTIONS, "DENY")];
    let of_page = content_is_shown(asset.name).then_some(AppendHeaders(of_page));
    let kind = [(CONTENT_TYPE, content_type(asset.name))];
    match short.as_ref().filter(|_| takes_gzip(headers)) {
        Some(short) => {
            (tag, kind, fixed, of_page, [(CONTENT_ENCODING, "gzip")], short.clone()).into_response()
        }
        None => (tag, kind, fixed, of_page, &*asset.content).into_response(),
    }
}

/// Returns true if a browser can show a file by itself, with scripts in it.
fn content_is_shown(name: &str) -> bool {
    name.ends_with(".html") || name.ends_with(".svg")
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
    fn files_are_sent_compressed_to_who_takes_that() {
        use axum::http::header::ACCEPT_ENCODING;
        use std::io::Read;
        let mut headers = HeaderMap::new();
        let plain = answer("fleet.js", &headers);
        assert!(plain.headers().get(CONTENT_ENCODING).is_none());
        headers.insert(ACCEPT_ENCODING, "br, gzip".parse().expect("a header"));
        let short = answer("fleet.js", &headers);
        assert_eq!(short.headers().get(CONTENT_ENCODING).expect("an encoding"), "gzip");
        assert_eq!(short.headers().get(ETAG), plain.headers().get(ETAG));
        for Sent { asset, short, .. } in SENT.iter() {
            let Some(short) = short else { continue };
            let mut text = Vec::new();
            flate2::read::GzDecoder::new(short.as_slice()).read_to_end(&mut text).expect("gzip");
            assert!(text == *asset.content, "{}", asset.name);
        }
        headers.insert(ACCEPT_ENCODING, "identity".parse().expect("a header"));
        assert!(answer("fleet.js", &headers).headers().get(CONTENT_ENCODING).is_none());
    }

    #[test]
    fn every_file_of_the_folder_is_served() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/src/serve/page");
        let mut files: Vec<String> = std::fs::read_dir(folder)
            .expect("the folder")
            .map(|entry| entry.expect("a file").file_name().to_string_lossy().into_owned())
            .collect();
        let mut served: Vec<&str> = SENT
            .iter()
            .map(|of| of.asset.name)
            .filter(|name| *name != LISTS && !name.contains("messages-"))
            .collect();
        files.sort_unstable();
        served.sort_unstable();
        assert_eq!(files, served);
    }

    /// 60 kB reach a phone on a slow network within a second and a half; the data of the fleet come on top.
    const MOST_BYTES: usize = 60_000;

    #[test]
    fn the_first_page_is_small_in_each_language() {
        let html = include_str!("page/index.html");
        let first: Vec<&str> = html
            .split("\"assets/")
            .skip(1)
            .filter_map(|rest| rest.split('"').next())
            .chain(["index.html", LISTS])
            .collect();
        let size = |name: &str| {
            let sent = SENT.iter().find(|of| of.asset.name == name).expect(name);
            sent.short.as_ref().map_or(sent.asset.content.len(), Vec::len)
        };
        let page: usize =
            first.iter().collect::<std::collections::BTreeSet<_>>().into_iter().map(|name| size(name)).sum();
        for (name, _) in MESSAGES {
            assert!(page + size(name) <= MOST_BYTES, "{page} and {} of {name}", size(name));
        }
    }

    #[test]
    fn the_page_gets_every_quantity_and_kind_from_the_program() {
        let text = String::from_utf8(lists().content.into_owned()).expect("text");
        let (quantities, kinds) = text.split_once(";\n").expect("two lists");
        let object = |text: &str, name: &str| -> Map<String, Value> {
            let text = text.trim_end_matches([';', '\n']).strip_prefix(name).expect("a list");
            serde_json::from_str(text).expect("an object")
        };
        let quantities = object(quantities, "export const QUANTITIES = ");
        assert_eq!(quantities.len(), Quantity::ALL.len());
        let offset = json!({
            "label": "offset of the torque signal", "unit": "Nm", "value": "with_unit", "score": "with_unit",
            "friction": false,
        });
        assert_eq!(quantities["torque_offset_nm"], offset);
        let kinds = object(kinds, "export const KINDS = ");
        assert_eq!((kinds.len(), &kinds["drift"]["label"]), (8, &json!("Drift of friction")));
    }
}
