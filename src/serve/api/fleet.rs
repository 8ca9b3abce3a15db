//! `GET /v1/fleet`: the fleet at a glance.

use std::cmp::Reverse;
use std::collections::HashMap;
use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use jiff::Timestamp;
use serde_json::{Map, Value, json};

use crate::serve::answer::Refusal;
use crate::serve::shared::Shared;
use crate::store::{Counts, Store, Table, ViewRows};

/// Tests of a joint's history.
const TESTS: u32 = 30;

/// Most anomalies that are told.
const ANOMALIES: usize = 200;

/// Most rows of one kind that are read for it.
const MOST: usize = 100_000;

/// States of anomalies that are not settled.
const UNSETTLED: [&str; 4] = ["open", "acknowledged", "shelved", "maintenance"];

/// Columns of `fleet_health` that a joint is told with.
const OF_JOINT: [&str; 9] = [
    "joint",
    "status",
    "reason",
    "friction_index",
    "moving_relative_rmsd",
    "trend",
    "warning_by",
    "critical_by",
    "open_anomalies",
];

/// Robots with their joints, alarms that are not settled, exports that are being read, and counts.
pub async fn fleet(State(shared): State<Arc<Shared>>, headers: HeaderMap) -> Result<Json<Value>, Refusal> {
    shared.access.check(&headers)?;
    let store = shared.looking().await?;
    let Counts { streaming_runs, complete_runs, quarantined_runs, cycles, .. } =
        store.counts().await.map_err(|error| Refusal::internal(&error))?;
    let robots = robots_with_joints(store).await?;
    let anomalies = anomalies(store).await?;
    let alarms = anomalies.iter().filter(|row| row["state"] == "open" && row["severity"] != "info").count();
    let (warning, critical) = {
        let config = shared.config.borrow();
        (config.detect.drift_warning, config.detect.drift_critical)
    };
    Ok(Json(json!({
        "now": Timestamp::now().to_string(),
        "counts": {
            "robots": robots.len(), "streaming_runs": streaming_runs, "complete_runs": complete_runs,
            "quarantined_runs": quarantined_runs, "cycles": cycles, "open_anomalies": alarms,
        },
        "limits": {"drift_warning_fraction": warning, "drift_critical_fraction": critical},
        "robots": robots,
        "anomalies": anomalies,
        "live": live(store).await?,
    })))
}

async fn robots_with_joints(store: &Store) -> Result<Vec<Value>, Refusal> {
    let histories = histories(&store.recent_indices(TESTS).await.map_err(Refusal::unanswered)?);
    let mut joints: HashMap<String, Vec<Map<String, Value>>> = HashMap::new();
    for row in rows(store, "fleet_health", &[], Some("joint")).await? {
        joints.entry(text(&row, "robot").to_owned()).or_default().push(row);
    }
    let robots = store.robot_list().await.map_err(Refusal::unanswered)?;
    let robot = |row: Value| {
        let name = row["robot"].as_str().unwrap_or_default().to_owned();
        let joints = joints.get(&name).map_or(&[][..], |of| of);
        let of_joint = |row: &Map<String, Value>| {
            let told = OF_JOINT.iter().map(|column| ((*column).to_owned(), row[*column].clone()));
            let mut told: Map<String, Value> = told.collect();
            let history = histories.get(&(name.clone(), row["joint"].as_i64().unwrap_or_default()));
            told.insert("history".into(), json!(history.map_or(&[][..], |of| of)));
            told
        };
        let latest =
            |column: &str| joints.iter().map(|of| text(of, column)).filter(|of| !of.is_empty()).max();
        json!({
            "robot": name, "model": row["model"], "status": row["status"],
            "last_run_at": latest("last_run_at"), "last_result_at": latest("last_result_at"),
            "expected_by": latest("expected_by"), "open_anomalies": row["open_anomalies"],
            "joints": joints.iter().map(of_joint).collect::<Vec<_>>(),
        })
    };
    Ok(robots.objects().map(robot).collect())
}

/// Friction indices by robot and joint, the oldest first.
fn histories(table: &Table) -> HashMap<(String, i64), Vec<Value>> {
    let mut histories: HashMap<(String, i64), Vec<Value>> = HashMap::new();
    for row in table.objects() {
        let of =
            (row["robot"].as_str().unwrap_or_default().to_owned(), row["joint"].as_i64().unwrap_or_default());
        histories.entry(of).or_default().push(row["friction_index"].as_f64().map_or(Value::Null, shown));
    }
    histories
}

/// A figure of a history with the digits that a line of some pixels shows.
fn shown(index: f64) -> Value {
    json!((index * 1e4).round() / 1e4)
}

/// Anomalies that are not settled, the worst first, then the newest.
async fn anomalies(store: &Store) -> Result<Vec<Value>, Refusal> {
    let severity =
        |row: &Map<String, Value>| ["critical", "warning"].iter().position(|of| text(row, "severity") == *of);
    let mut found = Vec::new();
    for state in UNSETTLED {
        found.extend(rows(store, "anomalies", &[("state", state)], None).await?);
    }
    found.sort_by_key(|row| {
        (
            severity(row).unwrap_or(2),
            Reverse(text(row, "last_seen_at").to_owned()),
            row["anomaly_id"].as_i64(),
        )
    });
    found.truncate(ANOMALIES);
    Ok(found.into_iter().map(Value::Object).collect())
}

/// Exports of which cycles are being stored.
async fn live(store: &Store) -> Result<Vec<Value>, Refusal> {
    let found = rows(store, "runs", &[("status", "streaming")], Some("started_at")).await?;
    let of = |row: Map<String, Value>| {
        json!({
            "run_id": row["run_id"], "robot": row["robot"], "source_name": row["source_name"],
            "started_at": row["started_at"], "cycles": row["cycles"],
        })
    };
    Ok(found.into_iter().map(of).collect())
}

async fn rows(
    store: &Store,
    view: &str,
    filters: &[(&str, &str)],
    order: Option<&str>,
) -> Result<Vec<Map<String, Value>>, Refusal> {
    let wanted = ViewRows {
        filters: filters.iter().map(|(column, value)| ((*column).to_owned(), (*value).to_owned())).collect(),
        order: order.map(|column| (column.to_owned(), false)),
        limit: MOST,
    };
    let table = store.rows_of_view(view, &wanted).await.map_err(Refusal::unanswered)?;
    let object = |row: Value| match row {
        Value::Object(columns) => Some(columns),
        _ => None,
    };
    Ok(table.objects().filter_map(object).collect())
}

fn text<'r>(row: &'r Map<String, Value>, column: &str) -> &'r str {
    row.get(column).and_then(Value::as_str).unwrap_or_default()
}
