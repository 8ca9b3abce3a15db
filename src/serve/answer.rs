//! Answers: JSON, and refusals that say what to do.

use axum::Json;
use axum::http::header::{CONNECTION, RETRY_AFTER, WWW_AUTHENTICATE};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use serde_json::json;

use crate::store::AskError;

/// How much of an upload is there, bytes.
pub const UPLOAD_OFFSET: HeaderName = HeaderName::from_static("upload-offset");

/// Whether an upload is whole: `?1` or `?0`.
pub const UPLOAD_COMPLETE: HeaderName = HeaderName::from_static("upload-complete");

/// A request that is not answered as its sender hoped.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal {
    /// HTTP status.
    pub status: StatusCode,
    /// What is wrong and what to do, for the sender's log.
    pub sentence: String,
    /// How much of the upload is there, where it can go on.
    pub offset: Option<u64>,
    /// Seconds after which another try makes sense.
    pub retry_after: Option<u64>,
}

impl Refusal {
    /// A refusal with a sentence.
    pub fn new(status: StatusCode, sentence: impl Into<String>) -> Self {
        Self { status, sentence: sentence.into(), offset: None, retry_after: None }
    }

    /// The same, saying from which byte the upload goes on.
    #[must_use]
    pub fn at(mut self, offset: u64) -> Self {
        self.offset = Some(offset);
        self
    }

    /// The same, saying when to try again.
    #[must_use]
    pub fn after(mut self, seconds: u64) -> Self {
        self.retry_after = Some(seconds);
        self
    }

    /// Without the token.
    pub fn unauthorized() -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "send the token as \"Authorization: Bearer TOKEN\"")
    }

    /// Not of this machine.
    pub fn forbidden() -> Self {
        Self::new(
            StatusCode::FORBIDDEN,
            "without a token, only requests to localhost or 127.0.0.1 are answered",
        )
    }

    /// A question of the database that has no answer.
    pub fn unanswered(error: AskError) -> Self {
        match error {
            AskError::NoView(text) => Self::new(StatusCode::NOT_FOUND, text),
            AskError::Statement(text) => Self::new(StatusCode::BAD_REQUEST, text),
            AskError::Store(error) => Self::internal(&error),
        }
    }

    /// A page of another server.
    pub fn of_other_page() -> Self {
        Self::new(StatusCode::FORBIDDEN, "requests of pages from another address are not answered")
    }

    /// The daemon has no token, and the request would change something.
    pub fn needs_token() -> Self {
        Self::new(
            StatusCode::FORBIDDEN,
            "the daemon has no token, and without one nothing is changed over HTTP: set serve.token_file or the \
             environment variable ARMWATCH_TOKEN, or use the command line on its machine",
        )
    }

    /// A fault of this program or machine; the detail goes to the log only.
    pub fn internal(detail: &dyn std::fmt::Display) -> Self {
        tracing::error!(%detail, "an HTTP request failed");
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal error; the daemon's log says more")
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let mut response = (self.status, Json(json!({"error": self.sentence}))).into_response();
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
        // what the client still sends is not read
        headers.insert(CONNECTION, HeaderValue::from_static("close"));
        response
    }
}
