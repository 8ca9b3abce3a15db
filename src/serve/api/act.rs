//! What people do in a page: with alarms, with work on a robot, with exports that were not understood.

use std::sync::Arc;

use axum::Json;
use axum::extract::rejection::JsonRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use jiff::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::robot::JointIndex;
use crate::serve::answer::Refusal;
use crate::serve::shared::Shared;
use crate::store::{AlarmAction, AlarmState, NewMaintenance, NotDone, ViewRows};

/// Most characters of a name or a reason.
const LONGEST: usize = 1000;

/// Who does something with an alarm, and why.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deed {
    who: String,
    why: Option<String>,
    until: Option<Timestamp>,
}

/// Work that was done on a robot.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Work {
    who: String,
    what: String,
    joint: Option<usize>,
    at: Option<Timestamp>,
}

/// `POST /v1/anomalies/ID/acknowledge`, `/shelve`, `/resolve`, `/false-alarm`: the anomaly as it stands then.
pub async fn on_anomaly(
    State(shared): State<Arc<Shared>>,
    Path((id, action)): Path<(i64, String)>,
    headers: HeaderMap,
    deed: Result<Json<Deed>, JsonRejection>,
) -> Result<Json<Value>, Refusal> {
    shared.access.check_action(&headers)?;
    let Deed { who, why, until } = body(deed)?;
    let who = named(&who)?;
    let why = why.map(|why| bounded(&why, "why")).transpose()?.filter(|why| !why.is_empty());
    let action = match (action.as_str(), until) {
        ("acknowledge", _) => AlarmAction::Acknowledge,
        ("resolve", _) => AlarmAction::Resolve,
        ("false-alarm", _) => AlarmAction::FalseAlarm,
        ("shelve", Some(until)) if until > Timestamp::now() => AlarmAction::Shelve(until),
        ("shelve", _) => return Err(bad("give until, a time that lies ahead, such as 2026-09-01T06:00:00Z")),
        _ => {
            let actions = "acknowledge, shelve, resolve and false-alarm";
            return Err(Refusal::new(
                StatusCode::NOT_FOUND,
                format!("there is no action {action}; there are {actions}"),
            ));
        }
    };
    let acted = shared.store.act_on_anomalies(&[id], action, &who, why.as_deref()).await;
    acted.map_err(|error| Refusal::internal(&error))?.map_err(|reason| not_done(&reason))?;
    let wanted =
        ViewRows { filters: vec![("anomaly_id".into(), id.to_string())], limit: 1, ..ViewRows::default() };
    let rows = shared.store.rows_of_view("anomalies", &wanted).await.map_err(Refusal::unanswered)?;
    Ok(Json(rows.objects().next().unwrap_or(Value::Null)))
}

/// `POST /v1/robots/ROBOT/maintenance`: the number under which the work is entered.
pub async fn maintenance(
    State(shared): State<Arc<Shared>>,
    Path(robot): Path<String>,
    headers: HeaderMap,
    work: Result<Json<Work>, JsonRejection>,
) -> Result<(StatusCode, Json<Value>), Refusal> {
    shared.access.check_action(&headers)?;
    let Work { who, what, joint, at } = body(work)?;
    let (who, what) = (named(&who)?, bounded(&what, "what")?);
    if what.is_empty() {
        return Err(bad("give what was done, such as \"gearbox changed\""));
    }
    let now = Timestamp::now();
    let at = at.unwrap_or(now);
    if at > now {
        return Err(bad("at lies ahead; enter work once it is done"));
    }
    let failed = |error| Refusal::internal(&error);
    let unknown =
        || Refusal::new(StatusCode::NOT_FOUND, format!("no export of a robot \"{robot}\" is stored"));
    let joints = shared.store.known_joints(&robot).await.map_err(failed)?.ok_or_else(unknown)?;
    let place = match joint {
        Some(number) => {
            Some(JointIndex::from_number(number).filter(|_| joints == 0 || number <= joints).ok_or_else(
                || bad(&format!("{robot} has no joint {number}; its tests have {joints} joints")),
            )?)
        }
        None => None,
    };
    let new = NewMaintenance { robot: robot.clone(), joint: place, at, what, who: Some(who) };
    let number = shared.store.enter_maintenance(&new).await.map_err(failed)?.ok_or_else(unknown)?;
    let told = json!({
        "maintenance_id": number, "robot": robot, "joint": joint, "at": at.to_string(), "what": new.what, "who": new.who,
    });
    Ok((StatusCode::CREATED, Json(told)))
}

/// `POST /v1/quarantine/RUN_ID/retry`: the export is read again at the next scan.
pub async fn retry(
    State(shared): State<Arc<Shared>>,
    Path(run_id): Path<i64>,
    headers: HeaderMap,
) -> Result<(StatusCode, Json<Value>), Refusal> {
    shared.access.check_action(&headers)?;
    if !shared.store.ask_retry(run_id).await.map_err(|error| Refusal::internal(&error))? {
        let sentence = format!("run {run_id} is not in quarantine");
        return Err(Refusal::new(StatusCode::CONFLICT, sentence));
    }
    Ok((
        StatusCode::ACCEPTED,
        Json(json!({"run_id": run_id, "outcome": "it is read again at the next scan"})),
    ))
}

fn body<T>(sent: Result<Json<T>, JsonRejection>) -> Result<T, Refusal> {
    sent.map(|Json(body)| body).map_err(|rejection| Refusal::new(rejection.status(), rejection.body_text()))
}

fn named(who: &str) -> Result<String, Refusal> {
    let who = bounded(who, "who")?;
    if who.is_empty() { Err(bad("give who does it, for those who read the history later")) } else { Ok(who) }
}

fn bounded(text: &str, name: &str) -> Result<String, Refusal> {
    let text = text.trim();
    if text.chars().count() > LONGEST || text.contains('\0') {
        return Err(bad(&format!("{name}: give at most {LONGEST} characters")));
    }
    Ok(text.to_owned())
}

fn bad(sentence: &str) -> Refusal {
    Refusal::new(StatusCode::BAD_REQUEST, sentence)
}

fn not_done(reason: &NotDone) -> Refusal {
    match reason {
        NotDone::Unknown(id) => Refusal::new(StatusCode::NOT_FOUND, format!("there is no anomaly {id}")),
        NotDone::Withdrawn(id) => Refusal::new(
            StatusCode::NOT_FOUND,
            format!("anomaly {id} was withdrawn: with more of the history known, it is none"),
        ),
        NotDone::NotFrom { anomaly_id, state, ended } => {
            let remedy = match state {
                _ if *ended => "later tests no longer show it",
                AlarmState::Resolved | AlarmState::FalseAlarm => "acknowledging it takes that back",
                _ => "nothing was changed",
            };
            let name = state.name().replace('_', " ");
            Refusal::new(StatusCode::CONFLICT, format!("anomaly {anomaly_id} is {name} already: {remedy}"))
        }
    }
}
