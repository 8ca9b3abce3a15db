//! Answers: JSON, and refusals that name a remedy.

use axum::extract::rejection::{BytesRejection, JsonRejection};
use axum::http::header::{CONNECTION, CONTENT_TYPE, HOST, ORIGIN, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::{IntoResponses, ToSchema};

use armwatch_config::Scope;
use armwatch_model::text;
use armwatch_store::AskError;

/// Largest body of a request other than an upload, bytes.
pub const BODY_BYTES: usize = 256 << 10;

/// Header with the number of bytes of an upload that have arrived.
pub const UPLOAD_OFFSET: HeaderName = HeaderName::from_static("upload-offset");

/// Header that is `?1` if an upload is complete and `?0` otherwise.
pub const UPLOAD_COMPLETE: HeaderName = HeaderName::from_static("upload-complete");

/// An answer in JSON. Hidden characters are escaped, so that they cannot mislead the reader of a log or terminal.
#[derive(Debug)]
pub struct Json<T>(pub T);

impl<T: Serialize> IntoResponse for Json<T> {
    fn into_response(self) -> Response {
        match serde_json::to_string(&self.0) {
            Ok(body) => {
                ([(CONTENT_TYPE, "application/json")], text::json(&body).into_owned()).into_response()
            }
            Err(error) => {
                tracing::error!(%error, "an answer is no JSON");
                StatusCode::INTERNAL_SERVER_ERROR.into_response()
            }
        }
    }
}

/// Why a request is refused
#[derive(Debug, Serialize, ToSchema)]
pub struct Problem {
    /// What is wrong and what to do
    pub error: String,
}

/// Refusals that any request may meet, for the description of the API.
#[derive(IntoResponses)]
#[expect(dead_code, reason = "only its description is used")]
pub enum Refused {
    /// The token is missing or not one of the daemon
    #[response(status = 401)]
    Unauthorized(Problem),
    /// The token may not do this, or the daemon has none; or the request is one of another page
    #[response(status = 403)]
    Forbidden(Problem),
    /// Too many requests of one address; try again after Retry-After
    #[response(status = 429)]
    TooMany(Problem),
    /// A fault of the program or its machine
    #[response(status = 500)]
    Internal(Problem),
}

/// A refused request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// HTTP status.
    pub status: StatusCode,
    /// The problem and its remedy, for the sender's log.
    pub sentence: String,
    /// Bytes of the upload that have arrived, if it can be continued.
    pub offset: Option<u64>,
    /// Seconds after which the sender should try again.
    pub retry_after: Option<u64>,
}

impl Refusal {
    /// A refusal with a sentence.
    pub fn new(status: StatusCode, sentence: impl Into<String>) -> Self {
        Self { status, sentence: sentence.into(), offset: None, retry_after: None }
    }

    /// Adds the offset from where the upload continues.
    #[must_use]
    pub fn at(mut self, offset: u64) -> Self {
        self.offset = Some(offset);
        self
    }

    /// Adds the time after which the sender should try again.
    #[must_use]
    pub fn after(mut self, seconds: u64) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// A body that is larger than allowed, or ended early.
    pub fn of_body(rejection: &BytesRejection) -> Self {
        if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE {
            let most = BODY_BYTES >> 10;
            let sentence = format!(
                "the body is larger than {most} KiB, the most of a request that is no upload; send less, and exports with \
                 PUT /v1/exports/NAME"
            );
            return Self::new(rejection.status(), sentence);
        }
        Self::new(rejection.status(), "the body broke off before its end; send the request again")
    }

    /// A body that is not the expected JSON, which looks like `example`.
    pub fn of_json(rejection: &JsonRejection, example: &str) -> Self {
        match rejection {
            JsonRejection::BytesRejection(rejection) => Self::of_body(rejection),
            JsonRejection::MissingJsonContentType(_) => Self::new(
                StatusCode::UNSUPPORTED_MEDIA_TYPE,
                format!("send JSON with Content-Type: application/json, such as {example}"),
            ),
            rejection => {
                let text = rejection.body_text();
                // the library puts the subject before the problem
                let wrong = text.split_once(": ").map_or(&*text, |(_, wrong)| wrong);
                Self::new(
                    StatusCode::BAD_REQUEST,
                    format!("the body is not understood: {wrong}; send {example}"),
                )
            }
        }
    }

