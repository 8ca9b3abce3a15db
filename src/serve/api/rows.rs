//! `GET /v1/views` and `/v1/views/VIEW`: rows of the SQL views.

use std::sync::Arc;

use axum::extract::{Path, Query, State};
use axum::http::{HeaderMap, StatusCode};
use serde::Serialize;
use utoipa::ToSchema;

use super::row::{ViewRow, language};
use crate::language::Language;
use crate::serve::answer::{Json, Problem, Refusal, Refused};
use crate::serve::shared::Shared;
use armwatch_store::ViewRows;

/// Rows of an answer, where the request does not say.
const USUAL_LIMIT: usize = 1000;

/// Most rows of an answer.
const MOST: usize = 10_000;

/// Views with messages of detectors.
const SPOKEN_VIEWS: [&str; 2] = ["anomalies", "fleet_health"];

/// The views of the database
#[derive(Debug, Serialize, ToSchema)]
pub struct Views {
    /// Views by name
    views: Vec<View>,
}

/// A view of the database
#[derive(Debug, Serialize, ToSchema)]
pub struct View {
    /// Its name
    view: String,
    /// Names of its columns in order
    columns: Vec<String>,
}

/// Rows of a view
#[derive(Debug, Serialize, ToSchema)]
pub struct RowPage {
    /// Name of the view
    view: String,
    /// The rows
    rows: Vec<ViewRow>,
    /// Whether there are more rows than the limit
    truncated: bool,
}

/// The views and their columns
#[utoipa::path(
    get, path = "/v1/views", tag = "Rows", operation_id = "views",
    responses((status = 200, description = "Views by name", body = Views), Refused),
    security(("token" = ["read"]), ()),
)]
pub async fn views(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Json<Views>, Refusal> {
    shared.access.check(&headers)?;
    let views = shared.looking().await?.views().await.map_err(Refusal::internal)?;
    Ok(Json(Views { views: views.into_iter().map(|(view, columns)| View { view, columns }).collect() }))
}

/// Rows of a view
///
/// Any column is a filter too: `?robot=Left&joint=3`; `null` asks for NULL.
#[utoipa::path(
    get, path = "/v1/views/{view}", tag = "Rows", operation_id = "rowsOfView",
    params(
        ("view" = String, Path, description = "Name of the view"),
        ("limit" = Option<usize>, Query, description = "Most rows; 1000 where it is not given", minimum = 1, maximum = 10_000),
        ("order" = Option<String>, Query, description = "Column to sort by, with - in front from its highest value down"),
        ("language" = Option<String>, Query, description = "en, it, de or zh: language of the messages of anomalies and reasons of fleet_health; English where it is not given"),
    ),
    responses(
        (status = 200, description = "The rows", body = RowPage),
        (status = 400, description = "No such column, or a wrong limit", body = Problem),
        (status = 404, description = "No such view", body = Problem),
        Refused,
    ),
    security(("token" = ["read"]), ()),
)]
pub async fn of_view(
    State(shared): State<Arc<Shared>>,
    Path(view): Path<String>,
    Query(asked): Query<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Json<RowPage>, Refusal> {
    shared.access.check(&headers)?;
    let mut wanted = ViewRows { limit: USUAL_LIMIT, ..ViewRows::default() };
    let mut spoken = Language::English;
    for (name, value) in asked {
        match name.as_str() {
            "language" => spoken = language(&value)?,
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
    let rows = table.objects().filter_map(ViewRow::of);
    let rows = match SPOKEN_VIEWS.contains(&view.as_str()) {
        true => rows.map(|row| row.in_language(spoken)).collect(),
        false => rows.collect(),
    };
    Ok(Json(RowPage { view, rows, truncated }))
}

fn limit(text: &str) -> Result<usize, Refusal> {
    text.parse().ok().filter(|limit| (1..=MOST).contains(limit)).ok_or_else(|| {
        Refusal::new(StatusCode::BAD_REQUEST, format!("limit = {text}: give a whole number from 1 to {MOST}"))
    })
}
