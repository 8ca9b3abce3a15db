//! Compression of answers, and tags by which a client that has an answer does not receive it again.

use std::io::Write;
use std::sync::Arc;

use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::header::{
    ACCEPT_ENCODING, CACHE_CONTROL, CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_TYPE, ETAG, IF_NONE_MATCH, VARY,
};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode};
use axum::response::{IntoResponse, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use tokio::sync::Semaphore;

use super::answer::Refusal;
use armwatch_ingest::bytes::fingerprint::of_bytes;

/// Answers that are compressed at once. Further ones are sent as they are, so that clients cannot take the cores of the
/// pipeline.
pub(super) const COMPRESSED_AT_ONCE: usize = 1;

/// Shorter answers fit into one packet.
const SHORT_BYTES: usize = 1 << 10;

/// Level of answers that are made on request: 650 kB in some 5 ms. A higher level saves a twentieth of the bytes.
const LEVEL: Compression = Compression::new(5);

/// The form of an answer that a client accepts, and the tags of answers that it has.
#[derive(Debug)]
pub(super) struct AcceptedForm {
    is_get: bool,
    gzip: bool,
    known: Option<HeaderValue>,
}

impl AcceptedForm {
    pub(super) fn by(request: &Request) -> Self {
        Self {
            is_get: *request.method() == Method::GET,
            gzip: takes_gzip(request.headers()),
            known: request.headers().get(IF_NONE_MATCH).cloned(),
        }
    }
}

/// An answer in the form that its client wants. Streams, files of the dashboard and refusals stay as they are.
pub(super) async fn in_wanted_form(
    places: &Arc<Semaphore>,
    wanted: AcceptedForm,
    answer: Response,
) -> Response {
    let media = answer.headers().get(CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
    let is_json = media.starts_with(b"application/json");
    let is_whole = answer.body().size_hint().exact().is_some();
    let is_ready = answer.headers().contains_key(CONTENT_ENCODING) || answer.headers().contains_key(ETAG);
    if !wanted.is_get
        || answer.status() != StatusCode::OK
        || is_ready
        || !is_whole
        || !(is_json || media.starts_with(b"text/"))
    {
        return answer;
    }
    let (mut head, body) = answer.into_parts();
    let bytes = match to_bytes(body, usize::MAX).await {
        Ok(bytes) => bytes,
        Err(error) => return Refusal::internal(error).into_response(),
    };
    head.headers.insert(VARY, HeaderValue::from_static("accept-encoding"));
    if is_json {
        // a browser asks each time, and receives the bytes only if they have changed
        head.headers.insert(CACHE_CONTROL, HeaderValue::from_static("private, no-cache"));
        let tag = tag_of(&bytes);
        let is_known = wanted.known.is_some_and(|known| is_among(&known, &tag));
        head.headers.extend(HeaderValue::try_from(tag).map(|tag| (ETAG, tag)));
        if is_known {
            head.status = StatusCode::NOT_MODIFIED;
            head.headers.remove(CONTENT_TYPE);
            head.headers.remove(CONTENT_LENGTH);
            return Response::from_parts(head, Body::empty());
        }
    }
    let place = (wanted.gzip && bytes.len() >= SHORT_BYTES).then(|| Arc::clone(places).try_acquire_owned());
    let Some(Ok(place)) = place else { return Response::from_parts(head, bytes.into()) };
    let whole = bytes.clone();
    let short = tokio::task::spawn_blocking(move || {
        let short = compressed(&whole, LEVEL);
        drop(place);
        short
    });
    match short.await {
        Ok(Some(short)) => {
            head.headers.remove(CONTENT_LENGTH);
            head.headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            Response::from_parts(head, short.into())
        }
        _ => Response::from_parts(head, bytes.into()),
    }
}

/// The tag of a content, which is weak because it is the same for both forms.
pub(super) fn tag_of(content: &[u8]) -> String {
    let hash = of_bytes(content).to_string();
    format!("W/\"{}\"", hash.get(..32).unwrap_or(&hash))
}

/// Returns true if a client that named the tags `known` has the content of `tag`.
pub(super) fn is_among(known: &HeaderValue, tag: &str) -> bool {
    known.to_str().is_ok_and(|known| known.split(',').any(|one| one.trim() == tag))
}

/// The content as gzip; `None` if that is not shorter.
pub(super) fn compressed(content: &[u8], level: Compression) -> Option<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), level);
    let short = encoder.write_all(content).and_then(|()| encoder.finish()).ok()?;
    (short.len() < content.len()).then_some(short)
}