    /// A request without a token.
    pub fn unauthorized() -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "send a token as \"Authorization: Bearer TOKEN\"")
    }

    /// A request with a token that the daemon does not know.
    pub fn wrong_token() -> Self {
        let sentence =
            "this token is none of the daemon's; its files are named by serve.token_file and serve.token";
        Self::new(StatusCode::UNAUTHORIZED, sentence)
    }

    /// A request with a token that lacks the scope `wanted`.
    pub fn out_of_scope(token: &str, wanted: Scope) -> Self {
        let sentence =
            format!("the token {token} lacks the scope \"{}\"; serve.token gives scopes", wanted.name());
        Self::new(StatusCode::FORBIDDEN, sentence)
    }

    /// More requests than one address may send.
    pub fn too_many(seconds: u64) -> Self {
        let sentence =
            "too many requests of this address; send fewer a second, or raise serve.requests_per_s";
        Self::new(StatusCode::TOO_MANY_REQUESTS, sentence).after(seconds)
    }

    /// A request to a daemon without tokens that is not addressed to this machine.
    pub fn forbidden() -> Self {
        Self::new(
            StatusCode::FORBIDDEN,
            "without a token, only requests to localhost or 127.0.0.1 are answered",
        )
    }

    /// A query of the database that has no answer.
    pub fn unanswered(error: AskError) -> Self {
        match error {
            AskError::NoView(text) => Self::new(StatusCode::NOT_FOUND, text),
            AskError::Statement(text) => Self::new(StatusCode::BAD_REQUEST, text),
            AskError::Store(error) => Self::internal(error),
        }
    }

    /// A request from a page of another server.
    pub fn of_other_page(headers: &HeaderMap) -> Self {
        let named = |name| {
            let value: Option<&HeaderValue> = headers.get(name);
            value.map_or_else(|| "missing".into(), |value| value.as_bytes().escape_ascii().to_string())
        };
        let sentence = format!(
            "the page that sent this request is at another address: Origin is {}, Host is {}. A reverse proxy must \
             pass on the browser's Host with its port; in nginx: proxy_set_header Host $http_host",
            named(ORIGIN),
            named(HOST)
        );
        Self::new(StatusCode::FORBIDDEN, sentence)
    }

    /// A request that would change something, sent to a daemon without a token.
    pub fn needs_token() -> Self {
        Self::new(
            StatusCode::FORBIDDEN,
            "the daemon has no token, and without one nothing is changed over HTTP: set serve.token_file or the \
             environment variable ARMWATCH_TOKEN, or use the command line on its machine",
        )
    }

    /// A fault of this program or its machine. Only the log contains the details.
    pub fn internal(detail: impl std::fmt::Display) -> Self {
        tracing::error!(%detail, "an HTTP request failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal error; the daemon's log says more")
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let mut response = (self.status, Json(Problem { error: self.sentence })).into_response();
        let headers = response.headers_mut();
        if let Some(offset) = self.offset {
            headers.insert(UPLOAD_OFFSET, offset.into());
        }
        if let Some(seconds) = self.retry_after {
            headers.insert(RETRY_AFTER, seconds.into());
        }
        if self.status == StatusCode::UNAUTHORIZED {
            headers.insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        // the rest of the request is not read
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn hidden_characters_of_names_are_escaped_in_answers() {
        let name = "E\u{202e}vsc \u{200b}ü";
        let answer = Json([name]).into_response();
        assert_eq!(answer.headers()[CONTENT_TYPE], "application/json");
        let bytes = axum::body::to_bytes(answer.into_body(), 1000).await.unwrap();
        assert_eq!(bytes, "[\"E\\u202evsc \\u200bü\"]".as_bytes());
        assert_eq!(serde_json::from_slice::<[String; 1]>(&bytes).unwrap(), [name]);
    }
}
