//! `GET /v1/views` and `/v1/views/VIEW`: rows of the SQL views.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode};
use serde_json::{Value, json};

use crate::serve::answer::Refusal;
use crate::serve::shared::Shared;
use crate::store::ViewRows;

/// Rows of an answer, where the request does not say.
const USUAL_LIMIT: usize = 1000;

/// Most rows of an answer.
const MOST: usize = 10_000;

/// Names of the views with their columns.
pub async fn views(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Json<Value>, Refusal> {
    shared.access.check(&headers)?;
    let views = shared.looking().await?.views().await.map_err(|error| Refusal::internal(&error))?;
    let views: Vec<Value> =
        views.iter().map(|(view, columns)| json!({"view": view, "columns": columns})).collect();
    Ok(Json(json!({"views": views})))
}

/// Rows of a view: any column is a filter, `order` sorts (`-` in front from the highest down), `limit` bounds.
pub async fn of_view(
    State(shared): State<Arc<Shared>>,
    Path(view): Path<String>,
    Query(asked): Query<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Json<Value>, Refusal> {
    shared.access.check(&headers)?;
    let mut wanted = ViewRows { limit: USUAL_LIMIT, ..ViewRows::default() };
    for (name, value) in asked {
        match name.as_str() {
            "limit" => wanted.limit = limit(&value)?,
            "order" => {
                wanted.order = Some(match value.strip_prefix('-') {
                    Some(column) => (column.to_owned(), true),
                    None => (value, false),
                });
            }
            _ => wanted.filters.push((name, value)),
        }
    }
    let most = wanted.limit;
    // one more tells whether there are more
    wanted.limit += 1;
    let mut table =
        shared.looking().await?.rows_of_view(&view, &wanted).await.map_err(Refusal::unanswered)?;
    let truncated = table.rows.len() > most;
    table.rows.truncate(most);
    let rows: Vec<Value> = table.objects().collect();
    Ok(Json(json!({"view": view, "rows": rows, "truncated": truncated})))
}

fn limit(text: &str) -> Result<usize, Refusal> {
    text.parse().ok().filter(|limit| (1..=MOST).contains(limit)).ok_or_else(|| {
        Refusal::new(StatusCode::BAD_REQUEST, format!("limit = {text}: give a whole number from 1 to {MOST}"))
    })
}