/// Returns true if a client takes gzip.
pub(super) fn takes_gzip(headers: &HeaderMap) -> bool {
    let taken = headers.get(ACCEPT_ENCODING).and_then(|taken| taken.to_str().ok()).unwrap_or_default();
    taken.split(',').any(|one| {
        let (name, quality) = one.split_once(';').unwrap_or((one, "q=1"));
        let quality = quality.trim().strip_prefix("q=").and_then(|of| of.trim().parse::<f64>().ok());
        name.trim().eq_ignore_ascii_case("gzip") && quality.is_some_and(|of| of > 0.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    const ROWS: usize = 4000;

    async fn asked(places: usize, headers: &[(&'static str, String)], answer: Response) -> Response {
        let mut request = Request::new(Body::empty());
        for (name, value) in headers {
            request.headers_mut().insert(*name, HeaderValue::try_from(value).expect("a header"));
        }
        in_wanted_form(&Arc::new(Semaphore::new(places)), AcceptedForm::by(&request), answer).await
    }

    fn rows() -> Response {
        super::super::answer::Json(vec!["Rüttler"; ROWS]).into_response()
    }

    #[tokio::test]
    async fn an_answer_is_compressed_for_who_takes_that_while_a_core_is_free() {
        let gzip = [("accept-encoding", "br, gzip;q=0.5".to_owned())];
        let short = asked(1, &gzip, rows()).await;
        assert_eq!(short.headers()[CONTENT_ENCODING], "gzip");
        assert_eq!(short.headers()[VARY], "accept-encoding");
        let bytes = to_bytes(short.into_body(), usize::MAX).await.unwrap();
        assert!(bytes.len() < 1000, "{}", bytes.len());
        let mut text = String::new();
        flate2::read::GzDecoder::new(&bytes[..]).read_to_string(&mut text).unwrap();
        assert_eq!(serde_json::from_str::<Vec<String>>(&text).unwrap(), vec!["Rüttler"; ROWS]);
        for (places, taken) in [(0, "gzip"), (1, "gzip;q=0"), (1, "br"), (1, "")] {
            let plain = asked(places, &[("accept-encoding", taken.to_owned())], rows()).await;
            assert!(plain.headers().get(CONTENT_ENCODING).is_none(), "{places} {taken}");
            assert_eq!(plain.body().size_hint().exact(), Some(text.len() as u64));
        }
    }

    #[tokio::test]
    async fn a_client_that_has_the_answer_receives_only_that() {
        let first = asked(1, &[], rows()).await;
        let tag = first.headers()[ETAG].to_str().unwrap().to_owned();
        let known = asked(1, &[("if-none-match", format!("\"other\", {tag}"))], rows()).await;
        assert_eq!((known.status(), known.body().size_hint().exact()), (StatusCode::NOT_MODIFIED, Some(0)));
        let other = super::super::answer::Json(["changed"]).into_response();
        assert_eq!(asked(1, &[("if-none-match", tag)], other).await.status(), StatusCode::OK);
    }

    #[tokio::test]
    async fn a_stream_is_passed_on_as_it_comes() {
        use axum::response::Sse;
        use axum::response::sse::Event;
        let events =
            futures_util::stream::iter([Ok::<_, std::convert::Infallible>(Event::default().data("{}"))]);
        let answer =
            asked(1, &[("accept-encoding", "gzip".to_owned())], Sse::new(events).into_response()).await;
        assert!(answer.headers().get(CONTENT_ENCODING).is_none() && answer.headers().get(ETAG).is_none());
        assert_eq!(to_bytes(answer.into_body(), 100).await.unwrap(), "data: {}\n\n");
    }
}
