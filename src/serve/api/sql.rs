//! `POST /v1/sql`: a query in SQL over the public views, within limits.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::State;
use axum::extract::rejection::BytesRejection;
use axum::http::header::{ACCEPT, CONTENT_TYPE};
use axum::http::{HeaderMap, HeaderName, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_store::{ResultTable, SqlAnswer, SqlError, SqlLimits};

/// Rows of an answer if the query sets no limit.
const USUAL_ROWS: usize = 1000;

/// Most rows of an answer.
const MOST_ROWS: usize = 100_000;

/// Most bytes of the values of an answer.
const MOST_BYTES: usize = 16 << 20;

/// Time limit of a statement.
const TIME: Duration = Duration::from_secs(10);

/// Longest wait of a query for others to end.
const PATIENCE: Duration = Duration::from_secs(2);

/// Header that reports more rows than the limit, because CSV has no place for it.
const TRUNCATED: HeaderName = HeaderName::from_static("x-truncated");

/// A question in SQL.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// One statement that begins with SELECT, WITH or VALUES
    sql: String,
    /// Values of ?1, ?2, ...: null, true, false, numbers or texts
    #[serde(default)]
    parameters: Vec<Value>,
    /// Most rows, 1 to 100,000; 1000 where it is not given
    #[schema(minimum = 1, maximum = 100_000)]
    limit: Option<usize>,
}

/// The answer to a question in SQL.
#[derive(Debug, Serialize, ToSchema)]
pub struct Answer {
    /// Names of the columns
    columns: Vec<String>,
    /// Rows with a value a column: null, a number or a text; bytes are hexadecimal digits
    rows: Vec<Vec<Value>>,
    /// Whether there are more rows than the limit
    truncated: bool,
}

/// Answer a question in SQL
///
/// One statement that reads the public views, within limits of rows, bytes and time. `Accept: text/csv` asks for CSV.
#[utoipa::path(
    post, path = "/v1/sql", tag = "Rows", operation_id = "sql",
    request_body(description = "The statement, with parameters or alone", content((Question = "application/json"), (String = "application/sql"), (String = "text/plain"))),
    responses(
        (status = 200, description = "The rows", content((Answer = "application/json"), (String = "text/csv"))),
        (status = 400, description = "The statement is not understood; the sentence says the line and the column", body = Problem),
        (status = 413, description = "The body is larger than 256 KiB", body = Problem),
        (status = 415, description = "The body is neither JSON nor a statement", body = Problem),
        (status = 422, description = "The statement takes longer, or its answer is larger, than allowed", body = Problem),
        (status = 503, description = "Other statements are under way; try again after Retry-After", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn sql(
    State(shared): State<Arc<Shared>>,
    headers: HeaderMap,
    body: Result<Bytes, BytesRejection>,
) -> Result<Response, Refusal> {
    shared.access.check(&headers)?;
    let body = body.map_err(|rejection| Refusal::of_body(&rejection))?;
    let Question { sql, parameters, limit } = question(&headers, &body)?;
    if sql.trim().is_empty() {
        let sentence = "the statement is empty; send one that begins with SELECT, WITH or VALUES, such as SELECT * FROM \
                        fleet_health";
        return Err(bad(sentence.into()));
    }
    let rows = limit.unwrap_or(USUAL_ROWS);
    if !(1..=MOST_ROWS).contains(&rows) {
        return Err(bad(format!("limit = {rows}: give a whole number from 1 to {MOST_ROWS}")));
    }
    let turn = tokio::time::timeout(PATIENCE, Arc::clone(&shared.statements).acquire_owned()).await;
    let Ok(Ok(turn)) = turn else {
        let sentence = "other statements are under way; try again";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, sentence).after(1));
    };
    let limits = SqlLimits { rows, bytes: MOST_BYTES, time: TIME };
    let store = shared.looking().await?.clone();
    // this function is dropped early if the client disconnects
    let abandon = Abandon::default();
    let abandoned = Arc::clone(&abandon.0);
    let asked = tokio::task::spawn_blocking(move || {
        let answer = store.ask_within(&sql, &parameters, limits, &abandoned);
        drop(turn);
        answer
    });
    let SqlAnswer { table, truncated } = asked.await.map_err(Refusal::internal)?.map_err(refused)?;
    if wants_csv(&headers) {
        let text = csv(&table).map_err(Refusal::internal)?;
        let truncated = if truncated { "true" } else { "false" };
        return Ok(
            ([(CONTENT_TYPE, "text/csv; charset=utf-8")], [(TRUNCATED, truncated)], text).into_response()
        );
    }
    let ResultTable { columns, rows } = table;
    Ok(Json(Answer { columns, rows, truncated }).into_response())
}

/// Stops a statement if no one waits for its answer.
#[derive(Debug, Default)]
struct Abandon(Arc<AtomicBool>);

impl Drop for Abandon {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn question(headers: &HeaderMap, body: &Bytes) -> Result<Question, Refusal> {
    let media = headers.get(CONTENT_TYPE).and_then(|media| media.to_str().ok()).unwrap_or_default();
    match media.split(';').next().unwrap_or_default().trim().to_ascii_lowercase().as_str() {
        "application/json" => serde_json::from_slice(body).map_err(|error| {
            bad(format!(
                "the body is not {{\"sql\": \"SELECT ...\", \"parameters\": [...], \"limit\": N}}: {error}"
            ))
        }),
        "application/sql" | "text/plain" => match std::str::from_utf8(body) {
            Ok(text) => Ok(Question { sql: text.to_owned(), parameters: Vec::new(), limit: None }),
            Err(error) => Err(bad(format!("the statement is not UTF-8: {error}"))),
        },
        _ => Err(Refusal::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "send JSON with Content-Type: application/json, or the statement alone with application/sql",
        )),
    }
}

fn wants_csv(headers: &HeaderMap) -> bool {
    headers
        .get(ACCEPT)
        .and_then(|accept| accept.to_str().ok())
        .is_some_and(|accept| accept.contains("text/csv"))
}

fn csv(table: &ResultTable) -> Result<Vec<u8>, Box<dyn std::error::Error + Send + Sync>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(&table.columns)?;
    for row in &table.rows {
        writer.write_record(row.iter().map(|value| match value {
            Value::Null => String::new(),
            Value::String(text) => text.clone(),
            other => other.to_string(),
        }))?;
    }
    Ok(writer.into_inner()?)
}

fn refused(error: SqlError) -> Refusal {
    let status = match &error {
        SqlError::Statement { .. } => StatusCode::BAD_REQUEST,
        SqlError::Forbidden(_) => StatusCode::FORBIDDEN,
        SqlError::TooSlow(_) | SqlError::TooLarge(_) => StatusCode::UNPROCESSABLE_ENTITY,
        SqlError::Store(error) => return Refusal::internal(error),
    };
    Refusal::new(status, error.to_string())
}

fn bad(sentence: String) -> Refusal {
    Refusal::new(StatusCode::BAD_REQUEST, sentence)
}
